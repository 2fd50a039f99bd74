"""Islands and holes too small for a cell of their own."""

import numpy as np
from scipy import ndimage


def remove_islands(labels: np.ndarray, smallest: float) -> tuple[np.ndarray, dict[int, int]]:
    """Give connected regions of fewer than `smallest` voxels to the label nearest to them.

    Regions are connected across voxel faces, so a voxel that touches its label at a corner only is
    an island. The background (0) is treated like a label: a small hole is filled. An island at the
    surface of an object goes to the labels next to it, not to the background, or it would leave a
    notch.

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
