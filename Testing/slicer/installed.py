"""Use the module as it was installed: python installed.py FOLDER, with stand-ins around it.

FOLDER holds ElastoIdentify.py. Prints what was imported from elsewhere and fails, or runs the
module's own tests, and says so.
"""

import os
import sys
from pathlib import Path


def main(folder: Path) -> None:
    """Load the module from `folder`, open its panel, run its tests."""
    here = Path(__file__).resolve().parent
    sys.path = [entry for entry in sys.path if Path(entry).resolve() != here]
    import slicer  # before this folder is on the path: slicer-core takes its parts by name

    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    sys.path[:0] = [str(here), str(folder)]
    from standins import application, modules, widgets

    application.start()
    widgets.install()
    modules.install(str(folder / "ElastoIdentify.py"))
    import elastoidentify
    import ElastoIdentifyLib

    import ElastoIdentify

    for package in (ElastoIdentify, ElastoIdentifyLib, elastoidentify):
        if folder not in Path(package.__file__).resolve().parents:
            sys.exit(f"{package.__name__} was imported from {package.__file__}")
    panel = ElastoIdentify.ElastoIdentifyWidget(widgets.ModulePanel())
    panel.setup()
    ElastoIdentify.ElastoIdentifyTest().runTest()
    panel.cleanup()
    slicer.mrmlScene.Clear(0)
    print("the installed module passed its tests")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
