"""Conforming triangles between the borders of a planar labelmap.

The borders come as segments (`interfaces`). Points inside are laid on a hexagonal lattice, relaxed,
and triangulated after Delaunay; segments that the triangulation does not contain are split. Which
label a triangle has follows exactly from the segments around it, never from a voxel under it.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, cKDTree

from ...progress import Progress, silent
from .interfaces import Network, build_network
from .quality import triangle_angles, triangle_areas

RELAXATIONS = 12
GOOD_ANGLE = 27.0  # degrees; triangles below it are refined
ROUNDS = 25


def mesh_triangles(
    labels: np.ndarray, spacing: np.ndarray, edge_length: float, progress: Progress = silent
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

    Points are in scaled indices: voxel (row, column) has its centre at (column, row) · spacing.
    """
    progress(0.0, "Borders between labels")
    network = build_network(labels, spacing, edge_length)
    part_crossing_segments(network)
    progress(0.2, "Nodes inside the labels")
    fixed, segments, pieces = network.sample()
    inner = lattice_points(labels, spacing, edge_length)
    frame = frame_points(labels.shape, spacing, edge_length)
    for step in range(ROUNDS):
        fixed, segments, pieces = network.sample()
        inner = clear_of_segments(inner, fixed, segments, edge_length)
        if step < RELAXATIONS:
            inner = relax(fixed, inner, frame, edge_length)
            inner = clear_of_segments(inner, fixed, segments, edge_length)
        points = np.vstack([fixed, inner, frame])
        triangles = delaunay(points)
        missing = ~contains_edges(triangles, segments, len(points))
        progress(0.2 + 0.7 * step / ROUNDS, "Triangles")
        if missing.any():
            network.split(pieces[missing])
        elif step >= RELAXATIONS:
            break
    label = classify(triangles, segments, network.sides[pieces[:, 0]], len(points))
    keep = label > 0
    used, triangles = np.unique(triangles[keep], return_inverse=True)
    progress(1.0, "Triangles")
    return points[used], triangles.reshape(-1, 3), label[keep]


def lattice_points(labels: np.ndarray, spacing: np.ndarray, edge_length: float) -> np.ndarray:
    """Return the points (n, 2) of a hexagonal lattice that lie in labels above 0."""
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


def relax(
    fixed: np.ndarray, inner: np.ndarray, frame: np.ndarray, edge_length: float
) -> np.ndarray:
    """Return the inner points moved to the middle of their neighbours."""
    points = np.vstack([fixed, inner, frame])
    first, second = unique_edges(delaunay(points)).T
    total = np.zeros_like(points)
    for axis in range(2):
        total[:, axis] = np.bincount(first, points[second, axis], len(points))
        total[:, axis] += np.bincount(second, points[first, axis], len(points))
    count = np.bincount(np.r_[first, second], minlength=len(points))
    mean = total / np.maximum(count, 1)[:, None]
    return mean[len(fixed) : len(fixed) + len(inner)]


def delaunay(points: np.ndarray) -> np.ndarray:
    """Return the Delaunay triangles (m, 3), counter-clockwise, without slivers of no area."""
    triangles = Delaunay(points).simplices
    area = triangle_areas(points, triangles)
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    return triangles[np.abs(area) > 1e-12 * np.ptp(points, axis=0).prod()]


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


def part_crossing_segments(network: Network) -> None:
    """Cut curves finer where their chords cross or touch each other."""
    for _ in range(6):
        points, segments, pieces = network.sample()
        crossing = crossing_segments(points, segments)
        if not len(crossing):
            return
        network.split(pieces[crossing])


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
) -> np.ndarray:
    """Return the label of each triangle (m,) from the labels left and right of the segments.

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
    return names[np.asarray(votes.argmax(axis=1)).ravel()][region]
