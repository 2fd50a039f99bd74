"""The error of measured displacements: its metric, samples of it, and its size from the data."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ..fem.assembly import internal_forces, tangent_stiffness
from .balance_system import BalanceSystem

FLOOR = 1e-6  # of the largest information: free in practice
ENOUGH_EQUATIONS = 12  # a scale from so many is good to about 20 %
CONTRADICTED = 3.0
"""Noise by all equations over noise by those among known cells from which the model is wrong, or
displacements are lost. Sound data have 0.1 to 2, however noisy."""
EXACT = 1e7  # times rounding: what solvers leave, and no measurement comes near
MEDIAN_CHI_SQUARED = 0.4549  # of one degree of freedom
SHARED = 0.5
"""Correlation of a node's errors in two trials that were registered to one rest image: that image's
noise is half of the variance of each. Image phantoms show 0.47 to 0.61 (docs/registration.md)."""


class DisplacementNoise:
    """Gaussian errors of nodal displacements, independent between nodes and trials.

    The covariance is scale² · C: C is the identity (`scale` is then a length) or the inverse of
    the information given (`scale` is then a pure number, 1 if the information is right).

    Parameters
    ----------
    displacements : (n_trials, n_nodes, d)
    information : (n_trials, n_nodes, d, d), optional
        Inverse covariance, 1/length². Directions without information are given a floor of 1e-6 of
        the largest eigenvalue of their trial, which leaves them free in practice.
    scale : float, optional
        The scale where the user knows it.
    lost : (n_trials, n_nodes) bool, optional
        Displacements of which nothing is known: their information is that floor. Those whose
        information says so are lost in any case.
    """

    def __init__(self, displacements, information=None, scale=None, lost=None):
        self.shape = displacements.shape
        self.scale = scale
        self.lost = np.zeros(self.shape[:2], bool) if lost is None else lost
        # rounding of the positions that displacements are differences of
        self.round_off = 4 * np.finfo(float).eps * np.abs(displacements).max(initial=0.0)
        self.information = None
        if information is not None:
            values, vectors = np.linalg.eigh(information)
            floor = FLOOR * np.maximum(values.max(axis=(1, 2)), np.finfo(float).tiny)[:, None]
            self.lost = self.lost | (values[..., -1] <= floor)
            values = np.where(self.lost[..., None], 0.0, values)
            values = np.maximum(values, floor[..., None])
            self.information = np.einsum("tnij,tnj,tnkj->tnik", vectors, values, vectors)
            self.root = vectors / np.sqrt(values)[..., None, :]  # C = root rootᵀ
            self.round_off *= np.sqrt(np.median(values))

    @property
    def shared(self) -> float:
        """Correlation of a node's errors between trials: information comes with images."""
        return 0.0 if self.information is None or len(self.lost) < 2 else SHARED

    @property
    def stated(self) -> float | None:
        """The scale that was stated; information states that it is one."""
        return self.scale if self.information is None else 1.0

    @property
    def alike(self) -> bool:
        """True if the covariance is the same in all trials."""
        return self.information is None and not self.lost.any()

    def samples(self, m: int, seed: int = 0) -> np.ndarray:
        """Return m errors of unit scale, (m, n_trials, n_nodes, d)."""
        z = np.random.default_rng(seed).standard_normal((m, *self.shape))
        if self.information is None:
            return z / np.sqrt(np.where(self.lost, FLOOR, 1.0))[..., None]
        return np.einsum("tnij,mtnj->mtni", self.root, z)

    def covariances(self, trial: int) -> np.ndarray:
        """Return C of a trial, (n_nodes, d, d)."""
        if self.information is None:
            return np.eye(self.shape[2]) / np.where(self.lost[trial], FLOOR, 1.0)[:, None, None]
        root = self.root[trial]
        return root @ np.swapaxes(root, -1, -2)


def block_diagonal(blocks: np.ndarray) -> sp.csr_matrix:
    """Return the (n·d, n·d) matrix that has blocks (n, d, d) on its diagonal."""
    at = np.arange(len(blocks) + 1)
    return sp.bsr_matrix((np.ascontiguousarray(blocks), at[:-1], at)).tocsr()


def per_block(function, matrix: sp.spmatrix) -> sp.csr_matrix:
    """Return a function of small dense matrices applied to the blocks of a block-diagonal matrix.

    The blocks are found from the pattern, in whatever order their rows come; `function` takes all
    of one size, (k, n, n).
    """
    matrix = matrix.tocoo()
    _, block = connected_components(matrix, directed=False)
    order = np.argsort(block, kind="stable")
    _, start, size = np.unique(block[order], return_index=True, return_counts=True)
    within = np.empty(len(order), int)  # the block
    within[order] = np.arange(len(order)) - np.repeat(start, size)
    parts = []
    for n in np.unique(size):
        chosen = np.flatnonzero(size == n)
        number = np.full(len(size), -1)
        number[chosen] = np.arange(len(chosen))
        here = number[block[matrix.row]] >= 0
        row, col = matrix.row[here], matrix.col[here]
        dense = np.zeros((len(chosen), n, n))
        np.add.at(dense, (number[block[row]], within[row], within[col]), matrix.data[here])
        members = order[start[chosen][:, None] + np.arange(n)]
        shape = dense.shape
        parts.append(
            (
                function(dense).ravel(),
                np.broadcast_to(members[:, :, None], shape).ravel(),
                np.broadcast_to(members[:, None, :], shape).ravel(),
            )
        )
    values, row, col = (np.concatenate(part) for part in zip(*parts, strict=True))
    return sp.csr_matrix((values, (row, col)), matrix.shape)


def scale_from_known_cells(system: BalanceSystem, noise: DisplacementNoise) -> tuple[float, int]:
    """Return the noise scale from nodes that touch known cells only, and how many equations say so.

    There the force left over is K δu with K known: no unknown has been fitted to it, so that the
    estimate holds however noisy the data are.
    """
    mesh, unknowns = system.mesh, system.unknowns
    around = system.node_cells @ np.ones(mesh.n_cells)
    known = system.node_cells @ unknowns.known.astype(float)
    nodes = np.flatnonzero((around > 0) & (known == around) & system.conditions.asked)
    rows = system.conditions.rows[(nodes[:, None] * mesh.dim + np.arange(mesh.dim)).ravel()]
    rows = rows[np.diff(rows.indptr) > 0]
    lam, mu = unknowns.lam_known, unknowns.mu_known
    ratios = []
    for trial, u in enumerate(system.displacements):
        law = system.laws[trial]
        force = rows @ internal_forces(mesh, law, u, lam, mu).ravel()
        K = rows @ tangent_stiffness(mesh, law, u, lam, mu)
        C = block_diagonal(noise.covariances(trial))
        variance = np.asarray((K @ C).multiply(K).sum(axis=1)).ravel()
        ratios.append(force**2 / variance)
    ratios = np.concatenate(ratios)
    return float(np.sqrt(ratios.mean())) if len(ratios) else np.nan, len(ratios)


@dataclass(frozen=True)
class Propagated:
    """What errors of displacements make of a linear solver's solution.

    Attributes
    ----------
    errors : (n_params, m)
        Samples of the error of θ.
    scale : float
        Of the noise.
    redundancy : int
        Number of equations that it was estimated from.
    excess : float, optional
        How many times the noise that was stated, or that known cells show, the equations left over
        show; None where either cannot be told.
    """

    errors: np.ndarray
    scale: float
    redundancy: int
    excess: float | None


def propagate(system: BalanceSystem, noise: DisplacementNoise, theta, solve) -> Propagated:
    """Carry displacement errors through a linear solver of the balance equations.

    To first order the error of θ solves A δθ = −K(θ) δu; `solve` is the method's own way from a
    right-hand side to θ. The scale of the noise, where it is not given, follows from the nodes that
    touch known cells only, or, where they are too few, from the equations that the method leaves
    unsatisfied: the ratio of the residuals found to those that errors of unit scale would leave.

    Parameters
    ----------
    theta : (n_params,)
        The solution; parameters that are missing or far from plausible count as the flat guess.
    solve : callable
        (n_equations, m) → (n_params, m)
    """
    m = 32 if system.unknowns.n_params < 40_000 else 8
    plausible = _plausible(system.unknowns.flat_guess(), theta)
    force = system.force_errors(plausible, noise.samples(m))
    unit = solve(-force)
    found = np.isfinite(theta) & np.isfinite(unit).all(axis=1)
    covered = np.asarray(abs(system.A) @ (~found).astype(float)).ravel() == 0
    left_unit = (force + system.A @ np.where(found[:, None], unit, 0))[covered]
    left = system.residual(np.where(found, theta, 0))[covered]
    # an equation that the method solves exactly tells nothing
    size = np.sqrt((force[covered] ** 2).mean(axis=1))
    variance = (left_unit**2).mean(axis=1)
    tells = np.sqrt(variance) > 1e-3 * size
    redundancy, scale, excess = int(tells.sum()), noise.scale, None
    shown = typical = np.nan
    if redundancy:
        ratio = left[tells] ** 2 / variance[tells]
        typical = np.sqrt(np.median(ratio) / MEDIAN_CHI_SQUARED)
        # (m − 2)/m: the mean of 1/variance from m samples is too large by its inverse
        shown = float(np.sqrt(ratio.mean() * (m - 2) / m))
    told = scale is not None
    if not told:
        scale, among_known = scale_from_known_cells(system, noise)
        told = among_known >= ENOUGH_EQUATIONS
        if told:
            redundancy = among_known
        elif redundancy:
            # where errors have grown without bound, a mean would hear those equations only
            scale = shown if shown < 5 * typical else typical
        scale = float(max(scale, noise.round_off) if np.isfinite(scale) else noise.round_off)
    if told and tells.sum() >= ENOUGH_EQUATIONS:
        excess = shown / max(scale, EXACT * noise.round_off)
        if excess > CONTRADICTED and noise.scale is None:
            scale = shown
    return Propagated(unit * max(scale, noise.round_off), scale, redundancy, excess)


def _plausible(flat, theta, factor=100.0):
    with np.errstate(invalid="ignore"):
        good = np.isfinite(theta) & (theta > flat / factor) & (theta < flat * factor)
    return np.where(good, theta, flat)
