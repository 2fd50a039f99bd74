"""The map as DICOM: Parametric Maps of a modulus and its error, segmentations of what they cover.

The quantity is (110830, DCM, "Elasticity") in kPa (UCUM); which modulus it is, how it was measured
and with what options stand beside it in the quantity definition (DICOM PS3.3, C.7.6.16.2.11, and
CID 7180). The frames are the slices of the rest image's grid, in the order in which their normal
(row × column) rises, so that no reader has to guess at mirrored axes.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..imaging.image import Image
from ..imaging.io import check_outputs, make_folder, write_whole
from ..installation import needs
from ..results import QUANTITIES
from .cell_map import CellMap
from .dicom_reference import Person, reference_of, reference_series
from .nifti import in_millimetres
from .sampling import cell_of_voxels, sample

ELASTICITY = ("110830", "DCM", "Elasticity")
KILOPASCAL = ("kPa", "UCUM", "kilopascal")
STANDARD_DEVIATION = ("386136009", "SCT", "Standard Deviation")
INDETERMINATE = ("114011", "DCM", "Value indeterminate")
TISSUE = ("85756007", "SCT", "Tissue")
RELATION = ("309825002", "SCT", "Spatial and Relational Concept")
ALGORITHM_FAMILY = ("123111", "DCM", "Deformable Models")

MAPS = {
    "Mu": ("mu", "SHEAR_MODULUS"),
    "MuStd": ("mu_std", "SHEAR_MOD_STD"),
    "YoungModulus": ("E", "YOUNGS_MODULUS"),
    "YoungModulusStd": ("E_std", "YOUNGS_MOD_STD"),
}
"""Quantity → name of its file, content label (at most 16 characters)."""

FIRST_SERIES = 9000  # series numbers that scanners do not use


@dataclass
class _Frames:
    """A grid as DICOM has it: frames whose normal, row × column, leads from one to the next.

    Attributes
    ----------
    image : Image
        Its axis k runs over the frames.
    """

    image: Image
    flipped: bool
    order: tuple[int, int, int]

    def array(self, array: np.ndarray) -> np.ndarray:
        """Return an array of the original grid, (nk, nj, ni), as (frames, rows, columns)."""
        turned = np.transpose(array, self.order)
        return np.ascontiguousarray(turned[::-1] if self.flipped else turned)


def write_dicom(
    folder: str | os.PathLike,
    result: CellMap,
    grid: Image,
    *,
    quantity: str = "Mu",
    rest_files: Sequence[str | os.PathLike] = (),
    person: Person | None = None,
) -> list[Path]:
    """Write a map as DICOM objects.

    Parameters
    ----------
    folder : path
        Made where it is not there.
    result : CellMap
    grid : Image
        The rest image, as read: the maps get its grid.
    quantity : "Mu" or "YoungModulus"
        Which modulus; its standard deviation goes with it.
    rest_files : sequence of paths
        The DICOM files of the rest image, or their folder: patient, study and frame of reference
        are theirs, and every frame says from which of them it was derived. Without any, the rest
        image is written as a series of its own, and the maps refer to that.
    person : Person, optional
        Who it is, for a rest image that was no DICOM.

    Returns
    -------
    list of Path
        ``mu.dcm``, ``mu_std.dcm`` (or ``E``…; float32 in kPa, NaN where there is no value),
        ``labels.dcm``, ``not_determined.dcm`` where cells have no value of it, ``rest_0001.dcm``….

    Raises
    ------
    InputError
        highdicom is missing; the unit is unknown; the files are no DICOM images of one series, or
        do not lie on the grid; the folder cannot be written to.
    """
    _highdicom()
    if quantity not in ("Mu", "YoungModulus"):
        raise InputError(f"quantity {quantity!r}: DICOM maps are made of Mu or YoungModulus")
    cells = cell_of_voxels(grid, result.points, result.blocks)
    frames = _frames(in_millimetres(grid, result))
    if rest_files:
        source, new = reference_of(rest_files, frames.image), []
    else:
        source = new = reference_series(frames.image, person or Person(), FIRST_SERIES)
    made = {f"rest_{number:04d}.dcm": data for number, data in enumerate(new, 1)}
    names = [name for name in (quantity, f"{quantity}Std") if name in result.values]
    for number, name in enumerate(names, FIRST_SERIES + 1):
        values = np.asarray(result.values[name], float) * result.to_kilopascal
        array = frames.array(sample(cells, values.astype(np.float32)))
        made[f"{MAPS[name][0]}.dcm"] = _parametric_map(array, name, result, frames, source, number)
    labels = frames.array(sample(cells, np.asarray(result.labels, np.int64), 0))
    made["labels.dcm"] = _labels(labels, result, frames, source, FIRST_SERIES + 3)
    lacking = frames.array(sample(cells, result.lacks(quantity), False))
    if lacking.any():
        made["not_determined.dcm"] = _not_determined(lacking, result, frames, source)
    folder = make_folder(folder)
    files = [folder / name for name in made]
    check_outputs(files, rest_files)
    for file, data in zip(files, made.values(), strict=True):
        write_whole(file, lambda part, data=data: data.save_as(part, enforce_file_format=True))
    return files


def _highdicom():
    try:
        import highdicom
    except ImportError:
        raise InputError(f"writing DICOM {needs('highdicom', 'dicom')}") from None
    return highdicom


def _frames(grid: Image) -> _Frames:
    """Return a grid with its slices last and its axes right-handed; the voxels stay in place."""
    across = 2 if grid.planar_axis is None else grid.planar_axis
    axes = [*(axis for axis in range(3) if axis != across), across]
    order = tuple(2 - axis for axis in reversed(axes))
    array, direction = np.transpose(grid.array, order), grid.direction[:, axes]
    spacing, origin = grid.spacing[axes], grid.origin
    flipped = bool(np.linalg.det(direction) < 0)
    if flipped:
        origin = origin + (len(array) - 1) * spacing[2] * direction[:, 2]
        array, direction = array[::-1], direction * [1, 1, -1]
    return _Frames(Image(array, origin, spacing, direction), flipped, order)


def _common(result: CellMap, source, number: int, description: str) -> dict:
    """Return what the constructors of maps and segmentations both take."""
    from .. import __version__

    highdicom = _highdicom()
    return {
        "source_images": source,
        "series_instance_uid": highdicom.UID(),
        "series_number": number,
        "sop_instance_uid": highdicom.UID(),
        "instance_number": 1,
        "manufacturer": "ElastoIdentify",
        "manufacturer_model_name": "elastoidentify",
        "software_versions": str(result.provenance.get("elastoidentify", __version__)),
        "device_serial_number": "0",
        "series_description": description[:64],
        "content_description": description[:64],
        "specific_character_set": "ISO_IR 192",
    }


def _geometry(image: Image) -> dict:
    """Return where the frames of a grid lie, in highdicom's words."""
    highdicom = _highdicom()
    steps = np.arange(image.size[2])[:, None] * image.axes[:, 2]
    patient = highdicom.CoordinateSystemNames.PATIENT
    return {
        "plane_positions": [
            highdicom.PlanePositionSequence(patient, place) for place in image.origin + steps
        ],
        "plane_orientation": highdicom.PlaneOrientationSequence(
            patient, [*image.direction[:, 0], *image.direction[:, 1]]
        ),
        "pixel_measures": highdicom.PixelMeasuresSequence(
            pixel_spacing=image.spacing[[1, 0]],
            slice_thickness=image.spacing[2],
            spacing_between_slices=image.spacing[2],
        ),
    }


# ---- maps


def _parametric_map(array, name: str, result: CellMap, frames: _Frames, source, number: int):
    highdicom = _highdicom()
    words = QUANTITIES[name].words
    low, high = _range(array)
    found = highdicom.pm.ParametricMap(
        pixel_array=array,
        contains_recognizable_visual_features=False,
        real_world_value_mappings=[_mapping(name, result, low, high)],
        voi_lut_transformations=[
            highdicom.VOILUTTransformation(
                window_center=round((low + high) / 2, 6),
                window_width=max(round(high - low, 6), 1e-6),
                voi_lut_function="LINEAR_EXACT",
            )
        ],
        content_label=MAPS[name][1],
        image_flavor="VOLUME",
        derived_pixel_contrast="QUANTITY",
        **_geometry(frames.image),
        **_common(result, source, number, f"{words[0].upper()}{words[1:]} (kPa)"),
    )
    found.ContentCreatorName = ""  # type 2
    _say_where(found)
    _rising(found, array)
    return found


def _rising(found, array) -> None:
    """Put the frames of a map in the order of the array.

    highdicom sorts them the other way, which is as good DICOM; but dcmqi (1.5.7) and others take
    the order of the frames for that of their normal, and would mirror the map.
    """
    frames = sorted(
        found.PerFrameFunctionalGroupsSequence,
        key=lambda one: one.FrameContentSequence[0].DimensionIndexValues,
        reverse=True,
    )
    places = [one.PlanePositionSequence[0].ImagePositionPatient for one in frames]
    turn = found.SharedFunctionalGroupsSequence[0].PlaneOrientationSequence[0]
    normal = np.cross(*np.reshape(turn.ImageOrientationPatient, (2, 3)).astype(float))
    if len(places) > 1 and (np.diff(np.array(places, float) @ normal) <= 0).any():
        raise RuntimeError("the frames of a map are not in the order of their normal")
    for number, one in enumerate(frames, 1):
        one.FrameContentSequence[0].DimensionIndexValues = number
    found.PerFrameFunctionalGroupsSequence = frames
    found.FloatPixelData = array.astype("<f4").tobytes()


def _say_where(found) -> None:
    """Add the frames' anatomy, which dcmqi takes for granted, where the source says nothing."""
    from pydicom.dataset import Dataset

    groups = [found.SharedFunctionalGroupsSequence[0], found.PerFrameFunctionalGroupsSequence[0]]
    if any("FrameAnatomySequence" in group for group in groups):
        return
    region, anatomy = Dataset(), Dataset()
    region.CodeValue, region.CodingSchemeDesignator, region.CodeMeaning = TISSUE
    anatomy.FrameLaterality, anatomy.AnatomicRegionSequence = "U", [region]
    groups[0].FrameAnatomySequence = [anatomy]


def _range(array) -> tuple[float, float]:
    """Return the smallest and the largest value."""
    finite = array[np.isfinite(array)]
    return (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)


def _mapping(name: str, result: CellMap, low: float, high: float):
    """Return the real world value mapping: unit, quantity, method and its parameters."""
    highdicom = _highdicom()
    from highdicom.sr import CodeContentItem, CodedConcept, TextContentItem

    mapping = highdicom.pm.RealWorldValueMapping(
        lut_label=MAPS[name][1],
        lut_explanation=f"{QUANTITIES[name].words}, kPa",
        unit=CodedConcept(*KILOPASCAL),
        value_range=(low, high),
        slope=1.0,
        intercept=0.0,
        quantity_definition=CodedConcept(*ELASTICITY),
    )
    more = []
    if QUANTITIES[name].error_of:
        derivation = CodedConcept("121401", "DCM", "Derivation")
        more.append(CodeContentItem(derivation, CodedConcept(*STANDARD_DEVIATION)))
    for code, text in _method(name, result).items():
        more.append(TextContentItem(CodedConcept(*code), text))
    mapping.QuantityDefinitionSequence.extend(more)
    return mapping


def _method(name: str, result: CellMap) -> dict[tuple[str, str, str], str]:
    """Return how it was measured, in concepts of DICOM."""
    from .. import __version__

    report, made = result.report, result.provenance
    chosen = ("method", "kinematics", "plane", "unknowns", "grouping", "trials")
    said = [f"{key} {report[key]}" for key in chosen if report.get(key) is not None]
    how = "; ".join([f"{QUANTITIES[name].words}, quasi-static, from displacements", *said])
    parameters = {"options": made.get("options", {}), "inputs": made.get("inputs", {})}
    return {
        ("370129005", "SCT", "Measurement Method"): how,
        ("111001", "DCM", "Algorithm Name"): "ElastoIdentify",
        ("111003", "DCM", "Algorithm Version"): str(made.get("elastoidentify", __version__)),
        ("111002", "DCM", "Algorithm Parameters"): json.dumps(parameters, default=str),
    }


# ---- segmentations


def _labels(labels, result: CellMap, frames: _Frames, source, number: int):
    present = [int(label) for label in np.unique(labels) if label]
    names = [result.name_of(label) for label in present]
    segments = [_segment(k, name, TISSUE, TISSUE) for k, name in enumerate(names, 1)]
    numbers = np.searchsorted([0, *present], labels).astype(
        np.uint8 if len(present) < 256 else "u2"
    )
    return _segmentation(
        numbers, segments, "LABELS", "Labels of the mesh", result, frames, source, number
    )


def _not_determined(lacking, result: CellMap, frames: _Frames, source):
    segments = [_segment(1, "not determined", RELATION, INDETERMINATE)]
    return _segmentation(
        lacking.astype(np.uint8), segments, "NOT_DETERMINED", "Cells without a readable value",
        result, frames, source, FIRST_SERIES + 4,
    )  # fmt: skip


def _segment(number: int, name: str, category, kind):
    from .. import __version__

    highdicom = _highdicom()
    from highdicom.sr import CodedConcept

    return highdicom.seg.SegmentDescription(
        segment_number=number,
        segment_label=name[:64],
        segmented_property_category=CodedConcept(*category),
        segmented_property_type=CodedConcept(*kind),
        algorithm_type="SEMIAUTOMATIC",
        algorithm_identification=highdicom.AlgorithmIdentificationSequence(
            name="ElastoIdentify", family=CodedConcept(*ALGORITHM_FAMILY), version=__version__
        ),
    )


def _segmentation(numbers, segments, label, description, result, frames, source, number):
    made = _highdicom().seg.Segmentation(
        pixel_array=numbers,
        segmentation_type="BINARY",
        segment_descriptions=segments,
        content_label=label,
        omit_empty_frames=False,
        **_geometry(frames.image),
        **_common(result, source, number, description),
    )
    made.ContentCreatorName = ""  # type 2
    return made
