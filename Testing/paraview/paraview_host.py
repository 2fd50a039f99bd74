"""Starting the real ParaView as the user does, with the launcher."""

import importlib.util
import os
import subprocess
import sys
import sysconfig
from contextlib import contextmanager
from pathlib import Path

import pytest
from hosts import program

HERE = Path(__file__).resolve().parent
PACKAGES = HERE.parents[1] / "ElastoIdentify"
LAUNCHER = [sys.executable, "-m", "elastoidentify.paraview.launch"]


def environment(**changes: str) -> dict[str, str]:
    """The environment to call the launcher in."""
    site = sysconfig.get_path("purelib")
    start = {**os.environ, "PYTHONPATH": str(PACKAGES), "OMP_NUM_THREADS": "1"}
    if not (Path(site) / "vtkmodules").exists():
        start.setdefault("ELASTOIDENTIFY_PARAVIEW_SITE", site)
    return {**start, "OPENBLAS_NUM_THREADS": "1", **changes}


def run(what: str, *arguments, before=(), timeout=300, cwd=None, **changes):
    """Run a program of ParaView by the launcher; stdout and stderr come as one text."""
    program({"gui": "paraview"}.get(what, what))
    return subprocess.run(
        [*before, *LAUNCHER, what, *map(str, arguments)],
        cwd=cwd,
        env=environment(**changes),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=timeout,
        check=False,
    )


@contextmanager
def virtual_display():
    """A display of its own number, as long as the context lasts; yields ":number"."""
    reading, writing = os.pipe()
    screen = ["-screen", "0", "1600x1000x24", "-nolisten", "tcp", "-noreset"]
    server = subprocess.Popen(
        [program("Xvfb"), "-displayfd", str(writing), *screen],
        pass_fds=[writing],
        stderr=subprocess.DEVNULL,
    )
    os.close(writing)
    try:
        with os.fdopen(reading) as answer:
            yield ":" + answer.readline().strip()
    finally:
        server.terminate()
        server.wait()


def mpirun(ranks: int):
    """The command that starts a program on several ranks, as root and on few cores too."""
    mpi = program("mpirun", "sudo apt-get install openmpi-bin")
    return [mpi, "--allow-run-as-root", "--oversubscribe", "-np", str(ranks)]


def python_with(*packages: str) -> str:
    """A Python that has packages which ParaView's need not have."""
    main = HERE.parents[1] / "build" / "environments" / "main" / "bin" / "python"
    here = all(map(importlib.util.find_spec, packages))
    python = os.environ.get("ELASTOIDENTIFY_PYTHON") or (sys.executable if here else str(main))
    found = [python, "-c", f"import {', '.join(packages)}"]
    if not os.path.exists(python) or subprocess.run(found, capture_output=True).returncode:
        pytest.skip(f"no Python with {', '.join(packages)}: set ELASTOIDENTIFY_PYTHON to one")
    return python
