"""Which motions the nodes may have, and along which of them balance is asked.

Displacements are y = F f + H h: along the columns of F nothing from outside pushes, so the forces
balance there, Fᵀ(internal forces) = 0; along those of H an outside body may push, and nothing is
asked. All columns are orthonormal. A free node has its d axes in F, a reaction node in H.

Two nodes that touch across an interface without friction share one normal displacement and have
each its own tangential one: F has the common normal motion (the sum of both normal forces is zero:
the traction passes on) and each side's tangential motions (each tangential force is zero). Normals
are those at rest. A body that slides on the node of a floor is pushed along the normal only, which
is then in H, and the tangential motions in F.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ..fem.contact import Pairs, blocked, border_normals, touching
from ..fem.mesh import Mesh

ZERO = 1e-3  # eigenvalues of sums of projections below this are none


@dataclass(frozen=True)
class Conditions:
    """Of a mesh with n dofs.

    Attributes
    ----------
    free, held : csr_matrix (n_dofs, n_free), (n_dofs, n_held)
        F and H.
    free_slots, held_slots : (n_free,), (n_held,) int
        A degree of freedom for each column, at a node that moves in it: where it counts as being.
    pairs : (p, 2) int
        Nodes that touch and slide.
    members : csr_matrix (n_nodes, n_nodes)
        1 where a node's equations hold forces of another (and of itself).
    """

    free: sp.csr_matrix
    held: sp.csr_matrix
    free_slots: np.ndarray
    held_slots: np.ndarray
    pairs: np.ndarray
    members: sp.csr_matrix
    dim: int

    @property
    def plain(self) -> bool:
        """True if every node is free or held along its axes."""
        return self.free.nnz == self.free.shape[1] and self.held.nnz == self.held.shape[1]

    @cached_property
    def asked(self) -> np.ndarray:
        """Nodes at which an equation counts as being, (n_nodes,) bool."""
        count = np.bincount(self.free_slots // self.dim, minlength=self.free.shape[0] // self.dim)
        return count > 0

    @cached_property
    def rows(self) -> sp.csr_matrix:
        """Fᵀ with d rows per node, zero ones where there is no equation. (n_dofs, n_dofs)"""
        n = self.free.shape[0]
        place = sp.csr_matrix(
            (np.ones(len(self.free_slots)), (self.free_slots, np.arange(len(self.free_slots)))),
            (n, len(self.free_slots)),
        )
        return (place @ self.free.T).tocsr()

    def left(self, forces: np.ndarray) -> np.ndarray:
        """Return the part of nodal forces (n_nodes, d) that should balance."""
        return (self.free @ (self.free.T @ forces.ravel())).reshape(forces.shape)

    def violation(self, u: np.ndarray) -> np.ndarray:
        """Return the part of displacements (n_nodes, d) that is not allowed: gaps, overlaps."""
        y = u.ravel()
        rest = y - self.free @ (self.free.T @ y) - self.held @ (self.held.T @ y)
        return rest.reshape(u.shape)


def conditions(
    mesh: Mesh,
    reaction: np.ndarray,
    sliding: np.ndarray | None = None,
    labels: np.ndarray | None = None,
    slip: Pairs = (),
) -> Conditions:
    """Return the conditions of a mesh.

    Parameters
    ----------
    reaction, sliding : (n_nodes,) bool
        Where an outside body may push, and where of that it only slides.
    labels : (n_cells,) int
    slip : sequence of (label, label)
        Labels that slide on each other; their nodes are split along the interface.
    """
    d, n = mesh.dim, mesh.n_nodes
    used = np.diff(mesh.node_cells.indptr) > 0
    pairs, normals = np.zeros((0, 2), int), np.zeros((0, d, d))
    if len(slip):
        pairs, normals = touching(mesh, labels, slip)
    reactions = np.zeros((n, d, d))
    reactions[reaction] = np.eye(d)
    special = np.zeros(n, bool)
    if sliding is not None and sliding.any():
        across = blocked(border_normals(mesh, sliding & reaction))
        slides = sliding & reaction & (np.abs(across).max(axis=(1, 2)) > 0)
        reactions[slides] = across[slides]
        special |= slides
    special[pairs.ravel()] = True

    axes = np.arange(d)
    free, held = (
        (np.flatnonzero(used & ~special & part)[:, None] * d + axes).ravel()
        for part in (~reaction, reaction)
    )
    parts = [_columns(free, held)]
    members = sp.identity(n, format="csr")
    if special.any():
        link = np.ones(len(pairs))
        graph = sp.coo_matrix((link, pairs.T), (n, n))
        _, cluster = connected_components(graph, directed=False)
        nodes = np.flatnonzero(special)
        nodes = nodes[np.argsort(cluster[nodes], kind="stable")]
        _, start, count = np.unique(cluster[nodes], return_index=True, return_counts=True)
        walls = blocked(normals)
        for copies in np.unique(count):
            group = nodes[start[count == copies][:, None] + np.arange(copies)]
            parts.append(_cluster_columns(group, reactions, pairs, walls))
            if copies > 1:
                row, col = (np.repeat(group, copies, axis=1), np.tile(group, (1, copies)))
                other = (row != col).ravel()
                ones = np.ones(other.sum())
                members = members + sp.csr_matrix(
                    (ones, (row.ravel()[other], col.ravel()[other])), (n, n)
                )
    (free, free_slots), (held, held_slots) = (
        _ordered([part[k] for part in parts], n * d) for k in (0, 1)
    )
    return Conditions(free, held, free_slots, held_slots, pairs, members.tocsr(), d)


def _columns(free, held):
    """Entries (rows, columns' slots, values) of columns along single axes."""
    return (free, free, np.ones(len(free))), (held, held, np.ones(len(held)))


def _cluster_columns(group, reactions, pairs, walls):
    """Entries of the columns of nodes (g, c) that move together, free ones and held ones."""
    g, c = group.shape
    d = reactions.shape[1]
    of_node, place = np.full((2, len(reactions)), -1)
    of_node[group], place[group] = np.arange(g)[:, None], np.arange(c)
    contact, outside = np.zeros((2, g, c, c, d, d))
    for k in range(c):
        outside[:, k, k] = reactions[group[:, k]]
    here = of_node[pairs[:, 0]] >= 0
    at, (i, j), wall = of_node[pairs[here, 0]], place[pairs[here]].T, walls[here]
    for one, other, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
        np.add.at(contact, (at, one, other), sign * wall)
    contact, outside = (np.swapaxes(part, 2, 3) for part in (contact, outside))
    contact, outside = (part.reshape(g, c * d, c * d) for part in (contact, outside))
    free = _null(contact + outside)
    held = _null(contact + free @ np.swapaxes(free, 1, 2))
    slots = (group[:, :, None] * d + np.arange(d)).reshape(g, c * d)
    taken = (np.abs(free).max(axis=1) > 0).sum(axis=1)
    return _entries(free, slots, 0 * taken), _entries(held, slots, taken)


def _null(matrices):
    """Orthonormal bases of null spaces, zero columns last. (g, n, n)"""
    values, vectors = np.linalg.eigh(matrices)  # ascending: the null space comes first
    vectors[np.abs(vectors) < 1e-14] = 0.0
    return vectors * (values < ZERO)[:, None, :]


def _entries(bases, slots, first):
    """Entries of bases (g, n, n) whose columns take the slots (g, n) from the `first` (g,) on."""
    n = bases.shape[1]
    real = np.abs(bases).max(axis=1) > 0
    column = np.minimum(np.arange(n) + first[:, None], n - 1)
    at = np.take_along_axis(slots, column, axis=1)
    keep = np.broadcast_to(real[:, None, :], bases.shape)
    row = np.broadcast_to(slots[:, :, None], bases.shape)[keep]
    return row, np.broadcast_to(at[:, None, :], bases.shape)[keep], bases[keep]


def _ordered(entries, n):
    """The matrix of all columns in the order of their slots, and the slots."""
    row, slot, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    slots, column = np.unique(slot, return_inverse=True)
    matrix = sp.csr_matrix((value, (row, column.ravel())), (n, len(slots)))
    matrix.eliminate_zeros()
    return matrix, slots


def contact_report(there: Conditions, displacements: np.ndarray) -> tuple[dict | None, list[str]]:
    """Return how far the two sides slide and part in the measured displacements, and what is odd.

    Parameters
    ----------
    displacements : (t, n_nodes, d)

    Returns
    -------
    dict or None
        ``pairs`` of nodes; ``slide`` and ``gap``, root mean squares over nodes and trials of the
        difference along and across the interface (length); None where nothing slides.
    list of str
    """
    if not len(there.pairs):
        return None, []
    one, other = there.pairs.T
    jump = displacements[:, one] - displacements[:, other]
    wrong = np.stack([there.violation(u) for u in displacements])
    across = wrong[:, one] - wrong[:, other]
    gap, slide = (float(np.sqrt((v**2).sum(axis=2).mean())) for v in (across, jump - across))
    report = {"pairs": len(there.pairs), "slide": slide, "gap": gap}
    if slide >= 2 * gap:
        return report, []
    return report, [
        f"labels are said to slide, but where they touch they slide by {slide:.2g} only and part "
        f"by {gap:.2g} (root mean squares): if they stick together, leave slip out"
    ]
