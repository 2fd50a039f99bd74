"""Meshes from elsewhere: seams, pieces, folds and overlaps are seen, sound ones are let through."""

import numpy as np
import pytest
from elastoidentify.fem import soundness
from hypothesis import given, settings
from hypothesis import strategies as st


def square(n=4, kind="triangle"):
    """Return the unit square of n × n squares as points (…, 2) and blocks."""
    y, x = np.mgrid[: n + 1, : n + 1] / n
    points = np.column_stack([x.ravel(), y.ravel()])
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    quads = np.column_stack([a, a + 1, a + n + 2, a + n + 1])
    if kind == "quad":
        return points, [("quad", quads)]
    return points, [("triangle", np.vstack([quads[:, [0, 1, 3]], quads[:, [1, 2, 3]]]))]


def cube(n=2, kind="hexahedron"):
    """Return the unit cube as points (…, 3) and blocks; tetrahedra fill each cube by six."""
    z, y, x = np.mgrid[: n + 1, : n + 1, : n + 1] / n
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    m = n + 1
    k, j, i = np.mgrid[:n, :n, :n]
    a = (k * m * m + j * m + i).ravel()
    up = m * m
    hexes = np.column_stack(
        [a, a + 1, a + m + 1, a + m, a + up, a + up + 1, a + up + m + 1, a + up + m]
    )
    if kind == "hexahedron":
        return points, [("hexahedron", hexes)]
    six = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
    return points, [("tetra", np.vstack([hexes[:, one] for one in six]))]


MESHES = [(square, "triangle"), (square, "quad"), (cube, "tetra"), (cube, "hexahedron")]


@pytest.mark.parametrize("make, kind", MESHES)
def test_a_sound_mesh_is_one_piece_without_overlap_however_its_cells_turn(make, kind):
    points, [(kind, nodes)] = make(kind=kind)
    turned = nodes.copy()
    if kind in ("triangle", "tetra"):
        turned[::2] = turned[::2][:, [1, 0, *range(2, nodes.shape[1])]]
    blocks = [(kind, turned)]
    assert soundness.overlaps(points, blocks) is None
    assert soundness.pieces(len(points), blocks)[0] == 1
    assert np.array_equal(soundness.coincident(points, blocks), np.arange(len(points)))


@pytest.mark.parametrize("make, kind", MESHES)
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
def test_nodes_stored_twice_along_a_seam_are_found_in_any_unit(make, kind, size):
    points, [(kind, nodes)] = make(kind=kind)
    left = points[nodes].mean(axis=1)[:, 0] < 0.5
    moved = nodes.copy()
    moved[~left] += len(points)
    noise = np.random.default_rng(0).uniform(-1e-8, 1e-8, points.shape)
    both = size * np.vstack([points, points + noise])
    first = soundness.coincident(both, [(kind, moved)])
    seam = np.intersect1d(nodes[left], nodes[~left])
    doubled = np.flatnonzero(first != np.arange(len(both)))
    assert np.array_equal(doubled, seam + len(points))
    assert np.array_equal(first[doubled], seam)
    assert soundness.pieces(len(both), [(kind, moved)])[0] == 2
    assert soundness.pieces(len(both), [(kind, first[moved])])[0] == 1


@pytest.mark.parametrize("make, kind", MESHES[:3])  # a hexahedron is inverted first
def test_a_node_moved_past_its_neighbours_folds_the_mesh(make, kind):
    points, blocks = make(kind=kind)
    inner = np.abs(points - 0.5).max(axis=1).argmin()
    points[inner] += 0.8
    cells, why = soundness.overlaps(points, blocks)
    assert "same side" in why and len(cells) >= 1


@pytest.mark.parametrize("make, kind", MESHES)
def test_a_cell_given_twice_overlaps(make, kind):
    points, [(kind, nodes)] = make(kind=kind)
    centre = np.abs(points[nodes].mean(axis=1) - 0.5).max(axis=1).argmin()
    found = soundness.overlaps(points, [(kind, np.vstack([nodes, nodes[centre : centre + 1]]))])
    assert found is not None


def test_an_extra_cell_on_an_inner_edge_overlaps():
    points, [(kind, nodes)] = square()
    extra = np.array([[6, 7, 18]])
    cells, why = soundness.overlaps(points, [(kind, np.vstack([nodes, extra]))])
    assert len(nodes) in cells and "more than two" in why


def test_mixed_kinds_of_cells_share_their_sides():
    points, [(_, quads)] = square(kind="quad")
    triangles = np.vstack([quads[:4][:, [0, 1, 2]], quads[:4][:, [0, 2, 3]]])
    blocks = [("triangle", triangles), ("quad", quads[4:])]
    assert soundness.overlaps(points, blocks) is None
    assert soundness.pieces(len(points), blocks)[0] == 1


def test_a_field_in_random_order_is_rough_and_a_smooth_one_is_not():
    points, blocks = square(12)
    ends = soundness.edges(blocks)
    smooth = np.column_stack([np.sin(points[:, 0]), points[:, 1] ** 2])
    assert soundness.roughness(smooth, ends) < 0.05
    shuffled = np.random.default_rng(0).permutation(smooth)
    assert 0.7 < soundness.roughness(shuffled, ends) < 1.3
    assert soundness.roughness(np.ones_like(smooth), ends) == 0


@settings(max_examples=40, deadline=None)
@given(
    make=st.sampled_from(MESHES),
    parts=st.integers(2, 4),
    seed=st.integers(0, 10**6),
    shift=st.floats(-1e3, 1e3),
    size=st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_a_mesh_cut_into_any_parts_is_one_again(make, parts, seed, shift, size):
    """Each part has nodes of its own, in any order; together they are the mesh before."""
    points, [(kind, nodes)] = make[0](kind=make[1])
    random = np.random.default_rng(seed)
    part = random.integers(parts, size=len(nodes))
    places, cells, start = [], np.empty_like(nodes), 0
    for number in np.unique(part):
        used, renamed = np.unique(nodes[part == number], return_inverse=True)
        order = random.permutation(len(used))
        places.append(points[used[order]])
        cells[part == number] = start + np.argsort(order)[renamed.reshape(-1, nodes.shape[1])]
        start += len(used)
    scattered = size * (np.concatenate(places) + shift)
    first = soundness.coincident(scattered, [(kind, cells)])
    assert len(np.unique(first[cells])) == len(np.unique(nodes))
    merged = [(kind, first[cells])]
    assert soundness.pieces(len(scattered), merged)[0] == 1
    assert soundness.overlaps(scattered, merged) is None
    assert np.allclose(scattered[first], scattered, atol=1e-4 * size)
