"""Planar segmentations become triangles that keep labels, borders and angles."""

import numpy as np
import pytest
from elastoidentify import identify
from elastoidentify.errors import Cancelled, InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.meshing.quality import triangle_angles, triangle_areas
from elastoidentify.imaging.phantom import Inclusion, make_phantom
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial import cKDTree


def grid(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the x and y of every voxel centre."""
    y, x = np.mgrid[:rows, :columns].astype(float)
    return x, y


def blob_radii(angle: np.ndarray) -> list[np.ndarray]:
    """Return the radii of four nested blobs at an angle."""
    return [
        210 + 18 * np.cos(3 * angle),
        155 + 14 * np.cos(5 * angle + 0.4),
        100 + 12 * np.cos(4 * angle + 1.0),
        50 + 7 * np.cos(3 * angle + 2.0),
    ]


def nested_blobs() -> np.ndarray:
    """Return 512 × 512 voxels with the four blobs as labels 1 to 4 around (256, 256)."""
    x, y = grid(512, 512)
    radius = np.hypot(x - 256, y - 256)
    return sum((radius < r).astype(int) for r in blob_radii(np.arctan2(y - 256, x - 256)))


def wheel(parts: int) -> np.ndarray:
    """Return a disc of equal sectors that meet in one point between the voxels."""
    x, y = grid(200, 200)
    turn = (np.arctan2(y - 99.5, x - 99.5) / (2 * np.pi)) % 1
    return np.where(np.hypot(x - 99.5, y - 99.5) < 90, (turn * parts).astype(int) + 1, 0)


def cells_of_voronoi(count: int) -> np.ndarray:
    """Return a disc cut into the regions nearest to random points."""
    x, y = grid(200, 200)
    seeds = np.random.default_rng(0).uniform(20, 180, (count, 2))
    nearest = np.hypot(x[..., None] - seeds[:, 0], y[..., None] - seeds[:, 1]).argmin(axis=2)
    return np.where(np.hypot(x - 100, y - 100) < 95, nearest + 1, 0)


def layered_block() -> np.ndarray:
    """Return a pad (3) on tissue (1) with a round inclusion (2), on a wider floor (4)."""
    x, y = grid(200, 160)
    labels = np.zeros((200, 160), int)
    labels[20:60, 20:140] = 3
    labels[60:150, 20:140] = 1
    labels[150:170, 10:150] = 4
    labels[np.hypot(x - 80, y - 100) < 18] = 2
    return labels


def mesh(labels: np.ndarray, edge: float, **options):
    return mesh_segmentation(Image(labels), edge, **options)


def flat(result) -> np.ndarray:
    return result.points[:, :2]


def areas(result) -> dict[int, float]:
    size = triangle_areas(flat(result), result.cells)
    return {int(k): float(size[result.labels == k].sum()) for k in np.unique(result.labels)}


def smallest_angle(result) -> float:
    return float(triangle_angles(result.points, result.cells).min())


def edges_and_uses(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def euler_number(result) -> int:
    """Return nodes − edges + cells: the pieces less the holes of a conforming mesh."""
    edges, _ = edges_and_uses(result.cells)
    return len(result.points) - len(edges) + len(result.cells)


def border_nodes(result, one: int, other: int) -> np.ndarray:
    """Return the nodes that two labels share; 0 stands for the outside."""
    if other == 0:
        edges, uses = edges_and_uses(result.cells)
        rim = np.unique(edges[uses == 1])
        return np.intersect1d(rim, result.cells[result.labels == one])
    return np.intersect1d(result.cells[result.labels == one], result.cells[result.labels == other])


def check_conforming(result):
    """No triangle is inverted, every node is used, and no edge has more than two triangles.

    A rim edge has one. Where triangles overlapped or left gaps, an inner edge would be a rim edge
    too, which the Euler number and the areas in the tests below would show.
    """
    assert (triangle_areas(flat(result), result.cells) > 0).all()
    assert np.array_equal(np.unique(result.cells), np.arange(len(result.points)))
    _, uses = edges_and_uses(result.cells)
    assert uses.max() <= 2


def test_nested_blobs_keep_area_borders_and_angles():
    result = mesh(nested_blobs(), 6.0)
    check_conforming(result)
    assert result.notes[:-1] == []  # the last note says that nothing outside touches the mesh
    assert smallest_angle(result) >= 25
    turn = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    discs = [np.mean(r**2) * np.pi for r in blob_radii(turn)] + [0.0]
    for label in range(1, 5):
        exact = discs[label - 1] - discs[label]
        assert areas(result)[label] == pytest.approx(exact, rel=0.01)
        x, y = flat(result)[border_nodes(result, label, label - 1)].T - 256
        error = np.hypot(x, y) - blob_radii(np.arctan2(y, x))[label - 1]
        assert np.abs(error).max() < 1.0
        assert np.sqrt(np.mean(error**2)) < 0.3
    assert euler_number(result) == 1


def test_every_edge_between_two_labels_lies_on_their_border():
    result = mesh(nested_blobs(), 6.0)
    edges = np.sort(result.cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(result.labels, 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    twin = (edges[1:] == edges[:-1]).all(axis=1)
    between = twin & (owner[1:] != owner[:-1])
    assert between.sum() > 200
    assert (np.abs(np.diff(owner.astype(int)))[between] == 1).all()  # nested: neighbours only
    middle = flat(result)[edges[1:][between]].mean(axis=1) - 256
    radii = np.array(blob_radii(np.arctan2(middle[:, 1], middle[:, 0])))
    border = np.maximum(owner[1:], owner[:-1])[between] - 1
    error = np.hypot(*middle.T) - radii[border, np.arange(len(border))]
    assert np.abs(error).max() < 1.0


@pytest.mark.parametrize(
    ("labels", "edge"),
    [
        (wheel(12), 8.0),
        (cells_of_voronoi(12), 8.0),
        (layered_block(), 8.0),
        (np.ones((64, 64), int), 6.0),
    ],
    ids=["twelve sectors", "twelve cells", "layered block", "full image"],
)
def test_junctions_keep_good_angles_and_the_area_of_every_label(labels, edge):
    result = mesh(labels, edge)
    check_conforming(result)
    assert smallest_angle(result) >= 25
    for label, area in areas(result).items():
        assert area == pytest.approx((labels == label).sum(), rel=0.01)
    assert euler_number(result) == 1


def test_a_ring_of_half_the_edge_length_stays_whole():
    x, y = grid(200, 200)
    radius = np.hypot(x - 100.3, y - 99.6)
    labels = (radius < 80).astype(int)
    labels[(radius > 40) & (radius < 43)] = 2
    result = mesh(labels, 6.0)
    check_conforming(result)
    assert smallest_angle(result) >= 25
    assert areas(result)[2] == pytest.approx(np.pi * (43**2 - 40**2), rel=0.01)
    ring = result.cells[result.labels == 2]
    edges, _ = edges_and_uses(ring)
    assert len(np.unique(ring)) - len(edges) + len(ring) == 0  # one piece, one hole


def test_a_layer_of_a_fifth_of_the_edge_length_stays_straight_and_whole():
    labels = np.zeros((200, 200), int)
    labels[10:190, 10:190] = 1
    labels[100:102, 10:190] = 2
    result = mesh(labels, 10.0)
    check_conforming(result)
    assert smallest_angle(result) >= 25
    assert areas(result)[2] == pytest.approx(360, abs=1e-6)
    layer = flat(result)[np.unique(result.cells[result.labels == 2])]
    assert np.isin(layer[:, 1].round(6), [99.5, 101.5]).all()


def longest_edges(result) -> np.ndarray:
    corners = result.points[result.cells]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)


def test_edges_grow_away_from_borders_and_borders_stay_as_they_are():
    even, graded = mesh(nested_blobs(), 6.0), mesh(nested_blobs(), 6.0, grading=4)
    check_conforming(graded)
    assert len(graded.cells) < 0.5 * len(even.cells)
    assert smallest_angle(graded) >= 25
    assert euler_number(graded) == euler_number(even)
    for label, area in areas(even).items():
        assert areas(graded)[label] == pytest.approx(area, rel=1e-3)
    length, centre = longest_edges(graded), flat(graded)[graded.cells].mean(axis=1)
    nodes = [border_nodes(graded, one, other) for one, other in ((1, 0), (2, 1), (3, 2), (4, 3))]
    distance = cKDTree(flat(graded)[np.concatenate(nodes)]).query(centre)[0]
    assert length[distance < 3].max() < 12
    assert np.median(length[distance > 20]) > 12
    assert length.max() < 30


def test_graded_cells_tell_the_modulus_of_a_label():
    phantom = make_phantom(
        inclusions=[Inclusion(0.5, 0.5, 0.12, 3.0)], width=208, elements=40, noise=0
    )
    found = {}
    for grading in (1, 4):
        one = mesh_segmentation(
            phantom.segmentation, 5.0, grading=grading, rigid_labels=phantom.rigid_labels
        )
        u = phantom.displacements(one.points)
        u += 1e-3 * np.abs(u).max() * np.random.default_rng(0).standard_normal(u.shape)
        known = [[5000.0, 0.45] if label == 1 else [np.nan] * 2 for label in one.labels]
        result = identify(
            one.points, one.cells, u[..., :2], known, labels=one.labels, grouping="label",
            method="regularized", unknowns="young", poisson_ratio=0.45, refine=1,
            reaction_nodes=one.reaction_nodes,
        )  # fmt: skip
        young = {label: np.median(result.young[one.labels == label]) for label in (2, 3)}
        found[grading] = len(one.cells), young
    assert found[4][0] < 0.5 * found[1][0]
    for label, true in ((2, 3000), (3, 9000)):
        assert found[4][1][label] == pytest.approx(true, rel=0.05), found


def test_a_hole_is_left_open():
    x, y = grid(120, 120)
    labels = np.ones((120, 120), int)
    labels[np.hypot(x - 60, y - 50) < 20] = 0
    result = mesh(labels, 8.0)
    check_conforming(result)
    assert euler_number(result) == 0
    assert areas(result)[1] == pytest.approx(120**2 - np.pi * 20**2, rel=0.005)
    assert np.hypot(*(flat(result) - [60, 50]).T).min() > 19


def test_a_block_keeps_its_straight_borders_and_corners_exactly():
    labels = np.zeros((100, 120), int)
    labels[20:50, 15:105] = 2
    labels[50:90, 15:105] = 1
    result = mesh(labels, 9.0)
    check_conforming(result)
    assert areas(result)[1] == pytest.approx(90 * 40, abs=1e-6)
    assert areas(result)[2] == pytest.approx(90 * 30, abs=1e-6)
    for corner in ((14.5, 19.5), (104.5, 19.5), (14.5, 89.5), (104.5, 89.5), (14.5, 49.5)):
        assert np.abs(flat(result) - corner).sum(axis=1).min() < 1e-6
    shared = flat(result)[border_nodes(result, 1, 2)]
    assert np.allclose(shared[:, 1], 49.5, atol=1e-6)


def test_a_corner_close_to_a_junction_stays():
    labels = np.zeros((100, 120), int)
    labels[20:80, 20:100] = 1
    labels[20:29, 91:100] = 2
    labels[68:80, 20:28] = 2
    result = mesh(labels, 12.0)
    check_conforming(result)
    for corner in ((99.5, 19.5), (90.5, 28.5), (19.5, 79.5), (27.5, 67.5)):
        assert np.abs(flat(result) - corner).sum(axis=1).min() < 1e-6
    assert sum(areas(result).values()) == pytest.approx(60 * 80, abs=1e-6)


def test_the_corners_of_an_oblique_block_are_found():
    x, y = grid(200, 200)
    turn = np.deg2rad(30)
    along = (x - 100) * np.cos(turn) + (y - 100) * np.sin(turn)
    across = -(x - 100) * np.sin(turn) + (y - 100) * np.cos(turn)
    result = mesh(((np.abs(along) < 60) & (np.abs(across) < 40)).astype(int), 8.0)
    check_conforming(result)
    assert smallest_angle(result) >= 25
    assert areas(result)[1] == pytest.approx(120 * 80, rel=0.005)
    for a, b in ((60, 40), (60, -40), (-60, 40), (-60, -40)):
        corner = 100 + np.array(
            [a * np.cos(turn) - b * np.sin(turn), a * np.sin(turn) + b * np.cos(turn)]
        )
        assert np.linalg.norm(flat(result) - corner, axis=1).min() < 1.0


def test_labels_at_the_image_border_reach_the_outer_voxel_edges():
    labels = np.ones((60, 80), int)
    labels[:20] = 2
    labels[40:, :30] = 0
    image = Image(labels, [5.0, -3.0, 2.0], [0.5, 0.5, 3.0])
    result = mesh_segmentation(image, 3.0)
    check_conforming(result)
    index = image.world_to_index(result.points)
    assert np.allclose(index.min(axis=0), [-0.5, -0.5, 0])
    assert np.allclose(index.max(axis=0), [79.5, 59.5, 0])
    for corner in ((-0.5, -0.5), (79.5, -0.5), (79.5, 59.5), (29.5, 59.5), (-0.5, 19.5)):
        assert np.abs(index[:, :2] - corner).sum(axis=1).min() < 1e-6
    assert areas(result)[1] == pytest.approx((labels == 1).sum() * 0.25, rel=1e-6)
    assert areas(result)[2] == pytest.approx((labels == 2).sum() * 0.25, rel=1e-6)


def rotation(*angles: float) -> np.ndarray:
    """Return a rotation about x, y, z in turn (radians)."""
    result = np.eye(3)
    for axis, angle in enumerate(angles):
        i, j = (k for k in range(3) if k != axis)
        turn = np.eye(3)
        turn[[i, j], [i, j]] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        result = turn @ result
    return result


def test_an_oblique_anisotropic_image_gives_the_mesh_of_the_upright_one():
    labels, spacing = layered_block(), [0.5, 0.8, 4.0]
    options = {"rigid_labels": [4], "border_reactions": True}
    upright = mesh_segmentation(Image(labels, np.zeros(3), spacing), 6.0, **options)
    turn, origin = rotation(0.4, -0.3, 0.2), np.array([12.0, -40.0, 7.0])
    oblique = mesh_segmentation(Image(labels, origin, spacing, turn), 6.0, **options)
    assert np.array_equal(oblique.cells, upright.cells)
    assert np.array_equal(oblique.labels, upright.labels)
    assert np.array_equal(oblique.reaction_nodes, upright.reaction_nodes)
    assert np.allclose(oblique.points, upright.points @ turn.T + origin, atol=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slice_along_any_axis_gives_the_same_mesh_in_its_plane(axis):
    labels = layered_block()
    upright = mesh(labels, 8.0)
    turned = mesh_segmentation(Image(np.expand_dims(labels, 2 - axis)), 8.0)
    along = [k for k in range(3) if k != axis]
    assert np.allclose(turned.points[:, along], upright.points[:, :2])
    assert np.allclose(turned.points[:, axis], 0)
    corners = turned.points[turned.cells]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, axis] > 0).all()


def test_a_mirrored_image_has_no_inverted_triangle():
    image = Image(layered_block(), direction=np.diag([1.0, -1.0, 1.0]))
    check_conforming(mesh_segmentation(image, 8.0))


def test_the_edge_length_is_in_world_units_in_every_direction():
    x, y = grid(100, 300)
    labels = (np.hypot((x - 150) * 0.2, (y - 50) * 0.6) < 25).astype(int)
    result = mesh_segmentation(Image(labels, np.zeros(3), [0.2, 0.6, 1.0]), 3.0)
    check_conforming(result)
    assert smallest_angle(result) >= 25
    assert areas(result)[1] == pytest.approx(np.pi * 25**2, rel=0.01)
    edges, _ = edges_and_uses(result.cells)
    step = np.diff(result.points[edges], axis=1)[:, 0]
    length = np.linalg.norm(step, axis=1)
    assert 2.5 < length.mean() < 3.5
    flat_edges = np.abs(step[:, 0]) > np.abs(step[:, 1])
    assert length[flat_edges].mean() == pytest.approx(length[~flat_edges].mean(), rel=0.1)


def test_islands_and_holes_smaller_than_a_cell_go_and_are_told():
    labels = np.ones((80, 80), int)
    labels[10:12, 10:12] = 2
    labels[30, 30] = labels[50, 20] = 0
    labels[50:70, 40:70] = 5
    result = mesh(labels, 8.0)
    check_conforming(result)
    assert set(result.labels.tolist()) == {1, 5}
    assert euler_number(result) == 1
    assert any("1 island of label 2" in note for note in result.notes)
    assert any("2 holes" in note for note in result.notes)


def test_pure_noise_is_refused_with_the_way_to_mend_it():
    noise = np.random.default_rng(0).integers(0, 4, (64, 64))
    with pytest.raises(InputError, match="smooth the segmentation") as error:
        mesh(noise, 6.0)
    assert "\n" not in str(error.value)


def test_an_island_at_the_surface_leaves_no_notch():
    labels = np.zeros((80, 80), int)
    labels[10:70, 10:70] = 1
    labels[40:44, 10:13] = 2  # at the left side
    labels[10:13, 10:13] = 3  # in a corner
    labels[2:4, 40:42] = 4  # in the air
    result = mesh(labels, 8.0)
    assert set(result.labels.tolist()) == {1}
    assert areas(result)[1] == pytest.approx(60**2, abs=1e-6)


def test_a_sharp_junction_is_told_where_it_is():
    x, y = grid(160, 160)
    labels = np.where((x > 20) & (x < 140) & (y > 20) & (y < 140), 1, 0)
    labels[(labels > 0) & (np.abs(y - 80) < 0.1 * (x - 30))] = 2
    result = mesh(labels, 8.0)
    check_conforming(result)
    assert smallest_angle(result) < 25
    (note,) = [note for note in result.notes if "have an angle below 25°" in note]
    assert f"smallest {smallest_angle(result):.1f}°" in note


def test_border_nodes_are_reaction_nodes_and_free_surfaces_are_not():
    labels = np.zeros((60, 80), int)
    labels[20:, :] = 1
    result = mesh(labels, 8.0)
    x, y = flat(result).T
    at_border = np.isclose(x, -0.5) | np.isclose(x, 79.5) | np.isclose(y, 59.5)
    assert np.array_equal(result.reaction_nodes == 1, at_border)
    top = np.isclose(y, 19.5) & ~at_border
    assert top.sum() > 5
    free = mesh(labels, 8.0, border_reactions=False)
    assert not free.reaction_nodes.any()
    assert any("No node is a reaction node" in note for note in free.notes)


def test_rigid_labels_get_no_cell_and_hold_the_nodes_they_share():
    whole = mesh(layered_block(), 8.0)
    result = mesh(layered_block(), 8.0, rigid_labels=[4])
    check_conforming(result)
    assert set(result.labels.tolist()) == {1, 2, 3}
    held = flat(result)[result.reaction_nodes == 1]
    assert np.allclose(held[:, 1], 149.5, atol=1e-6)
    assert np.allclose(sorted(held[:, 0])[:: len(held) - 1], [19.5, 139.5], atol=1e-6)
    assert len(held) == len(border_nodes(whole, 1, 4))


def test_a_rigid_label_that_touches_nothing_is_told():
    labels = np.zeros((80, 80), int)
    labels[10:40, 10:70], labels[50:70, 10:70] = 1, 2
    notes = mesh(labels, 8.0, rigid_labels=[2]).notes
    assert "Rigid label 2 touches no other label: it holds no node." in notes


def test_boxes_hold_the_nodes_inside_them():
    image = Image(layered_block(), [100.0, 0.0, -5.0])
    boxes = [(119, 240, 19, 20), (119, 125, 20, 60, -6, -4), (119, 125, 20, 60, 0, 4)]
    result = mesh_segmentation(image, 8.0, reaction_boxes=boxes, border_reactions=False)
    x, y = flat(result).T
    expected = (np.isclose(y, 19.5)) | ((x <= 125) & (y >= 20) & (y <= 60))
    assert np.array_equal(result.reaction_nodes == 1, expected)
    assert "Reaction box 3 holds no node of the mesh." in result.notes


def half(labels: np.ndarray) -> np.ndarray:
    return labels + 0.5


def holed(labels: np.ndarray) -> np.ndarray:
    return np.where(labels == 1, np.nan, labels)


BLOCK = layered_block()
SPECK = np.pad(np.full((3, 3), 2), 12, constant_values=1)  # label 2 is smaller than a cell


@pytest.mark.parametrize(
    ("labels", "edge", "options", "message"),
    [
        (np.zeros((20, 20), int), 4.0, {}, "no label above 0"),
        (-BLOCK, 8.0, {}, "negative labels"),
        (half(BLOCK), 8.0, {}, "fractional values"),
        (holed(BLOCK), 8.0, {}, "not finite"),
        (BLOCK.astype(complex), 8.0, {}, "type complex128"),
        (BLOCK * 2**40, 8.0, {}, "too large"),
        (BLOCK, 0.0, {}, "edge length is 0"),
        (BLOCK, -3.0, {}, "edge length is -3"),
        (BLOCK, np.nan, {}, "edge length is nan"),
        (BLOCK, np.inf, {}, "edge length is inf"),
        (BLOCK, "six", {}, "edge length is six"),
        (BLOCK, 500.0, {}, "larger than every label: use less than"),
        (BLOCK, 0.01, {}, "cells: use .* or more"),
        (BLOCK, 8.0, {"rigid_labels": [9]}, "rigid label 9 is not in .* labels 1, 2, 3, 4"),
        (BLOCK, 8.0, {"rigid_labels": [1, 2, 3, 4]}, "all labels are rigid"),
        (SPECK, 8.0, {"rigid_labels": [1]}, "only rigid labels are large enough"),
        (BLOCK, 8.0, {"reaction_boxes": [(0, 1, 2)]}, "reaction box 1 .* give x0,x1,y0,y1"),
        (BLOCK, 8.0, {"reaction_boxes": [(0, 1, 5, 2)]}, "lower bound must come before"),
        (BLOCK, 8.0, {"reaction_boxes": [(0, 1, 2, 3), (0, np.nan, 2, 3)]}, "reaction box 2"),
        (BLOCK, 8.0, {"reaction_boxes": (0, 1, 2, 3)}, "reaction box 1"),
    ],
)
def test_bad_input_stops_with_one_line(labels, edge, options, message):
    with pytest.raises(InputError, match=message) as stopped:
        mesh(labels, edge, **options)
    assert "\n" not in str(stopped.value)


def test_a_voxel_without_size_stops_with_one_line():
    for spacing in ([0, 1, 1], [1, np.nan, 1], [1, 1, -1]):
        with pytest.raises(InputError, match="has the voxel spacing"):
            mesh_segmentation(Image(BLOCK, np.zeros(3), spacing), 8.0)


@pytest.mark.parametrize("kind", [bool, np.uint8, np.int16, np.uint16, np.float32])
def test_every_type_of_whole_numbers_is_a_labelmap(kind):
    labels = (layered_block() > 0).astype(kind)
    result = mesh(labels, 8.0)
    assert result.labels.dtype == np.int32
    assert set(result.labels.tolist()) == {1}
    assert result.reaction_nodes.dtype == np.uint8


def test_progress_rises_to_the_end_and_can_cancel():
    seen = []
    mesh(layered_block(), 8.0, progress=lambda fraction, text: seen.append((fraction, text)))
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0
    assert fractions[-1] == 1
    assert all(text for _, text in seen)

    def cancel(fraction, text):
        if fraction > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        mesh(layered_block(), 8.0, progress=cancel)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    smoothness=st.floats(3.0, 8.0),
    edge=st.floats(5.0, 12.0),
    touching=st.booleans(),
)
def test_ragged_labels_of_any_shape_give_a_conforming_mesh(seed, smoothness, edge, touching):
    random = np.random.default_rng(seed)
    fields = ndimage.gaussian_filter(random.normal(size=(3, 90, 90)), (0, smoothness, smoothness))
    labels = fields.argmax(axis=0) + (0 if touching else 1)
    if not touching:
        labels = np.pad(labels, 5)
    result = mesh(labels, edge)
    check_conforming(result)
    told = any("angle below" in note for note in result.notes)
    assert told == (smallest_angle(result) < 25)
    if not any("given to the labels around" in note for note in result.notes):
        for label, area in areas(result).items():
            if any(f"area of label {label}" in note for note in result.notes):
                continue
            assert area == pytest.approx((labels == label).sum(), rel=0.03)
