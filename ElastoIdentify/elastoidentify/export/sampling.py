"""A map on an image's grid: every voxel takes the value of the cell that its centre lies in.

Exact: no interpolation and no smoothing. Cells are mapped to index coordinates, in which voxel
centres are whole numbers, so oblique images cost nothing extra. The candidates of a cell are the
voxel centres in its bounding box; each is brought to the cell's reference coordinates by Newton's
method, which for triangles and tetrahedra is done after one step.
"""

import numpy as np

from ..errors import InputError
from ..fem.elements import CELL_TYPES
from ..fem.mesh import plane_frame
from ..imaging.image import Image

OUTSIDE = -1
INSIDE = 1e-9  # of a cell: what a centre on a cell's side may be off by round-off
AT_ONCE = 2_000_000  # candidates tested together
STEPS = 25  # of Newton's method


def cell_of_voxels(image: Image, points: np.ndarray, blocks) -> np.ndarray:
    """Return in which cell the centre of every voxel lies.

    Parameters
    ----------
    image : Image
        Its grid is used only.
    points : (n, 3)
        Nodes in the image's world.
    blocks : list of (kind, (m, k) int)
        Triangles and quads of one plane, or tetrahedra and hexahedra. A planar mesh may lie in a
        slice of a volume or cross it obliquely: it is seen by the voxels that its plane passes
        through nearest to their centre, one per column across the plane.

    Returns
    -------
    cells : (nk, nj, ni) int32
        Numbers of cells in the order of `blocks`, -1 outside. On a side between two cells the one
        of the lower number.

    Raises
    ------
    InputError
        When no voxel lies in the mesh.
    """
    index = image.world_to_index(points)
    planar = blocks[0][0] in ("triangle", "quad")
    across = _most_normal_axis(image, points) if planar else None
    axes = [axis for axis in range(3) if axis != across]
    size = np.array(image.size)
    found = np.full(size[axes], OUTSIDE, np.int32)  # in the order of the axes i, j (, k)
    first = 0
    for kind, nodes in blocks:
        _locate(found, CELL_TYPES[kind], index[:, axes][np.asarray(nodes)], first)
        first += len(nodes)
    cells = _on_the_plane(found, index, across, size) if planar else found
    if not (cells >= 0).any():
        raise InputError(
            "no voxel of the image lies in the mesh: take the image on which the mesh was made"
        )
    return np.ascontiguousarray(cells.T)


def sample(cells: np.ndarray, values: np.ndarray, outside=np.nan) -> np.ndarray:
    """Return the value of every voxel's cell, `outside` where there is none.

    Parameters
    ----------
    cells : (nk, nj, ni) int
        See :func:`cell_of_voxels`.
    values : (n_cells,)
    """
    values = np.asarray(values)
    return np.where(cells >= 0, values[np.maximum(cells, 0)], np.asarray(outside, values.dtype))


def _most_normal_axis(image: Image, points: np.ndarray) -> int:
    """Return the image axis along which the mesh's plane is crossed most directly."""
    if image.planar_axis is not None:
        return image.planar_axis
    normal = np.cross(*plane_frame(points)[1].T)
    return int(np.abs(normal @ image.direction).argmax())


def _on_the_plane(found, index, across, size) -> np.ndarray:
    """Put columns' cells where the mesh's plane crosses the columns: (ni, nj, nk)."""
    along = [axis for axis in range(3) if axis != across]
    design = np.column_stack([index[:, along], np.ones(len(index))])
    slope = np.linalg.lstsq(design, index[:, across], rcond=None)[0]
    columns = np.argwhere(found >= 0)
    layer = np.rint(np.column_stack([columns, np.ones(len(columns))]) @ slope).astype(int)
    seen = (layer >= 0) & (layer < size[across])
    columns, layer = columns[seen], layer[seen]
    cells = np.full(size, OUTSIDE, np.int32)
    place = np.insert(columns, across, layer, axis=1)
    cells[tuple(place.T)] = found[tuple(columns.T)]
    return cells


def _locate(found, kind, corners, first) -> None:
    """Write the numbers of cells, from `first`, at the whole points that lie in them.

    Parameters
    ----------
    found : (n_0, n_1[, n_2]) int, changed
    kind : CellType
    corners : (m, k, d)
        In index coordinates.
    """
    low = np.maximum(np.ceil(corners.min(axis=1) - 1e-6), 0).astype(np.int64)
    high = np.minimum(np.floor(corners.max(axis=1) + 1e-6), np.array(found.shape) - 1)
    width = np.maximum(high.astype(np.int64) - low + 1, 0)
    count = width.prod(axis=1)
    ends = np.cumsum(count)
    start = 0
    while start < len(corners):
        before = ends[start] - count[start]
        stop = max(int(np.searchsorted(ends, before + AT_ONCE)), start + 1)
        cells, places = _candidates(low[start:stop], width[start:stop], count[start:stop])
        inside = _inside(kind, corners[start:stop], cells, places)
        places, cells = places[inside], cells[inside] + start + first
        flat = np.ravel_multi_index(tuple(places.T), found.shape)
        order = np.argsort(-cells, kind="stable")  # the lowest number is written last, and stays
        flat, cells = flat[order], cells[order]
        free = found.flat[flat] == OUTSIDE
        found.flat[flat[free]] = cells[free]
        start = stop


def _candidates(low, width, count):
    """Return (cell, whole point) of all points in the cells' boxes: (c,) and (c, d)."""
    cells = np.repeat(np.arange(len(count)), count)
    rest = np.arange(len(cells)) - np.repeat(np.cumsum(count) - count, count)
    places = np.empty((len(cells), low.shape[1]), np.int64)
    for axis in range(low.shape[1]):
        rest, within = np.divmod(rest, width[cells, axis])
        places[:, axis] = low[cells, axis] + within
    return cells, places


def _inside(kind, corners, cells, places) -> np.ndarray:
    """Tell which points lie in their cells; by Newton's method for x(ξ) = Σ_a N_a(ξ) x_a."""
    xi = np.broadcast_to(kind.corners.mean(axis=0), places.shape).copy()
    simplex = kind.n_nodes == kind.dim + 1
    active = np.arange(len(cells))
    for _ in range(1 if simplex else STEPS):
        nodes, at = corners[cells[active]], xi[active]
        miss = places[active] - np.einsum("ca,cai->ci", kind.values(at), nodes)
        slope = np.einsum("cai,caj->cij", nodes, kind.gradients(at))
        step = np.linalg.solve(slope, miss[..., None])[..., 0]
        # far outside of the cell the map may fold; such a point is outside whatever comes
        xi[active] = at + step if simplex else np.clip(at + step, -3.0, 3.0)
        active = active[np.abs(step).max(axis=1, initial=0.0) > 1e-12]
        if not len(active):
            break
    if simplex:
        return (xi >= -INSIDE).all(axis=1) & (xi.sum(axis=1) <= 1 + INSIDE)
    return (np.abs(xi) <= 1 + INSIDE).all(axis=1)
