"""Registration of whole image pairs: measured displacement against the known one."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from elastoidentify.errors import Cancelled, InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration.registration import (
    SIX,
    PixelFrame,
    check_image,
    on_grid_of,
    register,
)
from elastoidentify.workers.elastix_client import ElastixProcess
from hosts import has_elastix
from quick_elastix import quick_parameters
from scipy import ndimage

needs_elastix = pytest.mark.skipif(
    not has_elastix(), reason='needs itk-elastix: pip install ".[registration]"'
)
HERE = Path(__file__).parent
SQUARE = np.array([[40.0, 40, 0], [90, 40, 0], [90, 90, 0], [40, 90, 0]])
QUAD = np.array([[0, 1, 2, 3]])


@pytest.fixture(scope="module")
def elastix():
    """One warm worker for the whole module."""
    if not has_elastix():
        pytest.skip('needs itk-elastix: pip install ".[registration]"')
    with ElastixProcess() as process:
        yield process


@pytest.fixture(scope="module")
def pairs():
    for package, extra in (("skfem", "demo"), ("nilearn", "demo"), ("SimpleITK", "registration")):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f'needs {package}: pip install ".[{extra}]"')
    sys.path.insert(0, str(HERE))
    try:
        import pairs
    finally:
        sys.path.remove(str(HERE))
    return pairs


def speckle(shape=(128, 128), seed=0, blur=1.6):
    values = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), blur)
    return 100 + 20 * values / values.std()


def matrices(information):
    """(n, 3, 3) of (n, 6)."""
    full = np.zeros((len(information), 3, 3))
    for component, (a, b) in enumerate(SIX):
        full[:, a, b] = full[:, b, a] = information[:, component]
    return full


# --- accuracy ------------------------------------------------------------------------------------


@needs_elastix
def test_speckle_pushed_obliquely_is_found_in_a_slanted_world_with_honest_errors(pairs, elastix):
    """Displacement ≤ 0.10 px; the predicted covariance agrees with the error actually made."""
    pair = pairs.make_pair("speckle", "oblique", 0.05, 0.02)
    index, cells = pairs.block_mesh(12.0)
    direction = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    place = {"origin": [-30, 12, 500], "spacing": [0.5, 0.5, 3.0], "direction": direction}
    rest, pushed = (Image(np.uint16(2000 * one), **place) for one in (pair.rest, pair.pushed))
    points = rest.index_to_world(np.c_[index, np.zeros(len(index))])
    seen = []
    found = register(
        rest, [pushed], points, cells, progress=lambda fraction, text: seen.append((fraction, text))
    )
    true = np.c_[pair.displacement(index), np.zeros(len(index))] @ rest.axes.T
    error = found.displacements[0] - true
    assert pairs.rms(error) / 0.5 <= 0.10
    assert np.max(np.abs(error @ direction[:, 2])) < 1e-9  # stays in the plane

    figures = found.report["trials"][0]
    assert figures["similarity_before"] < 0.9 < 0.99 < figures["similarity_after"]
    assert figures["folded_cells"] == 0 and found.report["warnings"] == []
    assert figures["noise"] == pytest.approx(40, rel=0.15)
    assert np.median(found.disagreement[0]) < 0.1
    chi = np.einsum("na,nab,nb->n", error, matrices(found.information[0]), error) / 2
    assert 0.2 < np.mean(chi) / figures["independent_share"] < 1.5
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0 and len(seen) > 20


@pytest.mark.slow
@pytest.mark.parametrize("direction", ["straight", "oblique"])
@pytest.mark.parametrize(
    "texture, push, limit",
    [
        ("speckle", 0.02, 0.10),
        ("speckle", 0.05, 0.10),
        ("speckle", 0.12, 0.25),
        ("mr", 0.02, 0.18),
        ("mr", 0.05, 0.20),
        ("mr", 0.12, 0.40),
    ],
)
def test_displacement_error_on_phantoms_with_two_percent_noise(
    pairs, elastix, texture, direction, push, limit
):
    pair = pairs.make_pair(texture, direction, push, 0.02, seed=7)
    index, cells = pairs.block_mesh(12.0)
    points = np.c_[index, np.zeros(len(index))]
    found = register(
        Image(pair.rest), [Image(pair.pushed)], points, cells, backward=False, elastix=elastix
    )
    error = found.displacements[0][:, :2] - pair.displacement(index)
    assert pairs.rms(error) <= limit


@pytest.mark.slow
def test_oblique_anisotropic_volume_with_hexahedra(elastix):
    shape, random = (40, 72, 64), np.random.default_rng(0)

    def displacement(p):  # in voxels
        return np.stack(
            [1.5 * np.sin(p[:, 1] / 30) + 1, -0.05 * (p[:, 1] - 10), 0.04 * (p[:, 2] - 20)], 1
        )

    k, j, i = np.mgrid[: shape[0], : shape[1], : shape[2]]
    there = np.stack([i.ravel(), j.ravel(), k.ravel()], 1).astype(float)
    origin = there.copy()
    for _ in range(60):
        origin = there - displacement(origin)
    rest = speckle(shape, blur=1.5)
    pushed = ndimage.map_coordinates(rest, origin.T[::-1], order=3, mode="nearest").reshape(shape)
    angle = 0.5
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    place = {"origin": [5, -100, 40], "spacing": [0.8, 0.8, 1.2], "direction": turn[[2, 0, 1]]}
    rest, pushed = (
        Image((one + 2 * random.standard_normal(shape)).astype(np.int16), **place)
        for one in (rest, pushed)
    )
    grid = np.stack(
        np.meshgrid(np.arange(8, 57, 8), np.arange(8, 65, 8), np.arange(6, 35, 7), indexing="ij"),
        -1,
    )
    number = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    a, b = slice(None, -1), slice(1, None)
    corners = [
        (a, a, a),
        (b, a, a),
        (b, b, a),
        (a, b, a),
        (a, a, b),
        (b, a, b),
        (b, b, b),
        (a, b, b),
    ]
    cells = np.stack([number[corner] for corner in corners], -1).reshape(-1, 8)
    index = grid.reshape(-1, 3).astype(float)
    found = register(rest, [pushed], rest.index_to_world(index), cells, elastix=elastix)
    error = found.displacements[0] - displacement(index) @ rest.axes.T
    assert np.sqrt((error**2).sum(1).mean()) < 0.08 * found.report["pixel"]
    chi = np.einsum("na,nab,nb->n", error, matrices(found.information[0]), error) / 3
    assert 0.2 < np.mean(chi) / found.report["trials"][0]["independent_share"] < 2
    assert np.median(found.disagreement) < 0.1


@pytest.mark.slow
def test_consecutive_images_are_composed_and_repeated_pushes_are_told(pairs, elastix, tmp_path):
    small = pairs.make_pair("speckle", "straight", 0.06, 0.01, seed=1)
    large = pairs.make_pair("speckle", "straight", 0.12, 0.01, seed=2)
    index, cells = pairs.block_mesh(16.0)
    points = np.c_[index, np.zeros(len(index))]
    pushed = [Image(small.pushed), Image(large.pushed)]
    options = {"parameters": quick_parameters(tmp_path), "elastix": elastix}
    found = register(Image(small.rest), pushed, points, cells, reference="previous", **options)
    for trial, pair in enumerate((small, large)):
        error = found.displacements[trial][:, :2] - pair.displacement(index)
        assert pairs.rms(error) < 0.3
    assert any("push in the same way" in text for text in found.report["warnings"])


@pytest.mark.slow
def test_another_patient_is_told_and_left_out_and_alone_refused(pairs, elastix, tmp_path):
    pair = pairs.make_pair("speckle", "straight", 0.05, 0.02)
    other = Image(speckle((256, 256), seed=9))
    index, cells = pairs.block_mesh(24.0)
    points = np.c_[index, np.zeros(len(index))]
    options = {"parameters": quick_parameters(tmp_path), "elastix": elastix}
    found = register(Image(pair.rest), [Image(pair.pushed), other], points, cells, **options)
    (warning,) = (text for text in found.report["warnings"] if "did not find" in text)
    assert warning.startswith("Trial 2") and "same slice of the same patient" in warning
    assert np.any(found.information[0]) and not np.any(found.information[1])
    with pytest.raises(InputError, match="did not find the push") as error:
        register(Image(pair.rest), [other], points, cells, **options)
    assert "\n" not in str(error.value)


# --- geometry ------------------------------------------------------------------------------------


def test_pixel_frame_turns_pixels_into_world_vectors_and_information():
    direction = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    image = Image(np.zeros((1, 20, 30)), [1, 2, 3], [0.5, 2.0, 7.0], direction)
    frame = PixelFrame(image)
    assert frame.pixel == pytest.approx(1.0) and frame.shape == (20, 30)
    index = np.array([[3.0, 4.0], [5.0, 7.0]])
    points = image.index_to_world(np.c_[index, [0, 0]])
    np.testing.assert_allclose(frame.index(points), index)
    step = frame.to_world((index[1] - index[0]) * frame.spacing)
    np.testing.assert_allclose(step, points[1] - points[0])
    # the information of a displacement known to 0.1 along i and not at all along j
    world = matrices(frame.information_to_world(np.array([[[100.0, 0], [0, 0]]])))[0]
    np.testing.assert_allclose(world, 100 * np.outer(direction[:, 0], direction[:, 0]), atol=1e-12)


def test_a_slice_of_any_orientation_is_planar():
    for shape in ((1, 20, 30), (20, 1, 30), (20, 30, 1)):
        frame = PixelFrame(Image(np.zeros(shape), spacing=[1, 1, 1]))
        assert len(frame.shape) == 2 and set(frame.shape) == {20, 30}


def test_another_grid_of_the_same_extent_is_resampled():
    j, i = np.mgrid[:64, :80]
    rest = Image((2.0 * i + 3.0 * j)[None], spacing=[1, 1, 2])
    coarse = rest.array[:, ::2, ::2] + 2.5  # value at the middle of two voxels: (i + ½, j + ½)
    fine = on_grid_of(rest, Image(coarse, [0.5, 0.5, 0], [2, 2, 2]), "pushed")
    inner = np.s_[:, 2:-2, 2:-2]
    np.testing.assert_allclose(fine.array[inner], rest.array[inner], atol=1e-4)


def test_the_same_voxels_turned_round_are_put_back():
    image = speckle((24, 32))[None]
    turned = Image(image[:, :, ::-1], [31, 0, 0], [1, 1, 1], np.diag([-1.0, 1, 1]))
    back = on_grid_of(Image(image), turned, "pushed")
    np.testing.assert_allclose(back.array, image, atol=1e-4)


# --- bad input -----------------------------------------------------------------------------------


def holes():
    values = speckle()
    values[3, 4:7] = np.nan
    return values


@pytest.mark.parametrize(
    "array, said",
    [
        (np.full((64, 64), 7.0), "is 7 everywhere"),
        (holes(), "3 voxels that are not numbers"),
        (speckle((64, 10)), "too few"),
        (np.zeros((1, 1, 64)) + np.arange(64), "too few"),
        (speckle((40, 40, 4), blur=1), "too few"),
        (speckle((64, 64)).astype(complex), "grey values"),
    ],
)
def test_an_image_that_cannot_be_registered_is_one_line(array, said):
    with pytest.raises(InputError, match=said) as error:
        check_image(Image(array), "rest")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.uint16, np.float32, np.float64])
def test_usual_grey_values_are_accepted(kind):
    check_image(Image(speckle().astype(kind)), "rest")


def other_extent():
    return Image(speckle(), spacing=[1.1, 1, 1])


def volume():
    return Image(speckle((16, 128, 128)))


@pytest.mark.parametrize(
    "change, said",
    [
        ({"pushed": [other_extent()]}, "another part of the world"),
        ({"pushed": [volume()]}, "is a slice and the pushed .* a volume"),
        ({"rest": volume(), "pushed": [volume()]}, "tetrahedra or hexahedra"),
        ({"pushed": []}, "at least two images"),
        ({"rest": None}, "at least two images"),
        ({"reference": "next"}, "reference"),
        ({"points": SQUARE + np.array([0, 0, 50])}, "away from the plane"),
        ({"points": SQUARE + np.array([500, 0, 0])}, "100 % of the mesh nodes lie outside"),
        ({"points": SQUARE * [1, 1, np.nan]}, "not a number"),
        ({"mask": Image(np.zeros((128, 128)))}, "mask is empty"),
        ({"parameters": "/no/such/file.txt"}, "cannot read the elastix parameter file"),
    ],
)
def test_bad_input_is_refused_before_anything_is_started(change, said, monkeypatch):
    monkeypatch.setenv("ELASTOIDENTIFY_PYTHON", "/no/such/python")
    image = Image(speckle())
    arguments = {"rest": image, "pushed": [image], "points": SQUARE, "cells": QUAD, **change}
    with pytest.raises(InputError, match=said) as error:
        register(**arguments)
    assert "\n" not in str(error.value)


@needs_elastix
def test_cancel_is_heard_while_elastix_loads():
    def cancel(fraction, text):
        raise Cancelled

    image = Image(speckle())
    with pytest.raises(Cancelled):
        register(image, [image], SQUARE, QUAD, progress=cancel)
