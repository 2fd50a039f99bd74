"""How long edges may be: as asked at the borders between labels, longer away from them."""

import numpy as np
from scipy import ndimage


def wanted_edges(
    labels: np.ndarray, spacing: np.ndarray, edge_length: float, grading: float
) -> np.ndarray:
    """Return how long edges may be at every voxel, in units of `edge_length`, from 1 to `grading`.

    They grow by as much as the voxel is far from the next border: 2 from one edge on, 4 from three
    and 8 from seven on, a row of each before the next. In a plane the ends of the array are
    borders, for outlines are cut at the edge length; in a volume cells may grow up to them.

    Parameters
    ----------
    labels : ndarray of int, shape (nj, ni) or (nk, nj, ni)
    spacing : ndarray, shape (d,)
        Voxel size along i, j (, k).
    edge_length, grading : float
    """
    padded = np.pad(
        labels, 1, **({"constant_values": -1} if labels.ndim == 2 else {"mode": "edge"})
    )
    inner = np.ones(padded.shape, bool)
    for axis in range(labels.ndim):
        inside, along = np.moveaxis(inner, axis, 0), np.moveaxis(padded, axis, 0)
        inside[1:] &= along[1:] == along[:-1]  # one of the two voxels at a border will do
    if inner.all():
        return np.full(labels.shape, float(grading))
    distance = ndimage.distance_transform_edt(inner, sampling=spacing[::-1])
    return np.minimum(1 + distance[(slice(1, -1),) * labels.ndim] / edge_length, grading)


def at(values: np.ndarray, spacing: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the values (n,) of the voxels in which points (n, d) in scaled indices lie."""
    last = np.array(values.shape[::-1]) - 1
    index = np.clip(np.rint(points / spacing), 0, last).astype(int)
    return values[tuple(index.T[::-1])]
