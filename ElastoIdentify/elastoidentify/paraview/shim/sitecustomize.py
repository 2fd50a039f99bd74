"""What Python runs at start in every process of ParaView that ``elastoidentify paraview`` starts.

Two things have to be in place before any plugin is loaded:

- The package ``elastoidentify``. Only this one is made importable, not the folder it lies in: that
  may hold a ``vtk`` wheel, which crashes ParaView.
- For ParaView 5.11.0 under Python 3.11 and later, ``inspect.getargspec``: ParaView's helper for
  Python plugins imports it, Python 3.11 took it out, and ParaView mended that in 5.11.1.
"""

import importlib.util
import inspect
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
PACKAGE = os.path.dirname(os.path.dirname(HERE))


class PackageFinder:
    """Finds ``elastoidentify`` where this file belongs to, if nothing else has found it."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Return the specification of the package, None for any other name."""
        if name != "elastoidentify":
            return None
        return importlib.util.spec_from_file_location(
            name, os.path.join(PACKAGE, "__init__.py"), submodule_search_locations=[PACKAGE]
        )


def run_the_next_sitecustomize():
    """Run the one that this file hides, if there is any: Debian has one, and so may the user."""
    for folder in sys.path:
        path = os.path.join(os.path.abspath(folder), "sitecustomize.py")
        if os.path.dirname(path) != HERE and os.path.exists(path):
            spec = importlib.util.spec_from_file_location("hidden_sitecustomize", path)
            spec.loader.exec_module(importlib.util.module_from_spec(spec))
            return


sys.meta_path.append(PackageFinder)
if not hasattr(inspect, "getargspec"):
    inspect.getargspec = inspect.getfullargspec
run_the_next_sitecustomize()
