"""Factors of a sparse symmetric matrix by dense fronts along a nested dissection.

The unknowns of a piece are eliminated together, in a dense front with those that they are coupled
to; what is left of the front is added to that of the piece that comes next. Nearly all of the work
is then products of dense matrices, and half of it, by symmetry, need not be done. Source: Duff and
Reid, The multifrontal solution of indefinite sparse symmetric linear equations, ACM Trans. Math.
Softw. 9 (1983).

A quasi-definite matrix has factors L S Lᵀ in any order, S = diag(±1) (Vanderbei, SIAM J. Optim. 5,
1995). In a piece the unknowns of positive diagonal come first, so that both of its parts have
Cholesky factors:

    [ A   Bᵀ ]   [ L₁     ] [ 1     ] [ L₁ᵀ  Vᵀ  ]
    [ B  −C  ] = [ V   L₂ ] [    −1 ] [      L₂ᵀ ],      L₁ L₁ᵀ = A,   L₂ L₂ᵀ = C + V Vᵀ.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from scipy.linalg import blas, lapack


class NotQuasiDefinite(RuntimeError):
    """A pivot has not the sign of its diagonal entry."""


@dataclass
class Front:
    """What is eliminated together, all by its number in the order of elimination.

    The front's rows are the piece's own, `start` to `end`, and then those `below`.
    """

    start: int
    end: int
    positive: int  # of its own unknowns: the first so many have a positive diagonal
    below: np.ndarray  # later unknowns that these are coupled to, sorted
    entries: slice  # of the matrix's entries in the plan's order
    at: np.ndarray  # their places in the columns of the front
    children: list  # fronts that are added, with the places of what is left of them, and its runs

    @property
    def size(self) -> int:
        return self.end - self.start


class Plan:
    """The fronts of all matrices of one pattern.

    Parameters
    ----------
    matrix : (n, n), symmetric, by columns or rows
    pieces : list of int arrays
        Unknowns to be eliminated together, in this order.
    """

    def __init__(self, matrix: sp.csc_matrix, pieces: list[np.ndarray]):
        self.indptr, self.indices = matrix.indptr.copy(), matrix.indices.copy()
        positive = matrix.diagonal() > 0
        pieces = [np.concatenate([p[positive[p]], p[~positive[p]]]) for p in pieces]
        self.order = np.concatenate(pieces)
        number = np.empty(len(self.order), int)
        number[self.order] = np.arange(len(self.order))
        sizes = [len(piece) for piece in pieces]
        bounds, self.piece = np.cumsum([0, *sizes]), np.repeat(np.arange(len(pieces)), sizes)
        row, column = number[self.indices], np.repeat(number, np.diff(self.indptr))
        lower = np.flatnonzero(row >= column)
        self.entries = lower[np.argsort(self.piece[column[lower]], kind="stable")]
        row, column = row[self.entries], column[self.entries]
        cuts = np.searchsorted(self.piece[column], np.arange(len(pieces) + 1))
        self.fronts, self._children = [], [[] for _ in pieces]
        for i, piece in enumerate(pieces):
            entries = slice(cuts[i], cuts[i + 1])
            self._add(*bounds[i : i + 2], positive[piece].sum(), entries, row[entries],
                      column[entries])  # fmt: skip

    def _add(self, start, end, positive, entries, row, column):
        children = self._children[len(self.fronts)]
        left = [self.fronts[child].below for child in children]
        below = np.unique(np.concatenate([part[part >= end] for part in (row, *left)]))
        rows = np.concatenate([np.arange(start, end), below])
        if len(below):
            self._children[self.piece[below[0]]].append(len(self.fronts))
        at = np.searchsorted(rows, row) + (column - start) * len(rows)
        places = [np.searchsorted(rows, part) for part in left]
        added = [(c, p, _runs(p, end - start)) for c, p in zip(children, places, strict=True)]
        self.fronts.append(Front(start, end, int(positive), below, entries, at, added))

    def values(self, matrix: sp.csc_matrix) -> np.ndarray | None:
        """Return a matrix's entries in the plan's order, None where it has other ones.

        Sums of sparse matrices leave out what happens to be zero, so that some may be missing.
        """
        data, ours = matrix.data, (self.indptr, self.indices)
        if not all(map(np.array_equal, (matrix.indptr, matrix.indices), ours)):
            theirs, ours = _keys(matrix.indptr, matrix.indices), _keys(*ours)
            at = np.searchsorted(ours, theirs).clip(max=len(ours) - 1)
            if (np.diff(ours) <= 0).any() or (ours[at] != theirs).any():
                return None
            data = np.bincount(at, data, len(ours))
        return data[self.entries]


def _keys(indptr, indices):
    """One number for each place in a matrix."""
    size = len(indptr) - 1
    return np.repeat(np.arange(size) * size, np.diff(indptr)) + indices


def _runs(places, size):
    """Begin and end of stretches of places without gap, none across `size`."""
    breaks = (np.diff(places) > 1) | (places[1:] == size)
    cuts = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(places)]
    return list(pairwise(cuts))


class Fronts:
    """Factors L S Lᵀ of a symmetric positive definite or quasi-definite matrix.

    Parameters
    ----------
    plan : Plan
    data : array
        The matrix's entries in the plan's order.

    Raises
    ------
    NotQuasiDefinite
        Where it is neither.
    """

    def __init__(self, plan: Plan, data: np.ndarray):
        self.plan, self.factors, left = plan, [], {}
        for i, front in enumerate(plan.fronts):
            own, rest = _assembled(front, data[front.entries], left)
            L = _signed_cholesky(np.asfortranarray(own[: front.size]), front.positive)
            V = np.asfortranarray(own[front.size :])
            if len(V):
                V, left[i] = _eliminated(L, V, rest, front.positive)
            self.factors.append((L, V))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution for right-hand sides (n,) or (n, m)."""
        right = np.asarray(right, float)
        if not right.size:
            return right.copy()
        z = np.ascontiguousarray(right.reshape(len(right), -1)[self.plan.order])
        steps = list(zip(self.plan.fronts, self.factors, strict=True))
        for front, (L, V) in steps:
            own = _divided(z[front.start : front.end], L, True)
            if len(V):
                z[front.below] -= V @ own
            own[front.positive :] *= -1
        for front, (L, V) in reversed(steps):
            own = z[front.start : front.end]
            if len(V):
                own -= V.T @ z[front.below]
            _divided(own, L, False)
        solution = np.empty_like(z)
        solution[self.plan.order] = z
        return solution.reshape(right.shape)

    @property
    def entries(self) -> int:
        """Numbers that are kept."""
        return sum(L.size + V.size for L, V in self.factors)


# Of symmetric matrices below, only the lower triangle has a meaning. All are stored by columns, and
# numpy adds faster to transposed ones, by rows.


def _assembled(front, data, left):
    """The front's own columns, (rows, size), and the rest of it."""
    n, k = len(front.below), front.size
    own = np.bincount(front.at, data, (n + k) * k).reshape(k, n + k).T
    rest = np.zeros((n, n), order="F")
    for child, places, runs in front.children:
        part = left.pop(child).T
        for begin, end in runs:
            into, shift = (own, 0) if places[begin] < k else (rest, k)
            first = places[begin] - shift
            columns = slice(first, first + end - begin)
            into.T[columns, places[begin:] - shift] += part[begin:end, begin:]
    return own, rest


def _signed_cholesky(A, positive):
    """L of A = L S Lᵀ, S of `positive` ones and then of minus ones; A is overwritten."""
    p = positive
    A[:p, :p] = _cholesky(A[:p, :p])
    if p < len(A):
        C = np.asfortranarray(-A[p:, p:])
        if p:
            V = blas.dtrsm(1.0, A[:p, :p], A[p:, :p], side=1, lower=1, trans_a=1)
            C = blas.dsyrk(1.0, V, beta=1.0, c=C, lower=1, overwrite_c=1)
            A[p:, :p] = V
        A[p:, p:] = _cholesky(C)
    return A


def _cholesky(A):
    if not len(A):
        return A
    L, failed = lapack.dpotrf(A, lower=1, clean=0)
    if failed:
        raise NotQuasiDefinite("a pivot has the wrong sign")
    return L


def _eliminated(L, V, rest, positive):
    """The factor's rows below, V L⁻ᵀ S, and what is left of the front."""
    V = blas.dtrsm(1.0, L, V, side=1, lower=1, trans_a=1, overwrite_b=1)
    V[:, positive:] *= -1
    for sign, part in ((-1.0, V[:, :positive]), (1.0, V[:, positive:])):
        if part.size:
            rest = blas.dsyrk(sign, part, beta=1.0, c=rest, lower=1, overwrite_c=1)
    return V, rest


def _divided(z, L, forward):
    """L⁻¹ z or L⁻ᵀ z, in place; z is stored by rows."""
    blas.dtrsm(1.0, L, z.T, side=1, lower=1, trans_a=int(forward), overwrite_b=1)
    return z
