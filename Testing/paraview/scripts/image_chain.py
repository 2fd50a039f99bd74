"""Images → mesh → displacement → stiffness by proxies alone; every array against the pipeline's."""

import sys

import numpy as np
from elastoidentify.pipeline import run
from elastoidentify.results import QUANTITIES
from elastoidentify.study import Study
from elastoidentify.vtk_io import convert
from paraview.simple import *  # noqa: F403

folder, pad, young, poisson = sys.argv[1], int(sys.argv[2]), *map(float, sys.argv[3:5])
rigid, cache = sys.argv[5].split(","), sys.argv[6]


def image(proxy):
    return convert.image_from_vtk(servermanager.Fetch(proxy))  # noqa: F405


segmentation = ElastoIdentifyImage(FileNames=[f"{folder}/segmentation.nrrd"], Kind="segmentation")  # noqa: F405
rest = OpenDataFile(f"{folder}/rest.nrrd")  # noqa: F405
pushed = OpenDataFile([f"{folder}/pushed{n}.nrrd" for n in (1, 2)])  # noqa: F405  a push per step
mesh = SegmentationToTriangleMesh(Input=segmentation, EdgeLength=15.0, RigidLabels=rigid)  # noqa: F405
displacement = ElastixNodalDisplacement(  # noqa: F405
    Mesh=mesh, RestImage=rest, PushedImages=[pushed], Cache=cache
)
stiffness = LameIdentification(  # noqa: F405
    Input=displacement,
    KnownMaterials=[pad, young, poisson],
    Method="regularized",
    Unknowns="young",
    PoissonRatio=poisson,
    Grouping="label",
)
SaveData(f"{folder}/stiffness.vtu", stiffness)  # noqa: F405
found = servermanager.Fetch(stiffness)  # noqa: F405

# ---- the same by the pipeline, on the same stored registrations
pushes = []
for step in (0.0, 1.0):
    pushed.UpdatePipeline(step)
    pushes.append(image(pushed))
study = Study(
    segmentation=image(segmentation),
    rest=image(rest),
    pushed=pushes,
    cache=cache,
    edge_length=15.0,
    rigid_labels=[int(word) for word in rigid],
    known_materials={pad: (young, poisson)},
    method="regularized",
    unknowns="young",
    poisson_ratio=poisson,
    grouping="label",
)
outcome = run(study)
np.testing.assert_array_equal(convert.mesh_points(found), outcome.mesh.points)
np.testing.assert_array_equal(convert.simplices(found), outcome.mesh.cells)
measured = outcome.registration
for name, values in (
    ("Displacement", measured.displacements),
    ("DisplacementInformation", measured.information),
    ("Disagreement", measured.disagreement),
):
    for number, expected in enumerate(values, 1):
        stored = convert.get_array(found.GetPointData(), f"{name}_{number}")
        np.testing.assert_array_equal(stored, expected, err_msg=name)
for name, quantity in QUANTITIES.items():
    values = convert.get_array(found.GetCellData(), name)
    np.testing.assert_array_equal(values, getattr(outcome.result, quantity.field), err_msg=name)

# ---- elastix itself answers here: a rough map tells which way the tissue went
rough = ElastixNodalDisplacement(  # noqa: F405
    Mesh=mesh,
    RestImage=rest,
    PushedImages=[pushed],
    TimeStepsAsTrials=0,
    ParameterFile="affine",
    Backward=0,
    Correlation=0,
)
moved = convert.get_array(servermanager.Fetch(rough).GetPointData(), "Displacement_1")  # noqa: F405
assert (moved * outcome.displacements[0]).sum() > 0
print("done")
