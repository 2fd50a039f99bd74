"""The elastic laws against closed forms, finite differences and the principles behind them."""

import numpy as np
import pytest
from elastoidentify.fem.constitutive import KINEMATICS

FINITE = [name for name, law in KINEMATICS.items() if not law.linear]
both_dimensions = pytest.mark.parametrize("d", [2, 3])
every_law = pytest.mark.parametrize("name", list(KINEMATICS))
every_finite_law = pytest.mark.parametrize("name", FINITE)


def gradients(d, size=0.15, n=5, seed=0):
    """Displacement gradients H, well away from inversion."""
    return size * np.random.default_rng(seed).uniform(-1, 1, (n, d, d))


def rotations(d, n=5, seed=1):
    q = np.linalg.qr(np.random.default_rng(seed).standard_normal((n, d, d)))[0]
    q[:, :, 0] *= np.linalg.det(q)[:, None]
    return q


def energy(name, F):
    """Strain energy per unit λ and per unit μ, Bonet and Wood (2008), chapter 6."""
    d = F.shape[-1]
    if name == "neo-hookean":
        J = np.linalg.det(F)
        return np.log(J) ** 2 / 2, ((F**2).sum((-1, -2)) - d) / 2 - np.log(J)
    E = (np.swapaxes(F, -1, -2) @ F - np.eye(d)) / 2
    if name == "small-strain":
        E = (F + np.swapaxes(F, -1, -2)) / 2 - np.eye(d)
    return np.trace(E, axis1=-2, axis2=-1) ** 2 / 2, (E**2).sum((-1, -2))


@every_law
@both_dimensions
def test_stress_is_the_derivative_of_the_strain_energy(name, d):
    H, step = gradients(d), 1e-5
    stress = KINEMATICS[name].stress(H)
    for i in range(d):
        for j in range(d):
            dF = np.zeros((d, d))
            dF[i, j] = step
            ahead, behind = (energy(name, np.eye(d) + H + s * dF) for s in (1, -1))
            for part in range(2):
                slope = (ahead[part] - behind[part]) / (2 * step)
                assert np.allclose(stress[part][:, i, j], slope, atol=1e-9)


@every_law
@both_dimensions
def test_tangent_is_the_derivative_of_the_stress(name, d):
    law, H, step = KINEMATICS[name], gradients(d), 1e-5
    tangent = law.tangent(H)
    for k in range(d):
        for m in range(d):
            dH = np.zeros((d, d))
            dH[k, m] = step
            ahead, behind = law.stress(H + dH), law.stress(H - dH)
            for part in range(2):
                slope = (ahead[part] - behind[part]) / (2 * step)
                assert np.allclose(tangent[part][..., k, m], slope, atol=1e-8)


@pytest.mark.parametrize("stretch", [0.6, 0.95, 1.3])
@both_dimensions
def test_uniaxial_stretch_of_neo_hookean_material(d, stretch):
    H = np.zeros((d, d))
    H[0, 0] = stretch - 1
    per_lam, per_mu = KINEMATICS["neo-hookean"].stress(H)
    sideways = np.eye(d) * np.log(stretch)
    sideways[0, 0] = np.log(stretch) / stretch
    assert np.allclose(per_lam, sideways)
    assert np.isclose(per_mu[0, 0], stretch - 1 / stretch)
    assert np.isclose(np.abs(per_mu).sum(), abs(stretch - 1 / stretch))


@pytest.mark.parametrize("stretch", [0.6, 0.95, 1.3])
@both_dimensions
def test_uniaxial_stretch_of_st_venant_kirchhoff_material(d, stretch):
    H = np.zeros((d, d))
    H[0, 0] = stretch - 1
    per_lam, per_mu = KINEMATICS["st-venant-kirchhoff"].stress(H)
    green = (stretch**2 - 1) / 2
    expected = np.eye(d) * green
    expected[0, 0] = stretch * green
    assert np.allclose(per_lam, expected)
    assert np.isclose(per_mu[0, 0], 2 * stretch * green)
    assert np.isclose(np.abs(per_mu).sum(), abs(2 * stretch * green))


def test_simple_shear_of_neo_hookean_material_keeps_the_volume_and_needs_shear_stress_only():
    H = np.array([[0, 0.4], [0, 0]])
    per_lam, per_mu = KINEMATICS["neo-hookean"].stress(H)
    assert np.allclose(per_lam, 0)  # J = 1
    assert np.allclose(per_mu, [[0, 0.4], [0.4, 0]])


@every_finite_law
@both_dimensions
def test_a_rotation_costs_no_stress(name, d):
    for part in KINEMATICS[name].stress(rotations(d) - np.eye(d)):
        assert np.abs(part).max() < 1e-14


@every_finite_law
@both_dimensions
def test_stress_turns_with_the_body(name, d):
    H, Q = gradients(d), rotations(d)
    turned = Q @ (np.eye(d) + H) - np.eye(d)
    at_rest, after = KINEMATICS[name].stress(H), KINEMATICS[name].stress(turned)
    for part in range(2):
        assert np.allclose(after[part], Q @ at_rest[part], atol=1e-13)


def test_small_strain_is_no_finite_law_a_rotation_costs_stress():
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert np.abs(KINEMATICS["small-strain"].stress(quarter - np.eye(2))[1]).max() > 1


@every_finite_law
@both_dimensions
def test_finite_laws_go_over_into_hookes_law_quadratically(name, d):
    H = gradients(d, 1.0)
    difference = []
    for size in (1e-2, 1e-3, 1e-4):
        finite = KINEMATICS[name].stress(size * H)
        small = KINEMATICS["small-strain"].stress(size * H)
        difference.append([np.abs(a - b).max() for a, b in zip(finite, small, strict=True)])
    ratios = np.divide(difference[:-1], difference[1:])
    assert (ratios > 80).all()
    assert (ratios < 125).all()


@every_law
@both_dimensions
def test_tiny_displacements_keep_their_digits(name, d):
    H, size = gradients(d, 1.0), 1e-12
    tiny = KINEMATICS[name].stress(size * H)
    hooke = KINEMATICS["small-strain"].stress(H)
    for part in range(2):
        assert np.allclose(tiny[part] / size, hooke[part], rtol=1e-10, atol=1e-11)


@every_law
@both_dimensions
def test_the_tangent_at_rest_is_hookes(name, d):
    rest = np.zeros((1, d, d))
    for part, hooke in zip(
        KINEMATICS[name].tangent(rest), KINEMATICS["small-strain"].tangent(rest), strict=True
    ):
        assert np.allclose(part, hooke, atol=1e-14)


def test_plane_strain_is_the_three_dimensional_law_with_no_stretch_across():
    H = gradients(2)
    deep = np.zeros((len(H), 3, 3))
    deep[:, :2, :2] = H
    for law in KINEMATICS.values():
        for flat, solid in zip(law.stress(H), law.stress(deep), strict=True):
            assert np.allclose(flat, solid[:, :2, :2], atol=1e-14)
