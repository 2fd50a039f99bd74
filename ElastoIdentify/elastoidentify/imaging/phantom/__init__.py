"""Images of a pushed block whose stiffness is known."""

from .planar import Inclusion, Material, Phantom, make_phantom, write_phantom
from .volume import Ball, make_phantom_volume

__all__ = [
    "Ball",
    "Inclusion",
    "Material",
    "Phantom",
    "make_phantom",
    "make_phantom_volume",
    "write_phantom",
]
