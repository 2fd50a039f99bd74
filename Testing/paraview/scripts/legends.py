"""Colours and legend of a map: range, unit, the first map after a failure, the user's own range."""

import numpy as np
from paraview.simple import *  # noqa: F403


def colours(array="Mu"):
    points = GetColorTransferFunction(array).RGBPoints  # noqa: F405
    return points[0], points[-4]


phantom = PushingPhantom(Resolution=12, Noise=1e-6)  # noqa: F405
stiffness = LameIdentification(  # noqa: F405
    Input=phantom, KnownMaterials=[9, 5000, 0.43], Unit="kPa", Method="sequential"
)
view = CreateRenderView()  # noqa: F405
try:
    shown = Show(stiffness, view)  # noqa: F405
except Exception as error:
    assert "known label 9" in str(error)
    shown = GetDisplayProperties(stiffness, view)  # noqa: F405
assert not shown.ColorArrayName[1]

stiffness.KnownMaterials = [1, 5000, 0.43]
Render(view)  # noqa: F405
assert shown.ColorArrayName[1] == "Mu"
legend = GetScalarBar(GetColorTransferFunction("Mu"), view)  # noqa: F405
assert legend.Visibility and legend.Title == "μ (kPa)", legend.Title

values = np.sort(servermanager.Fetch(stiffness).GetCellData().GetArray("Mu"))  # noqa: F405
values = values[np.isfinite(values)]
assert values[-1] - values[0] > 3 * (values[-4] - values[3]), "the example has no wild cell"
low, high = colours()
assert high - low < (values[-1] - values[0]) / 2, (low, high, values[[0, -1]])
inside = ((values >= low) & (values <= high)).mean()
assert inside >= 0.97, inside

GetColorTransferFunction("Mu").RescaleTransferFunction(1000.0, 2000.0)  # noqa: F405
stiffness.Unit, stiffness.Method = "Pa", "global"
Render(view)  # noqa: F405
assert colours() == (1000.0, 2000.0)  # what the user has chosen stays
assert legend.Title == "μ (Pa)"
legend.Title = "stiffness"
stiffness.Unit = "kPa"
Render(view)  # noqa: F405
assert legend.Title == "stiffness"
ColorBy(shown, ("CELLS", "PoissonRatio"))  # noqa: F405
shown.SetScalarBarVisibility(view, True)
assert -1 < colours("PoissonRatio")[0] <= colours("PoissonRatio")[1] < 0.5

stiffness.UpdatePropertyInformation()
report = stiffness.SMProxy.GetProperty("Report").GetElement(0)
assert "label 1: known\nlabel 2: μ" in report, report

# a map under another assumption: the range and the colours of μ's, and its unit
small = PushingPhantom(Resolution=6, Noise=1e-6)  # noqa: F405
tried = LameIdentification(  # noqa: F405
    Input=small, Method="regularized", Grouping="label", Explore=1, Unit="kPa"
)
shown = Show(tried, view)  # noqa: F405
colour = GetColorTransferFunction("MuIfPlaneStress")  # noqa: F405
assert len(colour.RGBPoints) > 400, len(colour.RGBPoints)  # not the default's few
cells = servermanager.Fetch(tried).GetCellData()  # noqa: F405
mu, other = (np.array(cells.GetArray(name)) for name in ("Mu", "MuIfPlaneStress"))
low, high = colours("MuIfPlaneStress")
assert 0.999 * np.nanmin(mu) <= low < high <= 1.001 * np.nanmax(mu), (low, high)
assert high > 2 * np.nanmax(other)
ColorBy(shown, ("CELLS", "MuIfPlaneStress"))  # noqa: F405
shown.SetScalarBarVisibility(view, True)
Render(view)  # noqa: F405
legend = GetScalarBar(colour, view)  # noqa: F405
assert legend.Title == "μ if plane stress (kPa)", legend.Title

Delete(tried)  # noqa: F405
Delete(stiffness)  # noqa: F405
Render(view)  # noqa: F405
print("done")
