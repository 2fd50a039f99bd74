"""What a problem gives to a method, and what is kept from it until the scores."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Case:
    """One problem at one level of noise, as every method gets it. Numpy arrays only.

    Attributes
    ----------
    points : (n_nodes, d)
    kind : str
        "triangle", "quad", "tetra" or "hexahedron".
    cells : (n_cells, k) int
    displacements : (n_trials, n_nodes, d)
        As measured, with noise.
    reaction : (n_nodes,) bool
        Nodes where an outside body may push.
    known : (n_cells, 2)
        E and ν of the known cells, NaN elsewhere.
    poisson : float or None
        ν of the unknown cells where the problem gives it; None: both constants are sought.
    plane, kinematics : str
        As in `elastoidentify.identify`.
    information : (n_trials, n_nodes, d, d), optional
        Inverse covariance of the displacements, of problems that start from images.
    forces : (n_trials, n_nodes, d), optional
        Outside forces on the nodes, for methods that need them instead of known cells; the nodes in
        `clamped` then do not move.
    clamped : (n_nodes,) bool, optional
    axis : int
        Direction of the push of the first trial.
    """

    points: np.ndarray
    kind: str
    cells: np.ndarray
    displacements: np.ndarray
    reaction: np.ndarray
    known: np.ndarray
    poisson: float | None = None
    plane: str = "strain"
    kinematics: str = "small-strain"
    information: np.ndarray | None = None
    forces: np.ndarray | None = None
    clamped: np.ndarray | None = None
    axis: int = -1

    @property
    def is_known(self) -> np.ndarray:
        """(n_cells,) bool"""
        return np.isfinite(self.known[:, 0])


@dataclass(frozen=True)
class Truth:
    """What only the scores see: E and ν per cell, and the regions between which contrast is read.

    Attributes
    ----------
    young, poisson : (n_cells,)
    regions : {name: (n_cells,) bool}
        The region named "background" is what the others are compared with.
    """

    young: np.ndarray
    poisson: np.ndarray
    regions: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Estimate:
    """What a method answers; NaN where it leaves a cell open."""

    young: np.ndarray  # (n_cells,)
    young_std: np.ndarray | None = None  # None: the method states no uncertainty
    poisson: np.ndarray | None = None
    remarks: dict = field(default_factory=dict)  # JSON-ready: versions, steps, a verdict


class Skip(Exception):
    """Raised by a problem or a method that cannot run here; the text says why."""
