"""Cells that measured displacements turn inside out: left open, their nodes' motion not believed.

A registration may lose a few nodes while the rest is right. No body moves so, and a fit that
believes them bends the whole map to it. In the trial at hand such nodes get the place that an
elastic body gives them whose other nodes move as measured, and hardly any weight.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from ..fem.assembly import tangent_stiffness
from ..fem.constitutive import SmallStrain
from ..fem.elastic_constants import lame_from_young
from ..fem.mesh import Mesh

MOST = 0.1  # share of the cells; beyond, nothing says that the rest is right
ROUNDS = 4  # in which neighbours are given up, too, where their place leaves a cell inside out
NAMED = 12  # cells in a sentence
LOOSE = 1e-9  # of the stiffness: holds nodes that no node with a measured motion does


@dataclass(frozen=True)
class Inverted:
    """Cells that are inside out in some trial.

    Attributes
    ----------
    cells : (n_trials, n_cells) bool
    nodes : (n_trials, n_nodes) bool
        Whose displacements are not believed.
    displacements : (n_trials, n_nodes, d)
        With those of such nodes put where their neighbours have them.
    off : (n_trials,)
        Largest distance between both (length).
    """

    cells: np.ndarray
    nodes: np.ndarray
    displacements: np.ndarray
    off: np.ndarray

    def sentences(self, trials: np.ndarray) -> list[str]:
        """Return what was done, trial by trial; `trials` are their numbers."""
        said = []
        for trial, cells, nodes, off in zip(trials, self.cells, self.nodes, self.off, strict=True):
            if not cells.any():
                continue
            one, names = cells.sum() == 1, named(np.flatnonzero(cells))
            said.append(
                f"the displacements of trial {trial} turn {cells.sum()} of {len(cells)} cells "
                f"inside out, which no body does: cell{'' if one else 's'} {names}, where they are "
                f"off by up to {off:.2g} from what their neighbours say. Unless known, "
                f"{'it is' if one else 'they are'} left open (Status 0), and the displacements of "
                f"{nodes.sum()} nodes there were given no weight: check the registration there"
            )
        return said


def named(numbers: np.ndarray) -> str:
    """Return the first of some numbers for a sentence, and how many more there are."""
    names = ", ".join(map(str, numbers[:NAMED]))
    return names if len(numbers) <= NAMED else f"{names} and {len(numbers) - NAMED} more"


def may_be_mended(cells: np.ndarray) -> bool:
    """Tell whether some cells are inside out, (n_trials, n_cells) bool, but not many."""
    return bool(0 < cells.any(axis=0).mean() <= MOST)


def mended(mesh: Mesh, u: np.ndarray, cells: np.ndarray) -> Inverted:
    """Give up the nodes of cells (t, n_cells) that displacements (t, n, d) turn inside out."""
    filled, nodes = u.copy(), np.zeros(u.shape[:2], bool)
    for t in np.flatnonzero(cells.any(axis=1)):
        wrong = cells[t]
        for _ in range(ROUNDS):
            nodes[t] |= mesh.node_cells @ wrong.astype(float) > 0
            filled[t] = elastic(mesh, u[t], nodes[t])
            wrong = folded(mesh, filled[t])
            if not wrong.any():
                break
    off = np.linalg.norm(filled - u, axis=2).max(axis=1)
    return Inverted(cells, nodes, filled, off)


def folded(mesh: Mesh, u: np.ndarray) -> np.ndarray:
    """Tell which cells displacements (n, d) turn inside out. (n_cells,) bool"""
    found = np.zeros(mesh.n_cells, bool)
    for block in mesh.blocks:
        size = np.linalg.det(np.eye(mesh.dim) + block.gradient(u))
        found[block.ids] = (size <= 0).any(axis=1)
    return found


def elastic(mesh, u, lost):
    """Displacements (n, d) with the lost nodes, (n,) bool, in balance among the others."""
    lam, mu = (np.full(mesh.n_cells, float(x)) for x in lame_from_young(1.0, 0.3))
    K = tangent_stiffness(mesh, SmallStrain(), np.zeros_like(u), lam, mu)
    free = np.repeat(lost, mesh.dim)
    # counted from the mean, so that what nothing holds stays with the body
    mean = u[~lost].mean(axis=0)
    out = (u - mean).ravel()
    rows = K[free]
    inner = rows[:, free] + LOOSE * K.diagonal().max() * sp.identity(free.sum())
    out[free] = spla.spsolve(inner.tocsc(), -(rows[:, ~free] @ out[~free]))
    return out.reshape(u.shape) + mean
