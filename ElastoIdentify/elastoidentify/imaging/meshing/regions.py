"""Islands and holes too small for a cell of their own."""

import numpy as np
from scipy import ndimage

from ...errors import InputError


def remove_islands(labels: np.ndarray, smallest: float) -> tuple[np.ndarray, dict[int, int]]:
    """Give connected regions of fewer than `smallest` voxels to the label nearest to them.

    Regions are connected across voxel faces, so a voxel that touches its label at a corner only is
    an island. The background (0) is treated like a label: a small hole is filled. An island at the
    surface of an object goes to the labels next to it, not to the background, or it would leave a
    notch.

    Returns
    -------
    cleaned : ndarray
        `labels` without small regions.
    removed : dict
        Label to the number of regions taken from it.

    Raises
    ------
    InputError
        Every region above 0 is small: noise, or an edge length far too large.
    """
    small = np.zeros(labels.shape, bool)
    removed, largest = {}, 0
    for label in np.unique(labels):
        components, count = ndimage.label(labels == label)
        sizes = np.bincount(components.ravel(), minlength=count + 1)[1:]
        is_small = np.r_[False, sizes < smallest]
        largest = max(largest, sizes.max() if label > 0 else 0)
        if is_small.any():
            removed[int(label)] = int(is_small.sum())
            small |= is_small[components]
    if not small.any():
        return labels, {}
    if not (labels[~small] > 0).any():
        raise InputError(
            f"every connected region is smaller than a cell (the largest has {largest} voxels, a "
            f"cell {smallest:.0f}): smooth the segmentation, for example with a median filter, or "
            "use a smaller edge length"
        )
    return filled(labels, small), removed


def filled(labels: np.ndarray, small: np.ndarray) -> np.ndarray:
    """Return `labels` with the voxels of the mask `small` taken from the nearest others."""
    result = labels.copy()
    box = tuple(
        slice(max(0, s.start - 1), s.stop + 1) for s in ndimage.find_objects(small.view(np.int8))[0]
    )
    labels, small = labels[box], small[box]
    meshed = ~small & (labels > 0)
    islands, _ = ndimage.label(small)
    at_label = np.unique(islands[small & ndimage.binary_dilation(meshed)])
    beside = np.isin(islands, at_label[at_label > 0])
    for mask, source in ((beside, meshed), (small & ~beside, ~small)):
        if mask.any():
            nearest = ndimage.distance_transform_edt(
                ~source, return_distances=False, return_indices=True
            )
            result[box][mask] = labels[tuple(nearest[:, mask])]
    return result
