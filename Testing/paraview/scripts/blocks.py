"""Four blocks with a case each → stiffness → files. Run it serial and on two ranks."""

import sys

from paraview.simple import *  # noqa: F403

known = [float(word) for word in sys.argv[2].split(",")]
number = globals().get("ProcessIdScalars") or ProcessIds  # noqa: F405  the name from 6.0 on
for output in sys.argv[3:]:
    cases = OpenDataFile(sys.argv[1])  # noqa: F405
    if output.endswith(".vtpc"):
        cases = ConvertToPartitionedDataSetCollection(Input=cases)  # noqa: F405
    stiffness = LameIdentification(Input=cases, KnownMaterials=known, Method="global")  # noqa: F405
    SaveData(output, stiffness)  # noqa: F405
    ranked = number(Input=stiffness)
    ranked.UpdatePipeline()
    (array,) = {"ProcessId", "PointProcessIds"} & {*ranked.PointData.keys()}
    ranks = ranked.PointData[array].GetRange()
    print("ranks that did a block: {:.0f} to {:.0f}".format(*ranks))
print("done")
