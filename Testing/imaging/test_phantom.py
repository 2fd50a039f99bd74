"""The phantom: its push against closed forms and another solver, its images against its push."""

import json

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.phantom.planar import Inclusion, make_phantom, write_phantom
from elastoidentify.imaging.phantom.texture import slice_of
from scipy.ndimage import map_coordinates
from scipy.optimize import brentq

pytest.importorskip("skfem")
pytest.importorskip("SimpleITK")

SMALL = {"pixels": 64, "elements": 24}


def column(phantom, shares):
    """World points at the middle of the block, at these shares of its height."""
    points = np.column_stack([np.full(len(shares), 0.5), shares])
    points = points * [phantom.frame.width, phantom.frame.height]
    pixels = points / phantom.frame.spacing + phantom.frame.margin - 0.5
    return phantom.rest.index_to_world(np.column_stack([pixels, np.zeros(len(shares))]))


@pytest.mark.parametrize("kinematics", ["small-strain", "neo-hookean"])
def test_two_layers_without_poisson_effect_share_the_push_as_two_springs_do(kinematics):
    phantom = make_phantom(
        inclusions=(), pad=0.25, pushes=[(0, 0.1)], poisson=1e-9, noise=0, pad_young=5000.0,
        tissue_young=3000.0, kinematics=kinematics, **SMALL,
    )  # fmt: skip

    def force(stretch, young):  # E/2 = μ, λ = 0
        if kinematics == "small-strain":
            return young * (stretch - 1)
        return young / 2 * (stretch - 1 / stretch)

    def gap(pad_stretch):
        tissue_stretch = (0.9 - 0.25 * pad_stretch) / 0.75
        return force(pad_stretch, 5000.0) - force(tissue_stretch, 3000.0)

    pad_stretch = brentq(gap, 0.5, 1.2)
    tissue_stretch = (0.9 - 0.25 * pad_stretch) / 0.75
    shares = np.array([0.0, 0.1, 0.2, 0.4, 0.7, 1.0])
    below = np.maximum(shares - 0.25, 0)
    expected = 0.1 + np.minimum(shares, 0.25) * (pad_stretch - 1) + below * (tissue_stretch - 1)
    found = phantom.displacements(column(phantom, shares))[0] / phantom.frame.height
    assert np.allclose(found[:, 1], expected, atol=2e-4 * 0.1)
    assert np.allclose(found[:, [0, 2]], 0, atol=1e-6)


def test_the_push_agrees_with_linear_quadrilaterals_of_another_solver():
    from elastoidentify.fem.elastic_constants import lame_from_young
    from elastoidentify.fem.forward import box_mesh, solve_push

    phantom = make_phantom(pixels=64, elements=40, width=1.0, pushes=[(0.03, 0.05)], poisson=0.4)
    points, cells = box_mesh((60, 60), (1.0, 1.0), "quad")
    x, y = points[cells].mean(1).T  # y down here too: only the geometry is mirrored
    disc = Inclusion()
    young = np.where(np.hypot(x - disc.x, y - disc.y) < disc.radius, 9000.0, 3000.0)
    lam, mu = lame_from_young(np.where(y < 0.25, 5000.0, young), 0.4)
    moved = np.flatnonzero((points[:, 1] == 0) | (points[:, 1] == 1))
    target = np.where(points[moved, 1:] == 0, [[0.03, 0.05]], 0.0)
    other = solve_push(points, [("quad", cells)], lam, mu, moved, target)
    pixels = points / phantom.frame.spacing + phantom.frame.margin - 0.5
    world = phantom.rest.index_to_world(np.column_stack([pixels, np.zeros(len(points))]))
    found = phantom.displacements(world)[0][:, :2]
    assert np.sqrt(((found - other) ** 2).sum(1).mean()) < 0.01 * 0.058


@pytest.fixture(scope="module")
def oblique():
    a, b = 0.4, 0.7
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    tilt = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return make_phantom(
        noise=0, anisotropy=1.5, origin=(10, -70, 33), direction=turn @ tilt, pixels=96, elements=32
    )


def test_pushed_images_show_at_the_moved_place_what_the_rest_image_shows(oblique):
    rng = np.random.default_rng(0)
    rows, columns = oblique.frame.shape
    index = np.column_stack([rng.uniform(14, columns - 14, 500), rng.uniform(12, rows - 12, 500)])
    index = np.column_stack([index, np.zeros(500)])
    world = oblique.rest.index_to_world(index)
    for pushed, moved in zip(oblique.pushed, oblique.displacements(world), strict=True):
        there = pushed.world_to_index(world + moved)
        assert np.allclose(there[:, 2], 0, atol=1e-9)
        before, after = (
            map_coordinates(image.array[0].astype(float), [at[:, 1], at[:, 0]], order=5)
            for image, at in ((oblique.rest, index), (pushed, there))
        )
        assert np.sqrt(np.mean((after - before) ** 2)) < 0.01 * 1000
        still = map_coordinates(pushed.array[0].astype(float), index[:, [1, 0]].T, order=5)
        assert np.sqrt(np.mean((still - before) ** 2)) > 0.05 * 1000  # else nothing was tested


def test_the_same_phantom_in_another_place_has_the_same_pixels(oblique):
    upright = make_phantom(noise=0, anisotropy=1.5, pixels=96, elements=32)
    assert np.array_equal(upright.rest.array, oblique.rest.array)
    assert np.array_equal(upright.pushed[1].array, oblique.pushed[1].array)
    assert np.allclose(oblique.pushes, upright.pushes @ oblique.rest.direction.T)


def test_labels_and_true_maps_follow_the_geometry():
    phantom = make_phantom(inclusions=[Inclusion(0.5, 0.6, 0.15, 4.0)], noise=0, **SMALL)
    labels = phantom.segmentation.array[0]
    share = np.bincount(labels.ravel(), minlength=6) / 64**2
    assert share[phantom.label("pad")] == 0.25
    assert np.isclose(share[phantom.label("inclusion")], np.pi * 0.15**2, rtol=0.03)
    assert phantom.rigid_labels == [phantom.label("indenter"), phantom.label("floor")]
    inclusion = labels == phantom.label("inclusion")
    assert (phantom.young.array[0][inclusion] == 12000.0).all()
    assert np.allclose(phantom.mu.array[0][inclusion], 12000.0 / 2.9)
    assert np.isnan(phantom.lam.array[0][labels == 0]).all()


def test_noise_is_rician_of_the_level_asked_for():
    clean, noisy = (make_phantom(noise=noise, **SMALL) for noise in (0, 0.04))
    level = noisy.parameters["noise_grey_values"]
    assert np.isclose(level, 0.04 * np.percentile(clean.rest.array, 99), rtol=1e-6)
    bright = clean.rest.array > 10 * level
    assert np.isclose((noisy.rest.array - clean.rest.array)[bright].std(), level, rtol=0.05)
    power = np.mean(noisy.rest.array**2 - clean.rest.array**2)
    assert np.isclose(power, 2 * level**2, rtol=0.2)


def test_a_phantom_is_written_with_everything_that_is_known(tmp_path):
    from elastoidentify.imaging.io import read_image

    phantom = make_phantom(**SMALL)
    files = write_phantom(tmp_path / "new" / "folder", phantom)
    assert sorted(file.name for file in files) == sorted(
        file.name for file in (tmp_path / "new" / "folder").iterdir()
    )
    back = read_image(tmp_path / "new" / "folder" / "true_mu.nrrd")
    assert np.array_equal(back.array, phantom.mu.array, equal_nan=True)
    known = json.loads((tmp_path / "new" / "folder" / "phantom.json").read_text())
    assert known["materials"]["3"] == {"name": "inclusion", "young": 9000.0, "poisson": 0.45}
    assert known["rigid_labels"] == [4, 5]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inclusions": [Inclusion(x=0.95)]}, "leaves the tissue"),
        ({"inclusions": [Inclusion(y=0.3)]}, "leaves the tissue"),
        ({"poisson": 0.5}, "Poisson"),
        ({"pad": 1.2}, "pad thickness"),
        ({"noise": 2}, "noise"),
        ({"pushes": []}, "no push"),
        ({"kinematics": "linear"}, "kinematics"),
        ({"pushes": [(0, 1.5)]}, "push less"),
        ({"pushes": [(0, 1.5)], "kinematics": "neo-hookean"}, "push less"),
    ],
)
def test_what_makes_no_phantom_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        make_phantom(**{**SMALL, "elements": 8, **options})


# ---- textures


def test_a_slice_keeps_its_place_in_the_world_and_stands_upright():
    rng = np.random.default_rng(0)
    volume = Image(rng.random((6, 5, 4)), [1, 2, 3], [1, 2, 3], np.diag([-1.0, 1.0, -1.0]))
    for axis in range(3):
        image = slice_of(volume, axis, 2)
        assert (image.direction[range(3), range(3)] > 0).all()
        world = image.index_to_world(np.array([[0, 0, 0]]))
        i, j, k = np.rint(volume.world_to_index(world)[0]).astype(int)
        assert (i, j, k)[axis] == 2
        assert image.array[0, 0, 0] == volume.array[k, j, i]
    with pytest.raises(InputError, match="outside of the image"):
        slice_of(volume, 2, 6)


def test_a_constant_texture_is_refused():
    with pytest.raises(InputError, match="constant"):
        make_phantom(Image(np.full((50, 50), 3.0)), **SMALL)


def test_the_template_is_found_without_importing_nilearn():
    import sys

    from elastoidentify.imaging.io import read_image
    from elastoidentify.imaging.phantom.texture import mni152_path

    try:
        path = mni152_path()
    except InputError:
        pytest.skip("nilearn, which ships the MNI152 template, is not installed")
    assert "nilearn" not in sys.modules
    image = slice_of(read_image(path), index=92)
    assert image.size == (197, 233, 1)
    assert np.ptp(make_phantom(image, noise=0, **SMALL).rest.array) > 500
