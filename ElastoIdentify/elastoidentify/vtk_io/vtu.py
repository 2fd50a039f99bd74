"""Mesh files: VTK's XML unstructured grids (.vtu), and surfaces (.vtp) to read.

Texts in the field data (the reports) are bytes in the file: an array of UInt8, UTF-8, under the
name of the text, its component named ``UTF-8``. VTK's own form for texts (type ``String``) is one
that other readers of .vtu do not know; meshio refuses the whole file for it. :func:`read_mesh`
makes texts of both forms, and anybody else gets one by ``bytes(array).decode()``.
"""

import os
from contextlib import contextmanager
from pathlib import Path

from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow
from vtkmodules.vtkCommonDataModel import vtkFieldData, vtkUnstructuredGrid
from vtkmodules.vtkCommonMisc import vtkErrorCode
from vtkmodules.vtkIOXML import (
    vtkXMLPolyDataReader,
    vtkXMLUnstructuredGridReader,
    vtkXMLUnstructuredGridWriter,
)

from ..errors import InputError
from ..imaging.io import write_whole
from .convert import bytes_of_text, check_connectivity, grid_of_surface, text_of_bytes
from .vtu_structure import check_structure

READERS = {"UnstructuredGrid": vtkXMLUnstructuredGridReader, "PolyData": vtkXMLPolyDataReader}


def read_mesh(path: str | os.PathLike) -> vtkUnstructuredGrid:
    """Read a .vtu file with all its point, cell and field data (or the polygons of a .vtp).

    Raises
    ------
    InputError
        Missing, damaged or unreadable file, one that claims more than it holds, cells that name
        nodes which are not there, or a mesh without cells.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    kind = check_structure(path)
    if kind not in READERS:
        raise InputError(f"{path}: holds {kind or 'unknown data'}; give an unstructured grid, .vtu")
    reader = READERS[kind]()
    reader.SetFileName(str(path))
    with _vtk_messages() as messages:
        if readable := bool(reader.CanReadFile(str(path))):
            reader.Update()
    if not readable or reader.GetErrorCode() or messages():
        raise InputError(f"{path}: not a readable unstructured grid; give a .vtu file")
    try:
        grid = vtkUnstructuredGrid()
        if kind == "PolyData":
            grid = grid_of_surface(reader.GetOutput())
        else:
            grid.ShallowCopy(reader.GetOutput())
        if grid.GetNumberOfCells() == 0:
            raise InputError("the mesh has no cells")
        check_connectivity(grid)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return _with_fields(grid, text_of_bytes)


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
    writer.SetInputData(_with_fields(grid, bytes_of_text))
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()

    def write(part: Path) -> None:
        writer.SetFileName(str(part))
        with _vtk_messages() as messages:
            if not writer.Write() or messages() or writer.GetErrorCode():
                reason = vtkErrorCode.GetStringFromErrorCode(writer.GetErrorCode())
                raise RuntimeError(reason if writer.GetErrorCode() else "VTK could not write it")

    write_whole(path, write)


def _with_fields(grid, change):
    """Return a copy whose field arrays went through `change`, which returns None for "as it is"."""
    copy = vtkUnstructuredGrid()
    copy.ShallowCopy(grid)
    fields, changed = grid.GetFieldData(), vtkFieldData()
    for number in range(fields.GetNumberOfArrays()):
        array = fields.GetAbstractArray(number)
        changed.AddArray(change(array) or array)
    copy.SetFieldData(changed)
    return copy


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
