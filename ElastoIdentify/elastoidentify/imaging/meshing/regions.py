"""Islands and holes too small for a cell of their own."""

import numpy as np
from scipy import ndimage


def remove_islands(labels: np.ndarray, smallest: float) -> tuple[np.ndarray, dict[int, int]]:
    """Give connected regions of fewer than `smallest` voxels to the label nearest to them.

    Regions are connected across voxel faces, so a voxel that touches its label at a corner only is
    an island. The background (0) is treated like a label: a small hole is filled.

    Returns
    -------
    cleaned : ndarray
        `labels` without small regions. Unchanged when *every* region above 0 is small.
    removed : dict
        Label to the number of regions taken from it.
    """
    small = np.zeros(labels.shape, bool)
    removed = {}
    for label in np.unique(labels):
        components, count = ndimage.label(labels == label)
        is_small = np.bincount(components.ravel(), minlength=count + 1) < smallest
        is_small[0] = False
        if is_small.any():
            removed[int(label)] = int(is_small.sum())
            small |= is_small[components]
    if not small.any() or not (labels[~small] > 0).any():
        return labels, {}
    nearest = ndimage.distance_transform_edt(small, return_distances=False, return_indices=True)
    return labels[tuple(nearest)], removed
