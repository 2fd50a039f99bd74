"""The host's end of the registration worker: find an interpreter, start it, talk to it, kill it.

See :mod:`.elastix_engine` for the program at the other end and the reason for a process.
"""

import contextlib
import os
import queue
import re
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..installation import hint
from ..progress import Progress, silent
from . import elastix_engine

INSTALL_HINT = hint("registration")
PYTHON_VARIABLE = "ELASTOIDENTIFY_PYTHON"
CLEAN_PATH = "import sys; sys.path[:] = [p for p in sys.path if p not in ('', '.')]; "
"""Code that takes the working folder out of the places where modules are looked for."""
_PROGRAM = Path(elastix_engine.__file__).resolve()
_HEARTBEAT = 0.1  # seconds between two looks at the progress callback, which may cancel


def worker_environment(host_packages: bool = True) -> dict[str, str]:
    """The environment of a Python that works for this one.

    The working folder is not among the places where it looks for modules: a ``csv.py`` that lies
    beside the user's images is data, not ours to run. (PYTHONSAFEPATH is heeded from Python 3.11
    on; :data:`CLEAN_PATH` does the same for a ``-c`` of older ones.)

    Parameters
    ----------
    host_packages : bool
        It finds the packages of this process, which needs the same version of Python. False: it
        finds its own only, whatever the host has set (Slicer and ParaView set PYTHONPATH and
        PYTHONHOME to their own).
    """
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    environment["PYTHONSAFEPATH"] = "1"
    if host_packages:
        own = str(_PROGRAM.parent.parent.parent)  # the package itself is not needed there
        paths = [path for path in sys.path if os.path.isabs(path) and os.path.isdir(path)]
        paths = [path for path in paths if path != own and not _is_working_folder(path)]
        environment["PYTHONPATH"] = os.pathsep.join(paths)
    else:
        for name in ("PYTHONPATH", "PYTHONHOME"):
            environment.pop(name, None)
    return environment


def _is_working_folder(path: str) -> bool:
    try:
        return os.path.samefile(path, os.getcwd())
    except OSError:
        return False


def candidate_interpreters() -> list[str]:
    """Interpreters that may run the worker, most likely first.

    ``sys.executable`` is a plain Python in a plain Python and in Slicer's PythonSlicer; in
    pvpython, ParaView and the Slicer application it is the application (or empty), and the
    interpreter has to be found beside ``sys.prefix``.
    """
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    names = ["PythonSlicer", version, "python3", "python"]
    folders = []
    if sys.executable:
        folders.append(Path(sys.executable).parent)
    for prefix in (sys.prefix, sys.base_prefix, sys.exec_prefix):
        folders += [Path(prefix) / "bin", Path(prefix), Path(prefix).parent / "bin"]
    found = []
    if sys.executable and re.match(r"(python|PythonSlicer)", Path(sys.executable).name, re.I):
        found.append(sys.executable)
    suffix = ".exe" if os.name == "nt" else ""
    found += [str(folder / (name + suffix)) for folder in folders for name in names]
    return [path for path in dict.fromkeys(found) if os.access(path, os.X_OK)]


def _can_run(python: str) -> bool:
    """True if `python` is this version of Python and finds itk-elastix and numpy.

    Looks for the packages without importing them, which takes a tenth of a second, not fifteen.
    """
    code = CLEAN_PATH + (
        "import importlib.util as u, importlib.metadata as m; m.version('itk-elastix'); "
        "sys.exit(not (u.find_spec('itk') and u.find_spec('numpy') "
        f"and sys.version_info[:2] == {tuple(sys.version_info[:2])}))"
    )
    try:
        done = subprocess.run(
            [python, "-c", code],
            env=worker_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=60,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def find_interpreter() -> str:
    """Return a Python interpreter that can run elastix.

    The environment variable ``ELASTOIDENTIFY_PYTHON`` overrides the search; that interpreter may
    be of any version and environment with itk-elastix and numpy.

    Raises
    ------
    InputError
        None found, with the way to install itk-elastix.
    """
    chosen = os.environ.get(PYTHON_VARIABLE)
    if chosen:
        if not os.access(chosen, os.X_OK):
            raise InputError(
                f"{PYTHON_VARIABLE} is {chosen!r}, which is not a program: "
                "set it to a Python interpreter that has itk-elastix, or unset it"
            )
        return chosen
    candidates = candidate_interpreters()
    for python in candidates:
        if _can_run(python):
            return python
    if not candidates:
        raise InputError(
            f"found no Python interpreter to run the registration with: set {PYTHON_VARIABLE} to "
            "one that has itk-elastix"
        )
    raise InputError(
        f"the registration needs itk-elastix, which {candidates[0]} does not find: {INSTALL_HINT}, "
        f"or set {PYTHON_VARIABLE} to a Python that has it"
    )


class WorkerGone(RuntimeError):
    """The worker ended by itself: elastix crashed, or the machine ran out of memory."""


class LogProgress:
    """Read elastix's log: which resolution of which parameter map, which iteration.

    Parameters
    ----------
    iterations : list of list of int
        For each parameter map, the number of iterations of each resolution.
    """

    def __init__(self, iterations: list[list[int]]):
        self._steps = [count for one_map in iterations for count in one_map]
        self._total = max(sum(self._steps), 1)
        self._resolution = -1
        self.fraction = 0.0
        self.text = "reading the images"

    def read(self, line: str) -> None:
        """Take one line of the log into account."""
        if line.startswith("Resolution:"):
            self._resolution += 1
            self._tell(0)
        elif self._resolution >= 0 and (match := re.match(r"(\d+)\t", line)):
            self._tell(int(match.group(1)) + 1)

    def _tell(self, iteration: int) -> None:
        now = min(self._resolution, len(self._steps) - 1)
        done = sum(self._steps[:now]) + min(iteration, self._steps[now])
        self.fraction = done / self._total
        self.text = f"resolution {now + 1} of {len(self._steps)}, iteration {iteration}"


class ElastixProcess:
    """A warm worker. Use as a context manager; leaves no process and no file behind.

    Parameters
    ----------
    progress : callable, optional
        Told about the start (loading elastix takes some seconds the first time).

    Raises
    ------
    InputError
        No interpreter with itk-elastix was found, or elastix does not start there.
    """

    def __init__(self, progress: Progress | None = None):
        self._process = None
        self._tail = deque(maxlen=40)
        self._messages = queue.Queue()
        python = find_interpreter()
        chosen = bool(os.environ.get(PYTHON_VARIABLE))  # maybe another version of Python
        self._process = subprocess.Popen(
            [python, str(_PROGRAM)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=worker_environment(host_packages=not chosen),
            start_new_session=True,  # Ctrl-C is for the host, which then closes the worker
        )
        self._readers = [
            threading.Thread(target=read, daemon=True)
            for read in (self._read_answers, self._read_log)
        ]
        for reader in self._readers:
            reader.start()
        try:
            self._wait(progress or silent, lambda: (0.0, "starting elastix"))
        except WorkerGone as gone:
            self.close()
            raise InputError(
                f"the registration does not start with {python}: {gone}; {INSTALL_HINT}"
            ) from None
        except BaseException:
            self.close()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _read_answers(self) -> None:
        try:
            while (message := elastix_engine.receive(self._process.stdout)) is not None:
                self._messages.put(message)
        except (OSError, ValueError):
            pass
        self._messages.put(None)  # the worker is gone

    def _read_log(self) -> None:
        try:
            for line in self._process.stderr:
                text = line.decode(errors="replace").rstrip()
                self._tail.append(text)
                self._log.read(text)
        except (OSError, ValueError):
            pass

    _log = LogProgress([])

    def _wait(self, progress: Progress, state) -> dict[str, np.ndarray]:
        """Wait for an answer, telling `progress` the `state` (fraction, text) meanwhile."""
        while True:
            try:
                message = self._messages.get(timeout=_HEARTBEAT)
            except queue.Empty:
                progress(*state())
                continue
            if message is None:
                self._readers[1].join(timeout=5)  # its last words may still be under way
                raise WorkerGone(f"the registration worker stopped: {self._last_words()}")
            header, arrays = message
            if "error" in header:
                raise InputError(f"elastix could not register the images: {self._last_words()}")
            return arrays

    def _last_words(self) -> str:
        """The last telling line of the log: a Python error, or elastix's."""
        lines = [line.strip() for line in self._tail if line.strip()]
        telling = [line for line in lines if re.search(r"error|exception|itk::", line, re.I)]
        described = [line for line in lines if re.match(r"Description:|itk::ERROR", line)]
        for found in (described, telling, lines):
            if found:
                return found[-1]
        return "it said nothing"

    def register(
        self,
        fixed: np.ndarray,
        moving: np.ndarray,
        spacing: np.ndarray,
        maps: list[dict[str, list[str]]],
        points: np.ndarray,
        *,
        mask: np.ndarray | None = None,
        warp: bool = True,
        progress: Progress | None = None,
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Register two images of the same grid; the first voxel centre is the origin.

        Parameters
        ----------
        fixed, moving : float32 (nj, ni) or (nk, nj, ni)
        spacing : (d,)
            Voxel size along i, j(, k), in the unit of `points`.
        maps : list of {name: [values]}
            elastix parameter maps, applied one after the other.
        points : (n, d)
            Ordered i, j(, k).
        mask : uint8, shape of `fixed`, optional
            Samples are drawn where it is not 0.
        warp : bool
            Whether the warped image is wanted.

        Returns
        -------
        mapped : (n, d)
            T(points), the exact transform: where each point of `fixed` is in `moving`.
        warped : float32, shape of `fixed`, or None
            `moving` resampled at T(voxel centres).

        Raises
        ------
        Cancelled
            By the progress callback; the worker is killed.
        InputError
            elastix refused.
        WorkerGone
            elastix crashed.
        """
        self._log = LogProgress([_iterations(one_map) for one_map in maps])
        arrays = {
            "fixed": np.ascontiguousarray(fixed, np.float32),
            "moving": np.ascontiguousarray(moving, np.float32),
            "mask": None if mask is None else np.ascontiguousarray(mask, np.uint8),
            "points": np.ascontiguousarray(points, np.float64),
        }
        header = {"maps": maps, "spacing": [float(step) for step in spacing], "warp": warp}
        try:
            elastix_engine.send(self._process.stdin, header, arrays)
            answer = self._wait(progress or silent, lambda: (self._log.fraction, self._log.text))
        except InputError:
            raise
        except BaseException:  # cancelled, or the worker is gone: never to be used again
            self.close()
            raise
        return answer["mapped"], answer.get("warped")

    def close(self) -> None:
        """End the worker, whatever it does at the moment. The guard removes its directory."""
        if self._process is None:
            return
        process, self._process = self._process, None
        with contextlib.suppress(OSError):
            process.stdin.close()  # the guard kills the engine when its input ends
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
        process.stderr.close()


def _iterations(parameter_map: dict[str, list[str]]) -> list[int]:
    """Number of iterations of each resolution of a parameter map."""
    resolutions = int(parameter_map.get("NumberOfResolutions", ["3"])[0])
    counts = [int(float(n)) for n in parameter_map.get("MaximumNumberOfIterations", ["500"])]
    return [counts[min(level, len(counts) - 1)] for level in range(resolutions)]
