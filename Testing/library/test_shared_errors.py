"""Errors that trials share, because all were registered to one rest image."""

import elastoidentify as ei
import forward
import numpy as np
import pytest
from elastoidentify.inverse import regularized

pytestmark = pytest.mark.usefixtures("without_model_misfit")


def test_errors_that_trials_share_are_in_the_covariance():
    """Against dense matrices: x = Σ A_t y_t, with errors of ½ C between two trials."""
    case = forward.squares(6, contrast=2.0, radius=0.25)
    std = 0.01
    seen = {}
    original = regularized._Fit.exact_posterior

    def looked_at(one):
        original(one)
        seen["fit"] = one

    information = np.broadcast_to(np.eye(2) / std**2, (*case.displacements.shape, 2))
    labels = np.where(case.known, 1, np.where(case.from_edge < 0, 3, 2))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(regularized._Fit, "exact_posterior", looked_at)
        ei.identify(
            case.points, case.cells, case.noisy(std, 0), case.materials, labels=labels,
            reaction_nodes=case.reaction, method="regularized", unknowns="young",
            poisson_ratio=case.poisson, grouping="label", information=information,
        )  # fmt: skip
    one = seen["fit"]
    n, held = len(one.x), one.state.couplings[0].shape[1]
    trials = len(case.displacements)
    columns = n + trials * held
    dx = np.eye(n, columns)
    db = [np.eye(held, columns, n + t * held) for t in range(trials)]
    (J,) = one.misfit.seen(dx, one.state.change(dx, db))
    W = [o.weight.toarray() / one.scale**2 for o in one.misfit.terms[0]]
    P = np.zeros((columns, columns))
    P[:n, :n] = one.prior.hessian().toarray()
    H = np.linalg.inv(P + sum(j.T @ w @ j for j, w in zip(J, W, strict=True)))
    A = [H @ j.T @ w for j, w in zip(J, W, strict=True)]
    C = np.linalg.inv(W[0])
    between = A[0] @ C @ A[1].T
    exact = (H + 0.5 * (between + between.T))[:n, :n]
    found = one.samples[0] @ one.samples[0].T / one.samples[0].shape[1]
    assert np.allclose(found, exact, rtol=1e-3)  # nodes that are not measured are nearly free
    assert (np.diag(found) > 1.05 * np.diag(H)[:n]).any()
