"""What a NIfTI or Analyze header says: length, placement, and which file holds the voxels.

ITK's reader takes missing voxels for 0, prefers ``x.nii`` where ``x.nii.gz`` is asked for, and
forgets the placement of a single slice; so these are looked at here.
Source of the layout: nifti1.h and nifti2.h of the NIfTI Data Format Working Group.
"""

import gzip
import math
import os
import shutil
import struct
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError
from .damage import damaged, open_plain, require

BITS = {
    **{1: 1, 2: 8, 4: 16, 8: 32, 16: 32, 32: 64, 64: 64, 128: 24, 256: 8, 512: 16, 768: 32},
    **{1024: 64, 1280: 64, 1536: 128, 1792: 128, 2048: 256, 2304: 32},
}
"""Bits per voxel of each datatype."""

TO_MM = {1: 1000.0, 2: 1.0, 3: 0.001}
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass
class NiftiHeader:
    """The parts of a header that are used here.

    Attributes
    ----------
    size : tuple of int
        As long as the header's number of dimensions.
    voxels : Path
        The file with the voxels, `path` itself or the partner of a pair.
    bytes : int
        Of the voxels.
    offset : int
        Where they begin.
    pixdim : (8,)
    sform, qform : (4, 4) or None
        Index to LPS, mm.
    analyze : bool
        The older format, which knows no placement.
    second : bool
        NIfTI-2.
    """

    size: tuple[int, ...]
    voxels: Path
    bytes: int
    offset: int
    pixdim: np.ndarray
    sform: np.ndarray | None
    qform: np.ndarray | None
    analyze: bool
    second: bool

    @property
    def planar(self) -> bool:
        """Whether there is only one slice."""
        return len(self.size) < 3 or self.size[2] == 1

    @property
    def affine(self) -> np.ndarray | None:
        """The scanner's placement; where both agree the sform, which has more digits."""
        if self.qform is None or (self.sform is not None and self.apart <= 0.1):
            return self.sform
        return self.qform

    @property
    def apart(self) -> float:
        """How far the corners of the two placements are apart, in voxels."""
        corners = np.array([[i, j, k, 1] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
        corners[:, :3] *= np.array((*self.size, 1, 1, 1)[:3]) - 1
        off = (corners @ (self.sform - self.qform).T)[:, :3]
        return float(
            np.linalg.norm(off, axis=1).max() / np.linalg.norm(self.qform[:3, :3], axis=0).min()
        )


def is_nifti(path: Path) -> bool:
    """Tell whether a file is NIfTI or Analyze by its name or its first bytes."""
    names = (".nii", ".nii.gz", ".hdr", ".img", ".hdr.gz", ".img.gz")
    return path.name.lower().endswith(names)


def read_header(path: Path) -> NiftiHeader:
    """Read a header and compare the length of the file with it.

    Raises
    ------
    InputError
        Not such a file, half of a pair is missing, or fewer voxels than the header says.
    """
    header_path, voxels = _pair(path)
    try:
        with open_plain(header_path) as stream:
            raw = stream.read(544)
    except (OSError, EOFError, zlib.error):
        raise damaged(path, "its header does not unpack") from None
    try:
        header = _parse(raw, voxels)
    except (struct.error, ValueError, OverflowError):
        raise InputError(
            f"{path}: is no NIfTI file, or its header is damaged; copy or export it again"
        ) from None
    _check_length(header)
    return header


def placement_note(header: NiftiHeader) -> list[str]:
    """Return a sentence when the two placements of a header differ by more than a tenth voxel."""
    if header.sform is None or header.qform is None:
        return []
    if header.apart <= 0.1:
        return []
    return [
        "the header places the image twice, and the placements (sform, qform) differ by "
        f"{header.apart:.3g} voxels: the scanner's (qform) is used"
    ]


@contextmanager
def alone(path: Path, header: NiftiHeader) -> Iterator[Path]:
    """Yield another name of the file, in a folder where no twin can be taken for it.

    Of a single slice a copy without placement: ITK makes two dimensions of it, and refuses those of
    a coronal or sagittal slice. The placement is :attr:`NiftiHeader.affine`.
    """
    with tempfile.TemporaryDirectory(prefix="elastoidentify-") as folder:
        if header.planar and header.affine is not None:
            yield _without_placement(path, Path(folder))
            return
        packed = ".gz" if _is_packed(path) else ""
        if header.voxels == path and path.name.lower().removesuffix(".gz").endswith(".nii"):
            name = Path(folder) / f"image.nii{packed}"
            _link(path, name)
        else:
            name = Path(folder) / "image.hdr"
            header_path, voxels = _pair(path)
            _link(header_path, name)
            _link(voxels, Path(folder) / ("image.img.gz" if _is_packed(voxels) else "image.img"))
        yield name


def _without_placement(path: Path, folder: Path) -> Path:
    """Write an unpacked copy whose qform and sform codes are 0, and return its name."""
    header_path, voxels = _pair(path)
    with open_plain(header_path) as stream:
        raw = bytearray(stream.read())
    second = raw[4:7] in (b"n+2", b"ni2")
    at, length = (344, 8) if second else (252, 4)
    raw[at : at + length] = bytes(length)
    name = folder / ("image.nii" if voxels == header_path else "image.hdr")
    name.write_bytes(raw)
    if voxels != header_path:
        with open_plain(voxels) as stream, open(folder / "image.img", "wb") as copy:
            shutil.copyfileobj(stream, copy)
    return name


def _link(path: Path, name: Path) -> None:
    try:
        os.symlink(path.resolve(), name)
    except (OSError, NotImplementedError):
        shutil.copyfile(path, name)


def _is_packed(path: Path) -> bool:
    with open(path, "rb") as stream:
        return stream.read(2) == b"\x1f\x8b"


def _pair(path: Path) -> tuple[Path, Path]:
    """Return the files of header and voxels."""
    name = path.name
    packed = name[-3:] if name.lower().endswith(".gz") else ""
    stem, suffix = os.path.splitext(name[: len(name) - len(packed)])
    if suffix.lower() not in (".hdr", ".img"):
        return path, path
    wanted = ".img" if suffix.lower() == ".hdr" else ".hdr"
    wanted = wanted.upper() if suffix.isupper() else wanted
    for ending in dict.fromkeys((packed, "", ".gz")):
        partner = path.with_name(stem + wanted + ending)
        if partner.is_file():
            return (path, partner) if wanted.lower() == ".img" else (partner, path)
    with open_plain(path) as stream:
        if suffix.lower() == ".hdr" and stream.read(348)[344:347] == b"n+1":
            return path, path
    raise InputError(f"{path}: is half of a pair, and {stem}{wanted} is missing beside it")


def _parse(raw: bytes, voxels: Path) -> NiftiHeader:
    order = "<" if struct.unpack("<i", raw[:4])[0] in (348, 540) else ">"
    (length,) = struct.unpack(order + "i", raw[:4])
    if length not in (348, 540):
        raise ValueError("no header")
    second = length == 540

    def get(kind: str, at: int, at_second: int, kind_second: str | None = None):
        return struct.unpack_from(
            order + (kind_second or kind if second else kind), raw, at_second if second else at
        )

    dim = get("8h", 40, 16, "8q")
    (datatype,) = get("h", 70, 12)
    pixdim = np.array(get("8f", 76, 104, "8d"), float)
    (offset,) = get("f", 108, 168, "q")
    analyze = not second and raw[344:347] not in (b"n+1", b"ni1")
    if not 1 <= dim[0] <= 7 or min(dim[1 : dim[0] + 1]) < 1 or datatype not in BITS:
        raise ValueError("no sizes")
    size = tuple(int(n) for n in dim[1 : dim[0] + 1])
    header = NiftiHeader(
        size, voxels, -(-math.prod(size) * BITS[datatype] // 8), max(int(offset), 0), pixdim,
        None, None, analyze, second,
    )  # fmt: skip
    if not analyze:
        (units,) = get("b", 123, 500, "i")
        scale = np.diag([TO_MM.get(units & 7, 1.0)] * 3 + [1.0])
        (q_code,), (s_code,) = get("h", 252, 344, "i"), get("h", 254, 348, "i")
        if s_code > 0:
            rows = np.reshape(get("12f", 280, 400, "12d"), (3, 4))
            header.sform = LPS @ scale @ np.vstack([rows, [0, 0, 0, 1]])
        if q_code > 0:
            header.qform = LPS @ scale @ _from_quaternion(get("6f", 256, 352, "6d"), pixdim)
    return header


def _from_quaternion(numbers, pixdim) -> np.ndarray:
    """Return index → RAS of the qform: b, c, d of a unit quaternion and an offset."""
    b, c, d = numbers[:3]
    rest = 1 - b * b - c * c - d * d
    if rest < 1e-7:  # half a turn: single precision leaves nothing of a
        b, c, d = np.array([b, c, d]) / math.sqrt(b * b + c * c + d * d)
        rest = 0.0
    a = math.sqrt(rest)
    turn = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    steps = np.where(pixdim[1:4] > 0, pixdim[1:4], 1.0) * [1, 1, -1 if pixdim[0] < 0 else 1]
    affine = np.eye(4)
    affine[:3, :3] = turn * steps
    affine[:3, 3] = numbers[3:]
    return affine


def _check_length(header: NiftiHeader) -> None:
    """Count the bytes of the voxels, of a packed file by unpacking it (its checksum is seen to)."""
    path, wanted = header.voxels, header.offset + header.bytes
    if not _is_packed(path):
        require(path, path.stat().st_size - header.offset, header.bytes)
        return
    count = 0
    try:
        with gzip.open(path) as stream:
            while chunk := stream.read(1 << 20):
                count += len(chunk)
                if count > wanted + (1 << 24):
                    break
    except (EOFError, OSError, zlib.error) as error:
        raise damaged(path, f"it does not unpack: {error}") from None
    require(path, count - header.offset, header.bytes)
