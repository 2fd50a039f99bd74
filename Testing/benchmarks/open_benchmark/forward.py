"""Displacements for the benchmark: scikit-fem on quadratic cells of another, finer mesh."""

from collections.abc import Callable

import numpy as np
import skfem
from elastoidentify.linalg.factor import Factoriser
from scipy.spatial import cKDTree
from skfem.helpers import ddot, sym_grad, trace


def solve(
    points: np.ndarray,
    size: tuple[float, ...],
    shape: tuple[int, ...],
    young: Callable,
    poisson: Callable,
    pushes,
    *,
    plane: str = "strain",
) -> np.ndarray:
    """Return the displacements (n_pushes, n_nodes, d) at `points` of a box that stands clamped.

    Parameters
    ----------
    size, shape : (d,)
        Edge lengths of the box and number of quadratic quadrilaterals or bricks along each.
    young, poisson : functions
        Of positions (d, …): E and ν at the Gauss points.
    pushes : sequence of (d,)
        Displacement of the top, which is glued to what moves it.
    """
    d = len(size)
    mesh = {2: skfem.MeshQuad, 3: skfem.MeshHex}[d].init_tensor(
        *[np.linspace(0, one, n + 1) for one, n in zip(size, shape, strict=True)]
    )
    element = {2: skfem.ElementQuad2, 3: skfem.ElementHex2}[d]()
    basis = skfem.Basis(mesh, skfem.ElementVector(element), intorder=4)

    @skfem.BilinearForm
    def stiffness(u, v, w):
        E, nu = young(w.x), poisson(w.x)
        lam = E * nu / ((1 + nu) * (1 - (nu if plane == "stress" else 2 * nu)))
        eu, ev = sym_grad(u), sym_grad(v)
        return lam * trace(eu) * trace(ev) + E / (1 + nu) * ddot(eu, ev)

    K = stiffness.assemble(basis)
    top = basis.get_dofs(lambda x: np.isclose(x[-1], size[-1]))
    floor = basis.get_dofs(lambda x: np.isclose(x[-1], 0))
    fixed = np.unique(np.concatenate([top.all(), floor.all()]))
    read = _reader(basis, points, size)
    K = K.tocsr()
    free = np.setdiff1d(np.arange(basis.N), fixed)
    factors = Factoriser(basis.doflocs.T[free])(K[free][:, free])
    found = []
    for push in pushes:
        u = np.zeros(basis.N)
        for axis, one in enumerate(push):
            u[top.all([f"u^{axis + 1}"])] = one
        u[free] = factors.solve(-(K[free] @ u))
        found.append(read(u))
    return np.array(found)


def _reader(basis, points, size):
    """Return a function: solution → (n, d) values at points; direct where all are nodes."""
    d = len(size)
    apart, node = cKDTree(basis.doflocs.T[::d]).query(points)
    if apart.max() < 1e-9:  # the components of a node follow one another
        return lambda u: u.reshape(-1, d)[node]
    probe = basis.probes(np.clip(points, 1e-9, np.array(size) - 1e-9).T)
    return lambda u: (probe @ u).reshape(d, -1).T


def noisy(u: np.ndarray, share: float, seed: int = 0) -> np.ndarray:
    """Add Gaussian noise of `share` times the root mean square of each trial."""
    size = np.sqrt((u**2).mean(axis=(1, 2), keepdims=True))
    return u + share * size * np.random.default_rng(seed).standard_normal(u.shape)


def known_where(mask: np.ndarray, young, poisson) -> np.ndarray:
    """Return E and ν of the cells in `mask`, NaN elsewhere. (n_cells, 2)"""
    both = np.column_stack(
        [np.broadcast_to(young, mask.shape), np.broadcast_to(poisson, mask.shape)]
    )
    return np.where(mask[:, None], both, np.nan)
