"""Generalised plane strain: a stretch across the imaged plane, given or found."""

import numpy as np
import pytest
from elastoidentify import InputError, identify
from elastoidentify.fem.cells import LinearCells, LockingFreeCells
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh, solve_push, square_mesh
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.inverse.out_of_plane import warnings_of

STRETCH = 0.03
NOISE = 0.01


@pytest.mark.parametrize("kinematics", KINEMATICS)
def test_the_stress_in_a_stretched_plane_is_that_of_the_law_in_space(kinematics):
    law = KINEMATICS[kinematics]
    plane = 0.1 * np.random.default_rng(0).normal(size=(5, 2, 2))
    space = np.zeros((5, 3, 3))
    space[:, :2, :2], space[:, 2, 2] = plane, STRETCH
    for ours, full in zip(law.stretched(STRETCH).stress(plane), law.stress(space), strict=True):
        np.testing.assert_allclose(ours, full[:, :2, :2], rtol=1e-12, atol=1e-15)
    tangents = zip(law.stretched(STRETCH).tangent(plane), law.tangent(space), strict=True)
    for ours, full in tangents:
        np.testing.assert_allclose(ours, full[:, :2, :2, :2, :2], rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("free", [True, False])
def test_the_forces_slope_by_the_stretch_is_their_derivative(kinematics, free):
    points, triangles = square_mesh(3, 3, 1.0, 1.0)
    mesh, law = make_mesh(points, triangles), KINEMATICS[kinematics]
    random = np.random.default_rng(1)
    u, (lam, mu) = 0.05 * random.normal(size=points.shape), random.uniform(1, 3, (2, mesh.n_cells))
    patch = np.arange(mesh.n_cells) // 3
    cells = LockingFreeCells(mesh, law, patch) if free else LinearCells(mesh, law)
    step = 1e-6
    up, down = (cells.stretched(STRETCH + h).forces(u, lam, mu) for h in (step, -step))
    slope = cells.stretched(STRETCH).across_slope(u, lam)
    np.testing.assert_allclose(slope, ((up - down) / (2 * step)).ravel(), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("kinematics", KINEMATICS)
def test_a_slab_in_space_that_is_stretched_gives_the_moduli_of_its_slice(kinematics):
    """One layer of hexahedra between planes that move apart: 3-D forces, the slice's quads."""
    n, poisson = 4, 0.4
    points, bricks = box_mesh((n, n, 1), (1.0, 1.0, 0.1))
    young = np.random.default_rng(0).uniform(1, 3, n * n)
    young[-n:] = 2.0
    lam, mu = lame_from_young(young, poisson)
    flat, trials, stretches = points[points[:, 2] == 0], [], (STRETCH, -0.02)
    for (x, y), e in zip(((0.0, -0.08), (0.07, -0.05)), stretches, strict=True):
        fixed, value = np.zeros(points.shape, bool), np.zeros(points.shape)
        fixed[:, 2], value[:, 2] = True, e * points[:, 2]
        ends = (points[:, 1] == 0) | (points[:, 1] == 1)
        fixed[ends, :2] = True
        value[points[:, 1] == 1, :2] = x, y
        u = solve_push(points, bricks, lam, mu, fixed, value, kinematics=kinematics)
        trials.append(u[points[:, 2] == 0][:, :2])
    quads = box_mesh((n, n), (1.0, 1.0), "quad")[1]
    known = np.full((n * n, 2), np.nan)
    known[-n:] = 2.0, poisson
    settings = {
        "reaction_nodes": (flat[:, 1] == 0) | (flat[:, 1] == 1), "method": "global",
        "kinematics": kinematics, "unknowns": "young", "poisson_ratio": poisson,
    }  # fmt: skip
    words = (flat[:, :2], quads, np.array(trials), known)
    found = identify(*words, out_of_plane=stretches, **settings)
    np.testing.assert_allclose(found.young, young, rtol=1e-8)
    assert np.abs(found.residuals).max() < 1e-9
    assert np.nanmax(np.abs(identify(*words, **settings).young / young - 1)) > 0.3


def stretched_body(*stretches):
    pytest.importorskip("skfem")
    import broken

    return broken.body("stretch" if any(stretches) else "sound", n=12, stretch=stretches or 0.0)


def found(body, seed=0, **options):
    u = body.noisy(NOISE, seed)
    options = {
        "unknowns": "young", "poisson_ratio": body.poisson, "grouping": "label"
    } | options  # fmt: skip
    return identify(
        body.points, body.cells, u, {1: (1.0, body.poisson)}, labels=body.labels,
        reaction_nodes=body.reaction, method="regularized",
        information=np.broadcast_to(np.eye(2) / NOISE**2, (*u.shape, 2)), **options,
    )  # fmt: skip


def test_a_stretch_of_each_trial_is_found_within_its_standard_deviation():
    """Forward data: quadratic cells, a finer mesh; one unknown for the tissue around a lesion."""
    truth = (0.005, -0.003)
    for one, true in zip(
        found(stretched_body(*truth), out_of_plane_std=0.01).report["out_of_plane"], truth,
        strict=True,
    ):  # fmt: skip
        assert abs(one["stretch"] - true) < 3 * one["std"] + 2e-4  # one E for tissue and lesion
        assert one["std"] < 6e-4


@pytest.mark.slow
def test_with_the_stretch_found_the_model_fits_again():
    body = stretched_body(0.005, 0.005)
    without, sought = (
        found(body, grouping="cell", **more) for more in ({}, {"out_of_plane_std": 0.01})
    )
    assert without.report["verdict"]["level"] == "do not trust"
    assert sought.report["model_misfit"]["share"] < 0.1
    assert sought.report["verdict"]["noise_factor"] < 1.2
    wrong, right = (
        (np.abs(np.log(one.young / body.young)) > np.log(1.25)).mean() for one in (without, sought)
    )
    print(f"more than 25 % wrong: {right:.1%} of the cells, without the stretch {wrong:.0%}")
    assert right < 0.08


def test_a_stretch_that_the_data_do_not_tell_is_said():
    one = {"trial": 2, "stretch": 0.001, "std": 0.008, "given": 0.0, "given_std": 0.01}
    (sentence,) = warnings_of([one])
    assert "trial 2" in sentence and "hardly tell it" in sentence
    (sentence,) = warnings_of([one | {"std": 0.0001, "stretch": 0.06}])
    assert "far from" in sentence
    assert not warnings_of([one | {"std": 0.0001, "stretch": 0.01}])


@pytest.mark.parametrize(
    "more, words",
    [
        ({"out_of_plane": (0.01,) * 3}, "3 stretches out of the plane for 2 trials"),
        ({"out_of_plane": (0.7,)}, "length ratio less 1"),
        ({"out_of_plane_std": 0.3}, "between 0"),
        ({"out_of_plane_std": -0.1}, "between 0"),
        ({"out_of_plane": (0.01,), "plane": "stress"}, "no planar mesh in plane strain"),
        ({"out_of_plane_std": 0.01, "method": "global"}, "cannot estimate the stretch"),
    ],
)
def test_stretches_that_mean_nothing_are_refused(more, words):
    points, cells = square_mesh(4, 4, 1.0, 1.0)
    u = np.random.default_rng(0).normal(size=(2, *points.shape)) * 1e-3
    known = np.full((len(cells), 2), np.nan)
    known[-8:] = 1.0, 0.4
    with pytest.raises(InputError, match=words):
        identify(points, cells, u, known, reaction_nodes=points[:, 1] == 0, **more)
