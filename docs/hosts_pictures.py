"""Run the programs of hosts.md as they stand, and keep its pictures.

    python docs/hosts_pictures.py command-line | paraview | slicer | paraview-volume

Each with the Python of that host's tests; ParaView's needs Xvfb and ImageMagick. Each prints what
the page shows. The last one's program is that of volumes.md, its picture paraview-volume.png.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

DOCS = Path(__file__).resolve().parent
TESTING = DOCS.parent / "Testing"
sys.path[:0] = [str(TESTING), str(TESTING / "paraview"), str(TESTING / "slicer")]

from hosts_page import block  # noqa: E402
from paraview_host import virtual_display  # noqa: E402

sys.path.remove(str(TESTING))  # `import slicer` would take its folder for a part of it

COMMAND = [sys.executable, "-m"]
SHOW = """
view = GetActiveViewOrCreate("RenderView")
shown = Show(stiffness, view)
shown.Representation = "Surface With Edges"
shown.SetScalarBarVisibility(view, True)
SetActiveSource(stiffness)
view.InteractionMode, view.CameraParallelProjection = "2D", 1
view.ResetCamera()
Render()
"""
BALL = """
view = GetActiveViewOrCreate("RenderView")
for part, edges in ((half, "Surface"), (stiff, "Surface With Edges")):
    shown = Show(part, view)
    shown.Representation = edges
    ColorBy(shown, ("CELLS", "YoungModulus"))
colours = GetColorTransferFunction("YoungModulus")
colours.RescaleTransferFunction(0.0, 12000.0)
shown.SetScalarBarVisibility(view, True)
frame = Show(stiffness, view)
frame.Representation = "Outline"
SetActiveSource(stiffness)
view.CameraViewUp, view.CameraPosition = [0, 0, 1], [110, -190, 110]
view.CameraFocalPoint = [40, 40, 38]
view.ResetCamera()
Render()
"""


def command(heading: str) -> None:
    """Run the command under a heading."""
    words = shlex.split(block(heading, "sh").replace("\\\n", " "))
    subprocess.run([*COMMAND, *words], check=True, env=os.environ | {"MPLBACKEND": "Agg"})


def command_line(picture: Path) -> None:
    """Keep the picture that the command draws; the program in Python draws the same."""
    from PIL import Image

    command("Command line")
    shutil.copy("map.png", picture)
    exec(block("Python", "python"), {})
    pixels = [np.asarray(Image.open(file)) for file in ("map.png", picture)]
    assert (pixels[0] == pixels[1]).all()


def paraview(picture: Path) -> None:
    """Keep ParaView's window after the script."""
    window(block("ParaView", "python") + SHOW, picture)


def paraview_volume(picture: Path) -> None:
    """Keep ParaView's window after the script of volumes.md; registrations are made before."""
    from paraview_host import run

    page = (DOCS / "volumes.md").read_text(encoding="utf-8")
    words = re.search(r"`(elastoidentify phantom --3d --hidden[^`]*)`", page).group(1)
    subprocess.run([*COMMAND, *words.split()], check=True)
    script = block("In ParaView", "python", page, ElastixNodalDisplacement="Cache='cache'")
    Path("ball.py").write_text(script, encoding="utf-8")  # which updates all
    done = run("pvpython", "ball.py", timeout=1800)
    assert done.returncode == 0, done.stdout
    window(script + BALL, picture)


def window(script: str, picture: Path) -> None:
    """Keep ParaView's window after a script."""
    from test_gui import WINDOW, event, play

    Path("study.py").write_text(script, encoding="utf-8")
    menu = f"{WINDOW}/menubar/menu_View"  # messages open in a window of their own
    steps = [event(menu, "activate", "Output Messages")]
    with virtual_display() as display:
        good, text = play(
            Path.cwd(), display, steps, Path("w.png"), ["--script=study.py"], seconds=1800
        )
    assert good, text
    print(text)  # the script's lines
    reduce = ["convert", "w.png", "+dither", "-colors", "64", str(picture)]
    subprocess.run(reduce, check=True)


def slicer(picture: Path) -> None:
    """Keep the slice view, drawn by Slicer's own displayable managers, after the script."""
    from standins import application, modules, views, widgets

    application.start()
    sys.path.insert(0, str(DOCS.parent / "ElastoIdentify"))
    widgets.install()
    modules.install(str(DOCS.parent / "ElastoIdentify" / "ElastoIdentify.py"))
    import slicer

    rest = slicer.util.loadVolume("phantom/rest.nrrd")
    with views.slice_view(rest, np.diag([-1.0, 1.0, -1.0]), (920, 660)) as view:
        exec(block("3D Slicer", "python"), {})
        view.save(picture)
    slicer.mrmlScene.Clear(0)


if __name__ == "__main__":
    host = sys.argv[1].replace("-", "_")
    name = sys.argv[1] if host == "paraview_volume" else f"hosts-{sys.argv[1]}"
    target = DOCS / "pictures" / f"{name}.png"
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        if host == "paraview_volume":
            paraview_volume(target)
        else:
            command("The files")
            {"command_line": command_line, "paraview": paraview, "slicer": slicer}[host](target)
        os.chdir(DOCS)
