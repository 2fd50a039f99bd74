"""The strain image of compression elastography: stiffness is the inverse of the axial strain."""

import numpy as np

from ..problem import Estimate

TITLE = "Strain image"
SOURCE = (
    "E ∝ 1/|axial strain| of the first trial, scaled by the known cells' mean; no smoothing "
    "but that of a cell (strain elastography as on clinical scanners, Ophir et al. 1991)"
)


def estimate(case):
    strain = _axial_strain(case)
    known = case.is_known
    scale = np.mean(case.known[known, 0]) * strain[known].mean()
    return Estimate(scale / np.maximum(strain, 1e-12 * strain.max()))


def _axial_strain(case):
    """|∂u/∂x| along the push at the cells' centres, by least squares over their corners."""
    axis = case.axis % case.points.shape[1]
    x = case.points[case.cells]
    x = x - x.mean(axis=1, keepdims=True)
    u = case.displacements[0][case.cells][..., axis]
    u = u - u.mean(axis=1, keepdims=True)
    gram = np.einsum("nai,naj->nij", x, x)
    slope = np.linalg.solve(gram, np.einsum("nai,na->ni", x, u)[..., None])
    return np.abs(slope[:, axis, 0])
