"""What ParaView itself would run over: a misspelt choice, a wrong input, a warning not seen."""

import sys
import warnings

from paraview.simple import *  # noqa: F403

how = sys.argv[1]
phantom = PushingPhantom(Resolution=4)  # noqa: F405
if how == "choice":
    SaveData(sys.argv[2], LameIdentification(Input=phantom, Kinematics="neohookean"))  # noqa: F405
elif how == "row":
    rows = [1, -5000, 0.43, 2, 5000, 0.43]
    SaveData(sys.argv[2], LameIdentification(Input=phantom, KnownMaterials=rows))  # noqa: F405
elif how == "input":
    SaveData(sys.argv[2], LameIdentification(Input=Wavelet()))  # noqa: F405
elif how == "mended":
    found = LameIdentification(Input=phantom, Method="nonsense")  # noqa: F405
    try:
        found.UpdatePipeline()
    except ValueError as error:
        assert "method must be" in str(error), error
    else:
        raise SystemExit("not raised")
    found.Method = "global"
    found.UpdatePipeline()
    assert found.CellData["Mu"].GetRange()[1] > 1700
elif how == "surface":
    surface = ExtractSurface(Input=phantom)  # noqa: F405
    found = LameIdentification(Input=surface, Method="global")  # noqa: F405
    found.UpdatePipeline()
    assert found.CellData["Mu"].GetRange()[1] > 1700
elif how == "warning":
    phantom.Pushes = [0, -0.03, 0, 0.03, -0.03, 0]
    found = LameIdentification(Input=phantom, Method="global")  # noqa: F405
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        found.UpdatePipeline()
    assert sum("neo-hookean" in str(one.message) for one in seen) == 1, seen
    fields = servermanager.Fetch(found).GetFieldData()  # noqa: F405
    told = fields.GetAbstractArray("Warnings")
    assert told.GetNumberOfValues() == len(seen)
print("done")
