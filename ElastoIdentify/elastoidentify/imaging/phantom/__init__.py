"""Images of a pushed block whose stiffness is known."""

from .planar import Inclusion, Material, Phantom, make_phantom, write_phantom

__all__ = ["Inclusion", "Material", "Phantom", "make_phantom", "write_phantom"]
