"""What DICOM maps refer to: the files of the rest image, or a series made of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..imaging.image import Image
from ..imaging.io.dicom import SEGMENTATION_CLASSES, files_of, frames_of, header, is_dicom

SECONDARY_CAPTURE = "1.2.840.10008.5.1.4.1.1.7"
NEEDED = (
    "PatientID", "PatientName", "PatientBirthDate", "PatientSex", "AccessionNumber", "StudyID",
    "StudyDate", "StudyTime", "ReferringPhysicianName",
)  # fmt: skip
"""Attributes that a map takes over; they may be empty."""

SAME_PLACE = 0.05  # of a voxel
SAME_DIRECTION = 2e-3  # radians


@dataclass(frozen=True)
class Person:
    """Whom a series made of a rest image without DICOM is about; empty: not said."""

    identifier: str = ""
    name: str = ""
    birth_date: str = ""
    sex: str = ""


def reference_of(files: Sequence, frames: Image) -> list:
    """Return the headers of the rest image's files, in the order of the frames.

    Parameters
    ----------
    files : sequence of paths
        Files or folders; of a folder with several series those files are taken that lie on the
        frames.
    frames : Image
        The grid that was read from them, its axis k across the slices.

    Raises
    ------
    InputError
        No DICOM image, no frame of reference, or nothing that lies on the grid.
    """
    paths = [file for path in files for file in _of(Path(path))]
    series = {}
    for path in paths:
        data = header(path)
        if "Rows" in data and str(data.get("SOPClassUID", "")) not in SEGMENTATION_CLASSES:
            series.setdefault(str(data.get("SeriesInstanceUID", "")), []).append(data)
    if not series:
        raise InputError(f"{files[0]}: holds no DICOM image that the maps could refer to")
    matching = [found for group in series.values() if (found := _on(group, frames))]
    if len(matching) != 1:
        raise InputError(
            f"{files[0]}: {len(matching)} DICOM series lie on the grid of the rest image; give the "
            "files of the one that it was read from"
        )
    for data in matching[0]:
        _complete(data)
    if "FrameOfReferenceUID" not in matching[0][0]:
        raise InputError(
            f"{files[0]}: has no frame of reference, so no map can be placed on it; leave the "
            "files out, and the rest image is written as a series of its own"
        )
    return matching[0]


def _of(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if not is_dicom(path):
        raise InputError(f"{path}: is no DICOM file, to which the maps could refer")
    return files_of(path)


def _on(group, grid: Image) -> list:
    """Return the files of a series that make up the grid, by their place; none if any lacks."""
    placed, seen = [], set()
    for data in group:
        where = [
            place for frame in frames_of(data) if (place := _slice_of(frame, grid)) is not None
        ]
        if where:
            placed.append((min(where), data))
            seen.update(where)
    placed.sort(key=lambda pair: pair[0])
    first = {}
    for place, data in placed:
        first.setdefault(place, data)  # of several times or echoes at a place, the first one
    if len(seen) < grid.size[2]:
        return []
    return list({id(data): data for data in first.values()}.values())


def _slice_of(frame, grid: Image) -> int | None:
    """Return the number of the grid's slice that a frame is, None where it is none."""
    if frame.position is None or frame.orientation is None:
        return None
    normal = np.cross(*frame.orientation)
    if abs(normal @ grid.direction[:, 2]) < np.cos(SAME_DIRECTION):
        return None
    columns, rows = frame.size
    middle = frame.position + frame.orientation.T @ (
        (np.array([columns, rows]) - 1) / 2 * frame.spacing
    )
    index = grid.world_to_index(middle[None])[0]
    wanted = (np.array(grid.size[:2]) - 1) / 2
    number = round(float(index[2]))
    off = np.abs(index - [*wanted, number]).max()
    return number if off < SAME_PLACE and 0 <= number < grid.size[2] else None


def _complete(data) -> None:
    """Give a header the attributes that a map takes over, empty where it has none."""
    for keyword in NEEDED:
        if keyword not in data:
            setattr(data, keyword, "")


def reference_series(frames: Image, person: Person, number: int) -> list:
    """Return the rest image as a DICOM series of secondary captures, a Dataset per slice.

    The modality that took it is not known, so none is claimed. Grey values become whole numbers
    of 16 bits, with the scaling that leads back.

    Parameters
    ----------
    frames : Image
        Right-handed, its axis k across the slices, in mm.
    person : Person
    number : int
        Of the series.
    """
    from pydicom.uid import generate_uid

    now = datetime.now()
    stored, slope, intercept = _sixteen_bits(frames.array)
    uids = {name: generate_uid() for name in ("study", "series", "place")}
    return [
        _capture(frames, k, stored[k], (slope, intercept), person, uids, number, now)
        for k in range(frames.size[2])
    ]


def _sixteen_bits(array: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Return whole numbers and the slope and intercept that make the values of them."""
    values = np.nan_to_num(np.asarray(array, float))
    low, high = float(values.min()), float(values.max())
    whole = np.issubdtype(array.dtype, np.integer) and low >= 0 and high < 1 << 16
    if whole or array.dtype == bool:
        return values.astype(np.uint16), 1.0, 0.0
    slope = float(f"{(high - low) / 65535 or 1.0:.9g}")  # as DICOM writes it: 16 characters
    low = float(f"{low:.9g}")
    return np.clip(np.rint((values - low) / slope), 0, 65535).astype(np.uint16), slope, low


def _capture(frames: Image, k: int, pixels, scaling, person: Person, uids, number, now):
    """Return slice k as secondary capture."""
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.uid import ExplicitVRLittleEndian, generate_uid
    from pydicom.valuerep import format_number_as_ds as text

    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = SECONDARY_CAPTURE
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
    data.SpecificCharacterSet = "ISO_IR 192"
    data.PatientID, data.PatientName = person.identifier, person.name
    data.PatientBirthDate, data.PatientSex = person.birth_date, person.sex
    data.StudyInstanceUID, data.SeriesInstanceUID = uids["study"], uids["series"]
    data.FrameOfReferenceUID, data.PositionReferenceIndicator = uids["place"], ""
    data.StudyDate, data.StudyTime = now.strftime("%Y%m%d"), now.strftime("%H%M%S")
    data.StudyID, data.AccessionNumber, data.ReferringPhysicianName = "", "", ""
    data.Modality, data.ConversionType = "OT", "WSD"
    data.ImageType = ["DERIVED", "SECONDARY"]
    data.SeriesNumber, data.InstanceNumber = number, k + 1
    data.SeriesDescription = "Rest image"
    data.PatientOrientation, data.Laterality = "", ""
    data.ImagePositionPatient = [text(v) for v in (frames.origin + k * frames.axes[:, 2]).tolist()]
    data.ImageOrientationPatient = [text(v) for v in frames.direction[:, :2].T.ravel().tolist()]
    data.PixelSpacing = [text(v) for v in frames.spacing[[1, 0]].tolist()]
    data.SliceThickness = text(float(frames.spacing[2]))
    data.SpacingBetweenSlices = text(float(frames.spacing[2]))
    data.RescaleSlope, data.RescaleIntercept, data.RescaleType = *map(text, scaling), "US"
    data.Rows, data.Columns = pixels.shape
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 0
    data.PixelData = np.ascontiguousarray(pixels, "<u2").tobytes()
    return data
