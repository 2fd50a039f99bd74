"""Displacements and their information, turned and scaled by VTK, give the same map."""

import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.filters import ElastixNodalDisplacement, LameIdentification, PushingPhantom
from elastoidentify.imaging.registration import Registration
from elastoidentify.results import to_matrices
from elastoidentify.vtk_io import convert
from elastoidentify.vtk_io.arrays import write_registration
from elastoidentify.vtk_io.frame import FRAME, follow_frame
from vtkmodules.vtkCommonTransforms import vtkTransform
from vtkmodules.vtkFiltersGeneral import vtkTransformFilter, vtkWarpVector


def measured(random):
    """A mesh with noisy displacements that are surer in one direction, as registration gives it."""
    grid = PushingPhantom(resolution=6, noise=2e-5)()
    points = grid.GetPointData()
    u = [convert.get_array(points, f"Displacement_{k}").copy() for k in (1, 2)]
    rows = np.zeros((2, grid.GetNumberOfPoints(), 6))
    rows[..., 0] = random.uniform(1e8, 4e9, rows.shape[:2])
    rows[..., 1] = random.uniform(1e9, 4e10, rows.shape[:2])
    rows[..., 2], rows[..., 3] = 1e9, -1e8
    write_registration(grid, Registration(u, rows, None, {"warnings": []}))
    return grid


def transformed(grid, scale=1.0, turn=0.0, tilt=0.0, vectors=True):
    """The mesh after VTK's Transform, as ParaView calls it; and the map of its directions."""
    transform = vtkTransform()
    transform.Translate(3.0, -2.0, 1.0)
    transform.Scale(scale, scale, scale)
    transform.RotateZ(turn)
    transform.RotateX(tilt)
    made = vtkTransformFilter()
    made.SetTransformAllInputVectors(vectors)
    made.SetTransform(transform)
    made.SetInputData(grid)
    made.Update()
    matrix = transform.GetMatrix()
    return made.GetOutput(), np.array(
        [[matrix.GetElement(i, j) for j in range(3)] for i in range(3)]
    )


def of_trial(grid, number):
    points = grid.GetPointData()
    u = convert.get_array(points, f"Displacement_{number}")
    return u, to_matrices(convert.get_array(points, f"DisplacementInformation_{number}"))


HOW = [{"turn": 90}, {"scale": 1e-3}, {"turn": 30, "tilt": 50}]


@pytest.mark.parametrize("how", HOW)
def test_displacements_and_information_follow_a_transform_to_rounding(how):
    grid = measured(np.random.default_rng(4))
    there, A = transformed(grid, **how)
    followed = follow_frame(there)
    back = np.linalg.inv(A)
    for number in (1, 2):
        (u, W), (u_there, W_there) = of_trial(grid, number), of_trial(followed, number)
        for found, expected in ((u_there, u @ A.T), (W_there, back.T @ W @ back)):
            np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("how", HOW)
def test_a_transform_that_leaves_the_displacements_behind_is_refused(how):
    there, _ = transformed(measured(np.random.default_rng(4)), **how, vectors=False)
    with pytest.raises(InputError, match="Transform All Input Vectors"):
        LameIdentification()(there)
    moved, _ = transformed(measured(np.random.default_rng(4)), vectors=False)
    follow_frame(moved)  # moved only: displacements stay what they are


def test_a_mesh_warped_by_its_displacements_is_refused():
    warp = vtkWarpVector()
    warp.SetInputData(measured(np.random.default_rng(4)))
    warp.SetInputArrayToProcess(0, 0, 0, 0, "Displacement_1")
    warp.Update()
    with pytest.raises(InputError, match="the one at rest"):
        follow_frame(warp.GetOutput())


@pytest.mark.parametrize("how", HOW)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_transform_in_front_changes_no_stiffness(how):
    grid = measured(np.random.default_rng(4))
    find = {"method": "regularized", "grouping": "label"}
    before = LameIdentification(**find)(grid).GetCellData()
    after = LameIdentification(**find)(transformed(grid, **how)[0]).GetCellData()
    for name in ("Mu", "Lambda"):
        first, second = (convert.get_array(cells, name) for cells in (before, after))
        assert np.isfinite(first).all()
        np.testing.assert_allclose(second, first, rtol=1e-4)


def test_parts_that_were_turned_differently_are_refused():
    grid, _ = transformed(measured(np.random.default_rng(4)), turn=20)
    axes = convert.get_array(grid.GetCellData(), FRAME[0]).copy()
    axes[3:] = [0, 1, 0]
    convert.set_array(grid.GetCellData(), FRAME[0], axes)
    with pytest.raises(InputError, match="transformed differently"):
        follow_frame(grid)


def test_registration_says_that_it_starts_elastix(monkeypatch):
    monkeypatch.setattr("elastoidentify.vtk_io.steps.displaced", lambda mesh, *_: mesh)
    grid, image = PushingPhantom(resolution=2)(), convert.image_to_vtk(an_image())
    made = ElastixNodalDisplacement()
    made.SetMesh(grid)
    made.SetRestImage(image)
    made.AddPushedImage(image)
    said = []
    made.AddObserver("ProgressEvent", lambda *_: said.append(made.GetProgressText()))
    made.Update()
    assert "starting elastix" in said


def an_image():
    from elastoidentify.imaging.image import Image

    return Image(np.zeros((3, 4, 5)))
