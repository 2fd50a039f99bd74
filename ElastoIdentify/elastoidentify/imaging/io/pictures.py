"""Pictures: TIFF, PNG, JPEG and BMP. Whether they are whole, and the size of their pixels.

Sources: TIFF 6.0 (Adobe, 1992) and BigTIFF; PNG 1.2; the notes on ImageJ's TIFF description in its
source documentation; the OME-XML schema 2016-06 (attributes ``PhysicalSizeX``, ``…Unit``).
"""

import re
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import InputError
from .damage import damaged

TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 16: 8}
TYPE_FORMS = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d", 16: "Q"}
MM = {
    **dict.fromkeys(("mm", "millimeter", "millimetre", "millimeters"), 1.0),
    **dict.fromkeys(("micron", "microns", "um", "µm", "μm", "\\u00b5m", "micrometer"), 1e-3),
    **dict.fromkeys(("nm", "nanometer"), 1e-6),
    **dict.fromkeys(("cm", "centimeter"), 10.0),
    **dict.fromkeys(("m", "meter"), 1000.0),
    **dict.fromkeys(("inch", "in", "inches"), 25.4),
}
"""Units of length in millimetres."""

PRINT = (72, 96, 100, 150, 180, 200, 240, 300, 400, 600, 1200)  # dots per inch of printers, screens
ALIKE = (254, 258, 259, 262, 277, 284, 322, 323, 339)
"""Tags that the pictures of a stack have in common; ITK's reader breaks down where they differ."""

_MOST_PAGES = 100_000


@dataclass
class Page:
    """One picture of a TIFF file: the values of its tags."""

    tags: dict[int, tuple] = field(default_factory=dict)

    def get(self, tag: int, otherwise=None):
        """Return the first value of a tag."""
        values = self.tags.get(tag)
        return values[0] if values else otherwise

    @property
    def size(self) -> tuple:
        return self.get(256), self.get(257)


def check_tiff(path: Path) -> tuple[tuple[float, float, float] | None, list[str]]:
    """Check that a TIFF file is whole and says what it is.

    Returns
    -------
    spacing : (x, y, z) in mm, or None
        Where its description (ImageJ, OME) says it; ITK reads the plain tags itself.
    notes : list of str

    Raises
    ------
    InputError
        It is cut short, or is something that would be read wrongly: tiles or stripes with more than
        8 bits that ITK makes 8, several channels or times, pictures of several sizes.
    """
    size = path.stat().st_size
    try:
        with open(path, "rb") as stream:
            pages = _pages(path, stream, size)
    except (struct.error, OverflowError, MemoryError, KeyError, TypeError):
        raise damaged(path, "its tags do not make sense") from None
    if not pages:
        raise damaged(path, "it has no picture")
    if len({page.size for page in pages}) > 1:
        raise InputError(f"{path}: has pictures of several sizes; save one picture, or one stack")
    if len({tuple(page.tags.get(tag) for tag in ALIKE) for page in pages}) > 1:
        raise InputError(f"{path}: has pictures of several kinds; save one picture, or one stack")
    first = pages[0]
    numbers = [value for tag in (258, 262, 277, 282, 283, 296) for value in first.tags.get(tag, ())]
    if not all(isinstance(value, int | float) for value in numbers):
        raise damaged(path, "its tags do not make sense")
    bits = max(first.tags.get(258, (1,)))
    if 322 in first.tags and bits > 8:
        raise InputError(
            f"{path}: a tiled TIFF of {bits} bits, which is read as 8 bits only; save it in "
            "strips, or as .nrrd or .mha"
        )
    if bits not in (8, 16, 32, 64):
        raise InputError(f"{path}: a TIFF of {bits} bits per value; save it with 8, 16 or 32 bits")
    if first.get(262) == 3:
        raise InputError(f"{path}: a picture with a colour table; save it in grey")
    return _described(path, first, len(pages))


def _pages(path: Path, stream, size: int) -> list[Page]:
    start = stream.read(16)
    order = {b"II": "<", b"MM": ">"}[start[:2]]
    big = struct.unpack(order + "H", start[2:4])[0] == 43
    offset = struct.unpack_from(order + ("Q" if big else "I"), start, 8 if big else 4)[0]
    pages, seen = [], set()
    while offset:
        if offset in seen or len(pages) > _MOST_PAGES:
            raise damaged(path, "its list of pictures does not end")
        seen.add(offset)
        page, offset = _page(path, stream, order, big, offset, size)
        _check_pieces(path, page, size)
        pages.append(page)
    return pages


def _page(path: Path, stream, order: str, big: bool, offset: int, size: int):
    """Return one picture's tags and the place of the next."""
    count_form, entry, width = ("Q", "HHQ8s", 8) if big else ("H", "HHI4s", 4)
    stream.seek(offset)
    (count,) = struct.unpack(order + count_form, stream.read(struct.calcsize(count_form)))
    length = struct.calcsize(order + entry)
    if count * length > size:
        raise damaged(path, "it is cut short")
    table = stream.read(count * length + width)
    if len(table) < count * length + width:
        raise damaged(path, "it is cut short")
    page = Page()
    for number in range(count):
        tag, kind, n, value = struct.unpack_from(order + entry, table, number * length)
        bytes_ = TYPE_BYTES.get(kind, 1) * n
        if bytes_ > width:
            (place,) = struct.unpack(order + ("Q" if big else "I"), value)
            if place + bytes_ > size:
                raise damaged(path, "it is cut short")
            stream.seek(place)
            value = stream.read(bytes_)
        page.tags[tag] = _values(order, kind, n, value)
    (following,) = struct.unpack_from(order + ("Q" if big else "I"), table, count * length)
    return page, following


def _values(order: str, kind: int, count: int, raw: bytes) -> tuple:
    if kind == 2:
        return (raw[:count].rstrip(b"\0").decode("utf-8", "replace"),)
    if kind in (5, 10):
        pairs = struct.unpack_from(f"{order}{2 * count}{'I' if kind == 5 else 'i'}", raw)
        return tuple(a / b if b else 0.0 for a, b in zip(pairs[::2], pairs[1::2], strict=True))
    if kind not in TYPE_FORMS:
        return (raw,)
    return struct.unpack_from(f"{order}{count}{TYPE_FORMS[kind]}", raw)


def _check_pieces(path: Path, page: Page, size: int) -> None:
    """Raise unless every strip or tile lies in the file, and unpacked ones hold the picture."""
    places = page.tags.get(273) or page.tags.get(324) or ()
    lengths = page.tags.get(279) or page.tags.get(325) or ()
    if not places or len(places) != len(lengths) or None in page.size:
        raise damaged(path, "its pictures have no place")
    for place, length in zip(places, lengths, strict=True):
        if place + length > size:
            raise damaged(path, "it is cut short")
    if page.get(259, 1) == 1 and 273 in page.tags:
        bits = page.tags.get(258, (1,))
        samples = page.get(277, 1)
        row = -(-page.size[0] * bits[0] * samples // 8)
        if sum(lengths) < row * page.size[1]:
            raise damaged(path, "a picture has fewer values than its size")


def _described(path: Path, page: Page, count: int):
    """Return the voxel size that ImageJ or OME have written into the description, and notes."""
    text = str(page.get(270, "") or "")
    if text.startswith("ImageJ="):
        return _imagej(path, page, text, count)
    if "<OME" in text or "PhysicalSizeX" in text:
        return _ome(path, text, count)
    x, unit = page.get(282, 0), page.get(296, 2)
    if not x or unit == 1:
        return (1.0, 1.0, 1.0), ["the picture has no size: pixels of 1 × 1 are taken"]
    per_inch = x if unit == 2 else 2.54 * x
    if round(per_inch) in PRINT and abs(per_inch - round(per_inch)) < 0.01:
        return None, [
            f"the size of the pixels is that of a print ({round(per_inch)} dots per inch): likely "
            "not that of the object"
        ]
    return None, []


def _imagej(path: Path, page: Page, text: str, count: int):
    fields = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)

    def number(name: str, otherwise: float) -> float:
        try:
            return float(fields.get(name, otherwise))
        except ValueError:
            return otherwise

    for name, what in (("frames", "times"), ("channels", "channels")):
        if number(name, 1) > 1:
            raise InputError(
                f"{path}: an ImageJ stack of {number(name, 1):.0f} {what}; save one of them by "
                "itself (Image ▸ Duplicate…)"
            )
    if number("images", 1) != count:
        raise InputError(
            f"{path}: an ImageJ stack of {number('images', 1):.0f} pictures of which {count} can "
            "be found; save it as .nrrd"
        )
    unit = fields.get("unit", "").strip().strip('"')
    x, y = page.get(282, 0), page.get(283, 0)
    if unit.lower() not in MM or not x or not y:
        said = f"in {unit!r}" if unit and unit != "pixel" else "in no unit of length"
        return (1.0, 1.0, number("spacing", 1.0)), [
            f"the picture has its size {said}: pixels of 1 × 1 are taken"
        ]
    mm = MM[unit.lower()]
    depth = mm * abs(number("spacing", 0.0))
    notes = [] if depth or count == 1 else ["the distance of the slices is not said: 1 is taken"]
    return (mm / x, mm / y, depth or 1.0), notes


def _ome(path: Path, text: str, count: int):
    pixels = re.search(r"<(?:\w+:)?Pixels\b([^>]*)>", text)
    attributes = dict(re.findall(r'(\w+)\s*=\s*"([^"]*)"', pixels.group(1))) if pixels else {}
    for name, what in (("SizeT", "times"), ("SizeC", "channels")):
        if attributes.get(name, "1").strip() not in ("0", "1"):
            raise InputError(
                f"{path}: an OME image of {attributes[name]} {what}; save one of them by itself"
            )
    if attributes.get("SizeZ", "1").isdigit() and int(attributes.get("SizeZ", 1)) != count:
        raise InputError(
            f"{path}: an OME image of {attributes['SizeZ']} slices of which {count} are in this "
            "file; save them in one file"
        )
    spacing = []
    for axis in "XYZ":
        try:
            unit = attributes.get(f"PhysicalSize{axis}Unit", "µm").lower()
            spacing.append(float(attributes[f"PhysicalSize{axis}"]) * MM[unit])
        except (KeyError, ValueError):
            spacing.append(0.0)
    if min(spacing[:2]) <= 0:
        return (1.0, 1.0, 1.0), ["the picture has no size: pixels of 1 × 1 are taken"]
    notes = []
    if spacing[2] <= 0:
        spacing[2] = 1.0
        if count > 1:
            notes.append("the distance of the slices is not said: 1 is taken")
    return tuple(spacing), notes


def check_png(path: Path) -> None:
    """See that a PNG is whole: every checksum, and its end."""
    with open(path, "rb") as stream:
        stream.seek(8)
        while True:
            head = stream.read(8)
            if len(head) < 8:
                raise damaged(path, "it is cut short")
            length, name = struct.unpack(">I4s", head)
            content, check = stream.read(length), stream.read(4)
            if len(content) < length or len(check) < 4:
                raise damaged(path, "it is cut short")
            if zlib.crc32(name + content) != struct.unpack(">I", check)[0]:
                raise damaged(path, "a checksum fails")
            if name == b"IEND":
                return


def check_jpeg(path: Path) -> list[str]:
    """See that a JPEG ends as it should. Returns a sentence on its losses."""
    with open(path, "rb") as stream:
        stream.seek(0, 2)
        stream.seek(max(0, stream.tell() - 4096))
        if b"\xff\xd9" not in stream.read():
            raise damaged(path, "it is cut short")
    return ["a JPEG has lost detail, in blocks of 8 pixels: displacements are worse for it"]


def check_bmp(path: Path) -> None:
    """Compare a BMP's length with its header."""
    with open(path, "rb") as stream:
        head = stream.read(6)
    if len(head) < 6 or struct.unpack("<I", head[2:])[0] > path.stat().st_size:
        raise damaged(path, "it is cut short")
