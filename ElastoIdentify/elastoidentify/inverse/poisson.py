"""Poisson's ratio that nobody knows exactly: found together with the map, one per label.

Near incompressibility the stress is as sensitive to ν as to the shape of the body (λ grows like
1/(1 − 2ν)), and a map of E alone with a wrong ν bends E until the balance holds. Here ν is a
parameter of the fit, with a normal prior of given centre and width; all standard deviations then
hold what is not known of it.

Displacements are nearly linear in ν, not in its logarithms, so ν itself is the parameter. It is
bent near the ends of what a stable material may have,

    ν = ½ − b(3/2 − b(1 + q)),    b(y) = w log(1 + exp(y/w)),

which is q to within w exp(−distance/w), and for any q lies between −1 and ½.
"""

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.special import expit

from .parameterization import FreeRatio, LogParameters, Unknowns
from .prior import Gaussian

BEND = 0.002  # w: where ν begins to feel its bounds
FAR = 3.0  # widths of the prior from its centre that are worth a sentence


def free(unknowns: Unknowns, centre: float, std: float, labels: np.ndarray | None) -> Unknowns:
    """Return unknowns whose Poisson's ratio is one more unknown of every unknown label.

    Parameters
    ----------
    centre, std : float
        Of the prior.
    labels : (n_cells,) int, optional
        None: one ν for all.
    """
    cells = ~unknowns.known
    names, number = np.zeros(1, int), np.full(len(cells), -1)
    number[cells] = 0
    if labels is not None:
        names, number[cells] = np.unique(labels[cells], return_inverse=True)
    return replace(unknowns, ratio=FreeRatio(centre, std, number, names))


def ratio(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ν and dν/dq."""
    inner = BEND * np.logaddexp(0, (1 + np.asarray(q, float)) / BEND)
    outer = BEND * np.logaddexp(0, (1.5 - inner) / BEND)
    return 0.5 - outer, expit((1.5 - inner) / BEND) * expit((1 + q) / BEND)


def unbent(poisson: float) -> float:
    """Return q of a ν; the inverse of :func:`ratio`."""

    def inverse(y):  # of b
        return y + BEND * np.log(-np.expm1(-y / BEND))

    return float(inverse(1.5 - inverse(0.5 - poisson)) - 1)


def of_unit_young(nu: np.ndarray, plane_stress: bool):
    """Return (λ, μ) of E = 1, and their derivatives by ν; in plane stress λ* = ν/(1 − ν²)."""
    mu, mu_slope = 1 / (2 * (1 + nu)), -1 / (2 * (1 + nu) ** 2)
    below = (1 - nu) * (1 + nu) if plane_stress else (1 + nu) * (1 - 2 * nu)
    return (nu / below, mu), ((1 + (1 if plane_stress else 2) * nu**2) / below**2, mu_slope)


def parameters(unknowns: Unknowns, centres: np.ndarray) -> LogParameters:
    """Return the parameters of a fit, with ν among them where it is unknown."""
    return (PoissonParameters if unknowns.ratio else LogParameters)(unknowns, centres)


class PoissonParameters(LogParameters):
    """log E of each group, then (q − q₀)/std of each label, with q₀ and std those of the prior.

    So that a step of one is as large as what is not known beforehand, like one of a log-modulus.
    """

    def __init__(self, unknowns: Unknowns, centres: np.ndarray):
        super().__init__(unknowns, centres)
        free = unknowns.ratio
        self.centre, self.n_fields, self.n_ratios = unbent(free.centre), self.n, len(free.labels)
        self.cells = np.flatnonzero(~unknowns.known)
        self.of_cell = free.number[self.cells]
        self.n += self.n_ratios
        self.start = np.concatenate([self.start, np.zeros(self.n_ratios)])
        count = np.bincount(self.of_cell)[:, None]
        place = np.stack([np.bincount(self.of_cell, x) for x in centres[self.cells].T], axis=1)
        self.places = np.vstack([self.places, place / count])

    def ratios(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ν of each label and its derivative by its parameter, (n_ratios,) each."""
        std = self.unknowns.ratio.std
        poisson, slope = ratio(self.centre + std * x[self.n_fields :])
        return poisson, std * slope

    def moduli(self, x):
        unknowns, cells = self.unknowns, self.cells
        lam, mu = unknowns.lam_known.copy(), unknowns.mu_known.copy()
        young = np.exp(x[unknowns.group[cells]])
        poisson = self.ratios(x)[0][self.of_cell]
        (lam[cells], mu[cells]), _ = of_unit_young(poisson, unknowns.plane_stress)
        lam[cells] *= young
        mu[cells] *= young
        return lam, mu

    def slopes(self, x):
        cells, shape = self.cells, (len(self.unknowns.group), self.n)
        poisson, by_parameter = (part[self.of_cell] for part in self.ratios(x))
        factors = of_unit_young(poisson, self.unknowns.plane_stress)
        group = self.unknowns.group[cells]
        young = np.exp(x[group])
        rows, columns = np.tile(cells, 2), np.concatenate([group, self.n_fields + self.of_cell])
        return tuple(
            sp.csr_matrix(
                (np.concatenate([young * unit, young * slope * by_parameter]), (rows, columns)),
                shape,
            )
            for unit, slope in zip(*factors, strict=True)
        )

    def prior(self):
        """Return what is known of ν beforehand."""
        precision = np.zeros(self.n)
        precision[self.n_fields :] = 1.0
        return [Gaussian(self.start.copy(), precision)]

    def ratios_found(self, x: np.ndarray, errors: np.ndarray) -> list[dict]:
        """Return ν of each label, as found at x (n,) with samples of its error (n, m)."""
        given = self.unknowns.ratio
        poisson, slope = self.ratios(x)
        std = slope * np.sqrt((errors[self.n_fields :] ** 2).mean(axis=1))
        return [
            {"label": int(label), "poisson": float(value), "std": float(one),
             "given": given.centre, "given_std": given.std}
            for label, value, one in zip(given.labels, poisson, std, strict=True)
        ]  # fmt: skip


def far_warnings(found: list[dict]) -> list[str]:
    """Return a sentence for each ν that contradicts what was given."""
    return [
        f"Poisson's ratio of label {one['label']} comes out as {one['poisson']:.3f} ± "
        f"{one['std']:.3f}, far from the {one['given']:g} ± {one['given_std']:g} given: check "
        "both, and whether the tissue may move out of the imaged plane"
        for one in found
        if abs(one["poisson"] - one["given"]) > FAR * one["given_std"]
    ]
