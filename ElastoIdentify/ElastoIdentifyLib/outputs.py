"""From arrays to nodes: the map as a model, a transform per trial, a table and a plot.

All nodes of one result are in one folder of the subject hierarchy and carry the attribute
`ElastoIdentify.Result`, so that they can be found, replaced and removed together.
"""

from dataclasses import dataclass, field

import numpy as np
import slicer
import vtk
from elastoidentify.filters.identification import write_identification
from elastoidentify.inverse.identify import STATUS_NOT_DETERMINED
from elastoidentify.pipeline import Outcome, summarise
from elastoidentify.vtk_io.convert import mesh_to_vtk, set_array
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from vtk.util.numpy_support import numpy_to_vtk

RESULT = "ElastoIdentify.Result"
SYMBOLS = {
    "Mu": "μ",
    "Lambda": "λ",
    "YoungModulus": "E",
    "PoissonRatio": "ν",
    "MuStd": "std of μ",
    "LambdaStd": "std of λ",
}
"""Cell arrays that the panel offers for display, as the legend names them."""

GREY = (0.55, 0.55, 0.55)


@dataclass
class Result:
    """The nodes of one result."""

    model: object
    undetermined: object = None
    transforms: list = field(default_factory=list)
    table: object = None
    chart: object = None
    colors: object = None
    folder: int = 0

    def nodes(self) -> list:
        """Return every data node that is there."""
        return [
            node
            for node in (self.model, self.undetermined, *self.transforms, self.table, self.chart)
            if node is not None
        ]


def make_result(outcome: Outcome, request, name: str = "Stiffness", show: str = "Mu") -> Result:
    """Put an outcome of the pipeline into the scene and show it."""
    name = slicer.mrmlScene.GenerateUniqueName(name)
    grid = result_grid(outcome)
    result = Result(_add("vtkMRMLModelNode", name))
    result.model.SetAndObserveMesh(grid)
    result.model.SetAttribute("ElastoIdentify.Unit", request.unit)
    result.colors = stiffness_colors()
    _display_model(result.model, planar=outcome.mesh.cells.shape[1] == 3)
    result.undetermined = _undetermined_model(grid, outcome, name)
    show_quantity(result.model, show)
    geometry = _geometry(request.restVolume)
    for number, displacement in enumerate(outcome.displacements, 1):
        node = _add("vtkMRMLGridTransformNode", f"{name}: displacement {number}")
        _fill_transform(node, outcome.mesh.points, displacement, geometry, request.edgeLength)
        result.transforms.append(node)
    result.table = _segment_table(outcome, request, name)
    result.chart = _chart(result.table, request, name)
    _file_together(result, name)
    return result


def _add(class_name: str, name: str):
    node = slicer.mrmlScene.AddNewNodeByClass(class_name, name)
    node.SetAttribute(RESULT, "1")
    return node


# ---- the map


def result_grid(outcome: Outcome):
    """Return the mesh with every array of the data on the wire, in world RAS."""
    mesh = outcome.mesh
    grid = mesh_to_vtk(mesh.points, mesh.cells)
    set_array(grid.GetCellData(), "Label", mesh.labels.astype(np.int32))
    set_array(grid.GetPointData(), "ReactionNodes", mesh.reaction_nodes.astype(np.uint8))
    for number, displacement in enumerate(outcome.displacements, 1):
        set_array(grid.GetPointData(), f"Displacement_{number}", displacement)
    if outcome.information is not None:
        for number, information in enumerate(outcome.information, 1):
            set_array(grid.GetPointData(), f"DisplacementInformation_{number}", information)
    outcome.result.report["warnings"] = outcome.warnings
    write_identification(grid, outcome.result)
    return grid


def _display_model(model, planar: bool) -> None:
    model.CreateDefaultDisplayNodes()
    # The file then holds points and vectors in the same axes: Slicer would flip the points only.
    model.AddDefaultStorageNode()
    storage = model.GetStorageNode()
    storage.SetCoordinateSystem(slicer.vtkMRMLStorageNode.CoordinateSystemRAS)
    display = model.GetDisplayNode()
    display.SetVisibility2D(True)
    display.SetSliceIntersectionOpacity(0.6)
    display.SetEdgeVisibility(not planar)
    display.SetBackfaceCulling(False)
    display.SetInterpolation(display.FlatInterpolation)
    display.SetAmbient(1.0 if planar else 0.3)  # a plane shows its colours as the legend has them
    display.SetDiffuse(0.0 if planar else 0.7)
    if planar:
        # A mesh that lies in the slice has no intersection with it.
        display.SetSliceDisplayModeToProjection()


def show_quantity(model, quantity: str) -> None:
    """Colour the map by one of its cell arrays, with a legend that says its unit."""
    display = model.GetDisplayNode()
    values = slicer.util.arrayFromModelCellData(model, quantity)
    finite = values[np.isfinite(values)]
    display.SetActiveScalar(quantity, vtk.vtkAssignAttribute.CELL_DATA)
    display.SetAndObserveColorNodeID(stiffness_colors().GetID())
    display.SetScalarRangeFlag(display.UseManualScalarRange)
    low, high = np.percentile(finite, [1, 99]) if len(finite) else (0.0, 1.0)
    display.SetScalarRange(low, high if high > low else low + max(abs(low), 1.0) * 1e-3)
    display.SetScalarVisibility(True)
    unit = "" if quantity == "PoissonRatio" else f" ({model.GetAttribute('ElastoIdentify.Unit')})"
    legend = slicer.modules.colors.logic().AddDefaultColorLegendDisplayNode(display)
    for letters, size in (
        (legend.GetTitleTextProperty(), 16),
        (legend.GetLabelTextProperty(), 14),
    ):
        letters.SetFontFamilyToArial()
        letters.SetFontSize(size)
    legend.SetSize(0.12, 0.4)
    legend.SetUseColorNamesForLabels(False)
    legend.SetLabelFormat("%.3g")
    legend.SetTitleText(SYMBOLS.get(quantity, quantity) + unit)
    legend.SetVisibility(True)
    legend.Modified()  # letters do not tell


def stiffness_colors():
    """Return the colour table of the maps; made when first asked for.

    A cube helix (Green 2011, Bulletin of the Astronomical Society of India 39, 289): brightness
    rises evenly, so that the map reads the same in grey and for the colour-blind.
    """
    name = "ElastoIdentify stiffness"
    node = slicer.mrmlScene.GetFirstNode(name, "vtkMRMLColorTableNode")
    if node is not None:
        return node
    node = slicer.vtkMRMLColorTableNode()
    node.SetTypeToUser()
    node.SetName(name)
    node.SetNumberOfColors(256)
    for number, (red, green, blue) in enumerate(cube_helix(np.linspace(0.15, 0.85, 256))):
        node.SetColor(number, f"{number}", red, green, blue, 1.0)
    node.GetLookupTable().SetNanColor(*GREY, 1.0)
    node.SetAttribute("Category", "ElastoIdentify")
    slicer.mrmlScene.AddNode(node)
    return node


def cube_helix(brightness: np.ndarray, start=0.9, rotations=-0.9, hue=1.4) -> np.ndarray:
    """Return colours (n, 3) of brightness 0…1, Green's eq. 2."""
    angle = 2 * np.pi * (start / 3 + rotations * brightness)
    amplitude = hue * brightness * (1 - brightness) / 2
    weights = np.array([[-0.14861, 1.78277], [-0.29227, -0.90649], [1.97294, 0.0]])
    waves = np.stack([np.cos(angle), np.sin(angle)])
    return np.clip(brightness[:, None] + amplitude[:, None] * (weights @ waves).T, 0, 1)


def _undetermined_model(grid, outcome: Outcome, name: str):
    """Show the cells that are not determined as a grey grid over the map, so that nobody errs."""
    cells = np.flatnonzero(outcome.result.status == STATUS_NOT_DETERMINED)
    if not len(cells):
        return None
    ids = vtk.vtkIdList()
    for cell in cells:
        ids.InsertNextId(int(cell))
    extract = vtk.vtkExtractCells()
    extract.SetInputData(grid)
    extract.SetCellList(ids)
    extract.Update()
    part = vtk.vtkUnstructuredGrid()
    part.CopyStructure(extract.GetOutput())
    planar = outcome.mesh.cells.shape[1] == 3
    model = _add("vtkMRMLModelNode", f"{name}: not determined")
    model.SetAndObserveMesh(part)
    _display_model(model, planar)
    display = model.GetDisplayNode()
    display.SetColor(*GREY)
    display.SetEdgeVisibility(True)
    display.SetEdgeColor(0.15, 0.15, 0.15)
    display.SetScalarVisibility(False)
    return model


# ---- displacements


@dataclass
class _Geometry:
    origin: np.ndarray
    axes: np.ndarray  # columns: unit vectors of i, j, k
    spacing: np.ndarray


def _geometry(volume) -> _Geometry:
    from .images import ijk_to_world

    matrix = ijk_to_world(volume)
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    axes = matrix[:3, :3] / spacing
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-6:  # sheared: a grid needs right angles
        axes, _ = np.linalg.qr(axes)
    return _Geometry(matrix[:3, 3], axes, spacing)


def _fill_transform(node, points, displacement, geometry: _Geometry, edge_length: float) -> None:
    """Make a grid transform of nodal displacements, rest → pushed, along the image's axes.

    Within the mesh the displacement is interpolated linearly; around it, the nearest node's is
    carried on, because a grid cannot have holes. The grid is one edge length larger all round.
    """
    local = (points - geometry.origin) @ geometry.axes
    extent = np.ptp(local, axis=0)
    wide = extent > 1e-6 * extent.max()
    step = np.where(wide, edge_length / 2, np.maximum(geometry.spacing, edge_length))
    low = local.min(axis=0) - np.where(wide, edge_length, step)
    size = np.where(wide, np.ceil((extent + 2 * edge_length) / step) + 1, 3).astype(int)
    index = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), -1)
    places = (index.transpose(2, 1, 0, 3).reshape(-1, 3) * step + low)[:, wide]
    values = LinearNDInterpolator(local[:, wide], displacement)(places)
    holes = ~np.isfinite(values).all(axis=1)
    values[holes] = NearestNDInterpolator(local[:, wide], displacement)(places[holes])

    grid = vtk.vtkImageData()
    grid.SetDimensions(*(int(n) for n in size))
    grid.SetOrigin(*(geometry.origin + geometry.axes @ low))
    grid.SetSpacing(*step)
    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName("Displacement")
    grid.GetPointData().SetScalars(array)
    direction = np.eye(4)
    direction[:3, :3] = geometry.axes
    transform = slicer.vtkOrientedGridTransform()
    transform.SetDisplacementGridData(grid)
    transform.SetGridDirectionMatrix(slicer.util.vtkMatrixFromArray(direction))
    transform.SetInterpolationModeToCubic()  # as it will be when read from a file
    node.SetAndObserveTransformToParent(transform)
    node.CreateDefaultDisplayNodes()
    node.GetDisplayNode().SetVisibility(False)


# ---- figures


def _segment_table(outcome: Outcome, request, name: str):
    """Return a table node with one row per segment of the mesh."""
    rows = summarise(outcome.mesh.labels, outcome.result)
    unit = request.unit
    table = _add("vtkMRMLTableNode", f"{name}: segments")
    columns = {"Segment": [], "Role": [], "Cells": [], "Identified (%)": []}
    for label, segment, material in request.segments().values():
        if label not in rows:
            continue
        columns["Segment"].append(segment)
        columns["Role"].append(material.role)
        columns["Cells"].append(rows[label]["cells"])
        columns["Identified (%)"].append(round(100 * rows[label]["identified"], 2))
        for key, value in rows[label].items():
            quantity, _, statistic = key.partition(" ")
            if statistic:
                suffix = "" if quantity == "PoissonRatio" else f" ({unit})"
                columns.setdefault(f"{quantity} {statistic}{suffix}", []).append(value)
    for title, values in columns.items():
        if title in ("Segment", "Role"):
            column = vtk.vtkStringArray()
        elif title == "Cells":
            column = vtk.vtkIntArray()
        else:
            column = vtk.vtkDoubleArray()
        column.SetName(title)
        for value in values:
            column.InsertNextValue(value)
        table.AddColumn(column)
    return table


def _chart(table, request, name: str):
    """Return a bar chart of the median shear modulus of the segments."""
    series = _add("vtkMRMLPlotSeriesNode", f"{name}: median μ")
    series.SetAndObserveTableNodeID(table.GetID())
    series.SetPlotType(slicer.vtkMRMLPlotSeriesNode.PlotTypeBar)
    series.SetLabelColumnName("Segment")
    series.SetYColumnName(f"Mu median ({request.unit})")
    series.SetColor(0.2, 0.45, 0.6)
    chart = _add("vtkMRMLPlotChartNode", f"{name}: chart")
    chart.AddAndObservePlotSeriesNodeID(series.GetID())
    chart.SetTitle("Median shear modulus by segment")
    chart.SetYAxisTitle(f"μ ({request.unit})")
    chart.SetXAxisTitle("Segment")
    chart.SetLegendVisibility(False)
    return chart


# ---- the folder


def _file_together(result: Result, name: str) -> None:
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    result.folder = hierarchy.CreateFolderItem(hierarchy.GetSceneItemID(), f"{name} map")
    series = result.chart.GetNthPlotSeriesNode(0)
    for node in [*result.nodes(), series]:
        item = hierarchy.GetItemByDataNode(node)
        if item:
            hierarchy.SetItemParent(item, result.folder)
        else:  # the application makes an item for every node, a script's Slicer may not
            hierarchy.CreateItem(result.folder, node)


def _remove(node) -> None:
    """Remove a node with its display and storage nodes."""
    belongings = []
    if node.IsA("vtkMRMLDisplayableNode"):
        belongings += [node.GetNthDisplayNode(n) for n in range(node.GetNumberOfDisplayNodes())]
    if node.IsA("vtkMRMLStorableNode"):
        belongings.append(node.GetStorageNode())
    for one in [node, *belongings]:
        if one is not None:
            slicer.mrmlScene.RemoveNode(one)


def remove_result(model) -> None:
    """Remove the result that a model node belongs to: its folder and what this module put there."""
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    folder = hierarchy.GetItemParent(hierarchy.GetItemByDataNode(model))
    children = vtk.vtkIdList()
    hierarchy.GetItemChildren(folder, children)
    for position in range(children.GetNumberOfIds()):
        node = hierarchy.GetItemDataNode(children.GetId(position))
        if node is not None and node.GetAttribute(RESULT):
            _remove(node)
    hierarchy.GetItemChildren(folder, children)
    if folder != hierarchy.GetSceneItemID() and not children.GetNumberOfIds():
        hierarchy.RemoveItem(folder)
