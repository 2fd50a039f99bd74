"""DICOM images: one file, or the slices of a folder, put together by what the files say.

ITK's series reader takes the step between the first two slices for all, and knows neither missing
nor tilted slices nor several images per place. So positions, orientations, sizes and scalings are
read here from every file (and from every frame of an enhanced one) and compared. pydicom unpacks
plain and run-length pixels; for the other compressions GDCM does it, by way of SimpleITK.

Source of the attributes: DICOM PS3.3, C.7.6.2 (image plane), C.7.6.16 (functional groups), C.8.5.5
(ultrasound regions), C.11.1 (modality LUT).
"""

import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...installation import needs
from ..image import Image
from .damage import Damaged, damaged, heard
from .itk import grey, simpleitk
from .stack import Frame, orientation_name, same_place, stack

SEGMENTATION_CLASSES = {
    "1.2.840.10008.5.1.4.1.1.66.4": "segmentation object (SEG)",
    "1.2.840.10008.5.1.4.1.1.66.7": "segmentation object (SEG)",
    "1.2.840.10008.5.1.4.1.1.66.5": "surface segmentation object",
    "1.2.840.10008.5.1.4.1.1.481.3": "structure set (RTSTRUCT)",
}
DIRECTORY_CLASS = "1.2.840.10008.1.3.10"
SECONDARY = {8: "1.2.840.10008.5.1.4.1.1.7.2", 16: "1.2.840.10008.5.1.4.1.1.7.3"}
COLOURS = "1.2.840.10008.5.1.4.1.1.7.4"
DECODED_BY_PYDICOM = (
    "1.2.840.10008.1.2",
    "1.2.840.10008.1.2.1",
    "1.2.840.10008.1.2.1.98",
    "1.2.840.10008.1.2.1.99",
    "1.2.840.10008.1.2.2",
    "1.2.840.10008.1.2.5",
)
FILMS = "1.2.840.10008.1.2.4.10"  # MPEG-2, MPEG-4 and HEVC: …100 to …108
TIME_POINTERS = (0x00181063, 0x00181065)  # FrameTime, FrameTimeVector
CENTIMETRES = 3  # of PhysicalUnitsXDirection
LISTED = 8
FAR = 1e9  # mm: no position, pixel or slice
_MUCH = 1 << 30


@dataclass
class _Choice:
    """One image that can be chosen from a folder."""

    name: str  # what `series` must be
    uid: str
    text: str  # for the list
    frames: list[Frame] = field(default_factory=list)
    description: str = ""


# ---- which files


def is_dicom(path: Path) -> bool:
    """Tell whether `path` is a folder or begins as a DICOM file does."""
    if path.is_dir():
        return True
    with open(path, "rb") as stream:
        start = stream.read(132)
    if start[128:132] == b"DICM":
        return True
    # without preamble: the first element is of group 2 or 8
    return start[:2] in (b"\x02\x00", b"\x08\x00") and start[3:4] == b"\0" and len(start) == 132


def files_of(path: Path) -> list[Path]:
    """Return the DICOM files of a folder (or the file itself), in order of their names."""
    if not path.is_dir():
        return [path]
    found = sorted(file for file in path.iterdir() if file.is_file() and file.name[0] != ".")
    for file in found:
        if file.stat().st_size == 0 and file.suffix.lower() in ("", ".dcm", ".ima"):
            raise damaged(file, "it is empty")
        if file.suffix.lower() in (".dcm", ".ima") and not is_dicom(file):
            raise damaged(file, "it does not begin as DICOM does")
    return [file for file in found if is_dicom(file)]


def header(path: Path):
    """Return a file's attributes without its pixels, as a pydicom Dataset."""
    with understood(path):
        data = _pydicom().dcmread(path, stop_before_pixels=True, force=True)
        data.filename = str(path)
        sop = data.get("SOPClassUID") or getattr(data, "file_meta", {}).get(
            "MediaStorageSOPClassUID", ""
        )
        if "Rows" not in data and "Image Storage" in _pydicom().uid.UID(str(sop)).name:
            raise damaged(path, "it ends before its image")
        return data


@contextmanager
def understood(path) -> Iterator[None]:
    """Turn whatever a damaged file makes pydicom raise into one line."""
    pydicom = _pydicom()
    with warnings.catch_warnings(), pydicom.config.disable_value_validation():
        warnings.simplefilter("ignore")
        try:
            yield
        except InputError:
            raise
        except Exception as error:  # of many kinds, by what the bytes happen to be
            reason = str(error).split("\n")[0][:120] or type(error).__name__
            raise Damaged(
                f"{path}: a DICOM file that cannot be understood ({reason}); it may be damaged or "
                "incomplete, copy or export it again"
            ) from None


def _pydicom():
    try:
        import pydicom
        import pydicom.config
        import pydicom.pixels
    except ImportError:
        raise InputError(f"reading DICOM {needs('pydicom', 'registration')}") from None
    return pydicom


# ---- one image


def read(path: Path, *, series: str | None = None, frame: int | None = None) -> Image:
    """Read one image; see :func:`elastoidentify.imaging.io.read_image`."""
    headers = [header(file) for file in files_of(path)]
    images = [data for data in headers if _is_image(data)]
    if not images:
        raise InputError(_no_image(path, headers))
    with understood(path):
        choice = _choose(path, _choices(images), series)
        frames = _of_film(path, choice.frames, frame)
        volume = stack(path, frames, lambda one: values_of([one])[0])
    array = values_of(volume.frames)
    if array.ndim == 4:
        array = grey(array, path)
    notes = (*volume.notes, *_loss_note(volume.frames[0].data))
    return Image(array, volume.origin, volume.spacing, volume.direction, notes)


def _is_image(data) -> bool:
    sop = str(data.get("SOPClassUID", ""))
    return "Rows" in data and "Columns" in data and sop not in SEGMENTATION_CLASSES


def _no_image(path: Path, headers) -> str:
    for data in headers:
        kind = SEGMENTATION_CLASSES.get(str(data.get("SOPClassUID", "")))
        if kind:
            return f"{path}: is a DICOM {kind}, no image; give it as the segmentation"
    if not path.is_dir():
        return f"{path}: a DICOM file without an image ({_class_name(headers)})"
    if headers:
        return f"{path}: no DICOM series of images in this folder ({_class_name(headers)} only)"
    inner = [folder.name for folder in sorted(path.iterdir()) if folder.is_dir()]
    more = f"; it has folders: {', '.join(inner[:LISTED])}" if inner else ""
    return f"{path}: no DICOM series in this folder; give the folder with the files{more}"


def _class_name(headers) -> str:
    return str(getattr(headers[0].get("SOPClassUID", ""), "name", "") or "unknown contents")


def _choices(images) -> list[_Choice]:
    """Return what can be chosen: every series, and every image per place of one."""
    series = {}
    for data in images:
        series.setdefault(str(data.get("SeriesInstanceUID", "")), []).append(data)
    numbers = [str(group[0].get("SeriesNumber", "") or "") for group in series.values()]
    found = []
    for (uid, group), number in zip(series.items(), numbers, strict=True):
        name = number if number and numbers.count(number) == 1 else f"…{uid[-8:]}"
        frames = [one for data in group for one in frames_of(data)]
        first = group[0]
        description = str(first.get("SeriesDescription", "") or "").strip()
        said = [description, str(first.get("Modality", "") or ""), orientation_name(frames[0])]
        times = same_place(frames)
        for time, several in enumerate(times, 1):
            text = ", ".join(filter(None, [*said, f"{len(several)} slices"]))
            whole = f"{name}:{time}" if len(times) > 1 else name
            found.append(_Choice(whole, uid, f"{whole} ({text})", several, description))
    return found


def _choose(path: Path, choices: list[_Choice], series: str | None) -> _Choice:
    if series is None:
        chosen = choices
    else:
        wanted = str(series).strip()
        chosen = [c for c in choices if wanted in (c.name, c.uid) or c.name == f"…{wanted[-8:]}"]
        chosen = chosen or [c for c in choices if c.name.split(":")[0] == wanted]
        chosen = chosen or [c for c in choices if c.description.lower() == wanted.lower()]
        if not chosen:
            raise InputError(f"{path}: has no series {wanted!r}; it has {_listed(choices)}")
    if len(chosen) == 1:
        return chosen[0]
    uids = {choice.uid for choice in chosen}
    if len(uids) == 1:
        what = f"{len(chosen)} images at every place (times, echoes …)"
    else:
        what = f"{len(uids)} DICOM series in this folder"
    raise InputError(f"{path}: {what}: {_listed(chosen)}; choose one with --series")


def _listed(choices: list[_Choice]) -> str:
    more = f", and {len(choices) - LISTED} more" if len(choices) > LISTED else ""
    return ", ".join(choice.text for choice in choices[:LISTED]) + more


def _of_film(path: Path, frames: list[Frame], frame: int | None) -> list[Frame]:
    """Return the picture of a film that was asked for; other images as they are."""
    film = [one for one in frames if one.film]
    if frame is not None:
        if len(film) < 2 or len(film) < len(frames):
            raise InputError(f"{path}: is no film, of which a frame could be chosen")
        if not 1 <= frame <= len(film):
            raise InputError(f"{path}: has no frame {frame}; it has frames 1 to {len(film)}")
        return [film[frame - 1]]
    if len(film) > 1:
        raise InputError(
            f"{path}: a film (cine) of {len(film)} frames, not a volume; choose one with --frame, "
            "or export single frames"
        )
    return frames


def _loss_note(data) -> list[str]:
    if str(data.get("LossyImageCompression", "")) == "01":
        return ["was compressed with loss: displacements are worse for it"]
    return []


# ---- frames


def frames_of(data) -> list[Frame]:
    """Return where each frame of a file lies and how its values are scaled."""
    count = int(data.get("NumberOfFrames", 1) or 1)
    if count < 1 or count > 1_000_000:
        raise damaged(Path(data.filename), f"it claims {count} frames")
    if "MOSAIC" in [str(v).upper() for v in data.get("ImageType", []) or []]:
        raise InputError(
            f"{data.filename}: a mosaic of slices in one picture; convert it, for example with "
            "dcm2niix"
        )
    groups = data.get("PerFrameFunctionalGroupsSequence")
    if groups:
        if len(groups) != count:
            raise damaged(Path(data.filename), f"{count} frames and {len(groups)} descriptions")
        shared = (data.get("SharedFunctionalGroupsSequence") or [None])[0]
        return [_enhanced(data, k, groups[k], shared) for k in range(count)]
    first = _classic(data, 0)
    if count == 1:
        return [first]
    offsets = _offsets(data, first, count)
    if offsets is None:
        frames = [_classic(data, k) for k in range(count)]
        for one in frames:
            one.film, one.position = True, None
        return frames
    normal = np.cross(first.orientation[0], first.orientation[1])
    frames = []
    for k in range(count):
        one = _classic(data, k)
        one.position = first.position + offsets[k] * normal
        frames.append(one)
    return frames


def _offsets(data, first: Frame, count: int) -> np.ndarray | None:
    """Return how far each frame of a plain multi-frame file lies along the normal, if it says."""
    pointer = data.get("FrameIncrementPointer")
    pointers = [int(p) for p in np.atleast_1d(pointer)] if pointer is not None else []
    if first.position is None or first.orientation is None:
        return None
    if any(p in TIME_POINTERS for p in pointers):
        return None
    offsets = data.get("GridFrameOffsetVector")
    if offsets is not None and len(offsets) == count:
        values = np.array(offsets, float)
        return values - values[0] if values[0] else values
    if first.step:
        return first.step * np.arange(count)
    return None


def _classic(data, index: int) -> Frame:
    place = data
    if "ImagePositionPatient" not in data and data.get("DetectorInformationSequence"):
        place = data.DetectorInformationSequence[0]  # nuclear medicine
    position, orientation = place.get("ImagePositionPatient"), place.get("ImageOrientationPatient")
    slope, intercept = data.get("RescaleSlope"), data.get("RescaleIntercept")
    if slope is None:
        slope = data.get("DoseGridScaling")
    names = (
        *("TemporalPositionIdentifier", "EchoTime", "EchoNumbers", "TriggerTime"),
        *("DiffusionBValue", "AcquisitionNumber", "AcquisitionTime", "ImageType", "ContentTime"),
    )
    spacing, notes = _pixel_size(data)
    return _frame(
        data,
        index,
        position,
        orientation,
        spacing,
        step=data.get("SpacingBetweenSlices"),
        thickness=data.get("SliceThickness"),
        scale=(slope, intercept),
        keys={name: str(data.get(name, "")) for name in names if name in data},
        notes=notes,
    )


def _enhanced(data, index: int, own, shared) -> Frame:
    def group(*names):
        for name in names:
            for where in (own, shared):
                if where is not None and where.get(name):
                    return where.get(name)[0]
        return {}

    place = group("PlanePositionSequence", "PlanePositionVolumeSequence")
    turn = group("PlaneOrientationSequence", "PlaneOrientationVolumeSequence")
    measures = group("PixelMeasuresSequence")
    content = group("FrameContentSequence")
    values = group("PixelValueTransformationSequence")
    keys = {}
    for name in ("StackID", "TemporalPositionIndex", "FrameReferenceDateTime"):
        if name in content:
            keys[name] = str(content.get(name))
    for number, value in enumerate(np.atleast_1d(content.get("DimensionIndexValues", []))):
        keys[f"DimensionIndexValues {number}"] = str(value)
    for name, item in (
        ("MREchoSequence", "EffectiveEchoTime"),
        ("MRDiffusionSequence", "DiffusionBValue"),
        ("MRImageFrameTypeSequence", "FrameType"),
        ("CardiacSynchronizationSequence", "NominalCardiacTriggerDelayTime"),
    ):
        keys[item] = str(group(name).get(item, ""))
    for name in ("TemporalPositionIdentifier", "AcquisitionNumber", "AcquisitionTime"):
        keys[name] = str(data.get(name, ""))
    spacing, notes = measures.get("PixelSpacing"), []
    if spacing is None:
        spacing, notes = _pixel_size(data)
    else:
        spacing = np.array(spacing, float)[::-1]
    scale = values.get("RescaleSlope", data.get("RescaleSlope"))
    shift = values.get("RescaleIntercept", data.get("RescaleIntercept"))
    return _frame(
        data,
        index,
        place.get("ImagePositionPatient", place.get("ImagePositionVolume")),
        turn.get("ImageOrientationPatient", turn.get("ImageOrientationVolume")),
        spacing,
        step=measures.get("SpacingBetweenSlices"),
        thickness=measures.get("SliceThickness"),
        scale=(scale, shift),
        keys=keys,
        notes=notes,
    )


def _frame(data, index, position, orientation, spacing, *, step, thickness, scale, keys, notes):
    """Put a Frame together, its vectors checked."""
    path = Path(data.filename)
    rows = None
    if orientation is not None and len(np.atleast_1d(orientation)):
        rows = np.array(orientation, float)
        if rows.shape != (6,) or not np.isfinite(rows).all():
            raise damaged(path, "its orientation is no two vectors")
        rows = rows.reshape(2, 3)
        lengths = np.linalg.norm(rows, axis=1)
        if (np.abs(lengths - 1) > 0.02).any() or abs(rows[0] @ rows[1]) > 0.02:
            raise damaged(path, "its orientation is no pair of unit vectors at a right angle")
    place = None
    if position is not None and len(np.atleast_1d(position)):
        place = np.array(position, float)
        if place.shape != (3,) or not (np.abs(place) < FAR).all():
            raise damaged(path, "its position is no point")
    spacing = np.array(spacing, float)
    if spacing.shape != (2,) or not ((spacing > 0) & (spacing < FAR)).all():
        raise damaged(path, f"its pixels have the size {spacing.tolist()}")
    number = data.get("InstanceNumber")
    slope, intercept = (None if v in (None, "") else float(v) for v in scale)
    return Frame(
        data=data,
        index=index,
        position=place,
        orientation=rows,
        spacing=spacing,
        step=_length(step),
        thickness=_length(thickness),
        slope=1.0 if slope is None else slope,
        intercept=0.0 if intercept is None else intercept,
        keys=keys,
        number=int(number) if str(number or "").strip().lstrip("+-").isdigit() else None,
        digits=(_digits(position), _digits(orientation)),
        notes=notes,
    )


def _length(value) -> float | None:
    """Return a distance of slices, None where there is none or it cannot be one."""
    number = float(value) if value not in (None, "") else 0.0
    return number if 0 < abs(number) < FAR else None


def _digits(values) -> int:
    """Return the decimals that numbers were written with: how far they may be rounded."""
    digits = 0
    for value in np.atleast_1d([]) if values is None else values:
        text = str(getattr(value, "original_string", None) or value).strip().lower()
        mantissa, _, exponent = text.partition("e")
        after = len(mantissa.partition(".")[2])
        digits = max(digits, after - (int(exponent) if exponent.lstrip("+-").isdigit() else 0))
    return digits


def _pixel_size(data) -> tuple[np.ndarray, list[str]]:
    """Return the distance of pixels along i and j, and what was assumed for it."""
    plain = data.get("PixelSpacing")
    regions = _region_size(data)
    if regions is not None:
        notes = ["the pixel size is that of its calibrated ultrasound region"]
        if plain is not None and not np.allclose(regions[::-1], np.array(plain, float), rtol=0.01):
            notes = [notes[0] + "; another one in the file was not used"]
        return regions, notes
    for name, note in (
        ("PixelSpacing", None),
        ("ImagerPixelSpacing", "the pixel size is that at the detector, not in the object"),
        ("NominalScannedPixelSpacing", "the pixel size is that of a scanned film"),
    ):
        value = data.get(name)
        if value is not None and len(np.atleast_1d(value)) == 2:
            return np.array(value, float)[::-1], [note] if note else []
    ratio = data.get("PixelAspectRatio")
    if ratio is not None and len(np.atleast_1d(ratio)) == 2 and min(float(v) for v in ratio) > 0:
        spacing = np.array([1.0, float(ratio[0]) / float(ratio[1])])
        return spacing, ["the file has no pixel size, only its shape: a width of 1 is taken"]
    return np.ones(2), ["the file has no pixel size: pixels of 1 × 1 are taken"]


def _region_size(data) -> np.ndarray | None:
    """Return the pixel size in mm of the two-dimensional regions of an ultrasound image."""
    sizes = []
    for region in data.get("SequenceOfUltrasoundRegions") or []:
        spatial = int(region.get("RegionSpatialFormat", 0) or 0) == 1
        units = [int(region.get(f"PhysicalUnits{axis}Direction", 0) or 0) for axis in "XY"]
        if spatial and units == [CENTIMETRES] * 2:
            size = [10 * abs(float(region.get(f"PhysicalDelta{axis}", 0) or 0)) for axis in "XY"]
            if min(size) > 0:
                sizes.append(size)
    if not sizes:
        return None
    if not np.allclose(sizes, sizes[0], rtol=0.01):
        raise InputError(
            f"{data.filename}: has ultrasound regions with different pixel sizes; export the "
            "region of interest by itself"
        )
    return np.array(sizes[0])


# ---- values


def values_of(frames: list[Frame]) -> np.ndarray:
    """Return the values of frames, scaled as their files say. Shape (n, rows, columns[, 3])."""
    path = Path(frames[0].data.filename)
    with understood(path):
        unpacked, arrays = {}, []
        for one in frames:
            name = one.data.filename
            if name not in unpacked:
                unpacked = {name: pixels(Path(name))}
            stored = unpacked[name]
            if one.index >= len(stored):
                raise damaged(Path(name), "it has fewer frames than it claims")
            arrays.append(_scaled(stored[one.index], one))
        return np.stack(arrays)


def _scaled(values: np.ndarray, one: Frame) -> np.ndarray:
    if one.data.get("ModalityLUTSequence"):
        return _pydicom().pixels.apply_modality_lut(values, one.data)
    if one.slope == 1 and one.intercept == 0:
        return values
    if not (np.isfinite(one.slope) and np.isfinite(one.intercept)) or one.slope == 0:
        raise damaged(Path(one.data.filename), f"its values are scaled by {one.slope}")
    return values.astype(float) * one.slope + one.intercept


def pixels(path: Path) -> np.ndarray:
    """Return the stored values of a file's frames, (n, rows, columns[, 3])."""
    pydicom = _pydicom()
    with understood(path):
        data = pydicom.dcmread(path, force=True)
        kinds = ("PixelData", "FloatPixelData", "DoubleFloatPixelData")
        if not any(kind in data for kind in kinds):
            raise damaged(path, "its pixels are missing")
        if "TransferSyntaxUID" not in getattr(data, "file_meta", {}):
            data.file_meta = pydicom.dataset.FileMetaDataset()
            data.file_meta.TransferSyntaxUID = pydicom.uid.ImplicitVRLittleEndian
        syntax = str(data.file_meta.TransferSyntaxUID)
        _check_claim(path, data)
        if syntax in DECODED_BY_PYDICOM:
            array = pydicom.pixels.pixel_array(data)
        elif syntax.startswith(FILMS) and len(syntax) == len(FILMS) + 1:
            raise InputError(f"{path}: a film (MPEG); export single frames")
        else:
            array = _by_gdcm(path, data)
        if str(data.get("PhotometricInterpretation", "")).startswith("PALETTE"):
            array = pydicom.pixels.apply_color_lut(array, data)
        array = _meaningful_bits(array, data)
        colour = int(data.get("SamplesPerPixel", 1) or 1) > 1 or (
            str(data.get("PhotometricInterpretation", "")).startswith("PALETTE")
        )
        return array[None] if array.ndim == (3 if colour else 2) else array


def _check_claim(path: Path, data) -> None:
    """Refuse a compressed file that claims far more pixels than it can hold."""
    claim = int(data.Rows) * int(data.Columns) * int(data.get("NumberOfFrames", 1) or 1)
    there = len(data.get("PixelData", b"") or b"")
    if data.file_meta.TransferSyntaxUID.is_compressed and claim > max(_MUCH, 2000 * there):
        raise damaged(path, f"it claims {claim} pixels in {there} bytes")


def _meaningful_bits(array: np.ndarray, data) -> np.ndarray:
    """Return values without the bits above BitsStored, where overlays used to be kept."""
    stored, allocated = int(data.get("BitsStored", 0) or 0), 8 * array.dtype.itemsize
    if array.dtype.kind not in "iu" or not 0 < stored < allocated:
        return array
    if array.dtype.kind == "u":
        return array & array.dtype.type((1 << stored) - 1)
    return (array << (allocated - stored)) >> (allocated - stored)


def _by_gdcm(path: Path, data) -> np.ndarray:
    """Return the stored values as GDCM unpacks them.

    It gets the pixels alone, without scaling, place or patient.
    """
    pydicom, sitk = _pydicom(), simpleitk()
    bare = pydicom.dataset.Dataset()
    for name in (
        *("SamplesPerPixel", "PhotometricInterpretation", "PlanarConfiguration", "Rows"),
        *("Columns", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation"),
        *("NumberOfFrames", "PixelData"),
    ):
        if name in data:
            bare[name] = data[name]
    colour = int(data.get("SamplesPerPixel", 1)) > 1
    sop = COLOURS if colour else SECONDARY.get(int(data.BitsAllocated), SECONDARY[16])
    bare.SOPClassUID, bare.SOPInstanceUID = sop, pydicom.uid.generate_uid()
    bare.file_meta = pydicom.dataset.FileMetaDataset()
    bare.file_meta.MediaStorageSOPClassUID = sop
    bare.file_meta.MediaStorageSOPInstanceUID = bare.SOPInstanceUID
    bare.file_meta.TransferSyntaxUID = data.file_meta.TransferSyntaxUID
    with tempfile.TemporaryDirectory(prefix="elastoidentify-") as folder:
        name = Path(folder) / "pixels.dcm"
        bare.save_as(name, enforce_file_format=True)
        try:
            with heard():
                array = sitk.GetArrayFromImage(sitk.ReadImage(str(name)))
        except RuntimeError:
            syntax = data.file_meta.TransferSyntaxUID.name
            raise Damaged(
                f"{path}: its pixels cannot be unpacked ({syntax}): damaged, or of a compression "
                "that GDCM does not know; decompress it, for example with gdcmconv --raw"
            ) from None
    frames = int(data.get("NumberOfFrames", 1) or 1)
    shape = (frames, int(data.Rows), int(data.Columns)) + ((3,) if colour else ())
    if array.size != np.prod(shape):
        raise damaged(path, "its pixels are not as many as it claims")
    return array.reshape(shape)
