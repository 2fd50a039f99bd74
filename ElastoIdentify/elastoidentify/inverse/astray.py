"""Single nodes whose measured motion no elastic body shares: found by the fit, and not believed.

A registration may lose a few nodes without turning a cell inside out. Least squares would bend the
map to them and call the noise of all others large. After a fit a node is astray in a trial where
what the fit leaves of its displacement is far beyond what it leaves of the others', by their
median, which a few lost nodes do not move, and beyond the cells' own error, which is a share of
their strain. The fit begins again without such nodes and looks at all of them again, until the same
nodes are astray: least trimmed squares by concentration steps (Rousseeuw, Van Driessen, Data Min.
Knowl. Disc. 12, 2006).

Where the model is wrong much is astray, side by side: so much may be no matter of lost nodes. All
are believed then, and it is said where that is.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from ..errors import InputError
from ..fem.constitutive import KINEMATICS
from ..fem.mesh import Mesh
from .inverted import elastic, named
from .observations import DisplacementNoise
from .problem import Astray, Problem

FAR = 8.0  # standard deviations of the noise
FAR_NO_MORE = 5.0  # of where a fit without the node has it
FAR_IN_CELLS = 0.6  # of what the cells around are stretched by; nodes of sound bodies, 0.5 at most
FEW = 1.6  # over the number of samples: the least share of the noise that they can tell from none
PULLED = 0.3  # of the largest beside it: less may be what a lost node makes of its neighbours
ROUNDS = 6
MOST = 0.1  # share of a trial's nodes; beyond, nothing says that they are wrong and the model right
MOST_TOGETHER = 4  # nodes side by side
AT_FIRST = 2.0  # times as much, when lost nodes take others along; then less from look to look


def believing(problem: Problem, first_map: Callable):
    """Make a first map with the displacements that can be believed.

    Parameters
    ----------
    problem : Problem
    first_map : callable
        Problem → fit with its first map, with ``computed``: displacements (n_trials, n_nodes, d),
        ``computed_errors``: samples of their error (m, n_trials, n_nodes, d), and the noise
        ``scale``.

    Returns
    -------
    fit : object
        Of all displacements where those astray are too many, or side by side.
    astray : Astray
        Which are lost, or in that case where they are.
    """
    try:
        return _concentrated(problem, first_map)
    except InputError:
        # lost nodes may be why the law does not converge; in small strain they are seen
        if problem.law is not KINEMATICS["neo-hookean"]:
            raise
        seen = _concentrated(replace(problem, law=KINEMATICS["small-strain"]), first_map)[1].lost
        if not seen.any():
            raise
        fit, found = _concentrated(without(problem, seen > 0), first_map)
        return fit, Astray(np.where(found.lost > 0, found.lost, seen), found.patch)


def nothing(problem: Problem) -> Astray:
    """Return that every displacement is followed, or that nobody looked."""
    return Astray(*np.zeros((2, *problem.noise.lost.shape)))


def without(problem: Problem, nodes: np.ndarray) -> Problem:
    """Return the problem in which displacements of nodes (n_trials, n_nodes) are not believed."""
    noise, u = problem.noise, problem.displacements.copy()
    for t in np.flatnonzero(nodes.any(axis=1)):
        u[t] = elastic(problem.mesh, u[t], nodes[t])
    errors = DisplacementNoise(u, noise.information, noise.scale, noise.lost | nodes)
    return replace(problem, displacements=u, noise=errors)


def sentences(trials: np.ndarray, off: np.ndarray, numbers: np.ndarray) -> list[str]:
    """Say which displacements were not believed, trial by trial; by the numbers users know."""
    said = []
    for trial, far in zip(trials, off, strict=True):
        nodes = np.flatnonzero(far)
        if len(nodes):
            one = len(nodes) == 1
            said.append(
                f"in trial {trial} no elastic body moves {len(nodes)} of {len(far)} nodes as "
                f"measured: node{'' if one else 's'} {named(numbers[nodes])}, off by up to "
                f"{far.max():.2g} from what all the others say. "
                f"{'It was' if one else 'They were'} given no weight: check the registration there"
            )
    return said


def patch(off: np.ndarray, places: np.ndarray) -> dict | None:
    """Describe nodes that are off (n_trials, n_nodes), and believed; by places (n_nodes, 2 or 3).

    Returns
    -------
    dict
        ``nodes``: how many, counted in each trial, ``centre``, and ``off``: how far at most
        (length); None where there are none.
    """
    nodes = off.any(axis=0)
    if not nodes.any():
        return None
    centre = places[nodes].mean(axis=0).tolist()
    return {"nodes": int((off > 0).sum()), "centre": centre, "off": float(off.max())}


def _concentrated(problem: Problem, first_map: Callable):
    """Look for nodes astray until they stay the same; see :func:`believing`."""
    none = np.zeros(problem.noise.lost.shape, bool)
    fit, nodes, most = first_map(problem), none, AT_FIRST
    for _ in range(ROUNDS):
        found, off = _astray(problem, fit, nodes)
        much = _much(problem.mesh, found)
        if much > 1 and much >= most:
            if nodes.any():
                fit = None  # no two fits at a time: they are large
                fit = first_map(problem)
            return fit, Astray(off * none, off * found)
        if (found == nodes).all():
            break
        nodes, most, fit = found, much, None
        fit = first_map(without(problem, nodes))
    return fit, Astray(off * nodes, off * none)


def _astray(problem: Problem, fit, before: np.ndarray):
    """Tell which nodes a fit leaves far from where they were measured, bool, and how far all are.

    All (n_trials, n_nodes). The fit did not believe those astray `before`.
    """
    noise, mesh, beside = problem.noise, problem.mesh, _beside(problem.mesh)
    errors = fit.computed_errors
    left = problem.displacements - fit.computed
    off, found = np.linalg.norm(left, axis=2), np.zeros(noise.lost.shape, bool)
    for t, believed in enumerate(~noise.lost):
        metric = np.linalg.inv(noise.covariances(t))
        size = np.sqrt(np.einsum("ni,nij,nj->n", left[t], metric, left[t]))
        spread = np.einsum("mni,nij,mnj->n", errors[:, t], metric, errors[:, t])
        leverage = spread / (len(errors) * mesh.dim * fit.scale**2)
        # of the noise's variance, what the fit leaves; without the node it adds its own
        share = np.where(before[t], 1 + leverage, 1 - np.minimum(leverage, 1 - FEW / len(errors)))
        noises = size / np.sqrt(share)
        typical = np.median(noises[believed & ~before[t]]) / np.sqrt(chi2.median(mesh.dim))
        noises /= max(typical, noise.stated or 0.0, np.finfo(float).tiny)
        cells = FAR_IN_CELLS * _elongation(mesh, fit.computed[t])
        far = believed & (noises > FAR) & (off[t] > cells) & ~before[t]
        alone = size / share  # how far it would be without itself
        pulled = beside.multiply(far * alone).max(axis=1).toarray().ravel()
        back = noises < FAR_NO_MORE
        found[t] = (before[t] & ~back) | (far & (alone > PULLED * pulled))
    return found, off


def _elongation(mesh: Mesh, u: np.ndarray) -> np.ndarray:
    """Return strain × size of the cells around each node, the largest, (n_nodes,) (length).

    No cell counts as strained more than twice as much as most: a fit may follow a lost node.
    """
    strain = np.zeros(mesh.n_cells)
    for block in mesh.blocks:
        H = block.gradient(u)
        T = np.swapaxes(H, -1, -2)
        strain[block.ids] = np.linalg.norm(H + T + T @ H, axis=(-1, -2)).max(axis=1) / 2
    stretched = np.minimum(strain, 2 * np.median(strain)) * mesh.volumes ** (1 / mesh.dim)
    return mesh.node_cells.multiply(stretched).max(axis=1).toarray().ravel()


def _much(mesh: Mesh, nodes: np.ndarray) -> float:
    """Return how many nodes (n_trials, n_nodes) there are, or side by side, over what may be."""
    beside, much = _beside(mesh), nodes.mean(axis=1).max() / MOST
    for one in map(np.flatnonzero, nodes):
        piece = connected_components(beside[one][:, one], directed=False)[1]
        much = max(much, np.bincount(piece, minlength=1).max() / MOST_TOGETHER)
    return much


def _beside(mesh: Mesh):
    """Nodes that have a cell in common, sparse (n_nodes, n_nodes), themselves too."""
    return (mesh.node_cells @ mesh.node_cells.T > 0).astype(float)
