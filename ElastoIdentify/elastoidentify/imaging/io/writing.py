"""Output files: written whole or not at all, and checked before the work that fills them."""

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

from ...errors import InputError
from ..image import Image

WRITTEN_SUFFIXES = (".nrrd", ".nii.gz", ".nii", ".mha")
PART = ".elastoidentify-part-"  # of what is being written
ROOM = 1 << 20  # bytes that must be free where an output is to go


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
    _sweep(path.parent)
    try:
        handle, part = _begin(path.parent, suffix)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another") from None
    try:
        write(Path(part))
        os.chmod(part, 0o666 & ~_umask())  # mkstemp makes it private, the user's file is not
        os.replace(part, path)
    except (OSError, RuntimeError) as error:
        full = isinstance(error, RuntimeError) and _is_full(path.parent)
        reason = os.strerror(errno.ENOSPC) if full else _reason(error)
        raise InputError(f"{path}: cannot be written ({reason}); choose another") from None
    finally:
        os.close(handle)
        Path(part).unlink(missing_ok=True)


def _begin(folder: Path, suffix: str) -> tuple[int, str]:
    """Make a file to fill, locked until it is closed or this process ends, however it does."""
    while True:
        handle, part = tempfile.mkstemp(suffix, PART, folder)
        if fcntl is None:
            return handle, part
        with suppress(OSError):  # the disk knows no locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.path.exists(part):
            return handle, part
        os.close(handle)  # swept away by another process before it was locked


def _sweep(folder: Path) -> None:
    """Take away what processes left that were killed while they wrote here."""
    if fcntl is None:
        return
    for part in folder.glob(f"{PART}*"):
        with suppress(OSError), open(part, "rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)  # fails where one still writes
            part.unlink()


def check_writable(path: str | os.PathLike, room: int = ROOM) -> None:
    """Raise InputError when `path` cannot be written: better now than after an hour of work.

    Parameters
    ----------
    path : path
    room : int
        Bytes that the disk must still take.
    """
    path = Path(path)
    if "\0" in str(path):
        raise InputError(f"{str(path)!r}: a name cannot have a zero character; choose another")
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name the file to write")
        folder = path.parent
        if not folder.is_dir():
            raise InputError(f"{path}: the folder {folder} does not exist; make it first")
        path.exists()  # finds names that are too long for the system
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another") from None
    _check_length(path, folder)
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{path}: is there and may not be overwritten; choose another name")
    try:
        with tempfile.TemporaryFile(dir=folder) as trial:
            _fill(trial, room)
    except OSError as error:
        raise InputError(
            f"{path}: the folder {folder} cannot be written to ({_reason(error)}); choose another"
        ) from None


def check_outputs(
    outputs: Mapping[str, object] | Iterable[object],
    inputs: Mapping[str, object] | Iterable[object] = (),
    *,
    room: int = ROOM,
) -> None:
    """See that every output can be written and is neither an input nor another output.

    Parameters
    ----------
    outputs, inputs : {name: path} or sequence of paths
        A path may be None (not asked for) or a sequence of paths. The names, such as
        ``--picture``, are for the message.
    room : int
        Bytes that the disk must still take, for each output.

    Raises
    ------
    InputError
        One line: which output, why, and how to mend it.
    """
    seen = [(name, path, "reads") for name, path in _named(inputs)]
    for name, path in _named(outputs):
        check_writable(path, room)
        for other, there, what in seen:
            if _same_file(path, there):
                whose = f" ({other})" if other else ""
                raise InputError(
                    f"{_titled(name, path)}: is also a file that the command {what}{whose}; choose "
                    "another name"
                )
            if what == "reads" and there.is_dir() and _same_file(path.parent, there):
                raise InputError(
                    f"{_titled(name, path)}: lies in a folder that the command reads; choose "
                    "another folder"
                )
        seen.append((name, path, "writes"))


def _named(paths) -> Iterator[tuple[str, Path]]:
    """Yield (name, path) of a mapping or a sequence, of all that are given."""
    pairs = paths.items() if isinstance(paths, Mapping) else (("", path) for path in paths)
    for name, path in pairs:
        several = isinstance(path, list | tuple)
        yield from ((name, Path(one)) for one in (path if several else [path]) if one)


def _titled(name: str, path: Path) -> str:
    return f"{name} {path}" if name else str(path)


def _same_file(one: Path, other: Path) -> bool:
    with suppress(OSError, ValueError):
        if one.exists() and other.exists():
            return os.path.samefile(one, other)
        return one.resolve() == other.resolve()
    return False


def _check_length(path: Path, folder: Path) -> None:
    """Raise InputError when the name is longer than the folder's disk allows."""
    try:
        most = os.pathconf(folder, "PC_NAME_MAX")
    except (AttributeError, OSError, ValueError):
        most = 255
    length = len(os.fsencode(path.name))
    if length > most:
        raise InputError(
            f"{path}: the name has {length} bytes, and {most} are the most here; choose another"
        )


def _fill(stream, room: int) -> None:
    """Take `room` bytes of the disk for a file, or raise OSError when there are none."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(stream.fileno(), 0, room)
    else:
        stream.write(bytes(room))
        stream.flush()


def _is_full(folder: Path) -> bool:
    """Tell whether hardly anything can be written any more, which libraries do not say."""
    try:
        return shutil.disk_usage(folder).free < 1 << 16
    except OSError:
        return False


def _reason(error: Exception) -> str:
    """Return why something could not be written, in words."""
    return getattr(error, "strerror", None) or last_line(error)


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
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: cannot be made ({_reason(error)}); choose another") from None
    check_writable(folder / "file")
    return folder


def _umask() -> int:
    """Return the process' file mode mask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def last_line(error: Exception) -> str:
    """Return the line of an ITK error that says something: the last one, without its address."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].split("): ", 1)[-1] if lines else type(error).__name__
