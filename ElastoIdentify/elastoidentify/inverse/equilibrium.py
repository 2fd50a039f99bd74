"""The forward problem of the regularized fit: displacements in balance, and their derivatives.

The motion of the reaction nodes is unknown, so that no boundary condition is assumed. Unknown are
the parameters x and, per trial, the motion b of the held (reaction) nodes; the free nodes follow
from balance, f_f(y; x) = 0 with y = Z η, η = (free, held). Columns of Z are motions of single nodes
along an axis or, where nodes slide, those of :mod:`.conditions`. Where the mesh is refined, Z
interpolates the held nodes that only the refinement has. Linearised,

    K_ff dη_f = −K_fb db − R_f dx,       K = Zᵀ (∂f/∂y) Z,   R = Zᵀ ∂f/∂x.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ..errors import InputError
from ..fem.cells import LinearCells, LockingFreeCells
from ..fem.mesh import Mesh
from ..fem.patches import PATCH_SIZE, patches, together
from ..linalg.factor import Factoriser
from .conditions import conditions
from .parameterization import LogParameters
from .problem import Problem

NEWTON_STEPS, HALVINGS = 10, 6
BALANCED = 1e-5  # a Newton step below this share of the largest displacement is the last one
LEVELS = {1: 0, 4: 1, 16: 2, 64: 3}  # refinements of the mesh by sub-cells per (planar) cell


@dataclass
class State:
    """Balanced displacements of all trials for parameters x, and what linearises them there."""

    x: np.ndarray
    eta: np.ndarray  # (n_eta, n_trials), free degrees of freedom first
    n_free: int
    K: list  # per trial (n_eta, n_eta), the same one in small strain
    factors: list  # of K_ff, per trial
    slots: np.ndarray  # (n_eta,) a degree of freedom that each entry of η moves
    R: list = field(default_factory=list)  # per trial (n_eta, n_x), see Equilibrium.add_slopes

    def __post_init__(self):
        n, K = self.n_free, {}
        for matrix in self.K:
            if id(matrix) not in K:
                K[id(matrix)] = matrix[:n, n:].tocsr()
        self.couplings = [K[id(matrix)] for matrix in self.K]  # K_fb, (n_free, n_held)
        self.R_free = []  # R_f, (n_free, n_x)

    @property
    def shared(self) -> bool:
        """True if all trials have the same K."""
        return all(K is self.K[0] for K in self.K)

    def solve(self, columns: list[np.ndarray]) -> list[np.ndarray]:
        """Return K_ff⁻¹ of each trial's columns (n_free, m); one block where K is shared."""
        if self.shared:
            widths = np.cumsum([c.shape[1] for c in columns])[:-1]
            return np.split(self.factors[0].solve(np.hstack(columns)), widths, axis=1)
        return [f.solve(c) for f, c in zip(self.factors, columns, strict=True)]

    def change(self, dx: np.ndarray, db: list[np.ndarray]) -> list[np.ndarray]:
        """Return dη (n_eta, m) of each trial for dx (n_x, m), None: 0, and its db (n_held, m)."""
        loads = [-(self.couplings[t] @ b) for t, b in enumerate(db)]
        if dx is not None:
            loads = [load - R @ dx for load, R in zip(loads, self.R_free, strict=True)]
        return [np.vstack([f, b]) for f, b in zip(self.solve(loads), db, strict=True)]

    def adjoint(self, force: list[np.ndarray], by_parameters: bool = True):
        """Return the gradients by x, (n_x, m), and by b from those by η, (n_eta, m) per trial."""
        n = self.n_free
        multipliers = self.solve([-g[:n] for g in force])
        by_x = 0
        if by_parameters:
            by_x = sum(R.T @ w for R, w in zip(self.R_free, multipliers, strict=True))
        by_b = [g[n:] + K.T @ w for g, K, w in zip(force, self.couplings, multipliers, strict=True)]
        return by_x, by_b


class Equilibrium:
    """The forward problem, on a refinement of the mesh whose cells keep their parameters.

    Parameters
    ----------
    refine : int
        1, 4 or 16 sub-cells per planar cell.
    element : str
        "locking-free" or "linear".
    """

    def __init__(self, problem: Problem, parameters: LogParameters, refine: int, element: str):
        mesh = problem.mesh
        self.problem, self.parameters, self.law = problem, parameters, problem.law
        self.mesh, parent, interpolation, last = _refined(mesh, LEVELS[refine])
        self.parent, self.element, self.refine = parent, element, refine
        self.cells = self._cells(element, refine, last)
        coarse = problem.conditions
        here = coarse if refine == 1 else self._refined_conditions(interpolation)
        self.free, self.held = here.free_slots, coarse.held_slots  # degrees of freedom of η
        self.slots = np.concatenate([self.free, self.held])
        self.n_free, self.n_eta = len(self.free), len(self.slots)
        self.by_node = coarse.plain  # η holds d numbers for each node
        # nodes that only refinement has are not measured
        self.coarse = np.concatenate([self.free, self.held]) < mesh.n_dofs  # (n_eta,) bool
        # as the held nodes move, so do those between them
        carried = here.held @ (here.held.T @ sp.kron(interpolation, sp.identity(mesh.dim)))
        self.Z = sp.hstack([here.free, carried @ coarse.held], format="csr")
        self.data = np.stack([u.ravel() for u in problem.displacements], axis=1)
        self.size = np.abs(self.data).max()
        self.factoriser = Factoriser(self.mesh.points[self.free // mesh.dim], self.law.linear)

    def _cells(self, element, refine, last):
        if element == "linear":
            return LinearCells(self.mesh, self.law.of(self.parent))
        if refine == 1:
            unknowns, labels = self.problem.unknowns, self.problem.labels
            # labels are known to differ; single cells may be parts of one tissue
            kind = np.zeros(self.mesh.n_cells, int)
            if labels is not None:
                kind = np.unique(labels, return_inverse=True)[1].ravel()
            kind = np.where(unknowns.known, -1, kind)
            patch = patches(self.mesh, together(self.mesh, kind, unknowns.lam_known))
        else:  # the sub-cells of the cell that the last refinement cut
            patch = last.copy()
            for block in self.mesh.blocks:
                if PATCH_SIZE[block.cell.name] == 1:
                    patch[block.ids] = last.max() + 1 + block.ids
            patch = np.unique(patch, return_inverse=True)[1].ravel()
        return LockingFreeCells(self.mesh, self.law.of(self.parent), patch)

    def _refined_conditions(self, interpolation):
        problem, sliding = self.problem, None
        reaction = interpolation @ problem.reaction.astype(float) > 1 - 1e-9
        if problem.sliding is not None:
            sliding = reaction & (interpolation @ problem.sliding.astype(float) > 0)
        labels = None if problem.labels is None else problem.labels[self.parent]
        return conditions(self.mesh, reaction, sliding, labels, problem.slip)

    def rest(self, x: np.ndarray) -> State:
        """Return the state of nothing moved: where measured cells may be inside out, fits begin."""
        return self._linearise(x, np.zeros((self.n_eta, self.data.shape[1])))

    def displacements(self, eta: np.ndarray) -> np.ndarray:
        """Return y of all trials, (n_trials, n_nodes, d)."""
        return (self.Z @ eta).T.reshape(eta.shape[1], -1, self.mesh.dim)

    def settle(self, x: np.ndarray, eta: np.ndarray, tell=None) -> State:
        """Return the balanced state with parameters x and held motion as in η, (n_eta, n_trials).

        The free part of η is where Newton's method starts.
        """
        n = self.n_free
        if self.law.linear:
            state = self._linearise(x, eta.copy())
            load = state.couplings[0] @ eta[n:] + self._stretch_forces(x)
            state.eta[:n] = state.factors[0].solve(-load)
            return state
        eta, K, factors = eta.copy(), [], []
        lam, mu = self._moduli(x)
        cells = self._cells_of_trials(x)
        for t in range(eta.shape[1]):
            eta[:, t], *last = self._balance(cells[t], eta[:, t], lam, mu, tell)
            K.append(last[0])
            factors.append(last[1])
        return State(x, eta, n, K, factors, self.slots)

    def _cells_of_trials(self, x):
        """The cells of each trial, which differ where the trials are stretched across the plane."""
        stretches = self.parameters.stretches(x)
        if stretches is None:
            return [self.cells] * self.data.shape[1]
        return [self.cells.stretched(e) for e in stretches]

    def _stretch_forces(self, x):
        """Forces at rest of a linear law by the stretch, (n_free, n_trials), or 0."""
        if self.parameters.stretches(x) is None:
            return 0.0
        rest, moduli = np.zeros((self.mesh.n_nodes, self.mesh.dim)), self._moduli(x)
        forces = [cells.forces(rest, *moduli).ravel() for cells in self._cells_of_trials(x)]
        return (self.Z.T @ np.stack(forces, axis=1))[: self.n_free]

    def _balance(self, cells, eta, lam, mu, tell):
        """Newton's method for the free nodes of one trial: η, and its last K and factors."""

        def forces(eta):
            u = self.displacements(eta[:, None])[0]
            return (self.Z.T @ cells.forces(u, lam, mu).ravel())[: self.n_free]

        force = forces(eta)
        for _ in range(NEWTON_STEPS):
            K = self._stiffness(self.displacements(eta[:, None])[0], lam, mu, cells)
            factors = self._factorise(K)
            step = np.zeros(self.n_eta)
            step[: self.n_free] = factors.solve(-force)
            new = self.without_inversion(eta, eta + step)
            new, force = self._nearer_to_balance(forces, eta, force, new)
            change, eta = np.abs(new - eta).max(), new
            if tell:
                tell()
            if change < BALANCED * self.size:
                break
        if not np.isfinite(eta).all():
            raise self._diverged()
        return eta, K, factors

    def finer(self) -> "Equilibrium":
        """Return the forward problem on cells half as large."""
        return Equilibrium(self.problem, self.parameters, 4 * self.refine, self.element)

    @property
    def measured(self) -> sp.csr_matrix:
        """How the measured nodes' part of η moves them, (n_dofs of the nodes, k); orthonormal."""
        return self.Z[: self.problem.mesh.n_dofs][:, np.flatnonzero(self.coarse)]

    def _linearise(self, x, eta):
        """The state at η, with the matrix of its first trial for all."""
        lam, mu = self._moduli(x)
        trials = eta.shape[1]
        K = self._stiffness(self.displacements(eta[:, :1])[0], lam, mu)
        factors = [self._factorise(K)] * trials
        return State(x, eta, self.n_free, [K] * trials, factors, self.slots)

    def _moduli(self, x):
        lam, mu = self.parameters.moduli(x)
        return lam[self.parent], mu[self.parent]

    def _stiffness(self, u, lam, mu, cells=None):
        return (self.Z.T @ (cells or self.cells).tangent(u, lam, mu) @ self.Z).tocsr()

    def add_slopes(self, state: State):
        """Give a state the derivatives of its forces by the parameters."""
        # one product, not a sum of two: fewer entries cancel, so that the pattern seldom changes
        slopes = [part[self.parent] for part in self.parameters.slopes(state.x)]
        slopes = sp.vstack(slopes, format="csc")
        state.R = []
        cells = self._cells_of_trials(state.x)
        for t, u in enumerate(self.displacements(state.eta)):
            R = self.Z.T @ (sp.hstack(cells[t].force_matrices(u), format="csc") @ slopes)
            column = self.parameters.stretch_column(t)
            if column is not None:
                lam, _ = self._moduli(state.x)
                R = R + sp.csr_matrix(self.Z.T @ cells[t].across_slope(u, lam)[:, None]) @ column
            state.R.append(R.tocsr())
        state.R_free = [R[: self.n_free].tocsr() for R in state.R]

    def _factorise(self, K):
        n = self.n_free
        try:
            return self.factoriser(K[:n, :n])
        except RuntimeError as failed:
            raise self._diverged() from failed

    def _diverged(self):
        inverted = self.problem.inverted
        if inverted is not None and inverted.any():
            return InputError(
                f"the {self.law.name} fit does not converge: the displacements turn "
                f"{inverted.sum()} of {len(inverted)} cells inside out; the registration was lost, "
                "so check it, or take small-strain kinematics to see where"
            )
        return InputError(
            f"the {self.law.name} fit does not converge: a cell inverts; push less, use a coarser "
            "mesh or fewer sub-cells (refine), or check the registration"
        )

    def moved(self, state: State, dx: np.ndarray | None, db: list[np.ndarray]) -> np.ndarray:
        """Return η after a step dx (n_x,), None: 0, and db (n_held,) per trial, to first order."""
        dx = dx if dx is None else dx[:, None]
        changes = np.hstack(state.change(dx, [b[:, None] for b in db]))
        if self.law.linear:
            return state.eta + changes
        pairs = zip(state.eta.T, changes.T, strict=True)
        return np.stack([self.without_inversion(eta, eta + d) for eta, d in pairs], axis=1)

    def _nearer_to_balance(self, forces, eta, force, new):
        """Return new, halfway back to η for as long as its forces are the larger, and its forces.

        Newton's step leads to smaller forces at first, also where the body would buckle.
        """
        size = np.linalg.norm(force)
        for _ in range(HALVINGS):
            left = forces(new)
            if np.linalg.norm(left) < size or np.abs(new - eta).max() < BALANCED * self.size:
                break
            new = (eta + new) / 2
        return new, left

    def without_inversion(self, eta, new):
        """Return new, halfway back to η for as long as it turns cells inside out that η does not.

        Nodes that are hardly measured go far in a step.
        """

        def inverted(at):
            return self.mesh.n_inverted(self.displacements(at[:, None])[0])

        before = inverted(eta)
        for _ in range(HALVINGS):
            if inverted(new) <= before:
                break
            new = (eta + new) / 2
        return new


def _refined(mesh: Mesh, levels: int):
    """The mesh refined: itself, each cell's ancestor, interpolation, and parent of the last cut."""
    parent = last = np.arange(mesh.n_cells)
    interpolation = sp.identity(mesh.n_nodes, format="csr")
    for _ in range(levels):
        mesh, last, between = mesh.refined()
        parent, interpolation = parent[last], (between @ interpolation).tocsr()
    return mesh, parent, interpolation, last
