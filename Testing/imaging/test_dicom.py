"""DICOM: the grid is what the files say, or one sentence says why there is none."""

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.io import read_image, read_segmentation

pytest.importorskip("pydicom", reason='needs pydicom: pip install ".[registration]"')
sitk = pytest.importorskip("SimpleITK")

from dicom_files import (  # noqa: E402
    AXIAL,
    CINE,
    CORONAL,
    CT,
    MR,
    SAGITTAL,
    US,
    dataset,
    enhanced,
    item,
    oblique,
    places,
    put_pixels,
    save,
    segmentation,
    structures,
    volume,
    write_series,
)  # fmt: skip

PLANES = {"axial": AXIAL, "coronal": CORONAL, "sagittal": SAGITTAL, "oblique": oblique()}


def assert_grid(image, values, positions, orientation, spacing=(0.8, 1.3), atol=1e-6):
    """Every voxel is where its file says that it is, whatever the order of the files."""
    normal = np.cross(*orientation)
    order = np.argsort(positions @ normal)
    assert np.array_equal(image.array, values[order])
    n, rows, columns = values.shape
    index = np.array([[i, j, k] for i in (0, columns - 1) for j in (0, rows - 1) for k in range(n)])
    where = positions[order][index[:, 2]]
    where = where + spacing[0] * index[:, :1] * orientation[0]
    where = where + spacing[1] * index[:, 1:2] * orientation[1]
    assert np.allclose(image.index_to_world(index), where, atol=atol)


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("step, digits", [(0.7, 13), (1.1, 2), (0.625, 6), (3.0, 13), (-2.2, 2)])
def test_a_series_is_where_its_files_say(tmp_path, plane, step, digits):
    values, orientation = volume(), PLANES[plane]
    order = np.random.default_rng(0).permutation(len(values))
    positions = write_series(tmp_path, values, orientation, step, digits=digits, order=order)
    atol = 2 * 10.0**-digits + 1e-6
    assert_grid(read_image(tmp_path), values, positions, orientation, atol=atol)


def test_positions_rounded_to_a_tenth_make_an_even_grid(tmp_path):
    positions = write_series(tmp_path, volume(12), step=1.25, digits=1)
    image = read_image(tmp_path)
    assert np.isclose(image.spacing[2], 1.25, rtol=0.01)
    assert np.allclose(image.origin, positions[0], atol=0.06)


def test_it_agrees_with_itk_where_that_is_right(tmp_path):
    write_series(tmp_path, volume(), oblique(), 3.0)
    names = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(tmp_path))
    itk, image = sitk.ReadImage(names), read_image(tmp_path)
    corner = (9, 7, 5)
    assert np.allclose(
        image.index_to_world(np.array([corner]))[0],
        itk.TransformIndexToPhysicalPoint(corner),
        atol=1e-5,
    )
    assert np.array_equal(image.array, sitk.GetArrayFromImage(itk))


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("gone", [1, 3, 4])
def test_a_missing_slice_is_named(tmp_path, plane, gone):
    write_series(tmp_path, volume(), PLANES[plane], 1.1, edit=lambda k, data: k != gone)
    with pytest.raises(
        InputError, match=f"not evenly spaced.*slices {gone} and {gone + 1}; 1 slice"
    ):
        read_image(tmp_path)


def test_the_gap_between_three_slices_is_found(tmp_path):
    write_series(tmp_path, volume(), step=3.0, edit=lambda k, data: k in (0, 1, 3))
    with pytest.raises(InputError, match="3 mm as a rule, 6 mm between slices 2 and 3; 1 slice"):
        read_image(tmp_path)


def test_every_second_slice_missing_is_noted_where_the_files_say_their_distance(tmp_path):
    def edit(k, data):
        data.SpacingBetweenSlices = "1.5"
        return k % 2 == 0

    write_series(tmp_path, volume(), step=1.5, edit=edit)
    image = read_image(tmp_path)
    assert np.isclose(image.spacing[2], 3) and "every second one" in image.notes[-1]


def test_files_without_preamble_are_dicom_too(tmp_path):
    from pydicom import dcmread

    values = volume()
    positions = write_series(tmp_path / "whole", values)
    (tmp_path / "bare").mkdir()
    for file in (tmp_path / "whole").iterdir():
        data = dcmread(file)
        del data.file_meta
        data.save_as(tmp_path / "bare" / file.stem, implicit_vr=True, little_endian=True)
    assert_grid(read_image(tmp_path / "bare"), values, positions, AXIAL)


def test_series_of_one_number_are_chosen_by_their_uid(tmp_path):
    for k, values in enumerate((volume(), volume() + 1000)):
        write_series(tmp_path, values, number=3, order=range(10 * k, 10 * k + 6))
    from pydicom import dcmread

    uid = dcmread(tmp_path / "010.dcm").SeriesInstanceUID
    with pytest.raises(InputError, match=f"2 DICOM series.*{uid[-8:]}"):
        read_image(tmp_path)
    for chosen in (uid, uid[-8:], f"…{uid[-8:]}"):
        assert np.array_equal(read_image(tmp_path, series=chosen).array, volume() + 1000)


def test_a_slice_missing_at_an_end_is_noted_where_the_series_counts(tmp_path):
    def edit(k, data):
        data.ImagesInAcquisition = 6
        return k != 5

    write_series(tmp_path, volume(), edit=edit)
    assert "6 images by its own count and 5" in read_image(tmp_path).notes[0]


@pytest.mark.parametrize("jitter", [0.2, 0.5])
def test_uneven_slices_are_refused(tmp_path, jitter):
    positions = places(6, AXIAL, 3.0)
    positions[3, 2] += 3 * jitter
    write_series(tmp_path, volume(), positions=positions)
    with pytest.raises(InputError, match="not evenly spaced"):
        read_image(tmp_path)


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("angle", [-20.0, 2.0, 12.5])
def test_a_gantry_tilt_is_refused_with_its_angle(tmp_path, plane, angle):
    orientation = PLANES[plane]
    positions = places(6, orientation, 3.0)
    shift = 3 * np.tan(np.radians(angle)) * np.arange(6)
    positions = positions + shift[:, None] * orientation[1]
    write_series(tmp_path, volume(), orientation, positions=positions, sop=CT, modality="CT")
    with pytest.raises(InputError, match=f"gantry tilt of {abs(angle):g}"):
        read_image(tmp_path)


def test_slices_shifted_one_by_one_are_refused(tmp_path):
    positions = places(6, AXIAL, 3.0)
    positions[2, 0] += 5
    write_series(tmp_path, volume(), positions=positions)
    with pytest.raises(InputError, match="shifted sideways"):
        read_image(tmp_path)


@pytest.mark.parametrize("same_uid", [True, False])
def test_a_slice_given_twice_is_taken_once_and_said(tmp_path, same_uid):
    values = volume()
    positions = write_series(tmp_path, values)

    def copy(k, data):
        return k == 2

    write_series(tmp_path / "again", values, edit=copy)
    from pydicom import dcmread

    again = dcmread(tmp_path / "again" / "002.dcm")
    first = dcmread(tmp_path / "002.dcm")
    again.SeriesInstanceUID = first.SeriesInstanceUID
    if same_uid:
        again.SOPInstanceUID = again.file_meta.MediaStorageSOPInstanceUID = first.SOPInstanceUID
    save(again, tmp_path / "copy.dcm")
    image = read_image(tmp_path)
    assert_grid(image, values, positions, AXIAL)
    assert "twice" in image.notes[0]
    again.PixelData = bytes(len(again.PixelData))
    again.SOPInstanceUID = "1.2.3.4"
    save(again, tmp_path / "copy.dcm")
    with pytest.raises(InputError, match="two different images at one place"):
        read_image(tmp_path)


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.95])
def test_a_cut_slice_is_named(tmp_path, share):
    write_series(tmp_path, volume())
    whole = (tmp_path / "003.dcm").read_bytes()
    (tmp_path / "003.dcm").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"003\.dcm") as error:
        read_image(tmp_path)
    assert "\n" not in str(error.value)


def test_an_empty_slice_is_named(tmp_path):
    write_series(tmp_path, volume())
    (tmp_path / "005.dcm").write_bytes(b"")
    with pytest.raises(InputError, match=r"005\.dcm.*empty"):
        read_image(tmp_path)


@pytest.mark.parametrize("other", ["coronal", "sagittal", "oblique"])
def test_a_localizer_in_another_orientation_is_refused(tmp_path, other):
    def edit(k, data):
        if k == 5:
            data.ImageOrientationPatient = [f"{x:.6f}" for x in PLANES[other].ravel()]

    write_series(tmp_path, volume(), edit=edit)
    with pytest.raises(InputError, match=f"more than one orientation.*5 axial, 1 .*{other[:6]}"):
        read_image(tmp_path)


def test_slices_of_another_size_are_refused(tmp_path):
    def edit(k, data):
        if k == 0:
            put_pixels(data, np.zeros((12, 12), np.uint16))

    write_series(tmp_path, volume(), edit=edit)
    with pytest.raises(InputError, match="several sizes"):
        read_image(tmp_path)


# ---- several series, several times


def test_several_series_are_listed_and_one_can_be_chosen(tmp_path):
    first, second = volume(), volume() + 1000

    def named(name):
        return lambda k, data: setattr(data, "SeriesDescription", name)

    one = write_series(tmp_path, first, number=4, edit=named("t1"))
    two = write_series(tmp_path, second, CORONAL, number=7, order=range(10, 16), edit=named("t2"))
    with pytest.raises(InputError, match=r"2 DICOM series.*4 \(t1, MR, axial, 6 slices\), 7 \(t2"):
        read_image(tmp_path)
    assert_grid(read_image(tmp_path, series="4"), first, one, AXIAL)
    assert_grid(read_image(tmp_path, series="T2"), second, two, CORONAL)
    with pytest.raises(InputError, match="no series '5'"):
        read_image(tmp_path, series="5")


@pytest.mark.parametrize(
    "key, values",
    [
        ("TemporalPositionIdentifier", [1, 2, 3]),
        ("EchoTime", ["4.6", "9.2", "13.8"]),
        ("AcquisitionTime", ["101500", "101600", "101700"]),
        (None, None),
    ],
)
def test_several_times_of_a_series_are_listed_and_one_can_be_chosen(tmp_path, key, values):
    whole = np.concatenate([volume(), volume() + 1000, volume() + 2000])
    positions = np.tile(places(6, AXIAL, 1.1), (3, 1))
    if key is None:  # only the numbers of the files tell them apart: slice by slice
        order = np.arange(18).reshape(3, 6).T.ravel()
        whole_now, positions_now = whole[order], positions[order]
    else:
        whole_now, positions_now = whole, positions

    def edit(k, data):
        if key:
            setattr(data, key, values[k // 6])

    write_series(tmp_path, whole_now, positions=positions_now, edit=edit)
    with pytest.raises(InputError, match=r"3 images at every place.*1:1.*1:2.*1:3"):
        read_image(tmp_path)
    assert_grid(read_image(tmp_path, series="1:2"), whole[6:12], positions[:6], AXIAL)


def test_files_that_are_no_images_do_not_matter(tmp_path):
    values = volume()
    positions = write_series(tmp_path, values)
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / ".hidden").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    assert_grid(read_image(tmp_path), values, positions, AXIAL)


# ---- scaling and pixels


def test_every_slice_has_its_own_scaling(tmp_path):
    def edit(k, data):
        data.RescaleSlope, data.RescaleIntercept = f"{0.5 + 0.25 * k}", f"{-k}"

    values = volume()
    write_series(tmp_path, values, edit=edit)
    k = np.arange(6)[:, None, None]
    assert np.allclose(read_image(tmp_path).array, values * (0.5 + 0.25 * k) - k)


def test_bits_beyond_the_stored_ones_are_no_grey_values(tmp_path):
    values = volume()

    def edit(k, data):
        put_pixels(data, values[k] | np.uint16(0xF000))
        data.BitsStored, data.HighBit = 12, 11

    write_series(tmp_path, values, edit=edit)
    assert np.array_equal(read_image(tmp_path).array, values & 0x0FFF)


@pytest.mark.parametrize("compressor", ["JPEG", "JPEG2000"])
@pytest.mark.parametrize("kind", ["one", "multi-frame", "grey as colours"])
def test_compressed_pixels_are_those_before(tmp_path, compressor, kind):
    values = volume(1 if kind == "one" else 5, 32, 32)
    image = sitk.GetImageFromArray(values)
    if kind == "grey as colours":
        values = values[:1].astype(np.uint8)
        image = sitk.GetImageFromArray(np.repeat(values[..., None], 3, axis=-1), isVector=True)
    image.SetSpacing((0.5, 0.7, 2.0))
    writer = sitk.ImageFileWriter()
    writer.SetFileName(str(tmp_path / "one.dcm"))
    writer.SetUseCompression(True)
    writer.SetCompressor(compressor)
    writer.Execute(image)
    from pydicom import dcmread

    assert dcmread(tmp_path / "one.dcm").file_meta.TransferSyntaxUID.is_compressed
    back = read_image(tmp_path / "one.dcm")
    assert np.array_equal(back.array, values)
    assert np.allclose(back.spacing[:2], [0.5, 0.7])


@pytest.mark.parametrize("slope", [None, 2.0])
def test_run_length_and_deflated_pixels_are_those_before(tmp_path, slope):
    from pydicom.uid import DeflatedExplicitVRLittleEndian, RLELossless

    values = volume()

    def edit(k, data):
        if slope:
            data.RescaleSlope, data.RescaleIntercept = slope, 1
        if k % 2:
            data.compress(RLELossless)
        else:
            data.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian

    positions = write_series(tmp_path, values, edit=edit)
    image = read_image(tmp_path)
    expected = values if slope is None else 2.0 * values + 1
    assert_grid(image, expected, positions, AXIAL)


def test_colours_are_refused_and_grey_ones_are_grey(tmp_path):
    values = np.random.default_rng(0).integers(0, 255, (8, 10, 3)).astype(np.uint8)
    for name, pixels in (("colour", values), ("grey", np.repeat(values[..., :1], 3, axis=2))):
        data = dataset(US, "US", bits=8)
        data.Rows, data.Columns = 8, 10
        data.SamplesPerPixel, data.PhotometricInterpretation = 3, "RGB"
        data.PlanarConfiguration, data.PixelData = 0, pixels.tobytes()
        save(data, tmp_path / f"{name}.dcm")
    assert np.array_equal(read_image(tmp_path / "grey.dcm").array[0], values[..., 0])
    with pytest.raises(InputError, match="colour"):
        read_image(tmp_path / "colour.dcm")


# ---- multi-frame


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("order", [None, [5, 4, 3, 2, 1, 0], [3, 0, 5, 1, 4, 2]])
def test_an_enhanced_file_is_where_its_frames_say(tmp_path, plane, order):
    values = volume()
    positions = enhanced(tmp_path / "one.dcm", values, PLANES[plane], 1.7, order=order)
    assert_grid(read_image(tmp_path / "one.dcm"), values, positions, PLANES[plane])
    assert_grid(read_image(tmp_path), values, positions, PLANES[plane])


def test_every_frame_has_its_own_scaling(tmp_path):
    def edit(data):
        for k, group in enumerate(data.PerFrameFunctionalGroupsSequence):
            scale = item(RescaleSlope=1.0 + k, RescaleIntercept=0.0)
            group.PixelValueTransformationSequence = [scale]

    values = volume()
    enhanced(tmp_path / "one.dcm", values, edit=edit)
    k = np.arange(6)[:, None, None]
    assert np.allclose(read_image(tmp_path / "one.dcm").array, values * (1.0 + k))


def test_an_enhanced_file_with_a_missing_frame_or_two_times_is_refused(tmp_path):
    def shift(data):
        place = data.PerFrameFunctionalGroupsSequence[3].PlanePositionSequence[0]
        place.ImagePositionPatient = [-20.3, 30.7, 50.0]

    enhanced(tmp_path / "gap.dcm", volume(), edit=shift)
    with pytest.raises(InputError, match="not evenly spaced"):
        read_image(tmp_path / "gap.dcm")

    def twice(data):
        groups = data.PerFrameFunctionalGroupsSequence
        for k, group in enumerate(groups):
            half = groups[k % 3].PlanePositionSequence[0].ImagePositionPatient
            group.PlanePositionSequence[0].ImagePositionPatient = list(half)
            group.FrameContentSequence[0].TemporalPositionIndex = 1 + k // 3
            group.FrameContentSequence[0].DimensionIndexValues = [1 + k // 3, 1 + k % 3]

    enhanced(tmp_path / "times.dcm", volume(), edit=twice)
    with pytest.raises(InputError, match="2 images at every place"):
        read_image(tmp_path / "times.dcm")
    assert np.array_equal(read_image(tmp_path / "times.dcm", series="1:2").array, volume()[3:])


def test_frames_of_a_plain_file_with_a_step_are_a_volume(tmp_path):
    data = dataset(MR)
    values = volume()
    put_pixels(data, values)
    data.PixelSpacing, data.SpacingBetweenSlices = [1.3, 0.8], 2.5
    data.ImagePositionPatient, data.ImageOrientationPatient = [1, 2, 3], [1, 0, 0, 0, 1, 0]
    save(data, tmp_path / "one.dcm")
    positions = np.array([[1, 2, 3 + 2.5 * k] for k in range(6)])
    assert_grid(read_image(tmp_path / "one.dcm"), values, positions, AXIAL)


def test_an_enhanced_ultrasound_volume_is_where_its_frames_say(tmp_path):
    def renamed(data):
        shared = data.SharedFunctionalGroupsSequence[0]
        turn = shared.PlaneOrientationSequence[0].ImageOrientationPatient
        del shared.PlaneOrientationSequence
        shared.PlaneOrientationVolumeSequence = [item(ImageOrientationVolume=turn)]
        for group in data.PerFrameFunctionalGroupsSequence:
            place = group.PlanePositionSequence[0].ImagePositionPatient
            del group.PlanePositionSequence
            group.PlanePositionVolumeSequence = [item(ImagePositionVolume=place)]

    values = volume()
    positions = enhanced(tmp_path / "us.dcm", values, edit=renamed)
    assert_grid(read_image(tmp_path / "us.dcm"), values, positions, AXIAL)


def test_a_film_is_no_volume_and_a_frame_of_it_can_be_chosen(tmp_path):
    data = dataset(CINE, "US", bits=8)
    values = volume().astype(np.uint8)
    put_pixels(data, values)
    data.FrameTime, data.FrameIncrementPointer = "33.3", 0x00181063
    save(data, tmp_path / "cine.dcm")
    with pytest.raises(InputError, match=r"film.*6 frames"):
        read_image(tmp_path / "cine.dcm")
    assert np.array_equal(read_image(tmp_path / "cine.dcm", frame=3).array[0], values[2])
    with pytest.raises(InputError, match="frames 1 to 6"):
        read_image(tmp_path / "cine.dcm", frame=7)


# ---- sizes of pixels


def region(dx, dy, units=3, kind=1):
    return item(
        RegionSpatialFormat=kind, RegionDataType=1, RegionFlags=0,
        RegionLocationMinX0=0, RegionLocationMinY0=0, RegionLocationMaxX1=9,
        RegionLocationMaxY1=7, PhysicalUnitsXDirection=units, PhysicalUnitsYDirection=units,
        PhysicalDeltaX=dx, PhysicalDeltaY=dy,
    )  # fmt: skip


def ultrasound(path, *regions):
    data = dataset(US, "US", bits=8)
    put_pixels(data, volume(1)[0].astype(np.uint8))
    if regions:
        data.SequenceOfUltrasoundRegions = list(regions)
    return save(data, path)


def test_ultrasound_has_the_pixel_size_of_its_regions(tmp_path):
    other = region(0.5, 0.5, units=4, kind=3)  # a spectrum: seconds and cm/s
    path = ultrasound(tmp_path / "us.dcm", region(0.05, -0.02), other, region(0.05, 0.02))
    image = read_image(path)
    assert np.allclose(image.spacing[:2], [0.5, 0.2])
    assert "ultrasound region" in image.notes[0]


def test_ultrasound_regions_of_different_scale_are_refused_and_none_is_said(tmp_path):
    with pytest.raises(InputError, match="different pixel sizes"):
        read_image(ultrasound(tmp_path / "us.dcm", region(0.05, 0.02), region(0.04, 0.02)))
    image = read_image(ultrasound(tmp_path / "none.dcm"))
    assert image.spacing[:2].tolist() == [1, 1] and "no pixel size" in image.notes[0]


# ---- segmentations


def labels_of_block():
    labels = np.zeros((6, 8, 10), np.uint8)
    labels[0:2, 1:5, 2:9], labels[4:6, 3:7, 1:6] = 1, 2  # slices 2 and 3 are empty
    return labels


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("kind", ["BINARY", "FRACTIONAL"])
def test_a_segmentation_object_is_a_labelmap_with_names(tmp_path, plane, kind):
    labels, names = labels_of_block(), {1: "tissue", 2: "inclusion"}
    path = segmentation(tmp_path / "seg.dcm", labels, names, PLANES[plane], 1.1, kind=kind)
    image, found = read_segmentation(path)
    assert found == names
    assert_grid(image, labels, places(6, PLANES[plane], 1.1), PLANES[plane])
    for one in (path, tmp_path):
        with pytest.raises(InputError, match="segmentation object"):
            read_image(one)
    assert np.array_equal(read_segmentation(tmp_path)[0].array, labels)


def test_a_segmentation_beside_its_images_is_found_and_not_taken_for_an_image(tmp_path):
    values = volume()
    positions = write_series(tmp_path, values)
    segmentation(tmp_path / "seg.dcm", labels_of_block(), {1: "a", 2: "b"})
    assert_grid(read_image(tmp_path), values, positions, AXIAL)
    assert np.array_equal(read_segmentation(tmp_path)[0].array, labels_of_block())


def circle(radius, centre, k, image, n=60):
    angle = 2 * np.pi * np.arange(n) / n
    index = np.column_stack(
        [centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle), np.full(n, k)]
    )
    return image.index_to_world(index)


@pytest.mark.parametrize("plane", PLANES)
def test_contours_are_filled_on_the_images_grid_with_holes(tmp_path, plane):
    orientation = PLANES[plane]
    direction = np.column_stack([*orientation, np.cross(*orientation)])
    image = Image(np.zeros((5, 40, 50), np.uint8), [3, -4, 5], [0.8, 1.3, 2], direction)
    contours = [(3, circle(12, (20, 18), k, image)) for k in (1, 2, 3)]
    contours += [(3, circle(5, (20, 18), k, image)) for k in (1, 2, 3)]
    contours += [(8, circle(4, (40, 30), 2, image))]
    path = structures(tmp_path / "rt.dcm", contours, {3: "ring", 8: "dot", 9: "nothing"})
    labels, names = read_segmentation(path, image)
    assert names == {1: "ring", 2: "dot"}
    j, i = np.mgrid[:40, :50]
    r = np.hypot(i - 20, j - 18)
    ring = (r < 12) & (r > 5)
    sure = (np.abs(r - 12) > 0.1) & (np.abs(r - 5) > 0.1)
    for k in range(5):
        assert np.array_equal((labels.array[k] == 1)[sure], (ring & (k in (1, 2, 3)))[sure])
    assert (labels.array[2] == 2).sum() == pytest.approx(np.pi * 16, rel=0.1)
    assert np.allclose(labels.axes, image.axes) and "nothing" in labels.notes[-1]


@pytest.mark.parametrize("plane", PLANES)
def test_contours_without_an_image_have_the_right_volume(tmp_path, plane):
    orientation = PLANES[plane]
    direction = np.column_stack([*orientation, np.cross(*orientation)])
    image = Image(np.zeros((9, 9, 9)), [3, -4, 5], [1, 1, 2], direction)
    contours = [(1, circle(20, (0, 0), k, image, 200)) for k in range(6)]
    labels, _ = read_segmentation(structures(tmp_path / "rt.dcm", contours, {1: "cylinder"}))
    found = np.count_nonzero(labels.array) * labels.spacing.prod()
    assert found == pytest.approx(np.pi * 400 * 6 * 2, rel=0.01)
    centre = labels.index_to_world(np.argwhere(labels.array)[:, ::-1]).mean(axis=0)
    assert np.allclose(centre, image.index_to_world(np.array([[0, 0, 2.5]])), atol=0.2)
    with pytest.raises(InputError, match="RTSTRUCT"):
        read_image(tmp_path / "rt.dcm")
