"""What could be seen: the smallest lesion that mesh, noise and pushes would show.

A lesion multiplies the stiffness inside a ball. To first order it changes the measured numbers by
v = J t, with t the ball's log-moduli and J of the Gauss-Newton system (:mod:`.newton_systems`).
What the held nodes' unknown motion and another stiffness of the whole body could also explain is
projected out of v; the length of the rest in units of the noise,

    d′ = √(v⊥ᵀ W v⊥) / σ,

is the detectability of a known signal in noise (Barrett & Myers, Foundations of Image Science,
2004, section 13.2). A fit with an unknown per cell knows neither place nor outline, and its prior
asks for evidence of every side of a lesion's outline, so it takes more than the d′ = 3 of an
observer who knows both: `NEEDED`, from what fits of independent data found (docs/theory.md).
"""

import numpy as np

from .equilibrium import State
from .misfit import Misfit
from .newton_systems import ReducedSystem

CONTRAST = 2.0  # of the lesion that is looked for
NEEDED = 15.0
"""Where fits of independent data show about half of a lesion's log-contrast: d′ was 19 there with
noise of 0.3 % of the push, 11 to 13 with 3 %."""

PLACES, DIAMETERS = 3, 5  # that are tried
NODES_ACROSS = 5
"""Distances of nodes across the smallest lesion of which it is said, in space, that it would show:
one of four was lost by a fit at d′ = 47, and found by others (docs/theory.md)."""


def smallest_visible(
    state: State,
    misfit: Misfit,
    scale: float,
    n_fields: int,
    centres: np.ndarray,
    cell_size: float,
    place: np.ndarray | None = None,
    tell=None,
    least: float = 0.0,
) -> dict:
    """Return which lesion would be seen at some places of the tissue.

    Parameters
    ----------
    state, misfit : State, Misfit
        The fit, linearised at its map; its first parameters are `n_fields` fields of a value per
        unknown cell, the first of which is log-stiffness.
    scale : float
        Noise in units of the measurements' stated errors.
    centres : (n, d)
        Of the unknown cells.
    cell_size : float
        Length of a cell.
    place : (d,), optional
        One more place to look at.
    least : float
        Diameter below which no lesion counts as seen.

    Returns
    -------
    dict
        ``contrast``; the smallest visible diameters ``here`` (at `place`, or at the most central
        cell), and the ``typical`` and ``worst`` of some places; None: no lesion is seen.
    """
    places = centres[spread(centres, PLACES)]
    if place is not None:
        places = np.vstack([place, places])
    extent = np.linalg.norm(np.ptp(centres, axis=0))
    least = max(cell_size, least)
    diameters = np.geomspace(least, max(0.7 * extent, 2 * least), DIAMETERS)
    n = len(centres)
    lesions = np.zeros((len(state.x), len(places) * DIAMETERS))
    lesions[:n] = np.log(CONTRAST) * np.hstack(
        [balls(centres, at, diameters, cell_size) for at in places]
    )
    whole = np.zeros((len(state.x), n_fields))
    for k in range(n_fields):
        whole[k * n : (k + 1) * n, k] = 1.0
    seen = detectability(state, misfit, scale, lesions, whole, centres.shape[1], tell)
    found = [_crossing(diameters, one) for one in seen.reshape(len(places), -1)]
    here, elsewhere = found[0], found if place is None else found[1:]
    said = {"here": here, "typical": np.median(elsewhere), "worst": np.max(elsewhere)}
    known = {name: float(one) if np.isfinite(one) else None for name, one in said.items()}
    return {"contrast": CONTRAST} | known


def detectability(
    state: State,
    misfit: Misfit,
    scale: float,
    lesions: np.ndarray,
    whole: np.ndarray,
    dim: int,
    tell=None,
) -> np.ndarray:
    """Return d′ of each lesion, (m,).

    Parameters
    ----------
    lesions : (n_x, m)
        Changes of the parameters.
    whole : (n_x, k)
        Changes that count as no lesion, such as all of the tissue stiffer.
    dim : int
        Degrees of freedom per node.
    """
    system = ReducedSystem(np.zeros((0, dim)), dim)
    seen = system.unexplained(state, misfit, np.hstack([whole, lesions]), tell)
    F = misfit.gram(seen, scale)
    k = whole.shape[1]
    explained = F[k:, :k] @ np.linalg.pinv(F[:k, :k], hermitian=True) @ F[:k, k:]
    return np.sqrt(np.maximum(np.diag(F[k:, k:] - explained), 0.0))


def resolved(volume_per_node: float, dim: int) -> float:
    """Return the diameter of a lesion that a mesh is sure to resolve; 0 in the plane."""
    return NODES_ACROSS * volume_per_node ** (1 / dim) if dim == 3 else 0.0


def balls(centres: np.ndarray, place: np.ndarray, diameters: np.ndarray, cell_size: float):
    """Return the share of each cell that lies in balls around a place, (n, m), roughly."""
    distance = np.linalg.norm(centres - place, axis=1)[:, None]
    return np.clip((diameters / 2 - distance) / cell_size + 0.5, 0.0, 1.0)


def spread(points: np.ndarray, m: int) -> np.ndarray:
    """Return the indices of m points far from each other and from where points end, (m,).

    Each next one is where the distance to those before is largest, the first the most central one.
    """
    central = np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()
    chosen, nearest = [central], np.linalg.norm(points - points[central], axis=1)
    for _ in range(min(m, len(points)) - 1):
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _crossing(diameters, seen):
    """The diameter from which on a lesion is seen, between those that were tried; inf: none is."""
    enough = seen >= NEEDED
    if not enough.any():
        return float("inf")
    k = int(enough.argmax())
    if k == 0:
        return float(diameters[0])
    steps = np.log(np.maximum(seen[k - 1 : k + 1], 1e-30))
    part = (np.log(NEEDED) - steps[0]) / (steps[1] - steps[0])
    return float(np.exp((1 - part) * np.log(diameters[k - 1]) + part * np.log(diameters[k])))
