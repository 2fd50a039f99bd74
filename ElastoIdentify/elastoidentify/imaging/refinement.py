"""The second step of the measurement: one step of image correlation on the mesh itself.

B-splines bend the displacement smoothly where the tissue does not, at the edge of a stiff inclusion
say. What they miss there shows in the images: the pushed image, warped by the displacement that the
mesh interpolates, still differs from the rest image. This difference gives each node a correction.
"""

import numpy as np
from scipy import ndimage

from .information import BLUR, voxels_in_cells

DAMPING = 0.1  # share of the mean texture below which a node keeps the registration's displacement
LONGEST_STEP = 1.0  # voxels


def refine_displacement(
    rest: np.ndarray,
    pushed: np.ndarray,
    points: np.ndarray,
    cells: np.ndarray,
    displacement: np.ndarray,
) -> np.ndarray:
    """Correct measured displacements by what the images still differ in.

    One Gauss–Newton step of global digital image correlation with the mesh's linear shape functions
    N_i (Besnard, Hild & Roux 2006), the matrix lumped on each node:
    δ_i = (Σ N_i ∇f ∇fᵀ)⁻¹ Σ N_i ∇f (f − g(x + u)). Lumped, so that no linear system mixes
    the noise of neighbours; damped where the image has no texture.

    Parameters
    ----------
    rest, pushed : (nj, ni) or (nk, nj, ni)
    points : (n, d)
        Continuous voxel indices, ordered i, j(, k).
    cells : (m, k) int
    displacement : (n, d)
        In voxels, right to about a voxel.

    Returns
    -------
    (n, d)
        The corrected displacement in voxels.
    """
    dimension, nodes = rest.ndim, len(points)
    voxels, near, weights = voxels_in_cells(points, cells, rest.shape)
    here = np.stack(np.unravel_index(voxels, rest.shape), 1)[:, ::-1].astype(float)
    there = here + np.einsum("va,vad->vd", weights, displacement[near])
    first, second = (_value_and_gradient(*pair) for pair in ((rest, here), (pushed, there)))
    gain, offset = np.polyfit(second[0], first[0], 1)
    difference = first[0] - (gain * second[0] + offset)
    gradient = (first[1:] + gain * second[1:]) / 2

    def at_nodes(values):
        return np.bincount(near.ravel(), (values[:, None] * weights).ravel(), minlength=nodes)

    matrix = np.empty((nodes, dimension, dimension))
    for a in range(dimension):
        for b in range(a, dimension):
            matrix[:, a, b] = matrix[:, b, a] = at_nodes(gradient[a] * gradient[b])
    force = np.stack([at_nodes(component * difference) for component in gradient], 1)
    mean = np.trace(matrix, axis1=1, axis2=2).mean() / dimension
    damped = matrix + max(DAMPING * mean, np.finfo(float).tiny) * np.eye(dimension)
    step = np.linalg.solve(damped, force[..., None])[..., 0]
    return displacement + np.clip(step, -LONGEST_STEP, LONGEST_STEP)


def _value_and_gradient(image: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Slightly blurred value and its gradient per voxel along i, j(, k), (1 + d, v), at `where`."""
    image, dimension = np.asarray(image, float), image.ndim
    orders = [[0] * dimension]
    orders += [
        [int(axis == dimension - 1 - a) for axis in range(dimension)] for a in range(dimension)
    ]
    return np.stack(
        [
            ndimage.map_coordinates(
                ndimage.gaussian_filter(image, BLUR, order=order),
                where.T[::-1],
                order=1 if any(order) else 3,
                mode="nearest",
            )
            for order in orders
        ]
    )
