"""Phantom → identification by proxies, between ParaView's own filters, against the library."""

import sys

import elastoidentify as ei
import numpy as np
from elastoidentify.results import QUANTITIES
from elastoidentify.vtk_io import convert
from paraview.simple import *  # noqa: F403
from vtkmodules.util.numpy_support import vtk_to_numpy

folder = sys.argv[1]
pad = {1: (5000.0, 0.43)}


def cell(data, name):
    return vtk_to_numpy(data.GetCellData().GetArray(name))


def point(data, name):
    return vtk_to_numpy(data.GetPointData().GetArray(name))


phantom = PushingPhantom(Resolution=6, Shape="triangles", Pattern="crossed")  # noqa: F405
identification = LameIdentification(Input=phantom, Method="global")  # noqa: F405
assert len(identification.KnownMaterials) == 0  # nothing is prefilled, the phantom has its pad
mesh, found = servermanager.Fetch(phantom), servermanager.Fetch(identification)  # noqa: F405

expected = ei.identify(
    convert.mesh_points(mesh),
    convert.mesh_blocks(mesh)[0],
    np.stack([point(mesh, f"Displacement_{k}") for k in (1, 2)]),
    pad,
    labels=cell(mesh, "Label"),
    reaction_nodes=point(mesh, "ReactionNodes").astype(bool),
    method="global",
)
for name, quantity in QUANTITIES.items():
    expected_values = getattr(expected, quantity.field)
    np.testing.assert_array_equal(cell(found, name), expected_values, err_msg=name)
np.testing.assert_allclose(cell(found, "Mu"), cell(mesh, "TrueMu"), rtol=1e-8)

unused = LameIdentification(Input=phantom, Method="global", PoissonStd=0.05)  # noqa: F405
for proxy, said in ((unused, True), (identification, False)):  # the form begins with a ratio
    told = servermanager.Fetch(proxy).GetFieldData().GetAbstractArray("Warnings")  # noqa: F405
    words = "poisson_std says something only with unknowns young"
    assert any(words in line for line in convert.all_texts(told)) is said

# ---- ParaView's filters before: only the named part of the mesh, an array scaled by Calculator
pad_and_tissue = Threshold(Input=phantom)  # noqa: F405
pad_and_tissue.Scalars = ["CELLS", "Label"]
pad_and_tissue.LowerThreshold, pad_and_tissue.UpperThreshold = 1, 2
doubled = Calculator(Input=pad_and_tissue)  # noqa: F405
doubled.ResultArrayName, doubled.Function = "Displacement_1", '2*"Displacement_1"'
after_filters = LameIdentification(Input=doubled, Method="global")  # noqa: F405
part = servermanager.Fetch(after_filters)  # noqa: F405
assert 0 < part.GetNumberOfCells() < mesh.GetNumberOfCells()
assert part.GetPointData().HasArray("Residual_2")

# ---- a Transform, which takes the displacements along or is refused
turned = Transform(Input=phantom, Transform="Transform")  # noqa: F405
turned.Transform.Rotate, turned.Transform.Translate = [20.0, 30.0, 40.0], [1.0, 2.0, 3.0]
behind = LameIdentification(Input=turned, Method="global")  # noqa: F405
there = servermanager.Fetch(behind)  # noqa: F405
np.testing.assert_allclose(cell(there, "Mu"), cell(found, "Mu"), rtol=1e-6)
turned.TransformAllInputVectors = 0
try:
    behind.UpdatePipeline()
except ValueError as error:
    assert "Transform All Input Vectors" in str(error), error
else:
    raise SystemExit("displacements that stayed behind were taken")

# ---- and after
clip = Clip(Input=identification, ClipType="Plane")  # noqa: F405
clip.ClipType.Origin, clip.ClipType.Normal = [0.1, 0.1, 0], [0, 1, 0]
warp = WarpByVector(Input=clip, Vectors=["POINTS", "Displacement_1"])  # noqa: F405
smooth = CellDatatoPointData(Input=warp, ProcessAllArrays=1)  # noqa: F405
UpdatePipeline(proxy=smooth)  # noqa: F405
assert "Mu" in smooth.PointData

# ---- files
group = GroupDatasets(Input=[identification, after_filters])  # noqa: F405
collection = ConvertToPartitionedDataSetCollection(Input=group)  # noqa: F405
for source, name in ((identification, "a.vtu"), (group, "a.vtm"), (collection, "a.vtpc")):
    SaveData(f"{folder}/{name}", source)  # noqa: F405
    again = OpenDataFile(f"{folder}/{name}")  # noqa: F405
    if source is not identification:
        again = MergeBlocks(Input=again, MergePoints=0)  # noqa: F405
    again = servermanager.Fetch(again)  # noqa: F405
    first = found.GetNumberOfCells()  # of two blocks
    np.testing.assert_array_equal(cell(again, "Mu")[:first], cell(found, "Mu"))
    if source is identification:
        report = convert.get_text(again, "IdentificationReport")
        assert report == convert.get_text(found, "IdentificationReport") != ""
print("done")
