"""Bodies that slide on each other without friction: nodes, balance, and what is found."""

import elastoidentify as ei
import numpy as np
import pytest
import slipping
from elastoidentify.errors import InputError
from elastoidentify.fem.contact import split_nodes, touching
from elastoidentify.fem.forward import square_mesh
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.inverse.conditions import conditions
from slipping import E_PAD, E_TISSUE, POISSON

SLIP = ((1, 2),)
TILTED = ((0, -1.5), (1.05, -1.2, 0.06))


def found(case, displacements=None, **options):
    """Identify a case, by default with the slip that it has."""
    options = {
        "known": {1: (E_PAD, POISSON)}, "labels": case.labels, "slip": SLIP,
        "reaction_nodes": case.reaction, "method": "regularized",
    } | options  # fmt: skip
    displacements = case.displacements if displacements is None else displacements
    return ei.identify(case.points, case.cells, displacements, **options)


def layered(labels_of_squares):
    """3 × 3 squares of two triangles with labels row by row from below."""
    points, cells = square_mesh(3, 3, 3.0, 3.0)
    return points, cells, np.repeat(np.ravel(labels_of_squares), 2)


# ---- nodes


def test_each_side_of_an_interface_gets_its_own_nodes():
    points, cells, labels = layered([2, 2, 2, 2, 2, 2, 1, 1, 1])
    split, origin = split_nodes(cells, labels, SLIP)
    assert len(origin) == 16 + 4
    assert np.array_equal(points[origin][split], points[cells])
    assert not set(split[labels == 1].ravel()) & set(split[labels == 2].ravel())


def test_where_an_interface_ends_inside_the_body_both_sides_keep_one_node():
    _, cells, labels = layered([2, 2, 2, 2, 2, 2, 1, 1, 3])  # 3 sticks to both
    split, _ = split_nodes(cells, labels, SLIP)
    shared = set(split[labels == 1].ravel()) & set(split[labels == 2].ravel())
    assert shared == {10}  # where 1, 2 and 3 meet


def test_labels_that_slide_on_two_others_are_split_from_both():
    _, cells, labels = layered([2, 2, 3, 2, 2, 3, 1, 1, 1])
    split, origin = split_nodes(cells, labels, [(1, 2), (1, 3)])
    assert len(origin) == 16 + 4
    assert set(split[labels == 2].ravel()) & set(split[labels == 3].ravel())


def test_touching_nodes_are_found_again_with_the_normal_between_them():
    points, cells, labels = layered([2, 2, 2, 2, 2, 2, 1, 1, 1])
    cells, origin = split_nodes(cells, labels, SLIP)
    turn = np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    mesh = make_mesh(points[origin] @ turn, cells)
    nodes, normals = touching(mesh, labels, SLIP)
    assert np.allclose(mesh.points[nodes[:, 0]], mesh.points[nodes[:, 1]])
    assert len(nodes) == 4
    normal = np.array([0.0, 1.0]) @ turn
    assert np.allclose(normals[1] / np.trace(normals[1]), np.outer(normal, normal))


def test_sides_that_slide_share_their_normal_motion_only():
    points, cells, labels = layered([2, 2, 2, 2, 2, 2, 1, 1, 1])
    cells, origin = split_nodes(cells, labels, SLIP)
    mesh = make_mesh(points[origin], cells)
    there = conditions(mesh, np.zeros(mesh.n_nodes, bool), labels=labels, slip=SLIP)
    assert there.free.shape[1] == mesh.n_dofs - 4
    slide = np.where((mesh.node_cells @ (labels == 1) > 0)[:, None], [1.0, 0.0], [-1.0, 0.0])
    part = np.where((mesh.node_cells @ (labels == 1) > 0)[:, None], [0.0, 1.0], [0.0, 0.0])
    assert np.allclose(there.violation(slide), 0)
    assert np.abs(there.violation(part)).max() == pytest.approx(0.5)


def test_in_a_corner_of_the_interface_nothing_slides():
    points, cells, labels = layered([2, 2, 2, 2, 1, 2, 2, 2, 2])  # a square hole, filled by 1
    cells, origin = split_nodes(cells, labels, SLIP)
    mesh = make_mesh(points[origin], cells)
    there = conditions(mesh, np.zeros(mesh.n_nodes, bool), labels=labels, slip=SLIP)
    assert len(there.pairs) == 4
    assert there.free.shape[1] == mesh.n_dofs - 2 * 4


# ---- exact data


@pytest.mark.parametrize("method", ["sequential", "global"])
@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_exact_displacements_across_a_slip_give_exact_moduli(method, angle):
    case = slipping.slab(8, exact=True, pushes=TILTED)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    case.points, reaction = case.points @ turn, case.reaction
    result = found(case, case.displacements @ turn, method=method, reaction_nodes=reaction)
    true = np.where(case.inside, slipping.CONTRAST, 1.0) * E_TISSUE
    tissue = (case.labels == 2) & (result.status == 2)
    assert tissue.sum() > 80
    assert np.allclose(result.young[tissue], true[tissue], rtol=1e-6)
    assert result.report["contact"]["gap"] < 1e-9 * result.report["contact"]["slide"]


def test_a_floor_on_which_the_tissue_slides_asks_balance_along_it():
    case = slipping.slab(8, exact=True, floor="sliding", pushes=TILTED)
    marks = np.where(case.points[:, 1] < 1e-9, 2, case.reaction)
    result = found(case, method="global", reaction_nodes=marks)
    true = np.where(case.inside, slipping.CONTRAST, 1.0) * E_TISSUE
    tissue = (case.labels == 2) & (result.status == 2)
    assert np.allclose(result.young[tissue], true[tissue], rtol=1e-6)
    held = found(case, method="global")  # asks less there, and so finds no more
    assert (held.status == 2).sum() <= tissue.sum()
    assert result.report["equations"] > held.report["equations"]


TILTS = ((0, 0, -1.5), (1, 0, -1, 0.08), (0, 1, -1, -0.05), (0.5, 0.5, -1, 0.02))


@pytest.mark.parametrize("n", [3, 4])
def test_in_space_the_fit_by_products_finds_the_tissue(n):
    """Nodes that slide have fewer unknowns than axes, whatever number that makes of all."""
    case = slipping.block(n, exact=True, pushes=TILTS)
    case.cells = [("hexahedron", case.cells)]
    result = found(case, method="regularized", element="linear")
    plain = (case.labels == 2) & ~case.inside
    assert np.median(result.young[plain]) == pytest.approx(E_TISSUE, rel=0.03)


def test_exact_displacements_in_space_give_exact_moduli():
    case = slipping.block(4, exact=True, pushes=TILTS)
    case.cells = [("hexahedron", case.cells)]
    result = found(case, method="global")
    true = np.where(case.inside, slipping.CONTRAST, 1.0) * E_TISSUE
    tissue = (case.labels == 2) & (result.status == 2)
    assert tissue.sum() > 25
    assert np.allclose(result.young[tissue], true[tissue], rtol=1e-6)


# ---- independent data


@pytest.mark.slow
@pytest.mark.parametrize("surface", [slipping.flat, slipping.arched])
def test_a_hidden_lesion_under_a_sliding_pad_is_found(surface):
    case = slipping.slab(12, surface)
    result = found(case, case.noisy(0.005))
    contrast, tissue = case.contrast(result.young)
    assert contrast == pytest.approx(slipping.CONTRAST, rel=0.1)
    assert tissue == pytest.approx(E_TISSUE, rel=0.1)


# ---- refusals


def test_a_mesh_whose_sides_share_nodes_cannot_slip():
    points, cells = square_mesh(8, 8, 30.0, 30.0)
    labels = np.where(points[cells].mean(axis=1)[:, 1] > 22.5, 1, 2)
    push = np.column_stack([0 * points[:, 1], -0.05 * points[:, 1]])
    with pytest.raises(InputError, match=r"share 9 nodes.*with the same slip"):
        ei.identify(points, cells, push, {1: (5.0, 0.4)}, labels=labels, slip=SLIP)
    with pytest.raises(InputError, match="label 7 does not occur"):
        ei.identify(points, cells, push, {1: (5.0, 0.4)}, labels=labels, slip=((1, 7),))
