"""A labelmap and the image it belongs to: cropped, finer, shifted, or without its geometry."""

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.meshing.fit import fit_notes

DIRECTIONS = {
    "axial": np.eye(3),
    "coronal": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).T,
    "flipped": np.diag([-1.0, -1, 1]),
}


def scene(direction, shape=(1, 80, 90)):
    """Return a rest image and a labelmap of a block inside it."""
    image = Image(np.ones(shape, np.float32), [5, -7, 3], [0.5, 0.8, 1.5], direction)
    labels = np.zeros(shape, np.uint8)
    middle = slice(None) if shape[0] == 1 else slice(6, 14)
    labels[middle, 15:60, 20:70] = 1
    labels[middle, 15:30, 20:70] = 2
    return image, image.with_array(labels)


def crop(image, low, high):
    """Return voxels low … high − 1 (i, j, k) of an image, in their place."""
    cut = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
    origin = image.index_to_world(np.array([low], float))[0]
    return Image(image.array[cut], origin, image.spacing, image.direction)


@pytest.mark.parametrize("name", DIRECTIONS)
@pytest.mark.parametrize("shape", [(1, 80, 90), (20, 80, 90)])
def test_a_cropped_labelmap_has_the_reaction_nodes_of_the_whole_one(name, shape):
    image, whole = scene(DIRECTIONS[name], shape)
    depth = (0, 1) if shape[0] == 1 else (6, 14)
    cropped = crop(whole, (20, 15, depth[0]), (70, 60, depth[1]))
    found = mesh_segmentation(cropped, 4.0, seen=image)
    assert not found.reaction_nodes.any()
    assert "cropped" in found.notes[0]
    alone = mesh_segmentation(cropped, 4.0)
    assert alone.reaction_nodes.any()
    assert not mesh_segmentation(whole, 4.0, seen=image).reaction_nodes.any()
    assert np.allclose(found.points, alone.points)


@pytest.mark.parametrize("k", [0, 9])
def test_a_cropped_slice_of_a_volume_is_free_where_the_volume_goes_on(k):
    image, whole = scene(np.eye(3), (20, 80, 90))
    whole.array[:] = whole.array[9]
    found = mesh_segmentation(crop(whole, (20, 15, k), (70, 60, k + 1)), 4.0, seen=image)
    assert not found.reaction_nodes.any()


def test_a_label_at_the_images_own_border_may_be_pushed_there():
    image, whole = scene(np.eye(3))
    whole.array[:, 15:60, :70] = 1  # reaches the image's first column
    cropped = crop(whole, (0, 10, 0), (75, 65, 1))
    found = mesh_segmentation(cropped, 4.0, seen=image)
    left = np.isclose(found.points[:, 0], 5 - 0.25)
    assert left.any() and np.array_equal(found.reaction_nodes.astype(bool), left)


@pytest.mark.parametrize("name", DIRECTIONS)
@pytest.mark.parametrize("lost", ["spacing", "origin", "direction"])
def test_a_labelmap_that_lost_its_geometry_is_noted_or_refused(name, lost):
    image, labels = scene(DIRECTIONS[name])
    spacing, origin, direction = labels.spacing, labels.origin, labels.direction
    if lost == "spacing":
        spacing = spacing * [1, 0.5, 1]
    elif lost == "origin":
        origin = origin + np.array([4, 0, 0])
    else:
        direction = direction * [-1, 1, -1]
    try:
        notes = fit_notes(Image(labels.array, origin, spacing, direction), image)
    except InputError as error:
        assert "lie in the rest image" in str(error)
    else:
        assert "another geometry" in notes[0]


def test_finer_coarser_and_slightly_shifted_labelmaps_are_fine():
    image, labels = scene(np.eye(3))
    fine = Image(
        np.kron(labels.array[0], np.ones((2, 2), np.uint8)), [4.875, -7.2, 3], [0.25, 0.4, 1]
    )
    coarse = Image(labels.array[:, ::2, ::2], labels.origin, labels.spacing * [2, 2, 1])
    shifted = Image(labels.array, labels.origin + 0.1, labels.spacing)
    for one in (labels, fine, coarse, shifted):
        assert fit_notes(one, image) == []


def test_labels_beyond_the_image_are_said_and_most_beyond_it_refused():
    image, labels = scene(np.eye(3))
    part = crop(image, (30, 0, 0), (90, 80, 1))
    assert "outside of the rest image" in fit_notes(labels, part)[0]
    with pytest.raises(InputError, match="lie in the rest image"):
        fit_notes(labels, crop(image, (60, 0, 0), (90, 80, 1)))


@pytest.mark.parametrize("off", [-1e-7, 9e-4])
def test_labels_stored_as_floats_are_rounded(off):
    _, labels = scene(np.eye(3))
    whole = mesh_segmentation(labels, 4.0)
    found = mesh_segmentation(labels.with_array(labels.array + off), 4.0)
    assert np.array_equal(found.labels, whole.labels)
    with pytest.raises(InputError, match="fractional"):
        mesh_segmentation(labels.with_array(labels.array + 0.01), 4.0)
