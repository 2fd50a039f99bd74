"""The pictures of docs/slicer.md: the panel and the two views, with a result.

python -m standins.pictures FOLDER      # in Testing/slicer, takes some minutes
"""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import slicer

from .views import slice_view, space_view
from .widgets import ModulePanel

SIZE = (920, 660)


def make_pictures(folder: Path, small: bool = False) -> list[Path]:
    """Draw the pictures; `small`: of the exact push, which needs no registration."""
    import qt
    from ElastoIdentifyLib import images, sample
    from PySide6 import QtWidgets

    from ElastoIdentify import ElastoIdentifyLogic, ElastoIdentifyWidget

    folder.mkdir(parents=True, exist_ok=True)
    if small:
        inputs, _ = sample.add_exact_push()
    else:
        rest, *pushed, segmentation = sample.add_phantom()
        inputs = {"restVolume": rest, "pushedVolumes": pushed, "segmentation": segmentation}
        inputs["edgeLength"] = 7.0
    rest = inputs["restVolume"]
    widget = ElastoIdentifyWidget(ModulePanel())
    widget.setup()
    parameters = widget._parameterNode
    parameters.edgeLength = inputs["edgeLength"]
    for node in inputs.get("pushedVolumes", ()):
        widget.ui.pushedSelector.setCheckState(node, qt.Qt.Checked)

    axes = images.ijk_to_world(rest)[:3, :3]
    axes = axes / np.linalg.norm(axes, axis=0)
    right_up_out = np.column_stack([axes[:, 0], -axes[:, 1], axes[:, 2]])
    if np.linalg.det(right_up_out) < 0:
        right_up_out[:, 2] *= -1
    made = []
    with ExitStack() as stack:
        flat = stack.enter_context(slice_view(rest, right_up_out, SIZE))
        space = stack.enter_context(space_view(SIZE))
        if not small:
            made.append(folder / "slicer-rest.png")
            flat.save(made[-1])
        result = ElastoIdentifyLogic().process(progress=_tell, **inputs)
        parameters.resultModel = result.model
        widget.ui.statusLabel.text = ElastoIdentifyLogic.report(result)
        space.look(right_up_out @ [0.2, -0.35, 1.0], right_up_out[:, 1])
        for name, view in (("slicer-slice-view", flat), ("slicer-3d-view", space)):
            made.append(folder / f"{name}.png")
            view.save(made[-1])
    QtWidgets.QWidget.resize(widget.parent, 440, 1110)
    QtWidgets.QWidget.show(widget.parent)
    for _ in range(5):
        QtWidgets.QApplication.processEvents()
    made.append(folder / "slicer-panel.png")
    QtWidgets.QWidget.grab(widget.parent).save(str(made[-1]))
    widget.cleanup()
    widget.layout.itemAt(0).widget().setMRMLScene(None)
    table = result.table.GetTable()
    for row in range(table.GetNumberOfRows()):
        cells = {table.GetColumnName(c): table.GetValue(row, c).ToString() for c in range(4)}
        cells["Mu mean"] = table.GetValueByName(row, "Mu mean").ToString()
        print(cells)
    return made


def _tell(fraction, text):
    print(f"\r{100 * fraction:3.0f} % {text:60}", end="")


if __name__ == "__main__":
    import os
    import sys

    here = Path(__file__).resolve().parents[1]
    module = here.parents[1] / "ElastoIdentify" / "ElastoIdentify.py"
    sys.path[:0] = [str(module.parent)]
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    from . import application, modules, widgets

    application.start()
    widgets.install()
    modules.install(str(module))
    for path in make_pictures(Path(sys.argv[1])):
        print(path)
    slicer.mrmlScene.Clear(0)
