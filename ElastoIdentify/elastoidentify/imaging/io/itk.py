"""What ITK reads: one file of one image, after it was checked for being whole."""

import re
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...installation import needs
from . import nifti, pictures, text_headers
from .damage import damaged, heard
from .writing import last_line

MAGIC = {
    b"NRRD": "nrrd",
    b"II*\0": "tiff",
    b"MM\0*": "tiff",
    b"II+\0": "tiff",
    b"MM\0+": "tiff",
    b"\x89PNG": "png",
    b"\xff\xd8\xff": "jpeg",
    b"BM": "bmp",
    b"# vtk DataFile": "vtk",
}
FLAT = ("png", "jpeg", "bmp")
SHEARED = re.compile(r"orthonormal|orthogonal|singular|determinant", re.I)


@dataclass
class Voxels:
    """An image file as it is: one or several values per voxel.

    Attributes
    ----------
    array : ndarray, (nk, nj, ni) or (nk, nj, ni, c)
    origin, spacing, direction
        As of an Image.
    planar : bool
        The file has two dimensions.
    fields : {name: value}
        Of a NRRD header.
    notes : list of str
        Sentences, without the file's name.
    """

    array: np.ndarray
    origin: np.ndarray
    spacing: np.ndarray
    direction: np.ndarray
    planar: bool = False
    fields: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def simpleitk():
    """Return SimpleITK, or say how to install it."""
    try:
        import SimpleITK
    except ImportError:
        raise InputError(f"reading images {needs('SimpleITK', 'registration')}") from None
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    return SimpleITK


def read_voxels(path: Path) -> Voxels:
    """Read an image file that is not DICOM.

    Raises
    ------
    InputError
        It is not whole, not an image, or has more than three dimensions.
    """
    sitk = simpleitk()
    kind = kind_of(path)
    spacing, fields, notes, header = None, {}, [], None
    if kind == "nifti":
        header = nifti.read_header(path)
        notes += nifti.placement_note(header)
        if header.second:
            raise InputError(f"{path}: a NIfTI-2 file, which ITK does not read; save it as NIfTI-1")
        if header.analyze:
            notes.append("the Analyze format does not say where left and right are")
    elif kind == "nrrd":
        fields = text_headers.check_nrrd(path)
    elif kind == "meta":
        text_headers.check_metaimage(path)
    elif kind == "vtk":
        text_headers.check_vtk(path)
    elif kind == "tiff":
        spacing, notes = pictures.check_tiff(path)
    elif kind == "png":
        pictures.check_png(path)
    elif kind == "jpeg":
        notes = pictures.check_jpeg(path)
    elif kind == "bmp":
        pictures.check_bmp(path)
    else:
        notes = ["whether the file is whole was not checked: its format is not among those known"]
    _refuse_dimensions(path, header, fields)
    with nifti.alone(path, header) if header else nullcontext(path) as name:
        try:
            with heard() as said:
                image = sitk.ReadImage(str(name))
        except (RuntimeError, UnicodeError, MemoryError) as error:
            raise _refusal(path, error, kind) from None
    if kind == "jpeg" and said:
        raise damaged(path, said[0][:80])
    voxels = _voxels(sitk, image, path)
    voxels.fields = fields
    voxels.notes = notes + voxels.notes
    if spacing is not None:
        voxels.spacing = np.array(spacing)
    if kind in FLAT and (voxels.spacing[:2] == 1).all():
        voxels.notes.append("the picture has no size: pixels of 1 × 1 are taken")
    if header is not None and header.planar and header.affine is not None:
        _place(voxels, header)
    return voxels


def kind_of(path: Path) -> str:
    """Return the format of a file by its first bytes and its name, ``""`` if it is not known."""
    with open(path, "rb") as stream:
        start = stream.read(1024)
    if nifti.is_nifti(path) and not start.startswith(b"NRRD"):
        return "nifti"
    for magic, kind in MAGIC.items():
        if start.startswith(magic):
            return kind
    if re.search(rb"^(ObjectType|NDims|Comment)\s*=", start, re.M):
        return "meta"
    return ""


def _refuse_dimensions(path: Path, header, fields) -> None:
    """Refuse what has more than three dimensions, with words for what it is."""
    if fields:
        sizes = [int(n) for n in fields.get("sizes", "").split()]
        kinds = fields.get("kinds", "").split()
        if kinds[:1] == ["list"] and sizes[0] > 1 and not any("_LabelValue" in f for f in fields):
            raise InputError(
                f"{path}: a series of {sizes[0]} images (a sequence, or several values per voxel); "
                "give one file per image: in 3D Slicer, save the volumes one by one"
            )
    elif header is not None:
        vectors = len(header.size) == 5 and header.size[3] == 1  # NIfTI keeps vectors there
        sizes = list(header.size[:3] if vectors else header.size)
    else:
        return
    while len(sizes) > 3 and sizes[-1] == 1:
        sizes.pop()
    if header is not None and len(sizes) == 4:
        raise InputError(
            f"{path}: a time series of {sizes[3]} volumes; extract one time step and give one "
            "3-D file per trial"
        )
    if header is not None and len(sizes) > 4:
        raise InputError(
            f"{path}: an image of {len(sizes)} dimensions ({_times(sizes)}); give one volume per "
            "file"
        )


def _refusal(path: Path, error: RuntimeError, kind: str) -> InputError:
    """Return what to say when ITK does not read a file."""
    reason = last_line(error)
    if kind == "nifti" and SHEARED.search(str(error)):
        return InputError(
            f"{path}: its axes are not at right angles (a sheared sform, as an affine registration "
            "or a gantry tilt leaves it); resample it onto a straight grid, for example in 3D "
            "Slicer with Resample Scalar Volume, or remove the shear from the header"
        )
    if SHEARED.search(str(error)):
        return InputError(
            f"{path}: its axes are not at right angles or have no length ({reason}); resample it "
            "onto a straight grid"
        )
    others = "NRRD, NIfTI or MetaImage"
    return InputError(f"{path}: not an image that ITK can read ({reason}); convert it to {others}")


def _voxels(sitk, image, path: Path) -> Voxels:
    """Return the Voxels of a SimpleITK image; axes of length 1 beyond the third are dropped."""
    array = sitk.GetArrayFromImage(image)
    dimension, components = image.GetDimension(), image.GetNumberOfComponentsPerPixel()
    sizes = list(image.GetSize())
    direction = np.reshape(image.GetDirection(), (dimension,) * 2)
    if dimension > 3:
        if any(n > 1 for n in sizes[3:]):
            what = f"{dimension}-D image of size {_times(sizes)}"
            raise InputError(
                f"{path}: {what}, not of three dimensions; extract one time step (or channel) and "
                "give one 3-D file per trial"
            )
        array = array[(0,) * (dimension - 3)]
        direction = direction[:3, :3]
    if array.ndim == (2 if components == 1 else 3):
        array = array[None]
    used = min(dimension, 3)
    origin, spacing, axes = np.zeros(3), np.ones(3), np.eye(3)
    origin[:used] = image.GetOrigin()[:used]
    spacing[:used] = image.GetSpacing()[:used]
    axes[:used, :used] = direction
    if not np.isfinite([*origin, *spacing, *axes.ravel()]).all() or (spacing <= 0).any():
        raise InputError(f"{path}: its origin or voxel size is no number; repair its header")
    if abs(np.linalg.det(axes)) < 1e-6:
        raise InputError(f"{path}: its axes lie in one plane; repair the directions in its header")
    return Voxels(array, origin, spacing, axes, planar=dimension == 2)


def grey(array: np.ndarray, path: Path) -> np.ndarray:
    """Return the grey values of a picture with equal colour channels (alpha is ignored)."""
    colours = array[..., :3] if array.shape[-1] in (3, 4) else array
    if array.shape[-1] in (3, 4) and (colours == colours[..., :1]).all():
        return colours[..., 0]
    raise InputError(
        f"{path}: {array.shape[-1]} values per voxel (a colour picture or a layered segmentation); "
        "convert it to one grey value, or export the segmentation as one labelmap"
    )


def _place(voxels: Voxels, header) -> None:
    """Give a single slice of NIfTI its place in space, which ITK drops with the third axis."""
    affine = header.affine
    steps = np.linalg.norm(affine[:3, :3], axis=0)
    if not (np.isfinite(affine).all() and (steps > 0).all()):
        return
    direction = affine[:3, :3] / steps
    if abs(np.linalg.det(direction)) < 0.99:
        raise InputError("the axes of the slice are not at right angles; resample it")
    voxels.origin, voxels.spacing, voxels.direction = affine[:3, 3], steps, direction


def _times(sizes) -> str:
    return " × ".join(str(n) for n in sizes)
