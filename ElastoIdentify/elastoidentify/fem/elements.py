"""Linear isoparametric cells with full Gauss rules: one table entry per cell type.

To add a cell type, add an entry to :data:`CELL_TYPES`: gradients of its shape functions in the
reference cell, its Gauss rule, its faces, and how it is cut into smaller cells of the same type.
Node numbering is VTK's. Formulas: Hughes, The Finite Element Method (1987), chapter 3.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

_GAUSS = 1 / np.sqrt(3)


@dataclass(frozen=True)
class CellType:
    """A linear cell.

    Parameters
    ----------
    name : str
    vtk_type : int
        VTK's cell type number.
    corners : ndarray, shape (k, d)
        Reference coordinates of the nodes.
    values, gradients : callable
        ξ (m, d) → shape functions (m, k) and their derivatives ∂N/∂ξ (m, k, d).
    gauss_points, gauss_weights : ndarray, shape (q, d) and (q,)
    faces : tuple of tuples
        Local node numbers of each side (edges in 2-D, faces in 3-D).
    children : tuple of tuples of tuples
        One uniform refinement: each child's nodes, each as the tuple of the parent's local nodes
        of which it is the mean.
    """

    name: str
    vtk_type: int
    corners: np.ndarray
    values: Callable[[np.ndarray], np.ndarray]
    gradients: Callable[[np.ndarray], np.ndarray]
    gauss_points: np.ndarray
    gauss_weights: np.ndarray
    faces: tuple
    children: tuple

    @property
    def n_nodes(self) -> int:
        return len(self.corners)

    @property
    def dim(self) -> int:
        return self.corners.shape[1]


def _simplex(dim):
    corners = np.vstack([np.zeros(dim), np.eye(dim)])

    def values(xi):
        return np.column_stack([1 - xi.sum(1), xi])

    def gradients(xi):
        return np.broadcast_to(np.vstack([-np.ones(dim), np.eye(dim)]), (len(xi), dim + 1, dim))

    return corners, values, gradients


def _tensor(corners):
    corners = np.array(corners, float)
    dim = corners.shape[1]

    def factors(xi):
        return 1 + xi[:, None, :] * corners  # (m, k, d)

    def values(xi):
        return factors(xi).prod(axis=2) / 2**dim

    def gradients(xi):
        f = factors(xi)
        others = [np.delete(f, axis, axis=2).prod(axis=2) for axis in range(dim)]
        return np.stack(others, axis=2) * corners / 2**dim

    return corners, values, gradients


def _gauss_tensor(dim):
    return np.array(list(product((-_GAUSS, _GAUSS), repeat=dim))), np.ones(2**dim)


def _tensor_children(corners):
    """Each child of a quad or hexahedron sits in one corner of it.

    Its node in the direction of `local` is the mean of the parent's nodes that agree with the
    child's corner in every axis in which `local` does.
    """
    corners = np.array(corners)

    def mean_of(home, local):
        free = corners[home] != corners[local]
        return tuple(np.flatnonzero(np.all((corners == corners[home]) | free, axis=1)))

    nodes = range(len(corners))
    return tuple(tuple(mean_of(home, local) for local in nodes) for home in nodes)


_QUAD = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
_HEXAHEDRON = [(x, y, z) for z in (-1, 1) for x, y in _QUAD]

_TRIANGLE_CHILDREN = (
    ((0,), (0, 1), (0, 2)),
    ((0, 1), (1,), (1, 2)),
    ((0, 2), (1, 2), (2,)),
    ((0, 1), (1, 2), (0, 2)),
)
# Bey's red refinement (Computing 55, 1995)
_TETRA_CHILDREN = (
    ((0,), (0, 1), (0, 2), (0, 3)),
    ((0, 1), (1,), (1, 2), (1, 3)),
    ((0, 2), (1, 2), (2,), (2, 3)),
    ((0, 3), (1, 3), (2, 3), (3,)),
    ((0, 1), (0, 2), (0, 3), (1, 3)),
    ((0, 1), (0, 2), (1, 3), (1, 2)),
    ((0, 2), (0, 3), (1, 3), (2, 3)),
    ((0, 2), (1, 3), (1, 2), (2, 3)),
)

CELL_TYPES = {
    cell.name: cell
    for cell in (
        CellType(
            "triangle",
            5,
            *_simplex(2),
            gauss_points=np.full((1, 2), 1 / 3),
            gauss_weights=np.array([1 / 2]),
            faces=((0, 1), (1, 2), (2, 0)),
            children=_TRIANGLE_CHILDREN,
        ),
        CellType(
            "quad",
            9,
            *_tensor(_QUAD),
            *_gauss_tensor(2),
            faces=((0, 1), (1, 2), (2, 3), (3, 0)),
            children=_tensor_children(_QUAD),
        ),
        CellType(
            "tetra",
            10,
            *_simplex(3),
            gauss_points=np.full((1, 3), 1 / 4),
            gauss_weights=np.array([1 / 6]),
            faces=((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
            children=_TETRA_CHILDREN,
        ),
        CellType(
            "hexahedron",
            12,
            *_tensor(_HEXAHEDRON),
            *_gauss_tensor(3),
            faces=(
                (0, 1, 2, 3),
                (4, 5, 6, 7),
                (0, 1, 5, 4),
                (1, 2, 6, 5),
                (2, 3, 7, 6),
                (3, 0, 4, 7),
            ),
            children=_tensor_children(_HEXAHEDRON),
        ),
    )
}


def shape_gradients(cell: CellType, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ∇N at the Gauss points and their weights.

    Parameters
    ----------
    corners : (n, k, d)
        Node positions of n cells of this type.

    Returns
    -------
    gradients : (n, q, k, d)
        ∂N_a/∂x_j at rest; not finite where a cell has no volume.
    weights : (n, q)
        Gauss weight times det ∂x/∂ξ; not positive where a cell is inverted.
    """
    reference = cell.gradients(cell.gauss_points)  # (q, k, d)
    jacobian = np.einsum("nai,qaj->nqij", corners, reference)
    det = np.linalg.det(jacobian)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = _inverse(jacobian, det)
    gradients = np.einsum("qak,nqkj->nqaj", reference, inverse)
    return gradients, det * cell.gauss_weights


def _inverse(matrix, det):
    """Invert (…, 2, 2) or (…, 3, 3) by cofactors: no exception where a cell is degenerate."""
    m = matrix
    if m.shape[-1] == 2:
        rows = [[m[..., 1, 1], -m[..., 0, 1]], [-m[..., 1, 0], m[..., 0, 0]]]
        cofactor = np.stack([np.stack(row, -1) for row in rows], -2)
    else:
        a, b, c = m[..., :, 0], m[..., :, 1], m[..., :, 2]
        cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], -2)
    return cofactor / det[..., None, None]
