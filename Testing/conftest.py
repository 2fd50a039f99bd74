"""What the tests of every host share."""

import sys
from pathlib import Path

import pytest

TESTING = Path(__file__).resolve().parent
sys.path.insert(0, str(TESTING))  # for `import hosts`, in whatever environment the tests run


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of measured data beside the repository; skips where it is not there."""
    folder = TESTING.parents[1] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the measured data are not beside the repository ({folder.name} missing)")
    return folder


@pytest.fixture
def without_model_misfit(monkeypatch):
    """No look at where the model does not fit, where a test is about something else.

    It takes a quarter of a planar fit, and more than half of one in space.
    """
    from elastoidentify.inverse import regularized

    monkeypatch.setattr(regularized, "model_misfit", lambda *_: None)
    monkeypatch.setattr(regularized, "MOST_FACTORISED", 0)
