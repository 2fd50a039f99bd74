"""Labelled volumes become tetrahedra that keep labels, volumes and angles."""

import numpy as np
import pytest
from elastoidentify.errors import Cancelled
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.meshing.lattice import body_centred_lattice
from elastoidentify.imaging.meshing.quality import dihedral_angles, tetrahedron_volumes


def grid(*shape: int) -> tuple[np.ndarray, ...]:
    """Return the x, y, z of every voxel centre."""
    z, y, x = np.mgrid[tuple(slice(n) for n in shape)].astype(float)
    return x, y, z


def nested_blobs() -> np.ndarray:
    """Return 128³ voxels with four nested smooth blobs as labels 1 to 4."""
    x, y, z = (axis - 63.5 for axis in grid(128, 128, 128))
    radius = np.sqrt(x * x + y * y + z * z)
    corner, saddle = x * y * z / radius**3, (x**2 - y**2) / radius**2
    radii = (54 + 18 * corner + 3 * saddle, 41 + 4 * saddle, 28 + 12 * corner, 14 + 2 * saddle)
    return sum((radius < r).astype(int) for r in radii)


def layered_block() -> np.ndarray:
    """Return a block in air: pad (3) on tissue (1) with a round inclusion (2)."""
    x, y, z = grid(48, 60, 64)
    labels = np.zeros((48, 60, 64), int)
    block = (x > 8) & (x < 56) & (y > 10) & (y < 50) & (z > 4) & (z < 44)
    labels[block] = 1
    labels[block & (z >= 34)] = 3
    labels[np.sqrt((x - 32) ** 2 + (y - 30) ** 2 + (z - 19) ** 2) < 9] = 2
    return labels


def seeds(count: int) -> np.ndarray:
    """Return a full volume cut into the regions nearest to random points."""
    x, y, z = grid(48, 48, 48)
    places = np.random.default_rng(0).uniform(0, 48, (count, 3))
    distance = sum((axis[..., None] - places[:, k]) ** 2 for k, axis in enumerate((x, y, z)))
    return distance.argmin(axis=-1) + 1


def volumes(result) -> dict[int, float]:
    size = tetrahedron_volumes(result.points, result.cells)
    return {int(k): float(size[result.labels == k].sum()) for k in np.unique(result.labels)}


def faces_and_uses(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]
    faces = np.sort(cells[:, corners].reshape(-1, 3), axis=1)
    return np.unique(faces, axis=0, return_counts=True)


def check_conforming(result):
    """No tetrahedron is inverted, every node is used, and the rim is closed.

    No face has more than two cells; those with one form a surface without an edge of its own: each
    of its edges has an even number of faces.
    """
    assert (tetrahedron_volumes(result.points, result.cells) > 0).all()
    assert np.array_equal(np.unique(result.cells), np.arange(len(result.points)))
    faces, uses = faces_and_uses(result.cells)
    assert uses.max() <= 2
    rim = faces[uses == 1]
    edges = rim[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)
    assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()


def check_volumes(result, labels, voxel=1.0, within=0.03):
    for label, volume in volumes(result).items():
        count = (labels == label).sum()
        if count > 1000:
            assert volume == pytest.approx(count * voxel, rel=within), label


@pytest.mark.parametrize("edge", [5.0, 8.0])
def test_nested_blobs_keep_volume_borders_and_angles(edge):
    labels = nested_blobs()
    result = mesh_segmentation(Image(labels), edge)
    check_conforming(result)
    assert dihedral_angles(result.points, result.cells).min() >= 10
    check_volumes(result, labels)
    inner = np.unique(result.cells[result.labels == 4])
    shared = result.points[np.intersect1d(inner, result.cells[result.labels == 3])] - 63.5
    radius = np.linalg.norm(shared, axis=1)
    exact = 14 + 2 * (shared[:, 0] ** 2 - shared[:, 1] ** 2) / radius**2
    assert np.abs(radius - exact).max() < 0.4 * edge
    assert np.sqrt(np.mean((radius - exact) ** 2)) < 0.15 * edge


def test_edges_have_the_length_asked_for():
    result = mesh_segmentation(Image(np.ones((40, 40, 40), int)), 5.0)
    pairs = result.cells[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    length = np.linalg.norm(
        np.diff(result.points[np.unique(np.sort(pairs), axis=0)], axis=1), axis=2
    )
    assert length.mean() == pytest.approx(5.0, rel=0.1)


def ball_in_a_block() -> np.ndarray:
    """Return a pad (3) on tissue (1) with a small ball (2): a body that fills the image."""
    x, y, z = grid(64, 64, 64)
    ball = (x - 31.5) ** 2 + (y - 31.5) ** 2 + (z - 30) ** 2 < 8**2
    return np.where(z >= 54, 3, np.where(ball, 2, 1))


def test_edges_grow_away_from_borders():
    even = mesh_segmentation(Image(ball_in_a_block()), 3.0)
    graded = mesh_segmentation(Image(ball_in_a_block()), 3.0, grading=4)
    check_conforming(graded)
    assert len(graded.cells) < 0.5 * len(even.cells)
    assert dihedral_angles(graded.points, graded.cells).min() >= 12
    for label, volume in volumes(even).items():
        assert volumes(graded)[label] == pytest.approx(volume, rel=0.01)
    inner = [(mesh.labels == 2).sum() for mesh in (even, graded)]
    assert inner[1] > 0.9 * inner[0]
    largest = tetrahedron_volumes(graded.points, graded.cells).max()
    assert largest > 30 * np.median(tetrahedron_volumes(even.points, even.cells))


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_cubes_of_all_sizes_fill_the_block_without_a_gap(levels):
    """Random room, planes within the block, sides that no cube divides."""
    random = np.random.default_rng(levels)
    planes = [np.array([0, 11.0, 49.0]), np.array([0, 26.0]), np.array([-3.0, 25.0])]
    places = random.uniform([0, 0, -3], [49, 26, 25], (3, 3))

    def room(x):
        return 3 * np.linalg.norm(x[:, None] - places, axis=2).min(axis=1)

    points, cells = body_centred_lattice(planes, 1.0, room, levels)
    size = tetrahedron_volumes(points, cells)
    assert size.sum() == pytest.approx(49 * 26 * 28, rel=1e-12)
    assert size.max() / size.min() >= 0.9 * 8**levels
    angles = dihedral_angles(points, cells)
    assert angles.min() > 44.9 and angles.max() < 120.1
    faces, uses = faces_and_uses(cells)
    rim = points[faces[uses == 1]]
    low, high = points.min(axis=0), points.max(axis=0)
    flat = ((rim == low) | (rim == high)).all(axis=1).any(axis=1)
    assert uses.max() == 2 and flat.all()
    assert not ((points[cells] < 11).any(axis=1) & (points[cells] > 11).any(axis=1))[:, 0].any()


def test_many_labels_that_meet_everywhere():
    labels = seeds(12)
    result = mesh_segmentation(Image(labels), 5.0)
    check_conforming(result)
    assert dihedral_angles(result.points, result.cells).min() >= 10
    check_volumes(result, labels)
    assert sum(volumes(result).values()) == pytest.approx(48**3, rel=1e-9)


def test_a_block_in_air_keeps_its_faces_edges_and_corners():
    labels = layered_block()
    result = mesh_segmentation(Image(labels), 5.0)
    check_conforming(result)
    assert dihedral_angles(result.points, result.cells).min() >= 10
    check_volumes(result, labels)
    low, high = np.array([8.5, 10.5, 4.5]), np.array([55.5, 49.5, 43.5])
    assert np.allclose(result.points.min(axis=0), low)
    assert np.allclose(result.points.max(axis=0), high)
    assert sum(volumes(result).values()) == pytest.approx((high - low).prod(), rel=1e-9)
    top = np.unique(result.cells[result.labels == 3])
    shared = result.points[np.intersect1d(top, result.cells[result.labels == 1])]
    assert len(shared) > 50
    assert np.allclose(shared[:, 2], 33.5, atol=1e-6)


def test_a_block_on_a_wider_floor_keeps_the_corners_and_volumes_of_both():
    labels = layered_block()
    labels[labels == 2] = 1
    labels[1:5, 6:54, 5:60] = 4
    result = mesh_segmentation(Image(labels), 5.0)
    check_conforming(result)
    assert dihedral_angles(result.points, result.cells).min() >= 10
    for label, volume in volumes(result).items():
        assert volume == pytest.approx((labels == label).sum(), rel=1e-6)
    for corner in ((4.5, 5.5, 0.5), (59.5, 53.5, 4.5), (8.5, 49.5, 4.5), (55.5, 10.5, 33.5)):
        assert np.linalg.norm(result.points - corner, axis=1).min() < 1e-6


def test_a_flat_layer_of_a_third_of_the_edge_length_stays_whole():
    labels = np.ones((30, 40, 40), int)
    labels[14:16] = 2
    result = mesh_segmentation(Image(labels), 6.0)
    check_conforming(result)
    assert dihedral_angles(result.points, result.cells).min() >= 10
    assert volumes(result)[2] == pytest.approx(2 * 40 * 40, rel=1e-9)


def test_a_block_that_fills_the_image_reaches_the_outer_voxel_edges():
    image = Image(np.ones((20, 30, 25), int), [4.0, 5.0, 6.0], [2.0, 1.0, 1.5])
    result = mesh_segmentation(image, 6.0)
    check_conforming(result)
    index = image.world_to_index(result.points)
    assert np.allclose(index.min(axis=0), -0.5)
    assert np.allclose(index.max(axis=0), [24.5, 29.5, 19.5])
    assert volumes(result)[1] == pytest.approx(15_000 * 3.0, rel=1e-9)
    faces, uses = faces_and_uses(result.cells)
    assert np.array_equal(np.flatnonzero(result.reaction_nodes), np.unique(faces[uses == 1]))


def test_an_oblique_anisotropic_volume_gives_the_mesh_of_the_upright_one():
    labels, spacing = layered_block()[::2], np.array([0.8, 0.7, 1.6])
    upright = mesh_segmentation(Image(labels, np.zeros(3), spacing), 5.0)
    check_conforming(upright)
    check_volumes(upright, labels, spacing.prod())
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    origin = np.array([30.0, -20.0, 11.0])
    oblique = mesh_segmentation(Image(labels, origin, spacing, turn), 5.0)
    assert np.array_equal(oblique.cells, upright.cells)
    assert np.array_equal(oblique.labels, upright.labels)
    assert np.array_equal(oblique.reaction_nodes, upright.reaction_nodes)
    assert np.allclose(oblique.points, upright.points @ turn.T + origin, atol=1e-9)


def test_a_mirrored_volume_has_no_inverted_cell():
    image = Image(layered_block(), direction=np.diag([1.0, -1.0, 1.0]))
    check_conforming(mesh_segmentation(image, 6.0))


def test_a_hole_is_left_open():
    x, y, z = grid(40, 40, 40)
    labels = (np.sqrt((x - 20) ** 2 + (y - 20) ** 2 + (z - 20) ** 2) > 10).astype(int)
    result = mesh_segmentation(Image(labels), 4.0)
    check_conforming(result)
    check_volumes(result, labels)
    assert np.linalg.norm(result.points - 20, axis=1).min() > 8.5


def test_small_islands_go_and_are_told():
    labels = layered_block()
    labels[20, 20, 20] = 9
    result = mesh_segmentation(Image(labels), 5.0)
    assert set(result.labels.tolist()) == {1, 2, 3}
    assert any("1 island of label 9" in note for note in result.notes)


def test_a_shell_too_thin_for_the_edge_length_is_told():
    x, y, z = grid(48, 48, 48)
    radius = np.sqrt((x - 24) ** 2 + (y - 24) ** 2 + (z - 24) ** 2)
    labels = (radius < 20).astype(int)
    labels[(radius < 15) & (radius > 14)] = 2
    result = mesh_segmentation(Image(labels), 5.0)
    check_conforming(result)
    assert any("volume of label 2" in n or "no cell of label 2" in n for n in result.notes)


def test_rigid_labels_and_boxes_hold_their_nodes():
    labels = layered_block()
    labels[2:5, 8:52, 6:58] = 4
    whole = mesh_segmentation(Image(labels), 5.0)
    result = mesh_segmentation(
        Image(labels), 5.0, rigid_labels=[4], reaction_boxes=[(0, 64, 0, 60, 43, 44)]
    )
    check_conforming(result)
    assert 4 not in result.labels
    bottom = np.intersect1d(whole.cells[whole.labels == 4], whole.cells[whole.labels != 4])
    held = result.points[result.reaction_nodes == 1]
    top = held[:, 2] > 40
    assert (~top).sum() == len(bottom)
    assert np.allclose(held[~top, 2], 4.5, atol=1e-6)
    assert np.allclose(held[top, 2], 43.5)
    free = result.points[result.reaction_nodes == 0]
    assert (free[:, 2] < 43.4).all()


def test_progress_rises_to_the_end_and_can_cancel():
    seen = []
    image = Image(layered_block())
    mesh_segmentation(image, 6.0, progress=lambda fraction, text: seen.append(fraction))
    assert seen == sorted(seen)
    assert seen[-1] == 1

    def cancel(fraction, text):
        if fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        mesh_segmentation(image, 6.0, progress=cancel)
