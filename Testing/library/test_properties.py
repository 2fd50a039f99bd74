"""What must not matter, does not: position, unit, numbering; and more data never tell less."""

from functools import cache

import elastoidentify as ei
import numpy as np
import pytest
from bodies import body, floor_and_top, push_from_above, scattered_triangles
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.inverse.balance_system import BalanceSystem
from elastoidentify.inverse.parameterization import make_unknowns
from elastoidentify.linalg.front_qr import FrontQR
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

few = settings(
    max_examples=12, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip
methods = pytest.mark.parametrize("method", ["global", "sequential"])
kinematics = st.sampled_from(list(KINEMATICS))
seeds = st.integers(0, 2**16)
powers = st.floats(-9, 9)
PUSHES = ((0, -0.05), (-0.05, -0.05), (0.04, -0.02), (0.03, 0.02))


@cache
def pushed_body(kinematics="small-strain", seed=0, trials=2, n=5):
    points, cells = scattered_triangles(n, seed % 7)
    known = points[cells].mean(axis=1)[:, 1] > 0.7
    one = body(points, cells, known, floor_and_top(points), seed=seed, kinematics=kinematics)
    return push_from_above(one, 1.0, PUSHES[:trials])


def identify(one, method, points=None, cells=None, trials=None, known=None, reaction=None):
    def first(*values):
        return next(value for value in values if value is not None)

    return ei.identify(
        first(points, one.points), first(cells, one.cells), first(trials, np.array(one.trials)),
        first(known, one.given), reaction_nodes=first(reaction, one.reaction),
        method=method, kinematics=one.kinematics,
    )  # fmt: skip


def assert_same_map(a, b, factor=1.0, tolerance=1e-6):
    """The maps agree where either says it found something, and say so in the same cells."""
    assert np.array_equal(a.status, b.status)
    for one, other in ((a.lam, b.lam), (a.mu, b.mu), (a.young, b.young)):
        assert np.allclose(factor * one, other, rtol=tolerance, atol=0, equal_nan=True)
    assert np.allclose(a.poisson, b.poisson, rtol=tolerance, atol=tolerance, equal_nan=True)


@methods
@few
@given(seed=seeds, angle=st.floats(0, 7), shift=st.floats(-1e3, 1e3), power=st.floats(-6, 6),
       law=kinematics)  # fmt: skip
def test_rigid_motion_and_scale_of_the_mesh_change_nothing(method, seed, angle, shift, power, law):
    one = pushed_body(law, seed)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    scale = 10**power
    elsewhere = identify(
        one, method, points=scale * (one.points @ turn.T + shift),
        trials=scale * np.array(one.trials) @ turn.T,
    )  # fmt: skip
    # positions of a body of size 1 at a distance of 1000 have three digits less
    assert_same_map(identify(one, method), elsewhere, tolerance=1e-5)


@methods
@few
@given(seed=seeds, angle=st.floats(0, 7), shift=st.floats(-10, 10),
       law=st.sampled_from(["neo-hookean", "st-venant-kirchhoff"]))  # fmt: skip
def test_bodies_that_turn_while_they_are_pushed_are_seen_through_by_finite_strain(
    method, seed, angle, shift, law
):
    one = pushed_body(law, seed)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = (one.points + np.array(one.trials)) @ turn.T + shift - one.points
    assert_same_map(identify(one, method), identify(one, method, trials=turned))


@methods
@few
@given(seed=seeds, power=powers, law=kinematics)
def test_the_unit_of_the_pad_is_the_unit_of_the_map(method, seed, power, law):
    one = pushed_body(law, seed)
    factor = 10**power
    stiffer = identify(one, method, known=one.given * [factor, 1])
    assert_same_map(identify(one, method), stiffer, factor, tolerance=1e-8)


@methods
@few
@given(seed=seeds, power=powers)
def test_the_size_of_a_small_strain_push_does_not_matter(method, seed, power):
    one = pushed_body(seed=seed)
    scaled = np.array(one.trials) * 10 ** -abs(power)  # larger ones may turn cells inside out
    assert_same_map(identify(one, method), identify(one, method, trials=scaled), tolerance=1e-8)


@methods
@few
@given(seed=seeds, law=kinematics)
def test_numbering_of_nodes_cells_corners_and_trials_does_not_matter(method, seed, law):
    one = pushed_body(law, seed, trials=3)
    rng = np.random.default_rng(seed)
    nodes, cells = rng.permutation(len(one.points)), rng.permutation(len(one.cells))
    new_number = np.argsort(nodes)
    corners = np.array([np.roll(cell, rng.integers(3)) for cell in new_number[one.cells][cells]])
    trials = np.array(one.trials)[rng.permutation(3)][:, nodes]
    shuffled = identify(
        one, method, points=one.points[nodes], cells=corners, trials=trials,
        known=one.given[cells], reaction=one.reaction[nodes],
    )  # fmt: skip
    plain = identify(one, method)
    for name in ("lam", "mu", "young", "poisson", "status"):
        setattr(plain, name, getattr(plain, name)[cells])
    assert_same_map(plain, shuffled)


def rank(one, trials):
    system = BalanceSystem(
        make_mesh(one.points, one.cells), KINEMATICS[one.kinematics], np.array(trials),
        make_unknowns(*one.given.T), one.reaction,
    )  # fmt: skip
    rows = np.repeat(system.node_level, system.rows_per_node)
    columns = np.repeat(system.group_level, 2)
    factor = FrontQR(system.A, system.b, rows, columns)
    dense = np.linalg.matrix_rank(system.A.toarray(), tol=1e-10 * abs(system.A).max())
    reached = columns >= 0
    return reached.sum() - len(factor.dead), dense, ~factor.undetermined() & reached


@few
@given(seed=seeds, law=kinematics, order=st.permutations(range(4)))
def test_another_trial_never_lowers_the_rank_nor_loses_a_cell(seed, law, order):
    one = pushed_body(law, seed, trials=4)
    trials = [one.trials[k] for k in order]
    before, determined_before = 0, np.zeros(2 * int((~one.known).sum()), bool)
    for n in range(1, 5):
        found, dense, determined = rank(one, trials[:n])
        assert found == dense
        assert found >= before
        assert not (determined_before & ~determined).any()
        before, determined_before = found, determined


@methods
@few
@given(seed=seeds, law=kinematics)
def test_more_known_cells_never_lose_another(method, seed, law):
    one = pushed_body(law, seed)
    fewer = identify(one, method)
    rng = np.random.default_rng(seed)
    told = ~one.known & (rng.random(len(one.known)) < 0.2)
    truth = np.column_stack([one.young, one.poisson])
    more = identify(one, method, known=np.where(told[:, None], truth, one.given))
    assert not ((fewer.status == 2) & (more.status == 0)).any()
    assert np.nanmax(one.errors(more)) < 1e-6


@few
@given(young=st.floats(1e-3, 1e9), poisson=st.floats(-0.9, 0.499))
def test_elastic_constants_survive_their_conversions(young, poisson):
    from elastoidentify.fem.elastic_constants import (
        admissible,
        lambda_from_plane_stress,
        lame_from_young,
        plane_stress_lambda,
        young_from_lame,
    )

    lam, mu = lame_from_young(young, poisson)
    assert np.allclose(young_from_lame(lam, mu), (young, poisson), rtol=1e-9, atol=1e-12)
    assert np.isclose(
        plane_stress_lambda(lam, mu), young * poisson / (1 - poisson**2), atol=1e-9 * young
    )
    assert np.isclose(
        lambda_from_plane_stress(plane_stress_lambda(lam, mu), mu),
        lam,
        rtol=1e-6,
        atol=1e-9 * young,
    )
    assert admissible(lam, mu)
