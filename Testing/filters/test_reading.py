"""Image files on a VTK image: values and place as SimpleITK and DICOM have them."""

import os
import sys

import dicom_files as files
import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.filters import ImageFile
from elastoidentify.vtk_io.convert import all_texts, image_from_vtk

sitk = pytest.importorskip("SimpleITK", reason="needs SimpleITK: pip install SimpleITK")


@pytest.fixture
def oblique(random):
    """A turned image of another size, spacing and origin along every axis."""
    axes, _ = np.linalg.qr(random.normal(size=(3, 3)))
    image = sitk.GetImageFromArray(random.integers(0, 900, (4, 5, 6)).astype(np.int16))
    image.SetOrigin([5.0, -7.0, 11.0])
    image.SetSpacing([0.5, 0.75, 1.5])
    image.SetDirection((axes * np.sign(np.linalg.det(axes))).ravel().tolist())
    return image


def same_place(got, image, atol=1e-5):
    """NIfTI keeps its directions as numbers of single precision."""
    np.testing.assert_allclose(got.origin, image.GetOrigin(), atol=atol)
    np.testing.assert_allclose(got.spacing, image.GetSpacing(), atol=atol)
    np.testing.assert_allclose(got.direction.ravel(), image.GetDirection(), atol=atol)


@pytest.mark.parametrize("suffix", [".nrrd", ".nii.gz", ".nii", ".mha"])
def test_values_and_orientation_are_the_files(oblique, tmp_path, suffix):
    path = tmp_path / f"rest{suffix}"
    sitk.WriteImage(oblique, str(path))
    reader = ImageFile(file_names=path)
    reader.Update()
    got = image_from_vtk(reader.GetOutput())
    np.testing.assert_array_equal(got.array, sitk.GetArrayFromImage(oblique))
    same_place(got, oblique)
    assert reader.GetOutput().GetPointData().GetScalars().GetName() == "rest"


def test_a_dicom_folder_is_read_where_it_says(tmp_path):
    values = files.volume()
    files.write_series(tmp_path, values, files.oblique())
    reader = ImageFile(file_names=tmp_path)
    reader.Update()
    got = image_from_vtk(reader.GetOutput())
    np.testing.assert_array_equal(got.array, values)
    np.testing.assert_allclose(got.direction[:, :2].T, files.oblique(), atol=1e-6)


def test_a_segmentations_array_is_called_label(oblique, tmp_path):
    labels = sitk.Cast(sitk.Modulus(oblique, 4), sitk.sitkUInt8)
    for name, kind in (("a.nrrd", "segmentation"), ("b.seg.nrrd", "auto")):
        sitk.WriteImage(labels, str(tmp_path / name))
        reader = ImageFile(file_names=tmp_path / name, kind=kind)
        reader.Update()
        assert reader.GetOutput().GetPointData().GetScalars().GetName() == "Label"


def test_several_files_are_the_steps_of_a_series(oblique, tmp_path):
    paths = [tmp_path / f"pushed_{n}.nrrd" for n in (1, 2)]
    sitk.WriteImage(oblique, str(paths[0]))
    sitk.WriteImage(oblique + 1, str(paths[1]))
    reader = ImageFile(file_names=paths)
    first = sitk.GetArrayFromImage(oblique)
    for time in (1.0, 0.0):
        reader.UpdateTimeStep(time)
        data = reader.GetOutput()
        np.testing.assert_array_equal(image_from_vtk(data).array, first + int(time))
        assert data.GetPointData().GetScalars().GetName() == "pushed"


def test_steps_of_different_sizes_are_refused(oblique, tmp_path):
    paths = [tmp_path / f"pushed_{n}.nrrd" for n in (1, 2)]
    sitk.WriteImage(oblique, str(paths[0]))
    sitk.WriteImage(oblique[:, :, :2], str(paths[1]))
    reader = ImageFile(file_names=paths)
    with pytest.raises(InputError, match=r"pushed_2\.nrrd: has 6 × 5 × 2 voxels"):
        reader.UpdateTimeStep(1.0)
        reader._raise_first_error()


def test_a_damaged_file_is_refused_in_the_librarys_words_and_read_when_mended(
    oblique, tmp_path, messages
):
    from elastoidentify.imaging.io import read_image

    path = tmp_path / "rest.nrrd"
    sitk.WriteImage(oblique, str(path))
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    with pytest.raises(InputError) as library:
        read_image(path)
    reader = ImageFile(file_names=path)
    with pytest.raises(InputError) as filters:
        reader.Update()
    assert str(filters.value) == str(library.value)
    assert messages() == [f"ERROR: ImageFile: {library.value}"]
    path.write_bytes(whole)
    os.utime(path, (1, 1))
    reader.Modified()
    reader.Update()
    assert reader.GetOutput().GetNumberOfPoints() == 120


def test_no_file_is_said():
    with pytest.raises(InputError, match="no file given"):
        ImageFile().Update()


def test_what_was_assumed_is_a_warning(tmp_path):
    path = tmp_path / "photo.png"
    sitk.WriteImage(sitk.Image(4, 3, sitk.sitkUInt8), str(path))
    reader = ImageFile(file_names=path)
    with pytest.warns(UserWarning, match="the picture has no size"):
        reader.Update()
    assert len(all_texts(reader.GetOutput().GetFieldData().GetAbstractArray("Warnings"))) == 1


def test_without_the_packages_another_python_reads_and_refuses_alike(
    oblique, tmp_path, monkeypatch
):
    """As in ParaView: SimpleITK is in the Python that the launcher ran in."""
    from elastoidentify.workers import borrowed

    monkeypatch.setattr(borrowed.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setenv(borrowed.PYTHON_VARIABLE, sys.executable)
    path = tmp_path / "rest.nrrd"
    sitk.WriteImage(oblique, str(path))
    reader = ImageFile(file_names=path)
    reader.Update()
    same_place(image_from_vtk(reader.GetOutput()), oblique)
    path.write_bytes(path.read_bytes()[:-20])
    again = ImageFile(file_names=path)
    with pytest.raises(InputError, match="damaged or incomplete"):
        again.Update()
