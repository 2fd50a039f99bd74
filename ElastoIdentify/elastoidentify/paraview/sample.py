"""The sample in ParaView: λ, μ and the uncertainty of μ side by side, without any file.

In the application: ``elastoidentify paraview sample``. In pvpython and pvbatch, with the name of a
picture to write: ``elastoidentify paraview pvpython sample.py sample.png``.
"""

import sys

from paraview.simple import (
    AssignViewToLayout,
    ColorBy,
    CreateLayout,
    CreateRenderView,
    GetColorTransferFunction,
    GetScalarBar,
    LameIdentification,
    PushingPhantom,
    SaveScreenshot,
    SetActiveSource,
    Show,
)

SHOWN = {
    "Lambda": "Lambda (Pa)",
    "Mu": "Mu (Pa)",
    "MuStd": "Std. deviation of Mu (Pa)",
}

phantom = PushingPhantom(
    registrationName="Pushed phantom",
    Resolution=16,
    Pattern="alternating",
    InclusionCenter=[0.5, 0.3, 0.5],
    PadFraction=0.375,
    Noise=2e-5,  # m, 0.2 % of the push
)
stiffness = LameIdentification(
    registrationName="Stiffness", Input=phantom, KnownMaterials=[1, 5000, 0.43]
)

layout = CreateLayout("Stiffness")
layout.SplitHorizontal(0, 1 / 3)
layout.SplitHorizontal(2, 1 / 2)
for (array, title), cell in zip(SHOWN.items(), (1, 5, 6), strict=True):
    view = CreateRenderView()
    AssignViewToLayout(view=view, layout=layout, hint=cell)
    view.OrientationAxesVisibility = 0
    view.InteractionMode = "2D"
    display = Show(stiffness, view)
    display.Representation = "Surface With Edges"
    display.EdgeColor = [0.3, 0.3, 0.3]
    ColorBy(display, ("CELLS", array))
    display.RescaleTransferFunctionToDataRange(False, True)
    display.SetScalarBarVisibility(view, True)
    bar = GetScalarBar(GetColorTransferFunction(array), view)
    bar.Title, bar.ComponentTitle = title, ""
    bar.Orientation, bar.WindowLocation, bar.Position = "Horizontal", "Any Location", [0.2, 0.04]
    bar.ScalarBarLength, bar.TitleFontSize, bar.LabelFontSize = 0.6, 13, 12
    bar.RangeLabelFormat = bar.LabelFormat = "%.3g"
    view.CameraPosition, view.CameraFocalPoint = [0.1, 0.07, 1.0], [0.1, 0.07, 0.0]
    view.CameraParallelProjection, view.CameraParallelScale = 1, 0.14  # leaves room for the bar
SetActiveSource(stiffness)

if len(sys.argv) > 1 and sys.argv[1].endswith(".png"):
    SaveScreenshot(sys.argv[1], layout, ImageResolution=[1500, 620])
