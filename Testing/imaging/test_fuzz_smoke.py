"""A share of the fuzzer: damaged files are read or refused, and nothing ends with them."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("SimpleITK")
pytest.importorskip("pydicom")
pytest.importorskip("vtkmodules")

FUZZ = Path(__file__).resolve().parents[1] / "fuzz"


def test_two_hundred_damaged_files_are_read_or_refused(monkeypatch):
    monkeypatch.syspath_prepend(str(FUZZ))
    import run

    assert run.fuzz(200, seed=7) == []
    sys.modules.pop("run")
