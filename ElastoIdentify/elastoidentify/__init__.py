"""Stiffness of soft tissue from images alone: identification of Lamé constants on a mesh.

``import elastoidentify as ei`` gives the numerics, which need numpy and scipy only. Images are in
:mod:`elastoidentify.imaging`, VTK filters in :mod:`elastoidentify.filters`.
"""

from importlib import import_module

from . import _moved
from .errors import Cancelled, InputError

__version__ = "0.2.0"

_moved.install()

__all__ = ["Cancelled", "IdentificationResult", "InputError", "identify"]


def __getattr__(name: str):
    """Import the numerics when they are first asked for (PEP 562): ``--help`` need not wait."""
    if name in ("IdentificationResult", "identify"):
        return getattr(import_module(".inverse.identify", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
