"""Forward data of a pad that slides on tissue without friction.

Pad and tissue are two bodies of quadratic quadrilaterals (hexahedra) of scikit-fem, on a mesh three
times as fine as the one that identifies. The pad's nodes may not leave the tissue's surface: in
small strain the surface at rest, in finite strain the deformed one, on which they slide as far as
the push takes them; the normal forces are Lagrange's multipliers.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from elastoidentify.fem.forward import box_mesh, square_mesh
from forward import stiffness
from scipy.sparse.linalg import splu
from skfem.helpers import ddot

SIDE, PAD = 30.0, 0.25
PAD_LABEL, TISSUE_LABEL = 1, 2
E_PAD, E_TISSUE, CONTRAST, POISSON = 5.0, 3.0, 3.0, 0.45


@dataclass
class Slipping:
    """What identifies: cells of both labels, with nodes of their own along the interface."""

    points: np.ndarray
    cells: np.ndarray
    labels: np.ndarray
    displacements: np.ndarray  # exact, (t, n, d)
    inside: np.ndarray  # (m,) bool: cells of the inclusion, which has no label of its own

    @property
    def reaction(self):
        """Nodes of floor and indenter."""
        height = self.points[:, -1]
        return (height < 1e-9) | (height > SIDE - 1e-9)

    def noisy(self, share, seed=0):
        """Displacements with noise of a share of their root mean square."""
        u = self.displacements
        noise = np.random.default_rng(seed).standard_normal(u.shape)
        return u + share * np.sqrt((u**2).mean()) * noise

    def contrast(self, values):
        """Median of the inclusion over that of the tissue, and the tissue's."""
        tissue = (self.labels == TISSUE_LABEL) & ~self.inside
        middle = np.nanmedian(values[tissue])
        return np.nanmedian(values[self.inside]) / middle, middle


def flat(x):
    """Height of the interface: straight."""
    return np.full(np.shape(x), (1 - PAD) * SIDE)


def arched(x):
    """Height of the interface: curved, its ends lower by a tenth of the width."""
    return (1 - PAD) * SIDE - 0.1 * SIDE * (2 * np.asarray(x) / SIDE - 1) ** 2


def slab(
    n=16, surface=flat, kinematics="small-strain", *, exact=False, stuck=False, floor="stuck",
    pushes=((0, -1.5), (1.05, -1.05)),
):  # fmt: skip
    """n × n squares of two triangles, with a disc in the tissue.

    Parameters
    ----------
    exact : bool
        Solve on these triangles (linear ones), so that the data are exact for them.
    stuck : bool
        Pad and tissue stick together.
    floor : "stuck", "sliding"
    pushes : sequence of (x, y) or (x, y, tilt)
        Motion of the indenter. On a flat interface x moves the pad only, and all that the tissue
        gets is pushes of one direction; a tilt is another.
    """
    centre, radius = np.array([16.5, 11.0]), 4.5
    edge, rows, fine = (1 - PAD) * SIDE, round(PAD * n), 3
    parts, meshes = [], []
    for low, high, count in ((0.0, edge, n - rows), (edge, SIDE, rows)):

        def lift(points, low=low, high=high):
            top = surface(points[:, 0])
            bottom, top = (0.0, top) if low == 0 else (top, SIDE)
            share = (points[:, 1] - low) / (high - low)
            return np.column_stack([points[:, 0], bottom + share * (top - bottom)])

        points, cells = square_mesh(n, count, SIDE, high - low)
        points = lift(points + np.array([0, low]))
        parts.append((points, cells))
        x, y = np.linspace(0, SIDE, fine * n + 1), np.linspace(low, high, fine * count + 1)
        quads = skfem.MeshQuad.init_tensor(x, y)
        quads = skfem.MeshQuad(np.ascontiguousarray(lift(quads.p.T).T), quads.t)
        meshes.append(
            skfem.MeshTri(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
            if exact
            else quads
        )
    element = skfem.ElementVector(skfem.ElementTriP1() if exact else skfem.ElementQuad2())

    def inside(x):
        # exact data: cells are inside or not, as a whole
        at = x.mean(axis=2, keepdims=True) if exact else x
        return np.hypot(at[0] - centre[0], at[1] - centre[1]) < radius + 0 * x[0]

    def hidden(centres):
        return np.hypot(*(centres - centre).T) < radius

    contact = (surface, kinematics, stuck, floor)
    return _case(parts, meshes, element, inside, hidden, pushes, contact)


def block(n=6, *, exact=False, pushes=((0, 0, -1.5), (0.8, 0, -1.1), (0, 0.8, -1.1))):
    """n × n × n hexahedra with a ball in the tissue, in small strain; as :func:`slab`."""
    rows = max(round(PAD * n), 1)
    edge, centre, radius = (1 - rows / n) * SIDE, np.array([15.0, 15.0, 11.0]), 6.5
    parts, meshes, line = [], [], np.linspace(0, SIDE, n + 1)
    for low, high, count in ((0.0, edge, n - rows), (edge, SIDE, rows)):
        points, cells = box_mesh((n, n, count), (SIDE, SIDE, high - low))
        parts.append((points + np.array([0, 0, low]), cells))
        meshes.append(skfem.MeshHex.init_tensor(line, line, np.linspace(low, high, count + 1)))

    def inside(x):
        at = x.mean(axis=2, keepdims=True) if exact else x
        return ((at - centre[:, None, None]) ** 2).sum(axis=0) < radius**2 + 0 * x[0]

    def hidden(centres):
        return np.linalg.norm(centres - centre, axis=1) < radius

    contact = (lambda x: np.full(np.shape(x), edge), "small-strain", False, "stuck")
    element = skfem.ElementVector(skfem.ElementHex1() if exact else skfem.ElementHex2())
    return _case(parts, meshes, element, inside, hidden, pushes, contact)


def _case(parts, meshes, element, inside, hidden, pushes, contact):
    bodies = [_Body(mesh, element, inside, pad) for pad, mesh in enumerate(meshes)]
    u = [_push(bodies, np.array(push, float), *contact) for push in pushes]
    displacements = np.concatenate(
        [
            np.stack([body.at(part[0], solution[k]) for solution in u])
            for k, (body, part) in enumerate(zip(bodies, parts, strict=True))
        ],
        axis=1,
    )
    points = np.concatenate([part[0] for part in parts])
    cells = np.concatenate([parts[0][1], parts[1][1] + len(parts[0][0])])
    labels = np.repeat([TISSUE_LABEL, PAD_LABEL], [len(part[1]) for part in parts])
    lesion = (labels == TISSUE_LABEL) & hidden(points[cells].mean(axis=1))
    return Slipping(points, cells, labels, displacements, lesion)


class _Body:
    def __init__(self, mesh, element, inside, pad):
        order = 3 if isinstance(element.elem, skfem.ElementHex1) else 4
        self.mesh, self.basis = mesh, skfem.Basis(mesh, element, intorder=order)
        self.dim = mesh.dim()
        stiff = inside(np.asarray(self.basis.global_coordinates()))
        E = np.where(pad, E_PAD, E_TISSUE * np.where(stiff, CONTRAST, 1.0))
        self.lam = E * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
        self.mu = E / (2 * (1 + POISSON))
        self.small = stiffness(self.basis, self.lam, self.mu)
        # nodes (vertices, mid-edges, …): place and degrees of freedom
        where = np.round(self.basis.doflocs.T, 9)
        order = np.lexsort(where.T)
        self.dofs = order.reshape(-1, self.dim)
        # the components of a node in their order
        self.dofs.sort(axis=1)
        self.places = where[self.dofs[:, 0]]

    def at(self, points, u):
        """Displacements at points that are nodes."""
        from scipy.spatial import cKDTree

        distance, node = cKDTree(self.places).query(points)
        assert distance.max() < 1e-6
        return u[self.dofs[node]]

    def system(self, u, finite):
        """Forces and stiffness at u."""
        eye = np.eye(self.dim)[:, :, None, None]
        if not finite:
            return self.small @ u, self.small
        F = eye + self.basis.interpolate(u).grad
        inverse = np.moveaxis(np.linalg.inv(np.moveaxis(F, (0, 1), (2, 3))), (2, 3), (0, 1))
        log_j = np.log(np.linalg.det(np.moveaxis(F, (0, 1), (2, 3))))
        stress = self.mu * F + (self.lam * log_j - self.mu) * np.swapaxes(inverse, 0, 1)
        f = _stress.assemble(self.basis, stress=stress)
        K = _tangent_large.assemble(
            self.basis, lam=self.lam, mu=self.mu, log_j=log_j, inverse=inverse
        )
        return f, K


@skfem.LinearForm
def _stress(v, w):
    return ddot(w.stress, v.grad)


@skfem.BilinearForm
def _tangent_large(u, v, w):
    a, b = (np.einsum("ik...,kj...->ij...", w.inverse, g) for g in (u.grad, v.grad))
    trace_a, trace_b = (sum(m[i, i] for i in range(len(m))) for m in (a, b))
    return (
        w.mu * ddot(u.grad, v.grad)
        + (w.mu - w.lam * w.log_j) * ddot(np.swapaxes(a, 0, 1), b)
        + w.lam * trace_a * trace_b
    )


def _push(bodies, push, surface, kinematics, stuck, floor, steps=30):
    tissue, pad = bodies
    finite = kinematics == "neo-hookean"
    n = tissue.basis.N, pad.basis.N
    on_floor = tissue.dofs[np.abs(tissue.places[:, -1]) < 1e-7]
    on_top = pad.dofs[np.abs(pad.places[:, -1] - SIDE) < 1e-7]
    # a body between two that slide is held in one node, where no force is needed
    held = on_floor if floor == "stuck" else np.append(on_floor[:, -1], on_floor[0])
    u = np.zeros(sum(n))
    free = np.setdiff1d(np.arange(sum(n)), np.concatenate([held.ravel(), n[0] + on_top.ravel()]))
    u[n[0] + on_top] = push[: tissue.dim]
    if len(push) > tissue.dim:
        tilt = push[-1] * (pad.places[:, 0] - SIDE / 2)
        u[n[0] + on_top[:, -1]] += tilt[np.abs(pad.places[:, -1] - SIDE) < 1e-7]
    contact = _Contact(bodies, surface, finite, stuck)
    for step in range(steps):
        # the first step is small strain, which takes the inside along with the indenter
        parts = [
            body.system(part, finite and step > 0)
            for body, part in zip(bodies, np.split(u, n[:1]), strict=True)
        ]
        f, K = np.concatenate([f for f, _ in parts]), sp.block_diag([K for _, K in parts], "csr")
        C, gap = contact.at(u, step > 0, step > 5)
        C = C[:, free]
        matrix = sp.bmat(
            [[K[free][:, free], C.T], [C, -1e-12 * sp.identity(C.shape[0])]], format="csc"
        )
        change = splu(matrix).solve(np.concatenate([-f[free], -gap]))[: len(free)]
        u[free] += change
        if np.abs(change).max() < 1e-9 * SIDE:
            return np.split(u, n[:1])
    raise AssertionError(f"the push did not converge: {np.abs(change).max()}")


class _Contact:
    """Rows C and gaps of: the pad's nodes stay on the tissue's surface."""

    def __init__(self, bodies, surface, finite, stuck):
        self.finite, self.stuck = finite, stuck
        tissue, pad = bodies
        self.n = tissue.basis.N, pad.basis.N
        self.d = tissue.dim
        self.low, self.high = (self._on(body, surface) for body in bodies)
        self.x_low, self.x_high = tissue.places[self.low], pad.places[self.high]
        assert np.allclose(self.x_low, self.x_high, atol=1e-6)
        self.low, self.high = tissue.dofs[self.low], self.n[0] + pad.dofs[self.high]

    def _on(self, body, surface):
        # the middles of the edges of a curved surface lie a little off it
        x = body.places
        line = np.unique(np.round(body.mesh.p[0], 9))
        chord = np.interp(x[:, 0], line, surface(line))
        nodes = np.flatnonzero(np.abs(x[:, -1] - chord) < 1e-6)
        return nodes[np.lexsort(x[nodes, :-1].T)]

    def at(self, u, deformed, settled):
        if self.stuck:
            eye = sp.identity(sum(self.n), format="csr")
            C = eye[self.high.ravel()] - eye[self.low.ravel()]
            return C, C @ u
        if self.d == 3 or not (self.finite and deformed):
            normal = self._normals(self.x_low)
            C = self._rows(normal, self.low[:, None], np.ones((len(normal), 1)), self.high)
            return C, C @ u
        y_low, y_high = self.x_low + u[self.low], self.x_high + u[self.high]
        if not settled:
            self._project(y_low, y_high)
        segment, s, normal, on = self.found  # where nodes are found by now: else some flip for ever
        C = self._rows(
            normal,
            np.stack([self.low[segment], self.low[segment + 1]], axis=1),
            np.column_stack([1 - s, s]),
            self.high[on],
        )
        below = y_low[segment] + s[:, None] * (y_low[segment + 1] - y_low[segment])
        return C, (normal * (y_high[on] - below)).sum(axis=1)

    def _project(self, y_low, y_high):
        a, e = y_low[:-1], np.diff(y_low, axis=0)
        s = np.einsum("psi,si->ps", y_high[:, None] - a, e) / (e**2).sum(axis=1)
        off = np.linalg.norm(y_high[:, None] - a - np.clip(s, 0, 1)[..., None] * e, axis=2)
        segment = off.argmin(axis=1)
        s = s[np.arange(len(s)), segment]
        on = (s > -1e-9) & (s < 1 + 1e-9)  # the others have slid off
        segment, s = segment[on], s[on]
        normal = np.column_stack([-e[segment, 1], e[segment, 0]])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        self.found = segment, s, normal, on

    def _rows(self, normal, below, shares, above):
        m, d = normal.shape
        row = np.arange(m)
        parts = [(np.repeat(row, d), above.ravel(), normal.ravel())]
        for k in range(below.shape[1]):
            value = -(shares[:, k, None] * normal).ravel()
            parts.append((np.repeat(row, d), below[:, k].ravel(), value))
        r, c, v = (np.concatenate(part) for part in zip(*parts, strict=True))
        return sp.csr_matrix((v, (r, c)), (m, sum(self.n)))

    def _normals(self, x):
        if self.d == 3:
            return np.tile([0.0, 0.0, 1.0], (len(x), 1))
        along = np.gradient(x[:, 1], x[:, 0])
        normal = np.column_stack([-along, np.ones(len(x))])
        return normal / np.linalg.norm(normal, axis=1)[:, None]
