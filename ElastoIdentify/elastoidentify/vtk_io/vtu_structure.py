"""Whether a .vtu or .vtp file holds what its header claims, found out before VTK believes it.

VTK makes room for as many points as a header names, and ends the process when there is none: a
file of a few bytes that claims two billion points would take the host with it. So the lengths that
the XML names are compared here with the bytes that are there.
"""

import base64
import binascii
import itertools
import lzma
import mmap
import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ..errors import InputError

SIZES = {f"{sign}Int{bits}": bits // 8 for sign in ("", "U") for bits in (8, 16, 32, 64)} | {
    "Float32": 4,
    "Float64": 8,
    "String": 1,
    "Bit": 1,
}
"""Bytes of a value of each type of array (at least, for texts)."""

MOST_COMPRESSION = {"vtkZLibDataCompressor": 1040, "vtkLZ4DataCompressor": 260}
"""Bytes that one compressed byte can hold at most, by the compressor's format."""
OTHER_COMPRESSION = 20_000


LISTS = ("Cells", "Verts", "Lines", "Strips", "Polys")
"""Elements with the nodes of cells, one after the other (connectivity), and where each ends."""


@dataclass
class _File:
    """What reading an array needs to know of the file."""

    data: mmap.mmap
    start: int  # where appended data begin
    end: int
    base64: bool  # how they are written
    order: str  # byte order, of struct
    header: str  # type of the numbers before an array, of struct
    compressor: str | None


class _Broken(Exception):
    """The file does not hold what it claims; the text says what is wrong."""


def check_structure(path: Path) -> str:
    """Compare the lengths that a VTK XML file claims with what is there.

    Returns
    -------
    str
        The kind of data, ``"UnstructuredGrid"``, ``"PolyData"``, …

    Raises
    ------
    InputError
        The file is no VTK XML file, is cut short, or claims more than it holds.
    """
    try:
        if path.stat().st_size == 0:
            raise _Broken("it is empty")
        with open(path, "rb") as stream:
            data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
            try:
                return _check(data)
            finally:
                data.close()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except _Broken as broken:
        raise InputError(
            f"{path}: not a readable unstructured grid ({broken}); give a whole .vtu file"
        ) from None
    except (ValueError, TypeError, KeyError, OverflowError, struct.error, binascii.Error):
        raise InputError(
            f"{path}: not a readable unstructured grid (its header makes no sense); give a whole "
            ".vtu file"
        ) from None


def _check(data) -> str:
    begin = data.find(b"<AppendedData")
    head = data[:] if begin < 0 else data[:begin] + b"</VTKFile>"
    if b"<!DOCTYPE" in head or b"<!ENTITY" in head:
        raise _Broken("it defines entities, which no mesh needs")
    try:
        root = ElementTree.fromstring(head)
    except ElementTree.ParseError as error:
        raise _Broken(f"it is no whole XML: {error}") from None
    if root.tag != "VTKFile":
        raise _Broken("it is no VTK file")
    file = _file(data, begin, root)
    for array in root.iter():
        if array.tag in ("DataArray", "Array"):
            _check_array(array, None, file)
    for piece in root.iter("Piece"):
        for array, count in _counted(piece):
            _check_array(array, count, file)
        for cells in piece:
            if cells.tag in LISTS:
                _check_offsets(cells, file)
    return root.attrib.get("type", "")


def _file(data, begin: int, root) -> _File:
    order = ">" if root.attrib.get("byte_order") == "BigEndian" else "<"
    header = {"UInt32": "I", "UInt64": "Q"}[root.attrib.get("header_type", "UInt32")]
    start = end = 0
    in_base64 = False
    if begin >= 0:
        opening = re.compile(rb"<AppendedData([^>]*)>\s*_").match(data, begin)
        if opening is None:
            raise _Broken("its appended data do not begin")
        in_base64 = b"base64" in opening.group(1)
        start, end = opening.end(), data.rfind(b"</AppendedData>")
        if end < start or b"</VTKFile>" not in data[end:]:
            raise _Broken("it is cut short")
    return _File(data, start, end, in_base64, order, header, root.attrib.get("compressor"))


def _counted(piece):
    """Yield the arrays of a piece whose number of tuples the piece says, and that number."""
    sizes = {name: int(piece.attrib.get(f"NumberOf{name}", 0)) for name in ("Points", "Cells")}
    kinds = [f"NumberOf{name}" for name in ("Verts", "Lines", "Strips", "Polys")]
    sizes["Cells"] += sum(int(piece.attrib.get(kind, 0)) for kind in kinds)  # of a surface
    if min(sizes.values()) < 0:
        raise _Broken("it claims less than no points or cells")
    tables = (("Points", "Points"), ("PointData", "Points"), ("CellData", "Cells"))
    for tag, of in tables:
        for array in itertools.chain(*piece.findall(tag)):
            yield array, sizes[of] * int(array.attrib.get("NumberOfComponents", 1))
    for array in itertools.chain(*piece.findall("Cells")):
        if array.attrib.get("Name") in ("offsets", "types"):
            yield array, sizes["Cells"]
    if sizes["Points"] and not piece.findall("Points/"):
        raise _Broken("its points are missing")


def _check_array(array, count: int | None, file: _File) -> None:
    """Raise _Broken unless an array holds `count` values (None: as many as it says itself)."""
    attributes = array.attrib
    name, kind = attributes.get("Name", "?"), attributes["type"]
    if kind not in SIZES:
        raise _Broken(f"array {name!r} is of the unknown type {kind!r}")
    components = int(attributes.get("NumberOfComponents") or 1)
    if count is None and "NumberOfTuples" in attributes:
        count = int(attributes["NumberOfTuples"]) * components
    if components < 1 or components > 10_000 or (count or 0) < 0:
        raise _Broken(f"array {name!r} has {components} components")
    form = attributes.get("format", "ascii")
    if form == "ascii":
        words = (array.text or "").split()
        if kind == "String":
            codes = [int(word) for word in words]
            _check_texts(name, codes.count(0), codes[-1:] == [0], count)
        elif count is not None and kind != "Bit" and len(words) < count:
            raise _Broken(f"array {name!r} has fewer than the {count} values that it claims")
        return
    raw, encoded = _raw(array, file)
    try:
        found = _bytes_of(raw, encoded, file)
        if kind == "String" and found is not None:
            texts = _unpacked(raw, encoded, file)
            _check_texts(name, texts.count(b"\0"), texts[-1:] == b"\0", count)
            return
    finally:
        raw.release()
    if found is None:
        raise _Broken(f"array {name!r} is cut short or damaged")
    if count is not None and kind != "Bit" and found != count * SIZES[kind]:
        raise _Broken(f"array {name!r} holds {found // SIZES[kind]} values and claims {count}")


def _raw(array, file: _File) -> tuple[memoryview, bool]:
    """Return the bytes of the file from where an array begins, and whether they are base64."""
    attributes = array.attrib
    name, form = attributes.get("Name", "?"), attributes.get("format", "ascii")
    if form == "appended":
        offset = int(attributes["offset"])
        if not 0 <= offset <= file.end - file.start:
            raise _Broken(f"array {name!r} begins beyond the end of the file")
        return memoryview(file.data)[file.start + offset : file.end], file.base64
    if form == "binary":
        return memoryview((array.text or "").strip().encode()), True
    raise _Broken(f"array {name!r} has the unknown format {form!r}")


def _check_offsets(cells, file: _File) -> None:
    """Raise unless the cells' ends rise to the number of their nodes: VTK makes room by them."""
    arrays = {array.attrib.get("Name"): array for array in cells}
    if "offsets" not in arrays or "connectivity" not in arrays:
        if len(cells):
            raise _Broken("its cells have no nodes")
        return
    offsets = _whole_numbers(arrays["offsets"], file)
    last = int(offsets[-1]) if len(offsets) else 0
    if len(offsets) and (offsets[0] < 0 or (np.diff(offsets) < 0).any()):
        raise _Broken("its cells end before they begin")
    if last != len(_whole_numbers(arrays["connectivity"], file)):
        raise _Broken("its cells have more or fewer nodes than are listed")


def _whole_numbers(array, file: _File) -> np.ndarray:
    """Return the values of an array of integers."""
    kind = array.attrib["type"]
    if "Int" not in kind:
        raise _Broken(f"array {array.attrib.get('Name')!r} has no whole numbers")
    if array.attrib.get("format", "ascii") == "ascii":
        return np.array([int(word) for word in (array.text or "").split()], np.int64)
    raw, encoded = _raw(array, file)
    try:
        content = _unpacked(raw, encoded, file)
    finally:
        raw.release()
    dtype = np.dtype(f"{'u' if kind[0] == 'U' else ''}int{8 * SIZES[kind]}")
    values = np.frombuffer(content, dtype.newbyteorder(file.order))
    return values.astype(np.int64)


def _check_texts(name: str, ends: int, closed: bool, count: int | None) -> None:
    """Raise unless there are as many texts as claimed: VTK writes beyond its array otherwise."""
    if ends != (count or 0) or (ends and not closed):
        raise _Broken(f"array {name!r} holds {ends} texts and claims {count or 0}")


def _bytes_of(raw, encoded: bool, file: _File) -> int | None:
    """Return how many bytes an array has when it is unpacked, None if they are not there."""
    item = struct.calcsize(file.header)

    def room(start_size: int) -> int:
        """Bytes that can follow a header of so many bytes."""
        if not encoded:
            return len(raw) - start_size
        packed = file.compressor is not None  # then the header is encoded by itself
        begin, taken = (4 * -(-start_size // 3), 0) if packed else (0, start_size)
        return 3 * (len(raw) - begin) // 4 - taken

    if len(raw) < item:
        return None
    if file.compressor is None:
        (size,) = _numbers(raw, 1, encoded, file)
        return size if size <= room(item) else None
    (blocks,) = _numbers(raw, 1, encoded, file)
    if blocks == 0:
        return 0
    if blocks * item > len(raw):
        return None
    _, full, last, *packed = _numbers(raw, 3 + blocks, encoded, file)
    total = (blocks - 1) * full + last if last else blocks * full
    if sum(packed) > room((3 + blocks) * item) or last > full:
        return None
    most = MOST_COMPRESSION.get(file.compressor, OTHER_COMPRESSION)
    return total if total <= most * sum(packed) + 64 else None


def _numbers(raw, count: int, encoded: bool, file: _File) -> tuple[int, ...]:
    """Return the first numbers before an array."""
    size = count * struct.calcsize(file.header)
    found = _decoded(raw, size) if encoded else bytes(raw[:size])
    return struct.unpack(f"{file.order}{count}{file.header}", found[:size])


def _decoded(raw, size: int, start: int = 0) -> bytes:
    """Return `size` bytes of base64 that begins at character `start`."""
    text = bytes(raw[start : start + 4 * -(-size // 3)])
    return base64.b64decode(text + b"=" * (-len(text) % 4))[:size]


def _unpacked(raw, encoded: bool, file: _File) -> bytes:
    """Return the bytes of an array."""
    item = struct.calcsize(file.header)
    if file.compressor is None:
        (size,) = _numbers(raw, 1, encoded, file)
        whole = _decoded(raw, item + size) if encoded else bytes(raw[: item + size])
        if len(whole) != item + size:
            raise _Broken("an array is cut short")
        return whole[item:]
    (blocks,) = _numbers(raw, 1, encoded, file)
    if blocks == 0:
        return b""
    _, full, last, *packed = _numbers(raw, 3 + blocks, encoded, file)
    start = (3 + blocks) * item
    if encoded:  # the header is encoded by itself
        body = _decoded(raw, sum(packed), 4 * -(-start // 3))
    else:
        body = bytes(raw[start : start + sum(packed)])
    unpack = {"vtkZLibDataCompressor": zlib.decompress, "vtkLZMADataCompressor": lzma.decompress}
    found, at = [], 0
    for number, length in enumerate(packed):
        size = last if last and number == blocks - 1 else full
        block = body[at : at + length]
        try:
            plain = unpack.get(file.compressor, _from_lz4)(block)
        except (zlib.error, lzma.LZMAError, IndexError, EOFError):
            raise _Broken("a compressed block does not unpack") from None
        if len(plain) != size:
            raise _Broken("a compressed block has another length than it claims")
        found.append(plain)
        at += length
    return b"".join(found)


def _from_lz4(block: bytes) -> bytes:
    """Return an LZ4 block unpacked (lz4_Block_format.md of the LZ4 project)."""
    made, at = bytearray(), 0

    def length(first: int) -> int:
        nonlocal at
        total = first
        while first == 15 and (extra := block[at]) is not None:
            at += 1
            total += extra
            if extra != 255:
                break
        return total

    while at < len(block):
        token = block[at]
        at += 1
        literals = length(token >> 4)
        made += block[at : at + literals]
        at += literals
        if at >= len(block):
            break
        offset = block[at] | block[at + 1] << 8
        at += 2
        repeat = length(token & 15) + 4
        if not 0 < offset <= len(made):
            raise IndexError("an offset before the beginning")
        while repeat > 0:  # what is copied may be what was just written
            piece = made[-offset:][:repeat]
            made += piece
            repeat -= len(piece)
    return bytes(made)
