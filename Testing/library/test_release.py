"""One version, said in one place; how to cite it is valid; what changed is written down."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import elastoidentify
import pytest

ROOT = Path(__file__).resolve().parents[2]
CITATION = (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_citation_is_of_this_version():
    assert re.search(r"^version: (.+)$", CITATION, re.M).group(1) == elastoidentify.__version__


def test_the_changes_begin_with_this_version():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.search(r"^## (\S+) – (\d{4}-\d\d-\d\d)$", text, re.M)
    assert first.group(1) == elastoidentify.__version__
    assert f"date-released: {first.group(2)}" in CITATION


def test_no_other_file_says_the_version():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert 'dynamic = ["version"]' in project
    assert 'version = { attr = "elastoidentify.__version__" }' in project


def test_the_citation_is_valid():
    beside = Path(sys.executable).with_name("cffconvert")
    program = str(beside) if beside.exists() else shutil.which("cffconvert")
    if program is None:
        pytest.skip("needs cffconvert: pip install .[test]")
    done = subprocess.run([program, "--validate"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
