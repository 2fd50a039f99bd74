"""From images to the displacements of a mesh's nodes."""

import numpy as np

from ..errors import InputError
from ..vtk_io.convert import (
    INFORMATION_COMPONENTS,
    displacement_names,
    image_from_vtk,
    information_name,
    mesh_points,
    set_array,
    set_text,
    simplices,
    slice_of_image,
    to_json,
    vectors,
)
from .base import Filter, Port
from .options import Choice, File, Flag

DISAGREEMENT = "Disagreement"


class ElastixNodalDisplacement(Filter):
    """Register every pushed image to the rest image, and read the displacement at the nodes.

    Inputs: the mesh (port 0), the rest image (port 1), one pushed image per trial (port 2, any
    number, or a series with a push per time step). Output: the mesh with the point arrays
    ``Displacement_k`` (rest → pushed, in the mesh's length unit),
    ``DisplacementInformation_k`` (inverse covariance, xx yy zz xy yz xz, in 1/length²) and
    ``Disagreement_k`` (pixels by which going to the pushed image and back misses the node; only
    with ``backward``), and the field data string ``RegistrationReport`` (JSON). All else that the
    mesh carries stays. The registration runs in a worker process and can be cancelled.

    A planar mesh in a slice of three-dimensional images is registered in that slice.
    """

    ports = (
        Port("mesh", "vtkUnstructuredGrid"),
        Port("rest image", "vtkImageData"),
        Port("pushed images", "vtkImageData", repeatable=True, over_time=True),
    )

    parameter_file = File(
        "elastix parameter file; empty: the one that comes with ElastoIdentify.",
        extensions="txt",
        description="elastix parameter file",
    )
    reference = Choice(
        "rest",
        "What each pushed image is registered to: the rest image, or the pushed image before it, "
        "for a series of ever larger pushes.",
        ("rest", "previous"),
    )
    backward = Flag(
        True,
        "Also register from pushed to rest: takes twice the time and tells how far the "
        "displacements can be trusted.",
    )
    time_steps_as_trials = Flag(
        True, "Every time step of a pushed image series is a trial; off: the current one only."
    )

    # ---- inputs

    def SetMesh(self, mesh):
        """Set the mesh: a vtkUnstructuredGrid, a filter or an output port."""
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

    def AddInputData(self, *port_and_data):
        """Add the data of one more trial, as :meth:`AddPushedImage`; or to a port by number."""
        if len(port_and_data) == 2:
            self.AddInputDataObject(*port_and_data)
        else:
            self.AddPushedImage(*port_and_data)

    # ---- work

    def execute(self, mesh, rest, pushed, progress):
        """Return the mesh with displacements."""
        return displaced(
            mesh,
            image_from_vtk(rest, "rest image"),
            [
                image_from_vtk(data, f"pushed image of trial {number}")
                for number, data in enumerate(pushed, 1)
            ],
            parameters=self.parameter_file or None,
            reference=self.reference,
            backward=self.backward,
            progress=progress,
        )


def displaced(mesh, rest, pushed, *, mask=None, **options):
    """Return the mesh with the displacements that images show.

    A planar mesh in a slice of volumes is registered in that slice.

    Parameters
    ----------
    mesh : vtkUnstructuredGrid
    rest : Image or None
        None: the first pushed image takes its place.
    pushed : list of Image
    mask : Image, optional
    options
        As of :func:`~elastoidentify.imaging.registration.registration.register`.
    """
    from ..imaging.registration.registration import register

    points = mesh_points(mesh)
    images = [rest, *pushed, mask]
    if _is_planar(mesh):
        images = [one if one is None else slice_with_points(one, points) for one in images]
    rest, *pushed, mask = images
    found = register(rest, pushed, points, simplices(mesh), mask=mask, **options)
    grid = mesh.NewInstance()
    grid.ShallowCopy(mesh)
    write_registration(grid, found)
    return grid


def write_registration(grid, registration):
    """Put displacements, their information, their disagreement and the report into the mesh."""
    data = grid.GetPointData()
    for name in displacement_names(grid):
        for array in (name, information_name(name), name.replace("Displacement", DISAGREEMENT)):
            data.RemoveArray(array)
    for number, displacement in enumerate(registration.displacements, 1):
        set_array(data, f"Displacement_{number}", vectors(np.asarray(displacement, float)))
    for number, information in enumerate(registration.information, 1):
        name = f"DisplacementInformation_{number}"
        set_array(data, name, np.asarray(information, float))
        for component, (i, j) in enumerate(INFORMATION_COMPONENTS):
            data.GetArray(name).SetComponentName(component, "xyz"[i] + "xyz"[j])
    if registration.disagreement is not None:
        for number, pixels in enumerate(registration.disagreement, 1):
            set_array(data, f"{DISAGREEMENT}_{number}", np.asarray(pixels, float))
    set_text(grid, "RegistrationReport", to_json(registration.report))


def slice_with_points(image, points):
    """Return the slice of a volume in which the points (n, 3) lie; a planar image as it is."""
    if image.planar_axis is not None:
        return image
    index = image.world_to_index(points)
    low, high = index.min(axis=0), index.max(axis=0)
    flat = [axis for axis in range(3) if high[axis] - low[axis] < 0.01]
    if len(flat) != 1:
        raise InputError(
            "the mesh is planar and the images are volumes, but the mesh lies in no slice of them: "
            "cut the images to the mesh's plane first (Slice, then Resample), or mesh the volume"
        )
    axis = flat[0]
    number = round(float(index[:, axis].mean()))
    if abs(index[:, axis].mean() - number) > 0.5 or not 0 <= number < image.size[axis]:
        raise InputError(f"the mesh lies outside the images, at slice {number} of axis {axis}")
    return slice_of_image(image, axis, number)


def _is_planar(mesh) -> bool:
    return mesh.GetCell(0).GetCellDimension() == 2
