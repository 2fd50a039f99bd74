"""Nothing in the working folder is run, and what is missing is installed from the clone."""

import os
import subprocess
import sys

import numpy as np
import pytest
from elastoidentify.imaging.image import Image
from elastoidentify.pipeline import make_mesh
from elastoidentify.study import Study
from elastoidentify.workers import elastix_client
from elastoidentify.workers.job import BackgroundJob, State

NAMES = (
    *("csv", "email", "zipfile", "textwrap", "json", "pickle", "tempfile", "numpy", "itk"),
    *("SimpleITK", "elastoidentify", "runpy", "pathlib", "threading", "struct", "random"),
)


@pytest.fixture
def trapped(tmp_path, monkeypatch):
    """Work in a folder full of modules that note when they are run; returns that note."""
    note = tmp_path / "was run"
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(
            f"open({str(note)!r}, 'a').write({name + ' '!r})\n1/0\n"
        )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", str(tmp_path), *sys.path])
    return note


def test_the_search_for_an_interpreter_runs_nothing_there(trapped, monkeypatch):
    monkeypatch.delenv(elastix_client.PYTHON_VARIABLE, raising=False)
    found = elastix_client._can_run(sys.executable)
    assert not trapped.exists()
    if elastix_client.os.environ.get("ELASTOIDENTIFY_REQUIRE_HOSTS"):
        assert found


def test_the_registration_worker_runs_nothing_there(trapped, monkeypatch):
    monkeypatch.delenv(elastix_client.PYTHON_VARIABLE, raising=False)
    environment = elastix_client.worker_environment()
    code = "import csv, json, tempfile, numpy, sys; print(sys.path)"
    done = subprocess.run(
        [sys.executable, "-c", elastix_client.CLEAN_PATH + code],
        env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert str(trapped.parent) not in done.stdout and not trapped.exists()
    guard = subprocess.run(
        [sys.executable, elastix_client._PROGRAM], env={**environment, "PATH": os.defpath},
        stdin=subprocess.DEVNULL, capture_output=True, timeout=120,
    )  # fmt: skip
    assert guard.returncode in (0, 1, 128 + 9) and not trapped.exists()


def test_the_background_process_runs_nothing_there(trapped):
    labels = np.zeros((1, 30, 30), np.uint8)
    labels[:, 5:25, 5:25] = 1
    job = BackgroundJob(make_mesh, Study(segmentation=Image(labels), edge_length=5.0))
    mesh = job.wait()
    assert job.state is State.DONE and len(mesh.cells) > 10
    assert not trapped.exists()


def test_hints_name_an_installation_that_exists():
    assert 'pip install ".[registration]"' in elastix_client.INSTALL_HINT
