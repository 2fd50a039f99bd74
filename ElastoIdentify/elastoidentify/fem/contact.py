"""Two labels that slide on each other without friction: nodes split along their interface.

Each side has nodes of its own there, at the same places at rest. Which ones touch is found again
from the mesh alone, so that nothing has to travel with it.
"""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from .mesh import Mesh
from .soundness import Blocks, coincident, sides

Pairs = Sequence[tuple[int, int]]

CORNER = np.tan(np.radians(45) / 2) ** 2
"""Where the normals of an interface's sides turn by more than 45° in a node, it cannot slide: the
second eigenvalue of their mean outer product over the first is tan² of half that angle."""


def are_pairs(a: np.ndarray, b: np.ndarray, pairs: Pairs) -> np.ndarray:
    """Tell which labels a (n,), b (n,) are one of the pairs, in either order. (n,) bool"""
    found = np.zeros(np.shape(a), bool)
    for first, second in pairs:
        found |= (a == first) & (b == second) | (a == second) & (b == first)
    return found


def split_nodes(cells: np.ndarray, labels: np.ndarray, pairs: Pairs):
    """Give each side of the interfaces between pairs of labels nodes of its own.

    Cells around a node stay together where they share a side that is no such interface: at the
    end of an interface inside the body, both sides keep one node.

    Parameters
    ----------
    cells : (m, k) int
        Simplices.
    labels : (m,) int
    pairs : sequence of (label, label)

    Returns
    -------
    cells : (m, k) int
        The first of a place's nodes keeps its number.
    origin : (n_new,) int
        The old number of each node.
    """
    m, k = cells.shape
    found = sides([({3: "triangle", 4: "tetra"}[k], cells)])
    order = np.argsort(found.group, kind="stable")
    same = found.group[order][1:] == found.group[order][:-1]
    one, other = order[:-1][same], order[1:][same]
    slips = are_pairs(labels[found.owner[one]], labels[found.owner[other]], pairs)
    old = np.arange(cells.max() + 1)
    touched = np.unique(found.corners[one[slips]])
    if not slips.any():
        return cells, old

    # corners of cells, of which those that share a side that does not slip are one node
    first, second = found.owner[one[~slips]], found.owner[other[~slips]]
    nodes = found.corners[one[~slips]][:, : k - 1]
    here = np.isin(nodes, touched)
    cell_a, cell_b = (np.repeat(c[:, None], k - 1, axis=1)[here] for c in (first, second))
    nodes = nodes[here]
    corner_a, corner_b = (
        c * k + np.argmax(cells[c] == nodes[:, None], axis=1) for c in (cell_a, cell_b)
    )
    graph = sp.coo_matrix((np.ones(len(nodes)), (corner_a, corner_b)), (m * k, m * k))
    _, piece = connected_components(graph, directed=False)
    flat = cells.ravel()
    at = np.flatnonzero(np.isin(flat, touched))
    # by node, then piece; the first piece of a node keeps its number
    keys, inverse = np.unique(np.column_stack([flat[at], piece[at]]), axis=0, return_inverse=True)
    is_first = np.concatenate([[True], keys[1:, 0] != keys[:-1, 0]])
    number = np.where(is_first, keys[:, 0], len(old) + np.cumsum(~is_first) - 1)
    flat = flat.copy()
    flat[at] = number[inverse.ravel()]
    return flat.reshape(m, k), np.concatenate([old, keys[~is_first, 0]])


def touching(mesh: Mesh, labels: np.ndarray, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """Find the nodes that touch across the interfaces of pairs of labels.

    Returns
    -------
    nodes : (p, 2) int
        Coincident nodes of the two sides; none where both sides have one node.
    normals : (p, d, d)
        Sum of n nᵀ over the sides of the interface around them, weighted by their size.
    """
    blocks = [(b.cell.name, b.nodes) for b in mesh.blocks]
    owners = np.concatenate([b.ids for b in mesh.blocks])
    found = sides(blocks)
    label, d = labels[owners][found.owner], mesh.dim
    open_ = (np.bincount(found.group) == 1)[found.group] & np.isin(label, np.ravel(pairs))
    corners, label = found.corners[open_], label[open_]
    none = np.zeros((0, 2), int), np.zeros((0, d, d))
    if not len(corners):
        return none
    place = np.append(coincident(mesh.points, blocks), -1)
    key = np.sort(place[corners], axis=1)
    order = np.lexsort(key.T[::-1])
    same = (key[order][1:] == key[order][:-1]).all(axis=1)
    one, other = order[:-1][same], order[1:][same]
    keep = are_pairs(label[one], label[other], pairs)
    one, other = corners[one[keep]], corners[other[keep]]
    if not len(one):
        return none
    normal = _normals(mesh.points, one)  # as long as the side is large
    weight = np.linalg.norm(normal, axis=1)
    tensor = normal[:, :, None] * normal[:, None, :] / weight[:, None, None]
    # the corner of the other side at the same place
    match = np.argmax(place[one][:, :, None] == place[other][:, None, :], axis=2)
    opposite = np.take_along_axis(other, match, axis=1)
    real = one >= 0
    ends = np.sort(np.stack([one[real], opposite[real]], axis=1), axis=1)
    tensor = np.repeat(tensor[:, None], one.shape[1], axis=1)[real]
    apart = ends[:, 0] != ends[:, 1]
    nodes, inverse = np.unique(ends[apart], axis=0, return_inverse=True)
    normals = np.zeros((len(nodes), d, d))
    np.add.at(normals, inverse.ravel(), tensor[apart])
    return nodes, normals


def border_normals(mesh: Mesh, among: np.ndarray) -> np.ndarray:
    """Return Σ n nᵀ over the border's sides all of whose nodes are `among`, (n_nodes, d, d).

    Parameters
    ----------
    among : (n_nodes,) bool
    """
    found = sides([(b.cell.name, b.nodes) for b in mesh.blocks])
    inside = np.append(among, True)[found.corners].all(axis=1)
    corners = found.corners[inside & (np.bincount(found.group) == 1)[found.group]]
    total = np.zeros((mesh.n_nodes, mesh.dim, mesh.dim))
    if len(corners):
        normal = _normals(mesh.points, corners)
        tensor = normal[:, :, None] * normal[:, None, :]
        tensor /= np.linalg.norm(normal, axis=1)[:, None, None]
        real = corners >= 0
        np.add.at(total, corners[real], np.repeat(tensor[:, None], corners.shape[1], axis=1)[real])
    return total


def blocked(tensors: np.ndarray) -> np.ndarray:
    """Return projections (n, d, d) on the directions across a surface, from Σ n nᵀ (n, d, d).

    One direction where the surface is smooth, more in its corners, none where the sum is zero.
    """
    values, vectors = np.linalg.eigh(tensors)
    chosen = (values > CORNER * values[:, -1:]) & (values[:, -1:] > 0)
    return np.einsum("nik,nk,njk->nij", vectors, chosen.astype(float), vectors)


def on_two_sides(n_nodes: int, blocks: Blocks, labels: np.ndarray, pairs: Pairs):
    """Return a function that tells which pairs of nodes (p, 2) belong to the two sides of a slip.

    Parameters
    ----------
    labels : (m,) int
        In the order of the blocks' cells.
    """
    node = np.concatenate([nodes.ravel() for _, nodes in blocks])
    count = [np.full(len(nodes), nodes.shape[1]) for _, nodes in blocks]
    label = np.repeat(labels, np.concatenate(count))
    has = {one: np.zeros(n_nodes, bool) for one in np.unique(pairs).tolist()}
    for one, here in has.items():
        here[node[label == one]] = True

    def tell(nodes):
        found = np.zeros(len(nodes), bool)
        for a, b in pairs:
            only_a, only_b = has[a] & ~has[b], has[b] & ~has[a]
            for first, second in (nodes.T, nodes.T[::-1]):
                found |= only_a[first] & only_b[second]
        return found

    return tell


def _normals(points, corners):
    """Normals of sides (s, 2 or 4), as long as the sides are large. (s, d)"""
    x = points[corners]
    if points.shape[1] == 2:
        along = x[:, 1] - x[:, 0]
        return np.column_stack([-along[:, 1], along[:, 0]])
    last = np.where((corners[:, 3] >= 0)[:, None], x[:, 3], x[:, 0])
    return np.cross(x[:, 2] - x[:, 0], last - x[:, 1]) / 2
