"""Identification of the Lamé constants: one entry point over all methods."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .progress import Progress

STATUS_NOT_DETERMINED, STATUS_KNOWN, STATUS_IDENTIFIED, STATUS_OUT_OF_RANGE = range(4)


@dataclass
class IdentificationResult:
    """What was found, cell by cell, in the unit of the known material's Young's modulus.

    All cell arrays have shape (n_cells,) and the cell order of the input.
    """

    lam: np.ndarray
    mu: np.ndarray
    young: np.ndarray
    poisson: np.ndarray
    lam_std: np.ndarray
    mu_std: np.ndarray
    status: np.ndarray
    sequence_order: np.ndarray
    residuals: np.ndarray  # (n_trials, n_nodes, dim of the points given)
    report: dict = field(default_factory=dict)  # JSON-ready; report["warnings"]: list of sentences


def identify(
    points: np.ndarray,
    cells: np.ndarray | Sequence[tuple[str, np.ndarray]],
    displacements: np.ndarray,
    known: Mapping[int, tuple[float, float]] | np.ndarray,
    *,
    labels: np.ndarray | None = None,
    reaction_nodes: np.ndarray | None = None,
    method: str = "auto",
    kinematics: str = "small-strain",
    plane: str = "strain",
    unknowns: str = "lambda-mu",
    poisson_ratio: float | None = None,
    grouping: str = "cell",
    information: np.ndarray | None = None,
    noise: float | None = None,
    refine: int | None = None,
    progress: Progress | None = None,
) -> IdentificationResult:
    """Identify λ and μ of every cell from the displacements of its nodes.

    Parameters
    ----------
    points : (n_nodes, 2) or (n_nodes, 3)
        Node positions at rest. A mesh of planar cells may lie in any plane of space.
    cells : (n_cells, k) int, or list of (kind, (n, k) int)
        Connectivity. One array: triangles (k=3); quads or tetrahedra (k=4, by the dimension of
        the points: use the list form to be explicit); hexahedra (k=8). List: blocks of kinds
        "triangle", "quad", "tetra", "hexahedron", VTK's node order; cells are numbered through.
    displacements : (n_trials, n_nodes, 2 or 3)
        Rest → pushed, in the length unit of the points.
    known : {label: (young, poisson)} or (n_cells, 2) array
        The known cells, by label or per cell (NaN: not known).
    labels : (n_cells,) int, optional
        Label of each cell; needed for known-by-label and for ``grouping="label"``.
    reaction_nodes : (n_nodes,) bool, optional
        True where an outside body may push: no balance equation there.
    method : "auto", "sequential", "global", "regularized"
    kinematics : "small-strain", "st-venant-kirchhoff", "neo-hookean"
    plane : "strain", "stress" (2-D only)
    unknowns : "lambda-mu", or "young" with `poisson_ratio`
    grouping : "cell", "label"
    information : (n_trials, n_nodes, d, d), optional
        Inverse covariance of the measured displacements (1/length²).
    noise : float, optional
        Standard deviation of a displacement component; estimated when not given.
    refine : int, optional
        1, 4 or 16: sub-cells per cell of the forward problem of the regularized method.
    progress : callable, optional

    Raises
    ------
    InputError
        One line: what is wrong, where, how to mend it.
    """
    raise NotImplementedError
