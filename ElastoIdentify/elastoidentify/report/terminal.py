"""Progress and figures for people at a terminal."""

import math
import sys
import time
from typing import TextIO

QUIET_SECONDS = 10.0  # between two lines of progress where the output is a file
NOTICED_SECONDS = 2.0  # what takes less needs no line of its own


class TerminalProgress:
    """Progress on a terminal as one line that is rewritten; in a log, as a line now and then.

    Parameters
    ----------
    title : str
        What is being done.
    stream : file, optional
        Standard error by default.
    """

    def __init__(self, title: str, stream: TextIO | None = None):
        self.title, self.stream = title, stream or sys.stderr
        self.rewrite = self.stream.isatty()
        self.start = self.last = time.monotonic()
        self.width, self.shown = 0, ""

    def __call__(self, fraction: float, text: str):
        """Report; the :data:`~elastoidentify.progress.Progress` handed to the library."""
        now = time.monotonic()
        if now - self.last < (0.1 if self.rewrite else QUIET_SECONDS):
            return
        self.last = now
        line = f"{self.title}: {100 * min(max(fraction, 0.0), 1.0):3.0f} % {text}"
        if self.rewrite:
            line = line[:100]
            self._write("\r" + line.ljust(self.width))
            self.width = len(line)
        elif line != self.shown:
            self._write(line + "\n")
        self.shown = line

    def __enter__(self):
        return self

    def __exit__(self, kind, error, traceback):
        if self.rewrite and self.width:
            self._write("\r" + " " * self.width + "\r")
        duration = time.monotonic() - self.start
        if kind is None and duration > NOTICED_SECONDS:
            self._write(f"{self.title}: {seconds(duration)}\n")

    def _write(self, text: str):
        self.stream.write(text)
        self.stream.flush()


def seconds(duration: float) -> str:
    """Return a duration for people: ``4.2 s``, ``3 min 10 s``."""
    if duration < 60:
        return f"{duration:.1f} s"
    minutes, rest = divmod(round(duration), 60)
    return f"{minutes} min {rest} s"


def peak_memory() -> int | None:
    """Return the largest memory of this process plus that of its largest finished child, bytes.

    None where the system does not tell (Windows).
    """
    try:
        import resource
    except ImportError:
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    users = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return unit * sum(resource.getrusage(user).ru_maxrss for user in users)


def figure(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, ``-`` where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    if value != 0 and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0) if value else 0
    return f"{value:.{decimals}f}"


def table(header: list[str], rows: list[list[str]]) -> str:
    """Return lines of columns, the first flush left, the others flush right."""
    cells = [header, *rows]
    widths = [max(len(row[column]) for row in cells) for column in range(len(header))]
    lines = []
    for row in cells:
        first = row[0].ljust(widths[0])
        rest = [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join([first, *rest]).rstrip())
    return "\n".join(lines)
