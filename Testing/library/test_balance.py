"""Nodal forces against the paper's closed form, scikit-fem, the patch test and differences."""

import numpy as np
import pytest
import skfem
from elastoidentify.fem.assembly import (
    force_matrices,
    internal_forces,
    partial_connection_matrices,
    tangent_stiffness,
)
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.elements import CELL_TYPES
from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.fem.mesh import make_mesh
from skfem.helpers import ddot, sym_grad, trace

SKFEM = {
    "triangle": (skfem.MeshTri, skfem.ElementTriP1, skfem.ElementTriP0),
    "quad": (skfem.MeshQuad, skfem.ElementQuad1, skfem.ElementQuad0),
    "tetra": (skfem.MeshTet, skfem.ElementTetP1, skfem.ElementTetP0),
    "hexahedron": (skfem.MeshHex, skfem.ElementHex1, skfem.ElementHex0),
}
KINDS = list(CELL_TYPES)


def distorted(kind, size=3, seed=0):
    dim = CELL_TYPES[kind].dim
    if kind == "triangle":
        points, cells = square_mesh(size, size, 1, 1, "crossed")
    else:
        points, cells = box_mesh((size,) * dim, np.ones(dim), kind)
    inner = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    shift = np.random.default_rng(seed).uniform(-0.2, 0.2, points.shape) / size
    return points + inner[:, None] * shift, [(kind, cells)]


def mixed():
    points, quads = box_mesh((3, 4), (1.0, 1.0), "quad")
    upper = quads[6:]
    triangles = np.concatenate([upper[:, [0, 1, 3]], upper[:, [1, 2, 3]]])
    inner = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    points = points + inner[:, None] * np.random.default_rng(1).uniform(-0.05, 0.05, points.shape)
    return points, [("quad", quads[:6]), ("triangle", triangles)]


MESHES = {**{kind: lambda kind=kind: distorted(kind) for kind in KINDS}, "mixed": mixed}
every_mesh = pytest.mark.parametrize("make", list(MESHES))
every_law = pytest.mark.parametrize("law", list(KINEMATICS.values()), ids=lambda law: law.name)


def random_moduli(mesh, seed=2):
    rng = np.random.default_rng(seed)
    return rng.uniform(1, 5, mesh.n_cells), rng.uniform(1, 5, mesh.n_cells)


def small_push(mesh, size=0.02, seed=3):
    return size * np.random.default_rng(seed).standard_normal(mesh.points.shape)


def test_connection_matrices_of_the_triangle_are_the_papers_closed_form():
    mesh = make_mesh(*distorted("triangle"))
    found = partial_connection_matrices(mesh.blocks[0])
    for corners, J_lam, J_mu in zip(mesh.points[mesh.blocks[0].nodes], *found, strict=True):
        (xi, yi), (xj, yj), (xk, yk) = corners
        # ∂N/∂x = b/2A, ∂N/∂y = c/2A of nodes i, j, k
        b, c = np.array([yj - yk, yk - yi, yi - yj]), np.array([xk - xj, xi - xk, xj - xi])
        area = (b[0] * c[1] - b[1] * c[0]) / 2
        B = np.zeros((3, 6))  # strains xx, yy, shear xy
        B[0, 0::2], B[1, 1::2], B[2, 0::2], B[2, 1::2] = b, c, c, b
        B /= 2 * area
        D_lam = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0]])
        D_mu = np.diag([2, 2, 1])
        assert np.allclose(J_lam, area * B.T @ D_lam @ B, atol=1e-12)
        assert np.allclose(J_mu, area * B.T @ D_mu @ B, atol=1e-12)


def skfem_stiffness(kind, points, cells, lam, mu):
    """The stiffness matrix of the same mesh by scikit-fem, in our order of the unknowns."""
    mesh_type, element, constant = SKFEM[kind]
    ours = CELL_TYPES[kind].corners
    ours = (ours + 1) / 2 if ours.min() < 0 else ours  # scikit-fem's reference cells are 0…1
    order = [np.abs(ours - corner).sum(axis=1).argmin() for corner in mesh_type.elem.refdom.p.T]
    mesh = mesh_type(points.T.copy(), cells[:, order].T.copy())
    basis = skfem.Basis(mesh, skfem.ElementVector(element()), intorder=3)
    moduli = basis.with_element(constant())

    @skfem.BilinearForm
    def stiffness(u, v, w):
        e, f = sym_grad(u), sym_grad(v)
        return w.lam * trace(e) * trace(f) + 2 * w.mu * ddot(e, f)

    K = stiffness.assemble(basis, lam=moduli.interpolate(lam), mu=moduli.interpolate(mu))
    dofs = basis.nodal_dofs.T.ravel()  # node by node
    return K.tocsr()[dofs][:, dofs]


@pytest.mark.parametrize("kind", KINDS)
def test_stiffness_of_distorted_cells_with_their_own_moduli_is_scikit_fems(kind):
    points, cells = distorted(kind)
    mesh = make_mesh(points, cells)
    lam, mu = random_moduli(mesh)
    ours = tangent_stiffness(mesh, KINEMATICS["small-strain"], 0 * points, lam, mu)
    theirs = skfem_stiffness(kind, points, cells[0][1], lam, mu)
    assert abs(ours - theirs).max() < 1e-12 * abs(theirs).max()


@pytest.mark.parametrize("kind", KINDS)
def test_connection_matrices_times_displacement_are_the_nodal_forces(kind):
    mesh = make_mesh(*distorted(kind))
    lam, mu = random_moduli(mesh)
    u = small_push(mesh)
    (block,) = mesh.blocks
    J_lam, J_mu = partial_connection_matrices(block)
    J = lam[:, None, None] * J_lam + mu[:, None, None] * J_mu
    total = np.zeros(mesh.n_dofs)
    np.add.at(total, block.dofs, np.einsum("nij,nj->ni", J, u.ravel()[block.dofs]))
    forces = internal_forces(mesh, KINEMATICS["small-strain"], u, lam, mu)
    assert np.allclose(total, forces.ravel(), atol=1e-13)


@every_mesh
@every_law
def test_patch_a_linear_displacement_leaves_inner_nodes_in_balance_and_has_constant_stress(
    make, law
):
    points, cells = MESHES[make]()
    mesh = make_mesh(points, cells)
    H = np.array([[0.1, 0.05, -0.04], [-0.02, -0.12, 0.03], [0.06, 0.01, 0.08]])
    H = H[: mesh.dim, : mesh.dim]
    lam, mu = np.full(mesh.n_cells, 3.0), np.full(mesh.n_cells, 2.0)
    forces = internal_forces(mesh, law, points @ H.T, lam, mu)
    P_lam, P_mu = law.stress(H)
    P = 3 * P_lam + 2 * P_mu
    assert np.abs(forces[~mesh.boundary_nodes]).max() < 1e-14 * np.abs(P).max()
    # virtual work: Σ f ⊗ X = ∫ P dV, for the whole (volume 1)
    assert np.allclose(forces.T @ points, P, atol=1e-13)
    # inside the side x = 1 every node carries its share of the traction P n
    inside = ((points[:, 1:] > 1e-9) & (points[:, 1:] < 1 - 1e-9)).all(axis=1)
    on_side = forces[np.isclose(points[:, 0], 1) & inside]
    assert len(on_side)
    assert np.allclose(on_side / on_side[:, :1], P[:, 0] / P[0, 0], atol=1e-11)


@every_mesh
@every_law
def test_forces_are_linear_in_the_moduli_and_balance_as_a_whole(make, law):
    mesh = make_mesh(*MESHES[make]())
    (lam, mu), u = random_moduli(mesh), small_push(mesh)
    forces = internal_forces(mesh, law, u, lam, mu)
    per_lam, per_mu = force_matrices(mesh, law, u)
    assert np.allclose(per_lam @ lam + per_mu @ mu, forces.ravel(), atol=1e-13)
    assert np.abs(forces.sum(axis=0)).max() < 1e-13
    moment = np.einsum("ni,nj->ij", forces, mesh.points + (0 if law.linear else u))
    assert np.allclose(moment, moment.T, atol=1e-13)


@every_mesh
@every_law
def test_tangent_stiffness_is_the_derivative_of_the_forces(make, law):
    mesh = make_mesh(*MESHES[make]())
    (lam, mu), u = random_moduli(mesh), small_push(mesh)
    K = tangent_stiffness(mesh, law, u, lam, mu)
    assert abs(K - K.T).max() < 1e-12 * abs(K).max()  # there is a strain energy
    for seed in range(3):
        du = 1e-6 * small_push(mesh, 1.0, seed)
        ahead, behind = (internal_forces(mesh, law, u + s * du, lam, mu) for s in (1, -1))
        slope = ((ahead - behind) / 2).ravel()
        assert np.abs(K @ du.ravel() - slope).max() < 1e-7 * np.abs(slope).max()


@every_mesh
@pytest.mark.parametrize("name", ["st-venant-kirchhoff", "neo-hookean"])
def test_a_turned_body_has_no_forces(make, name):
    mesh = make_mesh(*MESHES[make]())
    q = np.linalg.qr(np.random.default_rng(0).standard_normal((mesh.dim, mesh.dim)))[0]
    q[:, 0] *= np.linalg.det(q)
    u = mesh.points @ q.T + 5 - mesh.points
    forces = internal_forces(mesh, KINEMATICS[name], u, *random_moduli(mesh))
    assert np.abs(forces).max() < 1e-13


@every_mesh
def test_small_strain_is_blind_to_small_rotations_and_translations(make):
    mesh = make_mesh(*MESHES[make]())
    skew = np.triu(np.random.default_rng(0).standard_normal((mesh.dim, mesh.dim)), 1)
    u = mesh.points @ (skew - skew.T) + 7
    forces = internal_forces(mesh, KINEMATICS["small-strain"], u, *random_moduli(mesh))
    assert np.abs(forces).max() < 1e-13
