"""Solvers of the Gauss-Newton system of the regularized fit.

Unknown are changes of the parameters, dx, and of the held nodes' motion, db of each trial; the free
nodes follow from balance (:mod:`.equilibrium`), and J maps both to the measured numbers:

    (P + Σ Jᵀ W J / σ²) (dx, db) = (p, 0) + Σ Jᵀ W v / σ²

with p a force on the parameters (the prior's gradient, or a sample of the prior) and v changes of
the measured numbers (the residuals, or a sample of their errors). Neither solver forms the matrix.

In space conjugate gradients take products: one forward and one adjoint solution with factors of
K_ff, all trials and columns in one block, preconditioned by P and the weights of the held nodes. In
the plane, where displacements are all that is measured, one sparse factorisation is cheaper: the
held motion is eliminated in the norm of the measured displacements, S = K C Kᵀ, which leaves

    [ P    Rᵀ  ]
    [ R  −σ²S  ]   (one block row per trial),

a quasi-definite matrix, whose LDLᵀ exists for any ordering (Vanderbei, SIAM J. Optim. 5, 1995). In
space its factors fill up, and S has several times the entries of K's.
"""

from collections.abc import Callable

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from ..linalg.blocks import Blocks
from ..linalg.factor import Factoriser
from .equilibrium import State
from .misfit import Misfit, difference

TOLERANCE, LIMIT = 0.003, 300  # of the conjugate gradients: relative residual, steps
REFIT = 0.003  # tolerance of the held nodes' motion alone
COARSE = 0.05  # where its square matters
FEW = 100  # parameters for which the preconditioner holds the data's own curvature
UNMEASURED = 1e4  # variance of nodes that only refinement has, over that of measured nodes
_TINY = np.finfo(float).tiny


class DirectSystem:
    """The system by one factorisation of the quasi-definite matrix; displacements only.

    Parameters
    ----------
    parameter_places : (n_x, d); node_places : (n_free, d)
        Where the parameters and the force equations of one trial are.
    """

    def __init__(self, parameter_places, node_places):
        self.parameter_places, self.node_places = parameter_places, node_places
        self.factorise_S, self.factorise_all = Factoriser(node_places), None
        self.together, self._covariances, self.state = Blocks(), {}, None

    def refit(self, state: State, misfit: Misfit, tell=None) -> list[np.ndarray]:
        """Return the db, (n_held,) per trial, of the balanced displacements nearest to measured."""
        self._take(state, misfit)
        out, solver = [], None
        for t, (K, C, S) in enumerate(zip(self.K, self.C, self.S, strict=True)):
            if solver is None or S is not self.S[t - 1]:
                solver = self.factorise_S(S)
            v = self.observations[t].by_eta.T @ self.observations[t].residual
            q = solver.solve(K @ v)
            q += solver.solve(K @ v - S @ q)  # S squares K's condition: refine once
            out.append((v - C @ (K.T @ q))[self.n_free :])
        return out

    def _take(self, state, misfit):
        """Take the matrices K, C and S = K C Kᵀ of each trial, once for each state."""
        (self.observations,) = misfit.terms
        if state is self.state:
            return
        self.state, n = state, state.n_free
        self.n_free, self.K, self.S = n, [K[:n] for K in state.K], []
        self.C = [self._covariance(o) for o in self.observations]
        for t, (K, C) in enumerate(zip(self.K, self.C, strict=True)):
            same = t and state.shared and C is self.C[0]
            self.S.append(self.S[0] if same else (K @ C @ K.T).tocsc())

    def _covariance(self, o):
        """C on all of η: nodes without measurement are nearly free. One for all states."""
        key = id(o.root)
        if key not in self._covariances:
            C = o.by_eta.T @ (o.root @ o.root.T) @ o.by_eta
            missing = C.diagonal() == 0
            nearly_free = missing * UNMEASURED * np.median(C.diagonal()[~missing])
            self._covariances[key] = o.root, (C + sp.diags(nearly_free)).tocsr()
        return self._covariances[key][1]

    def factorise(self, P: sp.spmatrix, state: State, misfit: Misfit, scale: float, extra=None):
        """Take new matrices; the force rows get a unit diagonal of σ²S.

        `extra` (n_free, n_free) is added to σ²S: the covariance of forces that the law lacks.
        """
        self._take(state, misfit)
        self.scale = scale
        rows, self.row_scale = [[P] + [None] * len(self.K)], []
        for t, S in enumerate(self.S):
            S = S if extra is None else S + extra / scale**2
            s = 1 / (scale * np.sqrt(S.diagonal()))
            R = _scaled(state.R_free[t], s)
            rows[0][t + 1] = R.T
            row = [R] + [None] * len(self.K)
            row[t + 1] = _scaled(S, -(scale**2) * s, s)
            rows.append(row)
            self.row_scale.append(s)
        matrix = self.together(rows)
        if self.factorise_all is None:
            places = np.vstack([self.parameter_places, *[self.node_places] * len(self.K)])
            self.factorise_all = Factoriser(places, definite=False)
        self.solver = self.factorise_all(matrix)

    def solve(self, parameter_part, numbers, start=None, tell=None, tolerance=None):
        """Return dx (n_x, m) and db (n_held, m) of each trial; `numbers` per term and trial.

        With e = v − dη the part of v that stays, K e = K v + R dx and e = σ² C Kᵀ q,
        q = (σ²S)⁻¹ (K v + R dx).
        """
        (v,) = numbers
        v = [o.by_eta.T @ part for o, part in zip(self.observations, v, strict=True)]
        dx, q = self._solved(parameter_part, [K @ part for K, part in zip(self.K, v, strict=True)])
        left = zip(v, self.C, self.K, q, strict=True)
        db = [(part - self.scale**2 * (C @ (K.T @ one)))[self.n_free :] for part, C, K, one in left]
        return dx, db

    def multipliers(self, parameter_part, numbers, forces=None) -> list[np.ndarray]:
        """Return q (n_free, m) of each trial, see `solve`; `forces` (n_free, m) add to K v."""
        (v,) = numbers
        seen = zip(self.K, self.observations, v, strict=True)
        load = [K @ (o.by_eta.T @ part) for K, o, part in seen]
        if forces is not None:
            load = [one + more for one, more in zip(load, forces, strict=True)]
        return self._solved(parameter_part, load)[1]

    def _solved(self, parameter_part, load):
        """dx and q of each trial for the forces K v."""
        force = [-s[:, None] * one for s, one in zip(self.row_scale, load, strict=True)]
        found = self.solver.solve(np.concatenate([parameter_part, *force]))
        n, parts = len(parameter_part), []
        for t, s in enumerate(self.row_scale):
            parts.append(s[:, None] * found[n + t * self.n_free :][: self.n_free])
        return found[:n], parts


class ReducedSystem:
    """The system by its products; preconditioned conjugate gradients, all columns at once.

    Parameters
    ----------
    parameter_places : (n_x, d)
    dim : int
        Degrees of freedom per node.
    """

    def __init__(self, parameter_places, dim: int):
        self.factoriser, self.dim, self.blocks = Factoriser(parameter_places), dim, {}

    def refit(self, state: State, misfit: Misfit, tell=None) -> list[np.ndarray]:
        """Return the db, (n_held,) per trial, of the balanced displacements nearest to measured."""
        least = REFIT**2 * misfit.value()  # to gain less is no gain
        found = self._held_motion(state, misfit, misfit.residuals(), tell, REFIT, least)
        return [b[:, 0] for b in found]

    def unexplained(self, state: State, misfit: Misfit, dx: np.ndarray, tell=None):
        """Return what dx (n_x, m) changes of the numbers and the held motion could not.

        Per term and trial, (k, m).
        """
        at_rest = [np.zeros((K.shape[1], dx.shape[1])) for K in state.couplings]
        seen = misfit.seen(dx, state.change(dx, at_rest))
        db = self._held_motion(state, misfit, seen, tell, COARSE)
        like = misfit.seen(None, state.change(None, db))
        return difference(seen, like)

    def _held_motion(self, state, misfit, numbers, tell, tolerance, least=0.0):
        """The db of each trial, (n_held, m), that comes nearest to numbers, dx held fast."""
        self.P, self.state, self.misfit, self.scale = None, state, misfit, 1.0
        self.of_b = self._held_blocks()
        right = self._gradient(numbers)[1:]
        fixed = np.zeros((0, right[0].shape[1]))
        return self._solve([fixed, *right], None, tell, tolerance, least)[1]

    def factorise(self, P: sp.spmatrix, state: State, misfit: Misfit, scale: float):
        """Take new matrices."""
        self.P, self.state, self.misfit, self.scale = P, state, misfit, scale
        self.of_b = self._held_blocks()
        if P.shape[0] > FEW:
            self.of_x = self.factoriser(P)
            return
        # few parameters have a weak prior: what the data say of them is all that matters
        at_rest = [np.zeros((K.shape[1], P.shape[0])) for K in state.couplings]
        dx = np.identity(P.shape[0])
        H = P + misfit.gram(misfit.seen(dx, state.change(dx, at_rest)), scale)
        self.of_x = Dense(H)

    def _held_blocks(self):
        """Per trial the inverse of a node-wise guess of the held nodes' part of the system.

        A held node takes the free nodes beside it along, so their weights count like its own: they
        keep a node in its place that is hardly measured itself.
        """
        out = []
        for t in range(len(self.state.K)):
            parts = [term[t] for term in self.misfit.terms]
            alike = all(o.scaled for o in parts)  # then the noise is a factor
            scale = 1.0 if alike else self.scale
            key = (scale, *(id(one) for o in parts for one in (o.weight, o.by_eta)))
            if key not in self.blocks:  # and what its numbers stand for is kept alive
                self.blocks[key] = parts, self._blocks_of(t, parts, scale)
            out.append(self.blocks[key][1] * (self.scale**2 if alike else 1.0))
        return out

    def _blocks_of(self, t, parts, scale):
        """The inverse blocks of one trial; which nodes touch is the same in all states."""
        n, d = self.state.n_free, self.dim
        free, held = (_padding(part, d) for part in np.split(self.state.slots, [n]))
        self.held = held.tocsc().indices  # where the padded blocks have the held motion
        H = sum(o.by_eta.T @ (o.weight / o.factor(scale)) @ o.by_eta for o in parts).tocsr()
        beside = _diagonal_blocks(free @ H[:n, :n] @ free.T, d)
        own = _diagonal_blocks(held @ H[n:, n:] @ held.T, d)
        near = _neighbours(free @ self.state.couplings[t] @ held.T, d)
        near = near.multiply(1 / np.maximum(near.sum(axis=1), 1)).tocsr()
        mean = (near @ beside.reshape(len(beside), -1)).reshape(-1, d, d)
        return np.linalg.inv(own + mean + _unused(held, d, H.diagonal().mean()))

    def solve(
        self, parameter_part, numbers, start=None, tell: Callable[[], None] | None = None,
        tolerance: float | np.ndarray = TOLERANCE,
    ):  # fmt: skip
        """Return dx (n_x, m) and db (n_held, m) of each trial.

        Parameters
        ----------
        parameter_part : (n_x, m)
        numbers : per term and trial (k, m)
        start : (dx, db), optional
            A guess; the solution of the step before is a good one.
        tell : callable, optional
            Called at each step.
        tolerance : float or (m,)
            Of the residual, relative to the right side, in the preconditioner's norm.
        """
        right = self._gradient(numbers)
        right[0] = right[0] + parameter_part
        return self._solve(right, start, tell, tolerance)

    def _solve(self, right, start, tell, tolerance, least=0.0):
        target = np.maximum(tolerance**2 * _dot(right, self._precondition(right)), least)
        if start is None:
            x, residual = [0 * part for part in right], right
        else:
            x = [start[0].copy(), *(b.copy() for b in start[1])]
            residual = [a - c for a, c in zip(right, self._product(x), strict=True)]
        direction = z = self._precondition(residual)
        size = _dot(residual, z)
        found, columns = [part.copy() for part in x], np.arange(len(size))
        for _ in range(LIMIT):
            going = size > target
            if not going.all():  # columns that are found cost no more
                for whole, part in zip(found, x, strict=True):
                    whole[:, columns] = part
                columns, size, target = columns[going], size[going], target[going]
                if not len(columns):
                    break
                x, residual, direction = (
                    [part[:, going] for part in parts] for parts in (x, residual, direction)
                )
            if tell:
                tell()
            image = self._product(direction)
            length = size / np.maximum(_dot(direction, image), _TINY)
            x = [a + length * p for a, p in zip(x, direction, strict=True)]
            residual = [a - length * q for a, q in zip(residual, image, strict=True)]
            z = self._precondition(residual)
            before, size = size, _dot(residual, z)
            turn = size / np.maximum(before, _TINY)
            direction = [a + turn * p for a, p in zip(z, direction, strict=True)]
        else:
            for whole, part in zip(found, x, strict=True):
                whole[:, columns] = part
        return found[0], found[1:]

    def _product(self, v):
        """(P + JᵀWJ/σ²) v for v = [dx, db of each trial]; dx without rows: held fast."""
        dx = v[0] if self.P is not None else None
        out = self._gradient(self.misfit.seen(dx, self.state.change(dx, v[1:])))
        out[0] = v[0] if dx is None else out[0] + self.P @ dx
        return out

    def _gradient(self, numbers):
        """JᵀW/σ² applied to numbers."""
        by_eta, by_x = self.misfit.weighted(numbers, self.scale)
        adjoint_x, by_b = self.state.adjoint(by_eta, self.P is not None)
        return [adjoint_x + by_x, *by_b]

    def _precondition(self, r):
        out = [r[0] if self.P is None else self.of_x.solve(r[0])]
        for blocks, part in zip(self.of_b, r[1:], strict=True):
            padded = np.zeros((len(blocks) * self.dim, part.shape[1]))
            padded[self.held] = part
            padded = padded.reshape(len(blocks), self.dim, part.shape[1])
            moved = np.einsum("nij,njm->nim", blocks, padded).reshape(-1, part.shape[1])
            out.append(moved[self.held])
        return out


class Dense:
    """The inverse of a small symmetric positive definite matrix, as factors have it."""

    def __init__(self, matrix):
        self.factor = la.cho_factor(np.asarray(matrix))

    def solve(self, right):
        return la.cho_solve(self.factor, right)


def _dot(a, b):
    return sum(np.einsum("ij,ij->j", p, q) for p, q in zip(a, b, strict=True))


def _scaled(A, rows, columns=None):
    """diag(rows) A diag(columns) of a sparse matrix by columns or rows."""
    major, minor = (rows, columns) if A.format == "csr" else (columns, rows)
    data = A.data
    if major is not None:
        data = data * np.repeat(major, np.diff(A.indptr))
    if minor is not None:
        data = data * minor[A.indices]
    return type(A)((data, A.indices, A.indptr), A.shape)


def _padding(slots, d):
    """Return E, (n d, columns): d places for every node, of which sliding ones use fewer."""
    _, node = np.unique(slots // d, return_inverse=True)
    place, columns = node.ravel() * d + slots % d, np.arange(len(slots))
    shape = (d * (node.max(initial=-1) + 1), len(slots))
    return sp.csr_matrix((np.ones(len(slots)), (place, columns)), shape)


def _unused(padding, d, size):
    """Return diagonal blocks, (n, d, d), that make a matrix definite where no column is."""
    empty = np.diff(padding.indptr) == 0
    return size * empty.reshape(-1, d)[:, :, None] * np.eye(d)


def _diagonal_blocks(H, d):
    """The d × d blocks on the diagonal of a sparse matrix, (n/d, d, d)."""
    H = sp.coo_matrix(H)
    same = H.row // d == H.col // d
    row, col = H.row[same], H.col[same]
    blocks = np.zeros((H.shape[0] // d, d, d))
    np.add.at(blocks, (row // d, row % d, col % d), H.data[same])
    return blocks


def _neighbours(coupling, d):
    """Incidence of held nodes and the free nodes beside them, from K_fb. (n_held, n_free)"""
    K = coupling.tocoo()
    shape = (coupling.shape[1] // d, coupling.shape[0] // d)
    near = sp.csr_matrix((np.ones(K.nnz), (K.col // d, K.row // d)), shape)
    near.data[:] = 1.0
    return near
