"""From images to the displacements of a mesh's nodes."""

from ..options import Flag
from ..study import RegistrationOptions
from ..vtk_io.arrays import read_report
from ..vtk_io.convert import get_text, image_from_vtk, set_text
from .base import Filter, Port
from .reading import FILE_NAME

REST_FILE = "RestImageFile"
"""Field data string: the file of the rest image, where it is known."""


class ElastixNodalDisplacement(Filter, tables=(RegistrationOptions,)):
    """Register every pushed image to the rest image, and read the displacement at the nodes.

    Inputs: the mesh (port 0), the rest image (port 1), one pushed image per trial (port 2, any
    number, or a series with a push per time step), a mask (port 3, optional). Output: the mesh with
    the point arrays ``Displacement_k`` (rest → pushed, in the mesh's length unit),
    ``DisplacementInformation_k`` (inverse covariance, xx yy zz xy yz xz, in 1/length²) and
    ``Disagreement_k`` (pixels by which going to the pushed image and back misses the node; only
    with ``backward``), and the field data string ``RegistrationReport`` (JSON). All else that the
    mesh carries stays. The registration runs in a worker process and can be cancelled.

    A planar mesh in a slice of three-dimensional images is registered in that slice.
    """

    ports = (
        Port("mesh", "vtkPointSet"),
        Port("rest image", "vtkImageData"),
        Port("pushed images", "vtkImageData", repeatable=True, over_time=True),
        Port("mask", "vtkImageData", optional=True),
    )

    time_steps_as_trials = Flag(
        True, "Every time step of a pushed image series is a trial; off: the current one only."
    )

    # ---- inputs

    def SetMesh(self, mesh):
        """Set the mesh: a vtkUnstructuredGrid or vtkPolyData, a filter or an output port."""
        self._connect(0, mesh)

    def SetRestImage(self, image):
        """Set the rest image: a vtkImageData, a filter or an output port."""
        self._connect(1, image)

    def AddPushedImage(self, image):
        """Add the image of one more trial: a vtkImageData, a filter or an output port."""
        self._connect_one_more(2, image)

    def ClearPushedImages(self):
        """Take all pushed images off; the mesh and the rest image stay."""
        self.RemoveAllInputConnections(2)

    def SetMask(self, image):
        """Compare the images where this one is not 0 (None: everywhere)."""
        self._connect(3, image)

    def AddInputData(self, *port_and_data):
        """Add the data of one more trial, as :meth:`AddPushedImage`; or to a port by number."""
        if len(port_and_data) == 2:
            self.AddInputDataObject(*port_and_data)
        else:
            self.AddPushedImage(*port_and_data)

    # ---- work

    def execute(self, mesh, rest, pushed, mask, progress):
        """Return the mesh with displacements."""
        from ..vtk_io.steps import displaced

        progress(0.0, "starting elastix")  # which takes a while to say anything
        chosen = self.choices(RegistrationOptions)
        chosen.rest = image_from_vtk(rest, "rest image")
        chosen.pushed = [
            image_from_vtk(data, f"pushed image of trial {number}")
            for number, data in enumerate(pushed, 1)
        ]
        chosen.mask = None if mask is None else image_from_vtk(mask, "mask")
        grid = displaced(mesh, chosen, progress)
        if get_text(rest, FILE_NAME):
            set_text(grid, REST_FILE, get_text(rest, FILE_NAME))
        return grid

    def warnings_of(self, output):
        """Return what makes the displacements doubtful."""
        return read_report(output, "registration").get("warnings", [])
