"""A result in the scene → files for radiologists, as the command line writes them.

The world of Slicer is RAS, that of the files LPS: points and vectors are turned on the way.
"""

from pathlib import Path

import numpy as np
from elastoidentify.errors import InputError
from elastoidentify.export.cell_map import CellMap, from_grid
from elastoidentify.imaging.image import Image
from elastoidentify.vtk_io.arrays import read_report
from slicer.i18n import tr as _

from .images import image_from_volume
from .outputs import REST

RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
KINDS = ("dicom", "nifti", "html")
PACKAGES = {
    "dicom": ["highdicom>=0.25", "pydicom>=3"],
    "nifti": ["SimpleITK"],
    "html": ["matplotlib"],
}
"""What a kind needs and a Slicer need not bring: it can be built without SimpleITK."""


def export(model, kind: str, target: str) -> list[Path]:
    """Write a result.

    Parameters
    ----------
    model : vtkMRMLModelNode
        Of a result.
    kind : "dicom", "nifti", "html"
    target : str
        A folder for DICOM; for NIfTI the beginning of the files' names, ``folder/case1``; for HTML
        the file.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        The model is no result, its rest volume is gone, or the target cannot be written to.
    """
    found, rest = map_in_lps(model), rest_in_lps(model)
    if kind == "nifti":
        from elastoidentify.export.nifti import write_nifti

        return write_nifti(target, found, rest)
    if kind == "dicom":
        from elastoidentify.export.dicom import write_dicom

        return write_dicom(target, found, rest)
    if kind == "html":
        from elastoidentify.export.html import write_html

        grid = model.GetMesh()
        write_html(
            target,
            found,
            rest,
            warnings=(read_report(grid, "registration") or {}).get("warnings", []),
            informed=grid.GetPointData().HasArray("DisplacementInformation_1") == 1,
        )
        return [Path(target)]
    raise InputError(f"export {kind!r}: there are {', '.join(KINDS)}")


def map_in_lps(model) -> CellMap:
    """Return the map of a model node in the world of files."""
    grid = model.GetMesh()
    if grid is None or not grid.IsA("vtkUnstructuredGrid"):
        text = _("the model {name!r} is no stiffness map: choose a result")
        raise InputError(text.format(name=model.GetName()))
    found = from_grid(grid, repr(model.GetName()))
    found.points = found.points * RAS_TO_LPS
    found.displacements = found.displacements * RAS_TO_LPS
    return found


def rest_in_lps(model) -> Image:
    """Return the rest volume of a result in the world of files."""
    volume = model.GetNodeReference(REST)
    if volume is None:
        text = _("the rest volume of {name!r} is no longer in the scene: load it, and apply again")
        raise InputError(text.format(name=model.GetName()))
    image = image_from_volume(volume)
    turn = RAS_TO_LPS[:, None]
    return Image(image.array, RAS_TO_LPS * image.origin, image.spacing, turn * image.direction)
