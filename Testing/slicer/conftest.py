"""Slicer's core with stand-ins for the application, and the module under test."""

import os
import shlex
import sys
from pathlib import Path

import pytest
from warm import Warm

HERE = Path(__file__).resolve().parent
MODULE = HERE.parents[1] / "ElastoIdentify" / "ElastoIdentify.py"


def import_slicer():
    """Import Slicer's core, which takes every folder named slicer on the path for a part of it."""
    path = sys.path[:]
    sys.path[:] = [entry for entry in path if Path(entry).resolve() != HERE.parent]
    try:
        import slicer
    finally:
        sys.path[:] = path
    return slicer


def pytest_configure(config):
    """Make `import slicer` and `import ElastoIdentify` work as they do in the application."""
    try:
        import_slicer()
    except ImportError:
        return  # the fixture below says so
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    sys.path[:0] = [str(HERE), str(MODULE.parent)]
    from standins import application, modules, sources, widgets

    application.start()
    widgets.install()
    (sources if sources.folder() else modules).install(str(MODULE))


@pytest.fixture(scope="session")
def python_slicer():
    """A folder with a PythonSlicer, the launcher of an interpreter that is warm; see `warm`.

    As with Slicer's own, the interpreter outlives its launcher, until its input ends.
    """
    from elastoidentify.workers.elastix_client import worker_environment

    paths = [str(MODULE.parent), worker_environment()["PYTHONPATH"]]
    environment = {**worker_environment(), "PYTHONPATH": os.pathsep.join(paths)}
    warm = Warm([sys.executable], ["elastoidentify.pipeline"], environment, "leave")
    launcher = warm.folder / "PythonSlicer"
    launcher.write_text(f'#!/bin/sh\nexec {shlex.join(warm.launcher)} "$@"\n')
    launcher.chmod(0o755)
    yield warm.folder
    warm.close()


@pytest.fixture
def warm(python_slicer, monkeypatch):
    """Runs in the background start at once. Those of test_background start as Slicer's do."""
    monkeypatch.setenv("PATH", str(python_slicer), prepend=os.pathsep)


@pytest.fixture(autouse=True)
def scene():
    """An empty scene."""
    if "slicer" not in sys.modules:
        from hosts import host_missing

        host_missing("slicer-core is not installed", "cmake --workflow --preset test")
    import slicer

    slicer.mrmlScene.Clear(0)
    yield slicer.mrmlScene
    slicer.mrmlScene.Clear(0)
