"""Exact data in two dimensions: every cell that the data determine is found, no other is given.

What the data determine is read off a dense singular value decomposition of a balance matrix that
is written down apart from the library (:mod:`bodies`).
"""

import bodies
import elastoidentify as ei
import numpy as np
import pytest
from bodies import (
    determined_cells,
    determined_constants,
    floor_and_top,
    push_from_above,
    scattered_triangles,
)
from elastoidentify.errors import InputError
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.inverse.balance_system import BalanceSystem
from elastoidentify.inverse.parameterization import make_unknowns
from elastoidentify.inverse.sequential import plan_walk
from elastoidentify.results import Status

EXACT = ("global", "sequential")
DOWN_AND_OBLIQUE = ((0, -0.05), (-0.05, -0.05))  # of a unit square
TABLE_ROWS = (  # of the source paper: motion of the top nodes in two trials, metres
    ((0, -0.025), (-0.025, -0.025)),
    ((0, -0.03), (-0.03, -0.03)),
    ((0, -0.05), (-0.05, -0.05)),
    ((0, -0.05), (-0.1, -0.1)),
)
# node, cells found there: the source paper's walk, right to left, row after row
PAPER_WALK = [
    (14, [15]), (13, [13, 14]), (12, [11, 12]), (11, [9, 10]), (10, [8]),
    (9, [7]), (8, [5, 6]), (7, [3, 4]), (6, [1, 2]), (5, [0]),
]  # fmt: skip


def paper_square(row=0, kinematics="small-strain", pattern="paper", **moduli):
    points, cells = square_mesh(4, 4, pattern=pattern)
    known = points[cells].mean(axis=1)[:, 1] > 0.1
    one = bodies.body(points, cells, known, floor_and_top(points), kinematics=kinematics)
    one.young[:], one.poisson[:] = moduli.get("young", 5e3), moduli.get("poisson", 0.43)
    return push_from_above(one, 0.2, TABLE_ROWS[row])


def squares(n, pattern="paper", pad=0.25, **more):
    points, cells = square_mesh(n, n, 1, 1, pattern)
    known = points[cells].mean(axis=1)[:, 1] > 1 - pad
    return bodies.body(points, cells, known, floor_and_top(points), **more)


def assert_exactly(one, result, determined, tolerance, within=None):
    """Every determined cell (`within` steps) right to `tolerance`, every other Status 0 and NaN.

    A walk multiplies round-off from step to step. Where it says itself that more than the
    tolerance may have been lost that way, `within` takes five of its standard deviations instead.
    """
    unknown, allowed = ~one.known, tolerance
    alone = result.status == Status.SHEAR_ONLY
    if within is None:
        assert np.array_equal((result.status > 0) & ~alone, determined | one.known)
        within = np.inf
    else:
        near = bodies.steps_from_known(one) <= within
        assert (result.status[determined & near] > 0).all()
        determined = determined & near & unknown | one.known
        stated = np.maximum(result.lam_std / one.lam, result.mu_std / one.mu)
        assert (stated[determined & unknown] < tolerance).mean() > 0.9
        allowed = np.maximum(tolerance, 5 * stated)[determined & unknown]
    found = determined & unknown
    assert (result.status[found] == 2).all()
    assert (one.errors(result)[found] < allowed).all()
    assert np.array_equal(result.status == 1, one.known)
    for array in (result.mu, result.mu_std):
        assert np.array_equal(np.isnan(array), result.status == 0)
    for array in (result.lam, result.young, result.poisson, result.lam_std):
        assert np.array_equal(np.isnan(array), (result.status == 0) | alone)


# ------------------------------------------------------------------------------- the paper's walk


def test_the_walk_is_the_papers_node_by_node():
    one = paper_square()
    system = BalanceSystem(
        make_mesh(one.points, one.cells),
        KINEMATICS[one.kinematics],
        np.array(one.trials),
        make_unknowns(*one.given.T),
        one.reaction,
    )
    walk = plan_walk(system).as_list()
    # unknown groups are cells 0…15 here
    assert [(nodes, sorted(cells)) for nodes, cells in walk] == [
        ([node], cells) for node, cells in PAPER_WALK
    ]


def test_sequence_order_counts_the_papers_steps():
    order = paper_square().identify("sequential").sequence_order
    for step, (_, cells) in enumerate(PAPER_WALK):
        assert (order[cells] == step).all()
    assert (order[16:] == -1).all()


@pytest.mark.parametrize("method", EXACT)
@pytest.mark.parametrize("row", range(4))
def test_all_32_unknowns_of_the_paper_to_1e_8(row, method):
    one = paper_square(row)
    result = one.identify(method)
    assert_exactly(one, result, np.full(32, True), 1e-8)
    assert np.allclose(result.young, 5e3, rtol=1e-8)
    assert np.allclose(result.poisson, 0.43, rtol=1e-8)


@pytest.mark.parametrize("pattern", ["paper", "alternating", "crossed"])
@pytest.mark.parametrize("kinematics", list(KINEMATICS))
@pytest.mark.parametrize("row", range(4))
def test_every_pattern_and_push_with_matching_kinematics(row, kinematics, pattern):
    try:
        one = paper_square(row, kinematics, pattern)
    except InputError:  # the forward problem of the largest pushes inverts a cell
        assert kinematics == "st-venant-kirchhoff"
        assert row == 3 or (row, pattern) == (2, "crossed")
        return
    determined = determined_cells(one)
    lost = (~determined).sum()
    assert lost == (2 if pattern == "alternating" else 0)  # cells in corners of the floor
    for method in EXACT:
        assert_exactly(one, one.identify(method), determined, 1e-6)


@pytest.mark.parametrize("kinematics", ["neo-hookean", "st-venant-kirchhoff"])
def test_small_strain_kinematics_on_a_finite_push_are_not_believed(kinematics):
    one = paper_square(1, kinematics)
    one.kinematics = "small-strain"
    result = one.identify("global")
    assert (result.status[:16] == 0).mean() > 0.5
    assert result.report["noise_scale"] > 1e-5  # equations left over: exact data leave none
    assert any("small-strain kinematics are good to" in text for text in result.report["warnings"])


# ------------------------------------------------------------------------------ heterogeneous maps


@pytest.mark.parametrize("seed", range(3))
def test_neighbours_that_differ_fivefold_on_12_by_12_squares(seed):
    one = squares(12, seed=seed)
    rng = np.random.default_rng(seed)
    one.young[~one.known] = np.where(rng.random((~one.known).sum()) < 0.5, 1e3, 5e3)
    push_from_above(one, 1.0, DOWN_AND_OBLIQUE)
    assert_exactly(one, one.identify("global"), np.full(288, True), 1e-8)
    assert_exactly(one, one.identify("sequential"), np.full(288, True), 1e-4)


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-7])
def test_exact_data_are_exact_however_small_the_push(size):
    one = push_from_above(squares(8), 1.0, size * np.array(DOWN_AND_OBLIQUE))
    assert_exactly(one, one.identify("global"), np.full(128, True), 1e-9)


@pytest.mark.parametrize("method", EXACT)
def test_a_material_without_sideways_strain_has_lambda_zero(method):
    one = squares(6)
    one.poisson[~one.known] = 0.0
    result = push_from_above(one, 1.0, DOWN_AND_OBLIQUE).identify(method, unknowns="young",
                                                                  poisson_ratio=0.0)  # fmt: skip
    assert (result.status[~one.known] == 2).all()
    assert np.allclose(result.young, one.young, rtol=1e-9)
    assert (result.lam[~one.known] == 0).all()


# ------------------------------------------------------------------------------ unstructured meshes


def hole_in_the_middle(centres):
    return np.hypot(*(centres - [0.5, 0.4]).T) > 0.2


def top_pad(n):
    points, cells = scattered_triangles(n)
    return bodies.body(points, cells, points[cells].mean(1)[:, 1] > 0.75, floor_and_top(points))


def pad_at_the_left(n):
    points, cells = scattered_triangles(n)
    return bodies.body(points, cells, points[cells].mean(1)[:, 0] < 0.25, floor_and_top(points))


def inclusion_in_pad(n):
    points, cells = scattered_triangles(n, lines=[bodies.circle(0.25, int(1.6 * n))])
    outside = np.hypot(*(points[cells].mean(1) - 0.5).T) > 0.25
    return bodies.body(points, cells, outside, floor_and_top(points))


def hole(n):
    ring = bodies.circle(0.2, int(1.3 * n), (0.5, 0.4))
    points, cells = scattered_triangles(n, lines=[ring], keep=hole_in_the_middle)
    return bodies.body(points, cells, points[cells].mean(1)[:, 1] > 0.75, floor_and_top(points))


def wall(n):
    """A row of nodes held from outside cuts the left of the body from the right; pad at the left.

    Beyond the wall no known force acts, so nothing there has a scale.
    """
    points, cells = scattered_triangles(n, lines=[np.column_stack(
        [np.full(n - 1, 0.5), np.linspace(0, 1, n + 1)[1:-1]])])  # fmt: skip
    reaction = floor_and_top(points) | np.isclose(points[:, 0], 0.5)
    known = (points[cells].mean(1) < [0.5, 2]).all(1) & (points[cells].mean(1)[:, 1] > 0.6)
    return bodies.body(points, cells, known, reaction)


BODIES = {f.__name__: f for f in (top_pad, pad_at_the_left, inclusion_in_pad, hole, wall)}


@pytest.mark.parametrize("n", [8, 12])
@pytest.mark.parametrize("shape", list(BODIES))
def test_unstructured_meshes_give_what_the_null_space_leaves(shape, n):
    one = push_from_above(BODIES[shape](n), 1.0, DOWN_AND_OBLIQUE)
    constants = determined_constants(one)
    determined = constants.all(axis=1)
    everywhere, walked = one.identify("global"), one.identify("sequential")
    assert_exactly(one, everywhere, determined, 1e-6)
    assert_exactly(one, walked, determined, 1e-4, within=10)
    # sequential may lose more to round-off far away, it never invents
    assert not (walked.status[~determined] > 0).any()
    assert np.array_equal(everywhere.status == Status.SHEAR_ONLY, constants[:, 1] & ~determined)
    if shape == "wall":
        beyond = one.points[one.cells].mean(1)[:, 0] > 0.5
        assert not determined[beyond].any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", ["top_pad", "pad_at_the_left", "inclusion_in_pad", "hole"])
def test_finer_unstructured_meshes_give_what_the_null_space_leaves(shape, seed):
    one = BODIES[shape](14)
    one.young[~one.known] = np.random.default_rng(seed).uniform(1e3, 5e3, (~one.known).sum())
    push_from_above(one, 1.0, DOWN_AND_OBLIQUE)
    determined = determined_cells(one)
    assert_exactly(one, one.identify("global"), determined, 1e-6)
    result = one.identify("sequential")
    assert_exactly(one, result, determined, 1e-4, within=10)


@pytest.mark.parametrize(("seed", "share"), [(0, 0.5), (0, 0.6), (1, 0.6), (1, 0.7), (2, 0.6)])
def test_one_trial_determines_the_cells_that_lie_in_much_pad_and_no_others(seed, share):
    points, cells = scattered_triangles(8)
    centres = points[cells].mean(axis=1)
    unknown = (np.abs(centres - 0.5) < 0.45).all(axis=1)
    unknown &= np.random.default_rng(seed).random(len(unknown)) < share
    one = bodies.body(points, cells, ~unknown, floor_and_top(points))
    push_from_above(one, 1.0, DOWN_AND_OBLIQUE[:1])
    determined = determined_cells(one)
    assert 0 < (determined & unknown).sum() < unknown.sum()
    for method in EXACT:
        assert_exactly(one, one.identify(method), determined, 1e-6)


def two_pieces():
    """The same square twice, side by side; only the left one has a pad."""
    points, cells = square_mesh(4, 4, 1, 1)
    left = points[cells].mean(axis=1)[:, 1] > 0.5
    apart = np.vstack([points, points + np.array([3, 0])])
    both = np.vstack([cells, cells + len(points)])
    known = np.r_[left, np.zeros(len(cells), bool)]
    one = bodies.body(apart, both, known, floor_and_top(apart))
    return push_from_above(one, 1.0, DOWN_AND_OBLIQUE)


def test_a_piece_that_touches_no_known_cell_is_not_determined():
    one = two_pieces()
    for method in EXACT:
        result = one.identify(method)
        assert_exactly(one, result, np.r_[np.ones(32, bool), np.zeros(32, bool)], 1e-8)
        assert any("32 of 48 unknown cells" in text for text in result.report["warnings"])


def test_cells_far_from_the_pad_that_round_off_destroys_are_not_given_as_found():
    one = push_from_above(squares(40, pad=0.1), 1.0, DOWN_AND_OBLIQUE)
    result = one.identify("sequential")
    given = (result.status >= 2) & ~one.known
    assert (result.status == 0).any()
    assert given.any()
    error = np.abs(result.mu - one.mu)
    assert (error[given] < 5 * result.mu_std[given] + 1e-12 * one.mu[given]).mean() > 0.99
    assert np.median(error[given] / one.mu[given]) < 1e-2


# ---------------------------------------------------------------------- other cells, other unknowns


def test_triangles_and_quads_in_one_mesh():
    points, quads = box_mesh((6, 6), (1, 1), "quad")
    inner = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    points = points + inner[:, None] * np.random.default_rng(0).uniform(-0.03, 0.03, points.shape)
    left = points[quads].mean(axis=1)[:, 0] < 0.5
    halves = quads[left]
    triangles = np.concatenate([halves[:, [0, 1, 3]], halves[:, [1, 2, 3]]])
    cells = [("quad", quads[~left]), ("triangle", triangles)]
    centres = make_mesh(points, cells).centres
    one = bodies.body(points, cells, centres[:, 1] > 0.7, floor_and_top(points))
    push_from_above(one, 1.0, (*DOWN_AND_OBLIQUE, (0.04, -0.02)))
    for method in EXACT:
        assert_exactly(one, one.identify(method), np.full(len(centres), True), 1e-8)


@pytest.mark.parametrize("method", EXACT)
def test_plane_stress_on_quads_with_loads(method):
    points, cells = box_mesh((8, 8), (1, 1), "quad")
    centres = points[cells].mean(axis=1)
    floor = np.isclose(points[:, 1], 0)
    one = bodies.body(points, cells, centres[:, 1] < 0.2, floor, plane="stress", seed=4,
                      young=(0.1, 1.0), poisson=(0.1, 0.5))  # fmt: skip
    top, right = np.isclose(points[:, 1], 1), np.isclose(points[:, 0], 1)
    for side, load in ((top, (0, -1)), (top, (1, 0)), (right, (1, 0)), (right, (0, 1))):
        one.push(np.zeros((floor.sum(), 2)), forces=0.002 * np.outer(side, load))
    one.reaction = floor | top | right  # where loads act, an outside body pushes
    result = one.identify(method)
    tolerance = 1e-8 if method == "global" else 1e-6
    assert (result.status[~one.known] == 2).all()
    assert np.abs(result.young / one.young - 1).max() < tolerance
    assert np.abs(result.poisson / one.poisson - 1).max() < tolerance
    # λ is the three-dimensional constant, Poisson's ratio times stiffness over (1 − 2ν)
    assert np.nanmax(one.errors(result)[one.poisson < 0.45]) < 10 * tolerance


@pytest.mark.parametrize("plane", ["strain", "stress"])
@pytest.mark.parametrize("method", EXACT)
def test_young_alone_needs_one_trial(plane, method):
    points, cells = scattered_triangles(7)
    known = points[cells].mean(axis=1)[:, 1] > 0.75
    one = bodies.body(points, cells, known, floor_and_top(points), plane=plane)
    one.poisson[:] = 0.46
    push_from_above(one, 1.0, DOWN_AND_OBLIQUE[1:])
    result = one.identify(method, unknowns="young", poisson_ratio=0.46)
    found = result.status[~one.known] == 2
    assert found.mean() > 0.9
    assert np.nanmax(np.abs(result.young / one.young - 1)) < 1e-8
    assert np.nanmax(np.abs(result.poisson - 0.46)) < 1e-12


@pytest.mark.parametrize("method", [*EXACT, "regularized"])
@pytest.mark.parametrize("unknowns", ["lambda-mu", "young"])
def test_one_unknown_material_per_label(method, unknowns):
    points, cells = scattered_triangles(8, lines=[bodies.circle(0.2, 10, (0.5, 0.4))])
    centres = points[cells].mean(axis=1)
    labels = np.where(centres[:, 1] > 0.75, 3, np.where(np.hypot(*(centres - [0.5, 0.4]).T) < 0.2,
                                                       7, 5))  # fmt: skip
    one = bodies.body(points, cells, labels == 3, floor_and_top(points))
    one.poisson[:] = 0.4
    one.young[:] = np.choose(np.searchsorted([3, 5, 7], labels), [5e3, 2e3, 9e3])
    push_from_above(one, 1.0, DOWN_AND_OBLIQUE[:1])
    more = {"poisson_ratio": 0.4} if unknowns == "young" else {}
    if method == "regularized":
        more |= {"refine": 1, "element": "linear"}  # the forward problem of these data
    result = one.identify(method, known={3: (5e3, 0.4)}, labels=labels, grouping="label",
                          unknowns=unknowns, **more)  # fmt: skip
    assert (result.status == np.where(labels == 3, 1, 2)).all()
    assert one.errors(result).max() < (1e-3 if method == "regularized" else 1e-9)


def test_a_pad_that_is_not_uniform_is_given_cell_by_cell():
    one = squares(6)
    one.young[one.known] *= np.random.default_rng(5).uniform(0.5, 2, one.known.sum())
    push_from_above(one, 1.0, DOWN_AND_OBLIQUE)
    assert_exactly(one, one.identify("global"), np.full(72, True), 1e-9)
    uniform = np.where(one.known[:, None], [one.young[one.known].mean(), 0.375], np.nan)
    assert np.nanmax(one.errors(one.identify("global", known=uniform))[~one.known]) > 0.01


# -------------------------------------------------------------------------------- planes of space


def turned(seed):
    q = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    return q, np.array([300.0, -200.0, 50.0])


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_a_planar_mesh_may_lie_in_any_plane_of_space(seed, clockwise):
    one = push_from_above(squares(5), 1.0, DOWN_AND_OBLIQUE)
    flat = one.identify("global")
    Q, shift = turned(seed)
    space = np.column_stack([one.points, np.zeros(len(one.points))]) @ Q.T + shift
    moved = np.array(one.trials) @ Q[:, :2].T
    cells = one.cells[:, ::-1] if clockwise else one.cells
    result = ei.identify(space, cells, moved, one.given, reaction_nodes=one.reaction,
                         method="global")  # fmt: skip
    assert_exactly(one, result, np.full(50, True), 1e-8)
    assert not any("dropped" in text for text in result.report["warnings"])
    assert result.residuals.shape == moved.shape
    assert np.allclose(flat.residuals, 0, atol=1e-9)
    # residuals are vectors of the world, in the plane of the mesh
    wrong = ei.identify(space, cells, moved * [[[1.0]], [[1.1]]], one.given,
                        reaction_nodes=one.reaction, method="global")  # fmt: skip
    size = np.abs(wrong.residuals).max()
    assert np.abs(wrong.residuals @ Q[:, 2]).max() < 1e-9 * max(size, 1.0)


def test_motion_across_the_plane_is_dropped_with_a_note_of_its_size():
    one = push_from_above(squares(5), 1.0, DOWN_AND_OBLIQUE)
    space = np.column_stack([one.points, np.full(len(one.points), 2.5)])
    moved = np.pad(np.array(one.trials), ((0, 0), (0, 0), (0, 1)), constant_values=0.0125)
    result = ei.identify(space, one.cells, moved, one.given, reaction_nodes=one.reaction,
                         method="global")  # fmt: skip
    assert_exactly(one, result, np.full(50, True), 1e-8)
    assert any("0.0125" in text and "dropped" in text for text in result.report["warnings"])


# ------------------------------------------------------------------------------------- what is said


@pytest.mark.parametrize("shape", ["wall", "apart"])
def test_the_fit_does_not_take_its_prior_for_data_where_no_equation_leads(shape):
    if shape == "wall":
        one = push_from_above(wall(8), 1.0, DOWN_AND_OBLIQUE)
        beyond = one.points[one.cells].mean(axis=1)[:, 0] > 0.5
    else:
        one = two_pieces()
        beyond = one.points[one.cells].mean(axis=1)[:, 0] > 2
    rng = np.random.default_rng(0)
    one.trials = [u + 1e-4 * rng.standard_normal(u.shape) for u in one.trials]
    result = one.identify("regularized", refine=1)
    assert (result.status[beyond] == 0).all()
    assert np.isnan(result.mu[beyond]).all()
    assert (result.status[~beyond & ~one.known] == 2).mean() > 0.9


@pytest.mark.parametrize("method", EXACT)
def test_what_is_left_of_the_balance_is_zero_at_free_nodes(method):
    one = push_from_above(squares(6), 1.0, DOWN_AND_OBLIQUE)
    result = one.identify(method)
    assert result.residuals.shape == (2, len(one.points), 2)
    assert np.abs(result.residuals).max() < 1e-8 * one.mu.max() * 0.05
    assert (result.residuals[:, one.reaction] == 0).all()


def test_trials_that_are_proportional_are_noticed():
    one = push_from_above(squares(4, pad=0.7), 1.0, ((0, -0.05), (0, -0.03)))
    assert any("proportional" in text for text in one.identify("global").report["warnings"])


def test_auto_keeps_the_walk_where_the_data_are_exact():
    one = push_from_above(squares(6), 1.0, DOWN_AND_OBLIQUE)
    result = one.identify("auto")
    assert result.report["method"] == "sequential"
    assert result.report["requested_method"] == "auto"
    assert_exactly(one, result, np.full(72, True), 1e-6)


@pytest.mark.parametrize("method", EXACT)
def test_auto_of_nothing_but_round_off_gives_standard_deviations_that_hold(method):
    one = push_from_above(top_pad(10), 1.0, DOWN_AND_OBLIQUE)
    result = one.identify(method)
    for found, true, std in (
        (result.mu, one.mu, result.mu_std), (result.lam, one.lam, result.lam_std)
    ):  # fmt: skip
        off = np.abs(found - true)[~one.known]
        assert (off <= 3 * std[~one.known]).mean() > 0.97
        assert (std[~one.known] < 1e-3 * true[~one.known]).all()
        assert (std[one.known] == 0).all()
