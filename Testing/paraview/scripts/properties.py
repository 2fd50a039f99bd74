"""All properties of all proxies: set, saved to a state file, loaded in another process."""

import sys
from pathlib import Path

from elastoidentify.options import Picture
from elastoidentify.study import (
    IdentificationOptions,
    MeshOptions,
    RegistrationOptions,
    ReportOptions,
)
from paraview import smstate
from paraview.simple import *  # noqa: F403

what, path = sys.argv[1:3]
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from option_samples import sample  # noqa: E402


def settings(table, **more):
    """A value of every option of a table, flat as a proxy has it, and of the filter's own."""
    values = {o.title: flat(sample(o)) for o in table.options().values() if not is_picture(o)}
    return {**values, **more}


def is_picture(option):
    return isinstance(option, Picture)


def flat(value):
    """Rows are one list of numbers."""
    if not isinstance(value, tuple):
        return int(value) if isinstance(value, bool) else value
    rows = [row if isinstance(row, tuple) else (row,) for row in value]
    return [float(number) for row in rows for number in row]


SETTINGS = {
    "PushingPhantom": dict(
        Shape="quads",
        Pattern="crossed",
        Resolution=5,
        Size=0.3,
        PadFraction=0.4,
        YoungModulus=4000.0,
        PoissonRatio=0.4,
        InclusionContrast=2.0,
        InclusionCenter=[0.4, 0.3, 0.2],
        InclusionRadius=0.2,
        Pushes=[0.0, -0.01, 0.0, 0.01, -0.01, 0.0, 0.01, 0.0, 0.0],
        Kinematics="neo-hookean",
        Noise=1e-6,
        Seed=7,
    ),
    "SegmentationToTriangleMesh": settings(
        MeshOptions,
        LabelArray="Labels",
        BoxInView="sliding",
        BoxCorner=[1.0, 2.0, 3.0],
        BoxSize=[4.0, 5.0, 6.0],
        RigidLabels=["4"],
        ReactionBoxes=[0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
    ),
    "ElastixNodalDisplacement": settings(RegistrationOptions, TimeStepsAsTrials=0),
    "LameIdentification": settings(
        IdentificationOptions,
        **settings(ReportOptions),
        Displacements=["Displacement_2", "Displacement_3"],
        TimeStepsAsTrials=1,
    ),
}
NOT_SETTINGS = {
    "Input",
    "Mesh",
    "RestImage",
    "PushedImages",
    "Mask",
    "LastError",
    "Report",
    "ShownRanges",
}


def check(name, proxy):
    names = {n for n in proxy.ListProperties() if not n.endswith("Info")} - NOT_SETTINGS
    assert names == set(SETTINGS[name]), names ^ set(SETTINGS[name])
    for key, value in SETTINGS[name].items():
        got = getattr(proxy, key)
        got = list(got) if isinstance(value, list) else got
        assert got == value, (name, key, got, value)


def build():
    phantom = PushingPhantom(registrationName="Phantom", **SETTINGS["PushingPhantom"])  # noqa: F405
    image = Wavelet(registrationName="Image")  # noqa: F405
    SegmentationToTriangleMesh(  # noqa: F405
        registrationName="Mesh", Input=image, **SETTINGS["SegmentationToTriangleMesh"]
    )
    ElastixNodalDisplacement(  # noqa: F405
        registrationName="Displacement",
        Mesh=phantom,
        RestImage=image,
        PushedImages=[image, Wavelet(registrationName="Pushed")],  # noqa: F405
        **SETTINGS["ElastixNodalDisplacement"],
    )
    LameIdentification(  # noqa: F405
        registrationName="Stiffness", Input=phantom, **SETTINGS["LameIdentification"]
    )


NAMES = {
    "Phantom": "PushingPhantom",
    "Mesh": "SegmentationToTriangleMesh",
    "Displacement": "ElastixNodalDisplacement",
    "Stiffness": "LameIdentification",
}
if what == "save":
    build()
    if path.endswith(".py"):
        with open(path, "w") as file:
            file.write(smstate.get_state())
    else:
        SaveState(path)  # noqa: F405
else:
    if path.endswith(".py"):
        exec(Path(path).read_text())
    else:
        LoadState(path)  # noqa: F405
for registered, name in NAMES.items():
    check(name, FindSource(registered))  # noqa: F405
stiffness = FindSource("Stiffness")  # noqa: F405
stiffness.Plane = "strain"  # with a finite-strain law, plane stress is refused
stiffness.Method = "global"
stiffness.KnownMaterials = [1, 4000, 0.4]  # there is no label 7,
stiffness.ReferenceLabel = 0  # nor 4
stiffness.Slip, stiffness.OutOfPlane = [], []
stiffness.PoissonStd = stiffness.OutOfPlaneStd = 0.0  # for which global has no estimate,
stiffness.Explore = 0  # and no weights
stiffness.UpdatePipeline()
assert "Residual_2" in stiffness.PointData
assert "Residual_3" not in stiffness.PointData
registration = FindSource("Displacement")  # noqa: F405
assert len(registration.PushedImages) == 2
assert registration.RestImage == FindSource("Image")  # noqa: F405
print("done")
