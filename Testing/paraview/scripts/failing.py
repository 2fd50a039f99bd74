"""A filter that fails ends the script in the way given; "catch" catches and goes on."""

import sys

from paraview.simple import *  # noqa: F403

how = sys.argv[1]
phantom = PushingPhantom(Resolution=4)  # noqa: F405
bad = LameIdentification(Input=phantom, KnownMaterials=[7, 5000, 0.43])  # noqa: F405
after = Threshold(Input=bad)  # noqa: F405
if how == "update":
    after.UpdatePipeline()
elif how == "update function":
    UpdatePipeline(proxy=after)  # noqa: F405
elif how == "information":
    after.PointData.keys()
elif how == "save":
    SaveData(sys.argv[2], after)  # noqa: F405
elif how == "fetch":
    servermanager.Fetch(bad)  # noqa: F405
elif how == "render":
    Show(after)  # noqa: F405
    Render()  # noqa: F405
elif how == "screenshot":
    Show(after)  # noqa: F405
    SaveScreenshot(sys.argv[2])  # noqa: F405
elif how == "catch":
    for _ in range(2):
        try:
            after.UpdatePipeline()
        except ValueError as error:
            assert "label 7" in str(error) and "LameIdentification" in str(error)
        else:
            raise SystemExit("not raised")
        bad.UpdatePropertyInformation()
        assert "label 7" in bad.LastError, bad.LastError
    bad.KnownMaterials = [1, 5000, 0.43]
    after.UpdatePipeline()
    assert bad.CellData["Mu"].GetRange()[1] > 1700
    bad.UpdatePropertyInformation()
    assert bad.LastError == ""
print("done")
