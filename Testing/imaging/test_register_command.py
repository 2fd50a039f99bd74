"""`elastoidentify register` on the images people have: types, orders, series, no rest image."""

import json

import numpy as np
import pytest
from elastoidentify.cli import main
from elastoidentify.imaging.io import read_image, write_image
from elastoidentify.imaging.phantom.planar import make_phantom, write_phantom
from elastoidentify.imaging.phantom.texture import mni152_path, slice_of
from elastoidentify.vtk_io.vtu import read_mesh
from quick_elastix import quick_parameters
from vtkmodules.util.numpy_support import vtk_to_numpy

pytest.importorskip("itk", reason="needs itk-elastix")
pytest.importorskip("skfem", reason="the phantom needs scikit-fem")
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("waiting_elastix")]

LIMIT = 0.25  # pixels, root mean square


def brain(index, seed=0):
    texture = slice_of(read_image(mni152_path()), index=index)
    return make_phantom(texture, pixels=128, elements=32, seed=seed)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a phantom and the same pushed image in other clothes; the phantom."""
    import SimpleITK as sitk

    folder = tmp_path_factory.mktemp("phantom")
    phantom = brain(92)
    write_phantom(folder, phantom)
    first = phantom.pushed[0]
    share = first.array / first.array.max()
    write_image(folder / "integers.nrrd", first.with_array(np.uint16(60000 * share)))
    write_image(folder / "doubles.nrrd", first.with_array(0.1 + share.astype(float)))
    grey = sitk.ReadImage(str(folder / "pushed_1.nrrd"))
    grey = sitk.Cast(sitk.RescaleIntensity(grey), sitk.sitkUInt8)
    sitk.WriteImage(sitk.Compose(grey, grey, grey), str(folder / "picture.nrrd"))
    write_image(folder / "other.nrrd", brain(60, seed=5).pushed[0])
    around = np.pad(np.ones(np.array(share.shape[1:]) - 8), 4)
    write_image(folder / "mask.nrrd", phantom.rest.with_array(around[None].astype(np.uint8)))
    mesh = ["mesh", folder / "segmentation.nrrd", "--edge-length", 12 * phantom.rest.spacing[0]]
    mesh += ["--rigid", 4, "--rigid", 5, "-o", folder / "mesh.vtu"]
    assert main([str(word) for word in mesh]) == 0
    return folder, phantom


def register(made, *words):
    """Run the command; return nodes, displacements in pixels, information and report."""
    folder, phantom = made
    given = ["register", "--mesh", "mesh.vtu", *words, "-o", "out.vtu"]
    given += ["--parameters", quick_parameters(folder)]
    assert main([str(folder / w) if str(w).endswith(("nrrd", "vtu")) else w for w in given]) == 0
    grid = read_mesh(folder / "out.vtu")
    data = grid.GetPointData()
    points = vtk_to_numpy(grid.GetPoints().GetData())
    names = [n for n in range(1, len(words)) if data.HasArray(f"Displacement_{n}")]
    found, information = (
        np.array([vtk_to_numpy(data.GetArray(f"{array}_{n}")) for n in names])
        for array in ("Displacement", "DisplacementInformation")
    )
    assert np.median(vtk_to_numpy(data.GetArray("Disagreement_1"))) < 0.1  # pixels
    report = json.loads(grid.GetFieldData().GetAbstractArray("RegistrationReport").GetValue(0))
    return points, found / phantom.rest.spacing[0], information, report


def rms(error):
    return np.sqrt((error**2).sum(axis=-1).mean())


def test_types_and_order_do_not_matter_and_another_patient_is_left_out(made):
    names = ["pushed_2", "integers", "doubles", "picture", "other"]
    files = [word for name in names for word in ("--pushed", f"{name}.nrrd")]
    points, found, information, report = register(made, "--rest", "rest.nrrd", *files)
    phantom = made[1]
    first, second = phantom.displacements(points) / phantom.rest.spacing[0]
    for measured, true in zip(found, (second, first, first, first), strict=False):
        assert rms(measured - true) < LIMIT
    assert information[:4].any(axis=(1, 2)).all()
    assert not information[4].any()
    (warning,) = (text for text in report["warnings"] if "did not find the push" in text)
    assert warning.startswith("Trial 5")
    assert sum("show the same push" in text for text in report["warnings"]) == 3


def test_a_series_with_a_mask_is_composed(made):
    files = ["--rest", "rest.nrrd", "--pushed", "pushed_1.nrrd", "--pushed", "pushed_2.nrrd"]
    options = ["--reference", "previous", "--mask", "mask.nrrd"]
    points, found, _, report = register(made, *files, *options)
    phantom = made[1]
    true = phantom.displacements(points) / phantom.rest.spacing[0]
    assert report["reference"] == "previous"
    assert rms(found - true) < LIMIT


def test_without_a_rest_image_the_way_from_one_push_to_the_other_is_found(made, capsys):
    points, found, *_ = register(made, "--pushed", "pushed_1.nrrd", "--pushed", "pushed_2.nrrd")
    assert "without a rest image" in capsys.readouterr().out
    phantom, start = made[1], points
    for _ in range(30):  # where the tissue at each node was at rest
        start = points - phantom.displacements(start)[0]
    true = start + phantom.displacements(start)[1] - points
    labels = phantom.segmentation.array[0]
    column, row = np.rint(phantom.rest.world_to_index(start)[:, :2]).astype(int).T
    rows, columns = labels.shape
    tissue = np.isin(labels[row.clip(0, rows - 1), column.clip(0, columns - 1)], (1, 2, 3))
    assert tissue.mean() > 0.8
    assert len(found) == 1
    assert rms((found[0] - true / phantom.rest.spacing[0])[tissue]) < LIMIT
