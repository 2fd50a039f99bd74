"""Radiofrequency data: frames of scatterers that move as is known, their pulses as they are."""

from dataclasses import replace

import numpy as np
import pytest
from elastoidentify import study
from elastoidentify.errors import InputError
from elastoidentify.fem.forward import box_mesh
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.phantom import Inclusion, make_phantom
from elastoidentify.imaging.registration import register, register_radiofrequency
from elastoidentify.imaging.registration.radiofrequency import follow
from elastoidentify.imaging.registration.waves import envelope, wavelength, waves_along
from elastoidentify.pipeline import measure, run

LINES, SAMPLES = 64, 512
SIZE = np.array([0.3, 0.04])  # mm from line to line, from sample to sample
WAVE, LENGTH, WIDTH = 6.0, 5.0, 1.0  # samples, samples, lines


def displacement(points):
    """A compression of 1 %, half of it in a disc, and what goes sideways; mm."""
    x, y = points.T
    centre = np.array([LINES, SAMPLES]) * SIZE / 2
    soft = 1 - 0.5 * np.exp(-(((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 16))
    return np.stack([0.004 * (x - centre[0]), -0.01 * y * soft], axis=1)


def frame(places, strength, noise, seed, lines=LINES, samples=SAMPLES):
    """Echoes of scatterers at places (s, 2), mm, with an oscillating pulse."""
    grid = np.zeros((samples, lines))
    column, row = (places / SIZE).T
    for across in range(-3, 4):
        for along in range(-20, 21):
            i, j = np.rint(column).astype(int) + across, np.rint(row).astype(int) + along
            inside = (i >= 0) & (i < lines) & (j >= 0) & (j < samples)
            off = j - row
            pulse = np.exp(-(off**2) / (2 * LENGTH**2) - (i - column) ** 2 / (2 * WIDTH**2))
            pulse *= np.cos(2 * np.pi * off / WAVE) * strength
            np.add.at(grid, (j[inside], i[inside]), pulse[inside])
    random = np.random.default_rng(seed)
    return grid + noise * grid.std() * random.standard_normal(grid.shape)


@pytest.fixture(scope="module")
def pair():
    """Frames at rest and pushed, and a mesh with its true displacement, (n, 3)."""
    random = np.random.default_rng(0)
    places = random.uniform(-0.1, 1.1, (9000, 2)) * SIZE * [LINES, SAMPLES]
    strength = random.standard_normal(len(places))
    moved = places + displacement(places)
    images = [
        Image(frame(where, strength, 0.05, seed), spacing=[*SIZE, 1.0])
        for seed, where in enumerate((places, moved))
    ]
    points, cells = box_mesh((9, 10), SIZE * [LINES - 8, SAMPLES - 60], "quad")
    points = points + SIZE * [4, 30]
    flat = np.column_stack([points, np.zeros(len(points))])
    return *images, flat, cells, np.column_stack([displacement(points), np.zeros(len(points))])


@pytest.fixture(scope="module")
def tracked(pair):
    rest, pushed, points, cells, _ = pair
    return register_radiofrequency("j", rest, [pushed], points, cells)


def errors(found, truth, inner):
    return (found.displacements[0] - truth)[inner, :2]


def inner_nodes(points):
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    return ((points[:, :2] > low + 1e-9) & (points[:, :2] < high - 1e-9)).all(axis=1)


def test_waves_are_followed_to_a_small_part_of_a_sample(pair, tracked):
    """Beside the registration of the same envelopes, which is where it began."""
    rest, pushed, points, cells, truth = pair
    inner = inner_nodes(points)
    images = [
        replace(one, array=envelope(one.array, 1, 3), spacing=one.spacing * [1, 3, 1])
        for one in (rest, pushed)
    ]
    before = register(images[0], images[1:], points, cells)
    rough, fine = (errors(one, truth, inner).std(axis=0) / SIZE for one in (before, tracked))
    assert fine[1] < 0.05  # samples; the displacement reaches 5
    assert fine[1] < 0.4 * rough[1]
    assert fine[0] < rough[0]
    figures = tracked.report["trials"][0]
    assert figures["wave_agreement"] > 0.9 and figures["nodes_off_wave"] == 0
    stated = np.sqrt(1 / tracked.information[0][inner, 1])
    normalised = errors(tracked, truth, inner)[:, 1] / stated
    assert 0.2 < np.sqrt(np.mean(normalised**2)) < 2


def test_a_node_on_the_neighbouring_wave_comes_back(pair, tracked):
    rest, pushed, points, cells, truth = pair
    start = replace(tracked, displacements=tracked.displacements.copy())
    off = np.flatnonzero(inner_nodes(points))[[10, 45]]
    start.displacements[0, off, 1] += WAVE * SIZE[1]
    found = follow(start, rest, [pushed], points, cells)
    assert np.abs(found.displacements[0, off, 1] - truth[off, 1]).max() < 0.5 * SIZE[1]
    assert (found.information[0][off, 1] > 0).all()


def test_where_the_echoes_are_others_nodes_have_no_weight_and_are_counted(pair, tracked):
    rest, pushed, points, cells, _ = pair
    spoiled = pushed.array.copy()
    random = np.random.default_rng(5)
    spoiled[0, 200:330, 20:44] = random.permutation(spoiled[0, 200:330, 20:44].ravel()).reshape(
        130, 24
    )
    found = follow(tracked, rest, [pushed.with_array(spoiled)], points, cells)
    lost = ~found.information[0].any(axis=1)
    number, place = found.report["trials"][0]["nodes_off_wave"], points[lost, :2] / SIZE
    assert 2 <= number == lost.sum() < 0.2 * len(points)
    assert ((place > [14, 160]) & (place < [50, 370])).all()
    assert any(f"around {number} mesh nodes the radiofrequency" in one
               for one in found.report["warnings"])  # fmt: skip


def test_frames_of_something_else_keep_what_the_envelopes_said(pair, tracked):
    rest, _, points, cells, _ = pair
    other = rest.with_array(np.random.default_rng(1).standard_normal(rest.array.shape))
    found = follow(tracked, rest, [other], points, cells)
    assert np.array_equal(found.displacements, tracked.displacements)
    assert any("agree too little" in one for one in found.report["warnings"])


def test_the_option_reaches_the_registration_and_envelopes_are_refused(pair):
    rest, pushed, points, cells, _ = pair
    sizes = [one.with_array(np.abs(one.array)) for one in (rest, pushed)]
    options = study.RegistrationOptions(rest=sizes[0], pushed=sizes[1:], radiofrequency="j")
    triangles = np.vstack([cells[:, :3], cells[:, [0, 2, 3]]])
    with pytest.raises(InputError, match="no value below 0"):
        measure(options, points, triangles)
    with pytest.raises(InputError, match="one voxel along k"):
        register_radiofrequency("k", rest, [pushed], points, cells)


def test_without_the_option_the_axis_is_named(pair):
    """Here the waves themselves are not registered at all; where they are, a warning says it."""
    rest, pushed, points, cells, _ = pair
    with pytest.raises(InputError, match="oscillate around 0 along j"):
        register(rest, [pushed], points, cells, backward=False)


def moduli(images, phantom, **options):
    """Return E of tissue and inclusion, one unknown per label, with their standard errors."""
    pad = phantom.materials[1]
    chosen = study.Study(
        segmentation=phantom.segmentation, rest=images[0], pushed=images[1:], edge_length=1.6,
        rigid_labels=phantom.rigid_labels, known_materials=[(1, pad.young, pad.poisson)],
        unknowns="young", poisson_ratio=pad.poisson, method="regularized", grouping="label",
        **options,
    )  # fmt: skip
    rows = {row["label"]: row for row in run(chosen).result.statistics}
    names = "YoungModulus mean", "YoungModulus standard error"
    return np.array([[rows[label][name] for name in names] for label in (2, 3)])


def test_moduli_are_several_times_as_exact_as_from_the_envelopes():
    """A block with an inclusion of 3:1, pushed twice by 2 %; the labels are on coarser pixels."""
    phantom = make_phantom(
        inclusions=[Inclusion(0.5, 0.55, 0.16, 3.0)], pushes=((0, 0.02), (0.012, 0.012)),
        width=24, pixels=104, elements=48, noise=0,
    )  # fmt: skip
    lines, samples = 98, 733
    random = np.random.default_rng(0)
    places = random.uniform(-0.05, 1.05, (30_000, 2)) * SIZE * [lines, samples]
    strength = random.standard_normal(len(places))
    moved = phantom.displacements(np.column_stack([places, 0 * strength]))
    images = [
        Image(frame(places + u, strength, 0.1, seed, lines, samples), spacing=[*SIZE, 1.0])
        for seed, u in enumerate([0, *moved[..., :2]])
    ]
    every = round(wavelength(images[0].array, 1))
    sizes = [
        replace(one, array=envelope(one.array, 1, every), spacing=one.spacing * [1, every, 1])
        for one in images
    ]
    fine, rough = moduli(images, phantom, radiofrequency="j"), moduli(sizes, phantom)
    true = np.array([3000.0, 9000.0])
    assert np.abs(fine[:, 0] / true - 1).max() < 0.04
    assert (np.abs(fine[:, 0] - true) < 3 * fine[:, 1]).all()
    assert (fine[:, 1] < 0.5 * rough[:, 1]).all()


def test_radiofrequency_data_are_recognised_and_images_are_not(pair):
    rest = pair[0]
    assert waves_along(rest.array[0]) == 0
    assert wavelength(rest.array[0], 0) == pytest.approx(WAVE, rel=0.1)
    random = np.random.default_rng(0)
    for image in (
        envelope(rest.array[0], 0, 1),
        np.abs(rest.array[0]),
        random.standard_normal((128, 128)),
        random.uniform(0, 255, (128, 128)),
        np.cumsum(random.standard_normal((128, 128)), axis=0),
    ):
        assert waves_along(image) is None
