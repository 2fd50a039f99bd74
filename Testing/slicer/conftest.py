"""Slicer's core with stand-ins for the application, and the module under test."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
MODULE = HERE.parents[1] / "ElastoIdentify" / "ElastoIdentify.py"


def pytest_configure(config):
    """Make `import slicer` and `import ElastoIdentify` work as they do in the application."""
    sys.path[:0] = [str(HERE), str(MODULE.parent)]
    try:
        import slicer  # noqa: F401
    except ImportError:
        return  # the fixtures say so
    import os

    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    from standins import application, modules, widgets

    application.start()
    widgets.install()
    modules.install(str(MODULE))


@pytest.fixture(autouse=True)
def scene():
    """An empty scene."""
    try:
        import slicer
    except ImportError:
        from hosts import host_missing

        host_missing("slicer-core is not installed", "cmake --workflow --preset test")
    slicer.mrmlScene.Clear(0)
    yield slicer.mrmlScene
    slicer.mrmlScene.Clear(0)
