"""Nodes where an outside body may push: no force balance can be asked of them."""

from collections.abc import Sequence

import numpy as np

from ...errors import InputError
from ..image import Image


def on_image_border(points: np.ndarray, image: Image, seen: Image | None = None) -> np.ndarray:
    """Return which world points (n, 3) lie on the outer voxel edges of the image. Shape (n,).

    The slice direction of a planar image has no border. Where `seen`, the image that was segmented,
    reaches beyond the border of a cropped labelmap, what lies there is seen to be background: such
    points are not returned.
    """
    size = np.array(image.size)
    index = image.world_to_index(points)
    touching = (np.abs(index + 0.5) < 1e-6 * size) | (np.abs(index - size + 0.5) < 1e-6 * size)
    if image.planar_axis is not None:
        touching[:, image.planar_axis] = False
    touching = touching.any(axis=1)
    if seen is not None:
        normal = None if image.planar_axis is None else image.direction[:, image.planar_axis]
        touching &= ~well_inside(points, seen, normal)
    return touching


def well_inside(points: np.ndarray, image: Image, normal: np.ndarray | None = None) -> np.ndarray:
    """Return which points (n, 3) have a whole voxel of the image beyond them on every side.

    Neither the slice direction of a planar image counts nor the axis nearest to `normal`, across
    which there is one slice only.
    """
    index, size = image.world_to_index(points), np.array(image.size)
    inside = (index > 0.5) & (index < size - 1.5)
    if image.planar_axis is not None:
        inside[:, image.planar_axis] = True
    if normal is not None:
        inside[:, np.abs(normal @ image.direction).argmax()] = True
    return inside.all(axis=1)


def check_boxes(boxes: Sequence[Sequence[float]], name: str = "reaction box") -> list[np.ndarray]:
    """Return boxes as arrays (2 or 3, 2) of lower and upper bounds, or raise `InputError`."""
    checked = []
    for number, box in enumerate(boxes, start=1):
        try:
            bounds = np.asarray(box, float).ravel()
        except (TypeError, ValueError):
            bounds = np.empty(0)
        if bounds.size not in (4, 6) or np.isnan(bounds).any():
            raise InputError(
                f"{name} {number} is {box!r}: give x0,x1,y0,y1 or x0,x1,y0,y1,z0,z1 in world units"
            )
        bounds = bounds.reshape(-1, 2)
        if (bounds[:, 0] > bounds[:, 1]).any():
            raise InputError(
                f"{name} {number} is {box!r}: each lower bound must come before its upper bound"
            )
        checked.append(bounds)
    return checked


def inside_box(points: np.ndarray, bounds: np.ndarray, tolerance: float) -> np.ndarray:
    """Return which points (n, 3) lie in the closed box (2 or 3, 2). Shape (n,).

    A box of two axes reaches through all z.
    """
    inner = points[:, : len(bounds)]
    return ((inner >= bounds[:, 0] - tolerance) & (inner <= bounds[:, 1] + tolerance)).all(axis=1)
