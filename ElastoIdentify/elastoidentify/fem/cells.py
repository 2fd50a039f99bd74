"""Two families of cells for the forward problem: plain linear ones, and ones that do not lock.

Near incompressibility a linear cell would have to keep its own volume, which its few nodes cannot
do while it bends: it locks, and a fit of its moduli to measured displacements is wrong by factors.
A *locking-free* cell keeps its volume together with its neighbours: the dilatation d in the energy
is the mean over a patch of cells,

    W = Σ_q w_q μ W_μ(H_q) + ½ Σ_p (Σ_c λ_c V_c) g(d̄_p)²,      d̄_p = Σ_q w_q d(H_q) / V_p,

with the same nodes, forces linear in λ and μ, and a symmetric tangent (a patch of one hexahedron is
Hughes' B-bar; for simplices see Bonet and Burton, Commun. Numer. Meth. Engng. 14, 1998, who average
over nodes).
"""

from copy import copy

import numpy as np
import scipy.sparse as sp

from .assembly import (
    assemble,
    force_matrices,
    integrate_tangent,
    internal_forces,
    tangent_stiffness,
)
from .constitutive import Kinematics
from .mesh import Mesh


class _Cells:
    def stretched(self, e: float):
        """Return the cells in a plane that is stretched across, F₃₃ = 1 + e."""
        other = copy(self)
        other.law = self.law.stretched(e)
        return other


class LinearCells(_Cells):
    """Plain isoparametric cells with full Gauss rules."""

    name = "linear"

    def __init__(self, mesh: Mesh, law: Kinematics):
        self.mesh, self.law = mesh, law

    def forces(self, u: np.ndarray, lam, mu) -> np.ndarray:
        """Return Σ f at every node, (n_nodes, d), for u (n_nodes, d)."""
        return internal_forces(self.mesh, self.law, u, lam, mu)

    def force_matrices(self, u: np.ndarray) -> tuple[sp.csc_matrix, sp.csc_matrix]:
        """Return A_λ, A_μ with forces A_λ λ + A_μ μ, (n_dofs, n_cells) each."""
        return force_matrices(self.mesh, self.law, u)

    def tangent(self, u: np.ndarray, lam, mu) -> sp.csr_matrix:
        """Return K = ∂(Σ f)/∂u, (n_dofs, n_dofs), symmetric."""
        return tangent_stiffness(self.mesh, self.law, u, lam, mu)

    def across_slope(self, u: np.ndarray, lam) -> np.ndarray:
        """Return ∂(Σ f)/∂e for a stretch across the plane, (n_dofs,)."""
        total = np.zeros(self.mesh.n_dofs)
        for block in self.mesh.blocks:
            H = block.gradient(u)
            pressure = self.law.across_slope(self.law.dilatation(H)) * block.weights
            slope = self.law.dilatation_slope(H)
            forces = np.einsum("nq,nqij,nqaj->nai", pressure, slope, block.gradients)
            forces *= lam[block.ids, None, None]
            total += np.bincount(block.dofs.ravel(), forces.ravel(), self.mesh.n_dofs)
        return total


class LockingFreeCells(_Cells):
    """Cells whose dilatation is a mean over patches; same interface as :class:`LinearCells`.

    Parameters
    ----------
    patch : (n_cells,) int
        The patch of each cell, see :func:`.patches.patches`.
    """

    name = "locking-free"

    def __init__(self, mesh: Mesh, law: Kinematics, patch: np.ndarray):
        self.mesh, self.law, self.patch = mesh, law, patch
        n = int(patch.max()) + 1
        cells = np.arange(mesh.n_cells)
        shape = (n, mesh.n_cells)
        self.members = sp.csr_matrix((np.ones(mesh.n_cells), (patch, cells)), shape)
        self.volumes = sp.csr_matrix((mesh.volumes, (patch, cells)), shape)
        self.size = np.bincount(patch, mesh.volumes, n)
        self.first = np.unique(patch, return_index=True)[1]  # cell of each patch: all are alike
        self._at_rest = None  # what a linear law needs only once

    def forces(self, u, lam, mu):
        """Return Σ f at every node, (n_nodes, d), for u (n_nodes, d)."""
        mean, slope = self._dilatation(u)
        pressure, _ = self.law.of(self.first).volume_strain(mean)
        shear = np.zeros(self.mesh.n_dofs)
        for block in self.mesh.blocks:
            forces = mu[block.ids, None] * self._shear_forces(block, u)
            shear += np.bincount(block.dofs.ravel(), forces.ravel(), self.mesh.n_dofs)
        return (shear + slope.T @ (pressure * (self.volumes @ lam))).reshape(-1, self.mesh.dim)

    def force_matrices(self, u):
        """Return A_λ, A_μ with forces A_λ λ + A_μ μ; λ of a cell acts at its whole patch."""
        mean, slope = self._dilatation(u)
        pressure, _ = self.law.of(self.first).volume_strain(mean)
        per_lam = slope.T @ sp.diags(pressure) @ self.volumes
        rows = [block.dofs.ravel() for block in self.mesh.blocks]
        cols = [np.repeat(block.ids, block.dofs.shape[1]) for block in self.mesh.blocks]
        values = [self._shear_forces(block, u).ravel() for block in self.mesh.blocks]
        per_mu = sp.csc_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))),
            (self.mesh.n_dofs, self.mesh.n_cells),
        )
        return per_lam.tocsc(), per_mu

    def tangent(self, u, lam, mu):
        """Return K = ∂(Σ f)/∂u, (n_dofs, n_dofs), symmetric."""
        mean, slope = self._dilatation(u)
        pressure, stiffness = self.law.of(self.first).volume_strain(mean)
        weight = self.volumes @ lam
        per_point = pressure * weight / self.size  # of the dilatation's own curvature
        K = assemble(self.mesh, [self._cell_tangent(b, u, mu, per_point) for b in self.mesh.blocks])
        return (K + slope.T @ sp.diags(stiffness * weight) @ slope).tocsr()

    def stretched(self, e):
        if self.law.linear:
            self._rest()  # which all copies have in common
        return super().stretched(e)

    def across_slope(self, u, lam):
        """Return ∂(Σ f)/∂e for a stretch across the plane, (n_dofs,)."""
        mean, slope = self._dilatation(u)
        return slope.T @ (self.law.across_slope(mean) * (self.volumes @ lam))

    def _shear_forces(self, block, u):
        stress = self.law.shear_stress(block.gradient(u))
        forces = np.einsum("nq,nqij,nqaj->nai", block.weights, stress, block.gradients)
        return forces.reshape(len(block.ids), -1)

    def _cell_tangent(self, block, u, mu, per_point):
        if self.law.linear:
            return mu[block.ids, None, None] * self._rest()[block.cell.name]
        H = block.gradient(u)
        m = (slice(None), *(None,) * 5)
        tangent = mu[block.ids][m] * self.law.shear_tangent(H)
        curvature = self.law.dilatation_curvature(H)
        if curvature is not None:
            tangent = tangent + per_point[self.patch[block.ids]][m] * curvature
        return integrate_tangent(block, tangent)

    def _dilatation(self, u):
        """Mean dilatation of each patch, (n_patches,), and its slope by u, (n_patches, n_dofs)."""
        slope = self._slope(u) if not self.law.linear else self._rest()["slope"]
        if self.law.linear:
            return slope @ u.ravel(), slope
        total = np.zeros(len(self.size))
        for block in self.mesh.blocks:
            d = (block.weights * self.law.dilatation(block.gradient(u))).sum(axis=1)
            total += np.bincount(self.patch[block.ids], d, len(total))
        return total / self.size, slope

    def _slope(self, u):
        rows, cols, values = [], [], []
        for block in self.mesh.blocks:
            by_H = self.law.dilatation_slope(block.gradient(u))
            value = np.einsum("nq,nqij,nqaj->nai", block.weights, by_H, block.gradients)
            rows.append(np.repeat(self.patch[block.ids], block.dofs.shape[1]))
            cols.append(block.dofs.ravel())
            values.append((value.reshape(len(block.ids), -1)).ravel())
        total = sp.csr_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))),
            (len(self.size), self.mesh.n_dofs),
        )
        return (sp.diags(1 / self.size) @ total).tocsr()

    def _rest(self):
        """Per unit μ, the stiffness of every cell; and the slope of the mean dilatations."""
        if self._at_rest is None:
            u = np.zeros((self.mesh.n_nodes, self.mesh.dim))
            self._at_rest = {
                block.cell.name: integrate_tangent(block, self.law.shear_tangent(block.gradient(u)))
                for block in self.mesh.blocks
            }
            self._at_rest["slope"] = self._slope(u)
        return self._at_rest
