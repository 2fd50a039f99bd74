"""The balance equations of all trials as one linear system A θ = b."""

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ..fem.assembly import force_matrices, tangent_stiffness
from ..fem.constitutive import Kinematics
from ..fem.mesh import Mesh
from .conditions import Conditions, conditions
from .parameterization import Unknowns


class BalanceSystem:
    """Σ_{unknown cells} f = −Σ_{known cells} f at every free node that touches an unknown cell.

    Parameters
    ----------
    mesh : Mesh
    law : Kinematics
    displacements : (n_trials, n_nodes, d)
    unknowns : Unknowns
    reaction : (n_nodes,) bool
        Nodes where an outside body may push: no equation.
    contact : Conditions, optional
        Instead of `reaction`, which it holds: nodes may slide, too.
    laws : list of Kinematics, optional
        Of each trial, where they differ from `law` by a stretch out of the plane.

    Attributes
    ----------
    nodes : (n_eq_nodes,) int
        The nodes that have equations.
    A, b : csr_matrix (n_equations, n_params), (n_equations,)
        Rows run over nodes, then trials, then components. Nodes that slide have fewer equations
        than components: the others are zero.
    """

    def __init__(
        self,
        mesh: Mesh,
        law: Kinematics,
        displacements: np.ndarray,
        unknowns: Unknowns,
        reaction: np.ndarray,
        contact: Conditions | None = None,
        laws: list[Kinematics] | None = None,
    ):
        self.mesh, self.law, self.unknowns = mesh, law, unknowns
        self.displacements, self.reaction = displacements, reaction
        self.laws = laws or [law] * len(displacements)
        self.conditions = contact or conditions(mesh, reaction)
        self.n_trials = len(displacements)
        self.node_cells = (self.conditions.members @ mesh.node_cells).tocsr()
        touches = self.node_cells @ (~unknowns.known).astype(float) > 0
        self.nodes = np.flatnonzero(touches & self.conditions.asked)
        self.rows = self.conditions.rows[self.dofs.ravel()]
        self.A, self.b = self._assemble(displacements)

    @property
    def rows_per_node(self) -> int:
        return self.n_trials * self.mesh.dim

    @property
    def dofs(self) -> np.ndarray:
        """Degrees of freedom of the equations' nodes, (n_eq_nodes, d), their places in `rows`."""
        return self.nodes[:, None] * self.mesh.dim + np.arange(self.mesh.dim)

    def _assemble(self, displacements):
        blocks, right = [], []
        for u, law in zip(displacements, self.laws, strict=True):
            per_lam, per_mu = force_matrices(self.mesh, law, u)
            known = per_lam @ self.unknowns.lam_known + per_mu @ self.unknowns.mu_known
            unknown = (per_lam @ self.unknowns.lam + per_mu @ self.unknowns.mu).tocsr()
            blocks.append(self.rows @ unknown)
            right.append(-(self.rows @ known))
        count = self.rows.shape[0] * self.n_trials
        order = self.by_node(np.arange(count).reshape(self.n_trials, -1))
        A = sp.vstack(blocks, format="csr")[order]
        return A, np.concatenate(right)[order]

    def by_node(self, per_trial: np.ndarray) -> np.ndarray:
        """Order (n_trials, n_eq_nodes·d) values as the rows of A are ordered."""
        d = self.mesh.dim
        return per_trial.reshape(self.n_trials, -1, d).transpose(1, 0, 2).ravel()

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Return A θ − b, the force left over."""
        return self.A @ theta - self.b

    def column_errors(self, samples: int = 4) -> np.ndarray:
        """Return what rounding of the displacements leaves in A's columns, relative. (n_params,)

        Displacements are differences of positions that the user's programs rounded; where a trial
        is mostly rigid motion, that is much of a strain. Rounding is random and so small that A is
        linear in it; it is scaled up for the difference not to be lost itself.
        """
        rng, scale = np.random.default_rng(0), 1e5
        size = np.abs(self.displacements).max(axis=(1, 2), keepdims=True)
        square = np.zeros(self.A.shape[1])
        for _ in range(samples):
            rounding = np.finfo(float).eps * size * rng.standard_normal(self.displacements.shape)
            change = self._assemble(self.displacements + scale * rounding)[0] - self.A
            square += np.asarray(change.multiply(change).sum(axis=0)).ravel() / samples
        norm = np.sqrt(np.asarray(self.A.multiply(self.A).sum(axis=0)).ravel())
        return np.sqrt(square) / scale / np.where(norm > 0, norm, np.inf)

    def stiffness_rows(self, theta: np.ndarray) -> list[sp.csr_matrix]:
        """Return ∂(equations of a trial)/∂u for each trial, (n_eq_nodes·d, n_dofs).

        A linear law has one matrix for all trials: the list then repeats it.
        """
        lam, mu = self.unknowns.moduli(theta)
        trials = self.displacements[:1] if self.law.linear else self.displacements
        pairs = zip(trials, self.laws, strict=False)
        K = [self.rows @ tangent_stiffness(self.mesh, law, u, lam, mu) for u, law in pairs]
        return K * self.n_trials if self.law.linear else K

    def force_errors(self, theta: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """Return the change of A θ − b, (n_equations, m), for errors of the displacements.

        Parameters
        ----------
        errors : (m, n_trials, n_nodes, d)
        """
        m = len(errors)
        parts = [
            K @ errors[:, t].reshape(m, -1).T for t, K in enumerate(self.stiffness_rows(theta))
        ]
        order = self.by_node(np.arange(len(self.b)).reshape(self.n_trials, -1))
        return np.concatenate(parts)[order]

    @cached_property
    def node_groups(self) -> sp.csr_matrix:
        """Incidence of equation nodes and groups: 1 where they meet. (n_eq_nodes, n_groups)."""
        u = self.unknowns
        cells = np.flatnonzero(~u.known)
        membership = sp.csr_matrix(
            (np.ones(len(cells)), (cells, u.group[cells])), (self.mesh.n_cells, u.n_groups)
        )
        incidence = (self.node_cells[self.nodes] @ membership).tocsr()
        incidence.data[:] = 1
        return incidence

    @cached_property
    def node_level(self) -> np.ndarray:
        """Number of steps from the known cells to each equation node, −1 where none leads there.

        Level 0 are the nodes that touch a known cell. (n_eq_nodes,) int
        """
        forced = (self.node_cells @ self.unknowns.known.astype(float))[self.nodes] > 0
        level = np.where(forced, 0, -1)
        N, Nt = self.node_groups, self.node_groups.T.tocsr()
        front, depth = forced, 0
        while front.any():
            depth += 1
            reached = (N @ ((Nt @ front.astype(float)) > 0).astype(float)) > 0
            front = reached & (level < 0)
            level[front] = depth
        return level

    @cached_property
    def group_level(self) -> np.ndarray:
        """Smallest level of a group's equation nodes, −1 where there is none. (n_groups,) int"""
        far = np.iinfo(np.int64).max
        level = np.where(self.node_level < 0, far, self.node_level)
        lowest = np.full(self.unknowns.n_groups, far)
        incidence = self.node_groups.tocoo()
        np.minimum.at(lowest, incidence.col, level[incidence.row])
        return np.where(lowest == far, -1, lowest)
