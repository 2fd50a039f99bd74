"""``elastoidentify paraview stop``: ends the runs that are under way.

Before version 6.1 ParaView's window has no button for it: it waits for the filter, and takes no
clicks. So the filters look for a file whose time is after the beginning of their run.
"""

import os
import time
from pathlib import Path

EVERY = 0.2  # seconds between two looks at the file
_last = {"look": 0.0, "asked": 0.0}


def install():
    """Let the filters of this process ask."""
    from ..filters.base import stop_askers  # VTK, which the launcher does without

    if is_asked not in stop_askers:
        stop_askers.append(is_asked)


def is_asked(began: float) -> bool:
    """Tell whether someone has asked to stop since a run began (seconds of the clock)."""
    if abs(time.monotonic() - _last["look"]) > EVERY:
        _last["look"], _last["asked"] = time.monotonic(), _when_asked()
    return _last["asked"] >= began


def _when_asked() -> float:
    try:
        return stop_file().stat().st_mtime
    except OSError:
        return 0.0


def ask():
    """Ask all runs of this user on this machine to stop."""
    file = stop_file()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    os.utime(file)


def stop_file() -> Path:
    """Return the file whose time says when."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "elastoidentify" / "stop"
