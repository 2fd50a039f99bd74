"""Makes ParaView's Python scripts raise what a filter of ElastoIdentify could not do.

In ParaView the filters run behind the proxies that a script holds, and a failure there only prints
a line: pvpython would go on with empty data and exit with 0. Loading the plugin therefore wraps
the two calls through which scripts run pipelines, so that they end in an exception.
"""

import functools
import os
import sys

from ..errors import Cancelled
from ..filters.base import failure_listeners

_failures: list[tuple[str, BaseException]] = []
_kinds: dict[str, type[BaseException]] = {}  # of what was raised already
_depth = 0


def install():
    """Wrap ParaView's calls in this process, once. Does nothing where no scripts run."""
    if _remember in failure_listeners:
        return
    failure_listeners.append(_remember)
    servermanager = sys.modules.get("paraview.servermanager")
    if servermanager is None:
        from paraview import servermanager
    source, proxy = servermanager.SourceProxy, servermanager.Proxy
    source.UpdatePipeline = _raising(source.UpdatePipeline)  # SaveData and Fetch come here too
    call = "_Proxy__ConvertArgumentsAndCall"  # everything else: rendering, writing pictures
    if hasattr(proxy, call):
        setattr(proxy, call, _raising(getattr(proxy, call)))


def _raising(method):
    """Return `method`, which then raises the first failure that happened during the call."""

    @functools.wraps(method)
    def wrapper(proxy, *args, **kwargs):
        global _depth
        if _depth == 0:
            _failures.clear()
        _depth += 1
        try:
            result = method(proxy, *args, **kwargs)
        finally:
            _depth -= 1
        if _failures:
            line, error = _failures.pop(0)
            _failures.clear()
            _kinds[line] = type(error)
            raise _told(type(error), line) from error
        line = _standing_failure(proxy) if method.__name__ == "UpdatePipeline" else ""
        if line:
            raise _told(_kinds.get(line, RuntimeError), line)
        return result

    return wrapper


def _told(kind: type[BaseException], line: str) -> BaseException:
    """Return an exception of this kind that says which filter failed."""
    try:
        return kind(line)
    except TypeError:  # an exception whose constructor wants more
        return RuntimeError(line)


def _remember(filter, error):
    if _depth and not isinstance(error, Cancelled):
        _failures.append((filter.GetLastError(), error))
    elif _is_batch_satellite():
        # The script runs on rank 0 only and cannot learn of this: end the whole run, non-zero.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(1)


def _is_batch_satellite() -> bool:
    from paraview.modules.vtkRemotingCore import vtkProcessModule

    return (
        vtkProcessModule.GetProcessType() == vtkProcessModule.PROCESS_BATCH
        and vtkProcessModule.GetProcessModule().GetPartitionId() > 0
    )


def _standing_failure(proxy) -> str:
    """Return the last failure of a filter or of one before it.

    It may have happened in a call before this one, for ParaView does not run a filter again that
    has not changed, or on a remote server.
    """
    for producer in _upstream(proxy.SMProxy):
        if producer.GetProperty("LastError"):
            producer.UpdatePropertyInformation()
            line = producer.GetProperty("LastError").GetElement(0)
            if line:
                return line
    return ""


def _upstream(proxy):
    """Yield server manager proxies that lead to `proxy`, the first in the chain first."""
    for i in range(proxy.GetNumberOfProducers()):
        yield from _upstream(proxy.GetProducerProxy(i))
    yield proxy
