"""How far the cells' own error shifts a map: a defect of the forward solution, carried to moduli.

The forward solution is repeated once on cells half as large, with the moduli and the held nodes'
motion found. The difference at the measured nodes is what the coarse cells get wrong, up to what
the finer ones still do (a third of it for cells of second order, which Richardson's extrapolation
adds), and the fit has taken it for stiffness: the Gauss-Newton system tells how much.
"""

import numpy as np

from ..errors import InputError
from .equilibrium import Equilibrium, State

RICHARDSON = 4 / 3  # 1 / (1 − 2⁻²)
# free degrees of freedom of the finer solution beyond which it costs too much, by dimension
MOST = {2: 300_000, 3: 45_000, (3, "pardiso"): 150_000}
CHILDREN = {2: 4, 3: 8}
FAR_LARGER = 100.0
NOTABLE, SHARE = 0.03, 0.05  # a shift of μ, and the share of cells, that are worth a sentence


def affordable(forward: Equilibrium) -> bool:
    """Tell whether the finer solution costs no more than the fit itself."""
    dim = forward.mesh.dim
    most = MOST.get((dim, forward.factoriser.name), MOST[dim])
    return forward.n_free * CHILDREN[dim] <= most


def defect(forward: Equilibrium, state: State, tell=None) -> list[np.ndarray] | None:
    """Return what better cells would add to the measured nodes' displacements, (n, 1) per trial.

    As the fit sees displacements, see :class:`.misfit.Displacements`. A fit of measured ones has
    taken it for stiffness: its map is off by what the fit answers to these. None where the finer
    solution does not converge.
    """
    fine = forward.finer()
    eta = np.zeros((fine.n_eta, state.eta.shape[1]))
    eta[fine.n_free :] = state.eta[forward.n_free :]
    if not forward.law.linear:
        eta[: fine.n_free] = _start(forward, fine, state)
    try:
        solved = fine.settle(state.x, eta, tell).eta
    except InputError:
        return None
    # the finer mesh keeps the nodes' numbers
    moved = fine.measured @ solved[fine.coarse] - forward.measured @ state.eta[forward.coarse]
    gap = forward.measured.T @ moved
    return list(RICHARDSON * gap.T[:, :, None])


def contradicted(gap: list[np.ndarray], residuals: list[np.ndarray]) -> bool:
    """Tell whether the data were made with these very cells: their error is nowhere in them.

    A fit can take a part of the cells' error for stiffness, never nearly all of it.
    """
    size, left = (np.sqrt(sum((one**2).sum() for one in each)) for each in (gap, residuals))
    return bool(size > FAR_LARGER * left)


def _start(forward, fine, state):
    """The coarse solution at the finer mesh's nodes."""
    u = forward.displacements(state.eta)
    _, _, between = forward.mesh.refined()
    flat = np.stack([(between @ v).ravel() for v in u], axis=1)
    return fine.Z[:, : fine.n_free].T @ flat


def bias_warning(bias, std, element: str) -> str | None:
    """Return a sentence where the cells' error is larger than that of the measurements.

    Parameters
    ----------
    bias, std : (n_cells,)
        Of the unknown cells' μ, relative to μ: the cells' error, the measurements' standard
        deviation.
    """
    larger = (np.abs(bias) > std) & (np.abs(bias) > NOTABLE)
    if larger.mean() < SHARE:
        return None
    mend = "choose element 'locking-free'" if element == "linear" else "take smaller cells"
    return (
        f"the mesh itself shifts {larger.mean():.0%} of the unknown cells by about "
        f"{np.median(np.abs(bias[larger])):.0%} of μ, more than the errors of the displacements do "
        f"({np.median(std[larger]):.1%}): {mend} (the standard deviations hold this shift)"
    )
