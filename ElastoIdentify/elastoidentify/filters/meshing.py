"""From a segmentation to a mesh."""

import contextlib

import numpy as np

from ..errors import InputError
from ..vtk_io.convert import image_from_vtk, mesh_to_vtk, set_array, set_text, slice_of_image
from .base import Filter, Port
from .options import Choice, Flag, Number, Rows, Text
from .selection import Selection


class SegmentationToTriangleMesh(Filter):
    """Mesh a labelmap: triangles of one slice, tetrahedra of a volume.

    Input: vtkImageData with one whole number per voxel, 0 where there is nothing. Output: a mesh
    that conforms to the labels' borders, with the cell array ``Label`` and the point array
    ``ReactionNodes``, in the world of the image. What was changed on the way (small islands
    dropped, say) is in the field data string ``MeshNotes``, a sentence per line.
    """

    ports = (Port("segmentation", "vtkImageData"),)

    edge_length = Number(
        0.0,
        "Length of the cells' edges in the image's length unit. 0: twelve times the smallest "
        "spacing of the image.",
        minimum=0.0,
    )
    label_array = Text("", "Point array with the labels; empty: the active scalars.")
    slice_axis = Choice(
        "none",
        "Mesh one slice across this image axis instead of the whole volume.",
        ("none", "i", "j", "k"),
    )
    slice_index = Number(0, "Number of that slice, from 0.", minimum=0, kind=int)
    border_reactions = Flag(
        True,
        "An outside body may push at the image's border: no force balance there.",
    )
    rigid_labels = Rows(
        "RigidLabel",
        "Labels of rigid bodies. They are not meshed, and may push where they touch the tissue.",
        ["label"],
        kinds=[int],
    )
    reaction_boxes = Rows(
        "ReactionBox",
        "Boxes (x0, x1, y0, y1[, z0, z1] in the world) in which an outside body may push.",
        ["x0", "x1", "y0", "y1", "z0", "z1"],
        lengths=[4, 6],
    )

    def __init__(self, **settings):
        self._rigid, self._labels_of = Selection(self), None
        super().__init__(**settings)

    def GetRigidLabelSelection(self):
        """Return the list of the segmentation's labels, by which a host lets rigid ones be picked.

        It adds to ``rigid_labels``.
        """
        return self._rigid.vtk

    def RequestInformation(self, request, inInfo, outInfo):
        """Offer the labels to the panel of a host, as soon as the image is known."""
        image = self.GetInputDataObject(0, 0) if self.GetNumberOfInputConnections(0) else None
        if image is not None and image.IsA("vtkImageData") and image.GetNumberOfPoints():
            self._offer(image)
        return 1

    def _offer(self, image):
        state = (image.GetAddressAsString(""), image.GetMTime(), self.label_array)
        if state != self._labels_of:
            with contextlib.suppress(InputError):
                labels = np.unique(image_from_vtk(image, array=self.label_array).array)
                if len(labels) <= 256:  # a grey image is no labelmap
                    self._rigid.offer([f"{label:g}" for label in labels if label])
            self._labels_of = state

    def execute(self, segmentation, progress):
        """Return the mesh."""
        from ..imaging.meshing import mesh_segmentation

        image = image_from_vtk(segmentation, "segmentation", self.label_array)
        if self.slice_axis != "none":
            image = slice_of_image(image, "ijk".index(self.slice_axis), self.slice_index)
        mesh = mesh_segmentation(
            _whole_numbers(image),
            self.edge_length or default_edge_length(image),
            rigid_labels=(*self.rigid_labels, *map(int, self._rigid.chosen())),
            reaction_boxes=self.reaction_boxes,
            border_reactions=self.border_reactions,
            progress=progress,
        )
        grid = mesh_to_vtk(mesh.points, mesh.cells)
        set_array(grid.GetCellData(), "Label", np.asarray(mesh.labels, np.int32))
        grid.GetCellData().SetActiveScalars("Label")  # what a host shows first
        set_array(grid.GetPointData(), "ReactionNodes", np.asarray(mesh.reaction_nodes, np.uint8))
        set_text(grid, "MeshNotes", "\n".join(mesh.notes))
        return grid


def default_edge_length(image) -> float:
    """Return twelve voxels: the finest edge at which registration still adds information."""
    spread = [d for d, n in zip(image.spacing, image.size, strict=True) if n > 1]
    return 12.0 * min(spread, default=1.0)


def _whole_numbers(image):
    """Return the labels as int32: images in files and in ParaView often come as floats."""
    labels = np.asarray(image.array)
    if not np.all(np.isfinite(labels)) or np.any(labels != np.round(labels)):
        raise InputError(
            "the segmentation has values that are not whole numbers: give a labelmap, not a grey "
            "image or one resampled with interpolation"
        )
    return image.with_array(labels.astype(np.int32))
