"""The two solvers of the Gauss-Newton system against dense algebra."""

import numpy as np
import pytest
import scipy.sparse as sp
from elastoidentify.dissection import QuasiDefiniteSolver
from elastoidentify.gauss_newton import AdjointSystem, DirectSystem
from elastoidentify.regularized import TrialFit

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
