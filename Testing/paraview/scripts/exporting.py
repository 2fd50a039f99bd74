"""Maps as NIfTI, DICOM and page by Save Data."""

import sys

from paraview.simple import *  # noqa: F403

folder = sys.argv[1]
phantom = PushingPhantom(Size=20.0)  # noqa: F405
stiffness = LameIdentification(Input=phantom)  # noqa: F405
rest = f"{folder}/rest.nrrd"
SaveData(f"{folder}/case.nii.gz", stiffness, RestImage=rest)  # noqa: F405
SaveData(f"{folder}/case.dcm", stiffness, RestImage=rest, PatientId="P7", Quantity="young")  # noqa: F405
SaveData(f"{folder}/case.html", stiffness)  # noqa: F405
try:
    SaveData(f"{folder}/never.nii.gz", stiffness)  # noqa: F405
except Exception as error:
    assert "say which file it is" in str(error), error
else:
    raise AssertionError("maps were written without a grid")
print("done")
