"""The second step of the measurement: one step of image correlation on the mesh itself.

B-splines bend the displacement smoothly where the tissue does not, at the edge of a stiff inclusion
say. What they miss there shows in the images: the pushed image, warped by the displacement that the
mesh interpolates, still differs from the rest image. This difference corrects the nodes.
"""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from scipy import ndimage
from scipy.sparse.csgraph import connected_components

from ...fem.assembly import tangent_stiffness
from ...fem.constitutive import SmallStrain
from ...fem.elastic_constants import lame_from_young
from ...fem.mesh import Mesh, make_mesh
from .information import BLUR, fit_grey_values, signed_volumes, simplices, voxels_in_cells

GAP = 1.0  # weight of the equilibrium gap over that of the images, as mean diagonals
POISSON_RATIO = 0.45  # of the equilibrium gap; what 0.3 and 0.49 do: docs/registration.md
DAMPING = 0.1  # share of the mean texture below which a node keeps the registration's displacement
LONGEST_STEP = 1.0  # voxels


def refine_displacement(
    rest: np.ndarray,
    pushed: np.ndarray,
    points: np.ndarray,
    cells: np.ndarray,
    displacement: np.ndarray,
    spacing: np.ndarray | None = None,
    *,
    located: tuple | None = None,
) -> np.ndarray:
    """Correct measured displacements by what the images still differ in.

    One Gauss–Newton step of global digital image correlation with the mesh's linear shape functions
    (Besnard, Hild & Roux 2006), regularised by the equilibrium gap ‖K (u + δ)‖² at the inner nodes
    (Claire, Hild & Roux 2004)::

        (M + αKᵀK + γ) δ = Σ N ∇f (f − g(x + u)) − αKᵀK u,     M = Σ N ∇f ∇fᵀ Nᵀ

    K is the stiffness of a uniform body. Its weight is small: it calms neighbours that correct
    each other to and fro, and gives way to an inclusion that nobody knows of.

    Parameters
    ----------
    rest, pushed : (nj, ni) or (nk, nj, ni)
    points : (n, d)
        Continuous voxel indices, ordered i, j(, k).
    cells : (m, k) int
    displacement : (n, d)
        In voxels, right to about a voxel.
    spacing : (d,), optional
        Voxel size along i, j(, k), in any unit; default: cubes.
    located : tuple, optional
        What :func:`~.information.voxels_in_cells` returns, if it is known already.

    Returns
    -------
    (n, d)
        The corrected displacement in voxels.
    """
    dimension = rest.ndim
    spacing = np.ones(dimension) if spacing is None else np.asarray(spacing, float)
    matrix, force = correlation_system(rest, pushed, points, cells, displacement, spacing, located)
    scale = matrix.diagonal().mean()
    if not scale > 0:  # images without texture
        return displacement.copy()
    u = (displacement * spacing).ravel()
    gap = equilibrium_gap(simplex_mesh(points * spacing, cells))
    if gap.nnz:
        gap = gap * (GAP * scale / gap.diagonal().mean())
    damped = (matrix + gap + DAMPING * scale * sp.identity(u.size)).tocsc()
    step = spl.splu(damped, permc_spec="MMD_AT_PLUS_A").solve(force - gap @ u)
    step = step.reshape(displacement.shape) / spacing
    return displacement + np.clip(step, -LONGEST_STEP, LONGEST_STEP)


def correlation_system(rest, pushed, points, cells, displacement, spacing, located=None):
    """The matrix M and the right-hand side Σ N ∇f (f − g(x + u)) of a Gauss–Newton step.

    Arguments as in :func:`refine_displacement`. Gradients per unit of `spacing`; unknowns ordered
    node by node.

    Returns
    -------
    matrix : csr_matrix, (n·d, n·d)
    force : (n·d,)
    """
    located = located or voxels_in_cells(points, cells, rest.shape)
    voxels, near, weights = located
    here, there, shown = _places(pushed, rest.shape, displacement, located)
    voxels, near, weights, here, there = (a[shown] for a in (voxels, near, weights, here, there))
    first = _value_and_gradient(rest, here, at_voxels=True)
    second = _value_and_gradient(pushed, there)
    gain, offset = fit_grey_values(first[0], second[0])
    difference = first[0] - (gain * second[0] + offset)
    gradient = (first[1:] + gain * second[1:]) / 2 / spacing[:, None]
    shape = sp.csr_matrix(
        (weights.ravel(), near.ravel(), np.arange(len(voxels) + 1) * near.shape[1]),
        (len(voxels), len(points)),
    )
    force = np.stack([shape.T @ (one * difference) for one in gradient], 1).ravel()
    return _correlation_matrix(shape, gradient), force


def warped_values(
    pushed: np.ndarray, shape: tuple[int, ...], displacement: np.ndarray, located: tuple
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pushed image where the mesh moves the voxels of the rest image to.

    Parameters
    ----------
    pushed : (nj, ni) or (nk, nj, ni)
    shape : tuple of int
        Of the rest image.
    displacement : (n, d)
        Of the nodes, in voxels.
    located : tuple
        Of :func:`~.information.voxels_in_cells`.

    Returns
    -------
    values : (v,)
    seen : (v,) bool
        Whether the pushed image shows the place.
    """
    _, there, seen = _places(pushed, shape, displacement, located)
    values = ndimage.map_coordinates(
        np.asarray(pushed, float), there.T[::-1], order=3, mode="nearest"
    )
    return values, seen


def _places(pushed, shape, displacement, located):
    """Where voxels are, where the mesh moves them to (v, d), and whether `pushed` shows that."""
    voxels, near, weights = located
    here = np.stack(np.unravel_index(voxels, shape), 1)[:, ::-1].astype(float)
    there = here + np.einsum("va,vad->vd", weights, displacement[near])
    return here, there, ((there >= 0) & (there <= np.array(pushed.shape[::-1]) - 1)).all(1)


def carried_displacement(
    points: np.ndarray, cells: np.ndarray, displacement: np.ndarray, trusted: np.ndarray
) -> np.ndarray:
    """Replace the displacement of nodes that are not trusted by what their surroundings do.

    They move as the nodes of a uniform elastic body do whose trusted nodes are held where they
    were measured and whose surface is free.

    Parameters
    ----------
    points : (n, d)
        In pixels.
    cells : (m, k) int
    displacement : (n, d)
        In pixels.
    trusted : (n,) bool

    Returns
    -------
    (n, d)
        As measured at trusted nodes, and where no mesh leads to one.
    """
    mesh = simplex_mesh(points, cells)
    links = mesh.node_cells @ mesh.node_cells.T
    _, part = connected_components(links, directed=False)
    reached = np.isin(part, part[trusted])
    free = np.flatnonzero(np.repeat(~trusted & reached, mesh.dim))
    if not len(free):
        return displacement.copy()
    stiffness = uniform_stiffness(mesh)
    carried = displacement.astype(float).ravel()
    carried[free] = 0.0
    force = (stiffness @ carried)[free]
    inner = stiffness[free][:, free].tocsc()
    # parts that hang on a single trusted node could turn about it
    inner = inner + 1e-9 * inner.diagonal().mean() * sp.identity(len(free), format="csc")
    carried[free] = -spl.splu(inner, permc_spec="MMD_AT_PLUS_A").solve(force)
    return carried.reshape(displacement.shape)


def uniform_stiffness(mesh: Mesh) -> sp.csr_matrix:
    """K of a uniform linear elastic body, (n·d, n·d)."""
    lam, mu = (np.full(mesh.n_cells, one) for one in lame_from_young(1.0, POISSON_RATIO))
    return tangent_stiffness(mesh, SmallStrain(), np.zeros_like(mesh.points), lam, mu)


def equilibrium_gap(mesh: Mesh) -> sp.csr_matrix:
    """KᵀK of a uniform linear elastic body, with the rows of the inner nodes. Shape (n·d, n·d)."""
    stiffness = uniform_stiffness(mesh)
    inner = np.flatnonzero(~mesh.boundary_nodes & (np.diff(mesh.node_cells.indptr) > 0))
    rows = stiffness[(inner[:, None] * mesh.dim + np.arange(mesh.dim)).ravel()]
    return (rows.T @ rows).tocsr()


def simplex_mesh(points: np.ndarray, cells: np.ndarray) -> Mesh:
    """The triangles or tetrahedra that the shape functions live on, all turned the same way."""
    corners = simplices(cells, points.shape[1])
    size = signed_volumes(points, corners)
    turned = corners[:, [1, 0, *range(2, corners.shape[1])]]
    corners = np.where((size < 0)[:, None], turned, corners)
    return make_mesh(points, corners[np.abs(size) > 1e-9 * np.abs(size).max()])


def _correlation_matrix(shape: sp.csr_matrix, gradient: np.ndarray) -> sp.csr_matrix:
    """M = Σ N ∇f ∇fᵀ Nᵀ over the voxels, unknowns ordered node by node. Shape (n·d, n·d)."""
    dimension, nodes = len(gradient), shape.shape[1]
    blocks = [[None] * dimension for _ in range(dimension)]
    for a in range(dimension):
        for b in range(a, dimension):
            product = sp.diags(gradient[a] * gradient[b]) @ shape
            blocks[a][b] = blocks[b][a] = shape.T @ product
    by_node = np.arange(nodes * dimension).reshape(dimension, nodes).T.ravel()
    return sp.bmat(blocks, format="csr")[by_node][:, by_node]


def _value_and_gradient(
    image: np.ndarray, where: np.ndarray, at_voxels: bool = False
) -> np.ndarray:
    """Slightly blurred value and its gradient per voxel along i, j(, k), (1 + d, v), at `where`."""
    image, dimension = np.asarray(image, float), image.ndim
    orders = [[0] * dimension]
    orders += [
        [int(axis == dimension - 1 - a) for axis in range(dimension)] for a in range(dimension)
    ]
    place = where.T[::-1]
    if at_voxels:
        place = tuple(place.astype(int))
        return np.stack([ndimage.gaussian_filter(image, BLUR, order=o)[place] for o in orders])
    return np.stack(
        [
            ndimage.map_coordinates(
                ndimage.gaussian_filter(image, BLUR, order=order),
                place,
                order=1 if any(order) else 3,
                mode="nearest",
            )
            for order in orders
        ]
    )
