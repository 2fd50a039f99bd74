"""The gallery's example of a cohort, in the environment that can run it."""

import importlib.util
from pathlib import Path

import pytest

PAGES = Path(__file__).resolve().parents[1] / "site" / "test_gallery.py"


def test_the_example_of_a_cohort_prints_what_its_page_says(tmp_path):
    pytest.importorskip("snakebids", reason="needs snakebids: pip install .[cohort]")
    specification = importlib.util.spec_from_file_location("gallery_pages", PAGES)
    pages = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(pages)
    pages.test_the_example_prints_what_its_page_says("cohort", tmp_path)
