"""Lengths of images with a header of text lines: NRRD, MetaImage and VTK's legacy format."""

import math
import re
from pathlib import Path

from ...errors import InputError
from .damage import count_unpacked, damaged, require

_LONGEST_HEADER = 1 << 22

NRRD_BYTES = {
    **dict.fromkeys(("signed char", "int8", "int8_t", "uchar", "unsigned char", "uint8"), 1),
    **dict.fromkeys(("uint8_t", "char"), 1),
    **dict.fromkeys(("short", "short int", "signed short", "signed short int", "int16"), 2),
    **dict.fromkeys(("int16_t", "ushort", "unsigned short", "unsigned short int"), 2),
    **dict.fromkeys(("uint16", "uint16_t"), 2),
    **dict.fromkeys(("int", "signed int", "int32", "int32_t", "uint", "unsigned int"), 4),
    **dict.fromkeys(("uint32", "uint32_t", "float"), 4),
    **dict.fromkeys(("longlong", "long long", "long long int", "signed long long"), 8),
    **dict.fromkeys(("signed long long int", "int64", "int64_t", "ulonglong"), 8),
    **dict.fromkeys(("unsigned long long", "unsigned long long int", "uint64", "uint64_t"), 8),
    "double": 8,
}
META_BYTES = {
    **{"MET_CHAR": 1, "MET_UCHAR": 1, "MET_SHORT": 2, "MET_USHORT": 2, "MET_INT": 4},
    **{"MET_UINT": 4, "MET_LONG": 4, "MET_ULONG": 4, "MET_LONG_LONG": 8, "MET_ULONG_LONG": 8},
    **{"MET_FLOAT": 4, "MET_DOUBLE": 8},
}
VTK_BYTES = {
    **{"unsigned_char": 1, "char": 1, "unsigned_short": 2, "short": 2, "unsigned_int": 4},
    **{"int": 4, "unsigned_long": 8, "long": 8, "float": 4, "double": 8},
}


def check_nrrd(path: Path) -> dict[str, str]:
    """Compare a NRRD file's length with its header.

    Returns
    -------
    {field: value}
        Of the header, fields in lower case; keys of ``key:=value`` lines as they are.

    Raises
    ------
    InputError
        The values are not all there, do not unpack, or their file is missing.
    """
    with open(path, "rb") as stream:
        lines, complete = _lines(stream)
        fields = {}
        for line in lines[1:]:
            if match := re.match(r"([^#:][^:]*):(=| ?)(.*)$", line):
                name, custom, value = match.groups()
                fields[name if custom == "=" else name.strip().lower()] = value.strip()
        try:
            sizes = [int(n) for n in fields["sizes"].split()]
            item = NRRD_BYTES.get(fields["type"].lower())
        except (KeyError, ValueError):
            raise damaged(path, "its header has no sizes") from None
        wanted = math.prod(sizes) * item if item and min(sizes, default=0) > 0 else None
        if wanted is None:
            return fields  # a block type or nonsense: ITK refuses it
        kind = _nrrd_encoding(fields)
        data = fields.get("data file", fields.get("datafile"))
        if data is None:
            if not complete:
                raise damaged(path, "its header does not end")
            _check(path, path, stream, kind, wanted, fields)
        elif "%" not in data and not data.startswith("LIST"):
            _check_detached(path, data, kind, wanted, fields)
    return fields


def _nrrd_encoding(fields) -> str:
    encoding = fields.get("encoding", "").lower()
    names = {"gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2", "raw": "raw"}
    return names.get(encoding, "text")


def _check_detached(path: Path, name: str, kind: str, wanted: int, fields) -> None:
    data = path.parent / name
    if not _is_file(data):
        raise InputError(f"{path}: the file with its values, {name!r}, is not there")
    with open(data, "rb") as stream:
        _check(path, data, stream, kind, wanted, fields)


def _check(path: Path, data: Path, stream, kind: str, wanted: int, fields) -> None:
    for _ in range(int(fields.get("line skip", fields.get("lineskip", 0)) or 0)):
        stream.readline()
    skip = int(fields.get("byte skip", fields.get("byteskip", 0)) or 0)
    if kind == "raw" and skip > 0:
        stream.seek(skip, 1)
    if kind == "text":
        item = NRRD_BYTES.get(fields["type"].lower(), 1)
        text = stream.read(64 * wanted + 1024)
        hexadecimal = fields.get("encoding", "").lower() == "hex"
        there = len(re.sub(rb"\s", b"", text)) // 2 if hexadecimal else item * len(text.split())
        require(path, there, wanted)
    else:
        require(path, count_unpacked(path, stream, kind, wanted), wanted)


def check_metaimage(path: Path) -> None:
    """Compare a MetaImage's length (.mha, or .mhd and its values) with its header."""
    with open(path, "rb") as stream:
        fields = {}
        while "ElementDataFile" not in fields:
            line = stream.readline(1 << 16)
            if not line or stream.tell() > _LONGEST_HEADER:
                raise damaged(path, "its header does not name the values")
            name, _, value = line.decode("latin-1").partition("=")
            fields[name.strip()] = value.strip()
        try:
            sizes = [int(n) for n in fields["DimSize"].split()]
            channels = int(fields.get("ElementNumberOfChannels", 1))
            item = META_BYTES[fields["ElementType"].removesuffix("_ARRAY")]
        except (KeyError, ValueError):
            raise damaged(path, "its header has no sizes or type") from None
        _check_meta_header(path, fields, sizes, channels)
        wanted = math.prod(sizes) * channels * item
        name = fields["ElementDataFile"]
        packed = fields.get("CompressedData", "").lower() == "true"
        text = fields.get("BinaryData", "").lower() == "false"
        if name.upper() == "LOCAL":
            _check_meta(path, stream, packed, text, wanted, item)
        elif name.upper().startswith("LIST") or "%" in name:
            raise InputError(f"{path}: its values are in several files; save it as one .mha")
        else:
            data = path.parent / name
            if not _is_file(data):
                raise InputError(f"{path}: the file with its values, {name!r}, is not there")
            with open(data, "rb") as values:
                skip = int(float(fields.get("HeaderSize", 0)))
                values.seek(skip if skip > 0 else 0)
                _check_meta(path, values, packed, text, wanted, item)


def _check_meta_header(path: Path, fields, sizes: list[int], channels: int) -> None:
    """Raise unless a MetaImage's header is consistent; MetaIO trusts it and ends the process."""
    dimensions = fields.get("NDims", "")
    if dimensions != str(len(sizes)) or not 1 <= len(sizes) <= 10:
        raise damaged(path, f"its header has {dimensions[:20]!r} dimensions, {len(sizes)} sizes")
    if min(sizes) < 1 or not 1 <= channels <= 1000:
        raise damaged(path, "its header has sizes below 1")
    n = len(sizes)
    lengths = {"ElementSpacing": n, "ElementSize": n, "Offset": n, "Position": n, "Origin": n}
    lengths |= {"CenterOfRotation": n, "TransformMatrix": n * n, "Rotation": n * n}
    for name, length in lengths.items():
        try:
            numbers = [float(word) for word in fields.get(name, "0 " * length).split()]
        except ValueError:
            numbers = []
        if len(numbers) != length:
            raise damaged(path, f"its header has no {length} numbers for {name}")


def _check_meta(path: Path, stream, packed: bool, text: bool, wanted: int, item: int) -> None:
    if text and not packed:
        require(path, item * len(stream.read().split()), wanted)
    else:
        kind = "zlib" if packed else "raw"
        require(path, count_unpacked(path, stream, kind, wanted), wanted)


def check_vtk(path: Path) -> None:
    """Compare the length of an image in VTK's legacy format with its header."""
    with open(path, "rb") as stream:
        text = stream.read(1 << 16)
        words = text.upper().split()
        binary = b"BINARY" in words[:64]
        size = re.search(rb"(?i)DIMENSIONS\s+(\d+)\s+(\d+)\s+(\d+)", text)
        kind = re.search(
            rb"(?i)(SCALARS|VECTORS)[ \t]+\S+[ \t]+(\w+)[ \t]*(\d*)[ \t]*\r?\n"
            rb"(LOOKUP_TABLE[ \t]+\S+[ \t]*\r?\n)?",
            text,
        )
        item = VTK_BYTES.get(kind.group(2).decode().lower()) if kind else None
        if size is None or item is None:
            raise InputError(
                f"{path}: no image of scalars in VTK's legacy format; save it as .nrrd or .mha"
            )
        components = 3 if kind.group(1).upper() == b"VECTORS" else int(kind.group(3) or 1)
        wanted = math.prod(int(n) for n in size.groups()) * components
        stream.seek(kind.end())
        if binary:
            require(path, count_unpacked(path, stream, "raw", 0), wanted * item)
        else:
            require(path, len(stream.read().split()), wanted)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that cannot be one
        return False


def _lines(stream) -> tuple[list[str], bool]:
    """Return the lines of a header up to an empty one, and whether there was one."""
    lines = []
    while stream.tell() < _LONGEST_HEADER:
        line = stream.readline(1 << 20)
        if not line:
            return lines, False
        if not line.strip():
            return lines, True
        lines.append(line.decode("utf-8", "replace").rstrip("\r\n"))
    return lines, False
