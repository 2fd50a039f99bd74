"""What the tests in the real ParaView share."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))  # for `import paraview_host`

from paraview_host import run, virtual_display  # noqa: E402


@pytest.fixture
def script():
    """Run a script of the folder `scripts` and demand that it gets to its end."""

    def run_script(name: str, *arguments, what="pvpython", **options):
        done = run(what, HERE / "scripts" / name, *arguments, **options)
        assert done.returncode == 0, done.stdout
        assert "done" in done.stdout.splitlines(), done.stdout
        return done.stdout

    return run_script


@pytest.fixture(scope="session")
def display():
    """The name of a virtual display."""
    with virtual_display() as name:
        yield name
