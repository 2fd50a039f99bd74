"""What a method is given and what it returns."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..fem.constitutive import Kinematics
from ..fem.contact import Pairs
from ..fem.mesh import Mesh
from .conditions import Conditions, conditions
from .motion import one_direction
from .observations import DisplacementNoise
from .out_of_plane import Stretch
from .parameterization import Unknowns


@dataclass(frozen=True)
class Problem:
    """One identification problem, checked, in the mesh's own dimension d."""

    mesh: Mesh
    law: Kinematics
    displacements: np.ndarray  # (n_trials, n_nodes, d)
    unknowns: Unknowns
    reaction: np.ndarray  # (n_nodes,) bool
    noise: DisplacementNoise
    refine: int | None = None
    element: str = "locking-free"  # of the regularized method's forward problem, or "linear"
    labels: np.ndarray | None = None  # (n_cells,) int: cells of different labels are not averaged
    slip: Pairs = ()  # pairs of labels that slide on each other
    sliding: np.ndarray | None = None  # (n_nodes,) bool: reaction nodes that are pushed across only

    stretch: Stretch | None = None  # out of the plane
    look_at: np.ndarray | None = None  # (d,) place for which it is asked what could be seen
    inverted: np.ndarray | None = None  # (n_cells,) bool: inside out in some trial as measured
    still: np.ndarray | None = None  # (n_trials,) bool: nothing but errors and a rigid motion

    def laws(self, stretches: np.ndarray | None = None) -> list[Kinematics]:
        """Return the law of each trial, with the stretches out of the plane given or found."""
        if stretches is None:
            stretches = self.stretch and self.stretch.centre
        if stretches is None:
            return [self.law] * len(self.displacements)
        return [self.law.stretched(e) for e in stretches]

    @cached_property
    def one_direction(self) -> bool:
        """Whether all pushes are of nearly one direction."""
        pushes = self.displacements if self.still is None else self.displacements[~self.still]
        return one_direction(self.mesh.points, pushes)

    @cached_property
    def conditions(self) -> Conditions:
        """Where balance is asked, and how nodes may move."""
        return conditions(self.mesh, self.reaction, self.sliding, self.labels, self.slip)


@dataclass(frozen=True)
class ModelMisfit:
    """Where the model does not fit, see :mod:`.model_misfit`.

    Attributes
    ----------
    share : (n_cells,)
        Of the local misfit, unexplained by noise, 0 to 1.
    stress : (n_cells,)
        Size of the stress that the law lacks over the size of the law's stress.
    scale : float
        The noise scale beside it.
    """

    share: np.ndarray
    stress: np.ndarray
    scale: float


@dataclass(frozen=True)
class Astray:
    """Displacements that a fit does not follow, see :mod:`.astray`.

    Attributes
    ----------
    lost : (n_trials, n_nodes)
        How far those that are not believed are from the fit's (length), 0 for all others.
    patch : (n_trials, n_nodes)
        Likewise those of many nodes, or of nodes side by side. They are believed for all that: they
        may be right, and the model wrong.
    """

    lost: np.ndarray
    patch: np.ndarray


@dataclass
class Estimate:
    """What a method found. In plane stress λ stands for λ*.

    Attributes
    ----------
    lam, mu : (n_cells,)
        NaN where nothing was found.
    lam_errors, mu_errors : (n_cells, m)
        Samples of the error; their root mean square is the standard deviation.
    order : (n_cells,) int
        Step of the sequential method, −1 otherwise.
    report : dict
    warnings : list of str
    misfit : ModelMisfit, optional
        Where the model does not fit; None where the method cannot tell.
    stretches : (n_trials,), optional
        Found out of the plane.
    edges : (k, 2) int, optional
        Cells on either side of an edge of the map that no label follows.
    astray : Astray, optional
        Displacements that the fit does not follow, see :mod:`.astray`.
    """

    lam: np.ndarray
    mu: np.ndarray
    lam_errors: np.ndarray
    mu_errors: np.ndarray
    order: np.ndarray
    report: dict = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    misfit: ModelMisfit | None = None
    stretches: np.ndarray | None = None
    edges: np.ndarray | None = None
    astray: Astray | None = None

    @property
    def lam_std(self):
        return np.sqrt((self.lam_errors**2).mean(axis=1))

    @property
    def mu_std(self):
        return np.sqrt((self.mu_errors**2).mean(axis=1))


def estimate_from_theta(problem: Problem, theta, errors, order=None, **report) -> Estimate:
    """Return the Estimate of parameters θ (NaN: not found) and samples of their error."""
    unknowns, missing = problem.unknowns, ~np.isfinite(theta)
    lam, mu = unknowns.moduli(np.where(missing, 0, theta))
    errors = np.where(missing[:, None], 0, errors)
    lam_errors, mu_errors = unknowns.lam @ errors, unknowns.mu @ errors
    for rows, *arrays in ((unknowns.lam, lam, lam_errors), (unknowns.mu, mu, mu_errors)):
        for array in arrays:
            array[rows @ missing.astype(float) != 0] = np.nan
    cells = ~unknowns.known
    steps = np.full(len(lam), -1)
    if order is not None:
        steps[cells] = order[unknowns.group[cells]]
    return Estimate(lam, mu, lam_errors, mu_errors, steps, report)
