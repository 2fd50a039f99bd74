"""Shared by the checks of single formats: how damage is said, and how packed bytes are counted."""

import bz2
import ctypes
import gzip
import os
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ...errors import InputError

_CHUNK = 1 << 20


class Damaged(InputError):
    """A file whose length or checksum does not fit what its header says."""


def damaged(path: Path, what: str) -> Damaged:
    """Return the error for a file that is not whole."""
    return Damaged(f"{path}: the file is damaged or incomplete ({what}); copy or export it again")


def require(path: Path, there: int, wanted: int) -> None:
    """Raise unless `there` bytes are at least the `wanted` ones of the header."""
    if there < wanted:
        raise damaged(path, f"it is cut short: {there} of {wanted} bytes of values are there")


def open_plain(path: Path) -> BinaryIO:
    """Open a file that may be gzipped, whatever its name."""
    with open(path, "rb") as stream:
        packed = stream.read(2) == b"\x1f\x8b"
    return gzip.open(path) if packed else open(path, "rb")


def count_unpacked(path: Path, stream: BinaryIO, kind: str, wanted: int) -> int:
    """Return how many bytes the rest of `stream` holds when it is unpacked.

    Parameters
    ----------
    kind : "raw", "gzip", "zlib", "bzip2"
        gzip's checksum is compared, as are those of the others.
    wanted : int
        Counting ends soon after that many.

    Raises
    ------
    Damaged
        The packed bytes are no such stream, end early, or fail their checksum.
    """
    if kind == "raw":
        here = stream.tell()
        return stream.seek(0, 2) - here
    unpack: Callable = {
        "gzip": lambda: zlib.decompressobj(31),
        "zlib": lambda: zlib.decompressobj(47),  # zlib or gzip, as its first bytes say
        "bzip2": bz2.BZ2Decompressor,
    }[kind]
    machine, count = unpack(), 0
    try:
        while count <= wanted + _CHUNK:
            packed = stream.read(_CHUNK)
            if not packed:
                break
            while packed:
                count += len(machine.decompress(packed))
                packed = machine.unused_data if machine.eof else b""
                if machine.eof:
                    if not packed.startswith((b"\x1f\x8b", b"BZh")):
                        return count
                    machine = unpack()
    except (zlib.error, OSError, EOFError, ValueError) as error:
        raise damaged(path, f"it does not unpack: {error}") from None
    if not machine.eof and count <= wanted + _CHUNK:
        raise damaged(path, "its packed values end early")
    return count


@contextmanager
def heard() -> Iterator[list[str]]:
    """Keep to ourselves what a C library prints; the list has it, line by line, at the end.

    libjpeg says nowhere else that a picture is damaged; MetaIO and HDF5 print what they raise too.
    """
    lines: list[str] = []
    try:
        kept = [os.dup(number) for number in (1, 2)]
    except OSError:  # no such streams, as in a host with windows only
        yield lines
        return
    with tempfile.TemporaryFile() as said:
        try:
            _flush()
            for number in (1, 2):
                os.dup2(said.fileno(), number)
            yield lines
        finally:
            _flush()
            for number, old in zip((1, 2), kept, strict=True):
                os.dup2(old, number)
                os.close(old)
            said.seek(0)
            lines += said.read().decode(errors="replace").splitlines()


def _flush() -> None:
    """Empty the buffers of Python's and of C's streams."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)  # not on Windows, where libraries bring a C of their own
