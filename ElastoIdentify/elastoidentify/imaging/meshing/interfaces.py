"""The borders between labels of a planar labelmap, as a network of smooth curves.

The voxel edges between different labels form a graph of lattice points. It falls into *curves*,
each with one label on its left and one on its right, that end at *anchors*: junctions of three or
more labels, corners, and the places where a border meets the edge of the image. Curves are smoothed
(anchors and straight runs stay where they are), then sampled at the edge length wanted.

Coordinates are continuous indices (x along the last array axis, y along the first; voxel centres at
integers, the outer voxel edges at −0.5 and n − 0.5) until they are scaled by the spacing.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

OUTSIDE = -1  # what lies around the image, told from the background 0

CORNER_ANGLE = 60.0  # degrees; a border that turns more than this within a few voxels has a corner
SHORTEST_ARM = 3  # voxel edges on either side that a corner needs
STRAIGHT_ANGLE = 150.0  # degrees; two branches of a junction at least so open are one line
LARGEST_SHIFT = 0.45  # voxels; below one half, smoothed borders come close but never cross
CLOSE_ANCHORS = 0.35  # of the edge length; nearer ones become one node
OPEN_ANGLE = 30.0  # degrees between the branches of such a node, at least


@dataclass
class Graph:
    """Voxel edges between different labels.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        Lattice points, in continuous indices.
    edges : ndarray of int, shape (m, 2)
    sides : ndarray of int, shape (m, 2)
        Labels left and right of each edge.
    anchors : ndarray of bool, shape (n,)
        Where curves end.
    corners : ndarray of bool, shape (n,)
        Those of the anchors that are sharp corners of a border.
    on_border : ndarray of bool, shape (n, 2)
        Whether x (y) is that of the image's own edge, and so must stay.
    """

    points: np.ndarray
    edges: np.ndarray
    sides: np.ndarray
    anchors: np.ndarray
    corners: np.ndarray
    on_border: np.ndarray


@dataclass
class Network:
    """Smooth curves between labels, and where they are cut into segments.

    Attributes
    ----------
    curves : list of ndarray, shape (k, 2)
        Dense polylines from anchor to anchor; a closed curve without anchor ends where it starts.
    sides : ndarray of int, shape (c, 2)
        Labels left and right of each curve.
    ends : ndarray of int, shape (c, 2)
        Number of the anchor at which each curve starts and stops.
    cuts : list of ndarray
        Arc lengths at which each curve is cut, first and last included.
    """

    curves: list[np.ndarray]
    sides: np.ndarray
    ends: np.ndarray
    cuts: list[np.ndarray]
    sampled: dict[int, np.ndarray] = field(default_factory=dict)  # points of curves at their cuts

    def sample(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points (n, 2), segments (s, 2) and the curve and piece of each segment (s, 2)."""
        for number, (curve, cuts) in enumerate(zip(self.curves, self.cuts, strict=True)):
            if number not in self.sampled:
                self.sampled[number] = equal_area_points(curve, cuts)
        points = np.concatenate([self.sampled[number] for number in range(len(self.curves))])
        counts = np.array([len(cuts) for cuts in self.cuts])
        stop = np.cumsum(counts)
        tips = np.stack([stop - counts, stop - 1], axis=1)  # first and last point of each curve
        inner = np.ones(len(points), bool)
        inner[tips] = False
        anchors = np.zeros((int(self.ends.max()) + 1, 2))
        anchors[self.ends.ravel()] = points[tips.ravel()]
        ids = len(anchors) + np.cumsum(inner) - 1
        ids[tips] = self.ends
        number = np.repeat(np.arange(len(counts)), counts)
        first = np.flatnonzero(number[:-1] == number[1:])  # points with a next one on their curve
        segments = np.stack([ids[first], ids[first + 1]], axis=1)
        pieces = np.stack([number[first], first - tips[number[first], 0]], axis=1)
        return np.concatenate([anchors, points[inner]]), segments, pieces

    def resolve(self, numbers: np.ndarray) -> None:
        """Cut the given curves at all their points, which never cross those of another curve."""
        for number in numbers:
            self.cuts[number] = arc_lengths(self.curves[number])
            self.sampled.pop(number, None)

    def split(self, pieces: np.ndarray) -> None:
        """Cut the given (curve, piece) pairs in two."""
        for number in np.unique(pieces[:, 0]):
            cuts = self.cuts[number]
            piece = pieces[pieces[:, 0] == number, 1]
            self.cuts[number] = np.sort(np.r_[cuts, (cuts[piece] + cuts[piece + 1]) / 2])
            self.sampled.pop(number, None)


def build_network(
    labels: np.ndarray, spacing: np.ndarray, edge_length: float, merge: bool = True
) -> Network:
    """Return the smooth borders of a labelmap (rows, columns), scaled by `spacing` (x, y).

    Unless `merge`, close anchors are left apart: then curves never cross, however ragged they are.
    """
    return network_of(smooth_curves(labels, spacing, edge_length), edge_length, merge)


def smooth_curves(labels: np.ndarray, spacing: np.ndarray, edge_length: float) -> tuple:
    """Return the curves, their sides, their ends and which x (y) of the anchors must stay.

    As in :class:`Network` and :func:`merge_close_anchors`, before anything is merged or cut.
    """
    voxels_per_edge = edge_length / np.sqrt(np.prod(spacing))
    graph = label_graph(labels)
    reach = max(5, round(voxels_per_edge / 2))
    mark_corners(graph, reach)
    smooth = smooth_points(graph, np.clip(1.5 * voxels_per_edge, 8, 24), reach) * spacing
    paths, sides = trace(graph)
    anchors, ends = np.unique([path[[0, -1]] for path in paths], return_inverse=True)
    pinned = graph.on_border[anchors] | graph.corners[anchors, None]
    return [smooth[path] for path in paths], sides, ends.reshape(-1, 2), pinned


def network_of(curves: tuple, edge_length: float, merge: bool = True) -> Network:
    """Return the network of what :func:`smooth_curves` returns, which stays as it is."""
    lines, sides, ends, pinned = curves
    network = Network(list(lines), sides, ends.copy(), [])
    if merge:
        merge_close_anchors(network, pinned.copy(), edge_length)
    network.cuts = regular_cuts(network.curves, network.ends, edge_length)
    return network


def merge_close_anchors(network: Network, pinned: np.ndarray, edge_length: float) -> None:
    """Shrink curves much shorter than an edge to a node, unless that makes a sharp angle.

    A junction of four labels is stored as two junctions of three a voxel apart, and a short edge
    between them would need tiny cells. The end of a thin layer stays: its two sides would meet.
    Corners stay where they are.

    Parameters
    ----------
    network : Network
        Changed in place.
    pinned : ndarray of bool, shape (a, 2)
        Whether x (y) of each anchor must stay.
    """
    lengths = np.array([arc_lengths(curve)[-1] for curve in network.curves])
    merged = np.zeros(len(lengths), bool)
    around: list[set[tuple[int, int]]] = [set() for _ in pinned]  # (curve, end) at each anchor
    for place, anchor in np.ndenumerate(network.ends):
        around[anchor].add(place)
    for short in np.argsort(lengths, kind="stable").tolist():
        if lengths[short] >= CLOSE_ANCHORS * edge_length:
            break
        one, other = network.ends[short]
        joining = {n for n, _ in around[one]} & {n for n, _ in around[other]}
        here, there = network.curves[short][[0, -1]]
        opposed = pinned[one] & pinned[other] & (here != there)
        if (
            one == other
            or len(joining) > 1
            or opposed.any()
            or pinned[one].all()
            or pinned[other].all()
        ):
            continue
        branches = sorted((around[one] | around[other]) - {(short, 0), (short, 1)})
        far = np.array(
            [far_point(network.curves[n][:: 1 - 2 * w], edge_length) for n, w in branches]
        )
        places = [
            np.where(pinned[one], here, np.where(pinned[other], there, place))
            for place in ((here + there) / 2, here, there)
        ]
        bends = np.array([straightest(far - place) for place in places])
        place = places[0 if bends[0] < bends.min() + 5 else bends.argmin()]
        if smallest_opening(far - place) < OPEN_ANGLE:
            continue
        merged[short] = True
        pinned[one] |= pinned[other]
        around[one] = set(branches)
        for number, way in branches:
            curve = network.curves[number][:: 1 - 2 * way]
            near = np.linalg.norm(curve - place, axis=1) < 1.5 * lengths[short]
            near[-1] = False
            curve = np.vstack([place, curve[int(np.argmin(near)) or 1 :]])
            network.curves[number] = curve[:: 1 - 2 * way]
            network.ends[number, way] = one
    network.curves = [c for c, gone in zip(network.curves, merged, strict=True) if not gone]
    network.sides, network.ends = network.sides[~merged], network.ends[~merged]


def far_point(curve: np.ndarray, reach: float) -> np.ndarray:
    """Return the point (2,) of a polyline at the arc length `reach`, or its end."""
    return curve[min(np.searchsorted(arc_lengths(curve), reach), len(curve) - 1)]


def bearings(branches: np.ndarray) -> np.ndarray:
    """Return the directions of vectors (b, 2) in degrees, in rising order."""
    return np.sort(np.degrees(np.arctan2(branches[:, 1], branches[:, 0])))


def smallest_opening(branches: np.ndarray) -> float:
    """Return the smallest angle in degrees between neighbours of the vectors (b, 2)."""
    around = bearings(branches)
    return float(np.diff(np.r_[around, around[0] + 360]).min())


def straightest(branches: np.ndarray) -> float:
    """Return by how many degrees the straightest pair of the vectors (b, 2) is off a line."""
    around = bearings(branches)
    between = np.abs(around[:, None] - around)
    return float(np.abs(180 - between).min())


def label_graph(labels: np.ndarray) -> Graph:
    """Return the voxel edges between different labels of an array (rows, columns)."""
    rows, columns = labels.shape
    padded = np.pad(labels.astype(np.int64), 1, constant_values=OUTSIDE)
    lattice = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    upright = [lattice[:-1], lattice[1:], padded[1:-1, :-1], padded[1:-1, 1:]]
    level = [lattice[:, :-1], lattice[:, 1:], padded[1:, 1:-1], padded[:-1, 1:-1]]
    start, stop, left, right = (
        np.r_[a.ravel(), b.ravel()] for a, b in zip(upright, level, strict=True)
    )
    differs = left != right
    start, stop, left, right = start[differs], stop[differs], left[differs], right[differs]
    junction = np.bincount(np.r_[start, stop], minlength=lattice.size) > 2
    meshed = np.maximum(left, right) > 0
    used, edges = np.unique(np.r_[start[meshed], stop[meshed]], return_inverse=True)
    points = np.c_[used % (columns + 1), used // (columns + 1)] - 0.5
    on_border = (points == -0.5) | (points == [columns - 0.5, rows - 0.5])
    return Graph(
        points,
        edges.reshape(2, -1).T,
        np.c_[left, right][meshed],
        junction[used] | on_border.all(axis=1),
        on_border.all(axis=1),
        on_border,
    )


def trace(graph: Graph) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the node paths from anchor to anchor, then closed paths, with their labels (c, 2).

    A walk is a sequence by nature, hence the loops.
    """
    order = np.argsort(graph.edges.ravel(), kind="stable")
    first = np.searchsorted(graph.edges.ravel()[order], np.arange(len(graph.points) + 1)).tolist()
    around = (order // 2).tolist()
    edges, is_anchor = graph.edges.tolist(), graph.anchors.tolist()
    seen = [False] * len(edges)
    paths, sides = [], []

    def walk(node: int, edge: int) -> None:
        forward = edges[edge][0] == node
        sides.append(graph.sides[edge] if forward else graph.sides[edge][::-1])
        path = [node]
        while not seen[edge]:
            seen[edge] = True
            node = edges[edge][0] + edges[edge][1] - node
            path.append(node)
            if is_anchor[node]:
                break
            one, other = around[first[node]], around[first[node] + 1]
            edge = one + other - edge
        paths.append(np.array(path))

    for node in np.flatnonzero(graph.anchors).tolist():
        for edge in around[first[node] : first[node + 1]]:
            if not seen[edge]:
                walk(node, edge)
    for edge, (node, _) in enumerate(edges):
        if not seen[edge]:
            walk(node, edge)
    return paths, np.array(sides)


def mark_corners(graph: Graph, reach: int) -> None:
    """Make anchors of the nodes where a border turns sharply, and put them where its arms meet.

    The arms have `reach` voxel edges, fewer near an anchor and on small closed curves.
    """
    for path in trace(graph)[0]:
        closed = path[0] == path[-1] and not graph.anchors[path[0]]
        if closed:
            nodes = path[:-1]
            arm = np.full(len(nodes), min(reach, len(nodes) // 8))
        else:
            nodes = path
            arm = np.minimum(reach, np.minimum(np.arange(len(path)), np.arange(len(path))[::-1]))
        points = graph.points[nodes]
        here = np.arange(len(nodes))
        back = points - points[here - arm]
        ahead = points[(here + arm) % len(nodes)] - points
        turn = np.where(arm >= SHORTEST_ARM, angle_between(back, ahead), 0)
        for k in peaks(turn, CORNER_ANGLE, arm, closed):
            around = np.arange(k - arm[k], k + arm[k] + 1) % len(nodes)
            graph.anchors[nodes[k]] = graph.corners[nodes[k]] = True
            graph.points[nodes[k]] = meeting_point(points[around], arm[k])


def angle_between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the angles between the vectors u and v (n, 2) in degrees."""
    cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.degrees(np.arctan2(np.abs(cross), np.einsum("nd,nd->n", u, v)))


def peaks(values: np.ndarray, least: float, distance: np.ndarray, closed: bool) -> list[int]:
    """Return the places of the largest values of at least `least`, each its `distance` apart."""
    found: list[int] = []
    for k in np.argsort(-values, kind="stable").tolist():
        if values[k] < least:
            break
        gaps = np.abs(np.array(found, int) - k)
        if closed:
            gaps = np.minimum(gaps, len(values) - gaps)
        if (gaps >= distance[k]).all():
            found.append(k)
    return found


def meeting_point(points: np.ndarray, middle: int) -> np.ndarray:
    """Return where the lines through the arms before and after node `middle` meet.

    The lines go through the middles of the voxel edges, which takes out the stairs.
    """
    there = points[middle]
    middles = (points[1:] + points[:-1]) / 2
    lines = []
    for arm in (middles[:middle], middles[middle:]):
        centre = arm.mean(axis=0)
        x, y = (arm - centre).T
        angle = np.arctan2(2 * (x @ y), x @ x - y @ y) / 2  # of the longest axis
        normal = np.array([-np.sin(angle), np.cos(angle)])
        lines.append([*normal, normal @ centre])
    lines = np.array(lines)
    if abs(np.linalg.det(lines[:, :2])) < 0.5:
        return there
    meeting = np.linalg.solve(lines[:, :2], lines[:, 2])
    return there + np.clip(meeting - there, -LARGEST_SHIFT, LARGEST_SHIFT)


def smooth_points(graph: Graph, wavelength: float, reach: int) -> np.ndarray:
    """Return the nodes (n, 2) moved onto smooth curves by less than half a voxel.

    Minimises Σ |x − x⁰|² + α Σ |x_i − (x_j + x_k)/2|² over the nodes i with neighbours j, k along a
    curve (Whittaker's smoother): it straightens stairs and, unlike averaging, hardly shrinks.
    α damps waves of `wavelength` nodes by half. Corners stay, and nodes of the image border stay on
    their line.
    """
    node, neighbours = neighbours_along_curves(graph, reach)
    row = np.arange(len(node))
    bend = sparse.csr_matrix(
        (
            np.r_[np.ones(len(node)), np.full(2 * len(node), -0.5)],
            (np.r_[row, row, row], np.r_[node, neighbours[:, 0], neighbours[:, 1]]),
        ),
        shape=(len(node), len(graph.points)),
    )
    alpha = (1 - np.cos(2 * np.pi / wavelength)) ** -2
    system = sparse.identity(len(graph.points)) + alpha * (bend.T @ bend)
    smooth = graph.points.copy()
    for axis in range(2):
        fixed = graph.corners | graph.on_border[:, axis]
        free = np.flatnonzero(~fixed)
        known = system[free][:, fixed] @ graph.points[fixed, axis]
        matrix = system[free][:, free].tocsc()
        smooth[free, axis] = spsolve(matrix, graph.points[free, axis] - known)
    return graph.points + np.clip(smooth - graph.points, -LARGEST_SHIFT, LARGEST_SHIFT)


def neighbours_along_curves(graph: Graph, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes (k,) that lie inside a curve, and their two neighbours along it (k, 2).

    A border that runs straight through a junction counts as one curve there.
    """
    nodes, neighbours = [], []
    branches: dict[int, list[tuple[int, np.ndarray]]] = {}
    for path in trace(graph)[0]:
        nodes.append(path[1:-1])
        neighbours.append(np.c_[path[:-2], path[2:]])
        if path[0] == path[-1] and not graph.anchors[path[0]]:
            nodes.append(path[:1])
            neighbours.append(path[[1, -2]][None])
            continue
        for way in (path, path[::-1]):
            far = graph.points[way[min(reach, len(way) - 1)]] - graph.points[way[0]]
            branches.setdefault(int(way[0]), []).append((int(way[1]), far))
    for node, arms in branches.items():
        if len(arms) != 3:
            continue
        far = np.array([direction for _, direction in arms])
        angles = angle_between(far[[1, 2, 0]], far[[2, 0, 1]])
        if angles.max() >= STRAIGHT_ANGLE:
            through = [arms[k][0] for k in range(3) if k != angles.argmax()]
            nodes.append(np.array([node]))
            neighbours.append(np.array([through]))
    return np.concatenate(nodes), np.vstack(neighbours)


def regular_cuts(curves: list[np.ndarray], ends: np.ndarray, spacing: float) -> list[np.ndarray]:
    """Return the arc lengths that cut each curve into equal pieces of about `spacing`.

    Closed curves get at least three pieces; of several curves that join the same two anchors, each
    gets at least two, or they would be one.
    """
    lengths = [arc_lengths(curve)[-1] for curve in curves]
    pieces = np.maximum(1, np.rint(np.array(lengths) / spacing)).astype(int)
    _, group, count = np.unique(
        np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    pieces = np.where(count[group.ravel()] > 1, np.maximum(pieces, 2), pieces)
    pieces = np.where(ends[:, 0] == ends[:, 1], np.maximum(pieces, 3), pieces)
    return [np.linspace(0, s, n + 1) for s, n in zip(lengths, pieces, strict=True)]


def arc_lengths(curve: np.ndarray) -> np.ndarray:
    """Return the arc length at each point of a polyline (k, 2), from 0. Shape (k,)."""
    arc = np.zeros(len(curve))
    step = curve[1:] - curve[:-1]
    np.cumsum(np.sqrt(step[:, 0] ** 2 + step[:, 1] ** 2), out=arc[1:])
    return arc


def equal_area_points(curve: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """Return points (p, 2) near the given arc lengths whose polygon has the area of the curve.

    A polygon inscribed into a curve loses the slivers between arc and chord. Each inner point is
    moved along the normal by half of both slivers next to it over half the chord of its neighbours,
    which gives the area back and keeps straight curves as they are.
    """
    arc = arc_lengths(curve)
    x, y = np.interp(cuts, arc, curve[:, 0]), np.interp(cuts, arc, curve[:, 1])
    # Signed area swept from the origin along the curve, at its points and at the cuts.
    (u, v), (x0, y0) = (curve - curve[0]).T, curve[0]
    swept = np.zeros(len(arc))
    np.cumsum((u[:-1] * v[1:] - u[1:] * v[:-1]) / 2, out=swept[1:])
    at = np.minimum(np.searchsorted(arc, cuts, side="right") - 1, len(arc) - 1)
    at_cuts = swept[at] + (u[at] * (y - y0) - v[at] * (x - x0)) / 2
    chord = ((x[:-1] - x0) * (y[1:] - y0) - (x[1:] - x0) * (y[:-1] - y0)) / 2
    sliver = at_cuts[1:] - at_cuts[:-1] - chord  # positive when the curve runs right of its chord
    reach_x, reach_y = x[2:] - x[:-2], y[2:] - y[:-2]
    length2 = np.maximum(reach_x**2 + reach_y**2, 1e-300)
    share = np.minimum(np.maximum((sliver[:-1] + sliver[1:]) / length2, -0.25), 0.25)
    x[1:-1] += share * reach_y
    y[1:-1] -= share * reach_x
    return np.stack([x, y], axis=1)
