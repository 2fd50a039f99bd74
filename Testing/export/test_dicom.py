"""DICOM maps: right by the checkers, and read back by other programs as they were."""

import dicom_files
import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.export.dicom_reference import Person
from elastoidentify.imaging.io import read_image
from elastoidentify.imaging.slices import slice_of_image
from export_grids import TURN, boxes, directions, expected, grid

pytest.importorskip("highdicom", reason="needs highdicom: pip install .[dicom]")

import dicom_maps
import pydicom
import SimpleITK as sitk
from elastoidentify.export.cell_map import CellMap
from elastoidentify.export.dicom import write_dicom
from elastoidentify.fem.forward import square_mesh


def planar(image, axis=None):
    """A map of triangles in a planar image, 2 … 5 along its first two axes."""
    axis = image.planar_axis if axis is None else axis
    points, cells = square_mesh(3, 3, 3.0, 3.0)
    points = image.index_to_world(np.insert(points + 1.6, axis, 0.0, axis=1))
    mu = np.linspace(1000.0, 2000.0, len(cells))
    return CellMap(
        points, [("triangle", cells)], {"Mu": mu, "MuStd": mu / 9}, np.full(len(cells), 2),
        np.ones(len(cells), int),
    )  # fmt: skip


def by_itk(file):
    """Return index → world and values of a file, by SimpleITK."""
    image = sitk.ReadImage(str(file))
    place = np.eye(4)
    place[:3, :3] = np.reshape(image.GetDirection(), (3, 3)) * image.GetSpacing()
    place[:3, 3] = image.GetOrigin()
    return place, sitk.GetArrayFromImage(image)


def check_pydicom(folder, made, image):
    for name, quantity in (("mu", "Mu"), ("mu_std", "MuStd")):
        found = dicom_maps.map_by_pydicom(folder / f"{name}.dcm", image)
        wanted = expected(image, made.values[quantity]) / 1000
        np.testing.assert_allclose(found, wanted, rtol=1e-5)
    labels = expected(image, made.labels, outside=0)
    for number, mask in dicom_maps.labels_by_pydicom(folder / "labels.dcm", image).items():
        assert np.array_equal(mask, labels == number)
    lacking = dicom_maps.labels_by_pydicom(folder / "not_determined.dcm", image)[1]
    assert np.array_equal(lacking, expected(image, made.status, outside=9) == 0)


@pytest.mark.parametrize("number", range(0, 96, 7))
def test_pydicom_reads_values_and_places_back(tmp_path, number):
    image = grid(list(directions())[number])
    made = boxes(image)
    write_dicom(tmp_path, made, image)
    check_pydicom(tmp_path, made, image)


@pytest.mark.slow
@pytest.mark.parametrize("turned", [False, True])
def test_every_axis_order_and_flip_comes_back_by_pydicom_and_dcmqi(tmp_path, turned):
    chosen = list(directions())[1::8] if turned else list(directions())[::2]
    for number, direction in enumerate(chosen):
        image, folder = grid(direction), tmp_path / str(number)
        made = boxes(image)
        write_dicom(folder, made, image)
        check_pydicom(folder, made, image)
        volume = by_itk(dicom_maps.volume_by_dcmqi(folder / "mu.dcm", folder / "map"))
        wanted = expected(image, made.values["Mu"]) / 1000
        np.testing.assert_allclose(dicom_maps.on_grid([volume], image), wanted, rtol=1e-5)
        segments = dicom_maps.segments_by_dcmqi(folder / "labels.dcm", folder / "labels")
        assert sorted(segments) == [1, 2, 3]
        for label, file in segments.items():
            mask = dicom_maps.on_grid([by_itk(file)], image) > 0
            assert np.array_equal(mask, expected(image, made.labels, outside=0) == label)


@pytest.mark.parametrize("direction", [np.eye(3), TURN * [1, 1, -1]])
def test_dciodvfy_finds_no_error(tmp_path, direction):
    image = grid(direction)
    files = write_dicom(tmp_path, boxes(image, unit="kPa"), image)
    assert {file.name: found for file in files if (found := dicom_maps.errors(file))} == {}


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_planar_image_of_any_orientation_is_one_frame(tmp_path, axis):
    image = slice_of_image(grid(TURN, size=(7, 6, 5)), axis, 2)
    made = planar(image)
    files = write_dicom(tmp_path, made, image)
    assert {file.name for file in files} == {"rest_0001.dcm", "mu.dcm", "mu_std.dcm", "labels.dcm"}
    found = dicom_maps.map_by_pydicom(tmp_path / "mu.dcm", image)
    assert found.shape == image.array.shape and np.isfinite(found).sum() == 9
    assert np.nanmin(found) >= 1.0 and np.nanmax(found) <= 2.0
    assert all(dicom_maps.errors(file) == [] for file in files)


def test_unit_quantity_and_method_are_said_in_codes(tmp_path):
    image = grid(np.eye(3))
    write_dicom(tmp_path, boxes(image), image, quantity="YoungModulus")
    data = pydicom.dcmread(tmp_path / "E_std.dcm")
    mapping = data.SharedFunctionalGroupsSequence[0].RealWorldValueMappingSequence[0]
    unit = mapping.MeasurementUnitsCodeSequence[0]
    assert (unit.CodeValue, unit.CodingSchemeDesignator) == ("kPa", "UCUM")
    first, *more = mapping.QuantityDefinitionSequence
    quantity = first.ConceptCodeSequence[0]
    assert (quantity.CodeValue, quantity.CodingSchemeDesignator) == ("110830", "DCM")
    said = {item.ConceptNameCodeSequence[0].CodeMeaning: item for item in more}
    assert said["Derivation"].ConceptCodeSequence[0].CodeMeaning == "Standard Deviation"
    assert "Young's modulus" in said["Measurement Method"].TextValue
    assert "neo-hookean" in said["Measurement Method"].TextValue
    assert said["Algorithm Version"].TextValue == "9.9"
    assert '"sha256": "00"' in said["Algorithm Parameters"].TextValue
    assert mapping.RealWorldValueSlope == 1 and mapping.RealWorldValueIntercept == 0


@pytest.mark.parametrize("orientation", [dicom_files.AXIAL, dicom_files.oblique()])
def test_a_map_refers_to_the_series_of_the_rest_image(tmp_path, orientation):
    def edit(_, data):
        data.SpecificCharacterSet, data.PatientName = "ISO_IR 100", "Müller^Jörg"
        data.FrameOfReferenceUID = "1.2.3.4"
        if "PatientSex" in data:
            del data.PatientSex

    values = dicom_files.volume()
    dicom_files.write_series(tmp_path / "rest", values, orientation, edit=edit)
    image = read_image(tmp_path / "rest")
    made = boxes(image)
    files = write_dicom(tmp_path / "out", made, image, rest_files=[tmp_path / "rest"])
    assert not [file for file in files if file.name.startswith("rest")]
    check_pydicom(tmp_path / "out", made, image)
    originals = [pydicom.dcmread(file) for file in (tmp_path / "rest").iterdir()]
    at = {tuple(np.round(one.ImagePositionPatient, 6)): one.SOPInstanceUID for one in originals}
    data = pydicom.dcmread(tmp_path / "out" / "mu.dcm")
    assert str(data.PatientName) == "Müller^Jörg"
    assert data.StudyInstanceUID == originals[0].StudyInstanceUID
    assert data.FrameOfReferenceUID == "1.2.3.4"
    for frame in data.PerFrameFunctionalGroupsSequence:
        place = tuple(np.round(frame.PlanePositionSequence[0].ImagePositionPatient, 6))
        (source,) = frame.DerivationImageSequence[0].SourceImageSequence
        assert source.ReferencedSOPInstanceUID == at[place]
    assert all(dicom_maps.errors(file) == [] for file in files)


def test_files_of_another_image_are_refused(tmp_path):
    dicom_files.write_series(tmp_path / "rest", dicom_files.volume(), step=3.0)
    dicom_files.write_series(tmp_path / "other", dicom_files.volume(), step=3.5)
    image = read_image(tmp_path / "rest")
    with pytest.raises(InputError, match="0 DICOM series lie on the grid of the rest image"):
        write_dicom(tmp_path / "out", boxes(image), image, rest_files=[tmp_path / "other"])
    assert not (tmp_path / "out").exists()


def test_a_rest_image_without_dicom_becomes_a_series_that_is_read_back(tmp_path):
    image = grid(TURN)
    image = image.with_array(image.array / 7.0 - 20.0)
    files = write_dicom(tmp_path / "out", boxes(image), image, person=Person("42", "Doe^Jane"))
    rest = [file for file in files if file.name.startswith("rest")]
    (tmp_path / "series").mkdir()
    for file in rest:
        file.rename(tmp_path / "series" / file.name)
    back = read_image(tmp_path / "series")
    step = np.ptp(image.array) / 65535
    np.testing.assert_allclose(back.array, image.array, atol=step)
    np.testing.assert_allclose(back.origin, image.origin, atol=1e-3)
    data = pydicom.dcmread(tmp_path / "out" / "mu.dcm")
    assert (data.PatientID, str(data.PatientName)) == ("42", "Doe^Jane")


def test_a_unit_that_is_unknown_is_refused(tmp_path):
    image = grid(np.eye(3))
    with pytest.raises(InputError, match="unit 'stone': not known"):
        write_dicom(tmp_path / "out", boxes(image, unit="stone"), image)
    assert not (tmp_path / "out").exists()
