"""The two solvers of the Gauss-Newton system against dense algebra, and each other in space."""

import elastoidentify as ei
import numpy as np
import pytest
import scipy.sparse as sp
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh, solve_push
from elastoidentify.inverse import regularized
from elastoidentify.inverse.newton_systems import AdjointSystem, DirectSystem
from elastoidentify.inverse.regularized import TrialFit
from elastoidentify.linalg.ldl import QuasiDefiniteSolver

SCALE = 0.3


@pytest.fixture
def system():
    """A chain of springs with 30 stiffnesses, seen twice; the dense Hessian beside it."""
    n, rng = 30, np.random.default_rng(0)
    ring = sp.diags([2.5, -1.0, -1.0], [0, 1, -1], (n, n), format="csr")
    P = (ring @ ring + sp.identity(n)).tocsc()
    fits, H = [], P.toarray()
    for _ in range(2):
        K = ring + sp.diags(rng.uniform(0.5, 1, n))
        S = (K @ K.T).tocsc()
        R = sp.diags([rng.uniform(1, 2, n), rng.uniform(1, 2, n - 1)], [0, 1], format="csr")
        u = np.zeros(n)
        fits.append(TrialFit(u, K, S, u, QuasiDefiniteSolver(S, np.arange(n)), R=R))
        H += R.T.toarray() @ np.linalg.solve(S.toarray() * SCALE**2, R.toarray())
    places = np.arange(n, dtype=float)[:, None]
    field, forces = rng.standard_normal((n, 3)), list(rng.standard_normal((2, n, 3)))
    right = field + sum(
        f.R.T @ np.linalg.solve(f.S.toarray() * SCALE**2, p)
        for f, p in zip(fits, forces, strict=True)
    )
    return P, fits, places, field, forces, np.linalg.solve(H, right)


@pytest.mark.parametrize(("kind", "tolerance"), [(DirectSystem, 1e-10), (AdjointSystem, 0.01)])
def test_solution_is_that_of_the_dense_hessian(system, kind, tolerance):
    P, fits, places, field, forces, expected = system
    solver = kind(places, places)
    solver.factorise(P, fits, SCALE)
    for right, found in (
        (expected, solver.solve(field, forces)),
        (expected[:, 0], solver.solve(field[:, 0], [p[:, 0] for p in forces])),
    ):
        assert np.abs(found - right).max() < tolerance * np.abs(right).max()


def test_a_good_start_costs_no_products(system):
    P, fits, places, field, forces, expected = system
    solver = AdjointSystem(places, places)
    solver.factorise(P, fits, SCALE)
    steps = []
    cold = solver.solve(field, forces, tell=lambda: steps.append("cold"))
    warm = solver.solve(field, forces, start=expected, tell=lambda: steps.append("warm"))
    assert "cold" in steps
    assert "warm" not in steps
    assert np.abs(warm - cold).max() < 0.01 * np.abs(expected).max()


def test_in_space_products_and_factors_give_the_same_map(monkeypatch):
    points, cells = box_mesh((5, 5, 5), (1.0, 1.0, 1.0))
    centre = points[cells].mean(axis=1)
    young = np.where(np.linalg.norm(centre - [0.5, 0.5, 0.4], axis=1) < 0.3, 3.0, 1.0)
    known = np.where((centre[:, 2] > 0.8)[:, None], [1.0, 0.43], np.nan)
    ends = (points[:, 2] == 0) | (points[:, 2] == 1)
    moved = np.flatnonzero(ends)
    pushes = np.array([[0, 0, -0.02], [0.02, 0, -0.01], [0, 0.02, -0.01], [-0.02, -0.02, 0]])
    on_top = points[moved, 2:] > 0.5
    lam, mu = lame_from_young(young, 0.43)
    u = np.array([solve_push(points, cells, lam, mu, moved, on_top * push) for push in pushes])
    u += 2e-4 * np.random.default_rng(0).standard_normal(u.shape)

    def identify():
        return ei.identify(
            points, cells, u, known, method="regularized", reaction_nodes=ends,
            unknowns="young", poisson_ratio=0.43,
        )  # fmt: skip

    unknown = np.isnan(known[:, 0])
    by_products = identify()
    flat = np.abs(1 / young - 1)[unknown].mean()
    assert np.abs(by_products.young / young - 1)[unknown].mean() < 0.25 * flat
    monkeypatch.setattr(regularized, "AdjointSystem", DirectSystem)
    by_factors = identify()
    apart = np.abs(np.log(by_products.young / by_factors.young))[unknown]
    print(f"apart by {apart.max():.4f} at most; the step that ends a stage is 0.05")
    assert apart.max() < 0.02
    spread = by_products.mu_std[unknown] / by_factors.mu_std[unknown]
    assert 0.7 < np.median(spread) < 1.4  # eight samples against sixteen on the way
