"""From a segmentation to a mesh."""

import contextlib

import numpy as np

from ..errors import InputError
from ..options import Text
from ..study import MeshOptions
from ..vtk_io.convert import get_text, image_from_vtk
from .base import Filter, Port
from .selection import Selection


class SegmentationToMesh(Filter, tables=(MeshOptions,)):
    """Mesh a labelmap: triangles of one slice, tetrahedra of a volume.

    Input: vtkImageData with one whole number per voxel, 0 where there is nothing. Output: a mesh
    that conforms to the labels' borders, with the cell array ``Label`` and the point array
    ``ReactionNodes``, in the world of the image. What was changed on the way (small islands
    dropped, say) is in the field data string ``MeshNotes``, a sentence per line.
    """

    ports = (Port("segmentation", "vtkImageData"),)

    label_array = Text(
        "", "Point array with the labels; empty: the active scalars.", group="Mesh", advanced=True
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
        from ..vtk_io.steps import meshed

        chosen = self.choices(MeshOptions)
        chosen.segmentation = image_from_vtk(segmentation, "segmentation", self.label_array)
        chosen.rigid_labels = (*self.rigid_labels, *map(int, self._rigid.chosen()))
        return meshed(chosen, progress)

    def warnings_of(self, output):
        """Return what was changed on the way to the mesh."""
        return get_text(output, "MeshNotes").splitlines()


class SegmentationToTriangleMesh(SegmentationToMesh):
    __doc__ = SegmentationToMesh.__doc__
