"""A thin sheet in finite strain: the neo-Hookean law of plane stress."""

import numpy as np
import pytest
from elastoidentify import InputError, identify
from elastoidentify.fem.constitutive import KINEMATICS, NeoHookeanPlaneStress
from elastoidentify.fem.elastic_constants import lame_from_young, plane_stress_lambda
from elastoidentify.fem.forward import box_mesh, solve_push, square_mesh
from scipy.optimize import brentq

NUS = (0.0, 0.3, 0.45, 0.495)


def sheet_stress(H, nu):
    """P of E = 1."""
    lam, mu = lame_from_young(1.0, nu)
    per_lam, per_mu = NeoHookeanPlaneStress(np.array([nu])).of([0]).stress(H[None])
    return (plane_stress_lambda(lam, mu) * per_lam + mu * per_mu)[0]


@pytest.mark.parametrize("stretch", [0.6, 0.95, 1.0, 1.02, 1.8])
@pytest.mark.parametrize("nu", NUS)
def test_a_bar_pulled_along_one_axis_has_the_stress_of_the_law_in_space(nu, stretch):
    """Closed form in space: both sides b follow from μ(b² − 1) + λ ln(a b²) = 0."""
    lam, mu = lame_from_young(1.0, nu)
    side = brentq(lambda b: mu * (b**2 - 1) + lam * np.log(stretch * b**2), 0.05, 20, xtol=1e-15)
    expected = mu * (stretch - 1 / stretch) + lam * np.log(stretch * side**2) / stretch
    found = sheet_stress(np.diag([stretch - 1, side - 1]), nu)
    np.testing.assert_allclose(found, [[expected, 0], [0, 0]], rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("nu", NUS)
def test_the_stress_is_that_of_space_with_a_free_face_and_the_tangent_its_derivative(nu):
    lam, mu = lame_from_young(1.0, nu)
    H = np.array([[0.1, 0.3], [-0.05, -0.2]])
    J = np.linalg.det(np.eye(2) + H)
    s = brentq(lambda s: mu * (s**2 - 1) + lam * np.log(J * s), 0.05, 20, xtol=1e-15)
    space = np.zeros((1, 3, 3))
    space[0, :2, :2], space[0, 2, 2] = H, s - 1
    P = sum(
        k * p[0] for k, p in zip((lam, mu), KINEMATICS["neo-hookean"].stress(space), strict=True)
    )
    np.testing.assert_allclose(P[2, 2], 0, atol=1e-12)
    np.testing.assert_allclose(sheet_stress(H, nu), P[:2, :2], rtol=1e-9, atol=1e-12)
    law, step = NeoHookeanPlaneStress(np.array([nu])).of([0]), 1e-6
    moduli = plane_stress_lambda(lam, mu), mu
    tangent = sum(k * t[0] for k, t in zip(moduli, law.tangent(H[None]), strict=True))
    for k in range(2):
        for m in range(2):
            change = np.zeros((2, 2))
            change[k, m] = step
            slope = (sheet_stress(H + change, nu) - sheet_stress(H - change, nu)) / (2 * step)
            np.testing.assert_allclose(tangent[:, :, k, m], slope, rtol=1e-6, atol=1e-8)


def slab(young, nu, n, thickness=0.02):
    """A thin slab of hexahedra with free faces, pushed two ways: its mid-plane's displacements."""
    points, bricks = box_mesh((n, n, 1), (1.0, 1.0, thickness / 2))
    lam, mu = lame_from_young(young, nu)
    middle, trials = points[:, 2] == 0, []
    for x, y in ((0.0, -0.1), (0.08, -0.06)):
        fixed, value = np.zeros(points.shape, bool), np.zeros(points.shape)
        fixed[middle, 2] = True  # symmetry
        top, ends = points[:, 1] == 1, (points[:, 1] == 0) | (points[:, 1] == 1)
        fixed[ends, :2] = True
        value[top, :2] = x, y
        u = solve_push(points, bricks, lam, mu, fixed, value, kinematics="neo-hookean")
        trials.append(u[middle][:, :2])
    return points[middle][:, :2], box_mesh((n, n), (1.0, 1.0), "quad")[1], np.array(trials)


def test_a_thin_slab_in_space_gives_its_moduli():
    """Independent: the law in space, free faces. In plane strain the inclusion of 3 reads 6."""
    n, nu = 12, 0.4
    rows = np.arange(n * n).reshape(n, n)
    labels = np.full(n * n, 2)
    labels[rows[4:8, 4:8].ravel()], labels[rows[9:].ravel()] = 3, 1
    points, quads, u = slab(np.where(labels == 3, 3.0, 1.0), nu, n)

    def young(plane):
        result = identify(
            points, [("quad", quads)], u, {1: (1.0, nu)}, labels=labels,
            reaction_nodes=(points[:, 1] == 0) | (points[:, 1] == 1), method="regularized",
            unknowns="young", poisson_ratio=nu, grouping="label", kinematics="neo-hookean",
            refine=1, plane=plane,
        )  # fmt: skip
        return {row["label"]: row["YoungModulus mean"] for row in result.statistics}

    found = young("stress")
    assert abs(found[2] - 1) < 0.01
    assert abs(found[3] / 3 - 1) < 0.03
    assert abs(young("strain")[3] / 3 - 1) > 0.5


@pytest.mark.parametrize(
    "more",
    [
        {"kinematics": "st-venant-kirchhoff", "unknowns": "young", "poisson_ratio": 0.4},
        {"kinematics": "neo-hookean"},
        {
            "kinematics": "neo-hookean", "unknowns": "young", "poisson_ratio": 0.4,
            "poisson_std": 0.05,
        },
    ],
)  # fmt: skip
def test_what_is_not_linear_in_the_unknowns_is_refused(more):
    points, cells = square_mesh(4, 4, 1.0, 1.0)
    known = np.full((len(cells), 2), np.nan)
    known[-8:] = 1.0, 0.4
    with pytest.raises(InputError, match="plane stress is linear in the unknowns"):
        identify(points, cells, np.zeros((1, *points.shape)), known, plane="stress", **more)
