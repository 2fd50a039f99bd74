"""Measured displacements, looked at before they are believed: are they pushes of this body?

A body that moves as a whole, because the patient does, is not deformed by that. So trials are
compared by what is left of them beside the nearest rigid motion u = a + ω × x.
"""

import numpy as np

from ..fem import soundness
from .border import Frame
from .inverted import folded

NOT_SMOOTH, ROUGH = 0.05, 0.5  # of what the same displacements in random order jump along edges
SMOOTHER = 0.3  # in the reverse order: then it is hardly by chance
FEW_NODES = 20
SMALL_PUSH = 1e-4  # of the mesh's size
STILL = 1.5  # standard errors, root mean square: what no push leaves, with errors stated too small

SAME_DIRECTION = 0.07
"""Second singular value of unit trials below which they count as one: an angle of some 5°."""


def deformation(points: np.ndarray, u: np.ndarray, metric: np.ndarray | None = None) -> np.ndarray:
    """Return displacements without the nearest rigid motion, (n, d).

    Parameters
    ----------
    points, u : (n, d)
    metric : (n, d, d), optional
        Inverse covariances of the displacements, in which the nearest is measured.
    """
    modes = rigid_motions(points)
    weighted = modes if metric is None else np.einsum("nij,njk->nik", metric, modes)
    force = np.einsum("nik,ni->k", weighted, u)
    amounts = np.linalg.lstsq(np.einsum("nik,nil->kl", weighted, modes), force, rcond=None)[0]
    return u - modes @ amounts


def rigid_motions(points: np.ndarray) -> np.ndarray:
    """Return translations and infinitesimal rotations about the centre, (n, d, 3 or 6)."""
    n, d = points.shape
    arms = (points - points.mean(axis=0)) / max(np.ptp(points, axis=0).max(), 1e-300)
    turned = []
    for i in range(d):
        for j in range(i):
            turn = np.zeros((n, d))
            turn[:, i], turn[:, j] = arms[:, j], -arms[:, i]
            turned.append(turn)
    shifts = np.broadcast_to(np.eye(d), (n, d, d))
    return np.concatenate([shifts, np.stack(turned, axis=2)], axis=2)


def is_still(points: np.ndarray, u: np.ndarray, metric: np.ndarray) -> bool:
    """Tell whether displacements (n, d) are no more than their errors and a rigid motion."""
    left = deformation(points, u, metric)
    sizes = np.linalg.eigvalsh(metric)
    counted = int((sizes > 1e-12 * sizes.max()).sum())
    chi_square = np.einsum("ni,nij,nj->", left, metric, left)
    return bool(chi_square < STILL**2 * counted)


def one_direction(points: np.ndarray, trials: np.ndarray) -> bool:
    """Tell whether the trials (t, n, d) deform the body in nearly one way, or are only one."""
    if len(trials) < 2:
        return True
    flat = np.array([deformation(points, u).ravel() for u in trials])
    flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
    return bool(np.linalg.svd(flat, compute_uv=False)[1] < SAME_DIRECTION)


# ---- in words


def still_notes(trials: np.ndarray) -> list[str]:
    """Return sentences on trials that show no push; `trials` are their numbers."""
    return [
        f"trial {trial} shows no push: but for a motion as a whole its displacements are no larger "
        "than their errors; is it the right image?"
        for trial in trials
    ]


def order_notes(frame: Frame, u: np.ndarray, trials: np.ndarray) -> list[str]:
    """Return sentences on displacements (t, n_given, c) in another order than the nodes."""
    notes = []
    for v, trial in zip(u, trials, strict=True):
        rough = soundness.roughness(v, frame.ends)
        back = soundness.roughness(v[::-1], frame.ends)
        if back < SMOOTHER * rough and rough > NOT_SMOOTH:
            notes.append(
                f"the displacements of trial {trial} would be much smoother in the reverse order "
                "of the nodes: are they those of this mesh?"
            )
        elif rough > ROUGH and len(frame.nodes) > FEW_NODES:
            notes.append(
                f"the displacements of trial {trial} jump from node to node as if in another order "
                "than the nodes: are they those of this mesh?"
            )
    return notes


def size_notes(frame: Frame, u: np.ndarray, trials: np.ndarray) -> list[str]:
    """Compare displacements (t, n_nodes, d) with the size of their mesh."""
    notes = []
    for v, trial in zip(u, trials, strict=True):
        spread = float(np.abs(v - v.mean(axis=0)).max(initial=0.0))
        if spread and not SMALL_PUSH * frame.size <= spread <= frame.size:
            notes.append(
                f"the displacements of trial {trial} differ by {spread:.2g} on a mesh of size "
                f"{frame.size:.3g}: are both in one unit of length?"
            )
    return notes


def folded_notes(frame: Frame, u: np.ndarray, trials: np.ndarray) -> list[str]:
    """Return sentences on displacements (t, n_nodes, d) that turn cells inside out."""
    notes = []
    for v, trial in zip(u, trials, strict=True):
        cells = np.flatnonzero(folded(frame.mesh, v))
        if len(cells):
            notes.append(
                f"the displacements of trial {trial} turn {len(cells)} of {frame.mesh.n_cells} "
                f"cells inside out, the first is cell {cells[0]}: no body moves so; check the "
                "registration there, or the order of the nodes"
            )
    return notes
