"""The picture of a map that is a VTK mesh."""

from pathlib import Path

import numpy as np

from ..imaging.image import Image
from ..report import picture
from ..results import mu_if
from .arrays import REPORTS, read_report
from .convert import get_array, get_text, has_array, mesh_blocks, mesh_points

ARRAYS = ("Mu", "MuStd", "Lambda", "Status")


def draw(path: str | Path, grid, rest: Image | None = None, **options) -> None:
    """Draw a mesh with results, see :func:`elastoidentify.report.picture.draw`.

    Parameters
    ----------
    path : path
    grid : vtkUnstructuredGrid
        With the arrays of an identification.
    rest : Image, optional
    **options
        unit, length, title.
    """
    blocks, order = mesh_blocks(grid)
    cells = grid.GetCellData()
    arrays = {name: get_array(cells, name)[order] for name in ARRAYS}
    if has_array(cells, "Label"):
        arrays["Label"] = np.asarray(get_array(cells, "Label"))[order]
    about = get_text(grid, REPORTS["provenance"])
    picture.draw(path, mesh_points(grid), blocks, arrays, rest, about=about, **options)


def draw_explored(path: str | Path, grid, **options) -> None:
    """Draw the maps under all assumptions that were tried side by side.

    Parameters
    ----------
    path : path
    grid : vtkUnstructuredGrid
        With the arrays of an identification that has tried some.
    **options
        unit, length of :func:`elastoidentify.report.side_by_side.draw`.
    """
    from ..report import side_by_side

    blocks, order = mesh_blocks(grid)
    cells, panels = grid.GetCellData(), []
    status = np.asarray(get_array(cells, "Status"))[order]
    for row in read_report(grid, "identification")["explored"]["rows"]:
        if not row["refused"]:
            name = "Mu" if row["assumption"] == "given" else mu_if(row["assumption"])
            panels.append((row, get_array(cells, name)[order]))
    labels = np.asarray(get_array(cells, "Label"))[order] if has_array(cells, "Label") else status
    side_by_side.draw(path, mesh_points(grid), blocks, labels, panels, **options)
