"""From volumes, segmentations and transforms to arrays, in Slicer's world: RAS, mm.

Everything is taken to the world at once, parent transforms included, so that nothing after this
border needs to know of them. RAS instead of LPS makes no difference to the library: an image
carries its axes.
"""

from collections.abc import Sequence

import numpy as np
import slicer
import vtk
from elastoidentify.errors import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.provenance import image_hash
from slicer.i18n import tr as _
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy


def image_from_volume(volume) -> Image:
    """Return a scalar volume as an image in the world; the voxels are copied.

    Raises
    ------
    InputError
        No voxels, several values per voxel, or a parent transform that is not linear.
    """
    name = volume.GetName()
    data = volume.GetImageData()
    if data is None or data.GetNumberOfPoints() == 0:
        text = _("the volume {name!r} holds no voxels: load it again, or choose another")
        raise InputError(text.format(name=name))
    if data.GetNumberOfScalarComponents() != 1:
        text = _("the volume {name!r} is in colour: convert it to a scalar volume first")
        raise InputError(text.format(name=name))
    array = slicer.util.arrayFromVolume(volume).copy()
    return _placed(array, ijk_to_world(volume))


def ijk_to_world(volume) -> np.ndarray:
    """Return the 4×4 matrix from voxel indices to world RAS, parent transforms included."""
    matrix = vtk.vtkMatrix4x4()
    volume.GetIJKToRASMatrix(matrix)
    parent = volume.GetParentTransformNode()
    if parent is not None:
        if not parent.IsTransformToWorldLinear():
            text = _(
                "the volume {name!r} is under the transform {parent!r}, "
                "which is not linear: harden it in the Transforms module first"
            )
            raise InputError(text.format(name=volume.GetName(), parent=parent.GetName()))
        to_world = vtk.vtkMatrix4x4()
        parent.GetMatrixTransformToWorld(to_world)
        vtk.vtkMatrix4x4.Multiply4x4(to_world, matrix, matrix)
    return slicer.util.arrayFromVTKMatrix(matrix)


def _placed(array: np.ndarray, matrix: np.ndarray) -> Image:
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    return Image(array, matrix[:3, 3], spacing, matrix[:3, :3] / spacing)


def segmentation_image(segmentation, segment_ids: Sequence[str], reference) -> Image:
    """Return the segments as labels 1, 2, … on the voxels of the reference volume.

    The scene is left as it was. Where segments overlap, the later one wins.
    """
    ids = vtk.vtkStringArray()
    for segment_id in segment_ids:
        ids.InsertNextValue(segment_id)
    labelmap = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLabelMapVolumeNode", "__temp__")
    try:
        logic = slicer.modules.segmentations.logic()
        if not logic.ExportSegmentsToLabelmapNode(segmentation, ids, labelmap, reference):
            text = _(
                "the segmentation {name!r} could not be written on the voxels of {volume!r}: "
                "check that it was drawn on that volume"
            )
            raise InputError(text.format(name=segmentation.GetName(), volume=reference.GetName()))
        array = slicer.util.arrayFromVolume(labelmap).copy()
    finally:
        display = labelmap.GetDisplayNode()
        colors = display.GetColorNode() if display is not None else None
        for node in (labelmap, display, colors):  # the export makes all three
            if node is not None:
                slicer.mrmlScene.RemoveNode(node)
    expected = slicer.util.arrayFromVolume(reference).shape
    if array.shape != expected:
        text = _(
            "the segmentation {name!r} does not fit on the voxels of {volume!r}: {found} instead "
            "of {expected}"
        )
        about = {"name": segmentation.GetName(), "volume": reference.GetName()}
        raise InputError(text.format(**about, found=array.shape[::-1], expected=expected[::-1]))
    return _placed(array.astype(np.int32), ijk_to_world(reference))


def box_of_roi(roi) -> tuple[float, ...]:
    """Return the box (x0, x1, y0, y1, z0, z1) of a markups ROI in world RAS."""
    bounds = [0.0] * 6
    roi.GetRASBounds(bounds)
    return tuple(bounds)


def fingerprint(volume) -> dict[str, str]:
    """Return a volume's name and the SHA-256 of its voxels and geometry."""
    return {"name": volume.GetName(), "sha256": image_hash(image_from_volume(volume))}


def nodal_displacements(transforms: Sequence, points: np.ndarray, to_rest: bool) -> np.ndarray:
    """Evaluate one transform per trial at the mesh nodes.

    Parameters
    ----------
    transforms : sequence of vtkMRMLTransformNode
    points : (n, 3) world RAS
    to_rest : bool
        False: a transform takes points at rest to where they are when pushed. True: the other way
        round, as registrations store it whose fixed image is the rest image.

    Returns
    -------
    (t, n, 3) displacements rest → pushed
    """
    places = vtk.vtkPoints()
    places.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    fields = []
    for node in transforms:
        transform = vtk.vtkGeneralTransform()
        (node.GetTransformFromWorld if to_rest else node.GetTransformToWorld)(transform)
        moved = vtk.vtkPoints()
        moved.SetDataTypeToDouble()
        transform.TransformPoints(places, moved)
        fields.append(vtk_to_numpy(moved.GetData()) - points)
    return np.array(fields)


def outside_grids(transforms: Sequence, points: np.ndarray) -> list[str]:
    """Say for which grid transforms mesh nodes lie outside of the grid, where they mean nothing."""
    sentences = []
    for node in transforms:
        grid = node.GetTransformToParent()
        grid = grid if grid is not None and grid.IsA("vtkGridTransform") else None
        grid = grid or node.GetTransformFromParent()
        if grid is None or not grid.IsA("vtkGridTransform") or grid.GetDisplacementGrid() is None:
            continue
        data = grid.GetDisplacementGrid()
        direction = np.eye(3)
        if grid.IsA("vtkOrientedGridTransform") and grid.GetGridDirectionMatrix() is not None:
            direction = slicer.util.arrayFromVTKMatrix(grid.GetGridDirectionMatrix())[:3, :3]
        index = (points - data.GetOrigin()) @ direction / data.GetSpacing()
        size = np.array(data.GetDimensions())
        wide = size > 1
        outside = ((index < -0.5) | (index > size - 0.5))[:, wide].any(axis=1)
        if outside.any():
            text = _(
                "{share:.0f} % of the mesh nodes lie outside the grid of the transform {name!r}: "
                "their displacement means nothing. Use a transform that covers the segmentation."
            )
            sentences.append(text.format(share=100 * outside.mean(), name=node.GetName()))
    return sentences
