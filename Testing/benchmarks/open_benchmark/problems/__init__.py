"""The problems: one module each, found by its name.

A problem is a module with TITLE, SOURCE (where it comes from and what is different here), LEVELS
(names of noise levels), QUICK (the one that `--quick` takes, or None) and
``make(level) -> (Case, Truth)``; optionally PUBLISHED = {level: {code: RMS}}, other codes' figures
on the publishers' own instance.
"""

import importlib
import pkgutil


def load(name: str):
    """Return the module of a problem."""
    return importlib.import_module(f"{__name__}.{name}")


NAMES = sorted(one.name for one in pkgutil.iter_modules(__path__))
