"""Kinematics: elastic laws whose nodal forces are linear in λ and μ.

The strain energy is μ W_μ(H) + ½ λ I(H)², with H = ∂u/∂x the displacement gradient, F = I + H the
deformation gradient, and I a measure of the change of volume: tr ε, tr E or ln J. I is written as
a function g of a *dilatation* d(H) of which means over several cells can be taken (tr ε, tr E,
J − 1): that is all that cells without locking need (:mod:`.cells`).

To add a law, add a small class to :data:`KINEMATICS`. Written in H, the laws keep all digits of
small displacements. Formulas: Bonet and Wood, Nonlinear Continuum Mechanics for Finite Element
Analysis (2008), chapter 6.

In plane strain F has the third diagonal entry 1, which leaves all three laws in the plane. With a
stretch out of the plane (generalised plane strain, F₃₃ = 1 + e) it only adds a number to I.
"""

from copy import copy
from typing import Protocol

import numpy as np


class Kinematics(Protocol):
    """An elastic law P(H) = λ P_λ(H) + μ P_μ(H), the first Piola-Kirchhoff stress."""

    name: str
    linear: bool  # is P linear in H?

    def stress(self, H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return P_λ, P_μ, both (…, d, d), for H (…, d, d)."""

    def tangent(self, H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ∂P_λ/∂H, ∂P_μ/∂H, both (…, d, d, d, d): [i, j, k, l] = ∂P_ij/∂H_kl."""

    def shear_stress(self, H: np.ndarray) -> np.ndarray:
        """Return P_μ."""

    def shear_tangent(self, H: np.ndarray) -> np.ndarray:
        """Return ∂P_μ/∂H."""

    def dilatation(self, H: np.ndarray) -> np.ndarray:
        """Return d(H), (…)."""

    def dilatation_slope(self, H: np.ndarray) -> np.ndarray:
        """Return ∂d/∂H, (…, d, d)."""

    def dilatation_curvature(self, H: np.ndarray) -> np.ndarray | None:
        """Return ∂²d/∂H², (…, d, d, d, d), or None where it is zero."""

    def volume_strain(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return p = g g′ and p′, for the energy ½ λ g(d)²: stress and stiffness against d."""

    def stretched(self, e: float) -> "Kinematics":
        """Return the law in a plane that is stretched across, F₃₃ = 1 + e."""

    def across_slope(self, d: np.ndarray) -> np.ndarray:
        """Return ∂p/∂e."""

    def of(self, cells: np.ndarray) -> "Kinematics":
        """Return the law of some cells, (n,) int, where it differs from cell to cell."""


def _eye(H):
    return np.broadcast_to(np.eye(H.shape[-1]), H.shape)


def _outer(A, B):
    return np.einsum("...ij,...kl->...ijkl", A, B)


def _trace(A):
    return np.trace(A, axis1=-2, axis2=-1)


def _transpose(A):
    return np.swapaxes(A, -1, -2)


def _cofactors(A):
    """det(A) A⁻ᵀ of matrices (…, 2, 2) or (…, 3, 3), many times faster than LAPACK one by one."""
    x = np.ascontiguousarray(np.moveaxis(A, (-2, -1), (0, 1)))
    if len(x) == 2:
        return np.stack([x[1, 1], -x[1, 0], -x[0, 1], x[0, 0]], -1).reshape(A.shape)
    found = np.empty(A.shape)
    for i in range(3):
        for j in range(3):
            (k, m), (p, q) = ((n - 2, n - 1) for n in (i, j))  # the next two, in a circle
            found[..., i, j] = x[k, p] * x[m, q] - x[k, q] * x[m, p]
    return found


def _det(A):
    """Determinants of matrices (…, 2, 2) or (…, 3, 3)."""
    return (A[..., 0, :] * _cofactors(A)[..., 0, :]).sum(-1)


def _green(H):
    """E = ½(FᵀF − I)."""
    return (H + _transpose(H) + _transpose(H) @ H) / 2


def _spread(scalar, n):
    return np.asarray(scalar)[(...,) + (None,) * n]


class _Law:
    """P_λ and its derivative from the dilatation, by the chain rule."""

    across, across_by_e = 0.0, 1.0  # what F₃₃ = 1 + e adds to I, and its derivative by e

    def of(self, cells):
        return self

    def stretched(self, e):
        law = copy(self)
        law.across, law.across_by_e = self._across(e)
        return law

    def across_slope(self, d):
        return self.across_by_e * self._measure_slope(d)

    def stress(self, H):
        with np.errstate(divide="ignore", invalid="ignore"):
            pressure, _ = self.volume_strain(self.dilatation(H))
        return _spread(pressure, 2) * self.dilatation_slope(H), self.shear_stress(H)

    def tangent(self, H):
        with np.errstate(divide="ignore", invalid="ignore"):
            pressure, stiffness = self.volume_strain(self.dilatation(H))
        slope, curvature = self.dilatation_slope(H), self.dilatation_curvature(H)
        lam = _spread(stiffness, 4) * _outer(slope, slope)
        if curvature is not None:
            lam = lam + _spread(pressure, 4) * curvature
        return lam, self.shear_tangent(H)


class _TraceMeasure(_Law):
    """I = d, a trace."""

    def volume_strain(self, d):
        return d + self.across, np.ones_like(d)

    def _measure_slope(self, d):
        return np.ones_like(d)


class SmallStrain(_TraceMeasure):
    """Hooke's law: P_λ = tr(ε) I, P_μ = 2ε, ε = sym H."""

    name = "small-strain"
    linear = True

    def shear_stress(self, H):
        return H + _transpose(H)

    def shear_tangent(self, H):
        eye = _eye(H)
        return np.einsum("...ik,...jl->...ijkl", eye, eye) + np.einsum(
            "...il,...jk->...ijkl", eye, eye
        )

    def _across(self, e):
        return e, 1.0

    def dilatation(self, H):
        return _trace(H)

    def dilatation_slope(self, H):
        return _eye(H)

    def dilatation_curvature(self, H):
        return None


class StVenantKirchhoff(_TraceMeasure):
    """S = λ tr(E) I + 2μE, P = F S, E = ½(FᵀF − I)."""

    name = "st-venant-kirchhoff"
    linear = False

    def shear_stress(self, H):
        return 2 * (_eye(H) + H) @ _green(H)

    def shear_tangent(self, H):
        eye, E = _eye(H), _green(H)
        F = eye + H
        FFt = F @ _transpose(F)
        return (
            2 * np.einsum("...ik,...lj->...ijkl", eye, E)
            + np.einsum("...il,...kj->...ijkl", F, F)
            + np.einsum("...ik,...jl->...ijkl", FFt, eye)
        )

    def _across(self, e):
        return e + e**2 / 2, 1.0 + e

    def dilatation(self, H):
        return _trace(_green(H))

    def dilatation_slope(self, H):
        return _eye(H) + H

    def dilatation_curvature(self, H):
        eye = _eye(H)
        return np.einsum("...ik,...jl->...ijkl", eye, eye)


class NeoHookean(_Law):
    """Compressible neo-Hookean: P = μ(F − F⁻ᵀ) + λ ln J F⁻ᵀ, J = det F > 0; d = J − 1."""

    name = "neo-hookean"
    linear = False

    def shear_stress(self, H):
        # F − F⁻ᵀ = F⁻ᵀ(FᵀF − I)
        return self._inverse_t(H) @ (2 * _green(H))

    def shear_tangent(self, H):
        eye, inverse_t = _eye(H), self._inverse_t(H)
        # ∂(F⁻ᵀ)_ij/∂F_kl = −F⁻ᵀ_il F⁻ᵀ_kj
        change = np.einsum("...il,...kj->...ijkl", inverse_t, inverse_t)
        return np.einsum("...ik,...jl->...ijkl", eye, eye) + change

    def dilatation(self, H):
        # det(I + H) − 1 is the sum of the principal minors of H of every order
        trace = _trace(H)
        minors = trace + _det(H)
        if H.shape[-1] == 3:
            minors = minors + (trace**2 - _trace(H @ H)) / 2
        return minors

    def dilatation_slope(self, H):
        return _spread(1 + self.dilatation(H), 2) * self._inverse_t(H)

    def dilatation_curvature(self, H):
        inverse_t = self._inverse_t(H)
        change = np.einsum("...il,...kj->...ijkl", inverse_t, inverse_t)
        return _spread(1 + self.dilatation(H), 4) * (_outer(inverse_t, inverse_t) - change)

    def volume_strain(self, d):
        with np.errstate(divide="ignore", invalid="ignore"):
            log = np.log1p(d) + self.across
            return log / (1 + d), (1 - log) / (1 + d) ** 2

    def _measure_slope(self, d):
        return 1 / (1 + d)

    def _across(self, e):
        return np.log1p(e), 1 / (1 + e)

    @staticmethod
    def _inverse_t(H):
        F = _eye(H) + H
        return _cofactors(F) / _det(F)[..., None, None]


class NeoHookeanPlaneStress(NeoHookean):
    """The neo-Hookean law of a sheet that is free across, P₃₃ = 0, for λ* and μ.

    The stretch s across follows from the change of area J = det F of the sheet,

        μ(s² − 1) + λ ln(J s) = 0,        P = μ(F − s² F⁻ᵀ) = μ(F − F⁻ᵀ) + λ* p J F⁻ᵀ,

    and depends on κ = λ/μ = 2ν/(1 − 2ν) alone: with ν given the forces are linear in E still. With
    λ* = 2λμ/(λ + 2μ), which takes λ's place in plane stress, p = −(1/2 + 1/κ)(s² − 1)/J.

    Parameters
    ----------
    poisson : (n_cells,)
        ν of each cell.
    """

    NEWTON = 12  # from the small-strain stretch, on a convex function: digits double in each step
    LEAST = 1e-9  # of κ: below, cork in effect

    def __init__(self, poisson: np.ndarray):
        ratio = 2 * np.asarray(poisson, float) / (1 - 2 * np.asarray(poisson, float))
        self.ratio = np.where(np.abs(ratio) < self.LEAST, self.LEAST, ratio)

    def of(self, cells):
        law = copy(self)
        law.ratio = self.ratio[cells]
        return law

    def log_stretch(self, d: np.ndarray) -> np.ndarray:
        """Return ln s for J = 1 + d, (n, …) like d."""
        kappa, log = self._ratio(d), np.log1p(d)
        t = -kappa * log / (kappa + 2)
        for _ in range(self.NEWTON):
            square = np.exp(2 * t)
            t = t - (np.expm1(2 * t) + kappa * (log + t)) / (2 * square + kappa)
        return t

    def volume_strain(self, d):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            kappa, t = self._ratio(d), self.log_stretch(d)
            square, gain, factor = np.exp(2 * t), np.expm1(2 * t), -(1 / 2 + 1 / kappa)
            slope = -2 * square * kappa / (2 * square + kappa) - gain
            return factor * gain / (1 + d), factor * slope / (1 + d) ** 2

    def _ratio(self, d):
        return self.ratio.reshape(self.ratio.shape + (1,) * (np.ndim(d) - np.ndim(self.ratio)))


KINEMATICS: dict[str, Kinematics] = {
    law.name: law for law in (SmallStrain(), StVenantKirchhoff(), NeoHookean())
}
