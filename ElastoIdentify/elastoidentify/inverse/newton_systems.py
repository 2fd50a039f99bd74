"""Solvers of the Gauss-Newton system of the regularized fit, H = P + Σ_t R_tᵀ (σ² S_t)⁻¹ R_t.

Neither forms H or a sensitivity. In the plane one sparse factorisation of the quasi-definite matrix

    [ P    Rᵀ  ]
    [ R  −σ²S  ]

is cheapest (its LDLᵀ exists for any ordering: Vanderbei, SIAM J. Optim. 5, 1995). In space its
factors fill up with the number of trials; there conjugate gradients need only products, each one
forward and one adjoint solution per trial with the factors that the fit has of S, and P as
preconditioner leaves them the few directions that the data determine.
"""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from ..linalg.ldl import QuasiDefiniteSolver, nested_dissection

TOLERANCE, LIMIT = 0.003, 300  # of the conjugate gradients: relative residual, steps


class DirectSystem:
    """H by one factorisation of the quasi-definite matrix.

    Parameters
    ----------
    group_places : (n_fields·n_groups, d); node_places : (n_free, d)
        Where the parameters and the force equations of one trial are.
    """

    samples = 16  # posterior samples worth their cost in every step

    def __init__(self, group_places, node_places):
        self.group_places, self.node_places = group_places, node_places
        self.order = None

    def factorise(self, P, fits, scale: float):
        """Take new matrices; the force rows are scaled to a unit diagonal of σ²S."""
        rows, self.row_scale = [[P] + [None] * len(fits)], []
        for k, fit in enumerate(fits):
            s = sp.diags(1 / (scale * np.sqrt(fit.S.diagonal())))
            R = s @ fit.R
            rows[0][k + 1] = R.T
            row = [R] + [None] * len(fits)
            row[k + 1] = -(scale**2) * (s @ fit.S @ s)
            rows.append(row)
            self.row_scale.append(s)
        matrix = sp.bmat(rows, format="csc")
        if self.order is None:
            places = np.vstack([self.group_places, *[self.node_places] * len(fits)])
            self.order = nested_dissection(matrix, places)
        self.solver = QuasiDefiniteSolver(matrix, self.order)

    def solve(self, field_part, force_parts, start=None, tell=None):
        """Return H⁻¹ (field_part + Σ_t R_tᵀ (σ²S_t)⁻¹ force_parts[t]); needs no start."""
        scaled = [s @ part for s, part in zip(self.row_scale, force_parts, strict=True)]
        return self.solver.solve(np.concatenate([field_part, *scaled]))[: len(field_part)]


class AdjointSystem:
    """H by its products; preconditioned conjugate gradients, all right-hand sides at once."""

    samples = 8

    def __init__(self, group_places, node_places):
        self.group_places, self.order = group_places, None

    def factorise(self, P, fits, scale: float):
        """Take new matrices."""
        self.P, self.fits, self.scale = P, fits, scale
        if self.order is None:
            self.order = nested_dissection(P, self.group_places)
        self.preconditioner = QuasiDefiniteSolver(P, self.order)

    def solve(self, field_part, force_parts, start=None, tell: Callable[[], None] | None = None):
        """Return H⁻¹ (field_part + Σ_t R_tᵀ (σ²S_t)⁻¹ force_parts[t]).

        Parameters
        ----------
        start : like field_part, optional
            A guess; the solution of the step before is a good one.
        tell : callable, optional
            Called at each step.
        """
        right = np.array(field_part, float)
        for fit, part in zip(self.fits, force_parts, strict=True):
            right += fit.R.T @ fit.solve(part) / self.scale**2
        shape = right.shape
        right = right.reshape(len(right), -1)
        target = TOLERANCE**2 * _dot(right, self.preconditioner.solve(right))
        x = np.zeros_like(right) if start is None else start.reshape(right.shape).copy()
        residual = right - (self._product(x) if start is not None else 0)
        z = self.preconditioner.solve(residual)
        direction, size = z, _dot(residual, z)
        for _ in range(LIMIT):
            going = size > target
            if not going.any():
                break
            if tell:
                tell()
            H_direction = self._product(direction)
            length = np.where(going, size / np.maximum(_dot(direction, H_direction), _TINY), 0)
            x += length * direction
            residual = residual - length * H_direction
            z = self.preconditioner.solve(residual)
            before, size = size, _dot(residual, z)
            direction = z + size / np.maximum(before, _TINY) * direction
        return x.reshape(shape)

    def _product(self, x):
        """H x: a forward and an adjoint solution per trial, which S⁻¹ = K⁻ᵀ C⁻¹ K⁻¹ unites."""
        data = sum(fit.R.T @ fit.solver.solve(fit.R @ x) for fit in self.fits)
        return self.P @ x + data / self.scale**2


_TINY = np.finfo(float).tiny


def _dot(a, b):
    return np.einsum("ij,ij->j", a, b)
