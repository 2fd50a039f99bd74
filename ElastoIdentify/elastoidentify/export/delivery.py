"""A map written for others, on the grid of a rest image."""

import os
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError
from ..imaging.image import Image
from ..imaging.io import read_image
from .cell_map import CellMap

FORMATS = ("nifti", "dicom", "html")


def deliver(
    result: CellMap,
    kind: str,
    target: str | os.PathLike,
    rest: str | os.PathLike = "",
    *,
    quantity: str = "Mu",
    patient_id: str = "",
    patient_name: str = "",
    warnings: Sequence[str] = (),
    informed: bool = False,
) -> tuple[list[Path], list[str]]:
    """Write a map in one format.

    Parameters
    ----------
    result : CellMap
    kind : "nifti", "dicom" or "html"
    target : path
        Prefix, folder or file, as in :func:`.nifti.write_nifti`, :func:`.dicom.write_dicom`,
        :func:`.html.write_html`.
    rest : path
        Of the rest image. A page does without.
    quantity, patient_id, patient_name : str
        For DICOM.
    warnings, informed
        For the page.

    Returns
    -------
    files : list of Path
    notes : list of str
        What was assumed, a sentence each.

    Raises
    ------
    InputError
        No rest image where one is needed, and what the writers refuse.
    """
    image = read_image(rest) if rest else None
    if kind == "html":
        from .html import write_html

        write_html(target, result, image, warnings=warnings, informed=informed)
        return [Path(target)], []
    if image is None:
        raise InputError("the maps need the grid of the rest image: say which file it is")
    if kind == "nifti":
        from .nifti import write_nifti

        return write_nifti(target, result, image), []
    from .dicom import Person

    person = Person(patient_id, patient_name)
    return write_dicom_of(target, result, image, rest, quantity, person)


def write_dicom_of(
    folder: str | os.PathLike,
    result: CellMap,
    rest: Image,
    source: str | os.PathLike,
    quantity: str,
    person,
) -> tuple[list[Path], list[str]]:
    """Write a map as DICOM that refers to the file of its rest image where that is DICOM itself.

    Returns files and notes. The map is worth more than its reference: where the files cannot be
    referred to, a copy of the image is.
    """
    from ..imaging.io.dicom import is_dicom
    from .dicom import write_dicom

    def write(files):
        return write_dicom(folder, result, rest, quantity=quantity, rest_files=files, person=person)

    if not is_dicom(Path(source)):
        return write([]), []
    try:
        return write([source]), []
    except InputError as error:
        return write([]), [f"the maps refer to a copy of the rest image: {error}"]
