"""Displacements and their information, turned and scaled by VTK, give the same map."""

import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.filters import ElastixNodalDisplacement, LameIdentification, PushingPhantom
from elastoidentify.filters.frame import FRAME, follow_frame, write_frame
from elastoidentify.vtk_io import convert
from vtkmodules.vtkCommonTransforms import vtkTransform
from vtkmodules.vtkFiltersGeneral import vtkTransformFilter


def measured(random):
    """A mesh with noisy displacements that are surer in one direction, as registration gives it."""
    grid = PushingPhantom(resolution=6, noise=2e-5)()
    for k in (1, 2):
        rows = np.zeros((grid.GetNumberOfPoints(), 6))
        rows[:, 0] = random.uniform(1e8, 4e9, len(rows))
        rows[:, 1] = random.uniform(1e9, 4e10, len(rows))
        rows[:, 2], rows[:, 3] = 1e9, -1e8
        convert.set_array(grid.GetPointData(), f"DisplacementInformation_{k}", rows)
    write_frame(grid)
    return grid


def transformed(grid, scale=1.0, turn=0.0, tilt=0.0):
    """The mesh after VTK's Transform, as ParaView calls it."""
    transform = vtkTransform()
    transform.Scale(scale, scale, scale)
    transform.RotateZ(turn)
    transform.RotateX(tilt)
    made = vtkTransformFilter()
    made.TransformAllInputVectorsOn()
    made.SetTransform(transform)
    made.SetInputData(grid)
    made.Update()
    return made.GetOutput()


@pytest.mark.parametrize("how", [{"turn": 90}, {"scale": 1e-3}, {"turn": 30, "tilt": 50}])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_transform_in_front_changes_no_stiffness(how):
    grid = measured(np.random.default_rng(4))
    find = {"method": "regularized", "grouping": "label"}
    before = LameIdentification(**find)(grid).GetCellData()
    after = LameIdentification(**find)(transformed(grid, **how)).GetCellData()
    for name in ("Mu", "Lambda"):
        first, second = (convert.get_array(cells, name) for cells in (before, after))
        assert np.isfinite(first).all()
        np.testing.assert_allclose(second, first, rtol=1e-4)


def test_parts_that_were_turned_differently_are_refused():
    grid = transformed(measured(np.random.default_rng(4)), turn=20)
    axes = convert.get_array(grid.GetCellData(), FRAME[0]).copy()
    axes[3:] = [0, 1, 0]
    convert.set_array(grid.GetCellData(), FRAME[0], axes)
    with pytest.raises(InputError, match="transformed differently"):
        follow_frame(grid)


def test_registration_writes_the_axes(monkeypatch):
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
    assert all(made.GetOutput().GetCellData().HasArray(name) for name in FRAME)


def an_image():
    from elastoidentify.imaging.image import Image

    return Image(np.zeros((3, 4, 5)))
