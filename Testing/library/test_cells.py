"""Cells that do not lock: consistent forces and tangents, and displacements that are right."""

from functools import cache

import numpy as np
import pytest
from elastoidentify.fem.cells import LinearCells, LockingFreeCells
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.fem.patches import PATCH_SIZE, patches, together
from scipy.sparse.linalg import spsolve

KINDS = ["triangle", "quad", "tetra", "hexahedron", "mixed"]


def distorted(kind, n=3, size=0.1, seed=0):
    if kind == "triangle":
        points, cells = square_mesh(n, n, 1.0, 1.0)
    else:
        dim = 3 if kind in ("tetra", "hexahedron") else 2
        points, cells = box_mesh((n,) * dim, (1.0,) * dim, "quad" if kind == "mixed" else kind)
    blocks = [(kind, cells)]
    if kind == "mixed":
        a, b = cells[: n * n // 2], cells[n * n // 2 :]
        blocks = [("quad", a), ("triangle", np.vstack([b[:, [0, 1, 2]], b[:, [0, 2, 3]]]))]
    shift = np.random.default_rng(seed).uniform(-size, size, points.shape) / n
    return make_mesh(points + shift, blocks)


def moduli(mesh, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(5, 50, mesh.n_cells), rng.uniform(1, 2, mesh.n_cells)


def displaced(mesh, size=0.02, seed=2):
    return size * np.random.default_rng(seed).standard_normal(mesh.points.shape)


@pytest.mark.parametrize("law", KINEMATICS.values(), ids=KINEMATICS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_tangent_is_the_derivative_of_the_forces_and_symmetric(kind, law):
    mesh = distorted(kind)
    cells, (lam, mu) = LockingFreeCells(mesh, law, patches(mesh)), moduli(mesh)
    u, d, h = displaced(mesh), displaced(mesh, 1.0, 3), 1e-6
    ahead, behind = cells.forces(u + h * d, lam, mu), cells.forces(u - h * d, lam, mu)
    K = cells.tangent(u, lam, mu)
    difference = (ahead - behind).ravel() / (2 * h)
    assert np.abs(K @ d.ravel() - difference).max() < 1e-7 * np.abs(difference).max()
    assert abs(K - K.T).max() < 1e-14 * abs(K).max()


@pytest.mark.parametrize("law", KINEMATICS.values(), ids=KINEMATICS)
@pytest.mark.parametrize("kind", KINDS)
def test_forces_are_linear_in_both_moduli(kind, law):
    mesh = distorted(kind)
    cells, (lam, mu), u = LockingFreeCells(mesh, law, patches(mesh)), moduli(mesh), displaced(mesh)
    per_lam, per_mu = cells.force_matrices(u)
    forces = cells.forces(u, lam, mu).ravel()
    assert np.abs(per_lam @ lam + per_mu @ mu - forces).max() < 1e-13 * np.abs(forces).max()
    twice = cells.forces(u, 2 * lam, 2 * mu).ravel()
    assert np.abs(twice - 2 * forces).max() < 1e-13 * np.abs(forces).max()


@pytest.mark.parametrize("law", KINEMATICS.values(), ids=KINEMATICS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_uniform_strain_gives_the_forces_of_plain_cells(kind, law):
    """The patch test: the mean dilatation of a uniform strain is the strain's own."""
    mesh = distorted(kind)
    H = 0.05 * np.random.default_rng(0).standard_normal((mesh.dim, mesh.dim))
    u, one = mesh.points @ H.T, np.ones(mesh.n_cells)
    averaged = LockingFreeCells(mesh, law, patches(mesh)).forces(u, 9 * one, one)
    plain = LinearCells(mesh, law).forces(u, 9 * one, one)
    assert np.abs(averaged - plain).max() < 1e-13 * np.abs(plain).max()


@pytest.mark.parametrize("kind", ["triangle", "tetra", "quad", "hexahedron"])
def test_patches_have_their_size_share_sides_and_stay_on_their_side_of_a_border(kind):
    mesh = distorted(kind, 6)
    known = mesh.centres[:, -1] > 0.7
    allowed = together(mesh, known.astype(int))
    patch = patches(mesh, allowed)
    size = np.bincount(patch)
    assert np.array_equal(np.unique(patch), np.arange(len(size)))
    inside = np.bincount(patch, known)
    assert np.isin(inside / size, [0, 1]).all()
    assert 0.75 * PATCH_SIZE[kind] <= size.mean() <= 1.5 * PATCH_SIZE[kind]
    # connected: within a patch of k cells at least k − 1 pairs of cells share a side
    pairs, _ = mesh.interfaces
    same = pairs[patch[pairs[:, 0]] == patch[pairs[:, 1]]]
    assert (np.bincount(patch[same[:, 0]], minlength=len(size)) >= size - 1).all()


def test_stiff_known_cells_are_not_averaged_with_soft_ones():
    mesh = distorted("triangle", 6)
    lam = np.where(mesh.centres[:, 0] > 0.5, 100.0, 1.0)
    patch = patches(mesh, together(mesh, np.zeros(mesh.n_cells, int), lam))
    stiff = np.bincount(patch, lam > 1) / np.bincount(patch)
    assert np.isin(stiff, [0, 1]).all()


BEND = {2: np.array([0.04, -0.05]), 3: np.array([0.04, 0.0, -0.05])}


@cache
def bent_block(dim, poisson):
    """Floor clamped, top pushed sideways and down: scikit-fem, quadratic cells, finer mesh."""
    import skfem
    from forward import stiffness, symmetric_solver

    fine = {2: skfem.MeshQuad, 3: skfem.MeshHex}[dim].init_tensor(
        *[np.linspace(0, 1, {2: 25, 3: 7}[dim])] * dim
    )
    element = {2: skfem.ElementQuad2, 3: skfem.ElementHex2}[dim]()
    basis = skfem.Basis(fine, skfem.ElementVector(element), intorder=4)
    K = stiffness(basis, *(v * np.ones_like(basis.dx) for v in lame_from_young(1.0, poisson)))
    top = basis.get_dofs(lambda x: np.isclose(x[-1], 1))
    floor = basis.get_dofs(lambda x: np.isclose(x[-1], 0))
    exact = np.zeros(basis.N)
    for axis in range(dim):
        exact[top.all([f"u^{axis + 1}"])] = BEND[dim][axis]
    free = np.setdiff1d(np.arange(basis.N), np.concatenate([top.all(), floor.all()]))
    exact[free] = symmetric_solver(K[free][:, free])(-(K @ exact)[free])
    return basis, exact


@pytest.mark.parametrize(("kind", "n"), [("triangle", 12), ("tetra", 6), ("hexahedron", 6)])
@pytest.mark.parametrize("poisson", [0.3, 0.499])
def test_a_bent_block_moves_as_quadratic_cells_say(kind, n, poisson):
    dim = 2 if kind == "triangle" else 3
    basis, exact = bent_block(dim, poisson)
    lam, mu = (float(v) for v in lame_from_young(1.0, poisson))
    square = square_mesh(n, n, 1.0, 1.0)
    points, cells = square if dim == 2 else box_mesh((n,) * dim, (1.0,) * dim, kind)
    mesh = make_mesh(points, [(kind, cells)])
    truth = (basis.probes(np.clip(points.T, 1e-9, 1 - 1e-9)) @ exact).reshape(dim, -1).T
    error = {}
    one = np.ones(mesh.n_cells)
    for family in (
        LinearCells(mesh, KINEMATICS["small-strain"]),
        LockingFreeCells(mesh, KINEMATICS["small-strain"], patches(mesh)),
    ):
        u = np.where(points[:, -1:] > 1 - 1e-9, BEND[dim], 0.0)
        free = np.repeat((points[:, -1] > 1e-9) & (points[:, -1] < 1 - 1e-9), dim)
        K = family.tangent(u, lam * one, mu * one)
        flat = u.ravel()
        flat[free] = spsolve(K[free][:, free].tocsc(), -(K @ flat)[free])
        error[family.name] = np.sqrt(((flat.reshape(-1, dim) - truth) ** 2).mean())
    print(kind, poisson, error)
    assert error["locking-free"] < 0.02 * 0.05
    if poisson > 0.49:
        assert error["locking-free"] < 0.4 * error["linear"]
