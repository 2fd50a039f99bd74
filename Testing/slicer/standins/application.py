"""The application object, the scene and the module logics, without Qt."""

import os
import sys
import tempfile
import types
from pathlib import Path

import slicer
import slicer.util
import vtk


class Signals:
    """Something to connect to that never has anything to say."""

    def connect(self, signal, slot):
        return True

    def disconnect(self, signal, slot):
        return True


class LayoutManager:
    """Slicer's own layouts and slice logics, without a window around them."""

    def __init__(self):
        self._logic = slicer.vtkMRMLLayoutLogic()
        self._logic.SetMRMLScene(slicer.mrmlScene)
        self._slices = vtk.vtkCollection()

    def layoutLogic(self):
        return self._logic

    def mrmlSliceLogics(self):
        return self._slices

    def setLayout(self, number):
        """Make the views of a layout, as the application does when it is first shown."""
        node = self._logic.GetLayoutNode()
        if not node.IsLayoutDescription(number):
            raise ValueError(f"no layout has the number {number}")
        node.SetViewArrangement(number)
        views = self._logic.GetViewNodes()
        for position in range(views.GetNumberOfItems()):
            view = views.GetItemAsObject(position)
            if view.IsA("vtkMRMLSliceNode") and not self._shown(view):
                logic = slicer.vtkMRMLSliceLogic()
                logic.SetMRMLScene(slicer.mrmlScene)
                logic.SetMRMLApplicationLogic(slicer.app.applicationLogic())
                logic.SetSliceNode(view)
                self._slices.AddItem(logic)

    def _shown(self, view):
        logics = (self._slices.GetItemAsObject(n) for n in range(self._slices.GetNumberOfItems()))
        return any(logic.GetSliceNode() is view for logic in logics)

    def resetThreeDViews(self):
        pass  # no window, no camera

    def _close(self):
        """Take the views out of the scene; singletons stay in it otherwise."""
        nodes = [self._logic.GetLayoutNode()]
        for position in range(self._slices.GetNumberOfItems()):
            logic = self._slices.GetItemAsObject(position)
            nodes += [logic.GetSliceModelNode(), logic.GetSliceCompositeNode()]
            logic.SetMRMLScene(None)
        views = self._logic.GetViewNodes()
        nodes += [views.GetItemAsObject(n) for n in range(views.GetNumberOfItems())]
        self._logic.SetMRMLScene(None)
        for node in nodes:
            if node is not None and slicer.mrmlScene.IsNodePresent(node):
                slicer.mrmlScene.RemoveNode(node)


class Application:
    """What module logic may ask of `slicer.app`; anything else raises AttributeError."""

    majorVersion, minorVersion = 5, 13

    def __init__(self, logic):
        self._logic = logic
        self.startup = []
        self.signals = Signals()
        self.layouts = None

    def applicationLogic(self):
        return self._logic

    def coreIOManager(self):
        return self.files

    def testingEnabled(self):
        return True

    def topLevelWidgets(self):
        return []

    def processEvents(self, *_):
        pass

    def translate(self, context, text):
        return text

    def connect(self, signal, slot):
        self.startup.append((signal, slot))

    def moduleManager(self):
        return self.signals

    def layoutManager(self):
        """None, as without a main window, unless a test made one."""
        return self.layouts

    def setOverrideCursor(self, *_):
        pass

    def restoreOverrideCursor(self):
        pass


STORAGE = {
    ".seg.nrrd": ("vtkMRMLSegmentationStorageNode", "vtkMRMLSegmentationNode"),
    ".vtk": ("vtkMRMLModelStorageNode", "vtkMRMLModelNode"),
    ".vtu": ("vtkMRMLModelStorageNode", "vtkMRMLModelNode"),
    ".h5": ("vtkMRMLTransformStorageNode", "vtkMRMLTransformNode"),
    ".tsv": ("vtkMRMLTableStorageNode", "vtkMRMLTableNode"),
}


class FileManager:
    """Enough of the application's file manager for `slicer.util.loadSegmentation` and the like."""

    def fileType(self, path):
        return next((key for key in STORAGE if path.lower().endswith(key)), "volume")

    def fileWriterFileType(self, node, format=None):
        return node.GetClassName()

    def loadNodes(self, file_type, properties, collection=None, messages=None):
        path = properties["fileName"]
        name = properties.get("name") or Path(path).name.split(".")[0]
        if not os.path.isfile(path):
            return False
        # A labelmap in a plain file becomes segments if they are asked for.
        suffix = ".seg.nrrd" if file_type == "SegmentationFile" else self.fileType(path)
        if suffix == "volume":
            bits = {"labelmap": 1, "singleFile": 4}  # of the logic's loading options
            asked = sum(bit for word, bit in bits.items() if properties.get(word))
            node = slicer.modules.volumes.logic().AddArchetypeVolume(path, name, asked)
        else:
            storage_class, node_class = STORAGE[suffix]
            node = slicer.mrmlScene.AddNewNodeByClass(node_class, name)
            storage = slicer.mrmlScene.AddNewNodeByClass(storage_class)
            storage.SetFileName(path)
            if not storage.ReadData(node):
                return False
            node.SetAndObserveStorageNodeID(storage.GetID())
            node.CreateDefaultDisplayNodes()
        if collection is not None:
            collection.AddItem(node)
        return node is not None

    def saveNodes(self, file_type, properties, messages=None):
        if file_type == "SceneFile":
            return slicer.mrmlScene.WriteToMRB(properties["fileName"], None)
        node = slicer.mrmlScene.GetNodeByID(properties["nodeID"])
        node.AddDefaultStorageNode()
        node.GetStorageNode().SetFileName(properties["fileName"])
        return bool(node.GetStorageNode().WriteData(node))


LOGICS = {
    "colors": ("vtkSlicerColorLogic", "Colors"),  # registers the colour legend's node
    "terminologies": ("vtkSlicerTerminologiesModuleLogic", "Terminologies"),
    "segmentations": ("vtkSlicerSegmentationsModuleLogic", "Segmentations"),
    "subjecthierarchy": ("vtkSlicerSubjectHierarchyModuleLogic", "SubjectHierarchy"),
    "volumes": ("vtkSlicerVolumesLogic", "Volumes"),
    "models": ("vtkSlicerModelsLogic", "Models"),
    "transforms": ("vtkSlicerTransformLogic", "Transforms"),
    "tables": ("vtkSlicerTablesLogic", "Tables"),
    "plots": ("vtkSlicerPlotsLogic", "Plots"),
}


def start():
    """Make `slicer.mrmlScene`, `slicer.app` and `slicer.modules`; returns the scene."""
    verbosity = vtk.vtkLogger.GetCurrentVerbosityCutoff()
    vtk.vtkLogger.SetStderrVerbosity(vtk.vtkLogger.VERBOSITY_OFF)  # files of the application
    try:
        return _start()
    finally:
        vtk.vtkLogger.SetStderrVerbosity(verbosity)


def _start():
    scene = slicer.vtkMRMLScene()
    logic = slicer.vtkSlicerApplicationLogic()
    logic.SetMRMLScene(scene)
    logic.GetColorLogic().SetMRMLScene(scene)
    logic.GetColorLogic().AddDefaultColorNodes()
    logic.SetSliceLogics(vtk.vtkCollection())
    logic.SetViewLogics(vtk.vtkCollection())
    slicer.mrmlScene = scene
    slicer.app = Application(logic)
    slicer.app.files = FileManager()

    slicer.modules = types.ModuleType("slicer.modules")
    sys.modules["slicer.modules"] = slicer.modules
    for name, (class_name, logic_name) in LOGICS.items():
        module_logic = getattr(slicer, class_name)()
        module_logic.SetMRMLScene(scene)
        module_logic.SetMRMLApplicationLogic(logic)
        logic.SetModuleLogic(logic_name, module_logic)
        setattr(slicer.modules, name, types.SimpleNamespace(logic=lambda it=module_logic: it))

    # Scenes are packed and unpacked (.mrb) through the data manager.
    remote = slicer.vtkMRMLRemoteIOLogic()
    remote.SetMRMLScene(scene)
    remote.SetMRMLApplicationLogic(logic)
    remote.GetCacheManager().SetRemoteCacheDirectory(tempfile.mkdtemp(prefix="slicer-cache-"))
    manager = slicer.vtkDataIOManagerLogic()
    manager.SetMRMLScene(scene)
    manager.SetMRMLApplicationLogic(logic)
    manager.SetAndObserveDataIOManager(remote.GetDataIOManager())
    remote.AddDataIOToScene()
    slicer.app.keep = (remote, manager)
    return scene
