"""Several registrations at once, each with an elastix process of its own.

elastix itself runs on one thread here: with more it crashes on metrics of several terms. Trials do
not need each other, so they share the cores instead.
"""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager

from ...errors import Cancelled
from ...progress import Progress
from ...workers.elastix_client import ElastixProcess

MOST_ENGINES = 4  # each takes about 0.9 GB
_LOOK = 0.1  # seconds between two looks at the progress callback, which may cancel


def engines_for(dimension: int, trials: int, workers: int | None) -> int:
    """How many elastix processes to use: as asked for, else one for slices, one per core else.

    A slice is registered in seconds, by which a second process would hardly have paid.
    """
    if workers is not None:
        return max(1, min(workers, 2 * trials))
    if dimension == 2:
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(cores or 1, trials, MOST_ENGINES))


class Engines:
    """elastix processes that are started when they are needed, and closed together.

    Parameters
    ----------
    first : ElastixProcess, optional
        One that is there already; it is left open.
    """

    def __init__(self, first: ElastixProcess | None = None):
        self._free = [first] if first else []
        self._own = ExitStack()
        self._lock = threading.Lock()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._own.close()

    @contextmanager
    def one(self, progress: Progress):
        """Lend a process; start it if none is free."""
        with self._lock:
            engine = self._free.pop() if self._free else None
        if engine is None:
            engine = ElastixProcess(progress)
            with self._lock:
                self._own.callback(engine.close)
        yield engine
        with self._lock:
            self._free.append(engine)


def run_together(tasks: Sequence[Callable], at_once: int, progress: Progress) -> list:
    """Run ``task(progress)`` for every task, so many at once, in the order given.

    Progress is told from the calling thread. What it raises, and the first error of a task, stops
    all of them: their own progress raises ``Cancelled``.

    Returns
    -------
    list
        What the tasks returned.
    """
    stop = threading.Event()
    state = [(0.0, "")] * len(tasks)

    def reporter(number):
        def tell(fraction, text):
            if stop.is_set():
                raise Cancelled
            state[number] = (max(fraction, state[number][0]), text)

        return tell

    with ThreadPoolExecutor(at_once) as pool:
        futures = [pool.submit(task, reporter(number)) for number, task in enumerate(tasks)]
        try:
            waiting = futures
            while waiting:
                done, waiting = wait(futures, timeout=_LOOK, return_when=FIRST_EXCEPTION)
                for future in done:
                    future.result()
                fractions = [1.0 if f.done() else s[0] for f, s in zip(futures, state, strict=True)]
                active = [s[1] for f, s in zip(futures, state, strict=True) if f.running() and s[1]]
                progress(sum(fractions) / len(fractions), "; ".join(active) or "starting elastix")
        except BaseException:
            stop.set()
            for future in futures:
                future.cancel()
            raise
    return [future.result() for future in futures]
