"""Factors of sparse symmetric matrices: one interface over MKL's PARDISO and what is always there.

PARDISO (Intel MKL through `pypardiso`, the extra ``fast``) is taken where it is installed. Else
nested dissection of the unknowns' places gives an order with little fill, for dense fronts in
numpy, which keep half of a symmetric matrix (:mod:`.fronts`), or for scipy's SuperLU, which takes
pivots of any sign, where a matrix turns out not to be quasi-definite.
"""

import os
import sys
from functools import cache

import numpy as np
import scipy.sparse as sp

from .fronts import Fronts, NotQuasiDefinite, Plan
from .ldl import QuasiDefiniteSolver, nested_dissection

CHOICE = "ELASTOIDENTIFY_FACTORISATION"  # environment variable: fronts, superlu or pardiso
SMALL = 1_500  # unknowns for which PARDISO's set-up costs more than it saves


class Factoriser:
    """Makes factors of matrices of one pattern, and remembers their order.

    Parameters
    ----------
    places : (n, d)
        Where each unknown is.
    definite : bool
        Whether the matrices are positive definite; else symmetric with no need of large pivots.
    """

    def __init__(self, places: np.ndarray, definite: bool = True):
        self.places, self.definite = places, definite
        self.pieces = self.plan = self.order = None
        self.name = factorisation()
        if self.name == "pardiso" and len(places) < SMALL:
            self.name = "fronts"

    def __call__(self, matrix: sp.spmatrix):
        """Return factors with ``solve(right)``, right (n,) or (n, m).

        Raises
        ------
        RuntimeError
            Where the matrix is singular or not finite.
        """
        if not np.isfinite(matrix.data).all():
            raise RuntimeError("the matrix has values that are not finite")
        if self.name == "pardiso":
            return self._pardiso(matrix)
        if self.pieces is None:
            self.pieces = nested_dissection(matrix, self.places)
        if self.name == "fronts":
            try:
                return self._fronts(matrix)
            except NotQuasiDefinite:
                pass  # a body that buckles, or is held nowhere: any pivots will do
        return QuasiDefiniteSolver(matrix, self.pieces)

    def _pardiso(self, matrix):
        try:
            found = Pardiso(matrix, self.definite, self.order)
        except RuntimeError:
            if not self.definite:
                raise
            # a body that is held nowhere: go on as SuperLU does, with perturbed pivots
            found = Pardiso(matrix, False, self.order)
        self.order = found.order
        return found

    def _fronts(self, matrix):
        if matrix.format not in ("csr", "csc"):
            matrix = matrix.tocsc()
        data = self.plan and self.plan.values(matrix)
        if data is None:
            self.plan = Plan(matrix, self.pieces)
            data = self.plan.values(matrix)
        return Fronts(self.plan, data)


@cache
def factorisation() -> str:
    """Return "pardiso" where it is installed and works, else "fronts"."""
    wanted = os.environ.get(CHOICE, "")
    if wanted in ("fronts", "superlu"):
        return wanted
    try:
        _mkl()
        trial = Pardiso(sp.diags([4.0, 1.0, 1.0], [0, 1, -1], (5, 5), format="csr"), True)
        return "pardiso" if np.isfinite(trial.solve(np.ones(5))).all() else "fronts"
    except Exception:  # a broken MKL may raise anything, and there is a way without it
        return "fronts"


@cache
def _mkl():
    """Return pypardiso's solver class, with MKL set to give the same digits every time."""
    from pypardiso import PyPardisoSolver

    library = PyPardisoSolver().libmkl
    # it would search the disk for the library once for every solver
    os.environ.setdefault("PYPARDISO_MKL_RT", library._name)
    if hasattr(library, "MKL_CBWR_Set"):
        library.MKL_CBWR_Set(2)  # MKL_CBWR_AUTO: the same path in every run on this processor
    return PyPardisoSolver


class Pardiso:
    """LLᵀ (definite) or LDLᵀ factors by MKL PARDISO, of the upper triangle.

    `order`, (n,), is that of other factors, of a matrix of this pattern: to find one takes an
    eighth of the time of a large factorisation, and half of that of a small one.
    """

    # (number, value), counted from 1 as in MKL's manual: nested dissection by METIS, no refinement,
    # no scaling or matching (they are for unsymmetric pivots), 1×1 and 2×2 pivots, entries counted
    PARAMETERS = ((1, 1), (2, 2), (8, 0), (10, 8), (11, 0), (13, 0), (18, -1), (21, 1), (24, 0))

    FIND_ORDER, TAKE_ORDER = (5, 2), (5, 1)

    def __init__(self, matrix: sp.spmatrix, definite: bool, order: np.ndarray | None = None):
        matrix = sp.triu(matrix, format="csr")
        matrix.sort_indices()
        self.n, self.matrix = matrix.shape[0], matrix
        self.solver = _mkl()(mtype=2 if definite else -2)
        self.solver._check_A = lambda A: None  # it would refuse a triangle
        how = self.FIND_ORDER if order is None else self.TAKE_ORDER
        for number, value in (*self.PARAMETERS, how):
            self.solver.set_iparm(number, value)
        self.order = self.solver.perm = np.zeros(self.n, np.int32) if order is None else order
        self._call(12, np.zeros((self.n, 1)))

    def _call(self, phase, right):
        from pypardiso.pardiso_wrapper import PyPardisoError

        self.solver.set_phase(phase)
        try:
            return self.solver._call_pardiso(self.matrix, right)
        except PyPardisoError as failed:
            raise RuntimeError(f"PARDISO: {failed}") from failed

    @property
    def entries(self) -> int:
        """Entries of the factor."""
        return int(self.solver.iparm[17])

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution for right-hand sides (n,) or (n, m)."""
        right = np.asarray(right, float)
        columns = np.asfortranarray(right.reshape(self.n, -1))
        if not columns.size:
            return right.copy()
        return np.asarray(self._call(33, columns)).reshape(right.shape)

    def __del__(self):
        if hasattr(self, "solver") and not sys.is_finalizing():  # then the memory goes anyway
            self.solver.set_phase(-1)
            self.solver._call_pardiso(self.matrix, np.zeros((self.n, 1)))
