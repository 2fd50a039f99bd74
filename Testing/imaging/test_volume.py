"""A volume from its files to moduli: labels, tetrahedra, registration, one modulus per label.

A block of soft tissue with a stiff ball and a known pad stands on a floor and is pushed by an
indenter, straight and obliquely. Its equilibrium is solved on hexahedra that identification does
not use; its images are speckle with noise, lying askew in the world, with voxels that are no cubes.
"""

import numpy as np
import pytest
from elastoidentify.cli import main
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh, solve_push
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.io import write_image
from elastoidentify.vtk_io.vtu import read_mesh
from scipy import ndimage
from scipy.spatial.transform import Rotation
from vtkmodules.util.numpy_support import vtk_to_numpy

pytest.importorskip("itk", reason="needs itk-elastix")

PAD, TISSUE, BALL, INDENTER, FLOOR = 1, 2, 3, 4, 5
YOUNG, POISSON = {PAD: 5000.0, TISSUE: 3000.0, BALL: 9000.0}, 0.4  # Pa
SIDE, PAD_HEIGHT, RADIUS = 64.0, 16.0, 17.0  # mm
CENTRE = np.array([32.0, 32.0, 24.0])
SHAPE, SPACING, MARGIN = (66, 80, 80), np.array([1.0, 1.0, 1.2]), np.array([8.0, 8.0, 7.6])
PUSHES = np.array([[0, 0, -3.6], [2.4, 1.2, -2.4]])  # mm
ELEMENTS = 16


def label_at(body):
    """Label at places (…, 3) of the body, mm from its lower corner."""
    label = np.where(body[..., 2] > SIDE - PAD_HEIGHT, PAD, TISSUE)
    label[np.linalg.norm(body - CENTRE, axis=-1) < RADIUS] = BALL
    label[body[..., 2] > SIDE] = INDENTER
    label[body[..., 2] < 0] = FLOOR
    beside = (body[..., :2] < 0) | (body[..., :2] > SIDE)
    label[beside.any(axis=-1) & (label < INDENTER)] = 0
    return label


def solved_push(push):
    """Displacement on the grid of nodes, (3, z, y, x)."""
    points, cells = box_mesh((ELEMENTS,) * 3, (SIDE,) * 3)
    labels = label_at(points[cells].mean(axis=1))
    young = np.choose(labels - 1, [YOUNG[PAD], YOUNG[TISSUE], YOUNG[BALL]])
    top = np.isclose(points[:, 2], SIDE)
    moved = np.flatnonzero(top | np.isclose(points[:, 2], 0))
    u = solve_push(
        points, cells, *lame_from_young(young, POISSON), moved, np.where(top[moved, None], push, 0)
    )
    return u.reshape((ELEMENTS + 1,) * 3 + (3,)).transpose(3, 0, 1, 2)


def displacement(field, body):
    """Interpolate it; around the body it goes on as at the surface."""
    place = body.T[::-1] * ELEMENTS / SIDE
    return np.stack([ndimage.map_coordinates(u, place, order=1, mode="nearest") for u in field], 1)


def volume_phantom(folder):
    """Write segmentation, rest and pushed images."""
    random = np.random.default_rng(0)
    voxels = np.stack(np.indices(SHAPE)[::-1], axis=-1)  # i, j, k
    body = voxels * SPACING - MARGIN
    labels = label_at(body)
    speckle = ndimage.gaussian_filter(random.standard_normal(SHAPE), 1.3)
    speckle = 100 + 25 * speckle / speckle.std()
    inside = ndimage.gaussian_filter((labels > 0).astype(float), 0.5)
    source = ndimage.spline_filter(speckle * inside, 3)

    def image(values, **more):
        turn = Rotation.from_euler("zyx", (20, -30, 40), degrees=True).as_matrix()
        return Image(values, np.array([-40.0, 120.0, 300.0]), SPACING, turn)

    def noisy(values):
        return image((values + 2 * random.standard_normal(SHAPE)).astype(np.float32))

    write_image(folder / "labels.nrrd", image(labels.astype(np.uint8)))
    write_image(folder / "rest.nrrd", noisy(speckle * inside))
    there = body.reshape(-1, 3)
    for trial, push in enumerate(PUSHES, 1):
        field, here = solved_push(push), there
        for _ in range(30):  # where the tissue at each voxel came from
            here = there - displacement(field, here)
        index = ((here + MARGIN) / SPACING).T[::-1]
        pushed = ndimage.map_coordinates(source, index, order=3, prefilter=False, mode="nearest")
        write_image(folder / f"pushed_{trial}.nrrd", noisy(pushed.reshape(SHAPE)))


@pytest.mark.slow
def test_a_volume_goes_from_files_to_the_moduli_of_its_labels(tmp_path):
    volume_phantom(tmp_path)
    words = ["run", "--rest", tmp_path / "rest.nrrd", "--segmentation", tmp_path / "labels.nrrd"]
    for trial in (1, 2):
        words += ["--pushed", tmp_path / f"pushed_{trial}.nrrd"]
    words += ["--rigid", INDENTER, "--rigid", FLOOR, "--edge-length", 9]
    words += ["--known", f"{PAD}:E={YOUNG[PAD]},nu={POISSON}", "--method", "regularized"]
    words += ["--unknowns", "young", "--poisson", POISSON, "--group", "label"]
    assert main([str(word) for word in [*words, "-o", tmp_path / "map.vtu"]]) == 0
    cells = read_mesh(tmp_path / "map.vtu").GetCellData()
    labels, young = (vtk_to_numpy(cells.GetArray(name)) for name in ("Label", "YoungModulus"))
    found = {label: np.median(young[labels == label]) for label in (PAD, TISSUE, BALL)}
    assert found[TISSUE] == pytest.approx(YOUNG[TISSUE], rel=0.1)
    assert found[BALL] / found[TISSUE] == pytest.approx(3, rel=0.1)
