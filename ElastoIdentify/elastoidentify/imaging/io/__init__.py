"""Image files in and out, in the world of ITK (LPS)."""

from .reading import read_image, read_segmentation
from .writing import (
    WRITTEN_SUFFIXES,
    check_outputs,
    check_writable,
    make_folder,
    output_folder,
    write_image,
    write_whole,
)

__all__ = [
    "WRITTEN_SUFFIXES",
    "check_outputs",
    "check_writable",
    "make_folder",
    "output_folder",
    "read_image",
    "read_segmentation",
    "write_image",
    "write_whole",
]
