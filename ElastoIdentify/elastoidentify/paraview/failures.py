"""Makes ParaView's Python scripts raise what a filter of ElastoIdentify could not do.

In ParaView the filters run behind the proxies that a script holds, and a failure there only prints
a line: pvpython would go on with empty data and exit with 0. Loading the plugin therefore wraps
the two calls through which scripts run pipelines, so that they end in an exception.
"""

import functools
import importlib.abc
import importlib.util
import os
import sys
import warnings
import weakref
from dataclasses import dataclass

from ..errors import Cancelled
from ..filters.base import failure_listeners, warning_listeners

SERVERMANAGER = "paraview.servermanager"

_failures: list["_Failure"] = []
_warnings: list[str] = []
_kinds: dict[str, type[BaseException]] = {}  # of what was raised already
_depth = 0


def install():
    """Wrap ParaView's calls in this process, once: now, or when a script first imports them.

    Not earlier: the application connects to its server after it has loaded the plugins, and
    ``paraview.servermanager`` would make a second connection if it were imported before.
    """
    if _remember in failure_listeners:
        return
    failure_listeners.append(_remember)
    warning_listeners.append(_remember_warnings)
    servermanager = sys.modules.get(SERVERMANAGER)
    if servermanager is None:
        sys.meta_path.insert(0, _AfterImport())
    else:
        _wrap(servermanager)


class _AfterImport(importlib.abc.MetaPathFinder):
    """Waits for the import of ``paraview.servermanager`` and wraps its calls right after."""

    def find_spec(self, name, path=None, target=None):
        if name != SERVERMANAGER:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        execute = spec.loader.exec_module

        def execute_and_wrap(module):
            execute(module)
            _wrap(module)

        spec.loader.exec_module = execute_and_wrap
        return spec


def _wrap(servermanager):
    source, proxy = servermanager.SourceProxy, servermanager.Proxy
    source.UpdatePipeline = _raising(source.UpdatePipeline)  # SaveData and Fetch come here too
    call = "_Proxy__ConvertArgumentsAndCall"  # everything else: rendering, writing pictures
    if hasattr(proxy, call):
        setattr(proxy, call, _raising(getattr(proxy, call)))


def _raising(method):
    """Return `method`, which then raises the first failure since the last such call."""

    @functools.wraps(method)
    def wrapper(proxy, *args, **kwargs):
        global _depth
        _depth += 1
        try:
            result = method(proxy, *args, **kwargs)
        finally:
            _depth -= 1
            failures = [failure for failure in _failures if failure.stands()]
            _failures.clear()
        while _warnings and not _depth:
            warnings.warn(_warnings.pop(0), stacklevel=2)
        if failures:
            _kinds[failures[0].line] = type(failures[0].error)
            raise _told(type(failures[0].error), failures[0].line) from failures[0].error
        line = _standing_failure(proxy) if method.__name__ == "UpdatePipeline" else ""
        if line:
            raise _told(_kinds.get(line, RuntimeError), line)
        return result

    return wrapper


@dataclass
class _Failure:
    filter: weakref.ref
    line: str
    error: BaseException

    def stands(self) -> bool:
        """Tell whether the filter has not run well since."""
        return self.filter() is not None and self.filter().GetLastError() == self.line


def _told(kind: type[BaseException], line: str) -> BaseException:
    """Return an exception of this kind that says which filter failed."""
    try:
        return kind(line)
    except TypeError:  # an exception whose constructor wants more
        return RuntimeError(line)


def _remember(filter, error):
    if isinstance(error, Cancelled):
        return
    if _is_batch_satellite():
        # The script runs on rank 0 only and cannot learn of this: end the whole run, non-zero.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(1)
    if _depth or not _in_application():  # what the user does in the window is no script's failure
        _failures.append(_Failure(weakref.ref(filter), filter.GetLastError(), error))


def _remember_warnings(filter, lines):
    if _depth or not _in_application():
        _warnings.extend(lines)


def _in_application() -> bool:
    return bool(getattr(sys.modules.get("paraview"), "fromGUI", False))


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
