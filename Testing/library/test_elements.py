"""Cells, their refinement and their neighbours, against what geometry alone says."""

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.fem.elements import CELL_TYPES
from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.fem.mesh import make_mesh, plane_frame
from scipy.spatial import ConvexHull

KINDS = list(CELL_TYPES)
REFERENCE_VOLUME = {"triangle": 1 / 2, "quad": 4, "tetra": 1 / 6, "hexahedron": 8}


def distorted(kind, size=3, seed=0, amount=0.2):
    """A box of cells of one kind whose inner nodes are moved at random."""
    shape = (size,) * CELL_TYPES[kind].dim
    edges = np.ones(len(shape))
    if kind == "triangle":
        points, cells = square_mesh(*shape, 1, 1, "alternating")
    else:
        points, cells = box_mesh(shape, edges, kind)
    inner = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-amount, amount, points.shape) / size
    return points + inner[:, None] * shift, [(kind, cells)]


def mixed_plane():
    """Quads below, triangles above, one conforming mesh: 3×2 squares each."""
    points, quads = box_mesh((3, 4), (1.5, 2.0), "quad")
    upper = quads[6:]
    triangles = np.concatenate([upper[:, [0, 1, 3]], upper[:, [1, 2, 3]]])
    inner = (np.abs(points[:, 0] - 0.75) < 0.7) & (np.abs(points[:, 1] - 1) < 0.9)
    points = points + inner[:, None] * np.random.default_rng(1).uniform(-0.1, 0.1, points.shape)
    return points, [("quad", quads[:6]), ("triangle", triangles)]


def samples(cell, n=7):
    """Points inside the reference cell."""
    weights = np.random.default_rng(3).dirichlet(np.ones(cell.n_nodes), n)
    return weights @ cell.corners


@pytest.mark.parametrize("kind", KINDS)
def test_shape_functions_are_a_partition_of_unity_and_one_at_their_own_node(kind):
    cell = CELL_TYPES[kind]
    assert np.allclose(cell.values(samples(cell)).sum(axis=1), 1, atol=1e-14)
    assert np.allclose(cell.gradients(samples(cell)).sum(axis=1), 0, atol=1e-14)
    assert np.allclose(cell.values(cell.corners), np.eye(cell.n_nodes), atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_the_derivatives_of_the_shape_functions(kind):
    cell, step = CELL_TYPES[kind], 1e-6
    x = samples(cell)
    for axis, e in enumerate(np.eye(cell.dim)):
        slope = (cell.values(x + step * e) - cell.values(x - step * e)) / (2 * step)
        assert np.allclose(cell.gradients(x)[:, :, axis], slope, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_the_gauss_rule_is_full(kind):
    cell = CELL_TYPES[kind]
    x, w = cell.gauss_points, cell.gauss_weights
    assert np.isclose(w.sum(), REFERENCE_VOLUME[kind])
    assert np.allclose(w @ x, w.sum() * cell.corners.mean(axis=0))
    if kind in ("quad", "hexahedron"):  # ∫ ξ²η² …: needs two points along every axis
        assert np.isclose(w @ (x**2).prod(axis=1), (2 / 3) ** cell.dim)


@pytest.mark.parametrize("kind", KINDS)
def test_a_linear_field_has_its_gradient_in_distorted_cells(kind):
    points, cells = distorted(kind)
    mesh = make_mesh(points, cells)
    slope = np.random.default_rng(5).standard_normal((mesh.dim, mesh.dim))
    for block in mesh.blocks:
        H = block.gradient(points @ slope.T + 3.0)
        assert np.allclose(H, slope, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_volumes_of_distorted_cells_add_up_and_agree_with_their_hulls(kind):
    points, cells = distorted(kind)
    mesh = make_mesh(points, cells)
    assert np.isclose(mesh.volumes.sum(), 1)
    if kind != "hexahedron":  # whose faces are not flat
        hulls = [ConvexHull(points[nodes]).volume for nodes in cells[0][1]]
        assert np.allclose(mesh.volumes, hulls)


@pytest.mark.parametrize("make", [*KINDS, "mixed"])
def test_refinement_keeps_volumes_parents_nodes_and_fits_together(make):
    points, cells = mixed_plane() if make == "mixed" else distorted(make, 2)
    mesh = make_mesh(points, cells)
    finer, parent, interpolation = mesh.refined()
    children = 2**mesh.dim
    assert np.array_equal(np.bincount(parent), np.full(mesh.n_cells, children))
    assert np.allclose(np.bincount(parent, finer.volumes), mesh.volumes, rtol=1e-12)
    assert np.array_equal(finer.points[: mesh.n_nodes], mesh.points)
    assert np.allclose(interpolation @ mesh.points, finer.points, atol=1e-15)
    assert len(np.unique(finer.points.round(12), axis=0)) == finer.n_nodes
    # conforming: no side without a neighbour but the pieces of the sides that had none
    open_sides = [count_open_sides(m) for m in (mesh, finer)]
    assert open_sides[1] == open_sides[0] * 2 ** (mesh.dim - 1)
    mean = np.zeros_like(mesh.centres)
    np.add.at(mean, parent, finer.centres / children)
    assert np.allclose(mean, mesh.centres, atol=1e-12)  # the children surround the parent's centre


def count_open_sides(mesh):
    sides = [
        tuple(sorted(nodes[list(face)]))
        for block in mesh.blocks
        for nodes in block.nodes
        for face in block.cell.faces
    ]
    return sum(count == 1 for count in {s: sides.count(s) for s in set(sides)}.values())


def test_children_have_the_volume_of_their_parents_share_by_share():
    for kind in ("triangle", "tetra"):  # red refinement: equal volumes
        mesh = make_mesh(*distorted(kind, 2))
        finer, parent, _ = mesh.refined()
        assert np.allclose(finer.volumes, mesh.volumes[parent] / 2**mesh.dim)


def test_neighbours_across_quads_and_triangles_and_the_length_of_their_side():
    points = np.array([[0, 0], [2, 0], [2, 1], [0, 1], [3, 0], [3, 1.0]])
    mesh = make_mesh(
        points, [("triangle", np.array([[1, 4, 2], [4, 5, 2]])), ("quad", np.array([[0, 1, 2, 3]]))]
    )
    pairs, sizes = mesh.interfaces
    found = {tuple(sorted(pair)): size for pair, size in zip(pairs.tolist(), sizes, strict=True)}
    assert found.keys() == {(0, 1), (0, 2)}
    assert np.isclose(found[0, 1], np.sqrt(2))
    assert np.isclose(found[0, 2], 1)


@pytest.mark.parametrize("kind", ["hexahedron", "tetra"])
def test_common_faces_of_a_box(kind):
    points, cells = box_mesh((3, 2, 2), (3, 2, 2), kind)
    mesh = make_mesh(points, [(kind, cells)])
    pairs, sizes = mesh.interfaces
    if kind == "hexahedron":
        # 2×(2·2) across x, 1×(3·2) across y and z each, all faces of unit area
        assert len(pairs) == 8 + 6 + 6
        assert np.allclose(sizes, 1)
    else:
        on_skin = 2 * 2 * (3 * 2 + 3 * 2 + 2 * 2)  # two triangles per unit square
        assert len(pairs) == (4 * mesh.n_cells - on_skin) // 2
        assert set(sizes.round(12)) == {round(1 / 2, 12), round(np.sqrt(2) / 2, 12)}
    skin = ((points == 0) | (points == [3, 2, 2])).any(axis=1)
    assert np.array_equal(mesh.boundary_nodes, skin)


@pytest.mark.parametrize("seed", range(8))
def test_the_frame_of_a_plane_in_any_orientation_keeps_lengths_and_areas(seed):
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    flat = np.column_stack([rng.uniform(-50, 70, (30, 2)), np.zeros(30)])
    points = flat @ rotation.T + rng.uniform(-100, 100, 3)
    origin, axes = plane_frame(points)
    assert np.allclose(axes.T @ axes, np.eye(2), atol=1e-12)
    inside = (points - origin) @ axes
    assert np.allclose(origin + inside @ axes.T, points, atol=1e-9)
    assert np.isclose(ConvexHull(inside).volume, ConvexHull(flat[:, :2]).volume)


@pytest.mark.parametrize("normal", range(3))
def test_the_frame_of_a_coordinate_plane_follows_the_world_axes(normal):
    points = np.random.default_rng(0).uniform(size=(9, 3))
    points[:, normal] = 4.0
    _, axes = plane_frame(points)
    assert np.allclose(np.abs(axes).sum(axis=0), 1)
    assert np.allclose(axes[normal], 0)


def test_nodes_that_leave_their_plane_are_refused():
    points = np.random.default_rng(0).uniform(size=(9, 3)) * [1, 1, 1e-3]
    with pytest.raises(InputError, match=r"do not lie in one plane.*flatten"):
        plane_frame(points)


@pytest.mark.parametrize("kind", KINDS)
def test_an_inverted_cell_is_refused_with_its_number(kind):
    points, [(_, cells)] = distorted(kind)
    swap = {"triangle": [1, 0, 2], "quad": [0, 3, 2, 1], "tetra": [1, 0, 2, 3],
            "hexahedron": [4, 5, 6, 7, 0, 1, 2, 3]}[kind]  # fmt: skip
    cells = cells.copy()
    cells[7] = cells[7][swap]
    with pytest.raises(InputError, match=rf"1 of {len(cells)} {kind} cells.*first is cell 7\b"):
        make_mesh(points, [(kind, cells)])


def test_a_bad_cell_is_named_by_its_number_in_the_whole_mesh():
    points, [(quad, quads), (triangle, triangles)] = mixed_plane()
    triangles = triangles.copy()
    triangles[2] = triangles[2][[0, 0, 1]]  # no area
    with pytest.raises(InputError, match=rf"cell {len(quads) + 2}\b"):
        make_mesh(points, [(quad, quads), (triangle, triangles)])


def test_a_quad_that_folds_at_one_corner_only_is_refused():
    points = np.array([[0, 0], [1, 0], [0.2, 0.2], [0, 1.0]])  # area positive, corner 2 folded
    with pytest.raises(InputError, match="cell 0"):
        make_mesh(points, [("quad", np.array([[0, 1, 2, 3]]))])
