"""Starting the real ParaView as the user does, with the launcher."""

import importlib.util
import os
import socket
import subprocess
import sys
import sysconfig
import time
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
        end(server)


@contextmanager
def listening_server(log: Path):
    """A pvserver as long as the context lasts, which prints into `log`; yields its port.

    Between the choice of a free port and its use another program may take it: then the server ends,
    and the next port is tried.
    """
    program("pvserver")
    for _ in range(3):
        with socket.socket() as free:
            free.bind(("localhost", 0))
            port = free.getsockname()[1]
        with log.open("w") as output:
            server = subprocess.Popen(
                [*LAUNCHER, "pvserver", f"--server-port={port}"],
                env=environment(),
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        try:
            if within(60, lambda: "Accepting connection" in log.read_text(), server):
                yield port
                return
        finally:
            end(server)
    pytest.fail(f"no pvserver within three attempts: {log.read_text()}")


def within(seconds: float, happened, process: subprocess.Popen) -> bool:
    """Wait until something has happened; False where the process or the time ends before."""
    latest = time.monotonic() + seconds
    while not happened():
        if process.poll() is not None or time.monotonic() > latest:
            return False
        time.sleep(0.1)
    return True


def end(process: subprocess.Popen, patience=20.0):
    """Ask a process to end, and make it where it does not."""
    process.terminate()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


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
