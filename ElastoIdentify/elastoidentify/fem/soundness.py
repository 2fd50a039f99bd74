"""Whether a mesh from elsewhere is one body: seams, pieces, overlaps, and fields that fit it.

Blocks are ``(kind, nodes (m, k))`` as everywhere; cells are numbered through them in turn.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .elements import CELL_TYPES

Blocks = Sequence[tuple[str, np.ndarray]]


@dataclass
class Sides:
    """Every side (2-D: edge, 3-D: face) of every cell.

    Attributes
    ----------
    owner : (s,) int
        Cell of each side.
    corners : (s, 2 or 4) int
        Nodes, −1 where a face has three.
    group : (s,) int
        The same number for the same side of two cells.
    """

    owner: np.ndarray
    corners: np.ndarray
    group: np.ndarray


def sides(blocks: Blocks) -> Sides:
    """Return the sides of all cells."""
    owners, corners, start = [], [], 0
    width = 2 if CELL_TYPES[blocks[0][0]].dim == 2 else 4
    for kind, nodes in blocks:
        for face in CELL_TYPES[kind].faces:
            padded = np.full((len(nodes), width), -1)
            padded[:, : len(face)] = nodes[:, face]
            owners.append(start + np.arange(len(nodes)))
            corners.append(padded)
        start += len(nodes)
    owner, corner = np.concatenate(owners), np.concatenate(corners)
    return Sides(owner, corner, _groups(np.sort(corner, axis=1)))


def _groups(rows: np.ndarray) -> np.ndarray:
    """Return a number for each row (n, 2 or 4), the same for equal rows. Shape (n,).

    As np.unique with an axis, which takes a hundred times as long: two columns make one key.
    """
    base = int(rows.max(initial=0)) + 2
    keys = [(rows[:, k] + 1) * base + rows[:, k + 1] + 1 for k in range(0, rows.shape[1], 2)]
    order = np.lexsort(keys[::-1])
    new = np.zeros(len(rows), bool)
    for key in keys:
        new[1:] |= key[order][1:] != key[order][:-1]
    group = np.empty(len(rows), int)
    group[order] = np.cumsum(new)
    return group


def edges(blocks: Blocks) -> np.ndarray:
    """Return the pairs of nodes that are neighbours on a side of a cell, (e, 2) int."""
    found = []
    for kind, nodes in blocks:
        for face in CELL_TYPES[kind].faces:
            corner = nodes[:, face]
            found.append(np.stack([corner, np.roll(corner, 1, axis=1)], -1).reshape(-1, 2))
    ends = np.sort(np.concatenate(found), axis=1)
    base = int(ends.max(initial=0)) + 1
    keys = np.sort(ends[:, 0] * base + ends[:, 1])  # quicker than np.unique
    keys = keys[np.concatenate([[True], keys[1:] != keys[:-1]])]
    return np.column_stack([keys // base, keys % base])


def coincident(
    points: np.ndarray,
    blocks: Blocks,
    tolerance: float = 1e-5,
    joined: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Return for each node the first node at its place, itself as a rule. Shape (n,) int.

    Only nodes of cells count. `tolerance` is a share of the typical edge; nodes of one cell are
    never taken for one. `joined` tells of pairs of nodes (p, 2) at one place which may be one.
    """
    first = np.arange(len(points))
    used = np.unique(np.concatenate([nodes.ravel() for _, nodes in blocks]))
    ends = edges(blocks)
    lengths = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    lengths = lengths[lengths > 0]
    if not len(lengths) or not np.isfinite(lengths).all() or lengths.max() > 1e150:
        return first  # nothing that could be near
    reach = min(tolerance * np.median(lengths), 0.1 * lengths.min())
    pairs = cKDTree(points[used]).query_pairs(reach, output_type="ndarray")
    if joined is not None and len(pairs):
        pairs = pairs[joined(used[pairs])]
    if not len(pairs):
        return first
    ones = np.ones(len(pairs))
    graph = sp.coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), (len(used),) * 2)
    _, piece = connected_components(graph, directed=False)
    smallest = np.full(piece.max() + 1, len(points))
    np.minimum.at(smallest, piece, used)
    first[used] = smallest[piece]
    return first


def pieces(n_nodes: int, blocks: Blocks) -> tuple[int, np.ndarray]:
    """Return how many parts share no node with one another, and each cell's part (m,)."""
    cell, node, start = [], [], 0
    for _, nodes in blocks:
        cell.append(np.repeat(start + np.arange(len(nodes)), nodes.shape[1]))
        node.append(nodes.ravel())
        start += len(nodes)
    cell, node = np.concatenate(cell), np.concatenate(node)
    graph = sp.coo_matrix((np.ones(len(cell)), (cell, start + node)), (start + n_nodes,) * 2)
    _, part = connected_components(graph, directed=False)
    kept, part = np.unique(part[:start], return_inverse=True)
    return len(kept), part


def node_pieces(n_nodes: int, cells: np.ndarray) -> np.ndarray:
    """Return the number of the part of the mesh that each node belongs to, (n_nodes,).

    Nodes without cells belong to the first part.
    """
    part = np.zeros(n_nodes, int)
    part[cells] = pieces(n_nodes, [("cell", cells)])[1][:, None]
    return part


def overlaps(points: np.ndarray, blocks: Blocks) -> tuple[np.ndarray, str] | None:
    """Return cells (c,) that cannot be parts of one body, and why; None when there are none.

    Parameters
    ----------
    points : (n, d)
        In the mesh's own dimension d.
    blocks

    Notes
    -----
    More than two cells at one side overlap, and so do two that lie on the same side of the side
    they share: the mesh is folded there. Neither depends on how the cells are turned.
    """
    found = sides(blocks)
    count = np.bincount(found.group)
    crowded = count[found.group] > 2
    if crowded.any():
        cells = np.unique(found.owner[crowded])
        what = "edge" if points.shape[1] == 2 else "face"
        return cells, f"more than two cells share one {what}"
    order = np.argsort(found.group, kind="stable")
    same = found.group[order][1:] == found.group[order][:-1]
    one, other = order[:-1][same], order[1:][same]
    height = _heights(points, blocks, found, one, one), _heights(points, blocks, found, one, other)
    folded = height[0] * height[1] > 0
    if folded.any():
        cells = np.unique([found.owner[one[folded]], found.owner[other[folded]]])
        return cells, "neighbours lie on the same side of what they share"
    return None


def _heights(points, blocks, found: Sides, side: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Return the height of the centres of the owners of `cell` over the sides `side`."""
    centres = np.concatenate([points[nodes].mean(axis=1) for _, nodes in blocks])
    x = points[found.corners[side]]
    if points.shape[1] == 2:
        along = x[:, 1] - x[:, 0]
        normal = np.column_stack([-along[:, 1], along[:, 0]])
        middle = x[:, :2].mean(axis=1)
    else:
        last = np.where((found.corners[side, 3] >= 0)[:, None], x[:, 3], x[:, 0])
        normal = np.cross(x[:, 2] - x[:, 0], last - x[:, 1])
        middle = (x[:, 0] + x[:, 1] + x[:, 2] + last) / 4
    return np.einsum("sd,sd->s", normal, centres[found.owner[cell]] - middle)


def roughness(field: np.ndarray, ends: np.ndarray) -> float:
    """Return how far a field jumps along edges: 0 constant, about 1 for values in random order.

    Parameters
    ----------
    field : (n, c)
    ends : (e, 2) int
        As of :func:`edges`.
    """
    used = np.unique(ends)
    field = field / (np.abs(field[used]).max() or 1.0)  # squares of any field can be held then
    spread = 2 * np.square(field[used] - field[used].mean(axis=0)).sum(axis=1).mean()
    jumps = np.square(field[ends[:, 0]] - field[ends[:, 1]]).sum(axis=1).mean()
    return float(jumps / spread) if spread > 0 else 0.0
