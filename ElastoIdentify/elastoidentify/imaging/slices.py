"""One slice of a volume, in its place in the world."""

import numpy as np

from ..errors import InputError
from .image import Image


def slice_of_image(image: Image, axis: int, index: int) -> Image:
    """Return slice `index` across `axis` (0, 1, 2 for i, j, k), in its place in the world."""
    length = image.size[axis]
    if not 0 <= index < length:
        raise InputError(f"slice {index} across {'ijk'[axis]} is not in 0…{length - 1}")
    cut = [slice(None)] * 3
    cut[2 - axis] = slice(index, index + 1)
    step = np.eye(3)[axis] * index
    origin = image.index_to_world(step[None])[0]
    return Image(image.array[tuple(cut)], origin, image.spacing, image.direction)


def slice_with_points(image: Image, points: np.ndarray) -> Image:
    """Return the slice of a volume in which the points (n, 3) lie; a planar image as it is."""
    if image.planar_axis is not None:
        return image
    index = image.world_to_index(points)
    low, high = index.min(axis=0), index.max(axis=0)
    flat = [axis for axis in range(3) if high[axis] - low[axis] < 0.01]
    if len(flat) != 1:
        raise InputError(
            "the mesh is planar and the images are volumes, but the mesh lies in no slice of them: "
            "cut the images to the mesh's plane first (Slice, then Resample), or mesh the volume"
        )
    axis = flat[0]
    number = round(float(index[:, axis].mean()))
    if abs(index[:, axis].mean() - number) > 0.5 or not 0 <= number < image.size[axis]:
        raise InputError(f"the mesh lies outside the images, at slice {number} of axis {axis}")
    return slice_of_image(image, axis, number)
