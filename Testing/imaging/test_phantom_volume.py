"""The phantom in space: its push against closed forms and scikit-fem, its images against it."""

import json

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.phantom import Ball, make_phantom_volume, write_phantom
from elastoidentify.imaging.phantom.push_bricks import solve_pushes_on_bricks
from elastoidentify.imaging.phantom.texture import sample_volume
from scipy.ndimage import map_coordinates
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

SMALL = {"voxels": 24, "elements": 4, "balls": ()}


@pytest.mark.parametrize("kinematics", ["small-strain", "neo-hookean"])
def test_two_layers_without_poisson_effect_share_the_push_as_two_springs_do(kinematics):
    def moduli(x, y, z):
        return np.where(z > 3, 5000.0, 3000.0), np.full(z.shape, 1e-9)

    push = solve_pushes_on_bricks(
        (2, 3, 4), moduli, [[0, 0, -0.4]], elements=2, kinematics=kinematics
    )

    def force(stretch, young):  # E/2 = μ, λ = 0
        if kinematics == "small-strain":
            return young * (stretch - 1)
        return young / 2 * (stretch - 1 / stretch)

    tissue = brentq(lambda s: force(s, 3000) - force(3.6 - 3 * s, 5000), 0.7, 1.1)
    heights = np.array([0.0, 1, 2, 3, 3.5, 4])
    expected = np.minimum(heights, 3) * (tissue - 1) + np.maximum(heights - 3, 0) * (
        2.6 - 3 * tissue
    )
    found = push[0](np.column_stack([0 * heights + 0.7, 0 * heights + 2.2, heights]))
    assert np.allclose(found[:, 2], expected, atol=1e-4 * 0.4)
    assert np.allclose(found[:, :2], 0, atol=1e-6)


def test_the_push_is_that_of_scikit_fems_quadratic_hexahedra():
    skfem = pytest.importorskip("skfem")
    from skfem.helpers import ddot, sym_grad, trace

    size, pushes = np.array([1.0, 1.25, 1.5]), np.array([[0.05, 0.02, -0.08], [0, 0, -0.1]])

    def moduli(x, y, z):
        return 3000 + 4000 * x * y + 1000 * z**2, np.full(np.shape(x), 0.45)

    found = solve_pushes_on_bricks(size, moduli, pushes, elements=4)

    mesh = skfem.MeshHex.init_tensor(
        *(np.linspace(0, s, n) for s, n in zip(size, (5, 6, 7), strict=True))
    )
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=5)

    @skfem.BilinearForm
    def stiffness(u, v, w):
        young, nu = moduli(*w.x)
        lam, mu = young * nu / ((1 + nu) * (1 - 2 * nu)), young / (2 * (1 + nu))
        return lam * trace(sym_grad(u)) * trace(sym_grad(v)) + 2 * mu * ddot(
            sym_grad(u), sym_grad(v)
        )

    matrix = stiffness.assemble(basis)
    top = basis.get_dofs(lambda x: np.isclose(x[2], size[2]))
    floor = basis.get_dofs(lambda x: np.isclose(x[2], 0))
    fixed = np.concatenate([top.all(), floor.all()])
    for push, deformation in zip(pushes, found, strict=True):
        u = np.zeros(basis.N)
        for axis, shift in enumerate(push):
            u[top.all([f"u^{axis + 1}"])] = shift
        u = skfem.solve(*skfem.condense(matrix, np.zeros(basis.N), x=u, D=fixed))
        nodes = u[basis.nodal_dofs]
        assert np.abs(deformation(mesh.p.T).T - nodes).max() < 1e-5 * np.abs(push).max()


def test_finite_strain_differs_from_small_strain_by_the_square_of_the_push():
    def moduli(x, y, z):
        return np.where(z > 0.5, 5000.0, 3000.0), np.full(z.shape, 0.4)

    points = np.random.default_rng(0).uniform(0.05, 0.95, (50, 3))
    apart = []
    for push in (0.02, 0.04):
        small, finite = (
            solve_pushes_on_bricks((1, 1, 1), moduli, [[0, 0, -push]], elements=4, kinematics=law)[
                0
            ]
            for law in ("small-strain", "neo-hookean")
        )
        apart.append(np.abs(small(points) - finite(points)).max())
    assert apart[1] / apart[0] == pytest.approx(4, rel=0.1)


@pytest.fixture(scope="module")
def oblique():
    turn = Rotation.from_euler("zyx", (20, -30, 40), degrees=True).as_matrix()
    return make_phantom_volume(
        voxels=32, elements=8, noise=0, anisotropy=4 / 3, direction=turn, origin=(10, -70, 33)
    )


def test_pushed_volumes_show_at_the_moved_place_what_the_rest_volume_shows(oblique):
    rng = np.random.default_rng(0)
    size = np.array(oblique.rest.size)
    index = rng.uniform(6, size - 7, (800, 3))
    world = oblique.rest.index_to_world(index)
    for pushed, moved in zip(oblique.pushed, oblique.displacements(world), strict=True):
        there = pushed.world_to_index(world + moved)
        before, after, still = (
            map_coordinates(image.array.astype(float), at.T[::-1], order=5)
            for image, at in ((oblique.rest, index), (pushed, there), (pushed, index))
        )
        assert np.sqrt(np.mean((after - before) ** 2)) < 0.012 * 1000
        assert np.sqrt(np.mean((still - before) ** 2)) > 0.05 * 1000  # else nothing was tested


def test_the_indenters_motion_is_the_push_and_the_floor_stays(oblique):
    shares = np.linalg.norm(oblique.pushes, axis=1) / oblique.parameters["block_mm"][2]
    assert np.allclose(shares, [0.05, 0.0495, 0.0495], atol=1e-4)
    for name, expected in (("indenter", oblique.pushes), ("floor", 0 * oblique.pushes)):
        k, j, i = np.argwhere(oblique.segmentation.array == oblique.label(name))[::97].T
        moved = oblique.displacements(oblique.rest.index_to_world(np.column_stack([i, j, k])))
        assert np.allclose(moved, expected[:, None], atol=1e-9)


def test_labels_and_true_maps_follow_the_geometry(oblique):
    labels, young = oblique.segmentation.array, oblique.young.array
    ball = labels == oblique.label("inclusion")
    voxel = oblique.rest.spacing.prod()
    assert ball.sum() * voxel == pytest.approx(4 / 3 * np.pi * (0.2 * 64) ** 3, rel=0.03)
    assert (labels == oblique.label("pad")).sum() * voxel == pytest.approx(0.25 * 64**3, rel=0.03)
    assert (young[ball] == 9000).all() and (young[labels == oblique.label("tissue")] == 3000).all()
    assert np.isnan(young[(labels == 0) | np.isin(labels, oblique.rigid_labels)]).all()
    assert np.allclose(oblique.mu.array[ball], 9000 / 2.9)


def test_a_hidden_ball_is_in_the_truth_and_not_in_the_labels(oblique):
    hidden = make_phantom_volume(voxels=24, elements=4, hidden=True)
    assert [material.name for material in hidden.materials.values()] == [
        "pad", "tissue", "indenter", "floor",
    ]  # fmt: skip
    assert set(np.unique(hidden.segmentation.array)) == {0, 1, 2, 3, 4}
    inside = hidden.young.array == 9000
    assert (hidden.segmentation.array[inside] == 2).all() and inside.sum() > 300
    assert hidden.knowledge()["hidden"] is True


def test_a_volume_gives_the_tissue_its_texture_and_is_sampled_where_it_is():
    k, j, i = np.indices((20, 24, 28)).astype(float)
    wave = np.sin(0.4 * i) + np.cos(0.3 * j) + 0.5 * np.sin(0.5 * k)
    x, y, z = np.linspace(-9, 9, 13), np.linspace(-8, 7, 11), np.linspace(-6, 6, 9)
    found = sample_volume(Image(wave, spacing=[1, 1.5, 2]), x, y, z)
    place = x / 1 + 13.5, (y / 1.5 + 11.5)[:, None], (z / 2 + 9.5)[:, None, None]
    true = np.sin(0.4 * place[0]) + np.cos(0.3 * place[1]) + 0.5 * np.sin(0.5 * place[2])
    assert np.corrcoef(found.ravel(), true.ravel())[0, 1] > 0.999
    made = make_phantom_volume(Image(np.random.default_rng(0).random((9, 9, 9))), width=6, **SMALL)
    assert np.ptp(made.rest.array[10:14]) > 300


def test_a_volume_phantom_is_written_with_everything_that_is_known(tmp_path):
    from elastoidentify.imaging.io import read_image

    phantom = make_phantom_volume(**SMALL)
    files = write_phantom(tmp_path, phantom)
    names = {file.stem for file in files}
    assert {"rest", "pushed_1", "pushed_2", "pushed_3", "segmentation", "true_mu"} <= names
    back = read_image(tmp_path / "pushed_3.nrrd")
    assert np.array_equal(back.array, phantom.pushed[2].array)
    known = json.loads((tmp_path / "phantom.json").read_text())
    assert known["rigid_labels"] == [3, 4] and known["pushes_mm"][0] == [0, 0, -3.2]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"balls": [Ball(z=0.7)]}, "leaves the tissue"),
        ({"balls": [Ball(x=0.1)]}, "leaves the tissue"),
        ({"poisson": 0.5}, "Poisson"),
        ({"pushes": []}, "no push"),
        ({"pushes": [(0, 0, -0.9)], "kinematics": "neo-hookean"}, "push less"),
        ({"pushes": [(0, 0, -1.2)]}, "push less"),
    ],
)
def test_a_phantom_that_cannot_be_is_refused_with_what_to_do(options, message):
    with pytest.raises(InputError, match=message):
        make_phantom_volume(**{**SMALL, **options})
