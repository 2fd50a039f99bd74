"""Nodes that a registration lost though no cell inverts: found, named, and not believed."""

from functools import cache

import numpy as np
import pytest
from elastoidentify import identify

pytest.importorskip("skfem")
import bodies
import broken
import forward
from elastoidentify.fem.forward import square_mesh

pytestmark = pytest.mark.usefixtures("without_model_misfit")

NOISE = 0.01  # mm; cells are stretched by some 0.15


@pytest.fixture(scope="module")
def square():
    return forward.squares(10)


@cache
def sound(kinematics, grouping):
    case = forward.squares(10)
    return forward.found(case, case.noisy(NOISE, 1), kinematics, grouping)


def moved(u, before):
    """Trial and node of every displacement that is not as before."""
    return [[t + 1, node] for t, node in np.argwhere((u != before).any(axis=2)).tolist()]


def assert_as_if_never_measured(case, result, kinematics="small-strain", grouping="cell"):
    """The map and the noise are those of the sound displacements; the verdict says what was done"""
    before = sound(kinematics, grouping)
    assert forward.contrast(case, result) == pytest.approx(forward.contrast(case, before), rel=0.05)
    outside = (case.from_edge > 2) & ~case.known
    assert np.nanmedian(result.young[outside]) == pytest.approx(
        np.nanmedian(before.young[outside]), rel=0.02
    )
    assert result.report["noise_scale"] == pytest.approx(before.report["noise_scale"], rel=0.1)
    verdict = result.report["verdict"]
    assert verdict["level"] == "trust with care"
    assert any("were not believed" in reason for reason in verdict["reasons"])


@pytest.mark.parametrize(
    "kinematics, grouping, count, size",
    [
        ("small-strain", "cell", 10, 0.5),
        ("neo-hookean", "cell", 5, 1.0),
        ("small-strain", "label", 1, 0.3),
        ("neo-hookean", "label", 10, 0.5),
    ],
)
def test_lost_nodes_are_named_and_the_map_is_as_without_them(
    square, kinematics, grouping, count, size
):
    sane = square.noisy(NOISE, 1)
    u = forward.spoiled(square, sane, count, 7 + count, size)
    result = forward.found(square, u, kinematics, grouping)
    assert result.report["inverted_cells"] == []
    assert result.report["nodes_astray"] == moved(u, sane)
    assert_as_if_never_measured(square, result, kinematics, grouping)
    said = " ".join(s for s in result.report["warnings"] if "no elastic body moves" in s)
    assert all(str(node) in said for _, node in moved(u, sane))


@pytest.mark.parametrize("node", [10, 55, 110, 115])
def test_lost_nodes_at_the_border_whose_motion_nothing_else_tells(square, node):
    """A fit follows the lost corner of a body, and leaves its neighbours off instead."""
    u = square.noisy(NOISE, 1)
    u[0, node] += (-1.0, 0.8)
    result = forward.found(square, u, grouping="label")
    assert [1, node] in result.report["nodes_astray"]
    assert len(result.report["nodes_astray"]) <= 2
    assert_as_if_never_measured(square, result, grouping="label")


@pytest.mark.parametrize("seed", [3, 8])
def test_lost_nodes_beside_cells_that_invert(square, seed):
    """Faults as large as a cell: some turn cells inside out, some do not."""
    u = forward.spoiled(square, square.noisy(NOISE, 1), 10, seed)
    result = forward.found(square, u)
    assert result.report["inverted_cells"] and result.report["nodes_astray"]
    assert_as_if_never_measured(square, result)


def test_lost_nodes_that_were_stored_as_not_moving(square):
    """As programs of image correlation may store them; in all trials the same nodes."""
    sane = square.noisy(NOISE, 1)
    u = sane.copy()
    u[:, [38, 52, 75]] = 0.0
    result = forward.found(square, u)
    assert result.report["nodes_astray"] == moved(u, sane)
    assert_as_if_never_measured(square, result)


def test_a_few_nodes_side_by_side(square):
    sane = square.noisy(NOISE, 1)
    u = sane.copy()
    u[0, np.linalg.norm(square.points - (9, 12), axis=1).argsort()[:3]] += (1.0, 0.6)
    result = forward.found(square, u)
    assert result.report["nodes_astray"] == moved(u, sane)
    assert_as_if_never_measured(square, result)


def test_a_large_patch_may_be_the_model_and_is_not_mended(square):
    u = square.noisy(NOISE, 1)
    u[0, np.linalg.norm(square.points - (9, 12), axis=1).argsort()[:9]] += (1.0, 0.6)
    result = forward.found(square, u)
    assert result.report["nodes_astray"] == []
    assert result.report["patch_astray"]["centre"] == pytest.approx((9, 12), abs=2)
    verdict = result.report["verdict"]
    assert verdict["level"] == "do not trust" and "lost there" in verdict["sentence"]


def test_with_information(square):
    sane = square.noisy(NOISE, 1)
    u = forward.spoiled(square, sane, 5, size=0.5)
    information = np.broadcast_to(np.eye(2) / NOISE**2, (*u.shape, 2))
    result = forward.found(square, u, information=information)
    assert result.report["nodes_astray"] == moved(u, sane)
    assert result.report["noise_scale"] == pytest.approx(1, rel=0.15)
    assert "stated noise explains" not in result.report["verdict"]["sentence"]


def test_noise_that_is_stated_larger_than_it_is_hides_what_it_explains(square):
    u = forward.spoiled(square, square.noisy(NOISE, 1), 5, size=0.5)
    result = forward.found(square, u, noise=0.1, method="regularized")
    assert result.report["nodes_astray"] == []


def of_broken(kind, n, noise):
    body = broken.body(kind, n=n, true_poisson=0.49)
    return identify(
        body.points, body.cells, body.noisy(noise, 0), {1: (1.0, body.poisson)},
        labels=body.labels, reaction_nodes=body.reaction, method="regularized",
    )  # fmt: skip


@pytest.mark.parametrize(
    "kind, noise", [("sound", 0.0), ("poisson", 0.0)] + [(kind, 0.01) for kind in broken.KINDS]
)
def test_no_node_of_a_body_that_is_sound_or_breaks_an_assumption_is_called_lost(kind, noise):
    result = of_broken(kind, 8, noise)
    assert result.report["nodes_astray"] == [] and result.report["patch_astray"] is None


def test_a_pad_that_slips_far_is_no_matter_of_lost_nodes():
    """Cells of λ and μ each make a soft layer of it, and leave too little for a misfit."""
    result = of_broken("slip", 16, 0.003)
    assert result.report["nodes_astray"] == []
    patch, verdict = result.report["patch_astray"], result.report["verdict"]
    assert patch["nodes"] > 10 and patch["centre"][1] == pytest.approx(22.5, abs=2)
    assert verdict["level"] == "do not trust"
    assert "something slips" in verdict["sentence"]


def test_numbers_are_those_of_the_mesh_given_and_loose_pieces_stay_out(square):
    """Two nodes that no cell has come first, and a cell apart from all others last."""
    sane = square.noisy(NOISE, 1)
    u = forward.spoiled(square, sane, 2, size=1.0)
    far = [[40.0, 0], [41, 0], [40, 1]]
    points = np.vstack([[[50.0, 50], [51, 51]], square.points, far])
    cells = np.vstack([square.cells, [[121, 122, 123]]]) + 2
    result = identify(
        points, cells, np.pad(u, ((0, 0), (2, 3), (0, 0))),
        np.vstack([square.materials, [[np.nan, np.nan]]]),
        reaction_nodes=np.pad(square.reaction, (2, 3)),
    )  # fmt: skip
    assert result.report["nodes_astray"] == [[t, node + 2] for t, node in moved(u, sane)]
    assert np.isnan(result.mu[-1])


def test_in_space():
    case = forward.boxes(5)
    sane = case.noisy(NOISE, 1)
    u = forward.spoiled(case, sane, 6, size=1.0)
    options = {"grouping": "label", "unknowns": "young", "poisson_ratio": 0.43}
    before, result = forward.found(case, sane, **options), forward.found(case, u, **options)
    missing = [one for one in moved(u, sane) if one not in result.report["nodes_astray"]]
    assert missing == [] and len(result.report["nodes_astray"]) <= 7
    assert forward.contrast(case, result) == pytest.approx(forward.contrast(case, before), rel=0.02)


# ---- methods that take every displacement as it is


def exact(noise=0.0, spoil=0.0):
    """A unit square of plain triangles, pushed two ways, with one node off in the first."""
    points, cells = square_mesh(8, 8, 1, 1)
    known = points[cells].mean(axis=1)[:, 1] > 0.75
    one = bodies.body(points, cells, known, bodies.floor_and_top(points))
    one.poisson[:] = 0.4
    one = bodies.push_from_above(one, 1, ((0, -0.05), (-0.05, -0.05)))
    u = np.array(one.trials)
    u += noise * np.random.default_rng(1).standard_normal(u.shape)
    u[0, 30] += (0.6 * spoil, -0.8 * spoil)
    return one, u


def by(method, one, u, **options):
    return identify(
        one.points, one.cells, u, one.given, reaction_nodes=one.reaction, method=method, **options
    )


@pytest.mark.parametrize("spoil", [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("method", ["sequential", "global"])
def test_exact_methods_say_that_a_node_contradicts_the_others(method, spoil):
    one, u = exact(spoil=spoil)
    result = by(method, one, u)
    verdict = result.report["verdict"]
    assert verdict["level"] == "do not trust"
    assert "known cells show" in verdict["sentence"] and "lost" in verdict["sentence"]
    wrong = ~one.known & (np.abs(result.young / one.young - 1) > 0.2)
    assert (result.young_std[wrong] > 0.03 * result.young[wrong]).all()  # not certain as rounding


@pytest.mark.parametrize("method", ["sequential", "global"])
def test_exact_methods_say_that_poissons_ratio_is_wrong(method):
    one, u = exact(1e-6)
    off = by(method, one, u, unknowns="young", poisson_ratio=0.35)
    right = by(method, one, u, unknowns="young", poisson_ratio=0.4)
    assert off.report["verdict"]["level"] == "do not trust"
    assert "miss the balance" not in right.report["verdict"]["sentence"]


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-6, 1e-4, 1e-3])
@pytest.mark.parametrize("method", ["sequential", "global"])
def test_noise_alone_contradicts_nothing(method, noise):
    result = by(method, *exact(noise))
    assert result.report["imbalance"] < 2.5
    assert "miss the balance" not in result.report["verdict"]["sentence"]


def test_auto_leaves_the_walk_that_its_own_balance_contradicts():
    one, u = exact(spoil=1e-2)
    result = by("auto", one, u)
    assert result.report["method"] == "regularized"
    assert "the balance of forces is missed" in result.report["auto"]
    assert result.report["nodes_astray"] == [[1, 30]]
