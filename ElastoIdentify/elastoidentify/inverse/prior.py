"""What is known of the parameters before any displacement is seen: a sum of terms.

A term is anything with the methods of :class:`PriorTerm`. Terms whose Hessian depends on the map
(total variation) are replaced by quadratics that are weighted anew in every step; for the others
weighing does nothing. To add knowledge, say Poisson's ratio of a label with its uncertainty, add a
:class:`Gaussian` to the list that :class:`Prior` is made of.
"""

from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ..fem.mesh import Mesh
from .parameterization import LogParameters

ANCHOR_STD = {"modulus": 3.0, "ratio": 1.5}  # natural logarithms, around the known material
REWEIGHTING = 3.0  # exponent of the reweighted prior of the posterior, p(jump) ∝ |jump|^−3
SMOOTHING = 0.02  # jumps of log-moduli below this count as none


class PriorTerm(Protocol):
    """A part of −log p(x), as the quadratic that stands for it at the present map."""

    def variational(self, x: np.ndarray, samples: np.ndarray | None) -> None:
        """Weigh anew at x (n,) with posterior samples (n, m) around it (None: none yet)."""

    def reweighted(self, x: np.ndarray, samples: np.ndarray | None) -> None:
        """Weigh anew for the sharpened map; `samples` None: around a point."""

    def hessian(self) -> sp.spmatrix:
        """Return the Hessian P, (n, n)."""

    def root(self) -> sp.spmatrix:
        """Return B with P = B Bᵀ, (n, k): B z is a sample of the term's random force."""

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Return the gradient at x, (n,)."""


class Gaussian:
    """Independent normal distributions of some parameters.

    Parameters
    ----------
    centre : (n,)
    precision : (n,)
        1/variance; 0 where the term says nothing.
    """

    def __init__(self, centre: np.ndarray, precision: np.ndarray):
        self.centre, self.precision = centre, precision

    def variational(self, x, samples):
        pass

    def reweighted(self, x, samples):
        pass

    def hessian(self):
        return sp.diags(self.precision)

    def root(self):
        return sp.diags(np.sqrt(self.precision))

    def gradient(self, x):
        return self.precision * (x - self.centre)


class TotalVariation:
    """Total variation of each field over the sides that cells of different groups share.

    Its weight is found from the map and its samples (variational Bayes of total variation:
    Babacan, Molina, Katsaggelos, IEEE Trans. Image Process. 17, 2008); the sharpened one is
    reweighted by its own result (Candès, Wakin, Boyd, J. Fourier Anal. Appl. 14, 2008).
    """

    FIRST_VARIANCE = 0.25  # of differences of log-moduli, before any sample

    def __init__(self, mesh: Mesh, parameters: LogParameters, labels: np.ndarray | None = None):
        unknowns = parameters.unknowns
        n, self.n_fields = unknowns.n_groups, unknowns.per_group
        pairs, sizes = mesh.interfaces
        apart = np.zeros(len(pairs), bool)
        if labels is not None:
            apart = labels[pairs[:, 0]] != labels[pairs[:, 1]]
        pairs = unknowns.group[pairs]
        inside = (pairs >= 0).all(axis=1)
        # labels are few and well determined: a prior between them would only bias their contrast
        inside &= unknowns.per_cell
        pairs, sizes, apart = pairs[inside], sizes[inside], apart[inside]
        m = len(pairs)
        rows = np.tile(np.arange(m), 2)
        signs = np.repeat([1.0, -1.0], m)
        one = sp.csr_matrix((signs, (rows, pairs.T.ravel())), (m, n))
        fields = sp.block_diag([one] * self.n_fields, format="csr")
        beside = sp.csr_matrix((fields.shape[0], parameters.n - fields.shape[1]))
        self.difference = sp.hstack([fields, beside], format="csr")
        self.size = np.tile(sizes / (sizes.mean() if m else 1.0), self.n_fields)
        self.field = np.repeat(np.arange(self.n_fields), m)
        # labels differ in stiffness; the ratio λ/μ, which the data hardly show, is alike
        self.apart = np.tile(apart, self.n_fields) & (self.field == 0)
        self.size[self.apart] = 0.0
        self.pairs, self.n_groups = pairs, n  # (m, 2) groups on either side
        self.sharpening = None  # exponent of the sharpened map, to be set
        self.edges = np.zeros(len(self.size), bool)  # sides between regions, once they are found
        self.once = np.ones(len(self.size))  # part of a side in the boundary that it belongs to
        self.weights, self.field_weight = np.zeros(len(self.size)), np.zeros(self.n_fields)

    def __len__(self) -> int:
        """Number of differences that it weighs: 0 where labels are the unknowns."""
        return len(self.size)

    def _variance(self, samples):
        return ((self.difference @ samples) ** 2).mean(axis=1)

    def variational(self, x, samples):
        """Weights of the quadratic that bounds total variation, size and weight by field."""
        if not len(self):
            return
        variance = self.FIRST_VARIANCE if samples is None else self._variance(samples)
        width = np.sqrt((self.difference @ x) ** 2 + variance)
        total = np.bincount(self.field, self.size * width, self.n_fields)
        self.field_weight = max(self.n_groups - 1, 1) / np.maximum(total, 1e-12)
        self.weights = self.field_weight[self.field] * self.size / width

    def reweighted(self, x, samples):
        """Weights of reweighted total variation at x (of differences with some variance)."""
        exponent, variance = self.sharpening, 0.0
        if samples is not None:
            exponent, variance = REWEIGHTING, self._variance(samples)
        jump = (self.difference @ x) ** 2 + variance + SMOOTHING**2
        self.weights = exponent * self.size * self.once / jump

    def find_regions(self, x, jump: float):
        """Take each boundary between two regions of the map for one jump from now on.

        Regions hang together by sides where x jumps by less than `jump`. All sides of a boundary
        show the same jump: counted one by one, they would pull it down as often.
        """
        self.edges = np.abs(self.difference @ x) > jump
        self.once = np.ones(len(self.size))
        for field in range(self.n_fields):
            here = np.flatnonzero(self.field == field)
            between = here[self.edges[here] & ~self.apart[here]]
            region = connected_components(self._within(field), directed=False)[1]
            sides = np.sort(region[self.pairs[between - here[0]]], axis=1)
            _, boundary = np.unique(sides, axis=0, return_inverse=True)
            boundary = boundary.ravel()
            self.once[between] = 1 / np.bincount(boundary, self.size[between])[boundary]

    def _within(self, field: int) -> sp.csr_matrix:
        """Which groups hang together in a region of one of the fields, (n_groups, n_groups)."""
        here = self.field == field
        one, other = self.pairs[~self.edges[here] & ~self.apart[here]].T
        links = sp.csr_matrix((np.ones(len(one)), (one, other)), (self.n_groups,) * 2)
        return links + links.T

    def merged(self, change: np.ndarray) -> np.ndarray:
        """Return how a change (n,) of the map goes beyond that of its regions, (n,).

        Less the mean of each region, which the refit finds, and averaged over neighbours of the
        same region, twice: what is left is common to several cells.
        """
        out = np.zeros(len(change))
        for field in range(self.n_fields):
            links = self._within(field) + sp.identity(self.n_groups)
            region = connected_components(links, directed=False)[1]
            part = change[field * self.n_groups :][: self.n_groups]
            mean = np.bincount(region, part) / np.bincount(region)
            part = part - mean[region]
            for _ in range(2):
                part = (links @ part) / (links @ np.ones(self.n_groups))
            out[field * self.n_groups :][: self.n_groups] = part
        return out

    def hessian(self):
        return self.difference.T @ sp.diags(self.weights) @ self.difference

    def root(self):
        return self.difference.T @ sp.diags(np.sqrt(self.weights))

    def gradient(self, x):
        return self.difference.T @ (self.weights * (self.difference @ x))


class Prior:
    """The sum of its terms."""

    def __init__(self, terms: list[PriorTerm]):
        self.terms = terms

    def variational(self, x, samples=None):
        for term in self.terms:
            term.variational(x, samples)

    def reweighted(self, x, samples=None):
        for term in self.terms:
            term.reweighted(x, samples)

    def hessian(self) -> sp.csc_matrix:
        """Return P, (n, n)."""
        return sum(term.hessian() for term in self.terms).tocsc()

    def root(self) -> sp.csr_matrix:
        """Return B with P = B Bᵀ."""
        return sp.hstack([term.root() for term in self.terms], format="csr")

    def gradient(self, x):
        return sum(term.gradient(x) for term in self.terms)


def anchor(parameters: LogParameters) -> Gaussian:
    """Return a weak pull of each field's mean to the known material.

    Of the mean of a field: an anchor at every cell would add up to a bias of the scale.
    """
    n = parameters.unknowns.n_groups
    std = [ANCHOR_STD["modulus"], ANCHOR_STD["ratio"]][: parameters.unknowns.per_group]
    precision = np.zeros(parameters.n)
    precision[: n * len(std)] = np.repeat(1 / (n * np.square(std)), n)
    return Gaussian(parameters.start.copy(), precision)
