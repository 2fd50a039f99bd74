"""DICOM files made from scratch for tests: series, enhanced, segmentations, structure sets."""

from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

CT, MR = "1.2.840.10008.5.1.4.1.1.2", "1.2.840.10008.5.1.4.1.1.4"
ENHANCED_MR = "1.2.840.10008.5.1.4.1.1.4.1"
US, CINE = "1.2.840.10008.5.1.4.1.1.6.1", "1.2.840.10008.5.1.4.1.1.3.1"
SEG, STRUCTURES = "1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.481.3"

AXIAL = np.array([[1.0, 0, 0], [0, 1, 0]])
CORONAL = np.array([[1.0, 0, 0], [0, 0, -1]])
SAGITTAL = np.array([[0, 1.0, 0], [0, 0, -1]])


def oblique(a=0.3, b=0.5):
    """Return the axial directions turned about z, then x."""
    about_z = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
    about_x = [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    return AXIAL @ (np.array(about_z) @ np.array(about_x)).T


def volume(n=6, rows=8, columns=10):
    """Return different values in every voxel, (n, rows, columns) uint16."""
    return np.arange(n * rows * columns, dtype=np.uint16).reshape(n, rows, columns)


def text(value, digits=13):
    """Return a number as DICOM writes it: rounded, at most 16 characters."""
    return f"{float(value):.{digits}f}"[:16] if digits < 13 else f"{float(value):.13g}"[:16]


def dataset(sop=MR, modality="MR", series=None, number=1, bits=16, instance=1):
    """Return a Dataset without pixels and place."""
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = sop
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.Modality, data.PatientName, data.PatientID = modality, "Made^Up", "0"
    data.StudyInstanceUID, data.SeriesInstanceUID = "1.2.3", series or generate_uid()
    data.SeriesNumber, data.InstanceNumber = number, instance
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.PixelRepresentation, data.BitsAllocated, data.BitsStored = 0, bits, bits
    data.HighBit = bits - 1
    return data


def put_pixels(data, array):
    """Give a Dataset its pixels, (rows, columns) or (frames, rows, columns)."""
    data.Rows, data.Columns = array.shape[-2:]
    if array.ndim == 3:
        data.NumberOfFrames = len(array)
    data.PixelData = array.tobytes() + b"\0" * (array.nbytes % 2)


def save(data, path):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    data.save_as(path, enforce_file_format=True)
    return Path(path)


def places(n, orientation, step, origin=(-20.3, 30.7, 15.1)):
    """Return the positions of n slices."""
    normal = np.cross(*orientation)
    return np.asarray(origin) + step * np.arange(n)[:, None] * normal


def write_series(
    folder, values, orientation=AXIAL, step=3.0, positions=None, spacing=(0.8, 1.3), digits=13,
    edit=None, order=None, **kind,
):  # fmt: skip
    """Write a series of single slices; `spacing` along i and j. `edit(k, data)` changes a file."""
    uid = generate_uid()
    positions = places(len(values), orientation, step) if positions is None else positions
    for k, (image, position) in enumerate(zip(values, positions, strict=True)):
        data = dataset(series=uid, instance=k + 1, **kind)
        put_pixels(data, image)
        data.PixelSpacing = [text(spacing[1]), text(spacing[0])]
        data.ImagePositionPatient = [text(x, digits) for x in position]
        data.ImageOrientationPatient = [text(x) for x in np.ravel(orientation)]
        data.SliceThickness = text(abs(step))
        name = k if order is None else order[k]
        if edit is None or edit(k, data) is not False:
            save(data, Path(folder) / f"{name:03d}.dcm")
    return positions


def item(**values):
    data = Dataset()
    for name, value in values.items():
        setattr(data, name, value)
    return data


def enhanced(path, values, orientation=AXIAL, step=2.0, spacing=(0.8, 1.3), order=None, edit=None):
    """Write an enhanced multi-frame file with its frames in any order."""
    data = dataset(ENHANCED_MR)
    order = np.arange(len(values)) if order is None else np.asarray(order)
    put_pixels(data, values[order])
    positions = places(len(values), orientation, step)
    turn = item(ImageOrientationPatient=[float(x) for x in np.ravel(orientation)])
    measures = item(PixelSpacing=[spacing[1], spacing[0]], SliceThickness=step)
    data.SharedFunctionalGroupsSequence = Sequence(
        [item(PlaneOrientationSequence=[turn], PixelMeasuresSequence=[measures])]
    )
    groups = []
    for k in order:
        place = item(ImagePositionPatient=[float(x) for x in positions[k]])
        content = item(DimensionIndexValues=[1, int(k) + 1])
        groups.append(item(PlanePositionSequence=[place], FrameContentSequence=[content]))
    data.PerFrameFunctionalGroupsSequence = Sequence(groups)
    if edit:
        edit(data)
    save(data, path)
    return positions


def segmentation(
    path, labels, names, orientation=AXIAL, step=3.0, spacing=(0.8, 1.3), kind="BINARY"
):
    """Write a SEG object of labels (n, rows, columns): a frame per segment and slice it is in."""
    data = dataset(SEG, "SEG", bits=1 if kind == "BINARY" else 8)
    data.SegmentationType = kind
    data.MaximumFractionalValue = 200
    data.SegmentSequence = Sequence(
        [item(SegmentNumber=n, SegmentLabel=name) for n, name in names.items()]
    )
    positions, frames, groups = places(len(labels), orientation, step), [], []
    for number in names:
        for k, plane in enumerate(labels == number):
            if plane.any():
                frames.append(plane)
                place = item(ImagePositionPatient=[float(x) for x in positions[k]])
                which = item(ReferencedSegmentNumber=number)
                group = {"PlanePositionSequence": [place], "SegmentIdentificationSequence": [which]}
                groups.append(item(**group))
    turn = item(ImageOrientationPatient=[float(x) for x in np.ravel(orientation)])
    measures = item(PixelSpacing=[spacing[1], spacing[0]], SpacingBetweenSlices=step)
    data.SharedFunctionalGroupsSequence = Sequence(
        [item(PlaneOrientationSequence=[turn], PixelMeasuresSequence=[measures])]
    )
    data.PerFrameFunctionalGroupsSequence = Sequence(groups)
    stacked = np.array(frames)
    put_pixels(data, stacked)
    if kind == "BINARY":
        packed = np.packbits(stacked.ravel(), bitorder="little").tobytes()
        data.PixelData = packed + b"\0" * (len(packed) % 2)
    else:
        put_pixels(data, np.where(stacked, 150, 20).astype(np.uint8))
    return save(data, path)


def structures(path, contours, names):
    """Write a structure set; `contours` are (number, points (n, 3))."""
    data = dataset(STRUCTURES, "RTSTRUCT")
    data.StructureSetROISequence = Sequence(
        [item(ROINumber=number, ROIName=name) for number, name in names.items()]
    )
    data.ROIContourSequence = Sequence([])
    for number in names:
        shapes = [
            item(
                ContourGeometricType="CLOSED_PLANAR",
                NumberOfContourPoints=len(points),
                ContourData=[text(x) for x in np.ravel(points)],
            )
            for n, points in contours
            if n == number
        ]
        data.ROIContourSequence.append(
            item(ReferencedROINumber=number, ContourSequence=Sequence(shapes))
        )
    return save(data, path)
