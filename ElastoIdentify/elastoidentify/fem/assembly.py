"""The force balance at the nodes, linear in λ and μ (source paper, section 2)."""

import numpy as np
import scipy.sparse as sp

from .constitutive import Kinematics
from .mesh import Block, Mesh


def partial_connection_matrices(block: Block) -> tuple[np.ndarray, np.ndarray]:
    """Return J_λ, J_μ of each cell for small strain: f = (λ J_λ + μ J_μ) u. Shape (n, k·d, k·d).

    They depend on the node positions at rest only. For the triangle in plane strain these are the
    6×6 matrices of the source paper.
    """
    from .constitutive import SmallStrain

    rest = np.zeros((*block.weights.shape, block.cell.dim, block.cell.dim))
    return tuple(integrate_tangent(block, part) for part in SmallStrain().tangent(rest))


def cell_forces(block: Block, law: Kinematics, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodal forces of each cell per unit λ and per unit μ. Shape (n, k·d) each.

    f_a = Σ_q w_q P(H_q) ∇N_a, with u (n_nodes, d) the displacement.
    """
    return tuple(
        np.einsum("nq,nqij,nqaj->nai", block.weights, stress, block.gradients).reshape(
            len(block.ids), -1
        )
        for stress in law.of(block.ids).stress(block.gradient(u))
    )


def force_matrices(
    mesh: Mesh, law: Kinematics, u: np.ndarray
) -> tuple[sp.csc_matrix, sp.csc_matrix]:
    """Return A_λ, A_μ with nodal forces f = A_λ λ + A_μ μ. Shape (n_dofs, n_cells) each."""
    rows, cols, lam, mu = [], [], [], []
    for block in mesh.blocks:
        forces = cell_forces(block, law, u)
        rows.append(block.dofs.ravel())
        cols.append(np.repeat(block.ids, block.dofs.shape[1]))
        lam.append(forces[0].ravel())
        mu.append(forces[1].ravel())
    place = (np.concatenate(rows), np.concatenate(cols))
    shape = (mesh.n_dofs, mesh.n_cells)
    return tuple(sp.csc_matrix((np.concatenate(part), place), shape) for part in (lam, mu))


def internal_forces(mesh: Mesh, law: Kinematics, u: np.ndarray, lam, mu) -> np.ndarray:
    """Return Σ_p f_p at every node. Shape (n_nodes, d)."""
    total = np.zeros(mesh.n_dofs)
    for block in mesh.blocks:
        per_lam, per_mu = cell_forces(block, law, u)
        forces = lam[block.ids, None] * per_lam + mu[block.ids, None] * per_mu
        total += np.bincount(block.dofs.ravel(), forces.ravel(), minlength=mesh.n_dofs)
    return total.reshape(-1, mesh.dim)


def tangent_stiffness(mesh: Mesh, law: Kinematics, u: np.ndarray, lam, mu) -> sp.csr_matrix:
    """Return K = ∂(Σ f)/∂u at displacement u (n_nodes, d). Shape (n_dofs, n_dofs)."""
    parts = []
    for block in mesh.blocks:
        per_lam, per_mu = law.of(block.ids).tangent(block.gradient(u))
        m = (slice(None), *(None,) * 5)
        tangent = lam[block.ids][m] * per_lam + mu[block.ids][m] * per_mu
        parts.append(integrate_tangent(block, tangent))
    return assemble(mesh, parts)


def assemble(mesh: Mesh, parts: list[np.ndarray]) -> sp.csr_matrix:
    """Return the sum of cell matrices, one array (n, k·d, k·d) per block. (n_dofs, n_dofs)"""
    slot, indices, indptr = mesh.matrix_pattern
    values = np.concatenate([part.ravel() for part in parts])
    data = np.bincount(slot, values, len(indices))
    return sp.csr_matrix((data, indices, indptr), (mesh.n_dofs, mesh.n_dofs))


def integrate_tangent(block, tangent):
    """Return K_{ai,bk} = Σ_q w_q ∂P_ij/∂H_kl ∇_jN_a ∇_lN_b, (n, k·d, k·d).

    `tangent` is ∂P/∂H at the Gauss points, (n, q, d, d, d, d).
    """
    n, size = len(block.ids), block.cell.n_nodes * block.cell.dim
    half = np.einsum("nqijkl,nqbl->nqijbk", tangent, block.gradients, optimize=True)
    stiffness = np.einsum(
        "nq,nqijbk,nqaj->naibk", block.weights, half, block.gradients, optimize=True
    )
    return stiffness.reshape(n, size, size)
