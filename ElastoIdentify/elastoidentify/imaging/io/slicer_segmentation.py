"""Segmentations of 3D Slicer (.seg.nrrd): layers of labels, with names.

The header has ``Segment0_Name``, ``Segment0_LabelValue``, ``Segment0_Layer`` and so on; segments
that overlap are on different layers, where labels may be used again.
"""

import re
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..image import Image
from .itk import Voxels


def is_one(voxels: Voxels) -> bool:
    """Tell whether an image has the segments of 3D Slicer in its header."""
    return any(re.fullmatch(r"Segment\d+_LabelValue", name) for name in voxels.fields)


def labels(voxels: Voxels, path: Path) -> tuple[Image, dict[int, str]]:
    """Return one labelmap and its names.

    A label that two layers use is given a new number for the later one; where segments overlap, the
    later layer covers the earlier, which the image's notes say.
    """
    array = voxels.array if voxels.array.ndim == 4 else voxels.array[..., None]
    made, names = np.zeros(array.shape[:3], np.int32), {}
    notes, covered, renamed = list(voxels.notes), 0, []
    for layer, value, name in sorted(_segments(voxels.fields)):
        if layer >= array.shape[-1]:
            raise InputError(f"{path}: segment {name!r} is on a layer that is not in the file")
        here = array[..., layer] == value
        label = value
        if label in names:
            label = max(names) + 1
            renamed.append(f"{name} is {label}")
        names[label] = name
        covered += int(np.count_nonzero(made[here]))
        made[here] = label
    if renamed:
        notes.append(f"labels that two segments share were numbered anew: {', '.join(renamed)}")
    if covered:
        notes.append(f"segments overlap in {covered} voxels, which the later one keeps")
    image = Image(made, voxels.origin, voxels.spacing, voxels.direction, tuple(notes))
    return image, names


def _segments(fields) -> list[tuple[int, int, str]]:
    found = []
    for key, text in fields.items():
        if match := re.fullmatch(r"Segment(\d+)_LabelValue", key):
            prefix = f"Segment{match.group(1)}_"
            try:
                layer, value = int(fields.get(prefix + "Layer", 0)), int(text)
            except ValueError:
                continue
            found.append((layer, value, fields.get(prefix + "Name", prefix[:-1])))
    return found
