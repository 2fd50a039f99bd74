"""`qt`, `ctk` and the MRML widgets, on PySide6, with the manners of PythonQt.

In PythonQt a Qt property is an attribute (`button.enabled = False`), what is no property stays a
method, signals are connected by their text (`button.connect("clicked(bool)", f)`), and a slot is
called with as many arguments as it takes.
"""

import inspect
import sys
import types
import xml.etree.ElementTree as ET

import slicer
import slicer.util
from PySide6 import QtCore, QtGui, QtWidgets
from PySide6.QtUiTools import QUiLoader

QOBJECT = object.__getattribute__
PLAIN = {"property", "setProperty", "metaObject", "children", "parent", "layout", "style"}
PLAIN |= {"sizeHint", "minimumSizeHint"}  # Qt itself looks these up, to see if they are overridden


def install():
    """Put `qt`, `ctk` and the widgets of `slicer` in place; returns the application."""
    application = QtWidgets.QApplication.instance() or QtWidgets.QApplication(["test"])
    sys.modules["qt"] = Qt("qt")
    ctk = types.ModuleType("ctk")
    ctk.ctkCollapsibleButton = ctkCollapsibleButton
    sys.modules["ctk"] = ctk
    for cls in (qMRMLWidget, qMRMLNodeComboBox, qMRMLCheckableNodeComboBox):
        setattr(slicer, cls.__name__, cls)
    slicer.util.loadUI = load_ui
    slicer.util.childWidgetVariables = child_variables
    return application


# ---- PythonQt's manners


def call(widget, name, *arguments):
    """Call a method of Qt's, past the attribute rules below."""
    return getattr(super(Manners, widget), name)(*arguments)


def is_property(widget, name):
    return call(widget, "metaObject").indexOfProperty(name) >= 0


class Manners:
    """Mixed into a Qt class: properties as attributes, signals connected by their text."""

    def __getattribute__(self, name):
        if name in ("connect", "disconnect"):
            return types.MethodType(getattr(Manners, f"{name}_by_text"), self)
        inherited = super().__getattribute__
        if name.startswith("_") or name in PLAIN:
            return inherited(name)
        if is_property(self, name) and not isinstance(
            getattr(type(self), name, None), (property, QtCore.Property)
        ):
            return inherited("property")(name)
        return inherited(name)

    def __setattr__(self, name, value):
        if not name.startswith("_") and is_property(self, name):
            if name == "text" and not isinstance(value, str):
                raise TypeError(f"text must be a string, not {value!r}")
            call(self, "setProperty", name, value)
        else:
            super().__setattr__(name, value)

    @property
    def name(self):
        return call(self, "objectName")

    @name.setter
    def name(self, name):
        call(self, "setObjectName", name)

    def connect_by_text(self, signal, slot):
        signal_name, _, arguments = signal.rstrip(")").partition("(")
        given = len([one for one in arguments.split(",") if one.strip()])
        super().__getattribute__(signal_name).connect(as_slot(slot, given))
        return True

    def disconnect_by_text(self, signal=None, slot=None):
        return True


def as_slot(slot, given):
    """Call a slot with as many arguments as it takes, and no more than the signal gives."""
    try:
        kinds = [parameter.kind for parameter in inspect.signature(slot).parameters.values()]
        takes = given if inspect.Parameter.VAR_POSITIONAL in kinds else min(given, len(kinds))
    except (TypeError, ValueError):
        takes = given
    return lambda *arguments: slot(*arguments[:takes])


class Qt(types.ModuleType):
    """The module `qt`: every class of Qt's, widgets and timers with PythonQt's manners."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        for module in (QtWidgets, QtGui, QtCore):
            if hasattr(module, name):
                found = getattr(module, name)
                if inspect.isclass(found) and issubclass(found, (QtWidgets.QWidget, QtCore.QTimer)):
                    found = polite(found)
                setattr(self, name, found)
                return found
        raise AttributeError(f"qt has no {name}")


_polite = {}


def polite(cls):
    """Return a Qt class with PythonQt's manners; always the same for the same class."""
    if cls not in _polite:
        _polite[cls] = type(cls.__name__, (Manners, cls), {})
    return _polite[cls]


def widget_base(name):
    return polite(getattr(QtWidgets, name))


# ---- CTK and MRML widgets


class ctkCollapsibleButton(widget_base("QWidget")):
    """A titled section that opens and closes."""

    def __init__(self, parent=None):
        super().__init__(parent)
        self._title = QtWidgets.QToolButton(self)
        self._title.setToolButtonStyle(QtCore.Qt.ToolButtonTextBesideIcon)
        self._title.setStyleSheet(
            "QToolButton{background:#d8dee6;border:1px solid #b5bcc6;font-weight:bold;padding:3px}"
        )
        self._title.clicked.connect(lambda: self._set_collapsed(not self._closed))
        self._closed = False
        call(self, "setContentsMargins", 0, 28, 0, 4)
        self._draw()

    def resizeEvent(self, event):
        self._title.setGeometry(0, 0, event.size().width(), 24)

    def _draw(self):
        self._title.setArrowType(QtCore.Qt.RightArrow if self._closed else QtCore.Qt.DownArrow)

    def _set_collapsed(self, closed):
        self._closed = closed
        call(self, "setMaximumHeight", 26 if closed else 16777215)
        self._draw()

    text = QtCore.Property(str, lambda s: s._title.text(), lambda s, v: s._title.setText(v))
    collapsed = QtCore.Property(bool, lambda s: s._closed, lambda s, v: s._set_collapsed(v))


class qMRMLWidget(widget_base("QWidget")):
    mrmlSceneChanged = QtCore.Signal(object)

    def __init__(self, parent=None):
        super().__init__(parent)
        self._scene = None

    def mrmlScene(self):
        return self._scene

    def setMRMLScene(self, scene):
        self._scene = scene
        self.mrmlSceneChanged.emit(scene)


class ModulePanel(qMRMLWidget):
    """What the application gives a module to lay its panel out in."""

    isEntered = QtCore.Property(bool, lambda s: True)

    def __init__(self):
        super().__init__()
        QtWidgets.QWidget.setLayout(self, polite(QtWidgets.QVBoxLayout)())
        self.setMRMLScene(slicer.mrmlScene)


class _NodeList(widget_base("QWidget")):
    """What the two node boxes share: they follow the nodes of their scene."""

    def __init__(self, parent=None):
        super().__init__(parent)
        self._scene, self._types, self._none, self._tags = None, [], False, []

    def mrmlScene(self):
        return self._scene

    def setMRMLScene(self, scene):
        for tag in self._tags:
            self._scene.RemoveObserver(tag)
        self._tags = []
        self._scene = scene
        if scene is not None:
            events = slicer.vtkMRMLScene
            for event in (events.NodeAddedEvent, events.NodeRemovedEvent, events.EndCloseEvent):
                self._tags.append(scene.AddObserver(event, lambda *_: self._fill()))
        self._fill()

    def _nodes(self):
        if self._scene is None:
            return []
        found = [node for kind in self._types for node in slicer.util.getNodesByClass(kind)]
        return [
            node
            for node in found
            if not node.GetHideFromEditors()
            and (self._children or node.IsA(self._types[0]))
            and (self._children or node.GetClassName() in self._types)
        ]

    _children = True

    def _set_types(self, types):
        self._types = list(types)
        self._fill()

    def _set_none(self, none):
        self._none = none
        self._fill()

    def _set_children(self, children):
        self._children = children
        self._fill()

    nodeTypes = QtCore.Property("QStringList", lambda s: s._types, _set_types)
    noneEnabled = QtCore.Property(bool, lambda s: s._none, _set_none)
    showChildNodeTypes = QtCore.Property(bool, lambda s: s._children, _set_children)
    addEnabled = QtCore.Property(bool, lambda s: False, lambda s, v: None)
    removeEnabled = QtCore.Property(bool, lambda s: False, lambda s, v: None)


class qMRMLNodeComboBox(_NodeList):
    currentNodeChanged = QtCore.Signal(object)

    def __init__(self, parent=None):
        super().__init__(parent)
        self._box, self._busy = QtWidgets.QComboBox(self), False
        row = QtWidgets.QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self._box)
        self._box.currentIndexChanged.connect(self._changed)

    def _changed(self, *_):
        if not self._busy:
            self.currentNodeChanged.emit(self.currentNode())

    def _fill(self):
        before = self._box.currentData()
        self._busy = True
        self._box.clear()
        nodes = self._nodes()
        if self._none or not nodes:
            self._box.addItem("None", None)
        for node in nodes:
            self._box.addItem(node.GetName(), node.GetID())
        self._box.setCurrentIndex(max(self._box.findData(before) if before else 0, 0))
        self._busy = False
        if self._box.currentData() != before:
            self._changed()

    def currentNode(self):
        chosen = self._box.currentData()
        return self._scene.GetNodeByID(chosen) if self._scene is not None and chosen else None

    def setCurrentNode(self, node):
        self._box.setCurrentIndex(self._box.findData(node.GetID() if node is not None else None))


class qMRMLCheckableNodeComboBox(_NodeList):
    checkedNodesChanged = QtCore.Signal()

    def __init__(self, parent=None):
        super().__init__(parent)
        self._checked, self._label = set(), QtWidgets.QComboBox(self)
        row = QtWidgets.QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self._label)
        self._fill()

    def _fill(self):
        present = {node.GetID() for node in self._nodes()}
        before, self._checked = self._checked, self._checked & present
        names = [node.GetName() for node in self._nodes() if node.GetID() in self._checked]
        self._label.clear()
        self._label.addItem(", ".join(names) or "None")
        if before != self._checked:
            self.checkedNodesChanged.emit()

    def checkedNodes(self):
        return tuple(node for node in self._nodes() if node.GetID() in self._checked)

    def checkState(self, node):
        checked = node.GetID() in self._checked
        return QtCore.Qt.Checked if checked else QtCore.Qt.Unchecked

    def setCheckState(self, node, state):
        before = set(self._checked)
        if state == QtCore.Qt.Checked:
            self._checked.add(node.GetID())
        else:
            self._checked.discard(node.GetID())
        self._fill()
        if before != self._checked:
            self.checkedNodesChanged.emit()


# ---- .ui files


class Loader(QUiLoader):
    """Makes the widgets of a .ui file from the classes above, and keeps a list of unknown ones."""

    def __init__(self):
        super().__init__()
        self.unknown, self.made = [], []

    def createWidget(self, class_name, parent=None, name=""):
        own = globals().get(class_name) if class_name[:3] in ("ctk", "qMR") else None
        if own is None and not hasattr(QtWidgets, class_name):
            self.unknown.append(class_name)
        cls = own or polite(getattr(QtWidgets, class_name, QtWidgets.QWidget))
        widget = cls(parent)
        call(widget, "setObjectName", name)
        self.made.append(widget)
        return widget


def load_ui(path):
    """Load a .ui file; what is wrong with it is in the attribute `_faults` of the widget.

    Its connections are made here, because their signatures name classes that PySide does not know.
    """
    root = ET.parse(path).getroot()
    connections = [
        tuple(connection.find(tag).text for tag in ("sender", "signal", "receiver", "slot"))
        for connection in root.iter("connection")
    ]
    for element in root.findall("connections"):
        root.remove(element)
    buffer = QtCore.QBuffer()
    buffer.setData(ET.tostring(root))
    buffer.open(QtCore.QIODevice.ReadOnly)
    loader = Loader()
    panel = loader.load(buffer)
    if panel is None:
        raise RuntimeError(f"{path}: {loader.errorString()}")
    widgets = {widget.name: widget for widget in loader.made}
    faults = [f"unknown class {name}" for name in loader.unknown]
    for sender, signal, receiver, slot in connections:
        try:
            source = QtWidgets.QWidget.__getattribute__(widgets[sender], signal.partition("(")[0])
            target = QtWidgets.QWidget.__getattribute__(widgets[receiver], slot.partition("(")[0])
            source.connect(target)
        except (KeyError, AttributeError) as problem:
            faults.append(f"broken connection {sender}.{signal} → {receiver}.{slot}: {problem}")
    with_scene = {receiver for _, _, receiver, slot in connections if "setMRMLScene" in slot}
    faults += [
        f"no scene for {name}"
        for name, widget in widgets.items()
        if isinstance(widget, _NodeList) and name not in with_scene
    ]
    panel._keep, panel._faults = loader.made, faults
    return panel


def child_variables(panel):
    """Return the named widgets of a loaded panel as attributes of one object."""
    return types.SimpleNamespace(**{w.name: w for w in panel._keep if w.name})
