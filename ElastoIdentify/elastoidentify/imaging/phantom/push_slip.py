"""The push of a phantom whose pad slides on the tissue without friction.

Pad and tissue are two grids of quadratic quadrilaterals. The pad's nodes on the interface stay on
the tissue's deformed surface, along which they may slide as far as the push takes them (until they
leave it at its end); Lagrange's multipliers are the normal forces.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ...errors import InputError
from ...installation import needs
from ...progress import Progress, silent
from .push import Deformation, Moduli, _Block

STEPS, SEARCHES = 30, 5  # Newton steps; after so many, nodes stay on the part where they are


@dataclass(frozen=True)
class SlippingDeformation:
    """The deformations of two bodies that meet at a height, y downwards."""

    upper: Deformation
    lower: Deformation
    edge: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the displacement (n, 2) at points (n, 2) at rest."""
        above = points[:, 1:] < self.edge
        return np.where(above, self.upper(points), self.lower(points))

    def inverse(self, points: np.ndarray) -> np.ndarray:
        """Return what (n, 2) at rest is seen at `points`; in a gap, the body that is nearer."""
        high, low = (body.inverse(points) for body in (self.upper, self.lower))
        outside = np.column_stack([high[:, 1] - self.edge, self.edge - low[:, 1]])
        return np.where((outside[:, 0] < outside[:, 1])[:, None], high, low)


def slipping_at(share: float) -> Callable:
    """Return a solver as :func:`.push.solve_pushes`, slip at a `share` of the height."""

    def solve(
        width: float,
        height: float,
        margin: float,
        moduli: Moduli,
        pushes: np.ndarray,
        *,
        elements: int = 80,
        kinematics: str = "small-strain",
        progress: Progress | None = None,
    ) -> list[SlippingDeformation]:
        if kinematics not in ("small-strain", "neo-hookean"):
            raise InputError(f"kinematics {kinematics!r}: give small-strain or neo-hookean")
        progress, edge = progress or silent, share * height
        x = width / elements
        beside = int(np.ceil(margin / x)) + 2
        columns = x * np.arange(-beside, elements + beside + 1)
        pad, tissue = (
            _Part(columns, low, high, max(round((high - low) / x), 2), width, moduli)
            for low, high in ((0.0, edge), (edge, height))
        )
        found = []
        for trial, push in enumerate(np.asarray(pushes, float)):
            progress(trial / len(pushes), f"pushing trial {trial + 1}")
            above, below = _solve(pad, tissue, edge, push, kinematics == "neo-hookean")
            found.append(SlippingDeformation(pad.field(above), tissue.field(below), edge))
        return found

    return solve


class _Part:
    """One body between two heights, with the air beside it."""

    def __init__(self, columns, low, high, rows, width, moduli):
        try:
            import skfem
        except ImportError:
            raise InputError(f"making a phantom {needs('scikit-fem', 'demo')}") from None
        lines = low + (high - low) / rows * np.arange(rows + 1)
        mesh = skfem.MeshQuad.init_tensor(columns, lines)
        self.basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad2()), intorder=4)
        self.block, self.n = _Block(self.basis, width, moduli), self.basis.N
        self.component = np.zeros(self.n, int)
        for dofs in (self.basis.nodal_dofs, self.basis.facet_dofs, self.basis.interior_dofs):
            self.component[dofs] = np.arange(dofs.shape[0])[:, None] % 2
        self.start = np.array([columns[0], low])
        self.step = np.array([columns[1] - columns[0], (high - low) / rows]) / 2
        self.shape = 2 * len(lines) - 1, 2 * len(columns) - 1
        self.places = self.basis.doflocs
        self.width = width

    def along(self, y) -> tuple[np.ndarray, np.ndarray]:
        """The solid's nodes at a height by x: degrees of freedom (k, 2), and x (k,)."""
        here = np.isclose(self.places[1], y)
        x = self.places[0]
        here &= (x > -1e-6 * self.width) & (x < self.width * (1 + 1e-6))
        both = [np.flatnonzero(here & (self.component == axis)) for axis in (0, 1)]
        both = [dofs[np.argsort(x[dofs])] for dofs in both]
        return np.column_stack(both), x[both[0]]

    def field(self, u) -> Deformation:
        index = np.rint((self.places.T - self.start) / self.step).astype(int)
        grid = np.empty((2, *self.shape))
        grid[self.component, index[:, 1], index[:, 0]] = u
        return Deformation.of_grid(self.start, self.step, grid)


def _solve(pad, tissue, edge, push, finite):
    """Displacements of both parts in balance."""
    n = pad.n + tissue.n
    u = np.zeros(n)
    moved = np.flatnonzero(np.isclose(pad.places[1], 0.0))
    u[moved] = push[pad.component[moved]]
    floor = pad.n + np.flatnonzero(np.isclose(tissue.places[1], tissue.places[1].max()))
    free = np.setdiff1d(np.arange(n), np.concatenate([moved, floor]))
    (above, x), (below, _) = pad.along(edge), tissue.along(edge)
    rest, below = np.column_stack([x, np.full(len(x), edge)]), below + pad.n
    zero = [part.block.stiffness(np.zeros(part.n)) for part in (pad, tissue)]
    where = _under(rest, rest)
    for step in range(STEPS):
        # the first step is small strain, which takes the inside along with the indenter
        parts = list(zip((pad, tissue), np.split(u, [pad.n]), zero, strict=True))
        if finite and step:
            f = np.concatenate([part.block.forces(v) for part, v, _ in parts])
            K = sp.block_diag([part.block.stiffness(v) for part, v, _ in parts], format="csr")
            if step <= SEARCHES:
                where = _under(rest + u[above], rest + u[below])
        else:
            f = np.concatenate([K @ v for _, v, K in parts])
            K = sp.block_diag(zero, format="csr")
        C = _rows(where, above, below, n)
        gap = C @ u + where.offset(rest)
        C = C[:, free]
        matrix = sp.bmat(
            [[K[free][:, free], C.T], [C, -1e-12 * sp.identity(C.shape[0])]], format="csc"
        )
        change = splu(matrix).solve(np.concatenate([-f[free], -gap]))[: len(free)]
        u[free] += change
        if np.abs(change).max() < 1e-8 * pad.width:
            return np.split(u, [pad.n])
    raise InputError("the push of the slipping phantom did not converge: push less")


@dataclass(frozen=True)
class _Where:
    """Which upper nodes stand on which parts of the lower surface."""

    on: np.ndarray  # (m,) upper nodes that have not left it
    segment: np.ndarray  # (m,) lower node at the part's beginning
    share: np.ndarray  # (m,) way to the next one
    normal: np.ndarray  # (m, 2)

    def offset(self, rest):
        """What of the gap does not come from displacements."""
        k, s = self.segment, self.share[:, None]
        return (self.normal * (rest[self.on] - (1 - s) * rest[k] - s * rest[k + 1])).sum(axis=1)


def _under(upper, lower) -> _Where:
    """Find the lower surface (k, 2) under the upper nodes (k, 2)."""
    a, e = lower[:-1], np.diff(lower, axis=0)
    share = np.einsum("psi,si->ps", upper[:, None] - a, e) / (e**2).sum(axis=1)
    nearest = a + np.clip(share, 0, 1)[..., None] * e
    segment = np.linalg.norm(upper[:, None] - nearest, axis=2).argmin(axis=1)
    share = share[np.arange(len(upper)), segment]
    on = np.flatnonzero((share > -1e-9) & (share < 1 + 1e-9))
    segment = segment[on]
    normal = np.column_stack([-e[segment, 1], e[segment, 0]])
    return _Where(on, segment, share[on], normal / np.linalg.norm(normal, axis=1)[:, None])


def _rows(where, above, below, n):
    """Rows of the relative normal motion, (m, n)."""
    k, s = where.segment, where.share[:, None]
    parts = (above[where.on], 1.0), (below[k], s - 1), (below[k + 1], -s)
    row = np.repeat(np.arange(len(k)), 2)
    entries = [(row, dofs.ravel(), (w * where.normal).ravel()) for dofs, w in parts]
    row, col, value = (np.concatenate(one) for one in zip(*entries, strict=True))
    return sp.csr_matrix((value, (row, col)), (len(k), n))
