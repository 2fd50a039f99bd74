"""Whether a map of cells shows anything but noise.

The map departs by t, log-moduli, from one value for all of the tissue. As for a lesion that is
looked for (:mod:`.visibility`), v = J t is what that changes of the displacements, v⊥ the part of
it that neither the held nodes' motion, nor another stiffness of the whole, nor the cells' own error
explains, and d′ = √(v⊥ᵀ W v⊥)/σ its length in units of the noise. This is the root of the drop of
the misfit that the structure stands for.

A fit of n cells has as many places to put structure that is none. The largest of n normal numbers
exceeds √(2 ln n) with a chance that vanishes with n, so structure with a smaller d′ counts as noise
(the universal threshold of Donoho and Johnstone, Biometrika 81, 1994; Foster and George, Ann.
Statist. 22, 1994, charge the same 2 ln n for a parameter that is chosen among n).

That supposes errors that are independent. Those of a registration are alike between trials and
between neighbours, and make structure longer: `ALIKE`.
"""

import numpy as np

from .equilibrium import State
from .misfit import Misfit
from .visibility import detectability

ALIKE = 2.0
"""√(1 + ½) for two trials of one rest image, times √(1 + 6 · 0.2) for six neighbours whose errors
go together by 0.2 (docs/registration.md), is 1.8. Image phantoms without a lesion had d′ = 3.4 and
5.2 for a bound of 7.1, one with a lesion of 3:1 had 56."""


def found_structure(
    state: State,
    misfit: Misfit,
    scale: float,
    n_fields: int,
    labels: np.ndarray,
    dim: int,
    informed: bool = False,
    bias: np.ndarray | None = None,
    tell=None,
) -> dict:
    """Return how far a map's structure stands out of the noise.

    Parameters
    ----------
    state, misfit : State, Misfit
        The fit, linearised at its map; its first parameters are `n_fields` fields of a value per
        unknown cell.
    scale : float
        Noise in units of the measurements' stated errors.
    labels : (n,) int
        Of the unknown cells.
    dim : int
        Degrees of freedom per node.
    informed : bool
        The displacements came with their information: they are a registration's.
    bias : (n_x,), optional
        Shift of the parameters by the cells' own error.

    Returns
    -------
    dict
        ``apart``: d′ of the departure from one value for the whole; ``within``: of that from one
        value per label, None where there is one label only; ``noise``: what noise may reach.
    """
    n = len(labels)
    beside = np.zeros((len(state.x), 0)) if bias is None else bias[:, None]

    def size(groups):
        """d′ of the departure from one value per field and group."""
        per_field = np.kron(np.eye(n_fields), groups[:, None] == np.unique(groups))
        explained = np.zeros((len(state.x), per_field.shape[1]))
        explained[: n * n_fields] = per_field
        means = (per_field.T @ state.x[: n * n_fields]) / per_field.sum(axis=0)
        departure = np.zeros((len(state.x), 1))
        departure[: n * n_fields, 0] = state.x[: n * n_fields] - per_field @ means
        explained = np.hstack([explained, beside])
        return float(detectability(state, misfit, scale, departure, explained, dim, tell)[0])

    return {
        "apart": size(np.zeros(n, int)),
        "within": size(labels) if len(np.unique(labels)) > 1 else None,
        "noise": float(np.sqrt(2 * np.log(max(n, 2))) * (ALIKE if informed else 1.0)),
    }
