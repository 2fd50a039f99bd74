"""A filter's work without its pipeline: errors, Ctrl-C and progress come straight through."""

from ..progress import Progress
from .base import Filter


def apply(filter: Filter, *inputs, progress: Progress):
    """Return the output of `filter` for `inputs`, one per port (a list for a repeatable port).

    For command lines. In VTK's pipeline an exception has to be carried around it, and Ctrl-C in an
    observer is lost.
    """
    given = [
        one if isinstance(one, list) or not (port.repeatable or port.over_time) else [one]
        for port, one in zip(filter.ports, inputs, strict=True)
    ]
    return filter.execute(*given, progress=progress)
