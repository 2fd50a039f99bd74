"""Kinematics: elastic laws whose nodal forces are linear in λ and μ.

To add one, add a small class to :data:`KINEMATICS`: the first Piola-Kirchhoff stress per unit λ and
per unit μ as functions of F = I + ∂u/∂x, and their derivatives by F. Formulas: Bonet and Wood,
Nonlinear Continuum Mechanics for Finite Element Analysis (2008), chapter 6.

In plane strain F has the third diagonal entry 1, which leaves all three laws in the plane.
"""

from typing import Protocol

import numpy as np


class Kinematics(Protocol):
    """An elastic law P(F) = λ P_λ(F) + μ P_μ(F)."""

    name: str
    linear: bool  # is P linear in ∂u/∂x?

    def stress(self, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return P_λ, P_μ, both (…, d, d), for F (…, d, d)."""

    def tangent(self, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ∂P_λ/∂F, ∂P_μ/∂F, both (…, d, d, d, d): [i, j, k, l] = ∂P_ij/∂F_kl."""


def _eye(F):
    return np.broadcast_to(np.eye(F.shape[-1]), F.shape)


def _outer(A, B):
    return np.einsum("...ij,...kl->...ijkl", A, B)


def _trace(A):
    return np.trace(A, axis1=-2, axis2=-1)[..., None, None]


def _transpose(A):
    return np.swapaxes(A, -1, -2)


class SmallStrain:
    """Hooke's law: P_λ = tr(ε) I, P_μ = 2ε, ε = sym(∂u/∂x)."""

    name = "small-strain"
    linear = True

    def stress(self, F):
        H = F - np.eye(F.shape[-1])
        return _trace(H) * _eye(F), H + _transpose(H)

    def tangent(self, F):
        eye = _eye(F)
        mu = np.einsum("...ik,...jl->...ijkl", eye, eye) + np.einsum(
            "...il,...jk->...ijkl", eye, eye
        )
        return _outer(eye, eye), mu


class StVenantKirchhoff:
    """S = λ tr(E) I + 2μE, P = F S, E = ½(FᵀF − I)."""

    name = "st-venant-kirchhoff"
    linear = False

    def stress(self, F):
        E = self._strain(F)
        return _trace(E) * F, 2 * F @ E

    def tangent(self, F):
        E, eye = self._strain(F), _eye(F)
        unit = np.einsum("...ik,...jl->...ijkl", eye, eye)
        lam = _trace(E)[..., None, None] * unit + _outer(F, F)
        FFt = F @ _transpose(F)
        mu = (
            2 * np.einsum("...ik,...lj->...ijkl", eye, E)
            + np.einsum("...il,...kj->...ijkl", F, F)
            + np.einsum("...ik,...jl->...ijkl", FFt, eye)
        )
        return lam, mu

    @staticmethod
    def _strain(F):
        # ½(H + Hᵀ + HᵀH) keeps the digits of a small H that ½(FᵀF − I) would lose
        H = F - np.eye(F.shape[-1])
        return (H + _transpose(H) + _transpose(H) @ H) / 2


class NeoHookean:
    """Compressible neo-Hookean: P = μ(F − F⁻ᵀ) + λ ln J F⁻ᵀ, J = det F > 0."""

    name = "neo-hookean"
    linear = False

    def stress(self, F):
        inverse_t = _transpose(np.linalg.inv(F))
        return self._log_det(F) * inverse_t, F - inverse_t

    def tangent(self, F):
        eye, inverse_t = _eye(F), _transpose(np.linalg.inv(F))
        # ∂(F⁻ᵀ)_ij/∂F_kl = −F⁻ᵀ_il F⁻ᵀ_kj
        change = -np.einsum("...il,...kj->...ijkl", inverse_t, inverse_t)
        lam = _outer(inverse_t, inverse_t) + self._log_det(F)[..., None, None] * change
        return lam, np.einsum("...ik,...jl->...ijkl", eye, eye) - change

    @staticmethod
    def _log_det(F):
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(np.linalg.det(F))[..., None, None]


KINEMATICS: dict[str, Kinematics] = {
    law.name: law for law in (SmallStrain(), StVenantKirchhoff(), NeoHookean())
}
