"""Meshes with exact displacements, to try everything without images."""

import numpy as np

from ..options import Choice, Number, Rows, Vector
from ..progress import part
from ..study import LAWS
from ..vtk_io.arrays import KNOWN, write_displacements
from ..vtk_io.convert import mesh_to_vtk, set_array, vectors
from .base import Filter

PAD, TISSUE, INCLUSION = 1, 2, 3


class PushingPhantom(Filter):
    """Push a block of tissue with a stiff inclusion through a pad of known stiffness.

    A source. The lower part of a square or cube is tissue (label 2) with a round inclusion
    (label 3), the upper part a pad (label 1). It stands on the floor, and its top is moved, once
    per trial; y points up. Output: the mesh with ``Label``, ``ReactionNodes`` (floor and top),
    ``Displacement_k``, the pad's constants in ``KnownYoungModulus`` and ``KnownPoissonRatio`` (NaN
    elsewhere), and the truth in ``TrueLambda``, ``TrueMu`` (Pa).

    Without noise the displacements are exact solutions of the same equations that identification
    uses: a check of the arithmetic, not of robustness.
    """

    shape = Choice(
        "triangles",
        "Triangles or quads of a square in plane strain, tetrahedra or hexahedra of a cube.",
        ("triangles", "quads", "tetrahedra", "hexahedra"),
    )
    pattern = Choice(
        "paper",
        "How each square is cut into triangles: all diagonals alike, alternating ones, or crossed.",
        ("paper", "alternating", "crossed"),
    )
    resolution = Number(8, "Squares or boxes along each edge.", minimum=2, kind=int)
    size = Number(0.2, "Length of an edge (m).", minimum=1e-9)
    pad_fraction = Number(
        0.5, "Height of the pad over the height of the whole.", minimum=0.0, maximum=1.0
    )
    young_modulus = Number(5000.0, "Young's modulus of pad and tissue (Pa).", minimum=1e-9)
    poisson_ratio = Number(0.43, "Poisson's ratio of all.", minimum=-0.99, maximum=0.499)
    inclusion_contrast = Number(
        3.0, "Young's modulus of the inclusion over that of the tissue.", minimum=1e-6
    )
    inclusion_center = Vector((0.5, 0.25, 0.5), "Centre of the inclusion, in edge lengths.")
    inclusion_radius = Number(
        0.15, "Radius of the inclusion, in edge lengths. 0: none.", minimum=0.0
    )
    pushes = Rows(
        "Push",
        "Displacement of the top (m), a row per trial; down is negative y. None: 5 % of the edge, "
        "straight and oblique, four times in a cube.",
        ["x", "y", "z"],
        lengths=[2, 3],
    )
    kinematics = Choice("small-strain", "Small strain, or a finite-strain law.", LAWS)
    noise = Number(
        0.0, "Standard deviation of the noise on every displacement component (m).", minimum=0.0
    )
    seed = Number(1, "Start of the noise's random numbers.", minimum=0, kind=int)

    def execute(self, progress):
        """Return the pushed mesh."""
        from ..fem.elastic_constants import lame_from_young

        points, cells = self._mesh()
        labels = self._labels(points[cells].mean(axis=1))
        stiffness = np.where(labels == INCLUSION, self.inclusion_contrast, 1.0)
        lam, mu = lame_from_young(self.young_modulus * stiffness, self.poisson_ratio)
        held = np.isin(points[:, 1], [points[:, 1].min(), points[:, 1].max()])
        grid = mesh_to_vtk(points, [(_KINDS[self.shape], cells)])
        set_array(grid.GetCellData(), "Label", labels)
        grid.GetCellData().SetActiveScalars("Label")  # what a host shows first
        set_array(grid.GetCellData(), "TrueLambda", lam)
        set_array(grid.GetCellData(), "TrueMu", mu)
        for name, value in zip(KNOWN, (self.young_modulus, self.poisson_ratio), strict=True):
            set_array(grid.GetCellData(), name, np.where(labels == PAD, value, np.nan))
        set_array(grid.GetPointData(), "ReactionNodes", held.astype(np.uint8))
        border = ((points == points.min(axis=0)) | (points == points.max(axis=0))).any(axis=1)
        set_array(grid.GetPointData(), "OuterBorder", border.astype(np.uint8))
        trials = self._pushed(points, cells, lam, mu, held, progress)
        write_displacements(grid, trials)
        return grid

    def _mesh(self):
        from ..fem.forward import box_mesh, square_mesh

        n, size = self.resolution, self.size
        if self.shape == "triangles":
            return square_mesh(n, n, size, size, self.pattern)
        if self.shape == "quads":
            return box_mesh((n, n), (size, size), "quad")
        return box_mesh((n, n, n), (size, size, size), _KINDS[self.shape])

    def _labels(self, centers):
        """Return the label of each cell by where its centre (m, 2 or 3) lies."""
        where = centers / self.size
        away = np.linalg.norm(where - self.inclusion_center[: where.shape[1]], axis=1)
        labels = np.where(away < self.inclusion_radius, INCLUSION, TISSUE)
        return np.where(where[:, 1] > 1 - self.pad_fraction, PAD, labels).astype(np.int32)

    def _pushed(self, points, cells, lam, mu, held, progress):
        """Yield the displacement (n, d) of every trial, its noise included."""
        from ..fem.forward import solve_push

        nodes, dimension = np.flatnonzero(held), points.shape[1]
        top = points[nodes, 1] > points[:, 1].mean()
        random = np.random.default_rng(self.seed)
        pushes = self.pushes or default_pushes(self.size, dimension)
        for number, push in enumerate(pushes):
            target = np.where(top[:, None], vectors(np.array([push]))[:, :dimension], 0.0)
            exact = solve_push(
                points,
                [(_KINDS[self.shape], cells)],
                lam,
                mu,
                nodes,
                target,
                kinematics=self.kinematics,
                progress=part(progress, number / len(pushes), (number + 1) / len(pushes)),
            )
            yield exact + random.normal(0.0, self.noise, exact.shape)


_KINDS = {
    "triangles": "triangle",
    "quads": "quad",
    "tetrahedra": "tetra",
    "hexahedra": "hexahedron",
}


def default_pushes(size: float, dimension: int) -> list[tuple[float, ...]]:
    """Return pushes of 5 % of `size`: as many as make all constants visible."""
    depth = 0.05 * size
    if dimension == 2:
        return [(0.0, -depth), (depth, -depth)]
    return [(0, -depth, 0), (depth, -depth, 0), (0, -depth, depth), (depth, 0, -depth)]
