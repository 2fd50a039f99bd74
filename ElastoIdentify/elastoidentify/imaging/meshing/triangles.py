"""Conforming triangles between the borders of a planar labelmap.

The borders come as segments (`interfaces`). Points inside are laid on a hexagonal lattice, relaxed,
and triangulated after Delaunay; segments that the triangulation does not contain are split. Which
label a triangle has follows exactly from the segments around it, never from a voxel under it.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, cKDTree

from ...errors import InputError
from ...progress import Progress, part, silent
from .grading import at, wanted_edges
from .interfaces import Network, network_of, smooth_curves
from .quality import triangle_angles, triangle_areas

RELAXATIONS = 5
REFINEMENTS = 60  # rounds until all borders are in the triangulation; a handful are usual
ENOUGH_REFINEMENTS = 30  # rounds after which small angles are left
GOOD_ANGLE = 26.0  # degrees; triangles below it are refined
SHORTEST = 0.2  # segments are split down to this share of the edge length


def mesh_triangles(
    labels: np.ndarray,
    spacing: np.ndarray,
    edge_length: float,
    progress: Progress = silent,
    grading: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (n, 2), triangles (m, 3) counter-clockwise and their labels (m,).

    Parameters
    ----------
    labels : ndarray of int, shape (rows, columns)
        0 is background and is not meshed.
    spacing : ndarray, shape (2,)
        Voxel size along the columns (x) and rows (y).
    edge_length : float
        In the unit of `spacing`.
    grading : float
        How many times longer edges may be away from borders.

    Points are in scaled indices: voxel (row, column) has its centre at (column, row) · spacing.
    """
    progress(0.0, "Borders between labels")
    curves = smooth_curves(labels, spacing, edge_length)
    network = network_of(curves, edge_length)
    if not parted(network):
        network = network_of(curves, edge_length, merge=False)
        parted(network)
    fixed, segments, _ = network.sample()
    frame = frame_points(labels.shape, spacing, edge_length)
    inner = lattice_points(labels, spacing, edge_length, grading)
    inner = clear_of_segments(inner, fixed, segments, edge_length)
    for step in range(RELAXATIONS):
        progress(0.1 + 0.4 * step / RELAXATIONS, "Nodes inside the labels")
        inner = relax(fixed, inner, frame)
        inner = clear_of_segments(inner, fixed, segments, edge_length)
    points, triangles, label = refine(network, inner, frame, edge_length, part(progress, 0.5, 1.0))
    keep = label > 0
    used, triangles = np.unique(triangles[keep], return_inverse=True)
    return points[used], triangles.reshape(-1, 3), label[keep]


def refine(
    network: Network,
    inner: np.ndarray,
    frame: np.ndarray,
    edge_length: float,
    progress: Progress = silent,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add nodes until the triangles hold every segment and have no small angle.

    Delaunay refinement after Ruppert (J. Algorithms 18, 1995): a poor triangle gets a node at the
    centre of its circumcircle, unless that comes too near to a segment, which is split instead.

    Returns
    -------
    points (n, 2), triangles (m, 3) and their labels (m,), 0 outside.

    Raises
    ------
    InputError
        If segments remain missing, however often they are split.
    """
    for step in range(REFINEMENTS):
        progress(step / REFINEMENTS, "Triangles")
        fixed, segments, pieces = network.sample()
        inner = inner[~encroached(inner, fixed, segments).any(axis=1)]
        points = np.vstack([fixed, inner, frame])
        triangulation = Delaunay(points)
        triangles = counterclockwise(points, triangulation.simplices)
        missing = ~contains_edges(triangles, segments, len(points))
        if missing.any():
            network.split(pieces[missing])
            continue
        region, label = classify(triangles, segments, network.sides[pieces[:, 0]], len(points))
        added, split = improvements(triangulation, region, label, fixed, segments)
        length = np.linalg.norm(np.diff(fixed[segments[split]], axis=1)[:, 0], axis=1)
        split = split[length > 2 * SHORTEST * edge_length]
        if not (len(added) or len(split)) or step >= ENOUGH_REFINEMENTS:
            return points, triangles, label
        network.split(pieces[split])
        inner = np.vstack([inner, added])
    raise InputError(
        "the borders between labels are too ragged for triangles: smooth the segmentation or use "
        "a smaller edge length"
    )


def lattice_points(
    labels: np.ndarray, spacing: np.ndarray, edge_length: float, grading: float = 1.0
) -> np.ndarray:
    """Return the points (n, 2) of a hexagonal lattice that lie in labels above 0.

    Of a hexagonal lattice every second point along both of its axes makes one of twice the edge.
    Where edges may be 2ˡ times longer, only points of the l-th of these are returned.
    """
    low, high = -0.5 * spacing, (np.array(labels.shape[::-1]) - 0.5) * spacing
    x, y = np.meshgrid(
        np.arange(low[0], high[0] + edge_length, edge_length),
        np.arange(low[1], high[1] + edge_length, edge_length * np.sqrt(3) / 2),
    )
    x[1::2] += edge_length / 2
    points = np.c_[x.ravel(), y.ravel()]
    column, row = np.rint(points / spacing).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < labels.shape[1]) & (row < labels.shape[0])
    inside[inside] = labels[row[inside], column[inside]] > 0
    if grading >= 2:
        line, place = np.indices(x.shape).reshape(2, -1)
        room = at(wanted_edges(labels, spacing, edge_length, grading), spacing, points)
        side = 2 ** np.log2(room).astype(int)
        inside &= (line % side == 0) & ((place - line // 2) % side == 0)
    return points[inside]


def frame_points(shape: tuple[int, ...], spacing: np.ndarray, edge_length: float) -> np.ndarray:
    """Return points around the image, so that no segment lies on the hull of all points."""
    low, high = -0.5 * spacing, (np.array(shape[::-1]) - 0.5) * spacing
    margin = 2 * edge_length
    low, high = low - margin, high + margin
    count = np.maximum(2, np.ceil((high - low) / margin).astype(int))
    x, y = (np.linspace(low[k], high[k], count[k]) for k in range(2))
    sides = [
        np.c_[x, np.full_like(x, low[1])],
        np.c_[x, np.full_like(x, high[1])],
        np.c_[np.full_like(y, low[0]), y][1:-1],
        np.c_[np.full_like(y, high[0]), y][1:-1],
    ]
    return np.vstack(sides)


def clear_of_segments(
    inner: np.ndarray, fixed: np.ndarray, segments: np.ndarray, edge_length: float
) -> np.ndarray:
    """Return the inner points that are clear of the segments and of each other."""
    if not len(inner):
        return inner
    middle = fixed[segments].mean(axis=1)
    length = np.linalg.norm(np.diff(fixed[segments], axis=1)[:, 0], axis=1)
    tree = cKDTree(middle)
    distance, nearest = tree.query(inner)
    clear = distance > 0.55 * np.minimum(length[nearest], edge_length)
    clear &= cKDTree(fixed).query(inner)[0] > 0.5 * edge_length
    inner = inner[clear]
    pairs = cKDTree(inner).query_pairs(0.5 * edge_length, output_type="ndarray")
    return np.delete(inner, np.unique(pairs[:, 1]), axis=0)


def encroached(places: np.ndarray, fixed: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Return which places (n, 2) lie in the circle about which of the segments near them.

    Returns an array of bool, shape (n, k), for the k segments whose middles are nearest; see
    `nearest_segments`.
    """
    distance, nearest = nearest_segments(places, fixed, segments)
    length = np.linalg.norm(np.diff(fixed[segments], axis=1)[:, 0], axis=1)
    return distance < 0.5 * length[nearest]


def nearest_segments(
    places: np.ndarray, fixed: np.ndarray, segments: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return distance and number of the segments with the nearest middles, nearest first (n, k)."""
    k = np.arange(1, min(6, len(segments)) + 1)
    return cKDTree(fixed[segments].mean(axis=1)).query(places.reshape(-1, 2), k)


def improvements(
    triangulation: Delaunay,
    region: np.ndarray,
    label: np.ndarray,
    fixed: np.ndarray,
    segments: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes to add (a, 2), and the segments to split (s,), that mend the poor triangles."""
    points, triangles = triangulation.points, triangulation.simplices
    angles = triangle_angles(points, triangles)
    poor = np.flatnonzero((label > 0) & (angles.min(axis=1) < GOOD_ANGLE))
    poor = poor[np.argsort(angles[poor].min(axis=1))]
    if not len(poor):
        return np.empty((0, 2)), np.empty(0, int)
    centre, radius = circumcircles(points[triangles[poor]])
    close = encroached(centre, fixed, segments)
    near = nearest_segments(centre, fixed, segments)[1]
    inside = triangulation.find_simplex(centre)
    stays = (inside >= 0) & (region[inside] == region[poor])
    blocked = close.any(axis=1) | ~stays
    first = np.where(close.any(axis=1), close.argmax(axis=1), 0)
    split = np.unique(near[blocked, first[blocked]])
    centre, radius = centre[~blocked], radius[~blocked]
    return centre[apart(centre, radius)], split


def circumcircles(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return centres (m, 2) and radii (m,) of the circles through the corners (m, 3, 2)."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    uu, vv = np.einsum("md,md->m", u, u), np.einsum("md,md->m", v, v)
    double = 2 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    offset = np.c_[v[:, 1] * uu - u[:, 1] * vv, u[:, 0] * vv - v[:, 0] * uu] / double[:, None]
    return corners[:, 0] + offset, np.linalg.norm(offset, axis=1)


def apart(centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return which of the circles, first ones first, have no earlier kept centre inside. (n,)."""
    kept = np.ones(len(centre), bool)
    if len(centre) > 1:
        pairs = cKDTree(centre).query_pairs(radius.max(), output_type="ndarray")
        for first, second in pairs[np.lexsort(pairs.T)].tolist():
            distance = np.linalg.norm(centre[first] - centre[second])
            if kept[first] and kept[second] and distance < max(radius[first], radius[second]):
                kept[second] = False
    return kept


def relax(fixed: np.ndarray, inner: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Return the inner points moved twice to the middle of their neighbours."""
    points = np.vstack([fixed, inner, frame])
    first, second = unique_edges(Delaunay(points).simplices).T
    ends, starts = np.r_[first, second], np.r_[second, first]
    total = sparse.csr_matrix((np.ones(len(ends)), (ends, starts)), shape=(len(points),) * 2)
    count = np.bincount(ends, minlength=len(points))[:, None]
    moving = slice(len(fixed), len(fixed) + len(inner))
    for _ in range(2):
        points[moving] = ((total @ points) / np.maximum(count, 1))[moving]
    return points[moving]


def counterclockwise(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the triangles (m, 3), those turned that run clockwise."""
    clockwise = triangle_areas(points, triangles) < 0
    return np.where(clockwise[:, None], triangles[:, ::-1], triangles)


def unique_edges(triangles: np.ndarray) -> np.ndarray:
    """Return the edges (e, 2), each once, lower node first."""
    edges = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]))
    n = int(edges.max()) + 1
    keys = np.unique(edges[:, 0] * n + edges[:, 1])
    return np.c_[keys // n, keys % n]


def contains_edges(triangles: np.ndarray, segments: np.ndarray, count: int) -> np.ndarray:
    """Return which segments (s, 2) are edges of the triangles of `count` points. Shape (s,)."""
    edges = unique_edges(triangles)
    low, high = np.sort(segments).T
    return np.isin(low * count + high, edges[:, 0] * count + edges[:, 1])


def parted(network: Network) -> bool:
    """Cut curves finer where their chords cross or touch each other. Returns whether none do."""
    for halving in range(5):
        points, segments, pieces = network.sample()
        crossing = pieces[crossing_segments(points, segments)]
        if not len(crossing):
            return True
        if halving < 3:
            network.split(crossing)
        else:
            network.resolve(np.unique(crossing[:, 0]))
    return False


def crossing_segments(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Return the indices of segments that cross another one with which they share no node."""
    ends = points[segments]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    pairs = cKDTree(ends.mean(axis=1)).query_pairs(length.max(), output_type="ndarray")
    first, second = segments[pairs].transpose(1, 0, 2)
    shared = (first[:, :, None] == second[:, None, :]).any(axis=(1, 2))
    pairs = pairs[~shared]
    (a, b), (c, d) = ends[pairs].transpose(1, 2, 0, 3)

    def side(p, q, r):
        return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])

    cross = (side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)
    return np.unique(pairs[cross])


def classify(
    triangles: np.ndarray, segments: np.ndarray, sides: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return region and label of each triangle (m,) from the labels left and right of segments.

    Triangles that meet across an edge that is no segment form one region; each segment tells the
    label of the region on either side.
    """
    start = triangles.ravel()
    stop = triangles[:, [1, 2, 0]].ravel()
    owner = np.repeat(np.arange(len(triangles)), 3)
    edge, twin = start * count + stop, stop * count + start
    order = np.argsort(edge)
    place = np.minimum(np.searchsorted(edge[order], twin), len(edge) - 1)
    has_twin = edge[order][place] == twin
    across = owner[order][place]
    left = segments[:, 0] * count + segments[:, 1]
    right = segments[:, 1] * count + segments[:, 0]
    is_segment = np.isin(edge, np.r_[left, right])
    free = has_twin & ~is_segment
    links = sparse.coo_matrix(
        (np.ones(free.sum()), (owner[free], across[free])), shape=(len(triangles),) * 2
    )
    count_regions, region = connected_components(links, directed=False)
    keys, labels = np.r_[left, right], np.r_[sides[:, 0], sides[:, 1]]
    place = np.minimum(np.searchsorted(edge[order], keys), len(edge) - 1)
    found = edge[order][place] == keys
    told = region[owner[order][place[found]]]
    names, number = np.unique(labels[found], return_inverse=True)
    votes = sparse.coo_matrix(
        (np.ones(len(told)), (told, number)), shape=(count_regions, len(names))
    ).tocsr()
    return region, names[np.asarray(votes.argmax(axis=1)).ravel()][region]
