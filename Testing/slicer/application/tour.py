"""The module used in Slicer's window as a person would, with checks and pictures.

start.sh FOLDER --python-script /helpers/tour.py OUTPUT_FOLDER [PART...]

Parts, in this order: sample cancel apply views again exports scene files editor volume selftest.
cancel and apply need sample before them, views, again and exports need apply, scene and files need
apply or saved, which opens the scene of an earlier tour. Ends with a line per check, and with the
exit code 1 if one of them failed.
"""

import glob
import os
import sys
from pathlib import Path

import numpy as np
import qt
import slicer

sys.path.insert(0, str(Path(__file__).resolve().parent))
import mouse
from mouse import until

OUTPUT = Path(sys.argv[1] if len(sys.argv) > 1 else "/tmp/tour").resolve()
ALL = ("sample", "cancel", "apply", "views", "again", "exports", "scene", "files", "editor")
ALL += ("volume", "selftest")
PARTS = sys.argv[2:] or ALL
checks = []


def check(what, holds, note=""):
    """Keep the answer and go on, so that one fault does not hide the next."""
    checks.append((what, bool(holds), note))
    print("ok  " if holds else "FAIL", what, note, flush=True)


def panel():
    return slicer.modules.elastoidentify.widgetRepresentation().self()


def names(kind):
    return [node.GetName() for node in slicer.util.getNodesByClass(kind)]


def workers():
    """Return the Pythons that this process, or one of them, has started and that still run."""
    parents = {}
    for path in glob.glob("/proc/[0-9]*/stat"):
        try:
            state, parent = Path(path).read_text().rsplit(")", 1)[1].split()[:2]
            command = Path(path).with_name("cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue  # it has just ended
        if state != "Z":
            parents[int(Path(path).parent.name)] = int(parent), command
    found, new = {}, {os.getpid()}
    while new:
        new = {pid for pid, (parent, _) in parents.items() if parent in new}
        found |= {pid: parents[pid][1] for pid in new}
    return [command for command in found.values() if "python" in command]


def photo(name):
    OUTPUT.mkdir(parents=True, exist_ok=True)
    mouse.picture(OUTPUT / f"{name}.png")


def button(parent, text):
    found = slicer.util.findChildren(parent, text=f"*{text}*")
    found = [one for one in found if one.inherits("QAbstractButton") and one.visible]
    if not found:
        raise AssertionError(f"no button says {text!r}")
    return found[0]


def choose(box, text):
    """Open a box of choices and click one, as a hand does."""
    mouse.click(box)
    yield 0.5
    view = box.view() if hasattr(box, "view") else box.comboBox().view()
    model = view.model()
    for row in range(model.rowCount()):
        index = model.index(row, 0)
        if index.data() == text:
            view.scrollTo(index)
            mouse.click_item(view, index)
            yield 0.5
            return
    raise AssertionError(f"{text!r} is not among the choices")


# ---- parts


def sample():
    """Sample Data: the phantom's button is there, and a click makes its nodes."""
    slicer.util.selectModule("SampleData")
    yield 2
    widget = slicer.modules.sampledata.widgetRepresentation()
    photo("sample-data")
    shown = [
        b for b in slicer.util.findChildren(widget, className="QToolButton") if "phantom" in b.text
    ]
    check("Sample Data has the phantoms' buttons", len(shown) == 2, [b.text for b in shown])
    shown = [b for b in shown if "3-D" not in b.text]
    scroll = widget.parent()
    while scroll is not None and not scroll.inherits("QScrollArea"):
        scroll = scroll.parent()
    if scroll is not None:
        scroll.ensureWidgetVisible(shown[0])
    yield 0.5
    mouse.click(shown[0])
    yield until(
        "the phantom", lambda: "Phantom segmentation" in names("vtkMRMLSegmentationNode"), 240
    )
    yield 3
    photo("sample")
    check(
        "phantom: three volumes",
        [n for n in names("vtkMRMLScalarVolumeNode")]
        == ["Phantom rest", "Phantom pushed 1", "Phantom pushed 2"],
        names("vtkMRMLScalarVolumeNode"),
    )


def inputs():
    """The panel: what can be guessed is filled in, the rest is chosen by hand."""
    slicer.util.selectModule("ElastoIdentify")
    yield 2
    ui = panel().ui
    check("rest volume suggested", ui.restSelector.currentNode().GetName() == "Phantom rest")
    check(
        "button says what is missing",
        "choose pushed volumes" in ui.applyButton.text,
        ui.applyButton.text,
    )
    photo("panel-missing")
    scroll(ui.pushedSelector)
    yield 0.5
    mouse.click(ui.pushedSelector)
    yield 1.5
    photo("panel-pushed-open")
    box = slicer.util.findChildren(ui.pushedSelector, className="ctkCheckableComboBox")[0]
    view = box.view()
    for row in range(box.count):
        index = box.model().index(row, 0, box.rootModelIndex())
        if "pushed" in str(index.data()):
            mouse.click_item(view, index)
            yield 0.5
    mouse.keys("Escape")
    yield 0.5
    check(
        "two pushed volumes are checked",
        [n.GetName() for n in panel()._parameterNode.pushedVolumes]
        == ["Phantom pushed 1", "Phantom pushed 2"],
        [n.GetName() for n in panel()._parameterNode.pushedVolumes],
    )
    scroll(ui.edgeLengthSpinBox)
    yield 0.3
    check("edge length is automatic", ui.edgeLengthSpinBox.text == "automatic")
    photo("panel-method")
    mouse.click(ui.edgeLengthSpinBox, 20, None, times=3)
    mouse.keys("ctrl+a")
    mouse.write("7")
    mouse.keys("Tab")
    yield 0.5
    check(
        "edge length 7 typed",
        panel()._parameterNode.edgeLength == 7.0,
        panel()._parameterNode.edgeLength,
    )
    check(
        "Apply is ready",
        ui.applyButton.enabled and ui.applyButton.text == "Apply",
        ui.applyButton.text,
    )
    photo("panel-ready")


def scroll(widget):
    """Bring a widget of the panel into sight."""
    area = widget.parent()
    while area is not None and not area.inherits("QScrollArea"):
        area = area.parent()
    if area is not None:
        area.ensureWidgetVisible(widget)


def cancel():
    """Apply turns into Cancel; Cancel leaves the scene as it was and no process behind."""
    ui = panel().ui
    scroll(ui.applyButton)
    yield 0.3
    before = slicer.mrmlScene.GetNumberOfNodes()
    mouse.click(ui.applyButton)
    yield 2
    dialog = slicer.app.activeModalWidget()
    if dialog is not None:  # itk-elastix is not there yet
        photo("install")
        mouse.click(button(dialog, "OK"))
        yield until("the installation", lambda: panel().run is not None, 600)
        yield 1
    check("Apply turned into Cancel", ui.applyButton.text == "Cancel", ui.applyButton.text)
    yield until("progress", lambda: panel().run is None or panel().run.fraction > 0.03, 300)
    yield 1
    check("the progress bar is shown", ui.progressBar.visible, ui.statusLabel.text)
    check("processes work", workers(), len(workers()))
    scroll(ui.statusLabel)
    yield 0.5
    photo("running")
    scroll(ui.applyButton)
    yield 0.3
    mouse.click(ui.applyButton)
    yield 3
    check("Cancel: as many nodes as before", slicer.mrmlScene.GetNumberOfNodes() == before)
    check("Cancel: no process left", not workers(), workers())
    check("Cancel: the button says Apply", ui.applyButton.text == "Apply", ui.applyButton.text)
    photo("cancelled")


def apply():
    """A map of the phantom."""
    ui = panel().ui
    panel()._parameterNode.cache = str(OUTPUT / "cache")  # the next map of it is there at once
    scroll(ui.applyButton)
    yield 0.3
    mouse.click(ui.applyButton)
    yield 2
    seen = []

    def done():
        if not seen or seen[-1] != ui.statusLabel.text:
            seen.append(ui.statusLabel.text)
        return panel().run is None

    yield until("the map", done, 1800)
    yield 4
    photo("map")
    check("many words of progress were shown", len(seen) > 20, len(seen))
    model = panel()._parameterNode.resultModel
    check("there is a map", model is not None, ui.statusLabel.text)
    if model is None:
        return
    label, mu, status = (
        slicer.util.arrayFromModelCellData(model, name) for name in ("Label", "Mu", "Status")
    )
    for value in np.unique(label):
        inside = (label == value) & (status > 0)
        print("    label", value, "median mu", np.median(mu[inside]), "cells", inside.sum())
    table = slicer.util.getNode("Stiffness: segments").GetTable()
    for row in range(table.GetNumberOfRows()):
        print(
            "    ", [table.GetValue(row, c).ToString() for c in range(table.GetNumberOfColumns())]
        )


def bright_part(widget):
    """Return how much of a view is not of its most common colours (its background)."""
    image = widget.grab().toImage()
    colours = {}
    for x in range(0, image.width(), 4):
        for y in range(0, image.height(), 4):
            colour = qt.QColor(image.pixel(x, y))
            if (
                max(colour.red(), colour.green(), colour.blue())
                - min(colour.red(), colour.green(), colour.blue())
                > 90
            ):
                colours[(x, y)] = True
    return len(colours) / (image.width() // 4 * (image.height() // 4))


def sight():
    """Return the angle between the line of sight and the normal of the plane map, in degrees."""
    view = slicer.app.layoutManager().threeDWidget(0).threeDView().mrmlViewNode()
    camera = slicer.modules.cameras.logic().GetViewActiveCameraNode(view)
    points = slicer.util.arrayFromModelPoints(panel()._parameterNode.resultModel)
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    line = np.array(camera.GetFocalPoint()) - np.array(camera.GetPosition())
    return np.degrees(np.arccos(min(1, abs(normal @ line) / np.linalg.norm(line))))


def views():
    """The layout after Apply: what its four parts show."""
    manager = slicer.app.layoutManager()
    check("the module's layout is shown", manager.layout > 100, manager.layout)
    check("one 3-D view", manager.threeDViewCount == 1)
    model, angle = panel()._parameterNode.resultModel, sight()
    check("the camera does not look along the plane's edge", angle < 60, f"{angle:.0f} degrees")
    check(
        "3-D view shows colours",
        bright_part(manager.threeDWidget(0)) > 0.02,
        bright_part(manager.threeDWidget(0)),
    )
    check(
        "red view shows colours",
        bright_part(manager.sliceWidget("Red")) > 0.02,
        bright_part(manager.sliceWidget("Red")),
    )
    table = manager.tableWidget(0).tableView()
    check("the table is shown", table.mrmlTableNode() is not None)
    plot = manager.plotWidget(0).mrmlPlotViewNode()
    check("the chart is shown", plot.GetPlotChartNodeID() is not None)
    ui = panel().ui
    scroll(ui.showComboBox)
    yield 0.5
    for _ in choose(ui.showComboBox, "MuStd"):
        yield _
    yield 1
    check(
        "another quantity is shown",
        model.GetDisplayNode().GetActiveScalarName() == "MuStd",
        model.GetDisplayNode().GetActiveScalarName(),
    )
    photo("map-uncertainty")
    for _ in choose(ui.showComboBox, "Mu"):
        yield _
    slicer.util.selectModule("Data")
    yield 2
    photo("data")
    slicer.util.selectModule("ElastoIdentify")
    yield 1


def again():
    """A second map puts the first one aside; a click brings it back."""
    ui = panel().ui
    first = panel()._parameterNode.resultModel
    scroll(ui.applyButton)
    yield 0.3
    mouse.click(ui.applyButton)
    yield 1
    yield until("the second map", lambda: panel().run is None, 900)
    yield 2
    second = panel()._parameterNode.resultModel
    check("another model", second is not None and second is not first)
    check("the first is put aside", first.GetName() == "Stiffness (previous)", first.GetName())
    check("and hidden", not first.GetDisplayNode().GetVisibility())
    check("the second has its name", second.GetName() == "Stiffness", second.GetName())
    scroll(ui.restoreButton)
    yield 0.5
    mouse.click(ui.restoreButton)
    yield 1
    check("the first is back", panel()._parameterNode.resultModel is first, first.GetName())
    check("and seen", first.GetDisplayNode().GetVisibility())
    photo("restored")


def exports():
    """What radiologists take away: a page by the button, DICOM and NIfTI by the logic."""
    ui = panel().ui
    folder = OUTPUT / "exports"
    folder.mkdir(parents=True, exist_ok=True)
    model = panel()._parameterNode.resultModel
    scroll(ui.exportHtmlButton)
    yield 0.5
    mouse.click(ui.exportHtmlButton)
    yield 2
    photo("export")
    mouse.keys("ctrl+a")
    mouse.write(str(folder / "map.html"))
    mouse.keys("Return")
    yield until("the page", lambda: (folder / "map.html").exists(), 120)
    yield 1
    check("the status line names the page", "map.html" in ui.statusLabel.text, ui.statusLabel.text)
    for kind, target in (("nifti", folder / "map"), ("dicom", folder / "dicom")):
        try:
            files = panel().logic.export(model, kind, str(target), ask=False)
            check(f"{kind} files are there", all(file.exists() for file in files), len(files))
        except Exception as problem:
            check(f"{kind} files are there", False, repr(problem))
        yield 0.5


def volume():
    """The 3-D phantom of Sample Data, with one value per segment."""
    slicer.mrmlScene.Clear(0)
    yield 1
    import ElastoIdentify

    rest, *pushed, segmentation = ElastoIdentify.loadSampleVolume()
    yield 2
    slicer.util.selectModule("ElastoIdentify")
    yield 1
    parameters = panel()._parameterNode
    parameters.restVolume, parameters.pushedVolumes = rest, pushed
    parameters.segmentation, parameters.wholeVolume = segmentation, True
    parameters.edgeLength, parameters.grouping = 11.0, "label"
    yield 1
    mouse.click(panel().ui.applyButton)
    yield until("the 3-D map", lambda: panel().run is None, 1800)
    yield 3
    photo("volume")
    check("there is a 3-D map", parameters.resultModel is not None, panel().ui.statusLabel.text)


def saved():
    """Open the scene of an earlier tour in a Slicer that has just started."""
    slicer.util.selectModule("ElastoIdentify")
    yield 1
    slicer.util.loadScene(str(OUTPUT / "map.mrb"))
    yield 4
    photo("saved")


def scene():
    """Save, close, load again: the map and the panel come back."""
    before = slicer.util.arrayFromModelCellData(panel()._parameterNode.resultModel, "Mu").copy()
    file = str(OUTPUT / "map.mrb")
    check("the scene is saved", slicer.util.saveScene(file), Path(file).stat().st_size)
    slicer.mrmlScene.Clear(0)
    yield 2
    check(
        "after Close the panel asks for a volume",
        "choose a rest volume" in panel().ui.applyButton.text,
        panel().ui.applyButton.text,
    )
    photo("closed")
    slicer.util.loadScene(file)
    yield 4
    photo("loaded")
    parameters = panel()._parameterNode
    check("the result is chosen again", parameters.resultModel is not None)
    angle = sight()
    check("the 3-D view does not look along the map's edge", angle < 75, f"{angle:.0f} degrees")
    after = slicer.util.arrayFromModelCellData(parameters.resultModel, "Mu")
    check("the same moduli", np.array_equal(before, after, equal_nan=True))
    check(
        "the pushed volumes are checked again", len(panel().ui.pushedSelector.checkedNodes()) == 2
    )
    check("edge length as before", parameters.edgeLength == 7.0)
    materials = panel().ui.materialsTable
    check("materials as before", materials.rowCount == 5, materials.rowCount)


def files():
    """Own files: written, and read through the window that File ▸ Add Data opens."""
    folder = OUTPUT / "own"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("Phantom rest", "Phantom pushed 1", "Phantom pushed 2"):
        slicer.util.saveNode(slicer.util.getNode(name), str(folder / f"{name[8:]}.nrrd"))
    slicer.util.saveNode(
        slicer.util.getNode("Phantom segmentation"), str(folder / "blocks.seg.nrrd")
    )
    slicer.mrmlScene.Clear(0)
    yield 1
    mouse.click(slicer.util.mainWindow())
    mouse.keys("ctrl+o")
    yield 2
    photo("add-data")
    dialog = slicer.app.activeModalWidget()
    check("Add Data opens", dialog is not None)
    if dialog is None:
        return
    mouse.click(button(dialog, "Choose File"))
    yield 2
    photo("add-data-files")
    chooser = slicer.app.activeModalWidget()
    check("a file dialog opens", chooser is not None and chooser is not dialog, str(chooser))
    mouse.write(" ".join(f'"{path}"' for path in sorted(folder.glob("*.nrrd"))))
    mouse.keys("Return")
    yield 2
    photo("add-data-list")
    mouse.keys("Return")
    yield until("the files", lambda: len(names("vtkMRMLSegmentationNode")) == 1, 60)
    yield 2
    slicer.util.selectModule("Data")  # the panel suggests when it is entered
    yield 1
    slicer.util.selectModule("ElastoIdentify")
    yield 2
    photo("own-files")
    check(
        "own files are there",
        sorted(names("vtkMRMLScalarVolumeNode")) == ["pushed 1", "pushed 2", "rest"],
        names("vtkMRMLScalarVolumeNode"),
    )
    check(
        "own materials came with the segmentation",
        panel().ui.materialsTable.rowCount == 5,
        panel().ui.materialsTable.rowCount,
    )


def in_view(view, place):
    """Return where a RAS point is in a slice view, in pixels of its widget."""
    inverse = np.linalg.inv(slicer.util.arrayFromVTKMatrix(view.mrmlSliceNode().GetXYToRAS()))
    x, y = (inverse @ [*place, 1.0])[:2]
    return x, view.height - 1 - y


def editor():
    """Segment Editor: segments drawn with the mouse on own images, then their materials."""
    slicer.mrmlScene.Clear(0)
    for name in ("rest", "pushed 1", "pushed 2"):
        # Names that differ by their number are taken for the slices of one volume otherwise.
        slicer.util.loadVolume(str(OUTPUT / "own" / f"{name}.nrrd"), {"singleFile": True})
    rest = slicer.util.getNode("rest")
    yield 1
    slicer.util.selectModule("SegmentEditor")
    yield 2
    editor = slicer.modules.segmenteditor.widgetRepresentation().self().editor
    if editor.sourceVolumeNode() is None:
        editor.setSourceVolumeNode(rest)
    yield 1
    photo("segment-editor")
    view = slicer.app.layoutManager().sliceWidget("Red").sliceView()
    slicer.app.layoutManager().sliceWidget("Red").mrmlSliceNode().RotateToVolumePlane(rest)
    slicer.app.layoutManager().sliceWidget("Red").sliceLogic().FitSliceToAll()
    yield 1
    matrix = rest.GetImageData().GetDimensions()
    toRas = np.eye(4)
    from ElastoIdentifyLib.images import ijk_to_world

    toRas = ijk_to_world(rest)
    width, height = matrix[:2]
    # shares of the image's height: the pad on top of the tissue, the rigid indenter and floor
    for first, last in ((0.16, 0.30), (0.30, 0.85)):
        mouse.click(button(editor, "Add"))
        yield 1
        mouse.click(button(editor, "Draw"))
        yield 1
        corners = [(0.2, first), (0.8, first), (0.8, last), (0.2, last)]
        for across, down in corners:
            place = (toRas @ [across * width, down * height, 0, 1])[:3]
            mouse.click(view, *in_view(view, place))
            yield 0.4
        mouse.keys("Return")
        yield 1
    photo("segments-drawn")
    node = editor.segmentationNode()
    check("two segments were drawn", node.GetSegmentation().GetNumberOfSegments() == 2)
    for number in range(node.GetSegmentation().GetNumberOfSegments()):
        segmentId = node.GetSegmentation().GetNthSegmentID(number)
        mask = slicer.util.arrayFromSegmentBinaryLabelmap(node, segmentId, rest)
        check(f"segment {number + 1} is not empty", mask.any(), int(mask.sum()))
    slicer.util.selectModule("ElastoIdentify")
    yield 2
    ui = panel().ui
    check("the button asks for what is missing", "choose pushed" in ui.applyButton.text)
    photo("segments-in-panel")


def selftest():
    """The module's own test, as Slicer's test runner runs it."""
    import unittest

    import ElastoIdentify

    slicer.mrmlScene.Clear(0)
    yield 1
    try:
        ElastoIdentify.ElastoIdentifyTest().runTest()
        check("ElastoIdentifyTest", True)
    except (AssertionError, Exception, unittest.SkipTest) as problem:
        check("ElastoIdentifyTest", False, repr(problem))
    yield 1


def tour():
    yield 3
    window = slicer.util.mainWindow()
    window.showMaximized()
    yield 2
    photo("start")
    print("Slicer", slicer.app.applicationVersion, "Python", sys.version.split()[0], flush=True)
    check("the module is loaded", hasattr(slicer.modules, "elastoidentify"))
    for part in PARTS:
        print("--", part, flush=True)
        for step in globals()[part]():
            yield step
        if part == "sample":
            for step in inputs():
                yield step


def finished(problem):
    if problem is not None:
        try:
            photo("failed")
        except Exception as second:
            print(second)
        checks.append((f"the tour went to its end: {problem!r}", False, ""))
    failed = [what for what, holds, _ in checks if not holds]
    print(f"{len(checks) - len(failed)} checks hold, {len(failed)} fail", *failed, sep="\n  ")
    slicer.util.exit(1 if failed else 0)


timer = mouse.run(tour(), finished)
