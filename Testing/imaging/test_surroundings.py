"""A body that goes on beyond its labels, or that something touches: seen in the image at rest."""

import numpy as np
import pytest
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import mesh_segmentation
from scipy import ndimage

FLOOR, BODY = 1, 2
SLANT = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [-0.3, 1, 0.1], [0.2, 0.1, 1]]))[0]


def scene(beyond, shape=(1, 90, 100), texture=0.3, noise=0.02, direction=None):
    """A rest image and its labels: a body on a rigid floor, in a surrounding.

    `beyond` tells where the image looks as inside: a function of the voxel's k, j, i.
    """
    rng = np.random.default_rng(3)
    smooth = ndimage.gaussian_filter(
        rng.standard_normal(shape), [0 if n == 1 else 2 for n in shape]
    )
    k, j, i = np.indices(shape)
    labels = np.zeros(shape, np.uint8)
    deep = slice(None) if shape[0] == 1 else slice(12, shape[0] - 12)
    labels[deep, 20:70, 25:75] = BODY
    labels[deep, 12:20, 25:75] = FLOOR
    filled = (labels > 0) | beyond(k, j, i)
    grey = np.where(filled, 1.0 + texture * smooth / smooth.std(), 0.05)
    # the magnitude of two noisy channels, as of MR
    grey = np.hypot(grey + noise * rng.standard_normal(shape), noise * rng.standard_normal(shape))
    direction = np.eye(3) if direction is None else direction
    image = Image(grey.astype(np.float32), [5, -7, 3], [0.5, 0.5, 0.5], direction)
    return image, image.with_array(labels)


def notes(beyond, edge_length=3.0, boxes=(), **options):
    image, labels = scene(beyond, **options)
    mesh = mesh_segmentation(
        labels, edge_length, rigid_labels=[FLOOR], reaction_boxes=boxes, seen=image
    )
    return [note for note in mesh.notes if note.startswith("Beyond")]


def nothing(k, j, i):
    return np.zeros(k.shape, bool)


def everything(k, j, i):
    return np.ones(k.shape, bool)


def above(k, j, i):
    return j >= 70


@pytest.mark.parametrize("texture", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
def test_around_a_body_in_air_there_is_nothing(texture, noise):
    assert notes(nothing, texture=texture, noise=noise) == []


@pytest.mark.parametrize("direction", [np.eye(3), SLANT])
@pytest.mark.parametrize("shape", [(1, 90, 100), (50, 90, 100)])
def test_a_body_that_goes_on_beyond_its_labels_is_said(shape, direction):
    (note,) = notes(everything, shape=shape, direction=direction, edge_length=6.0)
    assert "reaction box" in note
    assert int(note.split()[1]) > 60


def test_a_body_that_something_touches_on_one_side_is_said_with_the_place():
    (note,) = notes(above)
    assert 15 < int(note.split()[1]) < 50
    place = [float(x) for x in note.split("(")[1].split(")")[0].split(",")]
    assert place == pytest.approx([5 + 25, -7 + 35, 3], abs=2.5)


def test_where_a_reaction_box_holds_the_border_nothing_is_said():
    assert notes(above, boxes=[(0, 60, 27.5, 30)]) == []


def test_a_body_that_is_held_all_around_has_no_free_border():
    assert notes(everything, boxes=[(0, 100, -100, 100)]) == []


@pytest.mark.parametrize("shape", [(1, 90, 100), (50, 90, 100)])
def test_what_lies_far_away_changes_nothing(shape):
    image, labels = scene(above, shape=shape)
    wide = [(0, 0) if n == 1 else (0, 40) for n in shape]
    far = [Image(np.pad(one.array, wide), one.origin, one.spacing) for one in (image, labels)]
    found = [
        mesh_segmentation(b, 6.0, rigid_labels=[FLOOR], seen=a).notes
        for a, b in ((image, labels), far)
    ]
    assert any(note.startswith("Beyond") for note in found[0])
    assert found[0] == found[1]


def test_water_that_is_as_bright_but_has_no_texture_is_no_tissue():
    image, labels = scene(nothing)
    grey = np.where(labels.array > 0, image.array, 1.0)
    grey += 0.02 * np.random.default_rng(1).standard_normal(grey.shape).astype(np.float32)
    mesh = mesh_segmentation(labels, 3.0, rigid_labels=[FLOOR], seen=image.with_array(grey))
    assert not any(note.startswith("Beyond") for note in mesh.notes)


def test_two_bodies_with_a_gap_are_not_each_others_surroundings():
    """The far side of a cleft as narrow as the window is the body itself."""
    image, labels = scene(nothing)
    values = labels.array.copy()
    values[:, 30:70, 48:51] = 0
    mesh = mesh_segmentation(labels.with_array(values), 3.0, rigid_labels=[FLOOR], seen=image)
    assert not any(note.startswith("Beyond") for note in mesh.notes)


def test_an_image_too_small_to_tell_or_without_texture_says_nothing():
    assert notes(everything, texture=0.0, noise=0.0) == []
    image = Image(np.random.default_rng(0).random((1, 12, 12)).astype(np.float32))
    labels = np.zeros((1, 12, 12), np.uint8)
    labels[:, 3:9, 3:9] = BODY
    mesh = mesh_segmentation(image.with_array(labels), 2.0, seen=image)
    assert not any(note.startswith("Beyond") for note in mesh.notes)
