"""Patches of neighbouring cells over which cells without locking average their dilatation."""

import numpy as np
import scipy.sparse as sp

from .mesh import Mesh

# Simplices have about one pressure per three displacements then; a quad or hexahedron has enough
# nodes of its own (its mean dilatation is the B-bar method: Hughes 1987, section 4.5.2).
PATCH_SIZE = {"triangle": 6, "tetra": 8, "quad": 1, "hexahedron": 1}
JUMP = 1.5  # known neighbours whose λ differ by more are not averaged


def together(mesh: Mesh, kind: np.ndarray, known_lam: np.ndarray | None = None) -> np.ndarray:
    """Tell which of ``mesh.interfaces``' pairs may belong to one patch. (m,) bool

    Parameters
    ----------
    kind : (n_cells,) int
        Cells of different kinds are never averaged: known ones with unknown ones.
    known_lam : (n_cells,), optional
        λ of known cells, 0 elsewhere: bone is not averaged with the gel beside it.
    """
    a, b = mesh.interfaces[0].T
    same = kind[a] == kind[b]
    if known_lam is not None:
        size = np.log(np.maximum(np.abs(known_lam), np.finfo(float).tiny))
        same &= np.abs(size[a] - size[b]) < np.log(JUMP)
    return same


def patches(mesh: Mesh, allowed: np.ndarray | None = None) -> np.ndarray:
    """Group cells that share sides into compact patches.

    A patch takes next the neighbour that has most nodes in common with it. That depends on the
    ones taken before, hence the loop: a few seconds for 100 000 tetrahedra.

    Parameters
    ----------
    allowed : (m,) bool, optional
        Which of ``mesh.interfaces``' pairs may be in one patch; all by default.

    Returns
    -------
    patch : (n_cells,) int
        The patch of each cell, numbered from 0.
    """
    pairs, _ = mesh.interfaces
    if allowed is not None:
        pairs = pairs[allowed]
    size, nodes, name = np.ones(mesh.n_cells, int), [None] * mesh.n_cells, np.zeros(mesh.n_cells)
    for number, block in enumerate(mesh.blocks):
        size[block.ids] = PATCH_SIZE[block.cell.name]
        name[block.ids] = number
        for cell, corners in zip(block.ids.tolist(), block.nodes.tolist(), strict=True):
            nodes[cell] = corners
    pairs = pairs[name[pairs[:, 0]] == name[pairs[:, 1]]]
    n = mesh.n_cells
    graph = sp.csr_matrix((np.ones(2 * len(pairs)), np.vstack([pairs, pairs[:, ::-1]]).T), (n, n))
    patch = _grow(np.lexsort(mesh.centres.T).tolist(), graph, size.tolist(), nodes)
    return _merge_small(patch, graph, size)


def _grow(order, graph, size, nodes):
    around, start = graph.indices.tolist(), graph.indptr.tolist()
    patch, count = [-1] * len(order), 0
    for seed in order:
        if patch[seed] >= 0:
            continue
        patch[seed], corners, front = count, set(nodes[seed]), set()
        last = seed
        for _ in range(size[seed] - 1):
            front.update(c for c in around[start[last] : start[last + 1]] if patch[c] < 0)
            if not front:
                break
            last = max(front, key=lambda c: (sum(k in corners for k in nodes[c]), -c))
            front.discard(last)
            patch[last] = count
            corners.update(nodes[last])
        count += 1
    return np.array(patch)


def _merge_small(patch, graph, size):
    """Cells of patches below half the size join the smallest neighbouring patch."""
    for cell in np.flatnonzero(2 * np.bincount(patch)[patch] < size):
        count = np.bincount(patch)
        around = patch[graph.indices[graph.indptr[cell] : graph.indptr[cell + 1]]]
        around = around[around != patch[cell]]
        if len(around) and 2 * count[patch[cell]] < size[cell]:
            patch[cell] = around[np.argmin(count[around])]
    return np.unique(patch, return_inverse=True)[1].ravel()
