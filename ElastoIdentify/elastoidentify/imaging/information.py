"""How well a registration can see: texture, noise, and the covariance of the displacements."""

import numpy as np
from scipy import ndimage

_CHUNK = 4_000_000  # candidate voxels looked at in one go


def simplices(cells: np.ndarray, dimension: int) -> np.ndarray:
    """Cut cells into triangles (dimension 2) or tetrahedra (3) on the same nodes.

    Parameters
    ----------
    cells : (m, k) int
        Triangles or quadrilaterals in the plane; tetrahedra or hexahedra in space (VTK order).
        Planar cells in space are returned as triangles.

    Returns
    -------
    (p, 3) or (p, 4) int
    """
    cells = np.asarray(cells)
    kind = cells.shape[1]
    if kind == 3 or (kind == 4 and dimension == 3):
        return cells
    if kind == 4:
        return cells[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    six = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
    return cells[:, six].reshape(-1, 4)


def signed_volumes(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Signed area (triangles) or volume (tetrahedra), (p,). `points` are (n, d)."""
    edges = points[corners[:, 1:]] - points[corners[:, :1]]
    return np.linalg.det(edges) / (2 if points.shape[1] == 2 else 6)


def voxels_in_cells(points: np.ndarray, cells: np.ndarray, shape: tuple[int, ...]):
    """Find the voxels inside the mesh, with the linear shape functions there.

    Parameters
    ----------
    points : (n, d)
        Node positions as continuous voxel indices, ordered i, j(, k).
    cells : (m, k) int
    shape : tuple of d ints
        Shape of the image array, ordered (k,) j, i.

    Returns
    -------
    voxels : (v,) int
        Flat indices into the array, each once.
    nodes : (v, d + 1) int
        The nodes of the triangle or tetrahedron around each.
    weights : (v, d + 1)
        Their shape functions at the voxel centre; they sum to 1.
    """
    points = np.asarray(points, float)
    dimension = points.shape[1]
    corners = simplices(cells, dimension)
    corner_points = points[corners]
    size = np.array(shape[::-1])
    low = np.clip(np.ceil(corner_points.min(1) - 1e-9), 0, size).astype(int)
    high = np.clip(np.floor(corner_points.max(1) + 1e-9) + 1, low, size).astype(int)
    count = (high - low).prod(1)
    edges = np.swapaxes(corner_points[:, 1:] - corner_points[:, :1], 1, 2)
    flat = np.abs(np.linalg.det(edges)) < 1e-12
    count[flat] = 0
    inverse = np.zeros_like(edges)
    inverse[~flat] = np.linalg.inv(edges[~flat])

    found = []
    for part in _chunks(count):
        owner = np.repeat(part, count[part])
        first = np.repeat(np.cumsum(count[part]) - count[part], count[part])
        rank = np.arange(len(owner)) - first
        index = np.empty((len(owner), dimension), int)
        for axis in range(dimension):
            width = (high - low)[owner, axis]
            index[:, axis] = low[owner, axis] + rank % width
            rank = rank // width
        local = np.einsum("vab,vb->va", inverse[owner], index - corner_points[owner, 0])
        weights = np.column_stack([1 - local.sum(1), local])
        inside = (weights > -1e-9).all(1)
        voxel = np.ravel_multi_index(tuple(index[inside].T[::-1]), shape)
        found.append((voxel, owner[inside], weights[inside]))
    if not found:
        nothing = np.zeros((0, dimension + 1))
        return np.zeros(0, int), nothing.astype(int), nothing
    voxels, owners, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    voxels, once = np.unique(voxels, return_index=True)  # centres on a shared edge: count once
    return voxels, corners[owners[once]], np.clip(weights[once], 0, 1)


def _chunks(count: np.ndarray):
    """Split the cells into runs of at most about `_CHUNK` candidate voxels."""
    busy = np.flatnonzero(count)
    if not len(busy):
        return []
    return np.split(busy, np.flatnonzero(np.diff(np.cumsum(count[busy]) // _CHUNK)) + 1)


def noise_of_difference(difference: np.ndarray) -> float:
    """Robust standard deviation of the noise in an image of differences.

    Takes the part that changes from voxel to voxel (the Laplacian-like difference operator
    [1, -2, 1] along every axis, Immerkær 1996), which a remaining misregistration hardly touches,
    and its median absolute deviation, which edges hardly touch.
    """
    values = np.asarray(difference, float)
    gain = 1.0
    for axis, length in enumerate(values.shape):
        if length >= 3:
            values = np.diff(values, 2, axis=axis)
            gain *= np.sqrt(6.0)
    return float(1.4826 * np.median(np.abs(values - np.median(values))) / gain)


def texture_information(
    image: np.ndarray,
    noise: float,
    points: np.ndarray,
    cells: np.ndarray,
) -> np.ndarray:
    """Information that the texture around each node gives on the node's displacement.

    The inverse covariance Σ N_i ∇f ∇fᵀ / s² over the voxels, with N_i the node's linear shape
    function, f the rest image, s the standard deviation of the difference of the two images.

    Parameters
    ----------
    image : (nj, ni) or (nk, nj, ni)
        Rest image.
    noise : float
        s, in the image's grey values.
    points : (n, d)
        Continuous voxel indices, ordered i, j(, k).
    cells : (m, k) int

    Returns
    -------
    (n, d, d)
        1/voxel², per axis of the index.
    """
    dimension = image.ndim
    voxels, nodes, weights = voxels_in_cells(points, cells, image.shape)
    gradients = [
        ndimage.gaussian_filter1d(image, 0.7, axis=axis, order=1, mode="nearest").ravel()[voxels]
        for axis in reversed(range(dimension))
    ]
    information = np.zeros((len(points), dimension, dimension))
    for a in range(dimension):
        for b in range(a, dimension):
            product = (gradients[a] * gradients[b])[:, None] * weights
            total = np.bincount(nodes.ravel(), product.ravel(), minlength=len(points))
            information[:, a, b] = information[:, b, a] = total
    return information / max(noise, 1e-12) ** 2
