"""Stretch out of the plane, one number per trial: given, or found together with the map.

Generalised plane strain: the body is stretched across the imaged plane by the same e everywhere,
F₃₃ = 1 + e. That changes the volume and so adds to the in-plane stress, in proportion to λ: by
λ e I for small strain (`stretched` of :class:`~elastoidentify.fem.constitutive.Kinematics` for the
others). The forces stay linear in λ and μ, and e is one more parameter of the trial.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from .prior import Gaussian

HARDLY = 0.7  # found over given standard deviation from which the prior has spoken, not the data
FAR = 3.0  # widths of the prior from its centre that are worth a sentence


@dataclass(frozen=True)
class Stretch:
    """What is known of e before the fit: (n_trials,) centres and a common standard deviation."""

    centre: np.ndarray
    std: float
    trials: np.ndarray  # (n_trials,) int, as users number them


class StretchParameters:
    """Other parameters, then (e − e₀)/std of each trial where e is not known exactly.

    With the methods and attributes of :class:`~.parameterization.LogParameters`.
    """

    def __init__(self, others, stretch: Stretch):
        self.others, self.stretch, self.unknowns = others, stretch, others.unknowns
        trials = len(stretch.centre)
        self.n_before, added = others.n, trials if stretch.std else 0
        self.n = others.n + added
        self.start = np.concatenate([others.start, np.zeros(added)])
        middle = others.places.mean(axis=0)
        self.places = np.vstack([others.places, np.tile(middle, (added, 1))])

    def moduli(self, x):
        return self.others.moduli(x[: self.n_before])

    def slopes(self, x):
        beside = sp.csr_matrix((len(self.unknowns.group), self.n - self.n_before))
        parts = self.others.slopes(x[: self.n_before])
        return tuple(sp.hstack([part, beside], format="csr") for part in parts)

    def stretches(self, x: np.ndarray) -> np.ndarray:
        """Return e of each trial, (n_trials,)."""
        centre, std = self.stretch.centre, self.stretch.std
        return centre + std * x[self.n_before :] if std else centre

    def stretch_column(self, trial: int) -> sp.csr_matrix | None:
        """Return ∂e/∂x of a trial, (1, n); None where e is known."""
        if not self.stretch.std:
            return None
        place = ([0], [self.n_before + trial])
        return sp.csr_matrix(([self.stretch.std], place), (1, self.n))

    def prior(self):
        before = [_padded(term, self.n) for term in self.others.prior()]
        if not self.stretch.std:
            return before
        precision = np.zeros(self.n)
        precision[self.n_before :] = 1.0
        return [*before, Gaussian(self.start.copy(), precision)]

    def ratios_found(self, x, errors):
        return self.others.ratios_found(x[: self.n_before], errors[: self.n_before])

    def stretches_found(self, x: np.ndarray, errors: np.ndarray) -> list[dict]:
        """Return e of each trial, as found at x (n,) with samples of its error (n, m)."""
        std = np.zeros(len(self.stretch.centre))
        if self.stretch.std:
            std = self.stretch.std * np.sqrt((errors[self.n_before :] ** 2).mean(axis=1))
        given = self.stretch
        found = zip(given.trials, self.stretches(x), std, given.centre, strict=True)
        return [
            {"trial": int(k), "stretch": float(e), "std": float(s), "given": float(g),
             "given_std": float(given.std)}
            for k, e, s, g in found
        ]  # fmt: skip


def _padded(term: Gaussian, n: int) -> Gaussian:
    fill = np.zeros(n - len(term.centre))
    return Gaussian(np.concatenate([term.centre, fill]), np.concatenate([term.precision, fill]))


def warnings_of(found: list[dict]) -> list[str]:
    """Return what is to be said of stretches that were sought."""
    out = []
    for one in (one for one in found if one["given_std"]):
        value = (
            f"the stretch out of the plane of trial {one['trial']} comes out as "
            f"{one['stretch']:.2%} ± {one['std']:.2%}"
        )
        if one["std"] > HARDLY * one["given_std"]:
            out.append(
                f"{value}: mostly what was given, these data hardly tell it (Poisson's ratio and "
                "λ can take its place); give the stretch, or know Poisson's ratio better"
            )
        elif abs(one["stretch"] - one["given"]) > FAR * one["given_std"]:
            out.append(
                f"{value}, far from the {one['given']:.2%} ± {one['given_std']:.2%} given: check "
                "Poisson's ratio, and whether pad and tissue slip"
            )
    return out
