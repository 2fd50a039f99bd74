"""A slice view and a 3-D view without a window, drawn by Slicer's own displayable managers.

As in the application, the views come first and the nodes later: a colour legend that is older than
a view does not show in it.
"""

from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import slicer
import vtk
from vtk.util.numpy_support import vtk_to_numpy

SLICE_MANAGERS = (
    "vtkMRMLModelSliceDisplayableManager",
    "vtkMRMLTransformsDisplayableManager2D",
    "vtkMRMLColorLegendDisplayableManager",
)
SPACE_MANAGERS = (
    "vtkMRMLCameraDisplayableManager",
    "vtkMRMLViewDisplayableManager",
    "vtkMRMLModelDisplayableManager",
    "vtkMRMLColorLegendDisplayableManager",
)


@dataclass
class View:
    """A renderer with the managers that fill it."""

    window: vtk.vtkRenderWindow
    renderer: vtk.vtkRenderer
    keep: list = field(default_factory=list)

    def array(self) -> np.ndarray:
        """Render and return the picture, (height, width, 3) uint8, first row at the top."""
        self.window.Render()
        grab = vtk.vtkWindowToImageFilter()
        grab.SetInput(self.window)
        grab.ReadFrontBufferOff()
        grab.Update()
        data = grab.GetOutput()
        width, height, _ = data.GetDimensions()
        pixels = vtk_to_numpy(data.GetPointData().GetScalars()).reshape(height, width, -1)
        return pixels[::-1, :, :3]

    def look(self, direction, up) -> None:
        """Look at everything against `direction` (RAS, towards the viewer)."""
        self.renderer.ResetCamera()
        camera = self.renderer.GetActiveCamera()
        focus = np.array(camera.GetFocalPoint())
        camera.SetPosition(*(focus + camera.GetDistance() * np.array(direction)))
        camera.SetViewUp(*up)
        self.renderer.ResetCamera()

    def save(self, path) -> None:
        """Render into a PNG file."""
        from PySide6 import QtGui

        pixels = np.ascontiguousarray(self.array())
        height, width, _ = pixels.shape
        image = QtGui.QImage(pixels, width, height, 3 * width, QtGui.QImage.Format_RGB888)
        image.save(str(path))


def _managers(names, factory_class, node, renderer):
    factory = factory_class.GetInstance() if hasattr(factory_class, "GetInstance") else None
    factory = factory or factory_class()
    application = slicer.app.applicationLogic()
    factory.SetMRMLApplicationLogic(application)
    for name in names:
        if not factory.IsDisplayableManagerRegistered(name):
            factory.RegisterDisplayableManager(name)
    group = factory.InstantiateDisplayableManagers(renderer)
    group.SetMRMLDisplayableNode(node)
    return factory, group


def _window(size):
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(True)
    window.SetSize(*size)
    renderer = vtk.vtkRenderer()
    window.AddRenderer(renderer)
    interactor = vtk.vtkGenericRenderWindowInteractor()
    interactor.SetRenderWindow(window)
    window.SetInteractor(interactor)
    return window, renderer, interactor


@contextmanager
def slice_view(volume, axis_vectors, size=(720, 720)):
    """Show a volume in a slice view.

    Parameters
    ----------
    volume : vtkMRMLScalarVolumeNode
    axis_vectors : (3, 3)
        Columns: RAS directions to the right, up, and towards the viewer.
    """
    scene = slicer.mrmlScene
    logic = slicer.vtkMRMLSliceLogic()
    logic.SetMRMLScene(scene)
    logic.SetMRMLApplicationLogic(slicer.app.applicationLogic())
    node = logic.AddSliceNode("Red")
    slicer.app.applicationLogic().GetSliceLogics().AddItem(logic)
    composite = logic.GetSliceCompositeNode()
    composite.SetBackgroundVolumeID(volume.GetID())
    matrix = np.eye(4)
    matrix[:3, :3] = axis_vectors
    node.GetSliceToRAS().DeepCopy(slicer.util.vtkMatrixFromArray(matrix))
    node.UpdateMatrices()
    node.SetDimensions(*size, 1)
    logic.FitSliceToAll(*size)

    window, renderer, interactor = _window(size)
    mapper = vtk.vtkImageMapper()
    mapper.SetColorWindow(255)
    mapper.SetColorLevel(127.5)
    mapper.SetInputConnection(logic.GetImageDataConnection())
    picture = vtk.vtkActor2D()
    picture.SetMapper(mapper)
    picture.GetProperty().SetDisplayLocationToBackground()
    renderer.AddViewProp(picture)
    keep = _managers(
        SLICE_MANAGERS, slicer.vtkMRMLSliceViewDisplayableManagerFactory, node, renderer
    )
    try:
        yield View(window, renderer, [logic, interactor, mapper, *keep])
    finally:
        window.Finalize()
        slicer.app.applicationLogic().GetSliceLogics().RemoveItem(logic)
        for leftover in (logic.GetSliceModelNode(), composite, node):
            scene.RemoveNode(leftover)
        logic.SetMRMLScene(None)


@contextmanager
def space_view(size=(720, 720), node=None):
    """Show the models of the scene in a 3-D view; its node may be that of a layout."""
    scene = slicer.mrmlScene
    node = node or scene.AddNewNodeByClass("vtkMRMLViewNode", "View1")
    node.SetBackgroundColor(0.756863, 0.764706, 0.909804)  # Slicer's own
    node.SetBackgroundColor2(0.454902, 0.470588, 0.745098)
    node.SetBoxVisible(False)
    node.SetAxisLabelsVisible(False)
    window, renderer, interactor = _window(size)
    keep = _managers(
        SPACE_MANAGERS, slicer.vtkMRMLThreeDViewDisplayableManagerFactory, node, renderer
    )
    view = View(window, renderer, [interactor, *keep])
    try:
        yield view
    finally:
        window.Finalize()
