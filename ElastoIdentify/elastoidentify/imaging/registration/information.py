"""How well a registration can see: texture, noise, and the covariance of the displacements."""

from functools import cache

import numpy as np
from scipy import ndimage

BLUR = 0.7  # voxels, of the Gaussian that the image is differentiated with
# share of the resolution that the deformation model cannot follow, see docs/registration.md
MODEL_ERROR = 0.4  # of B-splines, resolution: the control-point spacing
REFINED_MODEL_ERROR = 0.2  # of displacements refined on the mesh, resolution: the node's patch
SINGULAR = 3.0  # times the gradient that cells see where the contact with a rigid body ends
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


def fit_grey_values(rest: np.ndarray, warped: np.ndarray) -> tuple[float, float]:
    """Gain and offset that bring `warped` closest to `rest` (least squares), both (v,)."""
    centred = np.asarray(warped, float) - np.mean(warped)
    power = (centred**2).sum()
    gain = float((centred * rest).sum() / power) if power > 0 else 0.0
    return gain, float(np.mean(rest) - gain * np.mean(warped))


def noise_of_difference(difference: np.ndarray) -> float:
    """Robust standard deviation of grey-value differences: 1.4826 × median absolute deviation.

    Edges and places where the registration missed touch it little.
    """
    values = np.asarray(difference, float).ravel()
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _derivatives(image: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """∂f/∂x, ∂f/∂y(, ∂f/∂z) by derivatives of a Gaussian, (d, *shape). `spacing` is i, j(, k)."""
    dimension = image.ndim
    return np.stack(
        [
            ndimage.gaussian_filter(
                image, BLUR, order=[int(axis == dimension - 1 - a) for axis in range(dimension)]
            )
            / spacing[a]
            for a in range(dimension)
        ]
    )


@cache
def _noise_gain(dimension: int) -> float:
    """Variance of a derivative of white noise of variance 1."""
    pulse = np.zeros((17,) * dimension)
    pulse[(8,) * dimension] = 1.0
    return float((_derivatives(pulse, np.ones(dimension))[0] ** 2).sum())


def cell_gradients(points: np.ndarray, corners: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """∇u of each triangle or tetrahedron, (p, d·d); 0 where it has no size."""
    edges, change = (
        values[corners[:, 1:]] - values[corners[:, :1]] for values in (points, displacement)
    )
    flat = np.abs(np.linalg.det(edges)) < 1e-12
    edges = np.where(flat[:, None, None], np.eye(points.shape[1]), edges)
    gradients = np.linalg.solve(edges, change).reshape(len(corners), -1)
    gradients[flat] = 0.0
    return gradients


def strain_spread(
    points: np.ndarray,
    corners: np.ndarray,
    displacement: np.ndarray,
    touched: np.ndarray | None = None,
) -> np.ndarray:
    """How much the displacement gradient changes around each node, squared, (n,).

    Mean over the cells at a node of |∇u − (∇u averaged at the cell's nodes)|². At a node that an
    outside body touches (`touched`, (n,) bool) the strain ends at once: |∇u|² more. Where the
    contact itself ends the strain is singular, and the cells see a part of it: (3 |∇u|)².
    The factors are measured, see docs/registration.md.
    """
    count, nodes = corners.shape[1], len(points)
    gradients = cell_gradients(points, corners, displacement)
    around = np.maximum(np.bincount(corners.ravel(), minlength=nodes), 1)

    def at_nodes(values):
        total = np.bincount(corners.ravel(), np.repeat(values, count), minlength=nodes)
        return total / around

    mean = np.stack([at_nodes(column) for column in gradients.T], 1)
    spread = at_nodes(((gradients[:, None] - mean[corners]) ** 2).sum(2).mean(1))
    if touched is not None:
        jump = np.where(touched, 1.0, 0.0)
        jump[contact_edge(corners, touched)] = SINGULAR
        spread = spread + (jump**2 * (mean**2).sum(1))
    return spread


def contact_edge(corners: np.ndarray, touched: np.ndarray) -> np.ndarray:
    """Numbers of the touched nodes whose surface goes on to nodes that are not touched."""
    size = corners.shape[1]
    sides = np.vstack([np.delete(corners, k, axis=1) for k in range(size)])
    _, first, uses = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
    )
    surface = sides[first[uses == 1]]
    ends = surface[~touched[surface].all(axis=1)]
    return np.unique(ends[touched[ends]])


def displacement_information(
    rest: np.ndarray,
    warped: np.ndarray,
    points: np.ndarray,
    cells: np.ndarray,
    displacement: np.ndarray,
    *,
    spacing: np.ndarray | None = None,
    resolution: float | None = 16.0,
    seen: np.ndarray | None = None,
    touched: np.ndarray | None = None,
    located: tuple | None = None,
):
    """Inverse covariance of displacements measured by a registration.

    The covariance at a node has two parts::

        C = s² (h^d ⟨∇f ∇fᵀ⟩)⁻¹ + (q h)² ⟨|δ∇u|²⟩ / d

    The first is image noise: s is the standard deviation of the difference of rest and warped
    pushed image, ⟨∇f ∇fᵀ⟩ the mean gradient product over the node's shape function, h the
    resolution of the registration (its control-point spacing), so that h^d voxels decide about one
    displacement. The second is what the deformation model cannot follow: it is proportional to the
    change of the displacement gradient around the node. Its factor q is measured, see
    docs/registration.md: 0.4 for B-splines, 0.2 for displacements refined on the mesh.

    Nodes closer than h share their error. They are weighted as if they shared one measurement:
    the information is C⁻¹ times min(1, A / h^d), A being the node's part of the mesh. So the
    uncertainty of everything smooth, which is what an identification averages, comes out right;
    that of a single node on a mesh finer than h is too large.

    The gradient product is that of the rest image with the warped image, whose noise is another:
    noise does not pass for texture.

    Parameters
    ----------
    rest, warped : (nj, ni) or (nk, nj, ni)
        The rest image and the pushed image warped onto it, in the same grey values.
    points : (n, d)
        Continuous voxel indices, ordered i, j(, k).
    cells : (m, k) int
    displacement : (n, d)
        In pixels.
    spacing : (d,), optional
        Voxel size in pixels; its product is 1.
    resolution : float or None
        h in pixels. None: the node's own patch, h^d = A, for displacements refined on the mesh.
    seen : bool, shape of `rest`, optional
        Where the warped image shows something; elsewhere the tissue has left the pushed image.
    touched : (n,) bool, optional
        Nodes that an outside body touches, see :func:`strain_spread`.
    located : tuple, optional
        What :func:`voxels_in_cells` returns, if it is known already.

    Returns
    -------
    information : (n, d, d)
        1/pixel², along the image axes.
    share : (n,)
        min(1, A / h^d): the part of an independent measurement that each node is.
    noise : float
        s, in grey values.
    """
    rest, warped = np.asarray(rest, float), np.asarray(warped, float)
    dimension, nodes = rest.ndim, len(points)
    spacing = np.ones(dimension) if spacing is None else np.asarray(spacing, float)
    voxels, near, weights = located or voxels_in_cells(points, cells, rest.shape)
    if seen is not None:
        shown = seen.ravel()[voxels]
        voxels, near, weights = voxels[shown], near[shown], weights[shown]

    def at_nodes(values):
        return np.bincount(near.ravel(), (values[:, None] * weights).ravel(), minlength=nodes)

    noise = noise_of_difference((rest - warped).ravel()[voxels])
    noise = max(noise, 1e-3 * rest.ravel()[voxels].std(), np.finfo(float).tiny)
    first, second = (
        _derivatives(image, spacing).reshape(dimension, -1)[:, voxels] for image in (rest, warped)
    )
    texture = np.empty((nodes, dimension, dimension))
    for a in range(dimension):
        for b in range(a, dimension):
            product = (first[a] * second[b] + first[b] * second[a]) / 2
            texture[:, a, b] = texture[:, b, a] = at_nodes(product)
    volume = at_nodes(np.ones(len(voxels)))
    chance = np.sqrt(np.bincount(near.ravel(), weights.ravel() ** 2, minlength=nodes))
    chance *= 2 * _noise_gain(dimension) * noise**2 / 2  # such a product arises from noise alone
    strength, axes = np.linalg.eigh(texture)
    strength = np.maximum(strength - chance[:, None], 0.0)

    patch = np.maximum(volume, 1e-9) if resolution is None else resolution**dimension
    certain = strength * (patch / np.maximum(volume, 1e-9))[:, None] / noise**2
    pixels = points * spacing
    spread = strain_spread(pixels, simplices(cells, dimension), displacement, touched)
    factor = REFINED_MODEL_ERROR if resolution is None else MODEL_ERROR
    model = factor**2 * patch ** (2 / dimension) * spread / dimension
    share = np.minimum(1.0, volume / patch)
    certain = share[:, None] * certain / (1 + model[:, None] * certain)
    return np.einsum("nab,nb,ncb->nac", axes, certain, axes), share, noise
