"""Every example of the gallery runs, prints what its page says, and draws its picture.

That for ParaView is run in `Testing/paraview`, by ParaView's Python.
"""

import importlib.util
import re
from pathlib import Path

import pytest
from hosts import has_elastix, host_missing
from printed import check

DOCS = Path(__file__).resolve().parents[2] / "docs"
specification = importlib.util.spec_from_file_location("make", DOCS / "examples" / "make.py")
make = importlib.util.module_from_spec(specification)
specification.loader.exec_module(make)

IMAGES = {"slice", "hidden_lesion", "region", "cohort"}  # they register images


def needs(name: str) -> None:
    """Skip an example for which this machine lacks something."""
    if name in IMAGES and not has_elastix():
        host_missing("itk-elastix is not installed", 'pip install ".[all]"')
    if name == "cohort":
        pytest.importorskip("snakebids", reason="needs snakebids: pip install .[cohort]")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in make.ORDER if name not in make.HOSTS])
def test_the_example_prints_what_its_page_says(name, tmp_path):
    needs(name)
    printed = make.run(name, tmp_path)
    text = (DOCS / "examples" / f"{name}.md").read_text(encoding="utf-8")
    check(printed, re.search(r"```text\n(.*?)```", text, re.S).group(1), rtol=0.15)
    assert (tmp_path / f"{name}.png").stat().st_size > 5000


@pytest.mark.parametrize("name", make.ORDER)
def test_the_page_is_made_of_the_script(name):
    text = (DOCS / "examples" / f"{name}.md").read_text(encoding="utf-8")
    assert text == make.page(name, re.search(r"```text\n(.*?)\n```", text, re.S).group(1))


def test_the_gallery_lists_every_example():
    assert (DOCS / "gallery.md").read_text(encoding="utf-8") == make.gallery()
    scripts = {path.stem for path in (DOCS / "examples").glob("*.py")} - {"make"}
    assert scripts == set(make.ORDER)
