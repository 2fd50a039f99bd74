"""The Python packages of Slicer that scripted modules import, reduced to what they promise."""

import enum
import os
import sys
import types
import typing
import unittest
from dataclasses import dataclass

import slicer
import vtk


def install(module_file: str) -> None:
    """Make slicer.ScriptedLoadableModule, slicer.i18n, slicer.parameterNodeWrapper importable.

    Parameters
    ----------
    module_file : str
        The scripted module under test; its Resources folder is beside it.
    """
    slicer.util.modulePath = lambda name: module_file
    _module(
        "slicer.ScriptedLoadableModule",
        ScriptedLoadableModule=ScriptedLoadableModule,
        ScriptedLoadableModuleWidget=ScriptedLoadableModuleWidget,
        ScriptedLoadableModuleLogic=ScriptedLoadableModuleLogic,
        ScriptedLoadableModuleTest=ScriptedLoadableModuleTest,
    )
    _module("slicer.i18n", tr=lambda text: text, translate=lambda context, text: text)
    _module(
        "slicer.parameterNodeWrapper",
        parameterNodeWrapper=parameterNodeWrapper,
        Choice=Choice,
        WithinRange=WithinRange,
    )


def _module(name: str, **content) -> None:
    module = types.ModuleType(name)
    module.__dict__.update(content)
    sys.modules[name] = module
    setattr(slicer, name.rpartition(".")[2], module)


# ---- base classes


class ScriptedLoadableModule:
    def __init__(self, parent):
        self.parent = parent


class ScriptedLoadableModuleWidget:
    def __init__(self, parent=None):
        import qt

        self.moduleName = type(self).__name__.removesuffix("Widget")
        self.parent = parent
        if parent is None:
            self.parent = slicer.qMRMLWidget()
            self.parent.setLayout(qt.QVBoxLayout())
            self.parent.setMRMLScene(slicer.mrmlScene)
        self.layout = self.parent.layout()
        if parent is None:
            self.setup()

    def setup(self):
        pass

    def resourcePath(self, name):
        folder = os.path.dirname(slicer.util.modulePath(self.moduleName))
        return os.path.join(folder, "Resources", name)


class ScriptedLoadableModuleLogic:
    def __init__(self, parent=None):
        self.moduleName = type(self).__name__.removesuffix("Logic")

    def getParameterNode(self):
        scene, tag, kind = slicer.mrmlScene, self.moduleName, "vtkMRMLScriptedModuleNode"
        node = scene.GetSingletonNode(tag, kind)
        if node is None:
            node = scene.CreateNodeByClass(kind)
            node.UnRegister(None)
            node.SetSingletonTag(tag)
            node.SetName(tag)
            node = scene.AddNode(node)
        node.SetAttribute("ModuleName", tag)
        node.SetModuleName(tag)
        return node


class ScriptedLoadableModuleTest(unittest.TestCase):
    def __init__(self, *args):
        super().__init__(*(args or ("runTest",)))

    def delayDisplay(self, message, *_):
        print(message)

    def runTest(self):
        pass


# ---- parameter nodes


@dataclass(frozen=True)
class Choice:
    choices: list


@dataclass(frozen=True)
class WithinRange:
    low: float
    high: float


def parameterNodeWrapper(cls):
    """Give a class of annotations typed access to the parameters of an MRML node."""
    hints = typing.get_type_hints(cls, include_extras=True)
    for name, hint in hints.items():
        parameter = _Parameter(name, hint, getattr(cls, name, None))
        setattr(cls, name, parameter)
    cls.allParameters = {name: getattr(cls, name) for name in hints}
    for method in (_init, connectGui, disconnectGui, StartModify, EndModify, AddObserver):
        setattr(cls, {"_init": "__init__"}.get(method.__name__, method.__name__), method)
    cls.RemoveObserver = lambda self, tag: self.parameterNode.RemoveObserver(tag)
    cls.__eq__ = lambda self, other: (
        type(self) is type(other) and self.parameterNode is other.parameterNode
    )
    cls.__hash__ = lambda self: hash(self.parameterNode)
    return cls


class _Kind(enum.Enum):
    VALUE, NODE, NODES = range(3)


class _Parameter:
    """One typed attribute: a value as text, a node reference, or a list of node references."""

    def __init__(self, name, hint, default):
        self.name = name
        self.type, *self.annotations = (
            typing.get_args(hint) if typing.get_origin(hint) is typing.Annotated else (hint,)
        )
        self.default = default
        self.kind = _Kind.VALUE
        if typing.get_origin(self.type) is list:
            self.kind = _Kind.NODES
        elif issubclass(self.type, slicer.vtkMRMLNode):
            self.kind = _Kind.NODE
        elif default is None:
            self.default = self.type()

    def annotation(self, kind):
        return next((note for note in self.annotations if isinstance(note, kind)), None)

    def __get__(self, owner, cls=None):
        if owner is None:
            return self
        node = owner.parameterNode
        if self.kind is _Kind.NODE:
            return node.GetNodeReference(self.name)
        if self.kind is _Kind.NODES:
            count = node.GetNumberOfNodeReferences(self.name)
            return [node.GetNthNodeReference(self.name, n) for n in range(count)]
        text = node.GetParameter(self.name)
        return text == "true" if self.type is bool else self.type(text)

    def __set__(self, owner, value):
        node = owner.parameterNode
        if self.kind is _Kind.NODE:
            node.SetNodeReferenceID(self.name, value.GetID() if value is not None else None)
        elif self.kind is _Kind.NODES:
            modified = node.StartModify()
            node.RemoveNodeReferenceIDs(self.name)
            for item in value:
                node.AddNodeReferenceID(self.name, item.GetID())
            node.Modified()
            node.EndModify(modified)
        else:
            self._check(value)
            node.SetParameter(self.name, str(value).lower() if self.type is bool else str(value))

    def _check(self, value):
        choice, limits = self.annotation(Choice), self.annotation(WithinRange)
        if not isinstance(value, (int, float) if self.type is float else self.type):
            raise TypeError(f"{self.name}: {value!r} is no {self.type.__name__}")
        if choice is not None and value not in choice.choices:
            raise ValueError(f"{self.name}: {value!r} is not one of {choice.choices}")
        if limits is not None and not limits.low <= value <= limits.high:
            raise ValueError(f"{self.name}: {value!r} is not in {limits.low}…{limits.high}")


def _init(self, parameterNode):
    self.parameterNode = parameterNode
    self._connections = {}
    for name, parameter in self.allParameters.items():
        if parameter.kind is _Kind.VALUE and name not in parameterNode.GetParameterNames():
            parameter.__set__(self, parameter.default)


def StartModify(self):
    return self.parameterNode.StartModify()


def EndModify(self, modified):
    self.parameterNode.EndModify(modified)


def AddObserver(self, event, callback, priority=0.0):
    return self.parameterNode.AddObserver(event, callback, priority)


def connectGui(self, ui):
    """Connect every widget that has the property SlicerParameterName."""
    links = []
    for widget in vars(ui).values():
        name = widget.property("SlicerParameterName")
        if name:
            links.append(_Link(self, self.allParameters[name], widget))

    def refresh(caller=None, event=None):
        for link in links:
            link.to_widget()

    refresh()
    for link in links:
        link.connect()
    tag = self.parameterNode.AddObserver(vtk.vtkCommand.ModifiedEvent, refresh)
    self._connections[tag] = links
    return tag


def disconnectGui(self, tag):
    self.parameterNode.RemoveObserver(tag)
    for link in self._connections.pop(tag):
        link.connected = False


WIDGETS = {
    "qMRMLNodeComboBox": ("currentNode", "setCurrentNode", "currentNodeChanged(vtkMRMLNode*)"),
    "QCheckBox": ("isChecked", "setChecked", "toggled(bool)"),
    "QRadioButton": ("isChecked", "setChecked", "toggled(bool)"),
    "QComboBox": ("currentText", "setCurrentText", "currentIndexChanged(int)"),
    "QSpinBox": ("value", "setValue", "valueChanged(int)"),
    "QDoubleSpinBox": ("value", "setValue", "valueChanged(double)"),
    "QLineEdit": ("text", "setText", "textChanged(QString)"),
}


class _Link:
    """Between one parameter and one widget."""

    def __init__(self, wrapper, parameter, widget):
        self.wrapper, self.parameter, self.widget = wrapper, parameter, widget
        self.getter, self.setter, self.signal = WIDGETS[type(widget).__name__]
        self.connected, self.busy = True, True
        choice, limits = parameter.annotation(Choice), parameter.annotation(WithinRange)
        if choice is None and type(widget).__name__ == "QComboBox":
            raise RuntimeError(f"{parameter.name}: a box of choices needs the annotation Choice")
        if choice is not None:
            widget.clear()
            widget.addItems(choice.choices)
        if limits is not None:
            widget.setRange(limits.low, limits.high)
        self.busy = False

    def connect(self):
        self.widget.connect(self.signal, lambda *_: self.to_parameter())

    def to_widget(self):
        self.busy = True
        getattr(self.widget, self.setter)(self.parameter.__get__(self.wrapper))
        self.busy = False

    def to_parameter(self):
        if self.connected and not self.busy:
            value = getattr(self.widget, self.getter)
            value = value() if callable(value) else value
            if value != self.parameter.__get__(self.wrapper):
                self.parameter.__set__(self.wrapper, value)
