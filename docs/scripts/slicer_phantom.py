"""From the sample phantom to the stiffness map, in Slicer without its window.

    Slicer --no-main-window --python-script docs/scripts/slicer_phantom.py OUTPUT_FOLDER

Installs itk-elastix if it is not there. Writes the scene (map.mrb) and the table (segments.tsv) to
the folder.
"""

import sys
from pathlib import Path

import slicer

import ElastoIdentify

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()
folder.mkdir(parents=True, exist_ok=True)
try:
    rest, *pushed, segmentation = ElastoIdentify.loadSample()
    logic = ElastoIdentify.ElastoIdentifyLogic()
    logic.ensurePackages(ask=False)
    result = logic.process(
        restVolume=rest,
        pushedVolumes=pushed,
        segmentation=segmentation,  # its segments say which is the pad, and how stiff
        edgeLength=7.0,  # mm, about twelve voxels
        progress=lambda fraction, text: print(f"{100 * fraction:3.0f} % {text}"),
    )
    print(logic.report(result))
    slicer.util.saveNode(result.table, str(folder / "segments.tsv"))
    slicer.util.saveScene(str(folder / "map.mrb"))
except Exception as problem:
    print(problem, file=sys.stderr)
    slicer.util.exit(1)  # takes effect later: the last call counts
else:
    slicer.util.exit(0)
