"""From one image format to another."""

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..imaging.image import Image
from ..imaging.io import WRITTEN_SUFFIXES, check_outputs, read_image, read_segmentation, write_image


def convert(
    source: str | os.PathLike,
    target: str | os.PathLike,
    *,
    segmentation: bool = False,
    reference: str | os.PathLike | None = None,
    series: str | None = None,
    frame: int | None = None,
    spacing: Sequence[float] | None = None,
) -> tuple[Image, dict[int, str]]:
    """Read an image and write it in another format.

    Parameters
    ----------
    source : path
        Whatever :func:`~elastoidentify.imaging.io.read_image` reads: NRRD, NIfTI, MetaImage, TIFF,
        PNG, JPEG, BMP, a DICOM file or folder; for segmentations also DICOM SEG and RTSTRUCT.
    target : path
        .nrrd, .nii, .nii.gz or .mha.
    segmentation : bool
        The source is a segmentation: labels are read, not grey values.
    reference : path, optional
        The image that was segmented, for a structure set's grid.
    series, frame : optional
        Which DICOM series (or array of a .mat file), which frame of a film.
    spacing : two or three floats, optional
        Size of a voxel along i, j (and k), instead of what the file says or lacks.

    Returns
    -------
    image : Image
        What was written; its ``notes`` say what was assumed.
    names : {label: name}
        Of a segmentation's labels.

    Raises
    ------
    InputError
    """
    if not str(target).lower().endswith(WRITTEN_SUFFIXES):
        raise InputError(f"{target}: images are written as {', '.join(WRITTEN_SUFFIXES)}")
    check_outputs([target], [source, reference])
    if segmentation:
        seen = None if reference is None else read_image(reference)
        image, names = read_segmentation(source, seen, series=series)
    else:
        image, names = read_image(source, series=series, frame=frame), {}
    if spacing is not None:
        image = with_spacing(image, spacing)
    write_image(target, image)
    return image, names


def with_spacing(image: Image, spacing: Sequence[float]) -> Image:
    """Return the image with other voxel sizes along i, j (, k); its first voxel stays in place."""
    sizes = np.asarray(spacing, float)
    if len(sizes) not in (2, 3) or not ((sizes > 0) & np.isfinite(sizes)).all():
        raise InputError(f"spacing {list(spacing)}: give two or three lengths above 0")
    if len(sizes) == 2 and image.size[2] > 1:
        raise InputError("spacing: the image has three axes: give three lengths")
    return replace(image, spacing=np.r_[sizes, image.spacing[len(sizes) :]], notes=())
