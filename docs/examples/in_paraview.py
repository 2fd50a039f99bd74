"""In ParaView, by a script

The filters of the menus in a script, between ParaView's own: a block is pushed, identified, cut to
what is stiff, measured, and drawn in its pushed shape. `elastoidentify paraview pvpython
in_paraview.py` runs it; where there is no display, with `xvfb-run -a` in front.

One thing in the map is not so. A cell in either bottom corner, of which one node only is free,
comes out stiff; its standard deviation says how little that means.
"""

from paraview.simple import (
    ColorBy,
    CreateRenderView,
    IntegrateVariables,
    LameIdentification,
    PushingPhantom,
    SaveScreenshot,
    Show,
    Threshold,
    WarpByVector,
    servermanager,
)

law = {"Kinematics": "neo-hookean"}  # the push is larger than 2 % of strain
block = PushingPhantom(Resolution=14, Pattern="alternating", Noise=2e-5, **law)  # m
stiffness = LameIdentification(Input=block, Method="regularized", **law)

table = servermanager.Fetch(stiffness, idx=1).GetRowData()
for row in range(table.GetArray("label").GetNumberOfTuples()):
    label, mu, error = (
        table.GetArray(name).GetValue(row) for name in ("label", "Mu mean", "Mu standard error")
    )
    print(f"label {label:.0f}: μ {mu:.0f} ± {error:.0f} Pa")

cells = servermanager.Fetch(stiffness).GetCellData()
for name, cell in (("left corner", 0), ("right corner", 26), ("below the inclusion", 40)):
    mu, error = (cells.GetArray(name).GetValue(cell) for name in ("Mu", "MuStd"))
    print(f"cell {cell}, {name}: μ {mu:.0f} ± {error:.0f} Pa, truth 1748")

stiff = Threshold(Input=stiffness, Scalars=["CELLS", "Mu"], LowerThreshold=3500, UpperThreshold=1e9)
area = servermanager.Fetch(IntegrateVariables(Input=stiff)).GetCellData().GetArray("Area")
print(f"stiffer than 3500 Pa: {1e4 * area.GetValue(0):.1f} cm²; the inclusion has 28.3 cm²")

view = CreateRenderView(ViewSize=[900, 620], OrientationAxesVisibility=0, InteractionMode="2D")
shown = Show(WarpByVector(Input=stiffness, Vectors=["POINTS", "Displacement_2"]), view)
shown.Representation = "Surface With Edges"
ColorBy(shown, ("CELLS", "Mu"))
shown.SetScalarBarVisibility(view, True)
view.ResetCamera()
SaveScreenshot("in_paraview.png", view)
