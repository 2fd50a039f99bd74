"""Whether a labelmap and the image that it is said to belong to fit each other."""

import numpy as np

from ...errors import InputError
from ..image import Image
from .reactions import well_inside

SAME_PLACE = 0.5  # of a voxel: what corners of one and the same grid may be apart
LEAST_INSIDE = 0.5  # share of the labelled voxels that must lie in the image


def fit_notes(segmentation: Image, image: Image) -> list[str]:
    """Compare the places of a labelmap and of the image that was segmented.

    A finer, coarser or cropped labelmap is fine as long as its labels lie in the image.

    Returns
    -------
    list of str
        A sentence where the labelmap has the image's matrix and another geometry (which was lost,
        most likely), is cut off inside the image, or has labels beyond it.

    Raises
    ------
    InputError
        Most of the labels lie outside of the image.
    """
    notes = []
    inside = _share_inside(segmentation, image)
    if inside < LEAST_INSIDE:
        raise InputError(
            f"only {100 * inside:.0f} % of the segmentation's labels lie in the rest image, which "
            f"is in {_box(image)}, the segmentation in {_box(segmentation)}: give the segmentation "
            "of this image, with its geometry"
        )
    planar = segmentation.planar_axis
    whole = planar is None or image.planar_axis is not None
    if whole and segmentation.size == image.size:
        apart = _corner_distance(segmentation, image, planar)
        if apart > SAME_PLACE:
            notes.append(
                "The segmentation has the matrix of the rest image and another geometry: the "
                f"segmentation covers {_box(segmentation)}, the image {_box(image)}; if its "
                "geometry was lost, give it that of the image."
            )
    if not notes and _cut_inside(segmentation, image):
        notes.append(
            "The segmentation is cropped inside the rest image, and labels reach its border: those "
            "sides are free surface."
        )
    if not notes and inside < 0.99:
        notes.append(
            f"{100 * (1 - inside):.0f} % of the segmentation's labels lie outside of the rest "
            "image, where no displacement can be measured."
        )
    return notes


def _labelled(segmentation: Image, most: int = 2_000_000) -> np.ndarray:
    """Return the world positions of labelled voxels, of a large volume an even share. (n, 3)."""
    stride = max(1, int(np.ceil((segmentation.array.size / most) ** (1 / 3))))
    if segmentation.planar_axis is not None:
        stride = max(1, int(np.ceil((segmentation.array.size / most) ** 0.5)))
    index = np.argwhere(segmentation.array[::stride, ::stride, ::stride] != 0) * stride
    if not len(index) and stride > 1:  # thin labels, all between the samples
        index = np.argwhere(segmentation.array != 0)
    return segmentation.index_to_world(index[:, ::-1])


def _share_inside(segmentation: Image, image: Image) -> float:
    index = image.world_to_index(_labelled(segmentation))
    inside = (index > -0.6) & (index < np.array(image.size) - 0.4)
    if image.planar_axis is not None:
        inside[:, image.planar_axis] = True
    return float(inside.all(axis=1).mean()) if len(inside) else 1.0


def _corners(image: Image) -> np.ndarray:
    ends = [(0, n - 1) for n in image.size]
    return image.index_to_world(np.array(np.meshgrid(*ends)).reshape(3, -1).T)


def _corner_distance(segmentation: Image, image: Image, planar: int | None) -> float:
    """Return how far the corners of two grids of one matrix are apart, in voxels of the image."""
    off = (_corners(segmentation) - _corners(image)) @ np.linalg.inv(image.axes).T
    if planar is not None:
        off[:, planar] = 0
    return float(np.abs(off).max())


def _cut_inside(segmentation: Image, image: Image) -> bool:
    """Tell whether labels reach a border of the labelmap that lies inside the image."""
    planar = segmentation.planar_axis
    normal = None if planar is None else segmentation.direction[:, planar]
    for axis in range(3):
        if segmentation.size[axis] == 1:
            continue
        for end in (0, segmentation.size[axis] - 1):
            index = np.argwhere(segmentation.array.take(end, axis=2 - axis) != 0)[:, ::-1]
            if not len(index):
                continue
            full = np.insert(index.astype(float), axis, end + (0.5 if end else -0.5), axis=1)
            if well_inside(segmentation.index_to_world(full), image, normal).any():
                return True
    return False


def _box(image: Image) -> str:
    corners = _corners(image)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return " × ".join(f"{a:.4g}…{b:.4g}" for a, b in zip(low, high, strict=True))
