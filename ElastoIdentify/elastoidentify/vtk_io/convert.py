"""Between VTK's data objects and the arrays that the library works on."""

import json
import re

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.util.vtkConstants import VTK_INT, VTK_UNSIGNED_CHAR
from vtkmodules.vtkCommonCore import (
    vtkIdList,
    vtkPoints,
    vtkStringArray,
    vtkUnsignedCharArray,
    vtkVersion,
)
from vtkmodules.vtkCommonDataModel import (
    VTK_HEXAHEDRON,
    VTK_QUAD,
    VTK_TETRA,
    VTK_TRIANGLE,
    vtkCellArray,
    vtkImageData,
    vtkUnstructuredGrid,
)

from ..errors import InputError
from ..imaging.image import Image

try:
    from vtkmodules.vtkCommonDataModel import vtkCellTypeUtilities as _KIND_NAMES  # from VTK 9.6
except ImportError:
    from vtkmodules.vtkCommonDataModel import vtkCellTypes as _KIND_NAMES

KINDS = {
    "triangle": (VTK_TRIANGLE, 3),
    "quad": (VTK_QUAD, 4),
    "tetra": (VTK_TETRA, 4),
    "hexahedron": (VTK_HEXAHEDRON, 8),
}
"""VTK's number and the number of nodes of each kind of cell."""

UTF8 = "UTF-8"
"""Name of the component of arrays of bytes that are a text."""

DISPLACEMENT = re.compile(r"Displacement(?:_(\d+))?$")


# ---- images


def image_from_vtk(data: vtkImageData, what: str = "image", array: str = "") -> Image:
    """Return the point array `array` (``""``: the active scalars, else the first) of `data`.

    Raises InputError, with the image called `what`, if there is no such array or if it has more
    than one component.
    """
    points = data.GetPointData()
    values = points.GetArray(array) if array else points.GetScalars() or points.GetArray(0)
    if values is None:
        wanted = f"no point array {array!r}" if array else "no point array"
        raise InputError(f"the {what} has {wanted}: it has {_names(points)}")
    if values.GetNumberOfComponents() != 1:
        raise InputError(
            f"the {what} has {values.GetNumberOfComponents()} values per voxel in "
            f"{values.GetName()!r}: convert colour images to grey first"
        )
    matrix = data.GetDirectionMatrix()
    direction = np.array([[matrix.GetElement(i, j) for j in range(3)] for i in range(3)])
    spacing, first = np.array(data.GetSpacing()), np.array(data.GetExtent()[::2])
    origin = np.array(data.GetOrigin()) + direction @ (spacing * first)
    grey = vtk_to_numpy(values).reshape(data.GetDimensions()[::-1])
    return Image(grey, origin, spacing, direction)


def image_to_vtk(image: Image, name: str = "ImageScalars") -> vtkImageData:
    """Return `image` as vtkImageData with one point array, the active scalars."""
    data = vtkImageData()
    data.SetDimensions(image.size)
    data.SetOrigin(image.origin)
    data.SetSpacing(image.spacing)
    data.SetDirectionMatrix(image.direction.ravel())
    values = numpy_to_vtk(np.ascontiguousarray(image.array).ravel(), deep=True)
    values.SetName(name)
    data.GetPointData().SetScalars(values)
    return data


# ---- meshes


def mesh_to_vtk(points: np.ndarray, cells) -> vtkUnstructuredGrid:
    """Return a grid of nodes (n, 2 or 3) and cells.

    `cells` is one array (m, 3) of triangles or (m, 4) of quads (planar points) or tetrahedra, or a
    list of blocks ``(kind, (m, k))``.
    """
    points = np.asarray(points, float)
    if isinstance(cells, np.ndarray):
        solid = {3: "triangle", 4: "tetra", 8: "hexahedron"}
        planar = points.shape[1] == 2 and cells.shape[1] == 4
        cells = [("quad" if planar else solid[cells.shape[1]], cells)]
    space = np.zeros((len(points), 3))
    space[:, : points.shape[1]] = points
    nodes = vtkPoints()
    nodes.SetData(numpy_to_vtk(space, deep=True))
    lengths = np.concatenate([np.full(len(block), block.shape[1]) for _, block in cells])
    corners = np.concatenate([np.asarray(block).ravel() for _, block in cells])
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    connectivity = vtkCellArray()
    connectivity.SetData(
        numpy_to_vtkIdTypeArray(offsets.astype(np.int64), deep=True),
        numpy_to_vtkIdTypeArray(corners.astype(np.int64), deep=True),
    )
    types = np.concatenate([np.full(len(block), KINDS[kind][0]) for kind, block in cells])
    grid = vtkUnstructuredGrid()
    grid.SetPoints(nodes)
    grid.SetCells(numpy_to_vtk(types.astype(np.uint8), deep=True), connectivity)
    return grid


def mesh_points(grid: vtkUnstructuredGrid) -> np.ndarray:
    """Return the nodes, (n, 3) float64."""
    if grid.GetNumberOfPoints() == 0:
        return np.zeros((0, 3))
    return vtk_to_numpy(grid.GetPoints().GetData()).astype(float)


def mesh_blocks(grid: vtkUnstructuredGrid) -> tuple[list[tuple[str, np.ndarray]], np.ndarray]:
    """Return the cells as blocks ``(kind, (m, k))``, and each block cell's number in the grid.

    Raises InputError for an empty mesh and for cells of other kinds, naming them.
    """
    if grid.GetNumberOfCells() == 0:
        raise InputError("the mesh has no cells")
    check_connectivity(grid)
    types = _cell_types(grid)
    known = {number: (kind, nodes) for kind, (number, nodes) in KINDS.items()}
    others = [number for number in np.unique(types) if number not in known]
    if others:
        names = ", ".join(_KIND_NAMES.GetClassNameFromTypeId(int(number)) for number in others)
        raise InputError(
            f"the mesh has cells of kind {names}: only triangles, quads, tetrahedra and hexahedra "
            "can be used; take these out with Threshold, or triangulate the mesh first"
        )
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray())[:-1]
    corners = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
    blocks, order = [], []
    for number in np.unique(types):
        kind, nodes = known[number]
        members = np.flatnonzero(types == number)
        blocks.append((kind, corners[offsets[members][:, None] + np.arange(nodes)].astype(int)))
        order.append(members)
    return blocks, np.concatenate(order)


def check_connectivity(grid: vtkUnstructuredGrid) -> None:
    """Raise InputError unless every cell has the nodes of its kind, and the mesh has those.

    VTK itself does not look, and reads beyond its arrays where a triangle is called a tetrahedron.
    """
    types = _cell_types(grid)
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray()).astype(np.int64)
    corners = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
    counts = np.diff(offsets)
    if len(counts) != len(types) or (counts < 0).any() or offsets[-1] > len(corners):
        raise InputError("the cells do not fit the list of their nodes: the file is damaged")
    for kind, (number, nodes) in KINDS.items():
        wrong = np.flatnonzero((types == number) & (counts != nodes))
        if len(wrong):
            raise InputError(
                f"{len(wrong)} cells are called {kind} and have another number of nodes than "
                f"{nodes}, the first is cell {wrong[0]} with {counts[wrong[0]]}: export the mesh "
                "with the right kind of cells"
            )
    n_points = grid.GetNumberOfPoints()
    if len(corners) and (corners.min() < 0 or corners.max() >= n_points):
        worst = corners.min() if corners.min() < 0 else corners.max()
        raise InputError(f"a cell has the node {worst}, but the mesh has nodes 0 to {n_points - 1}")


def grid_of_surface(surface) -> vtkUnstructuredGrid:
    """Return the polygons of vtkPolyData, with their data, as an unstructured grid.

    Lines and vertices are left out. Raises InputError for strips and for polygons of more than
    four corners.
    """
    if surface.GetNumberOfStrips():
        raise InputError("the surface has triangle strips: triangulate it first")
    n_polygons = surface.GetNumberOfPolys()
    before = surface.GetNumberOfVerts() + surface.GetNumberOfLines()
    grid = vtkUnstructuredGrid()
    if not n_polygons:
        return grid
    corners = np.diff(vtk_to_numpy(surface.GetPolys().GetOffsetsArray()))
    if ((corners != 3) & (corners != 4)).any():
        raise InputError("the surface has polygons that are no triangles or quads: triangulate it")
    types = np.where(corners == 3, VTK_TRIANGLE, VTK_QUAD).astype(np.uint8)
    grid.SetPoints(surface.GetPoints())
    grid.SetCells(numpy_to_vtk(types, deep=True), surface.GetPolys())
    grid.GetPointData().ShallowCopy(surface.GetPointData())
    grid.GetFieldData().ShallowCopy(surface.GetFieldData())
    kept = vtkIdList()
    kept.SetNumberOfIds(n_polygons)
    for cell in range(n_polygons):
        kept.SetId(cell, before + cell)
    cells = surface.GetCellData()
    grid.GetCellData().CopyAllocate(cells, n_polygons)
    grid.GetCellData().CopyAllOn()
    for number in range(cells.GetNumberOfArrays()):
        array = cells.GetAbstractArray(number).NewInstance()
        array.SetName(cells.GetAbstractArray(number).GetName())
        array.SetNumberOfComponents(cells.GetAbstractArray(number).GetNumberOfComponents())
        array.SetNumberOfTuples(n_polygons)
        cells.GetAbstractArray(number).GetTuples(kept, array)
        grid.GetCellData().AddArray(array)
    return grid


def _cell_types(grid: vtkUnstructuredGrid) -> np.ndarray:
    """Return VTK's number of each cell's kind, (n_cells,)."""
    new = (vtkVersion.GetVTKMajorVersion(), vtkVersion.GetVTKMinorVersion()) >= (9, 6)
    plain = vtkUnsignedCharArray()
    plain.DeepCopy(grid.GetCellTypes() if new else grid.GetCellTypesArray())
    return vtk_to_numpy(plain)


def simplices(grid: vtkUnstructuredGrid) -> np.ndarray:
    """Return the cells of a mesh of one kind, (m, k) int; InputError if it has several."""
    blocks, _ = mesh_blocks(grid)
    if len(blocks) > 1:
        raise InputError("the mesh mixes " + " and ".join(kind for kind, _ in blocks))
    return blocks[0][1]


# ---- arrays


def has_array(data, name: str) -> bool:
    """Tell whether the point or cell data has the array `name`."""
    return data.GetArray(name) is not None


def get_array(data, name: str) -> np.ndarray:
    """Return an array of the point or cell data; InputError names those that there are."""
    array = data.GetArray(name)
    if array is None:
        where = "point" if data.IsA("vtkPointData") else "cell"
        raise InputError(f"the mesh has no {where} array {name!r}: it has {_names(data)}")
    return vtk_to_numpy(array)


def set_array(data, name: str, values: np.ndarray):
    """Put `values`, one row per point or cell, into the point or cell data."""
    types = {np.dtype(np.int32): VTK_INT, np.dtype(np.uint8): VTK_UNSIGNED_CHAR}
    values = np.ascontiguousarray(values)
    array = numpy_to_vtk(values, deep=True, array_type=types.get(values.dtype))
    array.SetName(name)
    data.AddArray(array)


def set_text(grid, name: str, text: str):
    """Put a string into the field data."""
    array = vtkStringArray()
    array.SetName(name)
    array.InsertNextValue(text)
    grid.GetFieldData().AddArray(array)


def get_text(grid, name: str) -> str:
    """Return a string of the field data, ``""`` if there is none.

    Also one that a host has read from a file itself, where texts are bytes.
    """
    array = grid.GetFieldData().GetAbstractArray(name)
    return next(iter(all_texts(array)), "") if array is not None else ""


def all_texts(array) -> list[str]:
    """Return all values of an array of texts, as such or as bytes; none of other arrays."""
    array = text_of_bytes(array) or array
    if not array.IsA("vtkStringArray"):
        return []
    return [array.GetValue(number) for number in range(array.GetNumberOfValues())]


def bytes_of_text(array):
    """Return a vtkStringArray as bytes (UTF-8, a zero between texts); None for other arrays."""
    if not array.IsA("vtkStringArray"):
        return None
    texts = [array.GetValue(number) for number in range(array.GetNumberOfValues())]
    encoded = "\0".join(texts).encode("utf-8", "surrogateescape") or b"\0"  # meshio: never empty
    values = numpy_to_vtk(np.frombuffer(encoded, np.uint8), deep=True)
    values.SetName(array.GetName())
    values.SetComponentName(0, UTF8)
    return values


def text_of_bytes(array):
    """Return the vtkStringArray that :func:`bytes_of_text` had; None for other arrays."""
    if not array.IsA("vtkUnsignedCharArray") or array.GetComponentName(0) != UTF8:
        return None
    encoded = vtk_to_numpy(array).tobytes()
    texts = [""] if encoded == b"\0" else encoded.decode("utf-8", "replace").split("\0")
    strings = vtkStringArray()
    strings.SetName(array.GetName())
    for text in texts:
        strings.InsertNextValue(text)
    return strings


def to_json(report: dict) -> str:
    """Return a report as JSON; numpy's numbers and arrays become plain ones."""
    return json.dumps(report, default=lambda v: v.tolist() if hasattr(v, "tolist") else str(v))


def vectors(points: np.ndarray) -> np.ndarray:
    """Return 2- or 3-component rows as 3-component rows, the third zero."""
    padded = np.zeros((*points.shape[:-1], 3))
    padded[..., : points.shape[-1]] = points
    return padded


def displacement_names(grid) -> list[str]:
    """Return the names of the arrays ``Displacement``, ``Displacement_1``, …, by their number."""
    points = grid.GetPointData()
    names = [points.GetArrayName(i) for i in range(points.GetNumberOfArrays())]
    found = [match for match in (DISPLACEMENT.match(name or "") for name in names) if match]
    return [match[0] for match in sorted(found, key=lambda match: int(match[1] or 0))]


def information_name(displacement: str) -> str:
    """Return the name of the information array beside a displacement array."""
    return displacement.replace("Displacement", "DisplacementInformation", 1)


def _names(data) -> str:
    names = [data.GetArrayName(i) for i in range(data.GetNumberOfArrays())]
    return ", ".join(repr(name) for name in names) or "none"
