"""Forward data of bodies that break one assumption of the identification each.

The square of :mod:`forward` with its inclusion and known strip, pushed at the top, solved with
scikit-fem on quadratic quadrilaterals of a finer mesh: a pad that slides on the tissue without
friction, a Poisson's ratio that is not the one given, an inclusion that is stiffer along fibres, a
body that is stretched out of the plane. Where the model error lives is the part of the body in
which the stress is not what the identification's law makes of the same strain: `offending`.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from elastoidentify.fem.forward import square_mesh
from forward import stiffness, symmetric_solver
from skfem.helpers import sym_grad, trace

SIDE, STRIP = 30.0, 7.5
CENTRE, RADIUS = (15.0, 12.0), 4.5
PUSHES = ((0, -1.5), (-1.06, -1.06))
KINDS = ("sound", "slip", "poisson", "fibres", "stretch")


@dataclass
class Broken:
    """A body of side 30 (mm): E = 1, inclusion E = `contrast`, the top strip known with E = 1."""

    points: np.ndarray
    cells: np.ndarray
    displacements: np.ndarray  # exact, (n_trials, n_nodes, 2)
    young: np.ndarray  # true E per cell
    known: np.ndarray  # (n_cells,) bool
    poisson: float  # of everything
    offending: np.ndarray  # (n_cells,) bool: where the model error lives

    @property
    def reaction(self):
        height = self.points[:, 1]
        return (height < 1e-9) | (height > SIDE - 1e-9)

    @property
    def labels(self):
        """1 pad, 2 all the rest: the inclusion is hidden."""
        return np.where(self.known, 1, 2)

    def noisy(self, std, seed):
        noise = np.random.default_rng(seed).standard_normal(self.displacements.shape)
        return self.displacements + std * noise

    def correlated(self, std, seed, length):
        """Errors of nodes as far apart as `length` are alike, as those of a registration are."""
        noise = np.random.default_rng(seed).standard_normal(self.displacements.shape)
        gap = np.linalg.norm(self.points[:, None] - self.points[None], axis=2)
        kernel = np.exp(-((gap / length) ** 2))
        kernel /= np.linalg.norm(kernel, axis=1, keepdims=True)
        return self.displacements + std * np.einsum("ij,tjc->tic", kernel, noise)


def body(
    kind="sound", n=16, poisson=0.45, true_poisson=None, contrast=3.0, stretch=0.005, fibres=6.0,
    angle=0.6, centre=CENTRE, radius=RADIUS, pushes=PUSHES, pad_poisson=None,
):  # fmt: skip
    """Return a body whose forward solution breaks the assumption of its kind.

    Parameters
    ----------
    kind : one of :data:`KINDS`
    n : int
        n × n squares of two triangles identify.
    true_poisson : float
        Of all but the strip; `poisson` is what is given.
    stretch : float, or one per push
        Out of the plane, uniform.
    fibres, angle : float
        Young's modulus that fibres add to the inclusion along this angle (rad).
    """
    points, cells = square_mesh(n, n, SIDE, SIDE)
    place = points[cells].mean(axis=1)
    inside = np.linalg.norm(place - centre, axis=1) < radius
    known = place[:, 1] > SIDE - STRIP
    true = poisson if true_poisson is None or kind != "poisson" else true_poisson
    stretches = np.broadcast_to(stretch if kind == "stretch" else 0.0, len(pushes))
    solver = _Solver(kind == "slip")
    u = solver.solve(
        points, pushes, stretches, (poisson, true), contrast, centre, radius,
        fibres if kind == "fibres" else 0.0, angle,
    )  # fmt: skip
    top = np.isclose(points[:, 1], SIDE - STRIP)
    offending = {
        "sound": np.zeros(len(cells), bool),
        "slip": top[cells].any(axis=1),
        "poisson": ~known,
        "fibres": inside,
        "stretch": np.ones(len(cells), bool),
    }[kind]
    return Broken(points, cells, u, np.where(inside, contrast, 1.0), known, poisson, offending)


class _Solver:
    def __init__(self, slips, n=60):
        line = np.linspace(0, SIDE, n + 1)
        at = np.flatnonzero(np.isclose(line, SIDE - STRIP))[0]
        if slips:
            parts = [skfem.MeshQuad.init_tensor(line, line[: at + 1]),
                     skfem.MeshQuad.init_tensor(line, line[at:])]  # fmt: skip
            self.n_below = parts[0].t.shape[1]
            t = np.hstack([parts[0].t, parts[1].t + parts[0].p.shape[1]])
            mesh = skfem.MeshQuad(np.hstack([p.p for p in parts]), t, sort_t=False)
        else:
            mesh = skfem.MeshQuad.init_tensor(line, line)
        self.slips = slips
        element = skfem.ElementVector(skfem.ElementQuad2())
        self.basis = skfem.Basis(mesh, element, intorder=5)

    def solve(self, points, pushes, stretches, poisson, contrast, centre, radius, fibres, angle):
        basis = self.basis
        along = np.array([np.cos(angle), np.sin(angle)])

        x, y = np.asarray(basis.global_coordinates())
        inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2
        E, nu = np.where(inside, contrast, 1.0), np.where(y > SIDE - STRIP, *poisson)
        lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))

        @skfem.LinearForm
        def across(v, w):
            return -w.lam * trace(sym_grad(v))

        K = stiffness(basis, lam, mu, fibres * inside, along)
        load = across.assemble(basis, lam=lam)
        top = basis.get_dofs(lambda x: np.isclose(x[1], SIDE))
        floor = basis.get_dofs(lambda x: np.isclose(x[1], 0))
        fixed = np.unique(np.concatenate([top.all(), floor.all()]))
        tie = self._tie()
        probes = self._probes(points)
        free = np.setdiff1d(np.arange(basis.N), fixed)
        T = tie[free][:, np.flatnonzero(np.diff(tie[free].tocsc().indptr))]
        factored = symmetric_solver(T.T @ K[free][:, free] @ T)
        out = []
        for push, stretch in zip(pushes, stretches, strict=True):
            u = np.zeros(basis.N)
            for axis, size in enumerate(push):
                u[top.all([f"u^{axis + 1}"])] = size
            right = T.T @ (stretch * load - K @ u)[free]
            u[free] = T @ factored(right)
            out.append(np.mean([(p @ u).reshape(2, -1).T for p in probes], axis=0))
        return np.array(out)

    def _tie(self):
        """Dofs from independent ones: where the pad slips both sides share the normal motion."""
        N = self.basis.N
        tie = sp.identity(N, format="lil")
        if self.slips:
            x = self.basis.doflocs
            across = np.unique(self.basis.get_dofs(
                lambda x: np.isclose(x[1], SIDE - STRIP)).all(["u^2"]))  # fmt: skip
            order = across[np.lexsort((across, np.round(x[0, across], 6)))]
            first, second = order[::2], order[1::2]
            assert np.allclose(x[:, first], x[:, second])
            tie[second, second] = 0
            tie[second, first] = 1
        return tie.tocsr()

    def _probes(self, points):
        """Where the two sides move differently, a node has the mean of both."""
        points = np.clip(points, 1e-9, SIDE - 1e-9)
        if not self.slips:
            return [self.basis.probes(points.T)]
        on = np.isclose(points[:, 1], SIDE - STRIP)
        return [self.basis.probes((points + np.outer(on, (0, shift))).T) for shift in (-1e-7, 1e-7)]
