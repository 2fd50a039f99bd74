"""Exact data in three dimensions, tetrahedra and hexahedra."""

import bodies
import numpy as np
import pytest
from bodies import determined_cells, floor_and_top, push_from_above
from elastoidentify.errors import InputError
from elastoidentify.fem.forward import box_mesh


def twist(x):
    """Turn the top about its middle while it sinks."""
    return 0.08 * np.column_stack([0.5 - x[:, 1], x[:, 0] - 0.5, -np.full(len(x), 0.5)])


# straight down, twice oblique, and a twist: translations alone make three independent trials
PUSHES = ((0, 0, -0.05), (-0.05, 0, -0.05), (0, -0.05, -0.03), twist)


def box(kind, n=5, pad=0.2, distortion=0.0, **more):
    points, cells = box_mesh((n, n, n), (1, 1, 1), kind)
    inner = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    shift = np.random.default_rng(9).uniform(-distortion, distortion, points.shape) / n
    known = points[cells].mean(axis=1)[:, 2] > 1 - pad
    return bodies.body(points + inner[:, None] * shift, cells, known, floor_and_top(points), **more)


def assert_exactly(one, result, determined, tolerance):
    assert np.array_equal(result.status, np.where(one.known, 1, np.where(determined, 2, 0)))
    assert np.isnan(result.mu[~determined]).all()
    assert one.errors(result)[determined].max() < tolerance


@pytest.mark.parametrize("method", ["global", "sequential"])
def test_heterogeneous_hexahedra_5_by_5_by_5_with_four_trials_to_1e_8(method):
    one = push_from_above(box("hexahedron", young=(1e3, 5e3)), 1.0, PUSHES)
    result = one.identify(method)
    assert_exactly(one, result, np.full(125, True), 1e-8)
    assert not any("trials" in text for text in result.report["warnings"])


def test_heterogeneous_tetrahedra_5_by_5_by_5_with_four_trials_to_1e_8():
    one = push_from_above(box("tetra"), 1.0, PUSHES)
    result = one.identify("global")
    on_floor = np.isclose(one.points[one.cells][:, :, 2], 0).any(axis=1)
    # tetrahedra with one free node at the clamped floor stay open however many trials there are
    assert on_floor[result.status == 0].all()
    assert (result.status[~one.known] == 2).mean() > 0.9
    assert np.nanmax(one.errors(result)) < 1e-8


@pytest.mark.slow
def test_tetrahedra_5_by_5_by_5_give_what_the_null_space_leaves():
    one = push_from_above(box("tetra"), 1.0, PUSHES)
    assert_exactly(one, one.identify("global"), determined_cells(one), 1e-8)


@pytest.mark.parametrize("trials", [2, 3, 4])
@pytest.mark.parametrize("distortion", [0.0, 0.1])
def test_tetrahedra_give_what_the_null_space_leaves(trials, distortion):
    one = push_from_above(box("tetra", 3, pad=0.4, distortion=distortion), 1.0, PUSHES[:trials])
    determined = determined_cells(one)
    share = determined[~one.known].mean()
    assert 0.1 < share < 1
    result = one.identify("global")
    assert_exactly(one, result, determined, 1e-8)
    few = any(f"{trials} trials in 3-D" in text for text in result.report["warnings"])
    assert few == (trials < 4)


def test_the_walk_finds_in_tetrahedra_what_the_null_space_leaves():
    one = push_from_above(box("tetra", 3, pad=0.4, distortion=0.1), 1.0, PUSHES)
    assert_exactly(one, one.identify("sequential"), determined_cells(one), 1e-4)


def test_one_trial_is_too_little_for_two_unknowns_per_tetrahedron_and_this_is_refused():
    one = push_from_above(box("tetra", 3, pad=0.4), 1.0, PUSHES[:1])
    with pytest.raises(InputError, match=r"fewer equations \(96: 32 free nodes × 3.*add trials"):
        one.identify("global")


def test_young_alone_needs_two_trials_in_tetrahedra():
    one = box("tetra", 4, pad=0.3)
    one.poisson[:] = 0.45
    push_from_above(one, 1.0, PUSHES[:2])
    result = one.identify("global", unknowns="young", poisson_ratio=0.45)
    on_floor = np.isclose(one.points[one.cells][:, :, 2], 0).any(axis=1)
    assert on_floor[result.status == 0].all()
    assert (result.status[~one.known] == 2).mean() > 0.8
    assert np.nanmax(np.abs(result.young / one.young - 1)) < 1e-8


@pytest.mark.parametrize("kinematics", ["neo-hookean", "st-venant-kirchhoff"])
@pytest.mark.parametrize("method", ["global", "sequential"])
def test_finite_strain_of_distorted_hexahedra(kinematics, method):
    one = box("hexahedron", 3, pad=0.4, distortion=0.2, kinematics=kinematics)
    push_from_above(one, 1.0, [*(3 * np.array(PUSHES[:3])), twist])
    assert_exactly(one, one.identify(method), np.full(27, True), 1e-8)
