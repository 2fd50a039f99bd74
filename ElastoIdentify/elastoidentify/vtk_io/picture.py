"""The picture of a map that is a VTK mesh."""

from pathlib import Path

import numpy as np

from ..imaging.image import Image
from ..report import picture
from .arrays import REPORTS
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
