"""What users give: sound input in odd forms is taken, unsound refused, doubtful said."""

import bodies
import elastoidentify as ei
import numpy as np
import pytest
from bodies import floor_and_top, push_from_above, scattered_triangles
from elastoidentify.errors import InputError
from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.results import Status

NAN, INF = np.nan, np.inf
PUSHES = ((0, -0.05), (-0.05, -0.05))
METHODS = ("sequential", "global", "regularized", "auto")
YOUNG = {"unknowns": "young", "poisson_ratio": 0.4}


def pushed(points, cells, noise=0.0, pushes=PUSHES):
    """A body of two labels, pad (2) above, with one ν; `noise` is added to its displacements."""
    points, cells = np.asarray(points), np.asarray(cells)
    known = points[cells].mean(axis=1)[:, 1] > 0.65
    one = bodies.body(points, cells, known, floor_and_top(points), young=(5e3, 5e3))
    one.young[~known], one.poisson[:] = 3e3, 0.4
    push_from_above(one, 1.0, pushes)
    rng = np.random.default_rng(0)
    one.trials = [u + noise * rng.standard_normal(u.shape) for u in one.trials]
    return one


@pytest.fixture(scope="module")
def exact():
    return pushed(*square_mesh(5, 5, 1, 1))


@pytest.fixture(scope="module")
def noisy():
    return pushed(*scattered_triangles(5), noise=1e-4)


def arguments(one):
    labels = np.where(one.known, 2, 1)
    return {
        "points": one.points, "cells": one.cells, "displacements": np.array(one.trials),
        "known": {2: (5e3, 0.4)}, "labels": labels, "reaction_nodes": one.reaction,
        "method": "global", **YOUNG, "refine": 1, "element": "linear",  # as the data were made
    }  # fmt: skip


def said(result, *words):
    return [text for text in result.report["warnings"] if all(word in text for word in words)]


def same(a, b):
    return np.array_equal(a.status, b.status) and np.array_equal(a.mu, b.mu, equal_nan=True)


def weights(one, sizes):
    """Information of trials whose displacements are good to `sizes`; None: not known at all."""
    n, d = one.points.shape
    per_trial = [0.0 if size is None else size**-2.0 for size in sizes]
    return np.array(per_trial)[:, None, None, None] * np.broadcast_to(np.eye(d), (n, d, d))


# ------------------------------------------------------------------------------------- lost trials


@pytest.mark.parametrize(
    ("method", "grouping", "kinematics"),
    [
        *((method, "cell", "small-strain") for method in METHODS),
        ("global", "cell", "neo-hookean"),
        ("regularized", "label", "small-strain"),
        ("regularized", "label", "neo-hookean"),
    ],
)
def test_a_lost_trial_is_left_out_and_the_others_give_the_map(method, grouping, kinematics, noisy):
    more = arguments(noisy) | {"method": method, "grouping": grouping, "kinematics": kinematics}
    alone = ei.identify(
        **more | {"displacements": noisy.trials[0], "information": weights(noisy, [1e-4])}
    )
    result = ei.identify(**more, information=weights(noisy, [1e-4, None]))
    assert same(result, alone)
    assert said(result, "trial 2 has no information", "rests on trial 1")
    assert result.report["lost_trials"] == [2]
    assert result.residuals.shape == (2, *noisy.points.shape)
    assert np.isnan(result.residuals[1]).all()
    assert np.array_equal(result.residuals[0], alone.residuals[0], equal_nan=True)


@pytest.mark.parametrize("method", METHODS)
def test_a_lost_trial_is_left_out_in_space_too(method):
    points, cells = box_mesh((2, 2, 3), (1.0, 1.0, 1.0))
    known = points[cells].mean(axis=1)[:, 2] > 0.65
    one = bodies.body(points, cells, known, floor_and_top(points), young=(5e3, 5e3))
    one.young[~known], one.poisson[:] = 3e3, 0.4
    pushes = ((0, 0, -0.05), (0.05, 0, -0.05), (0, 0.05, -0.05), (0.03, 0.04, 0))
    push_from_above(one, 1.0, pushes)
    u = np.array(one.trials)
    u[1] = NAN
    more = arguments(one) | {"displacements": u, "method": method, "grouping": "label"}
    result = ei.identify(**more, information=weights(one, [1e-4, None, 1e-4, 1e-4]))
    assert said(result, "trial 2 has no information", "rests on trials 1, 3, 4")
    assert np.isnan(result.residuals[1]).all()
    assert np.nanmax(np.abs(result.young[~known] / 3e3 - 1)) < 1e-3


@pytest.mark.parametrize("rubbish", [0.0, NAN, INF, 1e6, "wild"])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_whatever_stands_in_a_lost_trial_does_not_matter(place, rubbish, exact):
    more = arguments(exact)
    u = list(more["displacements"])
    wild = np.random.default_rng(0).standard_normal(u[0].shape)
    u.insert(place, wild if rubbish == "wild" else np.full_like(u[0], rubbish))
    sizes = [1e-6, 1e-6]
    sizes.insert(place, None)
    result = ei.identify(**more | {"displacements": u}, information=weights(exact, sizes))
    assert np.nanmax(exact.errors(result)[~exact.known]) < 1e-8
    assert result.report["lost_trials"] == [place + 1]
    assert np.isnan(result.residuals[place]).all()
    others = np.delete(result.residuals, place, axis=0)
    assert np.abs(others).max() < 1e-6


def test_two_of_three_may_be_lost(exact):
    more = arguments(exact)
    u = np.concatenate([more["displacements"], more["displacements"][:1]])
    information = weights(exact, [None, 1e-6, None])
    result = ei.identify(**more | {"displacements": u}, information=information)
    assert said(result, "trials 1, 3 have no information and"[:30], "rests on trial 2")


def test_a_trial_known_to_the_size_of_the_mesh_only_is_lost(exact):
    result = ei.identify(**arguments(exact), information=weights(exact, [1e-6, 2.0]))
    assert result.report["lost_trials"] == [2]


@pytest.mark.parametrize("size", [1e-2, 1e-1, 1.0])
def test_a_trial_of_little_weight_stays(size, exact):
    result = ei.identify(**arguments(exact), information=weights(exact, [1e-6, size]))
    assert result.report["lost_trials"] == []
    assert np.nanmax(exact.errors(result)[~exact.known]) < 1e-8


def test_where_all_trials_are_lost_there_is_no_map(exact):
    with pytest.raises(InputError, match=r"zero everywhere.*every registration failed"):
        ei.identify(**arguments(exact), information=weights(exact, [None, None]))


def test_one_trial_left_is_too_little_for_two_unknowns_per_cell(exact):
    more = arguments(exact) | {"unknowns": "lambda-mu", "poisson_ratio": None}
    with pytest.raises(InputError, match=r"fewer equations .* × 1 trials"):
        ei.identify(**more, information=weights(exact, [1e-6, None]))


# ------------------------------------------------------------------------------ unsound information


def spoilt(one, change):
    information = weights(one, [1e-4, 1e-4]).copy()
    change(information)
    return information


def at_nodes(change, nodes, trial=1):
    """Change the matrix of some nodes in a trial (counted from 1)."""

    def spoil(information):
        for node in nodes:
            change(information[trial - 1, node])

    return spoil


def negative(W):
    W *= -1


def indefinite(W):
    W[0, 1] = W[1, 0] = 3e8


def askew(W):
    W[0, 1] = 5e7


def holed(W):
    W[1, 1] = NAN


def endless(W):
    W[0, 0] = INF


FAULTS = {
    "negative": (negative, "negative in some direction"),
    "indefinite": (indefinite, "negative in some direction"),
    "not symmetric": (askew, "not symmetric"),
    "NaN": (holed, "not finite"),
    "infinite": (endless, "not finite"),
}


@pytest.mark.parametrize("case", list(FAULTS))
def test_much_unsound_information_is_refused_in_one_line(case, exact):
    change, what = FAULTS[case]
    nodes = np.arange(7, 12)
    message = f"trial 2 is no inverse covariance at 5 of 36 nodes.*node 7.*{what}"
    with pytest.raises(InputError, match=message) as caught:
        ei.identify(**arguments(exact), information=spoilt(exact, at_nodes(change, nodes, 2)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", list(FAULTS))
def test_a_few_nodes_of_unsound_information_lose_their_weight_and_are_named(case, method, noisy):
    """Their displacements may be anything: the map is that of information zero there."""
    change, what = FAULTS[case]
    more = arguments(noisy) | {"method": method, "grouping": "label"}
    result = ei.identify(**more, information=spoilt(noisy, at_nodes(change, [20, 30])))
    blank = ei.identify(
        **more, information=spoilt(noisy, at_nodes(lambda W: W.fill(0.0), [20, 30]))
    )
    assert same(result, blank)
    (text,) = said(result, "trial 1 is no inverse covariance at 2 of")
    assert "node 20" in text and what in text and "counts as unknown" in text
    assert not said(blank, "inverse covariance")


def test_information_in_another_unit_is_refused(exact):
    with pytest.raises(InputError, match=r"±10.*measures 1\.41.*unit of"):
        ei.identify(**arguments(exact), information=1e-10 * weights(exact, [1e-4, 1e-4]))


def test_nodes_without_information_do_not_make_the_noise_look_smaller():
    """Half of the nodes tell nothing; those that do have errors as large as they say."""
    one = pushed(*scattered_triangles(10), noise=1e-4)
    information = weights(one, [1e-4, 1e-4]).copy()
    information[:, ::2] = 0.0
    more = arguments(one) | {"method": "regularized", "grouping": "label"}
    result = ei.identify(**more, information=information)
    assert result.report["noise_scale"] == pytest.approx(1, abs=0.15)  # 0.7 if they counted


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rounding_makes_information_of_one_direction_not_negative(dtype, exact):
    """An edge in the image tells across itself only: its tensor has a zero eigenvalue, rounded."""
    across = np.array([0.6, 0.8]) * 1e5
    information = np.broadcast_to(np.outer(across, across), (2, len(exact.points), 2, 2))
    result = ei.identify(**arguments(exact), information=information.astype(dtype))
    assert (result.status > 0).all()


# ------------------------------------------------------------------------- seams, pieces and folds


def torn(one, kind):
    """The same body with nodes stored twice: along a line, around every cell."""
    cells, n = one.cells.copy(), len(one.points)
    if kind == "every cell":
        return cells.ravel(), np.arange(cells.size).reshape(cells.shape)
    right = one.points[cells].mean(axis=1)[:, 0] > 0.5
    on_line = np.intersect1d(cells[right], cells[~right])
    number = np.arange(n)
    number[on_line] = n + np.arange(len(on_line))
    cells[right] = number[cells[right]]
    return np.r_[np.arange(n), on_line], cells


@pytest.mark.parametrize("kind", ["line", "every cell"])
@pytest.mark.parametrize("method", METHODS)
def test_nodes_stored_twice_count_as_one(method, kind, noisy):
    origin, cells = torn(noisy, kind)
    more = arguments(noisy) | {"method": method}
    whole = ei.identify(**more)
    reaction = noisy.reaction[origin].copy()
    for node in np.flatnonzero(noisy.reaction):  # only one of the copies is marked
        reaction[np.flatnonzero(origin == node)[1:]] = False
    result = ei.identify(
        **more | {
            "points": noisy.points[origin], "cells": cells, "reaction_nodes": reaction,
            "displacements": np.array(noisy.trials)[:, origin],
        }
    )  # fmt: skip
    assert said(result, f"{len(origin) - len(noisy.points)} nodes were stored twice")
    assert result.residuals.shape == (2, len(origin), 2)
    found = (whole.status == Status.IDENTIFIED) & (result.status == Status.IDENTIFIED)
    assert found.sum() >= 0.9 * (whole.status == Status.IDENTIFIED).sum()
    # the samples of the noise are others, and the fit stops elsewhere
    off = np.abs(result.mu - whole.mu)[found]
    allowed = 1e-9 * whole.mu if method in ("sequential", "global") else whole.mu_std
    assert (off < allowed[found]).all()


def test_a_crack_stays_open_and_is_said(exact):
    origin, cells = torn(exact, "line")
    u = np.array(exact.trials)[:, origin]
    u[:, len(exact.points) :, 0] += 0.01
    result = ei.identify(
        **arguments(exact) | {
            "points": exact.points[origin], "cells": cells, "displacements": u,
            "reaction_nodes": exact.reaction[origin],
        }
    )  # fmt: skip
    n = len(origin) - len(exact.points)
    assert said(result, f"{n} nodes lie at the place of another and move differently")


@pytest.mark.parametrize("method", METHODS)
def test_cells_that_share_no_node_are_refused(method, exact):
    origin, cells = torn(exact, "every cell")
    u = np.array(exact.trials)[:, origin]
    u = u + 0.01 * np.random.default_rng(0).standard_normal(u.shape)
    with pytest.raises(InputError, match=r"50 pieces that share no node.*merge the nodes"):
        ei.identify(
            **arguments(exact) | {
                "points": exact.points[origin], "cells": cells, "displacements": u,
                "reaction_nodes": exact.reaction[origin], "method": method,
            }
        )  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_a_piece_without_known_cells_is_said(method, noisy):
    n = len(noisy.points)
    loose = noisy.cells[~noisy.known][:5]
    u = np.array(noisy.trials)
    result = ei.identify(
        **arguments(noisy) | {
            "points": np.vstack([noisy.points, noisy.points + 2]),
            "cells": np.vstack([noisy.cells, loose + n]),
            "labels": np.r_[np.where(noisy.known, 2, 1), np.ones(5, int)],
            "displacements": np.concatenate([u, u], axis=1),
            "reaction_nodes": np.r_[noisy.reaction, np.zeros(n, bool)], "method": method,
        }
    )  # fmt: skip
    assert said(result, "5 cells, the first is cell", "share no node")
    assert (result.status[-5:] == Status.NOT_DETERMINED).all()
    assert (result.status[:-5] > 0).any()


@pytest.mark.parametrize("mesh", ["scattered", "crossed", "shuffled"])
def test_displacements_in_the_reverse_order_of_the_nodes_are_said(mesh):
    """A regular mesh is its own image in reverse: there it could be a body upside down."""
    points, cells = scattered_triangles(8) if mesh == "scattered" else square_mesh(
        6, 6, 1, 1, "crossed" if mesh == "crossed" else "paper")  # fmt: skip
    if mesh == "shuffled":
        order = np.random.default_rng(0).permutation(len(points))
        points, cells = points[order], np.argsort(order)[cells]
    one = pushed(points, cells)
    more = arguments(one)
    assert not said(ei.identify(**more), "order")
    result = ei.identify(**more | {"displacements": more["displacements"][:, ::-1]})
    assert len(said(result, "smoother in the reverse order")) == 2


def test_displacements_in_random_order_are_said():
    one = pushed(*scattered_triangles(8))
    u = np.random.default_rng(0).permutation(np.array(one.trials), axis=1)
    result = ei.identify(**arguments(one) | {"displacements": u})
    assert len(said(result, "jump from node to node")) == 2


@pytest.mark.parametrize("kinematics", ["small-strain", "neo-hookean", "st-venant-kirchhoff"])
def test_cells_turned_inside_out_are_said(kinematics, exact):
    u = np.array(exact.trials)
    inner = np.abs(exact.points - 0.5).max(axis=1).argmin()
    u[1, inner] += [0.5, 0.4]
    try:
        result = ei.identify(**arguments(exact) | {"displacements": u, "kinematics": kinematics})
    except InputError as error:
        assert "inside out" in str(error)
        return
    (text,) = said(result, "trial 2", "inside out")
    folded = _inside_out(exact, u[1])
    assert f"turn {len(folded)} of 50 cells" in text
    assert f"first is cell {folded[0]}" in text
    assert not said(ei.identify(**arguments(exact)), "inside out")


def _inside_out(one, u):
    """Cells whose corners turn the other way when they have moved."""
    corners = (one.points + u)[one.cells]
    return np.flatnonzero(np.linalg.det(corners[:, 1:] - corners[:, :1]) <= 0)


@pytest.mark.parametrize("factor", [1e3, 1e-5])
def test_displacements_in_another_unit_are_said(factor, exact):
    more = arguments(exact)
    assert not said(ei.identify(**more), "unit of length")
    more["displacements"] = factor * more["displacements"]
    assert len(said(ei.identify(**more), "unit of length")) == 2


# ------------------------------------------------------------------------- the noise that is given


@pytest.mark.parametrize(
    ("method", "given"),
    [(method, 1e-6) for method in METHODS] + [("global", 1e-12), ("regularized", 1e-12)],
)
def test_noise_far_below_what_the_data_show_is_said(given, method, noisy):
    result = ei.identify(**arguments(noisy) | {"method": method}, noise=given)
    (text,) = said(result, "the noise was given as", "shows about")
    shown = float(text.split("shows about ")[1].split(":")[0])
    assert 3e-5 < shown < 3e-3


@pytest.mark.parametrize("method", ["global", "regularized"])
@pytest.mark.parametrize("given", [3e-5, 1e-4, 1e-2])
def test_noise_of_the_right_size_or_too_large_is_not_complained_of(given, method, noisy):
    result = ei.identify(**arguments(noisy) | {"method": method}, noise=given)
    assert not said(result, "the noise was given as")


# ---------------------------------------------------------------------------------- forms of arrays


def masked(array, index):
    array = np.ma.array(array, float)
    array[index] = np.ma.masked
    return array


FORMS = {
    "lists": ("points", lambda x: x.tolist()),
    "cells as floats": ("cells", lambda x: x.astype(float)),
    "cells as lists of floats": ("cells", lambda x: [[float(v) for v in row] for row in x]),
    "cells of a small type": ("cells", lambda x: x.astype(np.uint8)),
    "complex numbers without an imaginary part": ("points", lambda x: x.astype(complex)),
    "a masked array without a mask": ("displacements", np.ma.array),
    "objects": ("displacements", lambda x: x.astype(object)),
    "labels as floats": ("labels", lambda x: x.astype(float)),
    "labels just below whole numbers": ("labels", lambda x: x - 1e-7),
    "reaction nodes as floats": ("reaction_nodes", lambda x: x.astype(float)),
    "reaction nodes as other numbers": ("reaction_nodes", lambda x: 7 * x.astype(int)),
    "a known material as a list": ("known", lambda x: {2: [5e3, 0.4]}),
    "a known material as an array": ("known", lambda x: {2: np.array([5e3, 0.4])}),
}


@pytest.mark.parametrize("form", list(FORMS))
def test_sound_values_may_come_in_any_form(form, exact):
    name, change = FORMS[form]
    more = arguments(exact)
    assert same(ei.identify(**more), ei.identify(**more | {name: change(more[name])}))


def test_known_cells_may_be_masked_where_they_are_not_known(exact):
    known = np.ma.masked_invalid(exact.given)
    assert same(ei.identify(**arguments(exact) | {"known": known}),
                ei.identify(**arguments(exact) | {"known": exact.given}))  # fmt: skip


REFUSED = {
    "masked points": ("points", lambda x: masked(x, 3), "points: 2 values are masked"),
    "masked displacements": ("displacements", lambda x: masked(x, (0, 4)), "2 values are masked"),
    "masked labels": ("labels", lambda x: masked(x, 9), "labels: 1 values are masked"),
    "masked reaction nodes": ("reaction_nodes", lambda x: masked(x, 9), "nodes: 1 values are mask"),
    "complex points": ("points", lambda x: x + 1e-3j, "points: real numbers.*complex"),
    "complex displacements": ("displacements", lambda x: x + 1e-3j, "displacements: real.*complex"),
    "words": ("points", lambda x: x.astype(str), "points: real numbers"),
    "nothing": ("points", lambda x: None, "points"),
    "rows of different length": ("cells", lambda x: [[0, 1, 2], [1, 2]], "cells: this is no array"),
    "cells between nodes": ("cells", lambda x: x + 0.5, "cells: whole numbers.*0.5 at 0, 0"),
    "cells at NaN": (
        "cells", lambda x: np.where(x == 7, NAN, x), "cells: whole numbers.*nan at"),
    "solid cells in the plane": (
        "cells", lambda x: [("tetra", np.c_[x, x[:, 0]])], "solid cells need points of three"),
    "labels between": ("labels", lambda x: x + 0.5, "labels: whole numbers.*1.5 at 0"),
    "a label that is NaN": (
        "labels", lambda x: np.where(np.arange(len(x)) == 6, NAN, x), "labels: whole.*nan at 6"),
    "reaction nodes of NaN": (
        "reaction_nodes", lambda x: x * NAN, "reaction nodes: 36 of 36 values are NaN.*node 0"),
    "a reaction node of NaN": (
        "reaction_nodes", lambda x: np.where(np.arange(36) == 8, NAN, x), "1 of 36.*node 8"),
    "a known scalar": ("known", lambda x: 5e3, r"shape \(\).*\{label: \(E, ν\)\}"),
    "a known pair": ("known", lambda x: (5e3, 0.4), r"shape \(2,\).*\{label: \(E, ν\)\}"),
    "a scalar by label": ("known", lambda x: {2: 5e3}, "label 2 is given as 5000.*two numbers"),
    "a triple by label": (
        "known", lambda x: {2: (5e3, 0.4, 1.0)}, r"label 2 is given as \(5000.*two numbers"),
    "a word by label": ("known", lambda x: {2: "stiff"}, "label 2 is given as 'stiff'.*two numb"),
    "None by label": ("known", lambda x: {2: None}, "label 2 is given as None.*two numbers"),
}  # fmt: skip


@pytest.mark.parametrize("case", list(REFUSED))
def test_values_that_would_lose_their_meaning_are_refused_in_one_line(case, exact):
    name, change, message = REFUSED[case]
    more = arguments(exact)
    with pytest.raises(InputError, match=message) as caught:
        ei.identify(**more | {name: change(more[name])})
    assert "\n" not in str(caught.value)


# ----------------------------------------------------------------------------------- reaction nodes


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("given", [None, "nowhere"])
def test_without_reaction_nodes_it_is_said_why_nothing_is_determined(given, method, noisy):
    reaction = None if given is None else np.zeros(len(noisy.points), bool)
    result = ei.identify(**arguments(noisy) | {"reaction_nodes": reaction, "method": method})
    assert (result.status[~noisy.known] == 0).mean() > 0.5
    assert said(result, "no node on the surface is marked as a reaction node")


@pytest.mark.parametrize("method", METHODS)
def test_reaction_nodes_everywhere_leave_no_equation(method, noisy):
    more = arguments(noisy) | {"reaction_nodes": np.ones(len(noisy.points), bool)}
    with pytest.raises(InputError, match="no equation: every node of an unknown cell is marked"):
        ei.identify(**more | {"method": method})


def test_nothing_is_said_of_reaction_nodes_where_the_map_is_found(noisy):
    assert not said(ei.identify(**arguments(noisy)), "reaction node")
