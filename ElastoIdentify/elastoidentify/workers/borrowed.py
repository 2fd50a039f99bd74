"""Work that needs packages which this Python lacks, done in another Python that has them.

ParaView's own Python has numpy and scipy. What reads and writes images is in the Python whose path
the launcher hands over in ELASTOIDENTIFY_PYTHON: another process, maybe another version of Python.
"""

import importlib.util
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from ..progress import Progress
from .elastix_client import CLEAN_PATH, PYTHON_VARIABLE, worker_environment
from .job import BackgroundJob

PACKAGE = Path(__file__).resolve().parents[1]
_START = CLEAN_PATH + (
    "import importlib.util as u, runpy; package = sys.argv.pop(1); "
    "spec = u.spec_from_file_location('elastoidentify', package + '/__init__.py', "
    "submodule_search_locations=[package]); module = u.module_from_spec(spec); "
    "sys.modules['elastoidentify'] = module; spec.loader.exec_module(module); "
    "runpy.run_module('elastoidentify.workers.job', None, '__main__')"
)
"""Imports this very package, and not the folder that it lies in, whose packages may be of another
version of Python."""


def call(
    function: Callable,
    *arguments,
    packages: Sequence[str],
    progress: Progress | None = None,
    **keywords,
):
    """Call a function of a module, here or where its packages are.

    Parameters
    ----------
    function : callable
    *arguments, **keywords
        Of the call; what can be pickled.
    packages : sequence of str
        What the function imports beside numpy and scipy.
    progress : callable, optional
        Told that the work goes on; ends it by raising.

    Returns
    -------
    What the function returns.

    Raises
    ------
    What the function raises; here it may be an InputError on a package that is missing.
    """
    lender = os.environ.get(PYTHON_VARIABLE)
    if not lender or all(importlib.util.find_spec(package) for package in packages):
        return function(*arguments, **keywords)
    job = _BorrowedJob(_without_progress, function, arguments, keywords)
    return job.wait(progress)


def _without_progress(function, arguments, keywords, progress):
    return function(*arguments, **keywords)


class _BorrowedJob(BackgroundJob):
    """A background job in the Python of ELASTOIDENTIFY_PYTHON, with the packages of that one."""

    def _command(self):
        return [os.environ[PYTHON_VARIABLE], "-c", _START, str(PACKAGE)]

    def _environment(self):
        return worker_environment(host_packages=False)
