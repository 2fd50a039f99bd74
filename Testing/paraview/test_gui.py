"""The real application on a virtual display: menus, panel, table, Apply, and what comes out."""

import functools
import os
import re
import subprocess
import time
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hosts import program
from paraview_host import HERE, LAUNCHER, PACKAGES, end, environment, within

WINDOW = "pqClientMainWindow"
SCROLL = "qt_scrollarea_viewport"
PANEL = f"{WINDOW}/propertiesDock/propertiesPanel"
FORM = f"{PANEL}/scrollArea/{SCROLL}/scrollAreaWidgetContents/PropertiesFrame/ProxyPanel"
INFORMATION = (
    f"{WINDOW}/informationDock/informationWidgetFrame/informationScrollArea/{SCROLL}"
    "/informationWidget"
)
KNOWN = f"{FORM}/KnownMaterials/ScalarValueList"
MESSAGES = f"{WINDOW}/outputWidgetDock/outputWidget"
PICTURES = HERE.parents[1] / "docs" / "pictures"


def event(widget, command, arguments=""):
    return f"<pqevent object={quoteattr(widget)} command={quoteattr(command)} " + (
        f"arguments={quoteattr(str(arguments))}/>"
    )


def check(widget, what, value):
    return f"<pqcheck object={quoteattr(widget)} property={quoteattr(what)} " + (
        f"arguments={quoteattr(str(value))}/>"
    )


def apply():
    return event(f"{PANEL}/Accept", "activate")


def menu(name, entry):
    category = "ElastoIdentify" if version() < (5, 13) else "Elasto Identify"
    return [
        event(f"{WINDOW}/menubar", "activate", name),
        event(f"{WINDOW}/menubar/{name}", "activate", category),
        event(f"{WINDOW}/menubar/{name}/ElastoIdentify", "activate", entry),
    ]


@functools.cache
def version():
    """ParaView's version, (major, minor)."""
    said = subprocess.run([program("pvserver"), "--version"], capture_output=True, text=True)
    return tuple(map(int, re.search(r"(\d+)\.(\d+)", said.stdout + said.stderr).groups()))


def without_messages():
    """Close the window of messages, which a warning opens over the map, until the next warning."""
    return [
        event(f"{MESSAGES}/alwaysOpenForNewMessagesCheckBox", "set_boolean", "false"),
        event(f"{WINDOW}/menubar", "activate", "menu_View"),
        event(f"{WINDOW}/menubar/menu_View", "activate", "Output Messages"),
    ]


def known_material(*row):
    """One more row in the table, which is empty to begin with."""
    return [event(f"{KNOWN}/Add", "activate"), *changed(dict(enumerate(row)))]


def changed(cells):
    """Edit the table's first row: column → value."""
    return [
        step
        for column, value in cells.items()
        for step in (
            event(f"{KNOWN}/Table", "edit", f"0.{column}"),
            event(f"{KNOWN}/Table", "editAccepted", f"0.{column},{value}"),
        )
    ]


def rounded(expression):
    """Calculator on the cells: rounds, so that a check by text does not hang on the last digit."""
    return [
        event(f"{WINDOW}/menubar/menuFilters/pqProxyGroupMenuManager0/Calculator", "activate"),
        event(f"{FORM}/AttributeType/ComboBox", "set_string", "Cell Data"),
        event(f"{FORM}/Function/Function/OneLiner", "set_string", expression),
        apply(),
    ]


def play(tmp_path, display, steps, picture=None, extra=(), seconds=120):
    """Play the steps; return whether they all succeeded, and what the application printed."""
    script = written(tmp_path / "steps.xml", steps)
    alive, text = application(tmp_path, display, [script, *extra], ENDED, picture, seconds=seconds)
    return alive and SUCCESS in text, text


SUCCESS = "Success =  true"
FAILED = "critical: In event"
ENDED = rf"is finished\. Success|{FAILED}"


def written(path, steps):
    """Write a script of steps; return the argument that makes the application play it."""
    path.write_text('<?xml version="1.0" ?><pqevents>' + "\n".join(steps) + "</pqevents>")
    return f"--test-script={path}"


def application(tmp_path, display, arguments, ended, picture=None, meanwhile=None, seconds=120):
    """Let the application run until it has printed what matches `ended`, or for so many seconds.

    `meanwhile` is called every now and then. Returns whether the application is alive then, and
    what it printed.
    """
    log = tmp_path / "log.txt"
    program("paraview")

    def has_ended():
        if meanwhile:
            meanwhile()
        return re.search(ended, log.read_text(), re.S)

    with log.open("w") as output:
        window = subprocess.Popen(
            [*LAUNCHER, "gui", "--dr", *arguments],
            env=environment(DISPLAY=display, XDG_RUNTIME_DIR=str(tmp_path)),
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            within(seconds, has_ended, window)
            text = log.read_text()
            if picture:
                time.sleep(1.0)  # the last rendering
                shoot(display, picture)
            alive = window.poll() is None
        finally:
            end(window)
    return alive, text


def shoot(display, picture, trim=True):
    """Keep a picture of the display, without its empty border if `trim`."""
    picture.parent.mkdir(parents=True, exist_ok=True)
    command = [
        program("import"),
        "-window",
        "root",
        *(["-trim"] if trim else []),
        str(picture),
    ]
    subprocess.run(command, env={**os.environ, "DISPLAY": display}, check=True, timeout=60)


def identified(young, expected):
    """The steps of a user who tries the phantom, and what the result has to be."""
    return [
        *menu("menuSources", "PushingPhantom"),
        event(f"{FORM}/Shape/ComboBox", "set_string", "quads"),
        apply(),
        check(f"{INFORMATION}/cellCount", "text", 64),
        *menu("menuFilters", "LameIdentification"),
        *known_material(1, young, 0.43),
        apply(),
        check(f"{INFORMATION}/cellCount", "text", 64),
        *rounded("floor(Mu+0.5)"),
        check(f"{INFORMATION}/dataArraysTable", "modelItemData", expected),
    ]


RESULT = "17.2"  # where the Calculator's array and its range stand in the table of arrays


def failing_first():
    """A known material that is not there, and then one that is."""
    return [
        *menu("menuSources", "PushingPhantom"),
        apply(),
        *menu("menuFilters", "LameIdentification"),
        *known_material(9, 5000, 0.43),
        apply(),
        check(f"{INFORMATION}/cellCount", "text", 0),
        *changed({0: 1}),
        apply(),
        check(f"{INFORMATION}/cellCount", "text", 128),
        check(f"{WINDOW}/variableToolbar/displayColor/Variables", "currentText", "Mu"),
    ]


@pytest.fixture(scope="module")
def played(tmp_path_factory, display):
    """What the application printed of each of three scripts, which it plays one after another.

    It resets itself before each, and ends at the first that fails: the one that has to is the last.
    """
    folder = tmp_path_factory.mktemp("played")
    scripts = {
        "right": identified(10000, f"{RESULT},[3497, 10490]"),
        "failing": failing_first(),
        "wrong": identified(5000, f"{RESULT},[3497, 10490]"),
    }
    arguments = [written(folder / f"{name}.xml", steps) for name, steps in scripts.items()]
    _, text = application(folder, display, arguments, rf"(is finished.*){{3}}|{FAILED}")
    parts = re.findall(r"^Playing: \S*/(\w+)\.xml(.*?)(?=^Playing: |\Z)", text, re.M | re.S)
    return dict.fromkeys(scripts, f"was not played: {text}") | dict(parts)


def test_menus_table_and_apply_give_the_right_stiffness(played):
    """E = 10 kPa for the pad instead of 5: μ of the tissue is 10000/2.86 Pa, the inclusion's 3×."""
    assert SUCCESS in played["right"], played["right"]


def test_a_failing_filter_leaves_the_application_alive_and_the_next_apply_works(played):
    text = played["failing"]
    assert SUCCESS in text, text
    assert "known label 9" in text, text
    assert not re.search("returned failure|Traceback", text), text


def test_a_wrong_expectation_fails(played):
    """The first check can fail: the same steps with the pad as it was."""
    assert SUCCESS not in played["wrong"]
    assert 'Checked item contain : "[1748, 5245]"' in played["wrong"]


BOX = f"{FORM}/InteractiveBox"


def test_a_box_in_the_view_is_one_more_reaction_box(tmp_path, display):
    """A block that touches nothing but the box, and the box typed into ParaView's own widget."""
    labels = np.zeros((1, 20, 20), np.uint8)
    labels[0, 4:16, 4:16] = 2
    pytest.importorskip("SimpleITK", reason="needs SimpleITK: pip install SimpleITK")
    from elastoidentify.imaging.image import Image
    from elastoidentify.imaging.io import write_image

    write_image(tmp_path / "segmentation.nrrd", Image(labels))
    (tmp_path / "open.py").write_text(
        "from paraview.simple import *\n"
        f"block = ElastoIdentifyImage(FileNames=[{str(tmp_path / 'segmentation.nrrd')!r}], "
        "Kind='segmentation')\nShow(block)\nResetCamera()\nSetActiveSource(block)\n"
    )
    page = "/tabWidget/qt_tabwidget_stackedwidget/fieldsPage" if version() >= (6, 0) else ""
    ends = {"translateX": 0, "translateY": 15, "translateZ": -1}
    ends |= {"scaleX": 20, "scaleY": 2, "scaleZ": 2}
    steps = [
        *menu("menuFilters", "SegmentationToTriangleMesh"),
        event(f"{FORM}/EdgeLength/DoubleLineEdit0", "set_string", "3"),
        apply(),
        check(f"{INFORMATION}/dataArraysTable", "modelItemData", "1.2,[0, 0]"),
        event(f"{FORM}/BoxInView/ComboBox", "set_string", "reaction"),
        *(event(f"{BOX}{page}/{name}", "set_string", value) for name, value in ends.items()),
        apply(),
        check(f"{INFORMATION}/dataArraysTable", "modelItemData", "1.2,[0, 1]"),
    ]
    folder = os.environ.get("ELASTOIDENTIFY_PICTURES")
    picture = folder and Path(folder) / "paraview-box.png"
    good, text = play(tmp_path, display, steps, picture, [f"--script={tmp_path / 'open.py'}"])
    assert good, text


LONG_RUN = """
from paraview.simple import *
found = LameIdentification(Input=PushingPhantom(Shape="hexahedra"), Method="regularized")
algorithm = found.GetClientSideObject()

def abort(*_):  # what the red cross beside the progress bar does (pqProgressManager::triggerAbort)
    if algorithm.GetProgress() > 0.2:
        algorithm.SetAbortExecuteAndUpdateTime()

ear = algorithm.AddObserver("ProgressEvent", abort) if ABORT else None
open(BEGUN, "w").close()  # what is printed comes at the end only
try:
    UpdatePipeline(proxy=found)
except BaseException as problem:
    print("stopped:", problem)
print(found.GetDataInformation().GetNumberOfCells(), "cells")
if ear:
    algorithm.RemoveObserver(ear)
found.Method = "global"
UpdatePipeline(proxy=found)
print(found.GetDataInformation().GetNumberOfCells(), "cells; ended")
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["stop", "abort"])
def test_a_run_can_be_ended_and_leaves_the_application_usable(tmp_path, display, way):
    """By the launcher, and from ParaView 6.1 on by its own abort.

    Its red cross is not clicked: in 6.1.1 the event filter of pqProgressManager takes every click
    on the window away while something runs, that on the cross too.
    """
    if way == "abort" and version() < (6, 1):
        pytest.skip("ParaView has abort from 6.1 on")
    known = f"ABORT, BEGUN = {way == 'abort'}, {str(tmp_path / 'begun')!r}\n"
    (tmp_path / "run.py").write_text(known + LONG_RUN)
    done = []

    def end_it():
        if way == "stop" and not done and (tmp_path / "begun").exists():
            time.sleep(1.0)  # the run has to begin
            screen = environment(DISPLAY=display, XDG_RUNTIME_DIR=str(tmp_path))
            done.append(subprocess.run([*LAUNCHER, "stop"], env=screen, check=True))

    script = [f"--script={tmp_path / 'run.py'}"]
    alive, text = application(tmp_path, display, script, "ended", meanwhile=end_it)
    assert alive and (done or way == "abort"), text
    assert "\n0 cells" in text and "\n512 cells; ended" in text, text
    assert "Traceback" not in text, text


@pytest.mark.slow
def test_pictures_for_the_manual(tmp_path, display, pvpython):
    """The manual's pictures. ELASTOIDENTIFY_PICTURES: where to put them, 1 is docs/pictures."""
    wanted = os.environ.get("ELASTOIDENTIFY_PICTURES") or tmp_path
    folder = PICTURES if wanted == "1" else Path(wanted)
    folder.mkdir(parents=True, exist_ok=True)
    size = ["-geometry", "1400x880"]
    steps = [
        *menu("menuSources", "PushingPhantom"),
        apply(),
        *menu("menuFilters", "LameIdentification"),
        apply(),
        *(without_messages() if folder != tmp_path else []),
        event(
            f"{WINDOW}/representationToolbar/displayRepresentation/comboBox",
            "set_string",
            "Surface With Edges",
        ),
    ]
    window = tmp_path / "paraview-lame-identification.png"
    good, text = play(tmp_path, display, steps, window, size)
    assert good, text
    assert colours(window) > 100
    if folder != tmp_path:  # the manual's copy is small
        reduce = [program("convert"), str(window), "+dither", "-colors", "256"]
        subprocess.run([*reduce, str(folder / window.name)], check=True)

    sample = folder / "paraview-sample.png"
    script = PACKAGES / "elastoidentify" / "paraview" / "sample.py"
    done = pvpython(script, sample, DISPLAY=display)
    assert done.returncode == 0, done.stdout
    assert colours(sample) > 100


def colours(picture):
    """How many colours a picture has: a blank window has few."""
    command = [program("identify"), "-format", "%k", str(picture)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
