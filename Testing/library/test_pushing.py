"""Exact pushes: structured meshes and forward solutions against scikit-fem and closed forms."""

import bodies
import numpy as np
import pytest
import skfem
from elastoidentify.errors import Cancelled, InputError
from elastoidentify.fem.assembly import internal_forces
from elastoidentify.fem.constitutive import KINEMATICS
from elastoidentify.fem.elastic_constants import lame_from_young, plane_stress_lambda
from elastoidentify.fem.forward import PATTERNS, box_mesh, solve_push, square_mesh
from elastoidentify.fem.mesh import make_mesh
from scipy.optimize import brentq
from skfem.models.elasticity import linear_elasticity

FINITE = ["st-venant-kirchhoff", "neo-hookean"]
TABLE_ROWS = [  # of the source paper: motion of the top nodes in two trials, metres
    ((0, -0.025), (-0.025, -0.025)),
    ((0, -0.03), (-0.03, -0.03)),
    ((0, -0.05), (-0.05, -0.05)),
    ((0, -0.05), (-0.1, -0.1)),
]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patterns_tile_the_rectangle_and_fit_together(pattern):
    points, cells = square_mesh(4, 3, 0.4, 0.6, pattern)
    mesh = make_mesh(points, cells)  # refuses clockwise cells
    per_square = 4 if pattern == "crossed" else 2
    assert mesh.n_cells == per_square * 12
    assert mesh.n_nodes == 20 + (12 if pattern == "crossed" else 0)
    assert np.allclose(mesh.volumes, 0.4 * 0.6 / mesh.n_cells)
    assert len(mesh.interfaces[0]) == (3 * mesh.n_cells - 14) / 2
    assert np.array_equal(mesh.boundary_nodes, ((points == 0) | (points == [0.4, 0.6])).any(axis=1))


def test_diagonals_alternate_like_a_chessboard():
    _, cells = square_mesh(2, 2, pattern="alternating")
    middle = (cells == 4).any(axis=1)
    assert middle.sum() in (4, 8)  # all diagonals meet in the middle, or none does
    assert (square_mesh(2, 2)[1] == 4).any(axis=1).sum() == 6


@pytest.mark.parametrize("kind", ["quad", "hexahedron", "tetra"])
def test_boxes_fill_their_volume_and_fit_together(kind):
    shape = (2, 3) if kind == "quad" else (2, 3, 4)
    points, cells = box_mesh(shape, shape, kind)
    mesh = make_mesh(points, [(kind, cells)])
    assert np.isclose(mesh.volumes.sum(), np.prod(shape))
    assert np.array_equal(mesh.boundary_nodes, ((points == 0) | (points == shape)).any(axis=1))


@pytest.mark.parametrize("kind", ["triangle", "quad", "tetra", "hexahedron"])
def test_small_strain_push_is_scikit_fems_solution_on_the_same_mesh(kind):
    dim = 2 if kind in ("triangle", "quad") else 3
    mesh, element = {
        "triangle": (skfem.MeshTri().refined(3), skfem.ElementTriP1),
        "quad": (skfem.MeshQuad().refined(3), skfem.ElementQuad1),
        "tetra": (skfem.MeshTet().refined(2), skfem.ElementTetP1),
        "hexahedron": (skfem.MeshHex().refined(2), skfem.ElementHex1),
    }[kind]
    basis = skfem.Basis(mesh, skfem.ElementVector(element()), intorder=3)
    lam, mu = lame_from_young(5e3, 0.43)
    stiffness = linear_elasticity(lam, mu).assemble(basis)
    points = mesh.p.T
    ends = np.isclose(points[:, -1], 0) | np.isclose(points[:, -1], 1)
    target = np.zeros_like(points)
    target[np.isclose(points[:, -1], 1), -1] = -0.05
    target[np.isclose(points[:, -1], 1), 0] = -0.03
    dofs = basis.nodal_dofs.T  # (n_nodes, d)
    x = np.zeros(basis.N)
    x[dofs] = target
    solution = skfem.solve(*skfem.condense(stiffness, x=x, D=dofs[ends].ravel()))
    n = mesh.t.shape[1]
    ours = solve_push(
        points, [(kind, vtk_order(kind, mesh, points))], np.full(n, lam), np.full(n, mu),
        np.flatnonzero(ends), target[ends],
    )  # fmt: skip
    assert ours.shape == (len(points), dim)
    assert np.abs(ours - solution[dofs]).max() < 1e-10 * np.abs(target).max()


def vtk_order(kind, mesh, points):
    """Cells of a scikit-fem mesh with their nodes in VTK's order, all turning the right way."""
    cells = mesh.t.T
    if kind in ("quad", "hexahedron"):  # by position along the axes: these cells are boxes
        corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
        if kind == "hexahedron":
            corners = np.vstack([np.column_stack([corners, np.full(4, z)]) for z in (0, 1)])
        x = points[cells]
        upper = (x > x.mean(axis=1, keepdims=True)).astype(int)
        match = (upper[:, None] == corners[:, None]).all(axis=3)
        return np.take_along_axis(cells, match.argmax(axis=2), axis=1)
    x = points[cells]
    turned = np.linalg.det(x[:, 1:] - x[:, :1]) < 0
    swapped = cells[:, [1, 0, *range(2, cells.shape[1])]]
    return np.where(turned[:, None], swapped, cells)


@pytest.mark.parametrize("kinematics", FINITE)
@pytest.mark.parametrize("kind", ["triangle", "quad", "tetra", "hexahedron"])
def test_large_pushes_are_in_equilibrium(kinematics, kind):
    if kind == "triangle":
        points, cells = bodies.scattered_triangles(5)
    else:
        shape = (4, 4) if kind == "quad" else (2, 2, 2)
        points, cells = box_mesh(shape, np.ones(len(shape)), kind)
    mesh = make_mesh(points, [(kind, cells)])
    rng = np.random.default_rng(0)
    lam, mu = lame_from_young(rng.uniform(1, 5, mesh.n_cells), rng.uniform(0.2, 0.4, mesh.n_cells))
    fixed = bodies.floor_and_top(points)
    target = np.where(points[:, -1:] > 0.5, -0.15 * np.eye(mesh.dim)[-1], 0)
    target = target + np.where(points[:, -1:] > 0.5, 0.1 * np.eye(mesh.dim)[0], 0)
    u = solve_push(points, [(kind, cells)], lam, mu, fixed.nonzero()[0], target[fixed],
                   kinematics=kinematics)  # fmt: skip
    forces = internal_forces(mesh, KINEMATICS[kinematics], u, lam, mu)
    assert np.array_equal(u[fixed], target[fixed])
    assert np.abs(forces[~fixed]).max() < 1e-12 * np.abs(forces[fixed]).max()


def rollers(points):
    """Mask of components: x on the left, y at the bottom (one roller side each)."""
    return np.column_stack([np.isclose(points[:, 0], 0), np.isclose(points[:, 1], 0)])


def pulled(points, stretch):
    """Rollers left and below, right side moved along x, the rest free."""
    mask, target = rollers(points), np.zeros_like(points)
    right = np.isclose(points[:, 0], points[:, 0].max())
    mask[right, 0] = True
    target[right, 0] = (stretch - 1) * points[right, 0]
    return mask, target


@pytest.mark.parametrize("stretch", [0.6, 1.4])
def test_a_neo_hookean_bar_in_plane_strain_thins_as_its_closed_form_says(stretch):
    points, cells = bodies.scattered_triangles(4)
    lam, mu = 3.0, 2.0
    # the free sides carry no stress: P_22 = μ(t − 1/t) + λ ln(s t)/t = 0
    thin = brentq(lambda t: mu * (t - 1 / t) + lam * np.log(stretch * t) / t, 0.1, 5)
    n = len(cells)
    u = solve_push(points, cells, np.full(n, lam), np.full(n, mu), *pulled(points, stretch),
                   kinematics="neo-hookean")  # fmt: skip
    assert np.allclose(u, points * [stretch - 1, thin - 1], atol=1e-10)


@pytest.mark.parametrize("stretch", [0.8, 1.4])
def test_a_st_venant_kirchhoff_bar_in_plane_strain_thins_as_its_closed_form_says(stretch):
    points, cells = bodies.scattered_triangles(4)
    lam, mu = 3.0, 2.0
    # S_22 = λ(E_11 + E_22) + 2μE_22 = 0
    green = -lam * (stretch**2 - 1) / 2 / (lam + 2 * mu)
    thin = np.sqrt(1 + 2 * green)
    n = len(cells)
    u = solve_push(points, cells, np.full(n, lam), np.full(n, mu), *pulled(points, stretch),
                   kinematics="st-venant-kirchhoff")  # fmt: skip
    assert np.allclose(u, points * [stretch - 1, thin - 1], atol=1e-10)


def test_a_bar_in_plane_stress_under_a_load_stretches_by_force_over_stiffness():
    points, cells = box_mesh((5, 3), (2.0, 1.0), "quad")
    E, nu, pressure = 7.0, 0.35, 0.3
    lam, mu = lame_from_young(E, nu)
    right = np.flatnonzero(np.isclose(points[:, 0], 2))
    forces = np.zeros_like(points)
    share = np.where(np.isin(points[right, 1], (0, 1)), 0.5, 1) / 3
    forces[right, 0] = pressure * share
    n = len(cells)
    u = solve_push(points, cells, np.full(n, plane_stress_lambda(lam, mu)), np.full(n, mu),
                   rollers(points), 0 * points, forces=forces)  # fmt: skip
    assert np.allclose(u, points * [pressure / E, -nu * pressure / E], atol=1e-13)


@pytest.mark.parametrize("kinematics", FINITE)
def test_tiny_pushes_of_finite_laws_are_small_strain_solutions(kinematics):
    points, cells = bodies.scattered_triangles(5)
    rng = np.random.default_rng(0)
    lam, mu = lame_from_young(rng.uniform(1, 5, len(cells)), rng.uniform(0.2, 0.45, len(cells)))
    fixed = bodies.floor_and_top(points)
    target = np.where(points[fixed, 1:] > 0.5, [1e-9, -2e-9], 0)
    tiny, hooke = (
        solve_push(points, cells, lam, mu, fixed.nonzero()[0], target, kinematics=name)
        for name in (kinematics, "small-strain")
    )
    assert np.abs(tiny - hooke).max() < 1e-7 * np.abs(target).max()


@pytest.mark.parametrize("row", range(4))
@pytest.mark.parametrize("kinematics", FINITE)
def test_the_fourth_row_of_the_paper_inverts_a_cell_of_st_venant_kirchhoff_only(kinematics, row):
    points, cells = square_mesh(4, 4)
    lam, mu = (np.full(32, float(x)) for x in lame_from_young(5e3, 0.43))
    fixed = bodies.floor_and_top(points)
    for motion in TABLE_ROWS[row]:
        target = np.where(points[fixed, 1:] > 0.1, motion, 0)
        args = (points, cells, lam, mu, fixed.nonzero()[0], target)
        if kinematics == "st-venant-kirchhoff" and motion == (-0.1, -0.1):
            with pytest.raises(InputError, match=r"does not converge beyond \d+%.*inverts"):
                solve_push(*args, kinematics=kinematics)
            continue
        u = solve_push(*args, kinematics=kinematics)
        x = (points + u)[cells]
        assert (np.linalg.det(x[:, 1:] - x[:, :1]) > 0).all()


def test_a_push_reports_its_progress_and_can_be_cancelled():
    points, cells = square_mesh(3, 3)
    n, fixed = len(cells), np.r_[0:4, 12:16]
    target = np.vstack([np.zeros((4, 2)), np.tile((0, -0.01), (4, 1))])
    told = []
    solve_push(points, cells, np.ones(n), np.ones(n), fixed, target, kinematics="neo-hookean",
               progress=lambda share, text: told.append((share, text)))  # fmt: skip
    assert told[-1][0] == 1
    assert "forward problem" in told[-1][1]

    def stop(share, text):
        raise Cancelled

    with pytest.raises(Cancelled):
        solve_push(points, cells, np.ones(n), np.ones(n), fixed, target, progress=stop)
