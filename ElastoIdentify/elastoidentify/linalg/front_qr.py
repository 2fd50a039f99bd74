"""Sparse orthogonal factorisation of the balance system, front by front from the known cells.

Unknowns are ordered by levels, the number of cells between them and the known region. A node of
level k touches unknowns of levels k−1 and k only, so A is block bidiagonal: eliminating level
after level by Householder reflections needs dense matrices of the size of one front. Unlike the
normal equations this does not square the condition number, and its pivots reveal the rank.
Source: George and Heath, Solution of sparse linear least squares problems using Givens rotations
(1980), with blocks in place of rotations; rank by column pivoting, Golub and Van Loan, Matrix
Computations (2013), section 5.4.

What counts as zero. The factor is the exact one of A + E, with ‖E e_j‖ ≤ (γ + ε_j) ‖A e_j‖: γ is
the backward error of Householder reflections (Higham, Accuracy and Stability of Numerical
Algorithms, 2002, theorem 19.4, with square roots, as its section 2.8 argues for real sums), ε_j
that of the data. A column that the others span, A x = 0 with x_j = 1, therefore leaves a pivot
|r_jj| = ‖E x‖ that is of the size of ‖(γ + ε) x‖ and not of a constant: it may be any number
where the others are ill-conditioned. A pivot tells apart from zero where it is `MARGIN` times that,
and with `MARGIN` far above one neither the order of a sum nor the kernel that forms it moves a
pivot across.
"""

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from ..progress import Progress, silent

EPS = np.finfo(float).eps
MARGIN = 100.0  # pivots up to so many times the round-off in them are grey, and count as zero
DOUBTFUL = 1e-5  # larger pivots, of columns of norm one, are above any round-off
# Share of the null space in a column that does not matter: 1e-6 of an amplitude that other
# columns, with values that are physical, cannot carry beyond a hundred times the column's own.
NEGLIGIBLE = 1e-6
WELL_CHOSEN = 1e2  # norm of a null vector with a one in its dependent column
EXCHANGES = 3  # at most; one is nearly always enough
MOST_NUMBERS = 20_000_000  # of a dense null space basis; beyond, random vectors stand for it


class FrontQR:
    """R of A Π = Q R, block bidiagonal, and Qᵀ b.

    Parameters
    ----------
    A : csr_matrix (n_rows, n_cols)
    b : (n_rows,)
    row_level, col_level : int arrays
        Level of each row and column, −1 to leave it out. A row of level k has columns of levels
        k−1 and k only.
    error : (n_cols,), optional
        Norm of the error that the data leave in each column, as a share of the column's norm.
    """

    def __init__(self, A, b, row_level, col_level, progress: Progress | None = None, error=None):
        progress = progress or silent
        self.A = A
        self._error = np.zeros(A.shape[1]) if error is None else np.asarray(error, float)
        self._gamma, self._reflections = 0.0, 0
        self.left_out = np.empty(0, int)  # dependent columns, see :meth:`revealing`
        self.norm = norm = np.sqrt(np.asarray(A.multiply(A).sum(axis=0)).ravel())
        self.scale = np.where(norm > 0, 1 / np.where(norm > 0, norm, 1), 0.0)
        self.scale[col_level < 0] = 0.0
        self.n = A.shape[1]
        self.columns, self.blocks, self.rhs = [], [], []
        scaled = (A @ sp.diags(self.scale)).tocsr()
        n_levels = int(col_level.max(initial=-1)) + 1
        self.by_level = by_level = [np.flatnonzero(col_level == k) for k in range(n_levels)]
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
        # every reflection of this front and of those before it may have rounded
        self._reflections += n
        self._gamma = EPS * np.sqrt(self._reflections)
        (reflectors, tau), R, pivot, rank = self._rank_revealing_qr(front, k)
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

    @classmethod
    def revealing(cls, A, b, row_level, col_level, progress: Progress | None = None, error=None):
        """Return the factor with a well-conditioned choice of the columns that count as dependent.

        The fronts call the last of some dependent columns dead. Where its share of the null space
        is small, the columns that are left are nearly dependent themselves. Then those with a
        large share are left out in its place, as Gu and Eisenstat, Efficient algorithms for
        computing a strong rank-revealing QR factorization (1996), exchange columns.
        """
        factor = cls(A, b, row_level, col_level, progress, error)
        for _ in range(EXCHANGES):
            dependent = factor.dependent
            if not 0 < len(dependent) * factor.n <= MOST_NUMBERS:
                break
            vectors = factor._null_vectors(np.eye(len(dependent)))
            norm = np.linalg.norm(vectors, axis=0)
            if norm.max() < WELL_CHOSEN:
                break
            pivot = la.qr((vectors / norm).T, mode="r", pivoting=True, check_finite=False)[1]
            level = np.array(col_level)
            level[pivot[: len(dependent)]] = -1
            factor = cls(A, b, row_level, level, None, error)
            factor.left_out = pivot[: len(dependent)]
        return factor

    @property
    def dead(self) -> np.ndarray:
        """Columns of the fronts that depend on the others."""
        return np.concatenate([dead for _, dead in self.columns] or [np.empty(0, int)])

    def _rank_revealing_qr(self, front, k):
        """Return raw reflectors, R, column order and rank; pivots only where the rank asks for it.

        A dependent column shows as a small diagonal entry without pivoting, too; pivoting is
        several times slower and needed only to gather such columns at the end.
        """
        n = front.shape[1]
        if front.size == 0:  # all equations of this front were spent on the one before
            return (front, np.empty(0)), np.empty((0, n)), np.arange(n), 0
        if len(front) >= n:
            raw, R = la.qr(front, mode="raw", check_finite=False)
            if np.abs(np.diag(R)).min(initial=1.0) > DOUBTFUL:
                return raw, R, np.arange(n), n
        raw, R, pivot = la.qr(front, mode="raw", pivoting=True, check_finite=False)
        return raw, R, pivot, self._rank(R, pivot, k)

    def _rank(self, R, pivot, k):
        """Count the pivots of front k that lie above their round-off by the margin."""
        size = np.abs(np.diag(R))
        sure = int(np.count_nonzero(size > DOUBTFUL))
        last = int(np.count_nonzero(size > EPS))
        if sure == last:
            return sure
        # x_j = r_jj R⁻¹ e_j combines column j with those before it; A x_j has the norm |r_jj|
        unit = np.zeros((last, last - sure))
        unit[np.arange(sure, last), np.arange(last - sure)] = np.diag(R)[sure:last]
        x = np.zeros((self.n, last - sure))
        x[self.by_level[k][pivot[:last]]] = la.solve_triangular(
            R[:last, :last], unit, check_finite=False
        )
        self._solve_up_to(k, x, None)
        round_off = np.linalg.norm((self._gamma + self._error)[:, None] * x, axis=0)
        dead = np.flatnonzero(~(size[sure:last] > MARGIN * round_off))
        return sure + int(dead[0]) if len(dead) else last

    @property
    def dependent(self) -> np.ndarray:
        """Columns left out or dead: as many as the null space has dimensions."""
        return np.concatenate([self.left_out, self.dead])

    def solve_r(self, rhs: list[np.ndarray], dead_values: np.ndarray) -> np.ndarray:
        """Solve R x = rhs for given values of the dead columns; x in the scaled unknowns.

        Parameters
        ----------
        rhs : list of (rank_k,) or (rank_k, m), one per level
        dead_values : (n,) or (n, m)
            Read at the dead columns.
        """
        x = np.array(dead_values, float)
        self._solve_up_to(len(self.blocks), x, rhs)
        return x

    def _solve_up_to(self, top, x, rhs):
        """Set x in the levels below `top`, given its values in the others; rhs None is zero."""
        for k in reversed(range(top)):
            triangle, beside, ahead = self.blocks[k]
            live, dead = self.columns[k]
            right = -(beside @ x[dead])
            if rhs is not None:
                right += rhs[k]
            if k + 1 < len(self.by_level):
                right -= ahead @ x[self.by_level[k + 1]]
            x[live] = la.solve_triangular(triangle, right, check_finite=False)

    def solve_rt(self, x: np.ndarray) -> list[np.ndarray]:
        """Solve Rᵀ y = x (live columns only); y as a list of levels."""
        y, x = [], np.array(x, float)
        for k, (triangle, _, ahead) in enumerate(self.blocks):
            live, _ = self.columns[k]
            part = la.solve_triangular(triangle, x[live], trans="T", check_finite=False)
            y.append(part)
            if k + 1 < len(self.blocks):
                x[self.by_level[k + 1]] -= ahead.T @ part
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

    def undetermined(self) -> np.ndarray:
        """Tell which columns take part in the null space, or may for all one can tell. (n,) bool

        The rows of an orthonormal basis of the null space have norms that do not depend on the
        basis, and so not on which of several equal pivots a kernel took first.
        """
        nothing = self.scale == 0
        if len(self.dependent) == 0:
            return nothing
        basis, growth = self._null_basis()
        share = np.linalg.norm(basis, axis=1)
        # what back substitution makes of the round-off in the factor
        noise = np.random.default_rng(1).standard_normal((self.n, 4))
        rhs = [(self._gamma + self._error[live])[:, None] * noise[live] for live, _ in self.columns]
        blur = np.linalg.norm(self.solve_r(rhs, np.zeros((self.n, 4))), axis=1) / 2
        return (share + growth * blur > NEGLIGIBLE) | nothing

    def _null_basis(self):
        """Orthonormal basis (n, m) of the null space, and by how much it enlarges round-off."""
        n_free = len(self.dependent)
        width = max(1, MOST_NUMBERS // self.n)
        values = np.eye(n_free) if n_free <= width else self._even_mixture(n_free, width)
        vectors = self._null_vectors(values)
        vectors /= np.linalg.norm(vectors, axis=0)
        basis, R = np.linalg.qr(vectors)
        growth = 1 / np.linalg.svd(R, compute_uv=False)[-1]
        return basis * np.sqrt(max(n_free / basis.shape[1], 1)), growth

    def _even_mixture(self, n_free, width):
        """Random values (n_free, 64) of the dependent columns that give null vectors one weight."""
        norm = np.empty(n_free)
        for first in range(0, n_free, width):
            some = slice(first, first + width)
            unit = np.eye(n_free, len(norm[some]), -first)
            norm[some] = np.linalg.norm(self._null_vectors(unit), axis=0)
        return np.random.default_rng(0).standard_normal((n_free, 64)) / norm[:, None]

    def _null_vectors(self, values):
        """Null vectors (n, m), scaled, with these values (n_dependent, m) in dependent columns."""
        x = np.zeros((self.n, values.shape[1]))
        out, dead = np.split(values, [len(self.left_out)])
        x[self.dead] = dead
        self._solve_up_to(len(self.blocks), x, None)
        if len(self.left_out):
            right = self.A[:, self.left_out] @ (out / self.norm[self.left_out, None])
            x -= self.pseudo_inverse(right) * self.norm[:, None]
            x[self.left_out] = out
        return x


def _apply_qt(reflectors, tau, matrix):
    if len(tau) == 0:
        return matrix
    reflectors = reflectors[:, : len(tau)]  # a front with fewer rows than columns has fewer
    ormqr, work = la.get_lapack_funcs(("ormqr",), (reflectors, matrix))[0], -1
    _, work, _ = ormqr("L", "T", reflectors, tau, matrix, -1)
    product, _, info = ormqr("L", "T", reflectors, tau, matrix, int(work[0]))
    assert info == 0
    return product
