"""MATLAB files (.mat up to version 7): a frame of ultrasound, samples by lines."""

from pathlib import Path

import numpy as np

from ...errors import InputError
from ..image import Image
from .damage import damaged

LEAST = 16  # values along an axis of a frame
HDF5 = b"MATLAB 7.3"
NOTE = (
    "a .mat file has no voxel size: lengths are in lines (i) and samples (j); `elastoidentify "
    "convert --spacing` gives them one"
)


def is_matlab(path: Path) -> bool:
    """Tell a MATLAB file of numbers from ITK's transforms of the same name."""
    if path.suffix.lower() != ".mat" or not path.is_file():
        return False
    with open(path, "rb") as stream:
        return stream.read(6) == b"MATLAB"


def read(path: Path, *, variable: str | None = None, frame: int | None = None) -> Image:
    """Read one frame: rows are samples (j, depth), columns are lines (i).

    Parameters
    ----------
    path : path
    variable : str, optional
        Which array, where the file has several.
    frame : int, optional
        Which frame of an array of samples × lines × frames, from 1.

    Raises
    ------
    InputError
        A damaged file, one of version 7.3, no array of two or three axes, several and no name, a
        film and no frame, complex values.
    """
    arrays = _arrays(path)
    if variable:
        if variable not in arrays:
            raise InputError(f"{path}: has no array {variable!r}; it has {_named(arrays)}")
        name = variable
    elif len(arrays) == 1:
        (name,) = arrays
    else:
        raise InputError(f"{path}: has several arrays, {_named(arrays)}; choose one with --series")
    array = arrays[name]
    if np.iscomplexobj(array):
        raise InputError(f"{path}: {name} is complex: give radiofrequency data or their envelope")
    return Image(_frame(path, name, array, frame)[None], notes=(NOTE,))


def _frame(path, name, array, frame):
    if array.ndim == 2:
        if frame is not None:
            raise InputError(f"{path}: {name} is no film, of which a frame could be chosen")
        return array
    count = array.shape[2]
    if frame is None:
        raise InputError(
            f"{path}: {name} is a film of {count} frames, not a volume; choose one with --frame"
        )
    if not 1 <= frame <= count:
        raise InputError(f"{path}: has no frame {frame}; it has frames 1 to {count}")
    return np.ascontiguousarray(array[:, :, frame - 1])


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file that may be frames, or films of them."""
    from scipy.io import loadmat

    with open(path, "rb") as stream:
        if stream.read(len(HDF5)) == HDF5:
            raise InputError(f"{path}: is of MATLAB 7.3: save it with save(…, '-v7')")
    try:
        found = loadmat(path)
    except MemoryError:
        raise
    except Exception as error:  # whatever a damaged file makes of the parser
        raise damaged(path, str(error) or type(error).__name__) from None
    arrays = {
        name: value
        for name, value in found.items()
        if isinstance(value, np.ndarray)
        and value.dtype.kind in "uifc"
        and value.ndim in (2, 3)
        and min(value.shape[:2]) >= LEAST
    }
    if not arrays:
        raise InputError(f"{path}: has no array of samples by lines, {LEAST} of each at least")
    return arrays


def _named(arrays) -> str:
    return ", ".join(
        f"{name} ({' × '.join(map(str, value.shape))})" for name, value in sorted(arrays.items())
    )
