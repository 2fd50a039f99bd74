"""DICOM maps in Slicer's own volume nodes, as QuantitativeReporting loads them: through dcmqi."""

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")
pytest.importorskip("highdicom", reason="needs highdicom: pip install .[dicom]")

import dicom_maps  # noqa: E402
import vtk  # noqa: E402
from elastoidentify.export.dicom import write_dicom  # noqa: E402
from elastoidentify.export.nifti import write_nifti  # noqa: E402
from export_grids import boxes, directions, expected, grid  # noqa: E402
from vtk.util.numpy_support import vtk_to_numpy  # noqa: E402

LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def loaded(file):
    """Return index → world (LPS) and values of a file, by Slicer's storage and volume nodes."""
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode")
    storage = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLVolumeArchetypeStorageNode")
    storage.SetFileName(str(file))
    assert storage.ReadData(node) == 1
    matrix = vtk.vtkMatrix4x4()
    node.GetIJKToRASMatrix(matrix)
    place = LPS @ np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
    image = node.GetImageData()
    values = vtk_to_numpy(image.GetPointData().GetScalars())
    return place, values.reshape(image.GetDimensions()[::-1])


def check(tmp_path, direction):
    image = grid(direction)
    made = boxes(image)
    # what nobody reads here is not written: another map of the same kind, and the cells without one
    del made.values["MuStd"]
    made.status[:] = 2
    tmp_path.mkdir(exist_ok=True)
    write_dicom(tmp_path / "dicom", made, image)
    write_nifti(tmp_path / "case", made, image, ["Mu"])
    volume = loaded(dicom_maps.volume_by_dcmqi(tmp_path / "dicom" / "mu.dcm", tmp_path / "q"))
    wanted = expected(image, made.values["Mu"])
    np.testing.assert_allclose(dicom_maps.on_grid([volume], image), wanted / 1000, rtol=1e-5)
    nifti = loaded(tmp_path / "case_mu.nii.gz")
    # niftilib, which ITK reads with, makes 0 of what is not a number: the sidecar says so
    wanted = np.nan_to_num(wanted)
    np.testing.assert_allclose(dicom_maps.on_grid([nifti], image), wanted, rtol=1e-5)


@pytest.mark.parametrize("number", [0, 13, 58])
def test_slicer_shows_a_map_where_the_tissue_is(tmp_path, number):
    check(tmp_path, list(directions())[number])


@pytest.mark.slow
def test_slicer_shows_every_axis_order_and_flip_right(tmp_path):
    for number, direction in enumerate(list(directions())[::2]):
        check(tmp_path / str(number), direction)
    for number, direction in enumerate(list(directions())[1::8]):
        check(tmp_path / f"oblique-{number}", direction)
