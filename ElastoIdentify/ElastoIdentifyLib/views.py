"""What the main window shows of a result: the map over the image, in 3-D, the table, the chart."""

import numpy as np
import slicer
from vtk.util.numpy_support import vtk_to_numpy

from .images import ijk_to_world
from .outputs import nodes_of_result, show_quantity

LAYOUT = 7137
"""Number of the module's layout; Slicer's own end at 100."""

EDGEWISE = 0.2
"""Sine of the angle between line of sight and plane below which a plane map is not seen."""

LAYOUT_DESCRIPTION = """
<layout type="vertical" split="true">
 <item splitSize="600">
  <layout type="horizontal">
   <item>
    <view class="vtkMRMLSliceNode" singletontag="Red">
     <property name="orientation" action="default">Axial</property>
     <property name="viewlabel" action="default">R</property>
     <property name="viewcolor" action="default">#F34A33</property>
    </view>
   </item>
   <item>
    <view class="vtkMRMLViewNode" singletontag="1">
     <property name="viewlabel" action="default">1</property>
    </view>
   </item>
  </layout>
 </item>
 <item splitSize="300">
  <layout type="horizontal">
   <item>
    <view class="vtkMRMLTableViewNode" singletontag="TableView1">
     <property name="viewlabel" action="default">T</property>
    </view>
   </item>
   <item>
    <view class="vtkMRMLPlotViewNode" singletontag="PlotView1">
     <property name="viewlabel" action="default">P</property>
    </view>
   </item>
  </layout>
 </item>
</layout>
"""


def register_layout() -> None:
    """Make the module's layout known; a scene that was saved with it shows no view otherwise."""
    manager = slicer.app.layoutManager()
    if manager is not None:
        manager.layoutLogic().GetLayoutNode().AddLayoutDescription(LAYOUT, LAYOUT_DESCRIPTION)


def show_result(result, request) -> None:
    """Show the map over the rest volume in the red view, in 3-D, and the table and the chart.

    Does nothing without a main window.

    Parameters
    ----------
    result : ElastoIdentifyLib.outputs.Result
    request : ElastoIdentifyLib.request.Request
    """
    manager = slicer.app.layoutManager()
    if manager is None:
        return
    register_layout()
    manager.setLayout(LAYOUT)
    _renew_legend(result.model)
    red = slicer.mrmlScene.GetNodeByID("vtkMRMLSliceNodeRed")
    turn_to_map(red, result.model, request)
    show_figures(result.model)
    turn_camera(slicer.mrmlScene.GetFirstNodeByClass("vtkMRMLViewNode"), result.model, red)


def show_figures(model) -> None:
    """Show the table and the chart of a result in the views that show some."""
    logic = slicer.app.applicationLogic()
    selection = logic.GetSelectionNode()
    for node in nodes_of_result(model):
        if node.IsA("vtkMRMLTableNode"):
            selection.SetActiveTableID(node.GetID())
        elif node.IsA("vtkMRMLPlotChartNode"):
            selection.SetActivePlotChartID(node.GetID())
    logic.PropagateTableSelection()
    logic.PropagatePlotChartSelection()


def _renew_legend(model) -> None:
    """Make the legend anew: a legend is not drawn in views that are younger than itself."""
    legend = slicer.modules.colors.logic().GetColorLegendDisplayNode(model)
    if legend is not None:
        slicer.mrmlScene.RemoveNode(legend)
    show_quantity(model, model.GetDisplayNode().GetActiveScalarName())


def turn_to_map(slice_node, model, request) -> None:
    """Show the rest volume in a slice view, in the plane of the map (of a 3-D map: its middle)."""
    _turn_to_slices(slice_node, request.restVolume, request.sliceAxis)
    points = vtk_to_numpy(model.GetMesh().GetPoints().GetData())
    slice_node.JumpSliceByOffsetting(*(points.max(axis=0) + points.min(axis=0)) / 2)


def turn_camera(view_node, model, slice_node) -> None:
    """Look at a model in a 3-D view as a slice view does, but a little from the side.

    Slicer's own reset of a view keeps the axis along which it looks; a plane may be seen along its
    edge then, which shows nothing.
    """
    camera = _camera_of(view_node)
    if camera is None:
        return
    right, up = slicer.util.arrayFromVTKMatrix(slice_node.GetSliceToRAS())[:3, :2].T
    towards = np.cross(right, up) + 0.2 * right - 0.35 * up
    towards /= np.linalg.norm(towards)
    points = vtk_to_numpy(model.GetMesh().GetPoints().GetData())
    low, high = points.min(axis=0), points.max(axis=0)
    centre, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    distance = radius / np.sin(np.radians(camera.GetViewAngle()) / 2)
    was_modified = camera.StartModify()
    camera.SetFocalPoint(*centre)
    camera.SetPosition(*(centre + distance * towards))
    camera.SetViewUp(*up)
    camera.EndModify(was_modified)
    camera.ResetClippingRange()


def mend_camera(model) -> None:
    """Turn the camera to a plane map that it sees along its edge, as a closed scene leaves it.

    A view that shows the map is left as it is.
    """
    if slicer.app.layoutManager() is None or model is None or model.GetMesh() is None:
        return
    view = slicer.mrmlScene.GetFirstNodeByClass("vtkMRMLViewNode")
    camera = None if view is None else _camera_of(view)
    red = slicer.mrmlScene.GetNodeByID("vtkMRMLSliceNodeRed")
    if camera is None or red is None:
        return
    points = vtk_to_numpy(model.GetMesh().GetPoints().GetData())
    sizes, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[1:]
    sight = np.subtract(camera.GetFocalPoint(), camera.GetPosition())
    flat = sizes[2] < 1e-3 * sizes[1]
    if flat and abs(axes[2] @ sight) < EDGEWISE * np.linalg.norm(sight):
        turn_camera(view, model, red)


def draw_again() -> None:
    """Draw the 3-D views: what a scene brings is at times not drawn yet when it has been read."""
    manager = slicer.app.layoutManager()
    if manager is not None:
        for number in range(manager.threeDViewCount):
            manager.threeDWidget(number).threeDView().scheduleRender()


def _camera_of(view_node):
    name = view_node.GetLayoutName()
    cameras = slicer.util.getNodesByClass("vtkMRMLCameraNode")
    return next((camera for camera in cameras if camera.GetLayoutName() == name), None)


def show_volume(volume) -> None:
    """Show a volume in the slice views, the red one in the plane of its slices."""
    red = slicer.mrmlScene.GetNodeByID("vtkMRMLSliceNodeRed")
    if red is not None:
        _turn_to_slices(red, volume, 2)


def _turn_to_slices(slice_node, volume, axis: int) -> None:
    """Turn a slice view into the slices of a volume across an axis; go to the volume's middle.

    Patient's left stays on the right, and anterior or superior at the top, as radiologists expect.
    """
    size = volume.GetImageData().GetDimensions()
    axis = size.index(1) if 1 in size else axis
    across = ijk_to_world(volume)[:3, axis]
    slice_node.SetOrientation(("Sagittal", "Coronal", "Axial")[int(np.abs(across).argmax())])
    slice_node.RotateToVolumePlane(volume)
    slicer.util.setSliceViewerLayers(background=volume, fit=True)
