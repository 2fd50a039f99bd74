"""Image files: NRRD, NIfTI, MetaImage, TIFF, PNG and DICOM folders, in the world of ITK (LPS)."""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from ..errors import InputError
from .image import Image

WRITTEN_SUFFIXES = (".nrrd", ".nii.gz", ".nii", ".mha")


def read_image(path: str | os.PathLike) -> Image:
    """Read a scalar image of two or three dimensions.

    Parameters
    ----------
    path : path
        A file that SimpleITK can read, or a folder with one DICOM series.

    Returns
    -------
    Image
        In LPS, lengths in the unit of the file (mm by the standards). A planar image becomes a
        volume of one slice; a grey picture stored as RGB becomes grey.

    Raises
    ------
    InputError
        Missing or unreadable file, colours, several values per voxel, time series, several DICOM
        series in the folder, slices that are not evenly spaced.
    """
    import SimpleITK as sitk

    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        itk_image = _read_series(path) if path.is_dir() else sitk.ReadImage(str(path))
    except RuntimeError as error:
        raise InputError(
            f"{path}: not an image that ITK can read ({_last_line(error)}); convert it to NRRD, "
            "NIfTI or MetaImage"
        ) from None
    return _from_sitk(itk_image, path)


def write_image(path: str | os.PathLike, image: Image) -> None:
    """Write an image to a NRRD, NIfTI or MetaImage (.mha) file, whole or not at all.

    Raises
    ------
    InputError
        Another suffix, or a folder that cannot be written to.
    """
    import SimpleITK as sitk

    path = Path(path)
    suffix = next((s for s in WRITTEN_SUFFIXES if path.name.lower().endswith(s)), None)
    if suffix is None:
        raise InputError(f"{path}: images are written as {', '.join(WRITTEN_SUFFIXES)}")
    array = image.array.astype(np.uint8) if image.array.dtype == bool else image.array
    itk_image = sitk.GetImageFromArray(np.ascontiguousarray(array))
    itk_image.SetOrigin(image.origin.tolist())
    itk_image.SetSpacing(image.spacing.tolist())
    itk_image.SetDirection(image.direction.ravel().tolist())
    write_whole(path, lambda part: sitk.WriteImage(itk_image, str(part), True), suffix)


def write_whole(path: Path, write: Callable[[Path], object], suffix: str | None = None) -> None:
    """Let `write` fill a temporary file beside `path`, then put it in the place of `path`.

    Parameters
    ----------
    path : Path
    write : callable(Path)
        Writes the file whose path it gets; when it raises, nothing is left behind.
    suffix : str, optional
        Suffix of the temporary file, for writers that choose the format by it.

    Raises
    ------
    InputError
        The folder does not exist or cannot be written to, or the disk is full.
    """
    path = Path(path)
    suffix = path.suffix if suffix is None else suffix
    try:
        handle, part = tempfile.mkstemp(suffix, f".{path.stem}-", path.parent)
        os.close(handle)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another") from None
    try:
        write(Path(part))
        os.chmod(part, 0o666 & ~_umask())  # mkstemp makes it private, the user's file is not
        os.replace(part, path)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or _last_line(error)
        raise InputError(f"{path}: cannot be written ({reason}); choose another") from None
    finally:
        Path(part).unlink(missing_ok=True)


def check_writable(path: str | os.PathLike) -> None:
    """Raise InputError when `path` cannot be written: better now than after an hour of work."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name the file to write")
    folder = path.parent
    if not folder.is_dir():
        raise InputError(f"{path}: the folder {folder} does not exist; make it first")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"{path}: the folder {folder} cannot be written to ({error.strerror}); choose another"
        ) from None


@contextmanager
def output_folder(path: str | os.PathLike) -> Iterator[Path]:
    """Make a folder for outputs, and take it away again if the work then fails and left it empty.

    Raises
    ------
    InputError
        It cannot be made or written to.
    """
    made = [folder for folder in (Path(path), *Path(path).parents) if not folder.exists()]
    try:
        yield make_folder(path)
    except BaseException:
        for folder in made:  # the innermost first
            with suppress(OSError):  # not empty
                folder.rmdir()
        raise


def make_folder(path: str | os.PathLike) -> Path:
    """Make a folder for outputs where there is none, or raise InputError if it cannot be used."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another") from None
    check_writable(folder / "file")
    return folder


def _umask() -> int:
    """Return the process' file mode mask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _read_series(folder: Path):
    """Read the only DICOM series of a folder as a SimpleITK image."""
    import SimpleITK as sitk

    series = sitk.ImageSeriesReader.GetGDCMSeriesIDs(str(folder))
    if len(series) != 1:
        found = f"{len(series)} DICOM series" if series else "no DICOM series"
        raise InputError(f"{folder}: {found} in this folder; give a folder with exactly one")
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), series[0]))
    image = reader.Execute()
    key = "ITK_non_uniform_sampling_deviation"
    if image.HasMetaDataKey(key) and float(image.GetMetaData(key)) > 0.01 * image.GetSpacing()[2]:
        raise InputError(
            f"{folder}: the slices are not evenly spaced (off by {image.GetMetaData(key)} mm); "
            "a slice may be missing, or resample the series first"
        )
    return image


def _from_sitk(itk_image, path: Path) -> Image:
    """Return the Image of a SimpleITK image of 2, 3 or (with one time step) 4 dimensions."""
    import SimpleITK as sitk

    if itk_image.GetDimension() > 3:
        if itk_image.GetSize()[3] != 1:
            raise InputError(
                f"{path}: {itk_image.GetDimension()}-D image of size {itk_image.GetSize()}; "
                "extract one time step (or channel) and give one 3-D file per trial"
            )
        itk_image = itk_image[:, :, :, 0]
    array = sitk.GetArrayFromImage(itk_image)
    if itk_image.GetNumberOfComponentsPerPixel() > 1:
        array = _grey(array, path)
    if np.iscomplexobj(array):
        raise InputError(f"{path}: complex values; export the magnitude image")

    dimension = itk_image.GetDimension()
    origin, spacing, direction = np.zeros(3), np.ones(3), np.eye(3)
    origin[:dimension] = itk_image.GetOrigin()
    spacing[:dimension] = itk_image.GetSpacing()
    direction[:dimension, :dimension] = np.reshape(itk_image.GetDirection(), (dimension,) * 2)
    return Image(array, origin, spacing, direction)


def _grey(array: np.ndarray, path: Path) -> np.ndarray:
    """Return the grey values of a picture with equal colour channels (alpha is ignored)."""
    colours = array[..., :3] if array.shape[-1] in (3, 4) else array
    if array.shape[-1] in (3, 4) and (colours == colours[..., :1]).all():
        return colours[..., 0]
    raise InputError(
        f"{path}: {array.shape[-1]} values per voxel (a colour picture or a layered segmentation); "
        "convert it to one grey value, or export the segmentation as one labelmap"
    )


def _last_line(error: Exception) -> str:
    """Return the line of an ITK error that says something: the last one, without its address."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].split("): ", 1)[-1] if lines else type(error).__name__
