"""From displacements to the Lamé constants."""

from ..errors import InputError
from ..options import Flag
from ..study import IdentificationOptions, ReportOptions
from ..vtk_io.arrays import displacement_of, label_table, read_report, trials_of
from ..vtk_io.convert import displacement_names, get_array, has_array, information_name, set_array
from ..vtk_io.frame import PLACE
from .base import Filter, Port
from .selection import Selection


class LameIdentification(Filter, tables=(IdentificationOptions, ReportOptions)):
    """Identify the Lamé constants λ, μ of every cell from the displacements of its nodes.

    Input: a mesh of triangles, quads, tetrahedra or hexahedra (surfaces too) with the point arrays
    ``Displacement_1``, ``Displacement_2``, … (and ``DisplacementInformation_k``,
    ``ReactionNodes`` where there are any), the cell array ``Label``, and known cells: by label
    (:meth:`AddKnownMaterial`) or cell by cell (cell arrays ``KnownYoungModulus``,
    ``KnownPoissonRatio``, NaN where not known). Output: the mesh with all its arrays and the cell
    arrays ``Lambda``, ``Mu``, ``YoungModulus``, ``PoissonRatio``, ``LambdaStd``, ``MuStd`` (in the
    unit of the known Young's modulus, NaN where not identified), ``Status`` (0 not determined,
    1 known, 2 identified, 3 out of range), ``SequenceOrder``, the point arrays ``Residual_k``
    and the field data strings ``IdentificationReport`` and ``Provenance`` (JSON)
    and ``Warnings`` (a sentence per value, where there are any).
    :meth:`GetLabelTable` has the figures per label.
    """

    ports = (Port("mesh", "vtkPointSet", over_time=True),)

    time_steps_as_trials = Flag(
        False,
        "Every time step of the mesh is a push of its own: the displacements of all steps are "
        "trials.",
    )

    def __init__(self, **settings):
        self._trials = Selection(self)
        super().__init__(**settings)

    # ---- which trials

    def GetDisplacementArraySelection(self):
        """Return the choice of displacement arrays, all ``Displacement_k`` to begin with."""
        return self._trials.vtk

    def SetDisplacementArrays(self, names):
        """Use these point arrays as trials and no others; none: all ``Displacement_k``."""
        names = [names] if isinstance(names, str) else list(names or ())
        if names != self.GetDisplacementArrays():
            self._trials.choose(names)

    def GetDisplacementArrays(self) -> list[str]:
        """Return the names of the arrays that are switched on."""
        return self._trials.chosen()

    displacement_arrays = property(GetDisplacementArrays, SetDisplacementArrays)

    def RequestInformation(self, request, inInfo, outInfo):
        """Offer the mesh's vector arrays to the panel of a host, as soon as the mesh is known."""
        mesh = self.GetInputDataObject(0, 0) if self.GetNumberOfInputConnections(0) else None
        if mesh is not None and mesh.IsA("vtkPointSet"):
            self._offer(mesh)
        return 1

    def _offer(self, mesh):
        self._trials.offer(displacement_names(mesh), on=True)
        self._trials.offer(_vector_names(mesh))

    def trials(self, mesh) -> list[str]:
        """Return the names of the displacement arrays to use, in the order of the trials."""
        self._offer(mesh)
        return trials_of(mesh, self._trials.chosen())

    # ---- work

    def execute(self, meshes, progress):
        """Return the mesh with the result arrays."""
        from ..vtk_io.steps import identified

        mesh = trials_of_steps(meshes, self.trials) if len(meshes) > 1 else meshes[0]
        return identified(mesh, self, self.trials(mesh), progress=progress)

    def warnings_of(self, output):
        """Return what makes the map doubtful."""
        return read_report(output, "identification").get("warnings", [])

    def GetLabelTable(self):
        """Return the figures per label of the last output as vtkTable."""
        return label_table(self.GetOutput())


def trials_of_steps(meshes, trials):
    """Return one mesh with the displacements of all time steps, numbered through.

    Parameters
    ----------
    meshes : sequence of vtkUnstructuredGrid
        The same mesh at each step.
    trials : callable
        Gives the names of a mesh's displacement arrays.
    """
    grid = meshes[0].NewInstance()
    grid.ShallowCopy(meshes[0])
    for name in displacement_names(grid):
        grid.GetPointData().RemoveArray(name)
        grid.GetPointData().RemoveArray(information_name(name))
    number = 0
    for step, mesh in enumerate(meshes):
        if mesh.GetNumberOfPoints() != grid.GetNumberOfPoints():
            raise InputError(
                f"the mesh has {mesh.GetNumberOfPoints()} nodes at time step {step} and "
                f"{grid.GetNumberOfPoints()} at the first: only steps of one mesh can be trials"
            )
        points = mesh.GetPointData()
        for name in trials(mesh):
            number += 1
            set_array(grid.GetPointData(), f"Displacement_{number}", displacement_of(mesh, name))
            if has_array(points, information_name(name)) and information_name(name) != name:
                rows = get_array(points, information_name(name))
                set_array(grid.GetPointData(), f"DisplacementInformation_{number}", rows)
    return grid


def _vector_names(mesh) -> list[str]:
    points = mesh.GetPointData()
    arrays = [points.GetArray(i) for i in range(points.GetNumberOfArrays())]
    names = [a.GetName() for a in arrays if a is not None and a.GetNumberOfComponents() == 3]
    return [name for name in names if name != PLACE]
