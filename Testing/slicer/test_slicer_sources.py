"""The module against Slicer's own sources: what it uses of the application is there.

These tests need a checkout of Slicer, see standins/sources.py, and are skipped without one.
"""

import ast
import importlib.util
import re
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

slicer = pytest.importorskip("slicer")

import vtk  # noqa: E402
from PySide6 import QtCore, QtWidgets  # noqa: E402
from standins import application, sources, widgets  # noqa: E402
from standins.headers import offer  # noqa: E402

import ElastoIdentify as module  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
MODULE = ROOT / "ElastoIdentify"
UI = ET.parse(MODULE / "Resources" / "UI" / "ElastoIdentify.ui").getroot()
CODE = [MODULE / "ElastoIdentify.py", *sorted((MODULE / "ElastoIdentifyLib").glob("*.py"))]

pytestmark = pytest.mark.skipif(
    sources.folder() is None, reason=f"no sources of Slicer are given. To enable: {sources.HINT}"
)


def checkouts():
    folder = sources.folder()
    widgets_of_slicer = [folder / "Libs" / "MRML" / "Widgets", folder / "Base"]
    return [*widgets_of_slicer, folder.parent / "CTK" / "Libs"]


def own(cls):
    """Names that a stand-in adds to its Qt class."""
    return {
        name
        for one in cls.__mro__
        if one.__module__ == widgets.__name__
        for name in vars(one)
        if not name.startswith("_")
    }


@pytest.mark.parametrize(
    "name",
    ["qMRMLWidget", "qMRMLNodeComboBox", "qMRMLCheckableNodeComboBox", "ctkCollapsibleButton"],
)
def test_a_stand_in_has_nothing_that_the_widget_has_not(name):
    """So what runs on the stand-ins finds the same names in the application."""
    qt_names = set(dir(QtWidgets.QAbstractButton)) | {"connect", "disconnect", "name"}
    qt_names |= {"connect_by_text", "disconnect_by_text"}  # how the stand-ins do `connect`
    assert own(getattr(widgets, name)) - qt_names <= offer(checkouts(), name).names()


def test_widgets_of_the_ui_file_have_their_properties_and_can_be_made_by_the_loader():
    for element in UI.iter("widget"):
        name = element.get("class")
        wanted = {p.get("name") for p in element.findall("property") if p.get("stdset") != "0"}
        found = offer(checkouts(), name)
        base = getattr(QtWidgets, found.base, None) or getattr(QtWidgets, name, QtWidgets.QWidget)
        known = {
            base.staticMetaObject.property(number).name()
            for number in range(base.staticMetaObject.propertyCount())
        }
        assert wanted <= known | found.properties, name
        if name.startswith(("qMRML", "ctk")):
            plugins = [
                *checkouts()[0].rglob(f"{name}Plugin.h"),
                *checkouts()[2].rglob(f"{name}Plugin.h"),
            ]
            assert plugins, f"{name} cannot be loaded from a .ui file"


def test_connections_of_the_ui_file_are_of_signals_and_slots_that_are_there():
    classes = {w.get("name"): w.get("class") for w in UI.iter("widget")}
    connections = list(UI.iter("connection"))
    assert connections
    for connection in connections:
        sender, signal, receiver, slot = (
            connection.find(tag).text for tag in ("sender", "signal", "receiver", "slot")
        )
        assert signal in offer(checkouts(), classes[sender]).signals
        assert slot in offer(checkouts(), classes[receiver]).slots


def test_signals_that_the_module_connects_are_there():
    found = re.findall(r'self\.ui\.(\w+)\.connect\("([^"]+)"', CODE[0].read_text())
    assert len(found) >= 5
    classes = {w.get("name"): w.get("class") for w in UI.iter("widget")}
    for widget, signal in found:
        cls = classes[widget]
        signals = offer(checkouts(), cls).signals
        if hasattr(QtWidgets, cls):
            meta = getattr(QtWidgets, cls).staticMetaObject
            methods = [meta.method(number) for number in range(meta.methodCount())]
            signals = {
                bytes(m.methodSignature()).decode()
                for m in methods
                if m.methodType() == QtCore.QMetaMethod.Signal
            }
        assert signal in signals, (widget, signal)


def test_the_application_has_what_the_module_asks_of_it():
    text = "\n".join(path.read_text() for path in CODE)
    app = offer(checkouts(), "qSlicerApplication").names() | {"connect", "processEvents"}
    assert set(re.findall(r"slicer\.app\.(\w+)", text)) <= app
    assert "startupCompleted()" in app
    manager = offer(checkouts(), "qSlicerLayoutManager").names()
    asked = set(re.findall(r"\bmanager\.(\w+)", text))
    assert asked
    assert asked <= manager
    assert {name for name in vars(application.LayoutManager) if name[0] != "_"} <= manager


def test_mrml_and_vtk_methods_are_in_this_version_of_slicer():
    """Every name with a capital that is called or read, in a header of Slicer's or in VTK."""
    used = {
        node.attr
        for path in CODE
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and re.match(r"[A-Z][a-z]+[A-Z]", node.attr)
    }
    assert len(used) > 100
    of_vtk = {name for cls in vars(vtk).values() if isinstance(cls, type) for name in dir(cls)}
    of_qt = set(dir(QtWidgets)) | set(dir(QtCore)) | set(dir(QtCore.Qt))
    of_qt |= set(dir(QtCore.Qt.ItemFlag)) | {"NoItemFlags"}
    of_qt |= set(dir(QtCore.QEventLoop.ProcessEventsFlag))
    folder = sources.folder()
    headers = [*(folder / "Libs").rglob("*.h"), *(folder / "Modules" / "Loadable").rglob("*.h")]
    headers += (folder.parent / "vtkAddon").glob("*.h")
    text = "\n".join(header.read_text(errors="replace") for header in headers)
    words = set(re.findall(r"\b[A-Z]\w+", text))
    words |= {
        prefix + name
        for name in re.findall(r"vtk(?:\w*)Macro\(\s*(\w+)", text)
        for prefix in ("Get", "Set")
    }
    own_names = {"PackageNotFoundError", "SampleDataLogic", "ScriptedLoadableModule"}
    assert used - of_vtk - of_qt - words - own_names == set()


# ---- Slicer's own Python code running


def test_the_parameter_node_and_the_base_classes_are_slicers_own():
    assert module.ElastoIdentifyParameterNode._is_parameter_node_wrapper
    for name in ("parameterNodeWrapper", "ScriptedLoadableModule", "i18n", "util"):
        path = Path(sys.modules[f"slicer.{name}"].__file__)
        assert sources.folder() in path.parents


@pytest.fixture
def loaded_module():
    """The module as the application loads it."""
    parent = types.SimpleNamespace(path=str(MODULE / "ElastoIdentify.py"), icon=None)
    slicer.app.startup.clear()
    module.ElastoIdentify(parent)
    return parent


def test_the_module_describes_itself(loaded_module):
    assert loaded_module.title == "ElastoIdentify"
    assert loaded_module.categories == ["Quantification"]
    assert loaded_module.contributors == ["The ElastoIdentify authors"]
    assert "tutorial" in loaded_module.helpText
    assert "elastix" in loaded_module.acknowledgementText
    assert not loaded_module.icon.isNull()


def test_reload_and_test_runs_the_modules_tests(loaded_module):
    slicer.selfTests["ElastoIdentify"](msec=100)


def test_ctest_runs_the_modules_tests(capsys):
    slicer.testing.runUnitTest([str(MODULE)], "ElastoIdentify")
    assert "test_aPushIsIdentifiedFromTransforms" in capsys.readouterr().err


@pytest.fixture
def sample_data(monkeypatch):
    """Slicer's own Sample Data module."""
    path = sources.folder() / "Modules" / "Scripted" / "SampleData" / "SampleData.py"
    specification = importlib.util.spec_from_file_location("SampleData", path)
    found = importlib.util.module_from_spec(specification)
    monkeypatch.setitem(sys.modules, "SampleData", found)
    specification.loader.exec_module(found)
    slicer.modules.sampleDataSources = {}
    yield found
    del slicer.modules.sampleDataSources


def test_the_sample_data_module_has_our_buttons_and_a_click_makes_the_nodes(
    loaded_module, sample_data, monkeypatch
):
    import ctk

    ((signal, slot),) = slicer.app.startup
    assert signal == "startupCompleted()"
    slot()
    slot()  # a reloaded module registers again: as many buttons all the same
    monkeypatch.setattr(ctk, "ctkCollapsibleGroupBox", widgets.widget_base("QGroupBox"))
    monkeypatch.setattr(ctk, "ctkFlowLayout", FlowLayout, raising=False)
    window = types.SimpleNamespace(iconSize=QtCore.QSize(16, 16), statusBar=lambda: None)
    monkeypatch.setattr(slicer.util, "mainWindow", lambda: window)
    panel = widgets.ModulePanel()
    logic = sample_data.SampleDataLogic()
    sample_data.SampleDataWidget.setCategoriesFromSampleDataSources(
        panel.layout(),
        {"ElastoIdentify": slicer.modules.sampleDataSources["ElastoIdentify"]},
        logic,
    )
    buttons = {button.text: button for button in panel.findChildren(QtWidgets.QToolButton)}
    assert sorted(buttons) == sorted([module.SAMPLE, module.SAMPLE_3D])
    assert not any(QtWidgets.QToolButton.icon(button).isNull() for button in buttons.values())
    QtWidgets.QToolButton.click(buttons[module.SAMPLE])
    names = [node.GetName() for node in slicer.util.getNodesByClass("vtkMRMLScalarVolumeNode")]
    assert names == ["Phantom rest", "Phantom pushed 1", "Phantom pushed 2"]
    (segmentation,) = slicer.util.getNodesByClass("vtkMRMLSegmentationNode")
    assert segmentation.GetSegmentation().GetNumberOfSegments() == 5


class FlowLayout(widgets.polite(QtWidgets.QVBoxLayout)):
    preferredExpandingDirections = None


def test_packages_are_installed_by_slicers_own_function(monkeypatch):
    packaging = pytest.importorskip("slicer.packaging")  # from 5.12
    asked, installed = [], []
    monkeypatch.setattr(packaging, "pip_check", lambda requirement: bool(installed))
    monkeypatch.setattr(packaging, "pip_install", lambda wanted, **_: installed.extend(wanted))
    monkeypatch.setattr(slicer.app, "testingEnabled", lambda: False)
    monkeypatch.setattr(
        slicer.util, "confirmOkCancelDisplay", lambda *a, **k: asked.append(a) or True
    )
    for _ in range(2):
        module.ElastoIdentifyLogic.ensurePackages()
    assert installed == ["itk-elastix>=0.23"]
    assert len(asked) == 1
    module.ElastoIdentifyLogic.ensurePackages()
