"""Kinematics: elastic laws whose nodal forces are linear in λ and μ.

To add one, add a small class to :data:`KINEMATICS`: the first Piola-Kirchhoff stress per unit λ and
per unit μ as functions of the displacement gradient H = ∂u/∂x, and their derivatives by it; F = I +
H is the deformation gradient. Written in H, the laws keep all digits of small displacements.
Formulas: Bonet and Wood, Nonlinear Continuum Mechanics for Finite Element Analysis (2008),
chapter 6.

In plane strain F has the third diagonal entry 1, which leaves all three laws in the plane.
"""

from typing import Protocol

import numpy as np


class Kinematics(Protocol):
    """An elastic law P(H) = λ P_λ(H) + μ P_μ(H)."""

    name: str
    linear: bool  # is P linear in H?

    def stress(self, H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return P_λ, P_μ, both (…, d, d), for H (…, d, d)."""

    def tangent(self, H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ∂P_λ/∂H, ∂P_μ/∂H, both (…, d, d, d, d): [i, j, k, l] = ∂P_ij/∂H_kl."""


def _eye(H):
    return np.broadcast_to(np.eye(H.shape[-1]), H.shape)


def _outer(A, B):
    return np.einsum("...ij,...kl->...ijkl", A, B)


def _trace(A):
    return np.trace(A, axis1=-2, axis2=-1)[..., None, None]


def _transpose(A):
    return np.swapaxes(A, -1, -2)


def _green(H):
    """E = ½(FᵀF − I)."""
    return (H + _transpose(H) + _transpose(H) @ H) / 2


class SmallStrain:
    """Hooke's law: P_λ = tr(ε) I, P_μ = 2ε, ε = sym H."""

    name = "small-strain"
    linear = True

    def stress(self, H):
        return _trace(H) * _eye(H), H + _transpose(H)

    def tangent(self, H):
        eye = _eye(H)
        mu = np.einsum("...ik,...jl->...ijkl", eye, eye) + np.einsum(
            "...il,...jk->...ijkl", eye, eye
        )
        return _outer(eye, eye), mu


class StVenantKirchhoff:
    """S = λ tr(E) I + 2μE, P = F S, E = ½(FᵀF − I)."""

    name = "st-venant-kirchhoff"
    linear = False

    def stress(self, H):
        F, E = _eye(H) + H, _green(H)
        return _trace(E) * F, 2 * F @ E

    def tangent(self, H):
        eye, E = _eye(H), _green(H)
        F = eye + H
        unit = np.einsum("...ik,...jl->...ijkl", eye, eye)
        lam = _trace(E)[..., None, None] * unit + _outer(F, F)
        FFt = F @ _transpose(F)
        mu = (
            2 * np.einsum("...ik,...lj->...ijkl", eye, E)
            + np.einsum("...il,...kj->...ijkl", F, F)
            + np.einsum("...ik,...jl->...ijkl", FFt, eye)
        )
        return lam, mu


class NeoHookean:
    """Compressible neo-Hookean: P = μ(F − F⁻ᵀ) + λ ln J F⁻ᵀ, J = det F > 0."""

    name = "neo-hookean"
    linear = False

    def stress(self, H):
        inverse_t = self._inverse_t(H)
        # F − F⁻ᵀ = F⁻ᵀ(FᵀF − I)
        return self._log_det(H) * inverse_t, inverse_t @ (2 * _green(H))

    def tangent(self, H):
        eye, inverse_t = _eye(H), self._inverse_t(H)
        # ∂(F⁻ᵀ)_ij/∂F_kl = −F⁻ᵀ_il F⁻ᵀ_kj
        change = -np.einsum("...il,...kj->...ijkl", inverse_t, inverse_t)
        lam = _outer(inverse_t, inverse_t) + self._log_det(H)[..., None, None] * change
        return lam, np.einsum("...ik,...jl->...ijkl", eye, eye) - change

    @staticmethod
    def _inverse_t(H):
        return _transpose(np.linalg.inv(_eye(H) + H))

    @staticmethod
    def _log_det(H):
        # det(I + H) − 1 is the sum of the principal minors of H of every order
        trace = np.trace(H, axis1=-2, axis2=-1)
        minors = trace + np.linalg.det(H)
        if H.shape[-1] == 3:
            minors += (trace**2 - np.trace(H @ H, axis1=-2, axis2=-1)) / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log1p(minors)[..., None, None]


KINEMATICS: dict[str, Kinematics] = {
    law.name: law for law in (SmallStrain(), StVenantKirchhoff(), NeoHookean())
}
