"""From arrays to nodes: the map as a model, a transform per trial, a table and a plot.

All nodes of one result are in one folder of the subject hierarchy and carry the attribute
`ElastoIdentify.Result`, so that they can be found, replaced and removed together.
"""

from dataclasses import dataclass, field

import numpy as np
import slicer
import vtk
from elastoidentify.pipeline import Outcome
from elastoidentify.results import QUANTITIES, Status
from elastoidentify.vtk_io.arrays import rows_to_table, write_outcome
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from slicer.i18n import tr as _
from vtk.util.numpy_support import numpy_to_vtk

RESULT = "ElastoIdentify.Result"
ASIDE = "ElastoIdentify.Aside"
"""Attribute of the model of a result that a newer one has replaced; it holds the name it had."""

REST = "ElastoIdentify.Rest"
"""Reference of the model to its rest volume."""

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
    """Put an outcome of the pipeline into the scene and show it: the whole of it, or nothing."""
    before = set(_own_nodes())
    try:
        return _make_result(outcome, request, _free_name(name), show)
    except BaseException:
        for node in set(_own_nodes()) - before:
            _remove(node)
        raise


def _free_name(name: str) -> str:
    """Return the name, with a number where it is taken; MRML counts on where it is free again."""
    taken = slicer.mrmlScene.GetFirstNodeByName(name) is not None
    return slicer.mrmlScene.GenerateUniqueName(name) if taken else name


def _own_nodes() -> list:
    nodes = slicer.util.getNodesByClass("vtkMRMLNode")
    return [node for node in nodes if node.GetAttribute(RESULT)]


def _make_result(outcome: Outcome, request, name: str, show: str) -> Result:
    grid = result_grid(outcome)
    result = Result(_add("vtkMRMLModelNode", name))
    result.model.SetAndObserveMesh(grid)
    result.model.SetNodeReferenceID(REST, request.restVolume.GetID())
    result.model.SetAttribute("ElastoIdentify.Unit", request.unit)
    result.colors = stiffness_colors()
    _display_model(result.model, planar=outcome.mesh.cells.shape[1] == 3)
    result.undetermined = _undetermined_model(grid, outcome, name)
    show_quantity(result.model, show)
    geometry = _geometry(request.restVolume)
    edge = outcome.provenance["options"]["edge_length"]  # as used, which 0 leaves to the library
    for number, displacement in enumerate(outcome.displacements, 1):
        title = _("{name}: displacement {number}").format(name=name, number=number)
        node = _add("vtkMRMLGridTransformNode", title)
        _fill_transform(node, outcome.mesh.points, displacement, geometry, edge)
        result.transforms.append(node)
    result.table = _segment_table(outcome, name)
    result.chart = _chart(result.table, request, name)
    _file_together(result, name)
    return result


def _add(class_name: str, name: str):
    node = slicer.mrmlScene.AddNewNodeByClass(class_name, name)
    node.SetAttribute(RESULT, "1")
    return node


# ---- the map


def result_grid(outcome: Outcome):
    """Return the mesh with every array and report of the data on the wire, in world RAS."""
    outcome.result.report["warnings"] = outcome.warnings
    return write_outcome(outcome)


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
    known = QUANTITIES.get(quantity)
    title = known.title(model.GetAttribute("ElastoIdentify.Unit") or "") if known else quantity
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
    legend.SetTitleText(title)
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
    cells = np.flatnonzero(outcome.result.status == Status.NOT_DETERMINED)
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
    model = _add("vtkMRMLModelNode", _("{name}: not determined").format(name=name))
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
        axes = np.linalg.qr(axes)[0]
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


def _segment_table(outcome: Outcome, name: str):
    """Return a table node with the rows of the result's statistics, one per segment."""
    table = _add("vtkMRMLTableNode", _("{name}: segments").format(name=name))
    table.SetAndObserveTable(rows_to_table(outcome.result.statistics))
    for column in (name for name in outcome.result.statistics[0] if _is_modulus(name)):
        table.SetColumnUnitLabel(column, outcome.result.statistics[0]["unit"])
    return table


def _is_modulus(column: str) -> bool:
    quantity = QUANTITIES.get(column.split()[0])
    return quantity is not None and quantity.is_modulus and "ratio" not in column


def _chart(table, request, name: str):
    """Return a bar chart of the mean shear modulus of the segments.

    Slicer's plots have no error bars, and numbers instead of names at the ticks: both are written
    below the bars, in their order.
    """
    series = _add("vtkMRMLPlotSeriesNode", _("{name}: mean μ").format(name=name))
    series.SetAndObserveTableNodeID(table.GetID())
    series.SetPlotType(slicer.vtkMRMLPlotSeriesNode.PlotTypeBar)
    series.SetLabelColumnName("name")
    series.SetYColumnName("Mu mean")
    series.SetColor(0.2, 0.45, 0.6)
    chart = _add("vtkMRMLPlotChartNode", _("{name}: chart").format(name=name))
    chart.AddAndObservePlotSeriesNodeID(series.GetID())
    chart.SetTitle(_("Mean shear modulus"))  # longer ones are cut off in a quarter of a window
    chart.SetYAxisTitle(f"μ ({request.unit})")
    chart.SetXAxisTitle(", ".join(_bar_labels(table.GetTable())))
    chart.SetLegendVisibility(False)
    return chart


def _bar_labels(rows) -> list[str]:
    """Return name, mean and standard error of every row: ``tissue 1.04 ± 0.02``."""
    found = []
    for row in range(rows.GetNumberOfRows()):
        name, given, mean, error = (
            rows.GetValueByName(row, column)
            for column in ("name", "given", "Mu mean", "Mu standard error")
        )
        text = f"{name.ToString()} {mean.ToDouble():.3g}"
        if not given.ToInt() and np.isfinite(error.ToDouble()):
            text += f" ± {error.ToDouble():.1g}"
        found.append(text)
    return found


# ---- the folder


def _file_together(result: Result, name: str) -> None:
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    result.folder = hierarchy.CreateFolderItem(
        hierarchy.GetSceneItemID(), _("{name} map").format(name=name)
    )
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


def _folder_of(model) -> tuple[object, int, list]:
    """Return the hierarchy, the folder of a result, and what this module put there."""
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    folder = hierarchy.GetItemParent(hierarchy.GetItemByDataNode(model))
    children = vtk.vtkIdList()
    hierarchy.GetItemChildren(folder, children)
    items = [children.GetId(position) for position in range(children.GetNumberOfIds())]
    nodes = [hierarchy.GetItemDataNode(item) for item in items]
    nodes = [node for node in nodes if node is not None and node.GetAttribute(RESULT)]
    return hierarchy, folder, nodes


def is_map(model) -> bool:
    """Return whether a model node, or None, is the map of a result."""
    if model is None or not model.GetAttribute(RESULT) or model.GetMesh() is None:
        return False
    return model.GetMesh().GetCellData().HasArray("Status") == 1


def nodes_of_result(model) -> list:
    """Return the nodes of the result that a model node belongs to."""
    return _folder_of(model)[2]


def remove_result(model) -> None:
    """Remove the result that a model node belongs to: its folder and what this module put there."""
    hierarchy, folder, nodes = _folder_of(model)
    for node in nodes:
        _remove(node)
    children = vtk.vtkIdList()
    hierarchy.GetItemChildren(folder, children)
    if folder != hierarchy.GetSceneItemID() and not children.GetNumberOfIds():
        hierarchy.RemoveItem(folder)


# ---- the result before


def previous_result():
    """Return the model of the result that was put aside, or None."""
    return next((node for node in _own_nodes() if node.GetAttribute(ASIDE)), None)


def put_aside(model) -> None:
    """Hide a result and free its name; it is kept until another one is put aside."""
    name = model.GetName()
    _rename(model, name, _("{name} (previous)").format(name=name))
    model.SetAttribute(ASIDE, name)
    _set_visible(model, False)


def take_back(model) -> None:
    """Show a result that was put aside under the name that it had."""
    name = model.GetAttribute(ASIDE)
    _rename(model, model.GetName(), name)
    model.RemoveAttribute(ASIDE)
    _set_visible(model, True)


def _rename(model, old: str, new: str) -> None:
    """Change the name of a result in those of all its nodes and of its folder."""
    hierarchy, folder, nodes = _folder_of(model)
    for node in nodes:
        node.SetName(node.GetName().replace(old, new, 1))
    if folder != hierarchy.GetSceneItemID():
        hierarchy.SetItemName(folder, hierarchy.GetItemName(folder).replace(old, new, 1))


def _set_visible(model, visible: bool) -> None:
    """Show or hide the models of a result, and the legend."""
    for node in nodes_of_result(model):
        if node.IsA("vtkMRMLModelNode"):
            node.GetDisplayNode().SetVisibility(visible)
    legend = slicer.modules.colors.logic().GetColorLegendDisplayNode(model)
    if legend is not None:
        legend.SetVisibility(visible)


def replace_result(old, make) -> Result:
    """Make a result in the place of an old one, which stays as it is if that fails.

    Parameters
    ----------
    old : vtkMRMLModelNode or None
        Of another result or of something else: then nothing is replaced.
    make : callable
        Returns the new Result.
    """
    if old is None or not old.GetAttribute(RESULT):
        return make()
    forgotten = previous_result()
    if old.GetAttribute(ASIDE):
        return make()
    put_aside(old)
    try:
        result = make()
    except BaseException:
        take_back(old)
        raise
    if forgotten is not None:
        remove_result(forgotten)
    return result


def exchange(current):
    """Take back the result that was put aside and put the current one there; returns its model."""
    previous = previous_result()
    if previous is None:
        return current
    if current is not None and current.GetAttribute(RESULT) and current is not previous:
        put_aside(current)
    take_back(previous)
    return previous
