"""Forward data for claims about noise: a finer mesh and another element type than identification.

A square body with a soft-tissue inclusion and a known strip on top, pushed at the top, solved with
scikit-fem on quadratic quadrilaterals; a cube likewise, on quadratic hexahedra.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.sparse as sp
import skfem
from elastoidentify import identify
from elastoidentify.fem.forward import box_mesh, square_mesh
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay, cKDTree
from skfem.helpers import ddot, sym_grad, trace


@dataclass
class Case:
    """A body of side 30 (mm): E = 1, inclusion E = `contrast`, the top strip known with E = 1."""

    points: np.ndarray
    cells: np.ndarray
    displacements: np.ndarray  # exact, (n_trials, n_nodes, dim)
    young: np.ndarray  # true E per cell
    known: np.ndarray  # (n_cells,) bool
    poisson: float
    from_edge: np.ndarray  # distance of each cell's centre from the inclusion's edge

    @property
    def reaction(self):
        height = self.points[:, -1]
        return (height < 1e-9) | (height > SIDE - 1e-9)

    @property
    def materials(self):
        """E, ν of the known cells, NaN elsewhere: (n_cells, 2)."""
        return np.where(self.known[:, None], [1.0, self.poisson], np.nan)

    @property
    def mu(self):
        return self.young / (2 * (1 + self.poisson))

    def noisy(self, std, seed):
        noise = np.random.default_rng(seed).standard_normal(self.displacements.shape)
        return self.displacements + std * noise


SIDE = 30.0


def spoiled(case, u, count, seed=3, size=4.0):
    """Displacements of which some nodes, each in one trial, are off by `size` in any direction."""
    u, random = u.copy(), np.random.default_rng(seed)
    inner = (np.abs(case.points - SIDE / 2) < SIDE / 2 - 1).all(axis=1)
    for node in random.choice(np.flatnonzero(inner), count, replace=False):
        trial, way = random.integers(len(u)), random.standard_normal(u.shape[2])
        u[trial, node] += size * way / np.linalg.norm(way)
    return u


def found(case, displacements, kinematics="small-strain", grouping="cell", **options):
    """What is identified of a case whose segmentation shows the inclusion."""
    labels = np.where(case.known, 1, np.where(case.young > 1, 3, 2))
    return identify(
        case.points, case.cells, displacements, case.materials, labels=labels,
        reaction_nodes=case.reaction, kinematics=kinematics, grouping=grouping, **options,
    )  # fmt: skip


def contrast(case, result):
    """Young's modulus of the inclusion's inner cells over that of the tissue outside."""
    inner, outside = case.from_edge < -1, (case.from_edge > 2) & ~case.known
    return np.nanmedian(result.young[inner]) / np.nanmedian(result.young[outside])


@cache
def squares(n, poisson=0.43, contrast=3.0, radius=0.15, pushes=((0, -1.5), (-1.06, -1.06))):
    """n×n squares of two triangles, which cut the inclusion's edge as they come."""
    points, cells = square_mesh(n, n, SIDE, SIDE)
    return _case(points, cells, (15.0, 12.0), radius * SIDE, poisson, contrast, pushes, 7.5)


@cache
def published(poisson=0.495, contrast=5.0, edge=1.185, follows_edge=True, pushes=((0, -0.3),)):
    """About 1 410 unstructured triangles, one push: like a published comparison problem."""
    centre, radius = (15.0, 15.0), 4.6
    points, cells = _disc_mesh(centre, radius, edge, follows_edge)
    return _case(points, cells, centre, radius, poisson, contrast, pushes, 3.0)


@cache
def published_nodal(poisson=0.495, contrast=5.0):
    """The published comparison problem as it was posed: moduli of nodes, linear between them.

    Its displacements come from the very triangles that identification gets, plain ones.
    """
    case = published(poisson, contrast, follows_edge=False)
    inside = np.linalg.norm(case.points - 15.0, axis=1) < 4.6
    nodal = np.where(inside, contrast, 1.0)
    mesh = skfem.MeshTri(case.points.T.copy(), case.cells.T.copy(), sort_t=False)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTriP1()), intorder=2)

    @skfem.BilinearForm
    def stiffness(u, v, w):
        lam, mu = w.E * poisson / ((1 + poisson) * (1 - 2 * poisson)), w.E / (2 * (1 + poisson))
        eu, ev = sym_grad(u), sym_grad(v)
        return lam * trace(eu) * trace(ev) + 2 * mu * ddot(eu, ev)

    young = basis.with_element(skfem.ElementTriP1()).interpolate(nodal)
    top = basis.get_dofs(lambda x: np.isclose(x[1], SIDE))
    floor = basis.get_dofs(lambda x: np.isclose(x[1], 0))
    u = np.zeros(basis.N)
    u[top.all(["u^2"])] = -0.3
    fixed = np.unique(np.concatenate([top.all(), floor.all()]))
    u = skfem.solve(*skfem.condense(stiffness.assemble(basis, E=young), 0 * u, x=u, D=fixed))
    moved, E = u[basis.nodal_dofs].T[None], nodal[case.cells].mean(axis=1)
    return replace(case, displacements=moved, young=E)


@cache
def boxes(n, poisson=0.43, contrast=3.0, radius=7.0):
    """n×n×n hexahedra with a ball inside, pushed four ways."""
    points, cells = box_mesh((n, n, n), (SIDE, SIDE, SIDE))
    pushes = (0, 0, -1.5), (1.1, 0, -1.1), (0, 1.1, -1.1), (-0.8, -0.8, -1.0)
    return _case(points, cells, (15.0, 15.0, 12.0), radius, poisson, contrast, pushes, 6.0)


def _case(points, cells, centre, radius, poisson, contrast, pushes, strip):
    from_edge = np.linalg.norm(points[cells].mean(axis=1) - centre, axis=1) - radius
    young = np.where(from_edge < 0, contrast, 1.0)
    known = points[cells].mean(axis=1)[:, -1] > SIDE - strip
    u = _solve(points, centre, radius, poisson, contrast, pushes)
    for array in (points, cells, u, young, known, from_edge):
        array.flags.writeable = False  # several tests share a case
    return Case(points, cells, u, young, known, poisson, from_edge)


def symmetric_solver(K):
    """Return the solver of a symmetric sparse matrix: one factor, in an order of little fill."""
    return splu(K.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve


def stiffness(basis, lam, mu, fibres=0.0, along=None):
    """Return ∫ λ tr ε(u) tr ε(v) + 2 μ ε(u) : ε(v), of moduli at the quadrature points, sparse.

    With `fibres`, the modulus that they add in the direction `along`. One product per element, not
    one evaluation of the form per pair of shape functions: ten times as fast.
    """
    grad = np.stack([np.asarray(shape[0].grad) for shape in basis.basis])
    strain = (grad + np.swapaxes(grad, 1, 2)) / 2
    n, n_cells = len(grad), grad.shape[3]
    parts = [
        np.sqrt(2 * mu * basis.dx) * strain.reshape(n, -1, *basis.dx.shape),
        np.sqrt(lam * basis.dx) * np.einsum("niieq->neq", grad)[:, None],
    ]
    if along is not None:
        stretch = np.einsum("i,j,nijeq->neq", along, along, strain)
        parts.append((np.sqrt(fibres * basis.dx) * stretch)[:, None])
    rows = np.concatenate([np.moveaxis(part, 2, 0).reshape(n_cells, n, -1) for part in parts], 2)
    dofs = np.asarray(basis.element_dofs).T
    place = np.repeat(dofs, n, axis=1).ravel(), np.tile(dofs, (1, n)).ravel()
    blocks = rows @ np.swapaxes(rows, 1, 2)
    return sp.csr_matrix((blocks.ravel(), place), (basis.N, basis.N))


@cache
def _basis(dim):
    line = np.linspace(0, SIDE, {2: 61, 3: 9}[dim])
    mesh = {2: skfem.MeshQuad, 3: skfem.MeshHex}[dim].init_tensor(*[line] * dim)
    element = {2: skfem.ElementQuad2, 3: skfem.ElementHex2}[dim]()
    return skfem.Basis(mesh, skfem.ElementVector(element), intorder={2: 5, 3: 4}[dim])


def _solve(points, *body):
    dim = points.shape[1]
    probe = _basis(dim).probes(np.clip(points.T, 1e-9, SIDE - 1e-9))
    return np.array([(probe @ u).reshape(dim, -1).T for u in _solutions(*body)])


@cache
def _solutions(centre, radius, poisson, contrast, pushes):
    """One per push, whatever mesh then sees it."""
    dim = len(centre)
    basis = _basis(dim)
    x = np.asarray(basis.global_coordinates())
    inside = sum((x - c) ** 2 for x, c in zip(x, centre, strict=True)) < radius**2
    E = np.where(inside, contrast, 1.0)
    lam, mu = E * poisson / ((1 + poisson) * (1 - 2 * poisson)), E / (2 * (1 + poisson))
    K = stiffness(basis, lam, mu)
    top = basis.get_dofs(lambda x: np.isclose(x[-1], SIDE))
    floor = basis.get_dofs(lambda x: np.isclose(x[-1], 0))
    fixed = np.unique(np.concatenate([top.all(), floor.all()]))
    free = np.setdiff1d(np.arange(basis.N), fixed)
    solve, solutions = symmetric_solver(K[free][:, free]), []
    for push in pushes:
        u = np.zeros(basis.N)
        for axis, size in enumerate(push):
            u[top.all([f"u^{axis + 1}"])] = size
        u[free] = solve(-(K @ u)[free])
        solutions.append(u)
    return solutions


def _disc_mesh(centre, radius, edge, follows_edge, strip=3.0, seed=0):
    """Delaunay triangles of a square; nodes on the strip's border and, if asked, on the disc's."""
    line = np.linspace(0, SIDE, round(SIDE / edge) + 1)
    inner = line[1:-1]
    border = np.vstack(
        [np.column_stack(pair) for pair in (
            (line, 0 * line), (line, 0 * line + SIDE), (0 * inner, inner), (0 * inner + SIDE, inner)
        )]
    )  # fmt: skip
    corner = np.isclose(border[:, 0] % SIDE, 0) & (abs(border[:, 1] - SIDE + strip) < 0.6 * edge)
    fixed = [border[~corner], np.column_stack([line, 0 * line + SIDE - strip])]
    if follows_edge:
        angle = np.arange(round(2 * np.pi * radius / edge)) * edge / radius
        angle *= 2 * np.pi / (len(angle) * edge / radius)
        fixed.append(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    fixed = np.vstack(fixed)
    x, y = np.meshgrid(np.arange(0, SIDE, edge), np.arange(0, SIDE, edge * np.sqrt(3) / 2))
    x[1::2] += edge / 2
    free = np.column_stack([x.ravel(), y.ravel()])
    free = free[((free > 0.4 * edge) & (free < SIDE - 0.4 * edge)).all(axis=1)]
    free = free[cKDTree(fixed).query(free)[0] > 0.65 * edge]
    points = np.vstack([fixed, free])
    points[len(fixed) :] += np.random.default_rng(seed).uniform(-0.1, 0.1, free.shape) * edge
    for _ in range(10):
        cells = Delaunay(points).simplices
        total, count = np.zeros_like(points), np.zeros(len(points))
        for i, j in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
            np.add.at(total, cells[:, i], points[cells[:, j]])
            np.add.at(count, cells[:, i], 1)
        points[len(fixed) :] = (total / count[:, None])[len(fixed) :]
    cells = Delaunay(points).simplices
    x = points[cells]
    sides = x[:, 1:] - x[:, :1]
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    cells[area < 0] = cells[area < 0][:, ::-1]
    return points, cells[abs(area) > 1e-3 * edge**2]
