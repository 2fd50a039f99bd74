"""The panel, loaded from its .ui: states and texts of Apply, clicks, cancel, closing scenes."""

import time

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")

import qt  # noqa: E402
from elastoidentify.study import Study  # noqa: E402
from ElastoIdentifyLib import exports, outputs, sample  # noqa: E402
from ElastoIdentifyLib.request import ROLES, materials_from_text  # noqa: E402
from PySide6 import QtWidgets  # noqa: E402
from standins.widgets import ModulePanel  # noqa: E402

import ElastoIdentify as module  # noqa: E402

pytestmark = pytest.mark.usefixtures("warm")


@pytest.fixture
def panel():
    widget = module.ElastoIdentifyWidget(ModulePanel())
    widget.setup()
    yield widget
    widget.cleanup()
    widget.layout.itemAt(0).widget().setMRMLScene(None)  # the boxes let go of the scene


def click(button):
    QtWidgets.QPushButton.click(button)


def finish(widget, seconds=600):
    """Let the timer's slot run until the run has ended."""
    until = time.monotonic() + seconds
    while widget.run is not None and time.monotonic() < until:
        widget.onTimer()
        time.sleep(0.05)
    assert widget.run is None


def set_role(widget, segment, role, young=None, poisson=None):
    table = widget.ui.materialsTable
    row = [table.item(r, 0).text() for r in range(table.rowCount)].index(segment)
    table.cellWidget(row, 1).setCurrentIndex(ROLES.index(role))
    for column, value in ((2, young), (3, poisson)):
        if value is not None:
            table.item(row, column).setText(str(value))


def fill(widget):
    """Choose everything by the panel's own widgets, transforms instead of images."""
    inputs, young = sample.add_exact_push()
    widget.ui.restSelector.setCurrentNode(inputs["restVolume"])
    widget.ui.segmentationSelector.setCurrentNode(inputs["segmentation"])
    widget.ui.useTransformsCheckBox.setChecked(True)
    for node in inputs["transforms"]:
        widget.ui.transformsSelector.setCheckState(node, qt.Qt.Checked)
    set_role(widget, "pad", "known", 5, 0.3)
    set_role(widget, "indenter", "rigid")
    set_role(widget, "floor", "rigid")
    widget.ui.edgeLengthSpinBox.setValue(6.0)
    widget.ui.methodComboBox.setCurrentText("global")
    widget.ui.poissonRatioSpinBox.setValue(0.3)
    return inputs, young


def test_the_ui_file_has_no_unknown_class_no_broken_connection_and_every_box_its_scene(panel):
    assert panel.layout.itemAt(0).widget()._faults == []
    for box in (
        panel.ui.restSelector,
        panel.ui.pushedSelector,
        panel.ui.segmentationSelector,
        panel.ui.transformsSelector,
        panel.ui.resultSelector,
    ):
        assert box.mrmlScene() is slicer.mrmlScene


def test_every_parameter_named_in_the_ui_exists_and_every_parameter_has_its_widget(panel):
    connected = {
        name
        for name in (w.property("SlicerParameterName") for w in vars(panel.ui).values())
        if name
    }
    parameters = set(module.ElastoIdentifyParameterNode.allParameters)
    assert connected <= parameters
    # lists and the table have code of their own
    by_code = {"pushedVolumes", "transforms", "reactionRois", "materials"}
    assert parameters - connected == by_code


def test_what_says_nothing_beside_the_other_choices_is_switched_off(panel):
    boxes = panel.ui.poissonRatioSpinBox, panel.ui.poissonStdOption
    for word, used in (("lambda-mu", False), ("young", True)):
        panel.ui.unknownsComboBox.setCurrentText(word)
        assert [box.enabled for box in boxes] == [used, used]


def test_apply_says_what_is_missing_one_thing_after_another(panel):
    button, ui = panel.ui.applyButton, panel.ui

    def says(text):
        assert not button.enabled
        assert button.text == f"Apply: {text}"

    says("choose a rest volume")
    inputs, _ = sample.add_exact_push()
    other = slicer.util.addVolumeFromArray(np.ones((1, 40, 40)), name="Other")
    panel.initializeParameterNode()
    says("choose pushed volumes")
    ui.pushedSelector.setCheckState(inputs["restVolume"], qt.Qt.Checked)
    says("the rest volume is also chosen as pushed")
    ui.pushedSelector.setCheckState(inputs["restVolume"], qt.Qt.Unchecked)
    ui.pushedSelector.setCheckState(other, qt.Qt.Checked)
    says("say which segment is known")
    ui.segmentationSelector.setCurrentNode(None)
    says("choose a segmentation")
    ui.segmentationSelector.setCurrentNode(inputs["segmentation"])
    set_role(panel, "pad", "known", -5, 0.3)
    says("Young's modulus of pad must be positive")
    set_role(panel, "pad", "known", 5, 0.5)
    says("Poisson's ratio of pad must be between -1 and 0.5")
    set_role(panel, "pad", "known", 5, 0.3)
    assert button.enabled
    assert button.text == "Apply"
    ui.useTransformsCheckBox.setChecked(True)
    says("choose a transform per trial")


def test_a_click_calls_the_logic_with_the_chosen_values(panel, monkeypatch):
    inputs, _ = fill(panel)
    panel.ui.kinematicsComboBox.setCurrentText("neo-hookean")
    panel.ui.unknownsComboBox.setCurrentText("young")
    panel.ui.noiseSpinBox.setValue(0.25)
    panel.ui.sliceIndexSpinBox.setValue(3)
    panel.ui.unitComboBox.setCurrentText("Pa")
    requests = []
    monkeypatch.setattr(panel.logic, "start", requests.append)
    click(panel.ui.applyButton)
    (request,) = requests
    assert request.restVolume is inputs["restVolume"]
    assert request.transforms == list(inputs["transforms"])
    assert request.pushedVolumes == []
    assert request.segmentation is inputs["segmentation"]
    roles = {name: m.role for _, (_, name, m) in request.segments().items()}
    assert roles == {"indenter": "rigid", "pad": "known", "tissue": "unknown", "floor": "rigid"}
    assert (request.materials["pad"].young, request.materials["pad"].poisson) == (5.0, 0.3)
    assert (request.edgeLength, request.sliceIndex, request.unit) == (6.0, 3, "Pa")
    said = {
        "method": "global",
        "kinematics": "neo-hookean",
        "unknowns": "young",
        "poisson_ratio": 0.3,
        "noise": 0.25,
    }
    plain = {k: "" if v == () else v for k, v in Study().values().items()}  # rows are a line here
    assert request.options == {name: said.get(name, plain[name]) for name in request.options}
    assert said.keys() < request.options.keys()


def test_from_a_click_to_the_map(panel):
    _, young = fill(panel)
    click(panel.ui.applyButton)
    assert panel.ui.applyButton.text == "Cancel"
    assert panel.ui.applyButton.enabled
    finish(panel)
    model = panel._parameterNode.resultModel
    status, label, found = (
        slicer.util.arrayFromModelCellData(model, name)
        for name in ("Status", "Label", "YoungModulus")
    )
    truth = np.array([young[value] for value in label])
    assert np.allclose(found[status > 0], truth[status > 0], rtol=1e-6)
    assert "cells identified" in panel.ui.statusLabel.text
    assert panel.ui.applyButton.text == "Apply"
    panel.ui.showComboBox.setCurrentText("YoungModulus")
    assert model.GetDisplayNode().GetActiveScalarName() == "YoungModulus"


def results():
    """Names of the models of results that are there, and whether they are seen."""
    models = slicer.util.getNodesByClass("vtkMRMLModelNode")
    models = [node for node in models if node.GetAttribute("ElastoIdentify.Result")]
    return {node.GetName(): bool(node.GetDisplayNode().GetVisibility()) for node in models}


def is_figure(node):
    return node.GetClassName() in ("vtkMRMLTableNode", "vtkMRMLPlotChartNode")


def figures():
    """The table and the chart that the views are asked to show."""
    selection = slicer.app.applicationLogic().GetSelectionNode()
    ids = selection.GetActiveTableID(), selection.GetActivePlotChartID()
    return {slicer.mrmlScene.GetNodeByID(one) for one in ids}


def test_a_new_result_puts_the_last_one_aside_and_a_click_exchanges_them(panel):
    fill(panel)
    made = []
    for young in (5, 6, 7):
        set_role(panel, "pad", "known", young, 0.3)
        click(panel.ui.applyButton)
        finish(panel)
        made.append(panel._parameterNode.resultModel)
    assert results() == {"Stiffness (previous)": False, "Stiffness": True}  # the first is gone
    assert panel.ui.restoreButton.enabled
    for shown in (made[1], made[2]):
        click(panel.ui.restoreButton)
        assert panel._parameterNode.resultModel is shown
        assert shown.GetName() == "Stiffness"
        assert results() == {"Stiffness (previous)": False, "Stiffness": True}
        folders = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
        item = folders.GetItemParent(folders.GetItemByDataNode(shown))
        assert folders.GetItemName(item) == "Stiffness map"
        assert figures() == {node for node in outputs.nodes_of_result(shown) if is_figure(node)}
        assert "cells identified" in panel.ui.statusLabel.text


@pytest.mark.parametrize("how", ["refused", "cancelled", "half made"])
def test_a_run_that_fails_leaves_the_last_result_as_it_is(panel, monkeypatch, how):
    fill(panel)
    click(panel.ui.applyButton)
    finish(panel)
    model = panel._parameterNode.resultModel
    before = sorted(node.GetName() for node in outputs._own_nodes())
    if how == "half made":

        def fail(*_):
            raise RuntimeError("no chart today")

        monkeypatch.setattr(outputs, "_chart", fail)
    if how == "refused":
        panel.ui.edgeLengthSpinBox.setValue(500.0)
    click(panel.ui.applyButton)
    if how == "cancelled":
        click(panel.ui.applyButton)
    else:
        with pytest.raises((ValueError, RuntimeError)):
            finish(panel)
    assert sorted(node.GetName() for node in outputs._own_nodes()) == before
    assert panel._parameterNode.resultModel is model
    assert results() == {"Stiffness": True}


def test_what_is_left_to_the_library_says_automatic(panel):
    for box in (panel.ui.edgeLengthSpinBox, panel.ui.workersOption, panel.ui.refineOption):
        assert box.text == "automatic", box.objectName


def test_segments_have_their_colours_in_the_table(panel):
    inputs, _ = fill(panel)
    inputs["segmentation"].GetSegmentation().GetSegment("pad").SetColor(0.2, 0.4, 1.0)
    table = panel.ui.materialsTable
    row = [table.item(r, 0).text() for r in range(table.rowCount)].index("pad")
    colour = table.item(row, 0).icon().pixmap(16, 16).toImage().pixelColor(8, 8)
    assert (colour.red(), colour.green(), colour.blue()) == (51, 102, 255)


def test_apply_progress_and_verdict_come_before_everything_else(panel):
    """On a small screen the panel ends far below what is seen."""
    layout = panel.layout.itemAt(0).widget().layout()
    names = [layout.itemAt(n).widget().objectName for n in range(4)]
    assert names == ["applyButton", "progressBar", "statusLabel", "inputsSection"]


@pytest.mark.parametrize("kind", ["dicom", "nifti", "html"])
def test_a_result_is_exported_by_a_click_as_the_command_line_does_it(
    panel, monkeypatch, tmp_path, kind
):
    needs = {"dicom": "highdicom", "nifti": "SimpleITK", "html": "matplotlib"}
    pytest.importorskip(needs[kind])
    fill(panel)
    button = getattr(panel.ui, f"export{kind.capitalize()}Button")
    assert not button.enabled
    click(panel.ui.applyButton)
    finish(panel)
    assert button.enabled
    targets = {"dicom": "maps", "nifti": "case", "html": "page.html"}
    target = tmp_path / targets[kind]
    monkeypatch.setattr(panel, "_askTarget", lambda asked: str(target))
    click(button)
    assert "Wrote" in panel.ui.statusLabel.text

    model = panel._parameterNode.resultModel
    points = slicer.util.arrayFromModelPoints(model)
    found, rest = exports.map_in_lps(model), exports.rest_in_lps(model)
    np.testing.assert_array_equal(found.points, points * [-1, -1, 1])
    if kind == "html":
        assert "cells" in target.read_text(encoding="utf-8")
        return
    from elastoidentify.export.sampling import cell_of_voxels, sample

    cells = cell_of_voxels(rest, found.points, found.blocks)
    wanted = sample(cells, found.values["Mu"].astype(np.float32))
    assert np.isfinite(wanted).mean() > 0.3
    if kind == "nifti":
        import SimpleITK

        image = SimpleITK.ReadImage(str(tmp_path / "case_mu.nii.gz"))
        written = SimpleITK.GetArrayFromImage(image)
        np.testing.assert_allclose(image.GetOrigin(), rest.origin, atol=1e-4)
        inside = np.isfinite(wanted)
        np.testing.assert_allclose(written[inside], wanted[inside], rtol=1e-6)
    else:
        assert {"mu.dcm", "labels.dcm"} <= {file.name for file in target.iterdir()}


def test_a_result_whose_rest_volume_is_gone_is_not_exported_but_said(panel, tmp_path):
    inputs, _ = fill(panel)
    click(panel.ui.applyButton)
    finish(panel)
    slicer.mrmlScene.RemoveNode(inputs["restVolume"])
    with pytest.raises(ValueError, match="rest volume of 'Stiffness' is no longer in the scene"):
        panel.logic.export(panel._parameterNode.resultModel, "nifti", str(tmp_path / "a"))


def test_a_message_of_the_library_is_translated(panel, monkeypatch):
    from ElastoIdentifyLib import request

    german = {"choose a rest volume": "Ruhebild wählen"}
    monkeypatch.setattr(request, "_", lambda text: german.get(text, text))
    panel.updateApplyButton()
    assert panel.ui.applyButton.text == "Apply: Ruhebild wählen"


def test_cancel_leaves_the_scene_as_it_was_and_apply_ready(panel):
    fill(panel)
    before = slicer.mrmlScene.GetNumberOfNodes()
    click(panel.ui.applyButton)
    run = panel.run
    click(panel.ui.applyButton)
    assert panel.run is None
    assert run.poll().value == "cancelled"
    assert slicer.mrmlScene.GetNumberOfNodes() == before
    assert panel.ui.applyButton.text == "Apply"
    assert panel.ui.applyButton.enabled


def test_a_failure_in_the_background_is_told_and_apply_is_ready_again(panel):
    fill(panel)
    panel.ui.edgeLengthSpinBox.setValue(500.0)
    click(panel.ui.applyButton)
    with pytest.raises(ValueError, match="edge length"):
        finish(panel)
    assert "edge length" in panel.ui.statusLabel.text
    assert panel.ui.applyButton.enabled


def test_closing_the_scene_ends_a_run(panel):
    fill(panel)
    click(panel.ui.applyButton)
    run = panel.run
    slicer.mrmlScene.Clear(0)
    assert panel.run is None
    assert run.poll().value == "cancelled"
    assert panel.ui.applyButton.text == "Apply: choose a rest volume"


def test_a_saved_scene_comes_back_into_the_panel(panel, tmp_path):
    inputs, _ = fill(panel)
    panel.ui.resultNameEdit.setText('Läsion; "2" < 3')
    panel.ui.sliceIndexSpinBox.setValue(0)
    click(panel.ui.applyButton)
    finish(panel)
    panel.ui.showComboBox.setCurrentText("YoungModulus")
    name = panel._parameterNode.resultModel.GetName()
    path = str(tmp_path / "scene.mrb")
    assert slicer.mrmlScene.WriteToMRB(path, None)
    slicer.mrmlScene.Clear(0)
    assert panel.ui.restSelector.currentNode() is None
    assert panel.ui.statusLabel.text == ""
    assert slicer.mrmlScene.ReadFromMRB(path)
    assert "cells identified" in panel.ui.statusLabel.text
    panel.enter()

    ui = panel.ui
    assert ui.restSelector.currentNode().GetName() == inputs["restVolume"].GetName()
    assert ui.segmentationSelector.currentNode().GetName() == "Block segments"
    assert ui.useTransformsCheckBox.checked
    assert [node.GetName() for node in ui.transformsSelector.checkedNodes()] == [
        "Block push 1",
        "Block push 2",
    ]
    assert (ui.edgeLengthSpinBox.value, ui.sliceIndexSpinBox.value) == (6.0, 0)
    assert ui.methodComboBox.currentText == "global"
    assert ui.resultNameEdit.text == 'Läsion; "2" < 3'
    assert ui.resultSelector.currentNode().GetName() == name
    assert ui.showComboBox.currentText == "YoungModulus"
    table = ui.materialsTable
    rows = {
        table.item(row, 0).text(): (table.cellWidget(row, 1).currentText, table.item(row, 2).text())
        for row in range(table.rowCount)
    }
    assert rows == {
        "indenter": ("rigid", ""),
        "pad": ("known", "5"),
        "tissue": ("unknown", ""),
        "floor": ("rigid", ""),
    }
    assert ui.applyButton.text == "Apply"
    click(ui.applyButton)  # and the loaded scene can be computed again
    finish(panel)
    assert "cells identified" in ui.statusLabel.text


def test_another_model_chosen_as_result_is_left_as_it_is(panel):
    fill(panel)
    liver = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "Liver")
    liver.CreateDefaultDisplayNodes()
    panel.ui.resultSelector.setCurrentNode(liver)
    panel.ui.showComboBox.setCurrentText("Lambda")
    assert not liver.GetDisplayNode().GetScalarVisibility()
    assert panel.ui.statusLabel.text == ""
    click(panel.ui.applyButton)
    finish(panel)
    assert slicer.mrmlScene.GetNodeByID(liver.GetID()) is liver
    assert panel._parameterNode.resultModel is not liver


def test_a_labelmap_is_not_suggested_as_the_rest_volume(panel):
    slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLabelMapVolumeNode", "Labels")
    panel.initializeParameterNode()
    assert panel._parameterNode.restVolume is None
    assert panel.ui.applyButton.text == "Apply: choose a rest volume"


def test_what_is_loaded_while_the_panel_is_open_is_suggested(panel):
    inputs, _ = sample.add_exact_push()
    QtWidgets.QApplication.processEvents()
    assert panel._parameterNode.restVolume is inputs["restVolume"]
    assert panel._parameterNode.segmentation is inputs["segmentation"]
    assert panel.ui.applyButton.text == "Apply: choose pushed volumes"


def test_the_rest_volume_is_suggested_by_its_name_and_a_pushed_one_never(panel):
    volumes = {}
    for name, suggested in (
        ("Breast pushed 1", None),
        ("Breast T2", "Breast T2"),
        ("case1_rest", "case1_rest"),
    ):
        volumes[name] = slicer.util.addVolumeFromArray(np.ones((1, 4, 4)), name=name)
        panel._parameterNode.restVolume = None
        QtWidgets.QApplication.processEvents()
        assert panel._parameterNode.restVolume is volumes.get(suggested)


def test_two_scenes_one_after_another(panel):
    fill(panel)
    slicer.mrmlScene.Clear(0)
    assert panel._parameterNode.restVolume is None
    assert materials_from_text(panel._parameterNode.materials) == {}
    assert panel.ui.materialsTable.rowCount == 0
    fill(panel)
    click(panel.ui.applyButton)
    finish(panel)
    assert panel._parameterNode.resultModel is not None


def test_segments_that_are_added_or_renamed_show_in_the_table(panel):
    inputs, _ = fill(panel)
    segments = inputs["segmentation"].GetSegmentation()
    segments.AddEmptySegment("vessel", "vessel")
    segments.GetSegment("tissue").SetName("liver")
    table = panel.ui.materialsTable
    names = [table.item(row, 0).text() for row in range(table.rowCount)]
    assert names == ["indenter", "pad", "liver", "floor", "vessel"]
    assert table.cellWidget(1, 1).currentText == "known"


def test_the_phantoms_materials_are_suggested_from_its_segmentation(panel):
    inputs, _ = sample.add_exact_push()
    from ElastoIdentifyLib.request import Material, tag_segment

    tag_segment(inputs["segmentation"], "pad", Material("known", 4.5, 0.4))
    panel.initializeParameterNode()
    table = panel.ui.materialsTable
    assert table.cellWidget(1, 1).currentText == "known"
    assert (table.item(1, 2).text(), table.item(1, 3).text()) == ("4.5", "0.4")
    request = panel.logic.request(panel._parameterNode)
    assert request.segments()["pad"][2].young == 4.5


def test_packages_are_asked_for_once_and_only_for_images(panel, monkeypatch):
    fill(panel)
    asked = []
    monkeypatch.setattr(panel.logic, "ensurePackages", lambda: asked.append("packages"))
    monkeypatch.setattr(panel.logic, "start", lambda request: None)
    click(panel.ui.applyButton)
    assert asked == []
    other = slicer.util.addVolumeFromArray(np.ones((1, 40, 40)), name="Other")
    panel.ui.useTransformsCheckBox.setChecked(False)
    panel.ui.pushedSelector.setCheckState(other, qt.Qt.Checked)
    click(panel.ui.applyButton)
    assert asked == ["packages"]


def test_missing_packages_are_installed_by_slicer_of_either_age(panel, monkeypatch):
    import importlib.metadata
    import sys
    import types

    def none(name):
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(module.importlib.metadata, "version", none)
    done = []
    packaging = types.ModuleType("slicer.packaging")
    packaging.pip_ensure = lambda wanted, **how: done.append((wanted, how))
    monkeypatch.setitem(sys.modules, "slicer.packaging", packaging)
    panel.logic.ensurePackages()
    how = {"requester": "ElastoIdentify", "prompt_install": True, "prompt_restart": True}
    assert done == [(["itk-elastix>=0.23"], how)]

    monkeypatch.setitem(sys.modules, "slicer.packaging", None)  # Slicer 5.10
    monkeypatch.setattr(slicer.util, "confirmOkCancelDisplay", lambda text: True)
    monkeypatch.setattr(slicer.util, "pip_install", done.append)
    panel.logic.ensurePackages()
    assert done[1] == ["itk-elastix>=0.23"]
    monkeypatch.setattr(slicer.util, "confirmOkCancelDisplay", lambda text: False)
    with pytest.raises(RuntimeError, match="itk-elastix"):
        panel.logic.ensurePackages()
    panel.logic.ensurePackages(ask=False)
    assert len(done) == 3


@pytest.fixture
def red():
    """The node of the red view, which closing a scene would leave in it."""
    node = slicer.vtkMRMLSliceNode()
    node.SetLayoutName("Red")
    node.SetSingletonTag("Red")
    node = slicer.mrmlScene.AddNode(node)
    yield node
    slicer.mrmlScene.RemoveNode(node)


def test_the_slice_of_the_red_view_is_taken(panel, red):
    """Axis and number of the slice that an oblique view through an oblique volume shows best."""
    matrix = np.array([[0, 0, 2.0, 5], [-1.2, 0.4, 0, 9], [-0.4, -1.2, 0, 7], [0, 0, 0, 1]])
    volume = slicer.util.addVolumeFromArray(np.ones((7, 20, 30)), matrix, "Sagittal")
    panel.ui.restSelector.setCurrentNode(volume)
    red.SetSliceToRASByNTP(0.95, 0.2, 0.1, 0, 1, 0, *(matrix @ [11, 8, 4.2, 1])[:3], 0)
    click(panel.ui.currentSliceButton)
    assert panel._parameterNode.sliceAxis == "k"
    assert panel._parameterNode.sliceIndex == 4
    assert panel.ui.sliceIndexSpinBox.value == 4
    red.SetSliceToRASByNTP(0.1, -0.9, -0.2, 1, 0, 0, *(matrix @ [29.8, 8, 4, 1])[:3], 0)
    click(panel.ui.currentSliceButton)
    assert (panel._parameterNode.sliceAxis, panel._parameterNode.sliceIndex) == ("i", 29)
