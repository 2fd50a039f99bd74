"""Isotropic elastic constants and their conversions.

λ, μ are the Lamé constants, E Young's modulus, ν Poisson's ratio; all moduli in one unit of stress.
"""

import numpy as np

NEGLIGIBLE_LAMBDA = 0.01  # of μ: an error of λ below this tells nothing about a material


def lame_from_young(young, poisson):
    """Return λ = νE/((1+ν)(1−2ν)), μ = E/(2(1+ν)); source paper, section on plane strain."""
    young, poisson = np.asarray(young, float), np.asarray(poisson, float)
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def young_from_lame(lam, mu):
    """Return E = μ(3λ+2μ)/(λ+μ), ν = λ/(2(λ+μ))."""
    lam, mu = np.asarray(lam, float), np.asarray(mu, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        return mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))


def plane_stress_lambda(lam, mu):
    """Return λ* = 2λμ/(λ+2μ) (= Eν/(1−ν²)), which takes λ's place in plane stress."""
    return 2 * lam * mu / (lam + 2 * mu)


def lambda_from_plane_stress(lam_star, mu):
    """Return the three-dimensional λ = 2μλ*/(2μ−λ*); inverse of :func:`plane_stress_lambda`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return 2 * mu * lam_star / (2 * mu - lam_star)


def admissible(lam, mu):
    """Tell where the strain energy is positive: μ > 0 and 3λ + 2μ > 0. NaN is not admissible."""
    return (mu > 0) & (3 * lam + 2 * mu > 0)
