"""Write four cases of different size and stiffness as blocks of one file."""

import sys

from paraview.simple import *  # noqa: F403

phantoms = [
    PushingPhantom(Resolution=4 + i, InclusionContrast=2.0 + i, Noise=1e-8, Seed=i + 1)  # noqa: F405
    for i in range(4)
]
if sys.argv[2:] == ["--spoil-the-last"]:
    phantoms[-1] = Threshold(Input=phantoms[-1], Scalars=["CELLS", "Label"])  # noqa: F405
    phantoms[-1].LowerThreshold, phantoms[-1].UpperThreshold = 2, 3  # without its pad
blocks = GroupDatasets(Input=phantoms)  # noqa: F405
SaveData(sys.argv[1], blocks)  # noqa: F405
print("done")
