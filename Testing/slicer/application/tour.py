"""The module used in Slicer's window as a person would, with checks and pictures.

start.sh FOLDER --python-script /helpers/tour.py OUTPUT_FOLDER [PART...]

Parts, in this order: sample cancel apply views again exports scene files drawn volume selftest.
cancel and apply need sample before them, views, again and exports need apply, scene and files need
apply or saved, which opens the scene of an earlier tour, drawn needs files. Ends with a line per
check, and with the exit code 1 if one of them failed.
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
ALL = ("sample", "cancel", "apply", "views", "again", "exports", "scene", "files", "drawn")
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
    found = [one for one in found if not one.inherits("QCheckBox")]
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


def click_sample(text, segmentation):
    """Sample Data: the phantoms' buttons are there; a click on one makes its nodes."""
    slicer.util.selectModule("SampleData")
    yield 2
    widget = slicer.modules.sampledata.widgetRepresentation()
    buttons = slicer.util.findChildren(widget, className="QToolButton")
    shown = {b.text: b for b in buttons if "phantom" in b.text}
    check("Sample Data has the phantoms' buttons", len(shown) == 2, list(shown))
    scroll(shown[text])
    yield 0.5
    photo("sample-data")
    mouse.click(shown[text])
    yield until("the phantom", lambda: segmentation in names("vtkMRMLSegmentationNode"), 240)
    yield 3


def sample():
    """The phantom of Sample Data, a slice."""
    yield from click_sample("ElastoIdentify phantom", "Phantom segmentation")
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
    check("the table has the segments' colours", *coloured_like())
    check(
        "button says what is missing",
        "choose pushed volumes" in ui.applyButton.text,
        ui.applyButton.text,
    )
    photo("panel-missing")
    yield from check_volumes(2)
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


def check_volumes(number):
    """Check the pushed volumes in their list."""
    selector = panel().ui.pushedSelector
    scroll(selector)
    yield 0.5
    mouse.click(selector)
    yield 1.5
    photo("panel-pushed-open")
    box = slicer.util.findChildren(selector, className="ctkCheckableComboBox")[0]
    view = box.view()
    for row in range(box.count):
        index = box.model().index(row, 0, box.rootModelIndex())
        if "pushed" in str(index.data()):
            mouse.click_item(view, index)
            yield 0.5
    mouse.keys("Escape")
    yield 0.5
    checked = [node.GetName() for node in panel()._parameterNode.pushedVolumes]
    good = len(checked) == number and all("pushed" in name for name in checked)
    check("the pushed volumes are checked", good, checked)


def swatches():
    """Return the colours of the squares in the table of materials."""
    table = panel().ui.materialsTable
    pixels = [
        qt.QColor(table.item(row, 0).icon().pixmap(16, 16).toImage().pixel(8, 8))
        for row in range(table.rowCount)
    ]
    return [(pixel.red(), pixel.green(), pixel.blue()) for pixel in pixels]


def colours():
    """Return the colours of the segments, 0 to 255."""
    segments = panel()._parameterNode.segmentation.GetSegmentation()
    found = [segments.GetNthSegment(n).GetColor() for n in range(segments.GetNumberOfSegments())]
    return [tuple(round(255 * part) for part in colour) for colour in found]


def coloured_like():
    """Return whether the squares have the segments' colours, to rounding, and both."""
    found, wanted = np.array(swatches()), np.array(colours())
    return found.shape == wanted.shape and np.abs(found - wanted).max() <= 1, (found, wanted)


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
    yield from install()  # itk-elastix, if it is not there yet
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


def press_apply(seconds):
    """Press Apply and wait for the end; returns the words of progress that were shown."""
    ui = panel().ui
    scroll(ui.applyButton)
    yield 0.3
    mouse.click(ui.applyButton)
    yield 2
    seen = []

    def done():
        if not seen or seen[-1] != ui.statusLabel.text:
            seen.append(ui.statusLabel.text)
        return panel().run is None

    yield until("the map", done, seconds)
    yield 4
    return seen


def apply():
    """A map of the phantom."""
    panel()._parameterNode.cache = str(OUTPUT / "cache")  # the next map of it is there at once
    stored = os.path.isdir(panel()._parameterNode.cache)
    seen = yield from press_apply(1800)
    photo("map")
    check("many words of progress were shown", len(seen) > (5 if stored else 20), len(seen))
    model = panel()._parameterNode.resultModel
    check("there is a map", model is not None, panel().ui.statusLabel.text)
    if model is not None:
        moduli()


def moduli():
    """Print the medians by label, and the table."""
    model = panel()._parameterNode.resultModel
    label, mu, status = (
        slicer.util.arrayFromModelCellData(model, name) for name in ("Label", "Mu", "Status")
    )
    for value in np.unique(label):
        inside = (label == value) & (status > 0)
        print("    label", value, "median mu", np.median(mu[inside]), "cells", inside.sum())
    table = slicer.util.getNode("Stiffness: segments").GetTable()
    for row in range(table.GetNumberOfRows()):
        cells = (table.GetValue(row, c) for c in range(table.GetNumberOfColumns()))
        print("    ", [cell.ToString() for cell in cells])


def coloured(widget):
    """Return whether a view shows strong colours, which the map has, and on how much of it."""
    image = widget.grab().toImage()
    places = [(x, y) for x in range(0, image.width(), 4) for y in range(0, image.height(), 4)]
    found = [qt.QColor(image.pixel(x, y)) for x, y in places]
    parts = [(colour.red(), colour.green(), colour.blue()) for colour in found]
    box = (255, 0, 255)  # the frame that a 3-D view draws is no map
    strong = (
        max(part) - min(part) > 90 and np.ptp([part, box], axis=0).max() > 80 for part in parts
    )
    share = sum(strong) / len(parts)
    return share > 0.02, round(share, 3)


def sight():
    """Return the angle between the line of sight and the normal of the plane map, in degrees."""
    window = slicer.app.layoutManager().threeDWidget(0).threeDView().renderWindow()
    camera = window.GetRenderers().GetFirstRenderer().GetActiveCamera()  # not only the scene's node
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
    check("3-D view shows colours", *coloured(manager.threeDWidget(0)))
    check("red view shows colours", *coloured(manager.sliceWidget("Red")))
    check("table and chart are the map's", *figures_of(model))
    ui = panel().ui
    scroll(ui.showComboBox)
    yield 0.5
    yield from choose(ui.showComboBox, "MuStd")
    yield 1
    check(
        "another quantity is shown",
        model.GetDisplayNode().GetActiveScalarName() == "MuStd",
        model.GetDisplayNode().GetActiveScalarName(),
    )
    photo("map-uncertainty")
    yield from choose(ui.showComboBox, "Mu")
    slicer.util.selectModule("Data")
    yield 2
    photo("data")
    slicer.util.selectModule("ElastoIdentify")
    yield 1


def figures_of(model):
    """Return whether the table and the chart that are shown are a result's, and their names."""
    manager = slicer.app.layoutManager()
    table = manager.tableWidget(0).tableView().mrmlTableNode()
    chart = manager.plotWidget(0).mrmlPlotViewNode().GetPlotChartNode()
    shown = [node and node.GetName() for node in (table, chart)]
    return shown == [f"{model.GetName()}: segments", f"{model.GetName()}: chart"], shown


def again():
    """A second map puts the first one aside; a click brings it back, another one the second."""
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
    check("table and chart are the second's", *figures_of(second))
    photo("second")
    for name, model, other in (("first", first, second), ("second", second, first)):
        scroll(ui.restoreButton)
        yield 0.5
        mouse.click(ui.restoreButton)
        yield 1
        shown = panel()._parameterNode.resultModel
        check(f"the {name} is back", shown is model and model.GetName() == "Stiffness")
        check("and seen", model.GetDisplayNode().GetVisibility())
        check("the other is not", not other.GetDisplayNode().GetVisibility(), other.GetName())
        check(f"table and chart are the {name}'s", *figures_of(model))
        photo(f"restored-{name}")


def exports():
    """What radiologists take away, by the three buttons and Slicer's own file dialogs."""
    ui = panel().ui
    folder = OUTPUT / "exports"
    (folder / "dicom").mkdir(parents=True, exist_ok=True)
    for kind, where, made in (
        ("Html", folder / "map.html", "map.html"),
        ("Nifti", folder / "case1", "case1_mu.nii.gz"),
        ("Dicom", folder / "dicom", "dicom/mu.dcm"),
    ):
        yield from export(getattr(ui, f"export{kind}Button"), kind.lower(), where)
        written = (folder / made).exists()
        check(f"{kind} is written", written, ui.statusLabel.text)
        check("the status line says so", "Wrote" in ui.statusLabel.text, ui.statusLabel.text)
        yield 0.5


def export(pressed, kind, where):
    """Press a button of Export, cancel its dialog, press it again and write a name."""
    before = panel().ui.statusLabel.text
    scroll(pressed)
    yield 0.5
    for written in (False, True):
        mouse.click(pressed)
        yield 2
        photo(f"export-{kind}")
        check(f"{kind}: a dialog asks where to", slicer.app.activeModalWidget() is not None)
        if not written:
            mouse.keys("Escape")
            yield 1
            check(f"{kind}: Cancel writes nothing", panel().ui.statusLabel.text == before)
            continue
        mouse.keys("ctrl+a")
        mouse.write(str(where))
        mouse.keys("Return")
        yield 2
    yield from install()
    yield until("the files", lambda: panel().ui.statusLabel.text != before, 240)


def install():
    """Say yes, if something is to be installed."""
    dialog = slicer.app.activeModalWidget()
    if dialog is not None:
        photo("install")
        mouse.click(button(dialog, "OK"))
        yield until("the installation", lambda: slicer.app.activeModalWidget() is None, 600)
        yield 1


def volume():
    """The 3-D phantom of Sample Data, with one value per segment."""
    slicer.mrmlScene.Clear(0)
    yield 1
    yield from click_sample("ElastoIdentify 3-D phantom", "Phantom 3-D segmentation")
    photo("sample-volume")
    slicer.util.selectModule("ElastoIdentify")
    yield 2
    ui, parameters = panel().ui, panel()._parameterNode
    yield from check_volumes(3)
    scroll(ui.wholeVolumeCheckBox)
    yield 0.3
    mouse.click(ui.wholeVolumeCheckBox, 10)
    yield 0.5
    check("whole volume is checked", parameters.wholeVolume)
    parameters.edgeLength, parameters.grouping = 11.0, "label"
    yield from press_apply(1800)
    yield 3
    photo("volume")
    model = parameters.resultModel
    check("there is a 3-D map", model is not None, ui.statusLabel.text)
    if model is not None:
        moduli()
        check("3-D view shows colours", *coloured(slicer.app.layoutManager().threeDWidget(0)))
        check("table and chart are the map's", *figures_of(model))


def saved():
    """Open the scene of an earlier tour in a Slicer that has just started."""
    slicer.util.selectModule("ElastoIdentify")
    yield 1
    slicer.util.loadScene(str(OUTPUT / "map.mrb"))
    yield 4
    photo("saved")


def open_files(paths):
    """Read files through the window that File ▸ Add Data opens."""
    mouse.click(slicer.util.mainWindow())
    mouse.keys("ctrl+o")
    yield 2
    dialog = slicer.app.activeModalWidget()
    check("Add Data opens", dialog is not None)
    mouse.click(button(dialog, "Choose File"))
    yield 2
    photo("add-data-files")
    chooser = slicer.app.activeModalWidget()
    check("a file dialog opens", chooser is not None and chooser is not dialog, str(chooser))
    mouse.write(" ".join(f'"{path}"' for path in paths))
    mouse.keys("Return")
    yield 2
    photo("add-data-list")
    mouse.keys("Return")
    yield 2


def save_scene():
    """Save the scene as one file through the window that File ▸ Save Data opens."""
    slicer.mrmlScene.SetRootDirectory(str(OUTPUT))
    before = set(OUTPUT.glob("*.mrb"))
    mouse.click(slicer.util.mainWindow())
    mouse.keys("ctrl+s")
    yield 2
    dialog = slicer.app.activeModalWidget()
    check("Save Data opens", dialog is not None)
    bundle = slicer.util.findChild(dialog, "DataBundleButton")
    mouse.click(bundle)
    yield 1
    photo("save")
    mouse.click(button(dialog, "Save"))
    yield 2
    yield from replaced(dialog)
    yield until("the scene's file", lambda: slicer.app.activeModalWidget() is None, 120)
    made = sorted(set(OUTPUT.glob("*.mrb")) - before)
    check("the scene is saved", len(made) == 1, [path.stat().st_size for path in made])
    if made:
        made[0].rename(OUTPUT / "map.mrb")
    else:
        slicer.util.saveScene(str(OUTPUT / "map.mrb"))


def replaced(dialog):
    """Say yes, where a dialog asks whether a file of this name is to be replaced."""
    another = slicer.app.activeModalWidget()
    if another is not None and another is not dialog:
        photo("save-replace")
        mouse.keys("Return")
        yield 1


def close_scene():
    """File ▸ Close Scene, and what it asks."""
    mouse.click(slicer.util.mainWindow())
    mouse.keys("ctrl+w")
    yield 2
    asked = slicer.app.activeModalWidget()
    if asked is not None:
        photo("close")
        mouse.click(button(asked, "Close scene"))
        yield 2
    # Slicer takes the button for the other one with Qt 6 (qSlicerMainWindow::confirmCloseScene)
    saving = slicer.app.activeModalWidget()
    if saving is not None:
        mouse.click(button(saving, "Save"))
        yield 2
        yield from replaced(saving)
        yield until("the scene is closed", lambda: slicer.app.activeModalWidget() is None, 120)
    yield 2


def scene():
    """Save, close, load again: the map and the panel come back."""
    before = slicer.util.arrayFromModelCellData(panel()._parameterNode.resultModel, "Mu").copy()
    was = panel().ui.statusLabel.text
    yield from save_scene()
    yield from close_scene()
    says = panel().ui.applyButton.text
    check("after Close the panel asks for a volume", "choose a rest volume" in says, says)
    photo("closed")
    yield from open_files([OUTPUT / "map.mrb"])
    yield until("the map", lambda: panel()._parameterNode.resultModel is not None, 60)
    yield 4
    photo("loaded")
    parameters, ui = panel()._parameterNode, panel().ui
    angle = sight()
    check("the 3-D view does not look along the map's edge", angle < 75, f"{angle:.0f} degrees")
    manager = slicer.app.layoutManager()
    check("3-D view shows colours", *coloured(manager.threeDWidget(0)))
    check("red view shows colours", *coloured(manager.sliceWidget("Red")))
    check("table and chart are the map's", *figures_of(parameters.resultModel))
    after = slicer.util.arrayFromModelCellData(parameters.resultModel, "Mu")
    check("the same moduli", np.array_equal(before, after, equal_nan=True))
    check("the pushed volumes are checked again", len(ui.pushedSelector.checkedNodes()) == 2)
    check("edge length as before", parameters.edgeLength == 7.0)
    check("materials as before", ui.materialsTable.rowCount == 5, ui.materialsTable.rowCount)
    check("the table has the segments' colours", *coloured_like())
    aside = "again" in PARTS
    check("what was put aside can be restored", ui.restoreButton.enabled == aside)
    print("    the status line before:", was, "after:", ui.statusLabel.text)


def files():
    """Own files, through File ▸ Add Data."""
    folder = OUTPUT / "own"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("Phantom rest", "Phantom pushed 1", "Phantom pushed 2"):
        slicer.util.saveNode(slicer.util.getNode(name), str(folder / f"{name[8:]}.nrrd"))
    blocks = slicer.util.getNode("Phantom segmentation")
    slicer.util.saveNode(blocks, str(folder / "blocks.seg.nrrd"))
    yield from close_scene()
    yield from open_files(sorted(folder.glob("*.nrrd")))
    yield until("the files", lambda: len(names("vtkMRMLSegmentationNode")) == 1, 60)
    yield 2
    slicer.util.selectModule("Data")  # the panel suggests when it is entered
    yield 1
    slicer.util.selectModule("ElastoIdentify")
    yield 2
    photo("own-files")
    found = sorted(names("vtkMRMLScalarVolumeNode"))
    check("own files are there", found == ["pushed 1", "pushed 2", "rest"], found)
    rows = panel().ui.materialsTable.rowCount
    check("own materials came with the segmentation", rows == 5, rows)


def in_view(view, place):
    """Return where a RAS point is in a slice view, in pixels of its widget."""
    inverse = np.linalg.inv(slicer.util.arrayFromVTKMatrix(view.mrmlSliceNode().GetXYToRAS()))
    x, y = (inverse @ [*place, 1.0])[:2]
    return x, view.height - 1 - y


# Shares of the image's height; nothing tells of the inclusion.
DRAWN = {"indenter": (0.0, 0.09), "pad": (0.09, 0.294), "tissue": (0.294, 0.905)}
DRAWN["floor"] = (0.905, 1.0)


def drawn():
    """Segments drawn with the mouse on own images, their materials by hand, and the map."""
    slicer.mrmlScene.Clear(0)
    for name in ("rest", "pushed 1", "pushed 2"):
        # Names that differ by their number are taken for the slices of one volume otherwise.
        slicer.util.loadVolume(str(OUTPUT / "own" / f"{name}.nrrd"), {"singleFile": True})
    yield 1
    yield from draw(slicer.util.getNode("rest"))
    slicer.util.selectModule("ElastoIdentify")
    yield 2
    ui, parameters = panel().ui, panel()._parameterNode
    check("the button asks for what is missing", "choose pushed" in ui.applyButton.text)
    check("the table has the segments' colours", *coloured_like())
    photo("segments-in-panel")
    yield from check_volumes(2)
    says = ui.applyButton.text
    check("the button asks for a known segment", "say which segment is known" in says, says)
    for row, role in enumerate(("rigid", "known", "unknown", "rigid")):
        yield from choose(ui.materialsTable.cellWidget(row, 1), role)
    for column, text in ((2, "5"), (3, "0.45")):
        yield from write_cell(ui.materialsTable, 1, column, text)
    pad = list(panel().logic.request(parameters).segments().values())[1][2]
    check("E and ν are typed", (pad.young, pad.poisson) == (5.0, 0.45), pad)
    photo("segments-materials")
    parameters.edgeLength = 7.0
    yield from press_apply(1800)
    photo("segments-map")
    model = parameters.resultModel
    check("there is a map of the drawn segments", model is not None, ui.statusLabel.text)
    if model is None:
        return
    moduli()
    check("the inclusion, which was not drawn, is seen", *inclusion_of(model))


def inclusion_of(model):
    """Return whether mu is larger where the phantom's inclusion is than elsewhere, and medians."""
    from ElastoIdentifyLib.images import ijk_to_world

    rest = slicer.util.getNode("rest")
    size = np.array(rest.GetImageData().GetDimensions())
    points = slicer.util.arrayFromModelPoints(model)
    mesh, ids = model.GetMesh(), []
    for number in range(mesh.GetNumberOfCells()):
        cell = mesh.GetCell(number)
        ids.append([cell.GetPointId(n) for n in range(cell.GetNumberOfPoints())])
    centres = np.c_[points[np.array(ids)].mean(axis=1), np.ones(len(ids))]
    share = (centres @ np.linalg.inv(ijk_to_world(rest)).T)[:, :2] / size[:2]
    away = np.hypot(*(share - (0.54, 0.58)).T)  # where it is in the picture, of radius 0.12
    mu, tissue = (slicer.util.arrayFromModelCellData(model, name) for name in ("Mu", "Label"))
    inside, outside = (
        float(np.nanmedian(mu[part & (tissue == 3)])) for part in (away < 0.1, away > 0.2)
    )
    return inside > 2 * outside, (round(inside, 3), round(outside, 3))


def write_cell(table, row, column, text):
    """Write into a cell of a table, as a hand does."""
    mouse.click_item(table, table.model().index(row, column), times=2)
    yield 0.5
    mouse.keys("ctrl+a")
    mouse.write(text)
    mouse.keys("Return")
    yield 0.5


def draw(rest):
    """Draw the segments of DRAWN in the Segment Editor."""
    from ElastoIdentifyLib.images import ijk_to_world

    slicer.util.selectModule("SegmentEditor")
    yield 2
    editor = slicer.modules.segmenteditor.widgetRepresentation().self().editor
    editor.setSourceVolumeNode(rest)
    slicer.util.setSliceViewerLayers(background=rest)
    yield 1
    red = slicer.app.layoutManager().sliceWidget("Red")
    red.mrmlSliceNode().RotateToVolumePlane(rest)
    red.sliceLogic().FitSliceToAll()
    sizes = np.array(red.mrmlSliceNode().GetFieldOfView()) * (1.2, 1.2, 1)  # its border is seen
    red.mrmlSliceNode().SetFieldOfView(*sizes)
    yield 1
    photo("segment-editor")
    width, height = rest.GetImageData().GetDimensions()[:2]
    for first, last in DRAWN.values():
        mouse.click(button(editor, "Add"))
        yield 1
        mouse.click(button(editor, "Draw"))
        yield 1
        for across, down in ((0.09, first), (0.91, first), (0.91, last), (0.09, last)):
            place = (ijk_to_world(rest) @ [across * width, down * height, 0, 1])[:3]
            mouse.click(red.sliceView(), *in_view(red.sliceView(), place))
            yield 0.4
        mouse.keys("Return")
        yield 1
    photo("segments-drawn")
    node = editor.segmentationNode()
    segments = node.GetSegmentation()
    ids = [segments.GetNthSegmentID(n) for n in range(segments.GetNumberOfSegments())]
    check("four segments were drawn", len(ids) == len(DRAWN), ids)
    for number, (segment, name) in enumerate(zip(ids, DRAWN, strict=False), 1):
        mask = slicer.util.arrayFromSegmentBinaryLabelmap(node, segment, rest)
        check(f"segment {number} is not empty", mask.any(), int(mask.sum()))
        segments.GetSegment(segment).SetName(name)


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
        yield from globals()[part]()
        if part == "sample":
            yield from inputs()


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
