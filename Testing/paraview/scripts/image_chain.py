"""Images → mesh → displacement → stiffness by proxies alone; every step against the library."""

import sys

import elastoidentify as ei
import numpy as np
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.imaging.registration.registration import register
from elastoidentify.results import to_matrices
from elastoidentify.vtk_io import convert
from paraview.simple import *  # noqa: F403

folder, pad, young, poisson = sys.argv[1], int(sys.argv[2]), *map(float, sys.argv[3:5])
rigid = sys.argv[5].split(",")


def read(name):
    return XMLImageDataReader(FileName=[f"{folder}/{name}.vti"])  # noqa: F405


def image(proxy):
    return convert.image_from_vtk(servermanager.Fetch(proxy))  # noqa: F405


segmentation, rest, pushed = read("segmentation"), read("rest"), [read("pushed1"), read("pushed2")]
mesh = SegmentationToTriangleMesh(Input=segmentation, EdgeLength=15.0, RigidLabels=rigid)  # noqa: F405
displacement = ElastixNodalDisplacement(  # noqa: F405
    Mesh=mesh, RestImage=rest, PushedImages=pushed, Backward=0
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

# ---- the same by the library
meshed = mesh_segmentation(image(segmentation), 15.0, rigid_labels=[int(word) for word in rigid])
points = np.asarray(meshed.points, float)
np.testing.assert_allclose(convert.mesh_points(found), points, rtol=1e-12, atol=1e-12)
np.testing.assert_array_equal(convert.simplices(found), meshed.cells)
registered = register(
    image(rest),
    [image(proxy) for proxy in pushed],
    points,
    meshed.cells,
    reaction_nodes=meshed.reaction_nodes,
    backward=False,
)
for number, expected in enumerate(registered.displacements, 1):
    values = convert.get_array(found.GetPointData(), f"Displacement_{number}")
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
information = np.stack([to_matrices(rows) for rows in registered.information])
identified = ei.identify(
    points,
    [("triangle", meshed.cells)],
    registered.displacements,
    {pad: (young, poisson)},
    labels=meshed.labels,
    reaction_nodes=meshed.reaction_nodes.astype(bool),
    information=information,
    method="regularized",
    unknowns="young",
    poisson_ratio=poisson,
    grouping="label",
)
for name, expected in (("Mu", identified.mu), ("MuStd", identified.mu_std)):
    values = convert.get_array(found.GetCellData(), name)
    np.testing.assert_allclose(values, expected, rtol=1e-12, err_msg=name)
print("done")
