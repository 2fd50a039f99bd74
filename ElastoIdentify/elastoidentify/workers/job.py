"""Call a function in another process, so that a host stays responsive.

The host starts a :class:`BackgroundJob`, polls it from a timer, and may cancel it, which kills the
process. The process writes its progress to standard output, one line of JSON each, and its result
to a file, whole or not at all.
"""

import contextlib
import enum
import json
import os
import pickle
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path

from ..errors import Cancelled, InputError
from ..progress import Progress
from .elastix_client import CLEAN_PATH, candidate_interpreters, worker_environment
from .pickles import dump

JOB, RESULT = "job.pickle", "result.pickle"
_START = (
    CLEAN_PATH + "import runpy; runpy.run_module('elastoidentify.workers.job', None, '__main__')"
)


class State(enum.Enum):
    """Of a background job."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


class BackgroundJob:
    """A process that calls one function.

    Parameters
    ----------
    function : callable
        Of a module, such as :func:`elastoidentify.pipeline.run`; it also gets ``progress``.
    *arguments, **keywords
        Of the call; what can be pickled.

    Attributes
    ----------
    state : State
    fraction, text : float, str
        Progress, as of the last :meth:`poll`.
    error : Exception or None
        Why it failed; an InputError is for the user, anything else is a fault of the program.
    """

    def __init__(self, function: Callable, *arguments, **keywords):
        self.state, self.error = State.RUNNING, None
        self.fraction, self.text = 0.0, "starting"
        self._result = None
        self._lines, self._tail = queue.Queue(), deque(maxlen=30)
        self._folder = Path(tempfile.mkdtemp(prefix="elastoidentify-"))
        try:
            with open(self._folder / JOB, "wb") as file:
                dump((function, arguments, keywords), file)
            self._process = subprocess.Popen(
                [*self._command(), str(self._folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=self._environment(),
                text=True,
                encoding="utf-8",
                errors="replace",
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        self._readers = [
            threading.Thread(target=self._read, args=(self._process.stdout, self._lines.put)),
            threading.Thread(target=self._read, args=(self._process.stderr, self._tail.append)),
        ]
        for reader in self._readers:
            reader.daemon = True
            reader.start()

    def _command(self) -> list[str]:
        """Return the program, which gets the job's folder as its last argument."""
        return [_interpreter(), "-c", _START]

    def _environment(self) -> dict[str, str]:
        """Return the environment of the process: the host's packages and this one."""
        environment = worker_environment()
        package = str(Path(__file__).resolve().parents[2])
        paths = [package, environment.get("PYTHONPATH", "")]
        return {**environment, "PYTHONPATH": os.pathsep.join(filter(None, paths))}

    @staticmethod
    def _read(stream, take) -> None:
        with contextlib.suppress(OSError, ValueError):
            for line in stream:
                take(line.rstrip())

    def poll(self) -> State:
        """Take in what the process has said since the last time; never waits."""
        if self.state is not State.RUNNING:
            return self.state
        code = self._process.poll()
        if code is not None:
            for reader in self._readers:
                reader.join(timeout=5)
        with contextlib.suppress(queue.Empty):
            while True:
                self._take(self._lines.get_nowait())
        if code is not None:
            self._finish(code)
        return self.state

    def _take(self, line: str) -> None:
        try:
            message = json.loads(line)
            self.fraction, self.text = float(message["fraction"]), str(message["text"])
        except (ValueError, TypeError, KeyError):
            self._tail.append(line)  # a library printed something

    def _finish(self, code: int) -> None:
        try:
            with open(self._folder / RESULT, "rb") as file:
                self._result, self.error = pickle.load(file)
        except FileNotFoundError:
            words = next((line for line in reversed(self._tail) if line.strip()), "it said nothing")
            self.error = RuntimeError(f"the background process ended with code {code}: {words}")
        self.state = State.FAILED if self.error else State.DONE
        self._clean()

    def cancel(self) -> None:
        """Kill the process and forget the job. Nothing stays behind."""
        if self.state is not State.RUNNING:
            return
        self.state, self.error = State.CANCELLED, Cancelled("cancelled")
        # Slicer's interpreter is behind a launcher, which alone would be killed: closing the input
        # ends the interpreter too, and a registration under way with it.
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        self._process.kill()
        self._process.wait()
        self._clean(patience=0.5)

    def _clean(self, patience: float = 5.0) -> None:
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        streams = (self._process.stdout, self._process.stderr)
        for reader, stream in zip(self._readers, streams, strict=True):
            reader.join(timeout=patience)
            if not reader.is_alive():  # else it ends with the interpreter, which is still starting
                with contextlib.suppress(OSError):
                    stream.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def result(self):
        """Return what the function returned, or raise what it raised."""
        if self.state is State.RUNNING:
            raise RuntimeError("the job is still running")
        if self.error is not None:
            raise self.error
        return self._result

    def wait(self, progress: Progress | None = None, interval: float = 0.05):
        """Wait for the end and return the result; a progress callable may cancel by raising."""
        try:
            while self.poll() is State.RUNNING:
                if progress:
                    progress(self.fraction, self.text)
                time.sleep(interval)
        except BaseException:
            self.cancel()
            raise
        return self.result()


def _interpreter() -> str:
    """Return a Python interpreter: Slicer's own where the host is Slicer."""
    found = shutil.which("PythonSlicer") or next(iter(candidate_interpreters()), None)
    if found is None:
        raise InputError("found no Python interpreter to work in the background")
    return found


# ---- the other end


def main(folder: Path) -> int:
    """Do the job in `folder`; called in the process."""
    threading.Thread(target=_end_with_host, daemon=True).start()
    result, error = None, None
    try:
        with open(folder / JOB, "rb") as file:
            function, arguments, keywords = pickle.load(file)
        result = function(*arguments, **keywords, progress=_report())
    except InputError as problem:
        error = problem
    except Exception as fault:
        traceback.print_exc()
        error = RuntimeError(f"{type(fault).__name__}: {fault}")
    part = folder / (RESULT + ".part")
    with open(part, "wb") as file:
        dump((result, error), file)
    os.replace(part, folder / RESULT)
    return 0


def _report(interval: float = 0.05) -> Progress:
    """Return a progress callable that prints at most one line per `interval` seconds."""
    last = 0.0

    def report(fraction: float, text: str) -> None:
        nonlocal last
        if time.monotonic() - last >= interval:
            last = time.monotonic()
            print(json.dumps({"fraction": fraction, "text": text}), flush=True)

    return report


def _end_with_host() -> None:
    """End this process when the host has gone, which closes our standard input."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
