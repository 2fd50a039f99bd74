"""Image files in: an image, or a segmentation with the names of its labels."""

import os
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..image import Image
from . import dicom, dicom_segmentation, matlab, slicer_segmentation
from .itk import Voxels, grey, read_voxels


def read_image(
    path: str | os.PathLike, *, series: str | None = None, frame: int | None = None
) -> Image:
    """Read a scalar image of two or three dimensions.

    Parameters
    ----------
    path : path
        A NRRD, NIfTI, MetaImage, TIFF, PNG, JPEG, BMP or DICOM file, a frame in a MATLAB file
        (.mat), another that SimpleITK can read, or a folder with DICOM files.
    series : str, optional
        Which DICOM series of the folder, where it has several: its number, ``number:time`` where it
        has several images per place, its UID or its description. Of a MATLAB file: the name of the
        array.
    frame : int, optional
        Which picture of a film (an ultrasound cine loop), from 1.

    Returns
    -------
    Image
        In LPS, lengths in the unit of the file (mm by the standards). A planar image becomes a
        volume of one slice; a grey picture stored as RGB becomes grey. ``notes`` has sentences
        on what was assumed.

    Raises
    ------
    InputError
        Missing, damaged or unreadable file, colours, several values per voxel, time series, several
        DICOM series in the folder, slices that are missing, doubled, tilted or not evenly spaced,
        a segmentation object.
    """
    path = _existing(path)
    if dicom.is_dicom(path):
        return dicom.read(path, series=series, frame=frame)
    if matlab.is_matlab(path):
        return matlab.read(path, variable=series, frame=frame)
    if series is not None or frame is not None:
        raise InputError(f"{path}: is no DICOM folder, of which a series or frame could be chosen")
    return scalar_image(read_voxels(path), path)


def read_segmentation(
    path: str | os.PathLike, reference: Image | None = None, *, series: str | None = None
) -> tuple[Image, dict[int, str]]:
    """Read a labelmap and the names of its labels.

    Parameters
    ----------
    path : path
        As for :func:`read_image`; also a DICOM segmentation object (SEG) or structure set
        (RTSTRUCT), alone or in a folder, and a segmentation of 3D Slicer (.seg.nrrd), whose
        layers become one labelmap.
    reference : Image, optional
        The image that was segmented. Contours of a structure set are filled on its grid; without
        it, on a grid of their own.
    series : str, optional
        As for :func:`read_image`.

    Returns
    -------
    labels : Image
    names : {label: name}
        Of the labels that have one in the file.
    """
    path = _existing(path)
    if dicom.is_dicom(path):
        found = dicom_segmentation.find(path)
        if found is not None:
            return dicom_segmentation.read(found, reference)
        return dicom.read(path, series=series), {}
    voxels = read_voxels(path)
    if slicer_segmentation.is_one(voxels):
        return slicer_segmentation.labels(voxels, path)
    return scalar_image(voxels, path), {}


def read_as(
    path: str | os.PathLike, kind: str = "auto", *, series: str | None = None, frame=None
) -> tuple[Image, dict[int, str], bool]:
    """Read an image or a segmentation.

    Parameters
    ----------
    path : path
    kind : "image", "segmentation" or "auto"
        auto: a segmentation where the file can be nothing else.
    series, frame : optional
        As for :func:`read_image`.

    Returns
    -------
    image : Image
    names : {label: name}
    segmentation : bool
        Whether it was read as one.
    """
    if kind == "segmentation" or (kind == "auto" and is_segmentation(path)):
        return *read_segmentation(path, series=series), True
    return read_image(path, series=series, frame=frame), {}, False


def is_segmentation(path: str | os.PathLike) -> bool:
    """Tell whether a file can be nothing but a segmentation, by its name or DICOM class."""
    path = _existing(path)
    if path.is_dir():
        return False
    if path.name.lower().endswith(".seg.nrrd"):
        return True
    return dicom.is_dicom(path) and dicom_segmentation.find(path) is not None


def scalar_image(voxels: Voxels, path: Path) -> Image:
    """Return one value per voxel, or raise InputError where a file has several."""
    array = voxels.array
    if array.ndim == 4:
        array = grey(array, path)
    if np.iscomplexobj(array):
        raise InputError(f"{path}: complex values; export the magnitude image")
    return Image(array, voxels.origin, voxels.spacing, voxels.direction, tuple(voxels.notes))


def _existing(path) -> Path:
    path = Path(path)
    try:
        if path.exists():
            return path
    except (OSError, ValueError):
        pass
    raise InputError(f"{path}: no such file or folder")
