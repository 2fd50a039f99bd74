"""What the tests in the real ParaView share."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))  # for `import paraview_host`

from hosts import program  # noqa: E402
from paraview_host import LAUNCHER, environment, run, virtual_display  # noqa: E402
from warm import Warm  # noqa: E402


@pytest.fixture(scope="session")
def pvpython():
    """Run a script as `run("pvpython", …)` does, but in a fork of a pvpython that is warm.

    What it starts with, the plugin too, is that of the launcher; MPI would hang at a fork's end.
    """
    program("pvpython")
    warm = Warm(
        [*LAUNCHER, "pvpython", "--no-mpi"],
        ["paraview.simple", "elastoidentify.pipeline", "elastoidentify.vtk_io.convert"],
        environment(),
    )
    yield warm.run
    warm.close()


@pytest.fixture
def script(request):
    """Run a script of the folder `scripts` and demand that it gets to its end.

    what : "pvbatch", or "pvpython" for one that starts anew, by the launcher.
    """

    def run_script(name: str, *arguments, what=None, **options):
        words = (HERE / "scripts" / name, *arguments)
        if what is None:
            done = request.getfixturevalue("pvpython")(*words, **options)
        else:
            done = run(what, *words, **options)
        assert done.returncode == 0, done.stdout
        assert "done" in done.stdout.splitlines(), done.stdout
        return done.stdout

    return run_script


@pytest.fixture(scope="session")
def blocks(pvpython, tmp_path_factory):
    """A file of four cases, a block each."""
    file = tmp_path_factory.mktemp("blocks") / "cases.vtm"
    done = pvpython(HERE / "scripts" / "make_blocks.py", file)
    assert done.returncode == 0, done.stdout
    return file


@pytest.fixture(scope="session")
def display():
    """The name of a virtual display."""
    with virtual_display() as name:
        yield name
