"""VTK filters: images to mesh, images to displacements, displacements to stiffness.

Needs VTK 9.2 or later, from the ``vtk`` wheel, ParaView or 3D Slicer. The filters chain with each
other and with VTK's own::

    from elastoidentify.filters import (
        ElastixNodalDisplacement, LameIdentification, SegmentationToTriangleMesh,
    )

    mesh = SegmentationToTriangleMesh(edge_length=12.0)
    mesh.SetInputData(labelmap)
    displacement = ElastixNodalDisplacement()
    displacement.SetMesh(mesh)
    displacement.SetRestImage(rest)
    displacement.AddPushedImage(pushed)
    stiffness = LameIdentification(known_materials={1: (5000.0, 0.43)})
    stiffness.SetInputConnection(displacement.GetOutputPort())
    stiffness.Update()          # raises what went wrong, in whichever filter
    stiffness.GetOutput()       # vtkUnstructuredGrid with Lambda, Mu, Status, …
"""

from .base import Filter
from .identification import LameIdentification
from .meshing import SegmentationToMesh, SegmentationToTriangleMesh
from .phantom import PushingPhantom
from .reading import ImageFile
from .registration import ElastixNodalDisplacement

__all__ = [
    "ElastixNodalDisplacement",
    "Filter",
    "ImageFile",
    "LameIdentification",
    "PushingPhantom",
    "SegmentationToMesh",
    "SegmentationToTriangleMesh",
]
