"""Nested dissection of a sparse symmetric matrix whose unknowns have places in space.

Source: George, Nested dissection of a regular finite element mesh, SIAM J. Numer. Anal. 10 (1973),
with separators by coordinate bisection. Less fill than minimum degree on large planar meshes.
"""

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl

LEAF = 120  # unknowns that are no longer divided
EVERYWHERE = 10  # an unknown coupled to this many times the median number is coupled everywhere


def nested_dissection(matrix: sp.spmatrix, places: np.ndarray) -> list[np.ndarray]:
    """Return the unknowns of a symmetric matrix in pieces, in an order of elimination.

    Parameters
    ----------
    matrix : (n, n)
        Its pattern must be symmetric.
    places : (n, d)
        Where each unknown is; unknowns coupled by the matrix should be near each other. Those
        coupled to very many, as a label is to all its nodes, have no place and come last.
    """
    pattern = sp.csr_matrix(matrix, dtype=np.float32, copy=True)
    pattern.data[:] = 1
    marked = np.zeros(len(places), np.float32)

    def touching(ours, theirs):
        marked[theirs] = 1
        touches = pattern[ours] @ marked > 0
        marked[theirs] = 0
        return touches

    def divide(ids):
        if len(ids) <= LEAF:
            return [ids]
        x = places[ids]
        along = x[:, np.argmax(np.ptp(x, axis=0))]
        left = along <= np.median(along)
        if left.all():  # all in one place
            left = np.arange(len(ids)) < len(ids) // 2
        sides = ids[left], ids[~left]
        touches = touching(*sides), touching(*sides[::-1])
        smaller = int(touches[1].sum() < touches[0].sum())
        ours, theirs, between = sides[smaller], sides[1 - smaller], touches[smaller]
        return [*divide(ours[~between]), *divide(theirs), _in_line(ours[between], places)]

    coupled = np.diff(pattern.indptr)
    everywhere = coupled > EVERYWHERE * np.median(coupled)
    pieces = [*divide(np.flatnonzero(~everywhere)), np.flatnonzero(everywhere)]
    return [piece for piece in pieces if len(piece)]


def _in_line(ids, places):
    """A separator's unknowns from one end to the other: what touches it does so in one stretch."""
    if not len(ids):
        return ids
    x = places[ids]
    return ids[np.argsort(x[:, np.argmax(np.ptp(x, axis=0))], kind="stable")]


class QuasiDefiniteSolver:
    """LDLᵀ-like factors of a symmetric quasi-definite matrix in a given order, no pivoting."""

    def __init__(self, matrix: sp.spmatrix, pieces: list[np.ndarray]):
        self.order = order = np.concatenate(pieces)
        permuted = sp.csc_matrix(matrix)[:, order].tocsr()[order].tocsc()
        self.factors = spl.splu(
            permuted,
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution for right-hand sides (n,) or (n, m)."""
        solution = np.empty_like(right, dtype=float)
        solution[self.order] = self.factors.solve(np.asarray(right, float)[self.order])
        return solution

    @property
    def entries(self) -> int:
        """Entries of both factors."""
        return int(self.factors.nnz)
