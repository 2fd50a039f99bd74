"""The methods: one module each, found by its name.

A method is a module with TITLE, SOURCE and ``estimate(case) -> Estimate``; optionally PYTHON, the
name of an environment variable that holds the interpreter of its own environment. It runs in a
process of its own; what this environment may lack it imports within `estimate`.
"""

import importlib
import pkgutil


def load(name: str):
    """Return the module of a method."""
    return importlib.import_module(f"{__name__}.{name}")


NAMES = sorted(one.name for one in pkgutil.iter_modules(__path__) if one.name[0] != "_")
