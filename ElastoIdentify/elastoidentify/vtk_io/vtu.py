"""Mesh files: VTK's XML unstructured grids (.vtu)."""

import os
from contextlib import contextmanager
from pathlib import Path

from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow
from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader, vtkXMLUnstructuredGridWriter

from ..errors import InputError
from ..imaging.io import write_whole


def read_mesh(path: str | os.PathLike) -> vtkUnstructuredGrid:
    """Read a .vtu file with all its point, cell and field data.

    Raises
    ------
    InputError
        Missing or unreadable file, or a mesh without cells.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    with _vtk_messages() as messages:
        if readable := bool(reader.CanReadFile(str(path))):
            reader.Update()
    if not readable or reader.GetErrorCode() or messages():
        raise InputError(f"{path}: not a readable unstructured grid; give a .vtu file")
    grid = vtkUnstructuredGrid()
    grid.ShallowCopy(reader.GetOutput())
    if grid.GetNumberOfCells() == 0:
        raise InputError(f"{path}: the mesh has no cells")
    return grid


def write_mesh(path: str | os.PathLike, grid: vtkUnstructuredGrid) -> None:
    """Write an unstructured grid to a .vtu file, whole or not at all.

    Raises
    ------
    InputError
        Another suffix, or a folder that cannot be written to.
    """
    path = Path(path)
    if path.suffix.lower() != ".vtu":
        raise InputError(f"{path}: meshes are written as .vtu")
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()

    def write(part: Path) -> None:
        writer.SetFileName(str(part))
        with _vtk_messages() as messages:
            if not writer.Write() or messages():
                raise RuntimeError(messages() or "VTK could not write it")

    write_whole(path, write)


@contextmanager
def _vtk_messages():
    """Collect what VTK would print as errors; yields a callable that returns it."""
    window, shown = vtkStringOutputWindow(), vtkOutputWindow.GetInstance()
    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkOutputWindow.SetInstance(window)
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        yield window.GetOutput
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
        vtkOutputWindow.SetInstance(shown)
