"""A script for ParaView

For pvpython and pvbatch: a phantom, its stiffness, a picture. The same names are in the application's
menus, and in its trace.
"""

from paraview import servermanager
from paraview.simple import *

phantom = PushingPhantom(Resolution=16, InclusionCenter=[0.5, 0.3, 0.5], Noise=2e-5)  # m
stiffness = LameIdentification(Input=phantom, KnownMaterials=[1, 5000.0, 0.43])
stiffness.UpdatePipeline()

cells = servermanager.Fetch(stiffness).GetCellData()
values, labels = cells.GetArray("Mu"), cells.GetArray("Label")
for label, truth in ((2, 1049), (3, 3147)):
    found = [values.GetValue(i) for i in range(len(cells.GetArray("Mu"))) if labels.GetValue(i) == label]
    print(f"label {label}: mean μ {sum(found) / len(found):.0f} Pa, truth {truth}")

view = CreateRenderView(ViewSize=[700, 450])
display = Show(stiffness, view)
ColorBy(display, ("CELLS", "Mu"))
display.SetScalarBarVisibility(view, True)
ResetCamera(view)
SaveScreenshot("paraview_script.png", view)
