"""From one image format to another."""

import os

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
        Which DICOM series, which frame of a film.

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
    write_image(target, image)
    return image, names
