"""From images to displacements: elastix, image correlation, the information of an image."""

from .radiofrequency import register_radiofrequency
from .registration import Registration, on_grid_of, register

__all__ = ["Registration", "on_grid_of", "register", "register_radiofrequency"]
