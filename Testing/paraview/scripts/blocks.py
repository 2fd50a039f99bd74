"""Four blocks with a case each → stiffness → a file. Run it serial and on two ranks."""

import sys

from paraview.simple import *  # noqa: F403

case_file, output = sys.argv[1:3]
known = [float(word) for word in sys.argv[3].split(",")]
cases = OpenDataFile(case_file)  # noqa: F405
if output.endswith(".vtpc"):
    cases = ConvertToPartitionedDataSetCollection(Input=cases)  # noqa: F405
stiffness = LameIdentification(Input=cases, KnownMaterials=known, Method="global")  # noqa: F405
SaveData(output, stiffness)  # noqa: F405
number = globals().get("ProcessIdScalars") or ProcessIds  # noqa: F405  the name from 6.0 on
ranked = number(Input=stiffness)
ranked.UpdatePipeline()
(array,) = {"ProcessId", "PointProcessIds"} & {*ranked.PointData.keys()}
print("ranks that did a block: {:.0f} to {:.0f}".format(*ranked.PointData[array].GetRange()))
print("done")
