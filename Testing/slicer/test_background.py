"""Background work behind a launcher, as Slicer's own interpreter is.

`PythonSlicer` is CTK's application launcher: it starts the real interpreter as a child, forwards
its standard input and output, and waits. Killing the launcher leaves the interpreter alone.
"""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")

from elastoidentify import pipeline  # noqa: E402
from elastoidentify.imaging.image import Image  # noqa: E402
from elastoidentify.study import Study  # noqa: E402
from elastoidentify.workers.job import BackgroundJob, State  # noqa: E402
from ElastoIdentifyLib import sample  # noqa: E402
from ElastoIdentifyLib.request import Request  # noqa: E402

from ElastoIdentify import ElastoIdentifyLogic  # noqa: E402

BUSY = """
import runpy, sys, time
from elastoidentify import pipeline
pipeline.make_mesh = lambda study, progress: (progress(0.5, "busy"), time.sleep(60))
del sys.argv[1:3]  # -c and the code
runpy.run_module("elastoidentify.workers.job", run_name="__main__")
"""


@pytest.fixture
def launched(tmp_path, monkeypatch):
    """Put a PythonSlicer on the path; returns the file in which it notes what it starts.

    A file busy.py beside it is what the interpreter runs, if there is one.
    """
    notes, busy, launcher = (tmp_path / name for name in ("pids", "busy.py", "PythonSlicer"))
    launcher.write_text(
        "#!/bin/sh\n"
        "exec 3<&0\n"
        f'[ -f "{busy}" ] && set -- "{busy}" "$@"\n'
        f'"{sys.executable}" "$@" <&3 &\n'  # a child, with the same input and output
        f'echo $! >> "{notes}"\n'
        "wait $!\n"
    )
    launcher.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    return notes


def running(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked up in /proc")
def test_cancel_ends_the_interpreter_behind_the_launcher_and_does_not_wait(launched):
    launched.with_name("busy.py").write_text(BUSY)
    inputs, _ = sample.add_exact_push()
    job = BackgroundJob(pipeline.make_mesh, Request(**inputs).study())
    until = time.monotonic() + 60
    while job.text != "busy" and time.monotonic() < until:
        assert job.poll() is State.RUNNING
        time.sleep(0.02)
    pid = int(launched.read_text())
    assert running(pid)
    before = time.monotonic()
    job.cancel()
    assert time.monotonic() - before < 8  # it used to wait 5 seconds each for output and errors
    assert job.state is State.CANCELLED
    until = time.monotonic() + 30
    while running(pid) and time.monotonic() < until:
        time.sleep(0.02)
    assert not running(pid)


def test_a_map_is_computed_behind_the_launcher(launched):
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    assert len(launched.read_text().split()) == 2  # mesh, then identification
    assert result.table.GetNumberOfRows() == 2


@pytest.mark.slow
def test_elastix_answers_behind_the_launcher(launched):
    """Its process is started by the process in the background; here it finds a shift of a pixel."""
    texture = 100 + 20 * np.random.default_rng(0).standard_normal((1, 48, 48)).astype(np.float32)
    study = Study(
        rest=Image(texture),
        pushed=[Image(np.roll(texture, 1, axis=2))],
        parameter_file="affine",
        backward=False,
        correlation=False,
    )
    points = np.array([[8.0, 8, 0], [40, 8, 0], [40, 40, 0], [8, 40, 0]])
    cells = np.array([[0, 1, 2], [0, 2, 3]])
    found = BackgroundJob(pipeline.measure, study, points, cells).wait()
    np.testing.assert_allclose(found.displacements[0], [[1, 0, 0]] * 4, atol=0.1)
