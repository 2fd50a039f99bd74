"""The map as NIfTI: an image per quantity on the rest image's grid, each with a JSON sidecar."""

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..imaging.image import Image
from ..imaging.io import check_outputs, write_image, write_whole
from ..results import QUANTITIES, Status
from .cell_map import SHORT, CellMap
from .sampling import cell_of_voxels, sample

WRITTEN = ("Mu", "MuStd", "YoungModulus", "YoungModulusStd")


def nifti_files(prefix: str | os.PathLike, quantities: Sequence[str] = WRITTEN) -> list[Path]:
    """Return the images that :func:`write_nifti` writes; each has a sidecar, ``.json``."""
    names = [*(SHORT[name] for name in quantities), "status", "label"]
    return [Path(f"{prefix}_{name}.nii.gz") for name in names]


def write_nifti(
    prefix: str | os.PathLike,
    result: CellMap,
    grid: Image,
    quantities: Sequence[str] = WRITTEN,
) -> list[Path]:
    """Write a map as NIfTI images with sidecars.

    Parameters
    ----------
    prefix : path
        ``out/case1`` gives ``out/case1_mu.nii.gz``, ``out/case1_mu.json`` and so on.
    result : CellMap
    grid : Image
        The rest image: the maps get its grid.
    quantities : sequence of str
        Names of :data:`~elastoidentify.results.QUANTITIES`. Those that the map lacks are left out.

    Returns
    -------
    list of Path
        What was written: images of quantities (float32, NaN outside and where not determined),
        ``_status`` and ``_label`` (0 outside), and the sidecars.

    Raises
    ------
    InputError
        A folder that is missing or may not be written to, a map outside of the image.
    """
    unknown = [name for name in quantities if name not in QUANTITIES]
    if unknown:
        raise InputError(f"{unknown[0]!r}: no such quantity; there are {', '.join(QUANTITIES)}")
    quantities = [name for name in quantities if name in result.values]
    files = nifti_files(prefix, quantities)
    check_outputs([*files, *map(_sidecar, files)])
    cells = cell_of_voxels(grid, result.points, result.blocks)
    arrays = [sample(cells, np.asarray(result.values[q], np.float32)) for q in quantities]
    arrays += [sample(cells, np.asarray(result.status, np.uint8), 0)]
    arrays += [sample(cells, _labels(result), 0)]
    about = [_about_quantity(result, q) for q in quantities]
    about += [_about_status(), _about_labels(result)]
    grid = in_millimetres(grid, result)
    for file, array, facts in zip(files, arrays, about, strict=True):
        write_image(file, grid.with_array(array))
        _write_json(_sidecar(file), facts | {"GeneratedBy": generated_by(result)})
    return [*files, *map(_sidecar, files)]


def in_millimetres(grid: Image, result: CellMap) -> Image:
    """Return the grid with its lengths in mm, which both NIfTI and DICOM are in."""
    scale = result.to_millimetre
    return Image(grid.array, grid.origin * scale, grid.spacing * scale, grid.direction, grid.notes)


def generated_by(result: CellMap) -> dict:
    """Return what made a map: name, version and provenance, after BIDS' GeneratedBy."""
    from .. import __version__

    made = result.provenance
    return {
        "Name": "ElastoIdentify",
        "Version": made.get("elastoidentify", __version__),
        "Method": {
            key: result.report.get(key)
            for key in ("method", "kinematics", "unknowns", "grouping", "trials", "plane")
            if result.report.get(key) is not None
        },
        "Provenance": made,
    }


def _sidecar(file: Path) -> Path:
    return file.with_name(file.name.removesuffix(".nii.gz") + ".json")


def _labels(result: CellMap) -> np.ndarray:
    """Return labels in the smallest type that holds them."""
    labels = np.asarray(result.labels)
    return labels.astype(np.uint8 if labels.min() >= 0 and labels.max() < 256 else np.int32)


def _about_quantity(result: CellMap, name: str) -> dict:
    quantity = QUANTITIES[name]
    return {
        "Quantity": quantity.words,
        "Symbol": quantity.symbol,
        "Units": result.unit_of(name),
        "NotANumber": "outside of the mesh, or not determined; readers made with niftilib (ITK, 3D "
        "Slicer) show 0 there: mask with the images _status and _label",
        "Sampling": "each voxel has the value of the cell that its centre lies in",
        "Warnings": list(result.report.get("warnings", [])),
    }


def _about_status() -> dict:
    levels = {str(int(status)): status.words for status in Status}
    levels["0"] += ", or outside of the mesh (where _label is 0)"
    return {"Quantity": "what is known of a cell", "Levels": levels}


def _about_labels(result: CellMap) -> dict:
    levels = {str(label): result.name_of(label) for label in np.unique(result.labels)}
    return {"Quantity": "label of the segmentation", "Levels": {"0": "outside"} | levels}


def _write_json(path: Path, facts: dict) -> None:
    text = json.dumps(_finite(facts), indent=1, ensure_ascii=False, allow_nan=False, default=str)
    write_whole(path, lambda part: part.write_text(text + "\n", encoding="utf-8"))


def _finite(value):
    """Replace numbers that JSON has no word for by null."""
    if isinstance(value, dict):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
