"""The misfit of the regularized fit: a sum of terms, each a set of measured numbers.

A term is anything with the methods of :class:`Term`. To fit something else that was measured, say
the force on the pad, add a class whose slopes give that number's derivatives by the displacements
(rows of ``state.K``) and by the parameters (rows of ``state.R``).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from .equilibrium import Equilibrium, State
from .observations import block_diagonal, per_block


@dataclass
class Observation:
    """One trial's part of a term at one state: k numbers, seen to first order.

    A change of the state changes them by by_eta @ dη + by_x @ dx.
    """

    residual: np.ndarray  # (k,) measured − computed
    by_eta: sp.csr_matrix  # (k, n_eta)
    by_x: sp.csr_matrix | None  # (k, n_x); None: zero
    weight: sp.csr_matrix  # (k, k) inverse covariance, up to the noise scale
    root: sp.csr_matrix  # covariance = root rootᵀ
    scaled: bool  # whether the covariance is to be multiplied by the noise scale, squared
    shared: float = 0.0  # correlation of an error with that of the same number in another trial

    def factor(self, scale: float) -> float:
        """Return what the covariance is multiplied by."""
        return scale**2 if self.scaled else 1.0


class Term(Protocol):
    """A set of measurements."""

    def observe(self, state: State) -> list[Observation]:
        """Return the trials' observations at a state."""

    @property
    def n_equations(self) -> int:
        """Numbers measured, less those that the held nodes' motion can fit by itself."""


class Displacements:
    """The measured displacements of the mesh's nodes, each node with its own covariance.

    Of nodes that touch and slide, the allowed motion nearest to what was measured.
    """

    def __init__(self, forward: Equilibrium):
        noise, B, y = forward.problem.noise, forward.measured, forward.data
        rows, n, n_trials = np.flatnonzero(forward.coarse), B.shape[1], y.shape[1]
        nodes = forward.slots[rows] // forward.mesh.dim
        self.pick = sp.csr_matrix((np.ones(n), (np.arange(n), rows)), (n, forward.n_eta))
        lost = int(noise.lost[:, nodes].sum())
        self.n_equations = max(n_trials * (n - len(forward.held)) - lost, 1)
        self.weight, self.root, self.data = [], [], np.empty((n, n_trials))
        self.shared = noise.shared
        for t in range(n_trials):
            if not (t and noise.alike):
                W = block_diagonal(np.linalg.inv(noise.covariances(t)))
                weight = B.T @ W @ B
                C = per_block(np.linalg.inv, weight)
                root = per_block(np.linalg.cholesky, C)
            self.weight.append(weight.tocsr())
            self.root.append(root)
            self.data[:, t] = C @ (B.T @ (W @ y[:, t]))

    def observe(self, state):
        residual = self.data - self.pick @ state.eta
        return [
            Observation(r, self.pick, None, W, root, True, self.shared)
            for r, W, root in zip(residual.T, self.weight, self.root, strict=True)
        ]


class Misfit:
    """The sum of its terms at one state.

    `added`, (k, 1) per term and trial, comes on top of what was measured.
    """

    def __init__(self, terms: list[Term], state: State, added=None):
        self.terms = [term.observe(state) for term in terms]
        for term, more in zip(self.terms, added or [], strict=False):
            for o, part in zip(term, more, strict=True):
                o.residual = o.residual + part[:, 0]

    def value(self) -> float:
        """Return Σ rᵀ W r over the terms that the noise scale multiplies."""
        return sum(
            float(o.residual @ (o.weight @ o.residual)) for t in self.terms for o in t if o.scaled
        )

    def residuals(self) -> list[list[np.ndarray]]:
        """Return per term and trial measured − computed, (k, 1)."""
        return [[o.residual[:, None] for o in term] for term in self.terms]

    def of_first_term(self, numbers) -> list[list[np.ndarray]]:
        """Return numbers per term and trial: those given in the first term, none in the others."""
        return [numbers, *[[0 * r for r in term] for term in self.residuals()[1:]]]

    def noise(self, random: np.random.Generator, m: int, scale: float, shared: bool = False):
        """Return per term and trial m samples of the measurements' errors, (k, m).

        Independent from trial to trial, as the weights take them to be; with `shared` as they are.
        """
        return [_errors(term, random, m, scale, shared) for term in self.terms]

    def weighted(self, numbers, scale: float) -> list[np.ndarray]:
        """Return the gradients of ½ Σ vᵀ W v / σ² by η, per trial, and by x; v per term, trial."""
        by_eta, by_x = [0] * len(self.terms[0]), 0
        for term, parts in zip(self.terms, numbers, strict=True):
            for t, (o, v) in enumerate(zip(term, parts, strict=True)):
                w = o.weight @ v / o.factor(scale)
                by_eta[t] = by_eta[t] + o.by_eta.T @ w
                if o.by_x is not None:
                    by_x = by_x + o.by_x.T @ w
        return by_eta, by_x

    def gram(self, numbers, scale: float) -> np.ndarray:
        """Return Σ vᵀ W v / σ², (m, m), for numbers v (k, m) per term and trial."""
        return sum(
            v.T @ (o.weight @ v) / o.factor(scale)
            for term, parts in zip(self.terms, numbers, strict=True)
            for o, v in zip(term, parts, strict=True)
        )

    def seen(self, dx, deta):
        """Return per term and trial the change of the numbers for dx (n_x, m), None: 0, and dη."""
        return [
            [
                o.by_eta @ d + (0 if o.by_x is None or dx is None else o.by_x @ dx)
                for o, d in zip(term, deta, strict=True)
            ]
            for term in self.terms
        ]


def _errors(term, random, m, scale, shared):
    """Samples of one term's errors, (k, m) per trial."""
    parts = [random.standard_normal((o.root.shape[1], m)) for o in term]
    if shared and any(o.shared for o in term):
        common = random.standard_normal(parts[0].shape)
        parts = [
            np.sqrt(o.shared) * common + np.sqrt(1 - o.shared) * own
            for o, own in zip(term, parts, strict=True)
        ]
    return [np.sqrt(o.factor(scale)) * (o.root @ part) for o, part in zip(term, parts, strict=True)]


def beside(*numbers) -> list[list[np.ndarray]]:
    """Return numbers per term and trial with the columns of all side by side."""
    return [
        [np.hstack(parts) for parts in zip(*trials, strict=True)]
        for trials in zip(*numbers, strict=True)
    ]


def difference(a, b) -> list[list[np.ndarray]]:
    """Return a − b of numbers per term and trial."""
    return [[p - q for p, q in zip(*trials, strict=True)] for trials in zip(a, b, strict=True)]
