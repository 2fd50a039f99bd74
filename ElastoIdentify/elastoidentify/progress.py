"""Progress and cancel, in one callable.

Every function that can take longer than two seconds has an argument ``progress``: ``None`` or a
callable ``progress(fraction, text)`` with ``fraction`` from 0 to 1 and a short text for people. To
cancel, the callable raises :class:`~elastoidentify.errors.Cancelled`; the function lets it through
and leaves nothing half done behind.
"""

from collections.abc import Callable

Progress = Callable[[float, str], None]


def silent(fraction: float, text: str) -> None:
    """Report to nobody: what ``progress=None`` stands for."""


def part(progress: Progress | None, start: float, stop: float) -> Progress:
    """Return a progress callable that reports 0…1 of a sub-task as start…stop of the whole."""
    if progress is None:
        return silent
    return lambda fraction, text: progress(start + (stop - start) * fraction, text)
