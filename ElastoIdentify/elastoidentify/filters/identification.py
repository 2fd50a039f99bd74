"""From displacements to the Lamé constants."""

import numpy as np

from ..errors import InputError
from ..fem.constitutive import KINEMATICS
from ..inverse.methods import METHODS
from ..vtk_io.convert import (
    DISPLACEMENT,
    displacement_names,
    get_array,
    has_array,
    information_name,
    matrices,
    mesh_blocks,
    mesh_points,
    set_array,
    set_text,
    to_json,
    vectors,
)
from .base import Filter, Port
from .options import Choice, Flag, Number, Rows
from .selection import Selection

KNOWN = ("KnownYoungModulus", "KnownPoissonRatio")

CELL_RESULTS = {
    "Lambda": "lam",
    "Mu": "mu",
    "YoungModulus": "young",
    "PoissonRatio": "poisson",
    "LambdaStd": "lam_std",
    "MuStd": "mu_std",
}
"""Cell array → field of the result; all float64."""


class LameIdentification(Filter):
    """Identify the Lamé constants λ, μ of every cell from the displacements of its nodes.

    Input: a mesh of triangles, quads, tetrahedra or hexahedra with the point arrays
    ``Displacement_1``, ``Displacement_2``, … (and ``DisplacementInformation_k``,
    ``ReactionNodes`` where there are any), the cell array ``Label``, and known cells: by label
    (:meth:`AddKnownMaterial`) or cell by cell (cell arrays ``KnownYoungModulus``,
    ``KnownPoissonRatio``, NaN where not known). Output: the mesh with all its arrays and the cell
    arrays ``Lambda``, ``Mu``, ``YoungModulus``, ``PoissonRatio``, ``LambdaStd``, ``MuStd`` (in the
    unit of the known Young's modulus, NaN where not identified), ``Status`` (0 not determined,
    1 known, 2 identified, 3 out of range), ``SequenceOrder``, the point arrays ``Residual_k``
    and the field data string ``IdentificationReport`` (JSON).
    """

    ports = (Port("mesh", "vtkUnstructuredGrid", over_time=True),)

    known_materials = Rows(
        "KnownMaterial",
        "Materials whose stiffness is known: label, Young's modulus (its unit is the unit of the "
        "result) and Poisson's ratio.",
        ["Label", "Young's modulus", "Poisson's ratio"],
        kinds=[int, float, float],
        start=(1, 5000.0, 0.43),
    )
    method = Choice(
        "auto",
        "sequential: node by node from the known cells, for clean displacements; global: all "
        "nodes at once; regularized: for measured displacements; auto: sequential, and regularized "
        "where its own error says that it cannot be trusted.",
        METHODS,
    )
    unknowns = Choice(
        "lambda-mu",
        "What to find in every cell: both Lamé constants, or Young's modulus alone with Poisson's "
        "ratio given, which suits soft tissue.",
        ("lambda-mu", "young"),
    )
    poisson_ratio = Number(
        None, "Poisson's ratio of the unknown cells where only Young's modulus is sought."
    )
    grouping = Choice("cell", "One unknown material per cell, or one per label.", ("cell", "label"))
    kinematics = Choice(
        "small-strain",
        "Small strain for pushes of up to about a percent; the finite-strain laws for larger ones.",
        KINEMATICS,
    )
    plane = Choice(
        "strain",
        "Plane strain (thick bodies) or plane stress (thin ones). For planar meshes.",
        ("strain", "stress"),
    )
    noise = Number(
        0.0,
        "Standard deviation of a displacement component, in the mesh's length unit. 0: estimated.",
        minimum=0.0,
    )
    refine = Number(
        0,
        "Sub-cells per cell of the regularized method's forward problem: 1, 4 or 16. 0: the "
        "method's own choice.",
        minimum=0,
        kind=int,
    )

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
        if mesh is not None and mesh.IsA("vtkUnstructuredGrid"):
            self._offer(mesh)
        return 1

    def _offer(self, mesh):
        self._trials.offer(displacement_names(mesh), on=True)
        self._trials.offer(_vector_names(mesh))

    def trials(self, mesh) -> list[str]:
        """Return the names of the displacement arrays to use, in the order of the trials."""
        self._offer(mesh)
        chosen, standard = self._trials.chosen(), displacement_names(mesh)
        others = [name for name in chosen if name not in standard]
        gone = [name for name in others if DISPLACEMENT.match(name)]  # of an earlier input
        return [n for n in standard if n in chosen] + [n for n in others if n not in gone]

    # ---- work

    def execute(self, meshes, progress):
        """Return the mesh with the result arrays."""
        from ..inverse.identify import identify

        mesh = trials_of_steps(meshes, self.trials) if len(meshes) > 1 else meshes[0]
        blocks, order = mesh_blocks(mesh)
        trials = self.trials(mesh)
        if not trials:
            raise InputError(
                "no displacements: the mesh needs a point array Displacement_1, and one more per "
                "further trial"
            )
        result = identify(
            mesh_points(mesh),
            blocks,
            np.stack([_displacement(mesh, name) for name in trials]),
            self._known(mesh, order),
            labels=_labels(mesh, order),
            reaction_nodes=_reaction_nodes(mesh),
            method=self.method,
            kinematics=self.kinematics,
            plane=self.plane,
            unknowns=self.unknowns,
            poisson_ratio=self.poisson_ratio,
            grouping=self.grouping,
            information=_information(mesh, trials),
            noise=self.noise or None,
            refine=self.refine or None,
            progress=progress,
        )
        grid = mesh.NewInstance()
        grid.ShallowCopy(mesh)
        write_identification(grid, result, order)
        return grid

    def _known(self, mesh, order):
        """Return what is known by label, or, where the mesh says it cell by cell, (n_cells, 2)."""
        by_label = {label: (young, poisson) for label, young, poisson in self.known_materials}
        cells = mesh.GetCellData()
        if not any(has_array(cells, name) for name in KNOWN):
            return by_label
        known = np.column_stack([get_array(cells, name) for name in KNOWN]).astype(float)[order]
        for label, constants in by_label.items():
            here = _labels(mesh, order) == label if has_array(cells, "Label") else np.zeros(1, bool)
            if not here.any():
                raise InputError(f"no cell of the mesh has the known material's label {label}")
            free = here & np.isnan(known).any(axis=1)  # what is said of a cell goes first
            known[free] = constants
        return known


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
            set_array(grid.GetPointData(), f"Displacement_{number}", _displacement(mesh, name))
            if has_array(points, information_name(name)) and information_name(name) != name:
                rows = get_array(points, information_name(name))
                set_array(grid.GetPointData(), f"DisplacementInformation_{number}", rows)
    return grid


def write_identification(grid, result, order=None):
    """Put an IdentificationResult into the mesh; `order`: each result cell's number in it."""
    n_cells = grid.GetNumberOfCells()
    order = np.arange(n_cells) if order is None else order

    def put(name, values, dtype):
        array = np.empty(n_cells, dtype)
        array[order] = values
        set_array(grid.GetCellData(), name, array)

    for name, field in CELL_RESULTS.items():
        put(name, getattr(result, field), np.float64)
    grid.GetCellData().SetActiveScalars("Mu")  # what a host shows first
    put("Status", result.status, np.uint8)
    put("SequenceOrder", result.sequence_order, np.int32)
    for number, residual in enumerate(result.residuals, 1):
        set_array(grid.GetPointData(), f"Residual_{number}", vectors(np.asarray(residual, float)))
    set_text(grid, "IdentificationReport", to_json(result.report))


def _vector_names(mesh) -> list[str]:
    points = mesh.GetPointData()
    arrays = [points.GetArray(i) for i in range(points.GetNumberOfArrays())]
    return [a.GetName() for a in arrays if a is not None and a.GetNumberOfComponents() == 3]


def _displacement(mesh, name: str) -> np.ndarray:
    values = get_array(mesh.GetPointData(), name).astype(float)
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise InputError(f"the point array {name!r} holds no vectors: it cannot be a displacement")
    return vectors(values)


def _labels(mesh, order):
    cells = mesh.GetCellData()
    return get_array(cells, "Label")[order].astype(int) if has_array(cells, "Label") else None


def _reaction_nodes(mesh):
    points = mesh.GetPointData()
    if not has_array(points, "ReactionNodes"):
        return None
    return get_array(points, "ReactionNodes").astype(bool)


def _information(mesh, trials):
    """Return (n_trials, n_nodes, 3, 3), or None unless every trial comes with its information."""
    points = mesh.GetPointData()
    names = [information_name(name) for name in trials]
    if not all(n != t and has_array(points, n) for n, t in zip(names, trials, strict=True)):
        return None
    return np.stack([matrices(get_array(points, name).astype(float)) for name in names])
