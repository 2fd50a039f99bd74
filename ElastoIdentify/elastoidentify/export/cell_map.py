"""A result as every writer takes it: mesh, values per cell, and what they are about."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from ..results import QUANTITIES, is_found

TO_KILOPASCAL = {
    "pa": 1e-3, "n/m²": 1e-3, "n/m2": 1e-3, "hpa": 0.1, "mbar": 0.1, "kpa": 1.0,
    "n/cm²": 10.0, "n/cm2": 10.0, "mpa": 1e3, "n/mm²": 1e3, "n/mm2": 1e3, "gpa": 1e6,
}  # fmt: skip
"""Units of stress, in lower case; millipascal has no use here."""

TO_MILLIMETRE = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "µm": 1e-3, "μm": 1e-3, "um": 1e-3}

SHORT = {
    "Mu": "mu", "Lambda": "lambda", "YoungModulus": "E", "PoissonRatio": "nu",
    "MuStd": "mu_std", "LambdaStd": "lambda_std", "YoungModulusStd": "E_std",
    "PoissonRatioStd": "nu_std",
}  # fmt: skip
"""Name of a quantity's cell array → what its files are called."""


@dataclass
class CellMap:
    """A result on its mesh.

    Parameters
    ----------
    points : (n, 3)
        World coordinates in the unit `length_unit`, in the world of the images (LPS for files).
    blocks : list of (kind, (m, k) int)
        Cells, kind by kind, in VTK's node order.
    values : {array: (n_cells,)}
        By the names of :data:`~elastoidentify.results.QUANTITIES`; NaN where not determined. In the
        order of `blocks`.
    status, labels : (n_cells,) int
    displacements : (t, n, 3)
        Rest → pushed; may be empty.
    reaction_nodes : (n,) bool
        Where an outside body may push; may be empty.
    label_names : {label: name}
    unit, length_unit : str
    provenance : dict
        What made it, see :func:`~elastoidentify.provenance.provenance`.
    report : dict
        The IdentificationReport.
    """

    points: np.ndarray
    blocks: list[tuple[str, np.ndarray]]
    values: Mapping[str, np.ndarray]
    status: np.ndarray
    labels: np.ndarray
    displacements: np.ndarray = field(default_factory=lambda: np.empty((0, 0, 3)))
    reaction_nodes: np.ndarray = field(default_factory=lambda: np.empty(0, bool))
    label_names: Mapping[int, str] = field(default_factory=dict)
    unit: str = "Pa"
    length_unit: str = "mm"
    provenance: dict = field(default_factory=dict)
    report: dict = field(default_factory=dict)

    def __post_init__(self):
        self.points = np.asarray(self.points, float)
        n = sum(len(nodes) for _, nodes in self.blocks)
        for name, values in {**self.values, "Status": self.status, "Label": self.labels}.items():
            if np.shape(values) != (n,):
                raise InputError(
                    f"{name} has shape {np.shape(values)} and the mesh {n} cells: give one value "
                    "per cell"
                )

    @property
    def dimension(self) -> int:
        """2 for a planar mesh, 3 for one of solid cells."""
        return 2 if self.blocks[0][0] in ("triangle", "quad") else 3

    @property
    def to_kilopascal(self) -> float:
        """What a modulus is multiplied with to be in kPa."""
        return kilopascal(self.unit)

    @property
    def to_millimetre(self) -> float:
        """What a length is multiplied with to be in mm."""
        factor = TO_MILLIMETRE.get(self.length_unit.strip().lower())
        if factor is None:
            raise InputError(
                f"length unit {self.length_unit!r}: not known, so the map cannot be placed in mm; "
                "say --length-unit mm, cm, m or µm"
            )
        return factor

    def unit_of(self, array: str) -> str:
        """Return the unit of a quantity, "1" for pure numbers."""
        return self.unit if QUANTITIES[array].is_modulus else "1"

    def name_of(self, label: int) -> str:
        """Return what a label is called."""
        return self.label_names.get(int(label), "") or f"label {label}"

    def lacks(self, array: str) -> np.ndarray:
        """Tell which cells have no value of a quantity that can be read."""
        return ~is_found(self.status, array)


def kilopascal(unit: str) -> float:
    """Return how many kPa a unit of stress is.

    Raises
    ------
    InputError
        A unit that is not known.
    """
    factor = TO_KILOPASCAL.get(unit.strip().lower())
    if factor is None:
        raise InputError(
            f"unit {unit!r}: not known, so the map cannot be given in kPa; say --unit Pa, kPa, MPa "
            "or N/mm²"
        )
    return factor


def read_cell_map(path) -> CellMap:
    """Read a result of ours (.vtu).

    Raises
    ------
    InputError
        No such file, or not a map.
    """
    from ..vtk_io.vtu import read_mesh

    return from_grid(read_mesh(path), str(path))


def from_grid(grid, where: str = "the mesh") -> CellMap:
    """Return the map of a VTK mesh that carries one."""
    from ..vtk_io.arrays import read_report, trials_of
    from ..vtk_io.checks import cell_labels, reaction_nodes
    from ..vtk_io.convert import get_array, has_array, mesh_blocks, mesh_points

    cells = grid.GetCellData()
    if not has_array(cells, "Status") or not has_array(cells, "Mu"):
        raise InputError(f"{where}: has no map (cell arrays Mu and Status); identify it first")
    blocks, order = mesh_blocks(grid)
    made, report = read_report(grid, "provenance") or {}, read_report(grid, "identification") or {}
    labels = cell_labels(grid)
    trials = [get_array(grid.GetPointData(), name) for name in trials_of(grid, None)]
    return CellMap(
        mesh_points(grid),
        blocks,
        {
            name: np.asarray(get_array(cells, name), float)[order]
            for name in QUANTITIES
            if has_array(cells, name)
        },
        np.asarray(get_array(cells, "Status"))[order].astype(int),
        np.ones(len(order), int) if labels is None else np.asarray(labels)[order],
        np.array(trials, float) if trials else np.empty((0, grid.GetNumberOfPoints(), 3)),
        np.empty(0, bool) if reaction_nodes(grid) is None else reaction_nodes(grid) != 0,
        _names(report),
        made.get("unit") or "Pa",
        made.get("length_unit") or "mm",
        made,
        report,
    )


def _names(report: Mapping) -> dict[int, str]:
    return {row["label"]: row["name"] for row in report.get("labels", []) if row.get("name")}
