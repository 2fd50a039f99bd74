"""The unknowns θ and how λ and μ of every cell follow from them, linearly."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..errors import InputError
from ..fem.elastic_constants import lame_from_young, plane_stress_lambda


@dataclass(frozen=True)
class FreeRatio:
    """Poisson's ratio of the unknown cells, one per label, as it is known before the fit.

    Parameters
    ----------
    centre, std : float
        Of a normal distribution.
    number : (n_cells,) int
        Which label's ν each cell has, −1 for known cells.
    labels : (n_labels,) int
        Their names.
    """

    centre: float
    std: float
    number: np.ndarray
    labels: np.ndarray


@dataclass(frozen=True)
class Unknowns:
    """λ = lam_known + L θ, μ = mu_known + M θ.

    θ is ordered group by group: (λ, μ) of each group, or its E alone. A group is one unknown cell,
    or all unknown cells of one label. In plane stress λ stands for λ* throughout.

    Parameters
    ----------
    group : (n_cells,) int
        Number of each cell's group, −1 for known cells.
    per_group : int
        2 (λ, μ) or 1 (E with ν given).
    lam, mu : csr_matrix, (n_cells, n_params)
        L and M.
    lam_known, mu_known : (n_cells,)
        Zero where not known.
    ratio : FreeRatio, optional
        Given where ν is unknown, too; L and M are those of its centre.
    plane_stress : bool
        λ stands for λ*.
    """

    group: np.ndarray
    per_group: int
    lam: sp.csr_matrix
    mu: sp.csr_matrix
    lam_known: np.ndarray
    mu_known: np.ndarray
    ratio: FreeRatio | None = None
    plane_stress: bool = False

    @property
    def n_groups(self) -> int:
        return int(self.group.max(initial=-1)) + 1

    @property
    def n_params(self) -> int:
        return self.n_groups * self.per_group

    @property
    def known(self) -> np.ndarray:
        """True for known cells. Shape (n_cells,)."""
        return self.group < 0

    @property
    def per_cell(self) -> bool:
        """True if every unknown cell is a group of its own."""
        return self.n_groups == int((~self.known).sum())

    def moduli(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return λ, μ of all cells, (n_cells, …), for θ (n_params, …)."""
        shape = (-1,) + (1,) * (np.ndim(theta) - 1)
        return (
            self.lam @ theta + self.lam_known.reshape(shape),
            self.mu @ theta + self.mu_known.reshape(shape),
        )

    def flat_guess(self) -> np.ndarray:
        """Return θ of a body as stiff as the known material: the median of the known cells."""
        known = self.known
        lam, mu = np.median(self.lam_known[known]), np.median(self.mu_known[known])
        if self.per_group == 2:
            return np.tile([lam, mu], self.n_groups)
        return np.full(self.n_groups, mu / self.mu.max())


def make_unknowns(
    young: np.ndarray,
    poisson: np.ndarray,
    *,
    plane_stress: bool = False,
    poisson_ratio: float | None = None,
    labels: np.ndarray | None = None,
) -> Unknowns:
    """Return the unknowns of a mesh whose known cells have E, ν given (NaN elsewhere).

    Parameters
    ----------
    young, poisson : (n_cells,)
    plane_stress : bool
        Use λ* = 2λμ/(λ+2μ) in place of λ.
    poisson_ratio : float, optional
        ν of the unknown cells; then E alone is unknown.
    labels : (n_cells,), optional
        Group the unknown cells by label.
    """
    known = np.isfinite(young)
    if not known.any():
        raise InputError(
            "no cell is known, and without a known material the scale of the stiffness cannot be "
            "found: give the pad's Young's modulus and Poisson's ratio"
        )
    if known.all():
        raise InputError("every cell is known, there is nothing to identify")
    group = np.full(len(young), -1)
    if labels is None:
        group[~known] = np.arange((~known).sum())
    else:
        group[~known] = np.unique(labels[~known], return_inverse=True)[1].ravel()
    lam_known, mu_known = (np.where(known, x, 0.0) for x in _lame(young, poisson, plane_stress))
    cells = np.flatnonzero(~known)
    if poisson_ratio is None:
        per_group, unit = 2, (1.0, 1.0)
        columns = (2 * group[cells], 2 * group[cells] + 1)
    else:
        per_group, unit = 1, _lame(1.0, poisson_ratio, plane_stress)
        columns = (group[cells], group[cells])
    shape = (len(young), per_group * (group.max() + 1))
    lam, mu = (
        sp.csr_matrix((np.full(len(cells), float(u)), (cells, column)), shape)
        for u, column in zip(unit, columns, strict=True)
    )
    return Unknowns(group, per_group, lam, mu, lam_known, mu_known, plane_stress=plane_stress)


def _lame(young, poisson, plane_stress):
    lam, mu = lame_from_young(young, poisson)
    return (plane_stress_lambda(lam, mu), mu) if plane_stress else (lam, mu)


class LogParameters:
    """The parameters x that the regularized fit moves, and λ, μ of the cells as functions of them.

    x holds fields, one value per group each: log μ and log(λ/μ) (that is, ν), or log E, since
    neighbouring tissues differ in stiffness more than in compressibility. A subclass may append
    parameters of other kinds: it lengthens `start` and `places` and gives them columns in `slopes`.

    Attributes
    ----------
    n : int
        Length of x.
    start : (n,)
        x of a body as stiff as the known material.
    places : (n, d)
        Where each parameter is: the mean of its group's cells.
    """

    def __init__(self, unknowns: Unknowns, centres: np.ndarray):
        self.unknowns = unknowns
        self.fields, self.start = _fields(unknowns, unknowns.flat_guess())
        self.n = len(self.start)
        cells = np.flatnonzero(~unknowns.known)
        group, count = unknowns.group[cells], np.bincount(unknowns.group[cells])[:, None]
        place = np.stack([np.bincount(group, x) for x in centres[cells].T], axis=1) / count
        self.places = np.tile(place, (unknowns.per_group, 1))

    def moduli(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return λ, μ of all cells, (n_cells,) each (in plane stress: λ*, μ)."""
        return self.unknowns.moduli(np.exp(self.fields @ x))

    def slopes(self, x: np.ndarray) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """Return ∂λ/∂x, ∂μ/∂x, (n_cells, n) each."""
        theta = sp.diags(np.exp(self.fields @ x)) @ self.fields
        return (self.unknowns.lam @ theta).tocsr(), (self.unknowns.mu @ theta).tocsr()

    def prior(self) -> list:
        """Return the prior terms of parameters beyond the fields."""
        return []

    def stretches(self, x: np.ndarray) -> np.ndarray | None:
        """Return the stretch out of the plane of each trial; None: there is none."""

    def stretch_column(self, trial: int) -> sp.csr_matrix | None:
        """Return the derivative of a trial's stretch by x, (1, n); None: it is no parameter."""

    def stretches_found(self, x: np.ndarray, errors: np.ndarray) -> list[dict]:
        """Return the stretches out of the plane that are given or parameters themselves."""
        return []

    def ratios_found(self, x: np.ndarray, errors: np.ndarray) -> list[dict]:
        """Return Poisson's ratios that are parameters themselves."""
        return []


def _fields(unknowns, flat):
    """Return X with log θ = X x, and x of the flat guess."""
    n = unknowns.n_groups
    if unknowns.per_group == 1:
        return sp.identity(n, format="csr"), np.log(flat)
    group = np.arange(n)
    rows = np.concatenate([2 * group, 2 * group, 2 * group + 1])
    cols = np.concatenate([group, n + group, group])
    fields = sp.csr_matrix((np.ones(3 * n), (rows, cols)), (2 * n, 2 * n))
    lam, mu = flat.reshape(-1, 2).T
    return fields, np.concatenate([np.log(mu), np.log(np.maximum(lam, 1e-3 * mu) / mu)])
