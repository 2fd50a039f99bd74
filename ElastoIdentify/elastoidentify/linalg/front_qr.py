"""Sparse orthogonal factorisation of the balance system, front by front from the known cells.

Unknowns are ordered by levels, the number of cells between them and the known region. A node of
level k touches unknowns of levels k−1 and k only, so A is block bidiagonal: eliminating level
after level by Householder reflections needs dense matrices of the size of one front. Unlike the
normal equations this does not square the condition number, and its pivots reveal the rank.
Source: George and Heath, Solution of sparse linear least squares problems using Givens rotations
(1980), with blocks in place of rotations; rank by column pivoting, Golub and Van Loan, Matrix
Computations (2013), section 5.4.
"""

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from ..progress import Progress, silent

RANK_TOLERANCE = 1e-10  # of a column's norm: what remains of it when the others are taken out


class FrontQR:
    """R of A Π = Q R, block bidiagonal, and Qᵀ b.

    Parameters
    ----------
    A : csr_matrix (n_rows, n_cols)
    b : (n_rows,)
    row_level, col_level : int arrays
        Level of each row and column, −1 to leave it out. A row of level k has columns of levels
        k−1 and k only.
    """

    def __init__(self, A, b, row_level, col_level, progress: Progress | None = None):
        progress = progress or silent
        self.A = A
        norm = np.sqrt(np.asarray(A.multiply(A).sum(axis=0)).ravel())
        self.scale = np.where(norm > 0, 1 / np.where(norm > 0, norm, 1), 0.0)
        self.scale[col_level < 0] = 0.0
        self.n = A.shape[1]
        self.columns, self.blocks, self.rhs = [], [], []
        scaled = (A @ sp.diags(self.scale)).tocsr()
        n_levels = int(col_level.max(initial=-1)) + 1
        by_level = [np.flatnonzero(col_level == k) for k in range(n_levels)]
        carry = self._rows(scaled, b, row_level, 0, by_level, first=True)
        for k in range(n_levels):
            carry = self._eliminate(scaled, b, row_level, by_level, k, carry)
            progress((k + 1) / n_levels, f"global: front {k + 1} of {n_levels}")

    @staticmethod
    def _rows(scaled, b, row_level, level, by_level, first=False):
        """Dense rows of one level: its columns of the level before, of this level, and b."""
        rows = np.flatnonzero(row_level == level)
        part = scaled[rows].tocsc()
        here = by_level[level] if level < len(by_level) else np.empty(0, int)
        own = part[:, here].toarray()
        right = b[rows, None]
        if first:
            return np.hstack([own, right])
        return part[:, by_level[level - 1]].toarray(), np.hstack([own, right])

    def _eliminate(self, scaled, b, row_level, by_level, k, carry):
        columns = by_level[k]
        n = len(columns)
        before, after = self._rows(scaled, b, row_level, k + 1, by_level)
        front = np.vstack([carry[:, :n], before])
        trailing = np.zeros((len(front), after.shape[1]))
        trailing[: len(carry), -1] = carry[:, -1]
        trailing[len(carry) :] = after
        (reflectors, tau), R, pivot, rank = _rank_revealing_qr(front)
        trailing = _apply_qt(reflectors, tau, trailing)
        # copies: views would keep the whole fronts alive
        self.blocks.append(
            (R[:rank, :rank].copy(), R[:rank, rank:].copy(), trailing[:rank, :-1].copy())
        )
        self.columns.append((columns[pivot[:rank]], columns[pivot[rank:]]))
        self.rhs.append(trailing[:rank, -1].copy())
        rest = trailing[rank:]
        if len(rest) > rest.shape[1]:  # keep no more rows than carry information
            rest = np.linalg.qr(rest, mode="r")
        return rest

    @property
    def dead(self) -> np.ndarray:
        """Columns that depend on the others: the dimension of the null space."""
        return np.concatenate([dead for _, dead in self.columns] or [np.empty(0, int)])

    def _level_columns(self, k):
        """Columns of level k in the order of the factor's trailing blocks."""
        live, dead = self.columns[k]
        return np.sort(np.concatenate([live, dead]))

    def solve_r(self, rhs: list[np.ndarray], dead_values: np.ndarray) -> np.ndarray:
        """Solve R x = rhs for given values of the dead columns; x in the scaled unknowns.

        Parameters
        ----------
        rhs : list of (rank_k,) or (rank_k, m), one per level
        dead_values : (n,) or (n, m)
            Read at the dead columns.
        """
        x = np.array(dead_values, float)
        for k in reversed(range(len(self.blocks))):
            triangle, beside, ahead = self.blocks[k]
            live, dead = self.columns[k]
            right = rhs[k] - beside @ x[dead]
            if k + 1 < len(self.blocks):
                right = right - ahead @ x[self._level_columns(k + 1)]
            x[live] = la.solve_triangular(triangle, right, check_finite=False)
        return x

    def solve_rt(self, x: np.ndarray) -> list[np.ndarray]:
        """Solve Rᵀ y = x (live columns only); y as a list of levels."""
        y, x = [], np.array(x, float)
        for k, (triangle, _, ahead) in enumerate(self.blocks):
            live, _ = self.columns[k]
            part = la.solve_triangular(triangle, x[live], trans="T", check_finite=False)
            y.append(part)
            if k + 1 < len(self.blocks):
                x[self._level_columns(k + 1)] -= ahead.T @ part
        return y

    def solution(self) -> np.ndarray:
        """Return the least squares solution with the dead columns at zero."""
        return self.scale * self.solve_r(self.rhs, np.zeros(self.n))

    def pseudo_inverse(self, right: np.ndarray) -> np.ndarray:
        """Return A⁺ right, (n, m), by the corrected seminormal equations.

        Source: Björck, Numerical Methods for Least Squares Problems (1996), section 6.6.5.
        """
        x = self._seminormal(right)
        return x + self._seminormal(right - self.A @ x)

    def _seminormal(self, right):
        scale = self.scale.reshape((-1,) + (1,) * (right.ndim - 1))
        y = self.solve_rt(scale * (self.A.T @ right))
        return scale * self.solve_r(y, np.zeros((self.n, *right.shape[1:])))

    def condition(self) -> float:
        """Return the ratio of the largest to the smallest pivot: a lower bound of cond(A)."""
        pivots = np.concatenate([np.abs(np.diag(t)) for t, _, _ in self.blocks] or [np.ones(1)])
        return float(pivots.max() / pivots.min()) if len(pivots) else np.inf

    def undetermined(self, probes: int = 6, tolerance: float = 1e-7) -> np.ndarray:
        """Tell which columns take part in the null space, by random null vectors. (n,) bool"""
        dead = self.dead
        if len(dead) == 0:
            return self.scale == 0
        start = np.zeros((self.n, probes))
        start[dead] = np.random.default_rng(0).standard_normal((len(dead), probes))
        zero = [np.zeros((len(t), probes)) for t, _, _ in self.blocks]
        null = self.solve_r(zero, start)
        return (np.abs(null).max(axis=1) > tolerance) | (self.scale == 0)


def _rank_revealing_qr(front):
    """Return raw reflectors, R, column order and rank; pivots only where the rank asks for it.

    A dependent column shows as a small diagonal entry without pivoting, too; pivoting is several
    times slower and needed only to gather such columns at the end.
    """
    n = front.shape[1]
    if front.size == 0:  # all equations of this front were spent on the one before
        return (front, np.empty(0)), np.empty((0, n)), np.arange(n), 0
    if len(front) >= n:
        raw, R = la.qr(front, mode="raw", check_finite=False)
        if np.abs(np.diag(R)).min(initial=1.0) > 1e3 * RANK_TOLERANCE:
            return raw, R, np.arange(n), n
    raw, R, pivot = la.qr(front, mode="raw", pivoting=True, check_finite=False)
    return raw, R, pivot, int(np.count_nonzero(np.abs(np.diag(R)) > RANK_TOLERANCE))


def _apply_qt(reflectors, tau, matrix):
    if len(tau) == 0:
        return matrix
    reflectors = reflectors[:, : len(tau)]  # a front with fewer rows than columns has fewer
    ormqr, work = la.get_lapack_funcs(("ormqr",), (reflectors, matrix))[0], -1
    _, work, _ = ormqr("L", "T", reflectors, tau, matrix, -1)
    product, _, info = ormqr("L", "T", reflectors, tau, matrix, int(work[0]))
    assert info == 0
    return product
