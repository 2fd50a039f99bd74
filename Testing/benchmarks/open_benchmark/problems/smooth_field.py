"""torch-fem's own example of property fields: 200 quads, a smooth field, noise."""

import numpy as np
import skfem
from elastoidentify.fem.forward import box_mesh
from skfem.helpers import ddot, sym_grad, trace

from ..problem import Case, Truth

TITLE = "Smooth field on 200 quads"
SOURCE = (
    'The example "property fields" of torch-fem (MIT): [0, 2] × [0, 1], thickness 0.1, plane '
    "stress, E = 2 + sin πx cos πy, ν = 0.3, clamped on the left, a line load of 0.1 on the "
    "right, noise 0.002. As published, the displacements come from the same 200 quads with E "
    "of their centres. Methods that want forces get the load, and are told no modulus; those "
    "that want known cells get the ten at the right end, and no force. The scores are of the "
    "other 190."
)
LEVELS = ("no noise", "noise 0.002")
QUICK = "noise 0.002"


def make(level):
    points, cells = box_mesh((20, 10), (2.0, 1.0), "quad")
    x = points[cells].mean(axis=1)
    E = 2 + np.sin(np.pi * x[:, 0]) * np.cos(np.pi * x[:, 1])
    u, forces = _pull(points, cells, E)
    if level != "no noise":
        u = u + 0.002 * np.random.default_rng(0).standard_normal(u.shape)
    left, right = np.isclose(points[:, 0], 0), np.isclose(points[:, 0], 2)
    end = x[:, 0] > 1.9
    known = np.where(end[:, None], np.column_stack([E, 0.3 + 0 * E]), np.nan)
    case = Case(
        points, "quad", cells, u[None], left | right, known, 0.3, plane="stress",
        forces=forces[None], clamped=left, axis=0,
    )  # fmt: skip
    return case, Truth(E, np.full(len(E), 0.3))


def _pull(points, cells, E):
    """Displacements and nodal forces (n_nodes, 2) of bilinear quads."""
    mesh = skfem.MeshQuad(points.T.copy(), cells.T.copy(), sort_t=False)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad1()), intorder=2)

    @skfem.BilinearForm
    def stiffness(u, v, w):
        eu, ev = sym_grad(u), sym_grad(v)
        return 0.1 * w.E / 1.3 * (0.3 / 0.7 * trace(eu) * trace(ev) + ddot(eu, ev))

    of_cells = skfem.Basis(mesh, skfem.ElementQuad0(), intorder=2)
    K = stiffness.assemble(basis, E=of_cells.interpolate(E))
    right = np.flatnonzero(np.isclose(points[:, 0], 2))
    forces = np.zeros(points.shape)
    forces[right, 0] = 0.1 * 0.1
    forces[right[[0, -1]], 0] /= 2  # half an edge each; the load is per length of the edge
    held = basis.get_dofs(lambda x: np.isclose(x[0], 0)).all()
    u = skfem.solve(*skfem.condense(K, forces[_nodes(basis)].ravel(), D=held))
    out = np.empty_like(points)
    out[_nodes(basis)] = u.reshape(-1, 2)
    return out, forces


def _nodes(basis):
    """Nodes in the order of the degrees of freedom, which come in pairs."""
    order = np.argsort(basis.nodal_dofs[0])
    assert (basis.nodal_dofs[1] == basis.nodal_dofs[0] + 1).all()
    return order
