"""Trials that are no pushes, and pushes that are alike, whatever the body does as a whole."""

import numpy as np
import pytest
from elastoidentify import identify
from elastoidentify.inverse.motion import deformation, is_still, one_direction

pytest.importorskip("skfem")
import forward

NOISE = 0.01  # mm
SHIFT, TURN = (4.0, -2.0), 0.1  # mm, radian: a patient who moves


@pytest.fixture(scope="module")
def case():
    return forward.squares(8)


def moved_as_a_whole(points, shift=SHIFT, turn=TURN):
    """Translation and infinitesimal rotation of points (n, 2)."""
    return np.add(shift, turn * np.column_stack([-points[:, 1], points[:, 0]]))


def found(case, u, **options):
    information = np.broadcast_to(np.eye(2) / NOISE**2, (*u.shape, 2))
    return identify(
        case.points, case.cells, u, {1: (1.0, case.poisson)}, labels=np.where(case.known, 1, 2),
        reaction_nodes=case.reaction, method="regularized",
        **({"information": information} | options),
    )  # fmt: skip


def about_trial(result, trial):
    return [text for text in result.report["warnings"] if f"trial {trial} " in text]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_rigid_motion_deforms_nothing_and_a_deformation_stays(dim):
    random = np.random.default_rng(0)
    points = random.normal(size=(40, dim))
    skew = random.normal(size=(dim, dim))
    rigid = points @ (skew - skew.T) + random.normal(size=dim)
    np.testing.assert_allclose(deformation(points, rigid), 0, atol=1e-12)
    strain = skew + skew.T
    stretched = (points - points.mean(axis=0)) @ strain
    assert np.linalg.norm(deformation(points, stretched)) > 0.5 * np.linalg.norm(stretched)
    roots = random.normal(size=(40, dim, dim))
    metric = np.einsum("nij,nkj->nik", roots, roots) + np.eye(dim)
    left = deformation(points, stretched, metric)
    np.testing.assert_allclose(deformation(points, stretched + rigid, metric), left, atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, TURN])
def test_errors_alone_are_still_and_the_smallest_push_that_shows_is_not(case, turn):
    random = np.random.default_rng(1)
    errors = NOISE * random.normal(size=case.points.shape)
    metric = np.broadcast_to(np.eye(2) / NOISE**2, (*case.points.shape, 2))
    whole = moved_as_a_whole(case.points, turn=turn)
    assert is_still(case.points, whole + errors, metric)
    push = case.displacements[0] * 3 * NOISE / np.abs(case.displacements[0]).std()
    assert not is_still(case.points, whole + errors + push, metric)


def test_pushes_are_compared_without_the_motion_as_a_whole(case):
    two = case.noisy(NOISE, 0)
    whole = moved_as_a_whole(case.points)
    assert not one_direction(case.points, two)
    assert not one_direction(case.points, two + 5 * whole)  # alike but for the pushes
    same = np.stack([two[0], two[0] + whole])
    assert one_direction(case.points, same)  # not alike but for the pushes
    assert one_direction(case.points, two[:1])


@pytest.mark.parametrize("stated", ["information", "noise"])
def test_a_trial_without_a_push_is_named_and_counts_as_none(case, stated):
    """As when the image at rest was taken twice: said once, and not as a matter of units."""
    u = case.noisy(NOISE, 0)
    u[1] = NOISE * np.random.default_rng(5).normal(size=u[1].shape) + SHIFT
    options = {"information": None, "noise": NOISE} if stated == "noise" else {}
    result = found(case, u, **options)
    assert about_trial(result, 1) == []
    (said,) = about_trial(result, 2)
    assert said.startswith("trial 2 shows no push")
    assert "all pushes have one direction" in result.report["verdict"]["sentence"]


def test_where_no_error_is_stated_nothing_is_called_still(case):
    result = found(case, case.noisy(NOISE, 0), information=None)
    assert not any("no push" in text for text in result.report["warnings"])


def test_a_body_without_any_push_gets_no_map(case):
    nothing = NOISE * np.random.default_rng(3).normal(size=case.displacements.shape)
    result = found(case, nothing)
    assert all(about_trial(result, trial) for trial in (1, 2))
    assert not (result.status[~case.known] > 0).any()
    assert result.report["verdict"]["level"] == "do not trust"
