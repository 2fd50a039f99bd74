"""A pushed cube with an inclusion, in space, true near incompressibility.

The unit cube stands on its floor, clamped or free of friction, its top is moved. Displacements come
from triquadratic bricks with discontinuous linear pressure: another element than any of the
library's, on another mesh, which does not lock.
"""

from functools import lru_cache
from itertools import product

import numpy as np
import scipy.sparse as sp
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh
from elastoidentify.linalg.factor import Factoriser
from scipy.spatial import Delaunay

PUSHES = np.array([(0, 0, -0.05), (0.04, 0, -0.035), (0, 0.04, -0.035), (-0.025, -0.025, -0.035)])
PAD = 0.75  # the pad is above this height
BOX = np.array([(0.25, 0.75), (0.25, 0.75), (0.125, 0.625)])
BALL = np.array((0.5, 0.5, 0.4)), 0.22
CONTRAST = 3.0


def inside(x, shape):
    """Whether points (…, 3) are in the inclusion."""
    if shape == "ball":
        return np.linalg.norm(x - BALL[0], axis=-1) < BALL[1]
    return ((x > BOX[:, 0]) & (x < BOX[:, 1])).all(axis=-1)


class Truth:
    """Displacements of the pushed cube from n³ triquadratic bricks.

    The dilatation enters by its projection onto (1, ξ, η, ζ) of each brick (Q2/P1, stable for every
    ν < 0.5: Hughes 1987, section 4.4). Gauss points decide which material they are in.
    """

    LOCAL = np.array(list(product(range(3), repeat=3)))

    def __init__(self, n, poisson, shape, slip):
        self.n, self.m = n, 2 * n + 1
        cells = np.array(list(product(range(n), repeat=3)))
        nodes = (2 * cells[:, None] + self.LOCAL) @ [self.m**2, self.m, 1]
        gauss, weight = np.polynomial.legendre.leggauss(3)
        xi = np.array(list(product(gauss, repeat=3)))
        weight = np.prod(list(product(weight, repeat=3)), axis=1) / (2 * n) ** 3
        slope = 2 * n * self._shapes(xi)[1]
        E = np.where(inside((cells[:, None] + 0.5 + xi / 2) / n, shape), CONTRAST, 1.0)
        lam, mu = lame_from_young(E, poisson)
        shear = np.einsum("qak,qbk,ij->qaibj", slope, slope, np.eye(3), optimize=True)
        shear += np.einsum("qaj,qbi->qaibj", slope, slope)
        basis = np.column_stack([np.ones(len(xi)), xi])
        mass = np.einsum("q,qp,qr->pr", weight, basis, basis)
        means = np.linalg.solve(
            mass, np.einsum("q,qp,qai->pai", weight, basis, slope).reshape(4, -1)
        )
        stiff = ((mu * weight) @ shear.reshape(27, -1)).reshape(-1, 81, 81)
        volume = np.einsum("nq,qp,qr->npr", lam * weight, basis, basis)
        stiff += np.einsum("pi,npr,rj->nij", means, volume, means, optimize=True)
        dofs = (3 * nodes[:, :, None] + np.arange(3)).reshape(-1, 81)
        place = np.repeat(dofs, 81, axis=1).ravel(), np.tile(dofs, (1, 81)).ravel()
        A = sp.csr_matrix((stiff.ravel(), place))
        grid = np.array(list(product(range(self.m), repeat=3)))
        top, floor = grid[:, 2] == self.m - 1, grid[:, 2] == 0
        fixed = np.zeros((self.m**3, 3), bool)
        fixed[top] = True
        fixed[floor, 2 if slip else slice(None)] = True
        self.u = np.zeros((len(PUSHES), self.m**3, 3))
        self.u[:, top] = PUSHES[:, None]
        flat, free = self.u.reshape(len(PUSHES), -1), np.flatnonzero(~fixed)
        factors = Factoriser(grid[free // 3] / self.m)(A[free][:, free])
        flat[:, free] = factors.solve(-(A[free] @ flat.T)).T

    @staticmethod
    def _shapes(xi):
        """Values and gradients of the 27 shape functions at ξ (k, 3): (k, 27), (k, 27, 3)."""
        value = np.stack([xi * (xi - 1) / 2, 1 - xi**2, xi * (xi + 1) / 2], axis=-1)
        slope = np.stack([xi - 0.5, -2 * xi, xi + 0.5], axis=-1)
        parts = [[value[:, axis][:, Truth.LOCAL[:, axis]] for axis in range(3)] for _ in range(4)]
        for axis in range(3):
            parts[axis][axis] = slope[:, axis][:, Truth.LOCAL[:, axis]]
        return np.prod(parts[3], axis=0), np.stack([np.prod(p, axis=0) for p in parts[:3]], axis=-1)

    def at(self, points):
        """Displacements at points (k, 3): (trials, k, 3)."""
        points = np.clip(points, 0, 1 - 1e-12)
        cell = (points * self.n).astype(int)
        nodes = (2 * cell[:, None] + self.LOCAL) @ [self.m**2, self.m, 1]
        value, _ = self._shapes(2 * (points * self.n - cell) - 1)
        return np.einsum("ka,tkai->tki", value, self.u[:, nodes])


@lru_cache(1)
def truth(n, poisson, shape="box", slip=False):
    """The last truth is kept: each is some 50 MB."""
    return Truth(n, poisson, shape, slip)


def unstructured(n):
    """Delaunay tetrahedra of jittered points that keep the planes of cube, pad and box."""
    points, _ = box_mesh((n, n, n), (1.0, 1.0, 1.0), "tetra")
    jitter = np.random.default_rng(0).uniform(-0.25, 0.25, points.shape) / n
    for axis, planes in enumerate(BOX):
        kept = [0, 1, *planes, *([PAD] if axis == 2 else [])]
        jitter[np.isclose(points[:, axis, None], kept).any(axis=1), axis] = 0
    points = points + jitter
    cells = Delaunay(points).simplices
    size = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])
    cells = np.where((size > 0)[:, None], cells, cells[:, [0, 2, 1, 3]])
    return points, cells[np.abs(size) > 0.03 / n**3]
