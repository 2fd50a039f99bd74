"""A client of a pvserver: a failure on the server raises here, and the next update works."""

import sys

from paraview.simple import *  # noqa: F403

Connect("localhost", int(sys.argv[1]))  # noqa: F405
phantom = PushingPhantom(Resolution=4)  # noqa: F405
stiffness = LameIdentification(Input=phantom, KnownMaterials=[7, 5000, 0.43])  # noqa: F405
try:
    stiffness.UpdatePipeline()
except RuntimeError as error:
    assert "LameIdentification: known label 7" in str(error)
else:
    raise SystemExit("not raised")
stiffness.KnownMaterials = [1, 5000, 0.43]
stiffness.UpdatePipeline()
assert stiffness.CellData["Mu"].GetRange()[1] > 1700
print("done")
