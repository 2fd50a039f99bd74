"""NIfTI maps, read back by nibabel, which shares no code with the writer."""

import json

import nibabel
import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.export.convert import convert
from elastoidentify.export.nifti import write_nifti
from elastoidentify.imaging.io import read_image, write_image
from export_grids import boxes, directions, expected, grid

LPS = np.diag([-1, -1, 1, 1.0])


def affine(image):
    """Index → RAS, as NIfTI has it."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = image.axes, image.origin
    return LPS @ matrix


@pytest.mark.parametrize("direction", list(directions()))
def test_values_and_places_come_back_in_every_orientation(tmp_path, direction):
    image = grid(direction)
    made = boxes(image)
    write_nifti(tmp_path / "case", made, image, ["Mu"])
    back = nibabel.load(tmp_path / "case_mu.nii.gz")
    np.testing.assert_allclose(back.affine, affine(image), atol=1e-4)
    wanted = expected(image, made.values["Mu"])
    np.testing.assert_allclose(back.get_fdata().T, wanted, rtol=1e-6)


def test_every_image_has_a_sidecar_with_units_and_provenance(tmp_path):
    image = grid(np.eye(3))
    files = write_nifti(tmp_path / "case", boxes(image, unit="kPa"), image)
    names = {file.name for file in files}
    ends = ("mu", "mu_std", "E", "E_std", "status", "label")
    assert names == {f"case_{end}.{s}" for end in ends for s in ("nii.gz", "json")}
    assert sorted(names) == sorted(file.name for file in tmp_path.iterdir())
    facts = json.loads((tmp_path / "case_mu.json").read_text(encoding="utf-8"))
    assert facts["Units"] == "kPa" and facts["Quantity"] == "shear modulus"
    assert facts["GeneratedBy"]["Version"] == "9.9"
    assert facts["GeneratedBy"]["Provenance"]["inputs"]["rest"]["sha256"] == "00"
    levels = json.loads((tmp_path / "case_label.json").read_text(encoding="utf-8"))["Levels"]
    assert levels["3"] == "inclusion"


def test_labels_and_status_are_whole_numbers_with_zero_outside(tmp_path):
    image = grid(np.eye(3))
    made = boxes(image)
    write_nifti(tmp_path / "case", made, image)
    for name, values in (("status", made.status), ("label", made.labels)):
        back = nibabel.load(tmp_path / f"case_{name}.nii.gz")
        assert back.get_data_dtype() == np.uint8
        assert np.array_equal(np.asarray(back.dataobj).T, expected(image, values, outside=0))


def test_a_mesh_in_metres_is_placed_in_millimetres(tmp_path):
    image = grid(np.eye(3))
    write_nifti(tmp_path / "case", boxes(image, length_unit="m"), image, ["Mu"])
    back = nibabel.load(tmp_path / "case_mu.nii.gz")
    np.testing.assert_allclose(back.affine[:3], 1000 * affine(image)[:3], rtol=1e-6)


def test_a_quantity_that_is_none_is_refused(tmp_path):
    image = grid(np.eye(3))
    with pytest.raises(InputError, match="'stiffness': no such quantity; there are Mu"):
        write_nifti(tmp_path / "case", boxes(image), image, ["stiffness"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".nrrd", ".nii.gz", ".nii", ".mha"])
def test_an_image_is_the_same_in_every_format_that_is_written(tmp_path, suffix):
    image = grid(list(directions())[13])
    write_image(tmp_path / "in.nrrd", image)
    convert(tmp_path / "in.nrrd", tmp_path / f"out{suffix}")
    back = read_image(tmp_path / f"out{suffix}")
    assert np.array_equal(back.array, image.array)
    np.testing.assert_allclose(back.axes, image.axes, atol=1e-5)
    np.testing.assert_allclose(back.origin, image.origin, atol=1e-4)


def test_a_format_that_is_not_written_is_refused(tmp_path):
    write_image(tmp_path / "in.nrrd", grid(np.eye(3)))
    with pytest.raises(InputError, match=r"images are written as \.nrrd"):
        convert(tmp_path / "in.nrrd", tmp_path / "out.png")
