"""The true push of a volume: quadratic bricks on a regular grid, and the map it makes.

Bricks of 27 nodes with 3 × 3 × 3 Gauss points, which no identification uses. All bricks are alike,
so that their stiffness is one product of a matrix of moduli and a fixed table; the equations are
solved by conjugate gradients, preconditioned by the diagonal and by a direct solution on the
bricks' corners (two-level additive Schwarz: Smith, Bjørstad & Gropp, Domain Decomposition, 1996).
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import product

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ...errors import InputError
from ...progress import Progress, part, silent
from .push import Deformation

Moduli = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

_GAUSS = np.sqrt(0.6) * np.array([-1, 0, 1]), np.array([5, 8, 5]) / 9
_LOCAL = np.array(list(product(range(3), repeat=3)))[:, ::-1]  # (x, y, z) of a brick's nodes, 0…2
_CORNERS = np.array(list(product((0, 2), repeat=3)))[:, ::-1]


def solve_pushes_on_bricks(
    size: Sequence[float],
    moduli: Moduli,
    pushes: np.ndarray,
    *,
    elements: int = 12,
    kinematics: str = "small-strain",
    progress: Progress | None = None,
) -> list[Deformation]:
    """Push a block that stands on a floor.

    Parameters
    ----------
    size : (3,)
        The block covers 0…size, z upwards; its top follows the indenter, its bottom stays on the
        floor, its sides are free.
    moduli : callable
        ``young, poisson = moduli(x, y, z)``, any shape.
    pushes : (t, 3)
        Displacement of the indenter.
    elements : int
        Bricks across the first axis; they are as near to cubes as the other sides allow.
    kinematics : "small-strain", "neo-hookean"
        The latter is P = μ(F − F⁻ᵀ) + λ ln J F⁻ᵀ (Bonet & Wood, Nonlinear Continuum Mechanics for
        Finite Element Analysis, 2nd ed., eq. 6.28), solved by Newton's method.

    Returns
    -------
    list of Deformation
        One per push, constant beyond the block's sides.

    Raises
    ------
    InputError
        The push turns the block inside out, or Newton's method does not converge.
    """
    if kinematics not in ("small-strain", "neo-hookean"):
        raise InputError(f"kinematics {kinematics!r}: give small-strain or neo-hookean")
    progress = progress or silent
    size = np.asarray(size, float)
    count = np.maximum(np.rint(size * elements / size[0]).astype(int), 2)
    block = _Bricks(count, size / count, moduli)
    progress(0.0, "assembling the phantom's stiffness")
    preconditioner = _TwoLevel(block)
    held = np.zeros((block.n_nodes, 3, len(pushes)))
    held[block.height == block.height.max()] = np.asarray(pushes, float).T
    u = held.reshape(block.n_nodes * 3, -1)
    stiffness = block.assembled(block.rest_stiffness)
    free = block.free
    u[free] = _conjugate_gradients(
        stiffness[free][:, free],
        -(stiffness @ u)[free],
        preconditioner,
        part(progress, 0.1, 0.9 if kinematics == "small-strain" else 0.3),
    )
    if kinematics == "neo-hookean":
        for trial in range(len(pushes)):
            share = 0.3 + 0.7 * trial / len(pushes)
            progress(share, f"pushing trial {trial + 1} in finite strain")
            u[:, trial] = _newton(block, u[:, trial], preconditioner)
    shape = *(2 * count + 1)[::-1], 3
    return [
        Deformation.of_grid(np.zeros(3), size / count / 2, np.moveaxis(field.reshape(shape), -1, 0))
        for field in u.T
    ]


class _Bricks:
    """Internal forces and tangent stiffness of a regular grid of quadratic bricks.

    Parameters
    ----------
    count : (3,) int
        Bricks along x, y, z.
    step : (3,)
        Their edges.
    moduli : callable
        Evaluated at the Gauss points, so that a curved border passes through the bricks.
    """

    def __init__(self, count, step, moduli: Moduli):
        self.count = np.asarray(count)
        lines = 2 * self.count + 1
        self.n_nodes = int(lines.prod())
        self.height = np.arange(self.n_nodes) // (lines[0] * lines[1])
        on_plates = (self.height == 0) | (self.height == lines[2] - 1)
        self.free = np.flatnonzero(~np.repeat(on_plates, 3))
        grids = np.meshgrid(*(np.arange(n) for n in self.count[::-1]), indexing="ij")[::-1]
        self.place = np.stack([g.ravel() for g in grids], 1)  # (n, 3) of the bricks
        self.nodes = _numbers(2 * self.place[:, None] + _LOCAL, lines)  # (n, 27)

        line, weight = _GAUSS
        xi = np.array(list(product(line, repeat=3)))
        self.weights = np.prod(list(product(weight, repeat=3)), axis=1) * np.prod(step) / 8
        self.slopes = _slopes(xi) * 2 / step  # (q, 27, 3)
        at = (self.place[:, None] + 0.5 + xi / 2) * step  # (n, q, 3)
        young, poisson = (np.asarray(values, float) for values in moduli(*np.moveaxis(at, -1, 0)))
        self.lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        self.mu = young / (2 * (1 + poisson))

    @cached_property
    def _table(self):
        """∇N_a ⊗ ∇N_b times the weights: (q·3·3, 27·27)."""
        table = np.einsum("q,qak,qbl->qklab", self.weights, self.slopes, self.slopes)
        return table.reshape(-1, 27 * 27)

    @cached_property
    def _entries(self):
        """Rows and columns of all bricks' matrices (n, 3, 3, 27, 27) in the system."""
        dofs = (3 * self.nodes[:, None] + np.arange(3)[:, None]).astype(np.int32)  # (n, 3, 27)
        shape = (len(dofs), 3, 3, 27, 27)
        rows = np.broadcast_to(dofs[:, :, None, :, None], shape).ravel()
        return rows, np.broadcast_to(dofs[:, None, :, None, :], shape).ravel()

    def _state(self, u):
        """Return F⁻¹ (n, q, 3, 3) and ln J (n, q) at displacements u (3·n_nodes,)."""
        local = u.reshape(-1, 3)[self.nodes]  # (n, 27, 3)
        gradient = np.einsum("nai,qak->nqik", local, self.slopes, optimize=True) + np.eye(3)
        jacobian = np.linalg.det(gradient)
        if not (jacobian > 0).all():
            raise InputError("the push turns the phantom inside out: push less")
        return gradient, np.linalg.inv(gradient), np.log(jacobian)

    def forces(self, u: np.ndarray) -> np.ndarray:
        """Return the internal forces (3·n_nodes,): ∫ P(F) : ∇v."""
        gradient, inverse, log_j = self._state(u)
        away = np.swapaxes(inverse, -1, -2)
        stress = self.mu[..., None, None] * (gradient - away)
        stress += (self.lam * log_j)[..., None, None] * away
        local = np.einsum("q,nqik,qak->nai", self.weights, stress, self.slopes, optimize=True)
        total = [np.bincount(self.nodes.ravel(), local[..., i].ravel()) for i in range(3)]
        return np.stack(total, 1).ravel()

    def stiffness(self, u: np.ndarray) -> np.ndarray:
        """Return the bricks' tangents ∂forces/∂u, (n, 3, 3, 27, 27)."""
        _, inverse, log_j = self._state(u)
        return self._bricks(inverse, self.mu - self.lam * log_j)

    @cached_property
    def rest_stiffness(self) -> np.ndarray:
        """The bricks' stiffness at rest, that of small strain, (n, 3, 3, 27, 27)."""
        return self._bricks(np.broadcast_to(np.eye(3), (*self.mu.shape, 3, 3)), self.mu)

    def _bricks(self, inverse, shear):
        """∂P_ik/∂F_jl = μ δ_ij δ_kl + (μ − λ ln J) F⁻¹_kj F⁻¹_li + λ F⁻¹_ki F⁻¹_lj."""
        eye, stiffness = np.eye(3), np.empty((len(self.nodes), 3, 3, 27 * 27))
        for i, j in product(range(3), repeat=2):
            first = inverse[..., :, j, None] * inverse[..., None, :, i]  # (n, q, k, l)
            second = inverse[..., :, i, None] * inverse[..., None, :, j]
            slope = shear[..., None, None] * first + self.lam[..., None, None] * second
            if i == j:
                slope = slope + self.mu[..., None, None] * eye
            stiffness[:, i, j] = slope.reshape(len(self.nodes), -1) @ self._table
        return stiffness.reshape(-1, 3, 3, 27, 27)

    def assembled(self, bricks: np.ndarray) -> sp.csr_matrix:
        """Return the system's matrix (3·n_nodes,)² of the bricks' (n, 3, 3, 27, 27)."""
        n = 3 * self.n_nodes
        return sp.csr_matrix((bricks.ravel(), self._entries), shape=(n, n))


class _TwoLevel:
    """Preconditioner: the diagonal, and the direct solution for trilinear bricks."""

    def __init__(self, block: _Bricks):
        bricks = block.rest_stiffness
        ends = block.count + 1
        corners = _numbers(block.place[:, None] + _CORNERS // 2, ends)  # (n, 8)
        weights = np.prod(  # of each corner at each of the 27 nodes
            1 - np.abs(_LOCAL[:, None] - _CORNERS) / 2, axis=-1
        )
        small = np.einsum("ac,nijab,bd->nicjd", weights, bricks, weights, optimize=True)
        dofs = 3 * corners[:, None] + np.arange(3)[:, None]  # (n, 3, 8)
        shape = small.shape
        rows = np.broadcast_to(dofs[:, :, :, None, None], shape).ravel()
        columns = np.broadcast_to(dofs[:, None, None], shape).ravel()
        n = int(3 * ends.prod())
        coarse = sp.csc_matrix((small.ravel(), (rows, columns)), shape=(n, n))
        level = np.arange(n) // (3 * ends[0] * ends[1])
        inner = np.flatnonzero((level > 0) & (level < ends[2] - 1))
        self.coarse = splu(
            coarse[inner][:, inner], permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
        )
        axes = [_interpolation(n) for n in block.count]
        nodes = sp.kron(sp.kron(axes[2], axes[1]), axes[0])
        self.up = sp.kron(nodes, sp.eye(3)).tocsr()[block.free][:, inner]
        own = np.einsum("niiaa->nai", bricks)
        diagonal = [np.bincount(block.nodes.ravel(), own[..., i].ravel()) for i in range(3)]
        self.diagonal = np.stack(diagonal, 1).ravel()[block.free]

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Return an estimate of the error (n_free, t) that leaves `residual`."""
        return residual / self.diagonal[:, None] + self.up @ self.coarse.solve(self.up.T @ residual)


def _conjugate_gradients(matrix, right, preconditioner, progress=silent, tolerance=1e-7, limit=999):
    """Solve for all columns of `right` at once, each to `tolerance` of its own size."""
    x, residual = np.zeros_like(right), right.copy()
    step = z = preconditioner(residual)
    old, first = np.einsum("nt,nt->t", residual, z), None
    for count in range(limit):
        if first is None:
            first = old
        worst = np.sqrt(old / np.maximum(first, 1e-300)).max()
        if worst < tolerance:
            return x
        progress(min(np.log(max(worst, tolerance)) / np.log(tolerance), 1.0), f"step {count}")
        product_ = matrix @ step
        length = old / np.maximum(np.einsum("nt,nt->t", step, product_), 1e-300)
        x += length * step
        residual -= length * product_
        z = preconditioner(residual)
        new = np.einsum("nt,nt->t", residual, z)
        step = z + new / np.maximum(old, 1e-300) * step
        old = new
    raise InputError(
        "the phantom's push cannot be solved: give a Poisson's ratio farther from 0.5, or stiffer "
        "tissue"
    )


def _newton(block: _Bricks, u: np.ndarray, preconditioner, steps: int = 12) -> np.ndarray:
    """Bring the internal forces at the free nodes to zero, starting from `u`."""
    scale = np.abs(block.forces(u)).max()
    for _ in range(steps):
        residual = block.forces(u)[block.free]
        if np.abs(residual).max() < 1e-6 * scale:
            return u
        matrix = block.assembled(block.stiffness(u))[block.free][:, block.free]
        u = u.copy()
        u[block.free] -= _conjugate_gradients(
            matrix, residual[:, None], preconditioner, tolerance=1e-4
        )[:, 0]
    raise InputError("the push of the neo-Hookean phantom did not converge: push less")


def _numbers(place: np.ndarray, lines) -> np.ndarray:
    """Number the places (…, 3) of a grid of `lines` (3,), x fastest."""
    return place @ np.array([1, lines[0], lines[0] * lines[1]])


def _interpolation(count: int) -> sp.csr_matrix:
    """Linear interpolation from count + 1 ends to 2·count + 1 nodes of a line."""
    at = np.arange(2 * count + 1)
    left, right = at // 2, (at + 1) // 2
    values = np.full(len(at), 0.5)
    rows = np.concatenate([at, at])
    return sp.csr_matrix((np.tile(values, 2), (rows, np.concatenate([left, right]))))


def _slopes(xi: np.ndarray) -> np.ndarray:
    """Gradients (m, 27, 3) of the 27-node brick's shape functions at ξ (m, 3) in −1…1."""
    value = np.stack([xi * (xi - 1) / 2, 1 - xi**2, xi * (xi + 1) / 2], -1)  # (m, 3 axes, 3)
    slope = np.stack([xi - 0.5, -2 * xi, xi + 0.5], -1)
    return np.stack(
        [
            np.prod([(slope if a == b else value)[:, b][:, _LOCAL[:, b]] for b in range(3)], axis=0)
            for a in range(3)
        ],
        -1,
    )
