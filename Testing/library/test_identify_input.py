"""Bad input to identification: one line that says what, where and how to mend it."""

import bodies
import elastoidentify as ei
import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.fem.forward import box_mesh, square_mesh

N_NODES, N_CELLS, PAD = 25, 32, 16  # the paper's square; the pad's cells come last


@pytest.fixture(scope="module")
def good():
    """Arguments of identify that work, and that each test spoils in one place."""
    points, cells = square_mesh(4, 4, 1, 1)
    labels = np.where(points[cells].mean(axis=1)[:, 1] > 0.5, 2, 1)
    one = bodies.body(points, cells, labels == 2, bodies.floor_and_top(points))
    bodies.push_from_above(one, 1.0, ((0, -0.05), (-0.05, -0.05)))
    return {
        "points": points, "cells": cells, "displacements": np.array(one.trials),
        "known": {2: (5e3, 0.375)}, "labels": labels, "reaction_nodes": one.reaction,
        "method": "global",
    }  # fmt: skip


def test_the_arguments_work_as_they_are(good):
    assert (ei.identify(**good).status > 0).all()


def spoil(array, index, value):
    array = np.array(array, copy=True)
    array[index] = value
    return array


def turned_cell(good):
    return spoil(good["cells"], 9, good["cells"][9][[1, 0, 2]])


def per_cell(cell, young, poisson):
    known = np.full((N_CELLS, 2), np.nan)
    known[PAD:] = 5e3, 0.375
    known[cell] = young, poisson
    return known


INFORMATION = np.broadcast_to(np.eye(2), (2, N_NODES, 2, 2))
NAN, INF = np.nan, np.inf
CASES = {
    # what was given: (argument, its value or how it follows from the good ones, the message)
    "no known cells": ({"known": {}}, r"no cell is known.*give the pad's Young's modulus"),
    "nothing unknown": ({"known": {1: (1, 0.3), 2: (1, 0.3)}}, "nothing to identify"),
    "a label that is not there": (
        {"known": {7: (5e3, 0.4)}}, r"known label 7 does not occur.*its labels are 1, 2"),
    "labels missing": ({"labels": None}, "by label, but the cells have no labels"),
    "labels of another mesh": ({"labels": np.ones(31, int)}, r"labels: \(31,\) values for 32"),
    "negative stiffness": ({"known": {2: (-5.0, 0.4)}}, r"known label 2.*-5.*positive"),
    "infinite stiffness": ({"known": {2: (INF, 0.4)}}, r"known label 2.*inf.*positive"),
    "no stiffness": ({"known": {2: (NAN, 0.4)}}, r"known label 2.*nan.*positive"),
    "incompressible": ({"known": {2: (5e3, 0.5)}}, r"known label 2.*0\.5.*take 0\.49"),
    "stiffness without Poisson's ratio": (
        {"known": lambda g: per_cell(17, 5e3, NAN)}, r"cell 17.*Poisson's ratio"),
    "Poisson's ratio without stiffness": (
        {"known": lambda g: per_cell(18, NAN, 0.4)}, r"cell 18.*Young's modulus"),
    "a known cell of infinite stiffness": (
        {"known": lambda g: per_cell(19, INF, 0.4)}, r"known cell 19.*inf.*positive"),
    "a known cell of negative stiffness": (
        {"known": lambda g: per_cell(20, -1, 0.4)}, r"known cell 20.*-1.*positive"),
    "known cells of another mesh": ({"known": np.ones((31, 2))}, r"\(31, 2\), expected \(32, 2\)"),
    "NaN in displacements": (
        {"displacements": lambda g: spoil(g["displacements"], (1, 7, 0), NAN)},
        r"trial 2 is not a finite number.*node 7"),
    "a trial that does not move": (
        {"displacements": lambda g: g["displacements"] * [[[1.0]], [[0.0]]]},
        r"trial 2 has no displacement"),
    "no displacements": ({"displacements": np.empty((0, N_NODES, 2))}, r"displacements must have"),
    "displacements of another mesh": (
        {"displacements": np.ones((2, 24, 2))}, r"25 nodes.*\(2, 24, 2\)"),
    "displacements with four components": (
        {"displacements": np.ones((2, N_NODES, 4))}, r"4 components.*2 dimensions"),
    "fewer equations than unknowns": (
        {"displacements": lambda g: g["displacements"][:1]},
        r"fewer equations \(20: 10 free nodes × 2 components × 1 trials\) than unknowns \(32\)"
        r".*add trials"),
    "inverted cell": ({"cells": turned_cell}, r"cell 9\b.*repair the mesh"),
    "a node that does not exist": (
        {"cells": lambda g: spoil(g["cells"], (3, 1), 25)}, r"25, but the mesh has 25 nodes"),
    "triangles with two nodes": (
        {"cells": lambda g: [("triangle", g["cells"][:, :2])]}, r"\(32, 2\): expected \(n, 3\)"),
    "cells with five nodes": ({"cells": np.zeros((4, 5), int)}, r"\(4, 5\)"),
    "an unknown kind of cell": (
        {"cells": lambda g: [("wedge", g["cells"])]}, r"'wedge' is unknown.*triangle, quad"),
    "no cells": ({"cells": np.empty((0, 3), int), "labels": None}, "no cells"),
    "points of one dimension": ({"points": np.zeros(25)}, r"\(25,\)"),
    "a node at no place": (
        {"points": lambda g: spoil(g["points"], (12, 1), NAN)}, r"node 12 is not a finite"),
    "reaction nodes of another mesh": (
        {"reaction_nodes": np.zeros(24, bool)}, r"24,\) values for 25"),
    "an unknown method": ({"method": "magic"}, r"method 'magic' is unknown.*auto, sequential"),
    "unknown kinematics": ({"kinematics": "rubber"}, r"'rubber' is unknown.*neo-hookean"),
    "unknown plane": ({"plane": "flat"}, r"plane 'flat' is unknown.*strain, stress"),
    "unknown unknowns": ({"unknowns": "mu"}, r"unknowns 'mu' is unknown.*lambda-mu, young"),
    "unknown grouping": ({"grouping": "organ"}, r"grouping 'organ' is unknown.*cell, label"),
    "young without Poisson's ratio": ({"unknowns": "young"}, "need Poisson's ratio"),
    "young and incompressible": (
        {"unknowns": "young", "poisson_ratio": 0.5}, r"0\.5.*take 0\.49"),
    "groups without labels": (
        {"grouping": "label", "labels": None, "known": lambda g: per_cell(0, NAN, NAN)},
        "needs the label of every cell"),
    "finite strain in plane stress": (
        {"plane": "stress", "kinematics": "neo-hookean"}, r"plane stress.*small strain"),
    "noise of no size": ({"noise": 0.0}, r"noise is 0.*positive length"),
    "noise that is not a number": ({"noise": NAN}, r"noise is nan.*positive length"),
    "refinement by three": ({"refine": 3}, "1, 4 or 16"),
    "information of another mesh": (
        {"information": np.ones((2, 24, 2, 2))}, r"\(2, 24, 2, 2\)"),
    "information of another dimension": (
        {"information": np.ones((2, N_NODES, 5, 5))}, r"5×5.*2 dimensions"),
    "information that is not a number": (
        {"information": INFORMATION * NAN}, "no inverse covariance.*it is not finite"),
    "no information at all": ({"information": INFORMATION * 0.0}, "has no texture"),
}  # fmt: skip


@pytest.mark.parametrize("case", list(CASES))
def test_bad_input_is_refused_in_one_line_that_helps(good, case):
    changes, message = CASES[case]
    spoilt = {key: value(good) if callable(value) else value for key, value in changes.items()}
    with pytest.raises(InputError, match=message) as caught:
        ei.identify(**(good | spoilt))
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) > 25


def test_planar_and_solid_cells_in_one_mesh_are_refused():
    points, cells = box_mesh((1, 1, 1), (1, 1, 1))
    mixed = [("hexahedron", cells), ("triangle", cells[:, :3])]
    with pytest.raises(InputError, match="mixes planar and solid cells"):
        ei.identify(points, mixed, np.ones((1, 8, 3)), np.full((2, 2), np.nan))


def test_a_curved_surface_is_refused(good):
    bulge = np.column_stack([good["points"], 0.1 * (good["points"] ** 2).sum(axis=1)])
    with pytest.raises(InputError, match="do not lie in one plane"):
        ei.identify(**(good | {"points": bulge}))


def test_bad_input_is_refused_before_any_work(good):
    told = []
    with pytest.raises(InputError):
        ei.identify(**(good | {"method": "magic"}), progress=lambda share, text: told.append(text))
    assert told == []


@pytest.mark.parametrize("method", ["global", "sequential", "regularized", "auto"])
def test_cancelling_stops_at_once_and_comes_through(good, method):
    def stop(share, text):
        raise ei.Cancelled

    with pytest.raises(ei.Cancelled):
        ei.identify(**(good | {"method": method}), progress=stop)


@pytest.mark.parametrize("method", ["global", "sequential", "regularized", "auto"])
def test_progress_grows_from_zero_to_one(good, method):
    shares = []

    def note(share, text):
        assert text
        shares.append(share)

    ei.identify(**(good | {"method": method}), progress=note)
    assert shares[0] == 0
    assert shares[-1] == 1
    assert (np.diff(shares) >= 0).all()


def test_blocks_without_cells_are_as_good_as_none(good):
    cells = [("quad", np.empty((0, 4), int)), ("triangle", good["cells"])]
    assert (ei.identify(**(good | {"cells": cells})).status > 0).all()


def test_noise_beside_information_is_said_to_be_unused(good):
    information = INFORMATION / 1e-4**2
    plain = ei.identify(**(good | {"information": information}))
    both = ei.identify(**(good | {"information": information, "noise": 0.1}))
    assert np.array_equal(plain.mu_std, both.mu_std)
    assert any("noise given was not used" in text for text in both.report["warnings"])
    assert not any("noise given" in text for text in plain.report["warnings"])
