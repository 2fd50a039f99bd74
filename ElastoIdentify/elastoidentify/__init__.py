"""Stiffness of soft tissue from images alone: identification of Lamé constants on a mesh.

``import elastoidentify as ei`` gives the numerics, which need numpy and scipy only. Images are in
:mod:`elastoidentify.imaging`, VTK filters in :mod:`elastoidentify.filters`.
"""

from .errors import Cancelled, InputError
from .identification import IdentificationResult, identify

__version__ = "0.1.0"

__all__ = ["Cancelled", "IdentificationResult", "InputError", "identify"]
