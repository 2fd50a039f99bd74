"""Regularized identification: fit the displacements of elastic equilibrium to the measured ones.

Finite element model updating. With log-moduli x, minimise over x and the displacements u_t

    Σ_t (u_t − û_t)ᵀ C_t⁻¹ (u_t − û_t) / σ²  +  prior(x)    subject to  f(u_t; x) = 0

at the free nodes.

The motion of the reaction nodes is free, so that no boundary condition is assumed. Eliminating u_t
from the linearised problem leaves the balance residual of the measured displacements, whitened:

    Σ_t (r_t + R_t δx)ᵀ (σ² S_t)⁻¹ (r_t + R_t δx),   S_t = K_t C_t K_tᵀ,

K_t = ∂f/∂u and R_t = ∂f/∂x (adjoint gradient: R_tᵀ p_t with p_t = S_t⁻¹ r_t). The Gauss-Newton step
and posterior samples come from H = P + Σ_t R_tᵀ (σ² S_t)⁻¹ R_t, P the Hessian of the prior, which
gauss_newton.py solves without forming it.

The prior is a total variation of each log-modulus over the cells' common sides. Stage one finds
the noise σ and a first map by the variational Bayes treatment of total variation (Babacan, Molina,
Katsaggelos, IEEE Trans. Image Process. 17, 2008): no weight is set by hand, σ² is the misfit over
the equations that the effective parameters leave (the discrepancy principle in its unbiased form).
Stage two sharpens: total variation is reweighted by its own result (Candès, Wakin, Boyd, J. Fourier
Anal. Appl. 14, 2008), which has no scale of its own and so takes the contrast loss of total
variation away. The standard deviations are those of the Gaussian that the same variational step
puts around the sharpened map.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..errors import InputError
from ..fem.assembly import force_matrices, internal_forces, tangent_stiffness
from ..linalg.ldl import QuasiDefiniteSolver, nested_dissection
from ..progress import Progress, silent
from .newton_systems import AdjointSystem, DirectSystem
from .observations import block_diagonal
from .problem import Estimate, Problem, estimate_from_theta

ANCHOR_STD = {"modulus": 3.0, "ratio": 1.5}  # natural logarithms, around the known material
REWEIGHTING = 3.0  # exponent of the reweighted prior: p(jump) ∝ |jump|^−3 beyond the smoothing
SMOOTHING = 0.02  # jumps of log-moduli below this count as none
UNMEASURED = 1e4  # variance of nodes that only refinement has, over that of measured nodes
VARIATIONAL_STEPS, SHARPENING_STEPS, POSTERIOR_STEPS = 20, 15, 2
SETTLED = {"variational": 0.1, "sharpening": 0.05}  # largest change of a log-modulus in a step
SAMPLES, HALVINGS = 16, 6


def fit_displacements(problem: Problem, progress: Progress | None = None) -> Estimate:
    """Fit equilibrium displacements; see the module's text."""
    return _Fit(problem, progress or silent).run()


def default_refinement(n_cells: int, poisson: float, dim: int, per_cell: bool = True) -> int:
    """Sub-cells per cell for the forward problem, from what the benchmark shows.

    Linear cells are too stiff where they cut the edge of an inclusion and near incompressibility.
    With one unknown per label the noise averages out and this bias is what remains.
    """
    if dim == 3:
        return 1
    if n_cells <= 2_000 and (poisson > 0.48 or not per_cell):
        return 16
    return 4 if n_cells <= 6_000 else 1


@dataclass
class TrialFit:
    """Equilibrium displacements nearest to one trial's measured ones, linearised there."""

    u: np.ndarray  # (n_dofs,)
    K: sp.csr_matrix  # (n_free, n_dofs)
    S: sp.csc_matrix  # (n_free, n_free)
    r: np.ndarray  # (n_free,) balance residual of the measured displacements
    solver: QuasiDefiniteSolver  # of S
    misfit: float = np.nan  # rᵀ S⁻¹ r
    R: sp.csr_matrix | None = None  # (n_free, n_fields·n_groups)

    def solve(self, force):
        """Return S⁻¹ force, (n_free,) or (n_free, m)."""
        p = self.solver.solve(force)
        return p + self.solver.solve(force - self.S @ p)  # S squares K's condition: refine once


class Equilibrium:
    """The forward problem, on a refinement of the mesh whose cells keep their parameters."""

    def __init__(self, problem: Problem, refine: int):
        mesh, unknowns = problem.mesh, problem.unknowns
        self.law, self.mesh = problem.law, mesh
        parent, interpolation = np.arange(mesh.n_cells), sp.identity(mesh.n_nodes, format="csr")
        for _ in range({1: 0, 4: 1, 16: 2}[refine]):
            self.mesh, finer, between = self.mesh.refined()
            parent, interpolation = parent[finer], (between @ interpolation).tocsr()
        self.lam, self.mu = unknowns.lam[parent], unknowns.mu[parent]
        self.lam_known, self.mu_known = unknowns.lam_known[parent], unknowns.mu_known[parent]
        self.measured = [interpolation @ u for u in problem.displacements]
        reaction = interpolation @ problem.reaction.astype(float) > 1 - 1e-9
        used = np.diff(self.mesh.node_cells.indptr) > 0
        free = used & ~reaction
        d = mesh.dim
        self.free = (np.flatnonzero(free)[:, None] * d + np.arange(d)).ravel()
        self.places, self.order = self.mesh.points[self.free // d], None
        only_fine = np.arange(self.mesh.n_nodes) >= mesh.n_nodes
        inflate = np.where(only_fine & ~reaction, UNMEASURED, 1.0)
        shared = problem.noise.information is None
        trials = range(1 if shared else len(self.measured))
        C = [self._covariance(problem.noise.covariances(t), interpolation, inflate) for t in trials]
        self.C = C * len(self.measured) if shared else C
        self.shared = shared and self.law.linear
        self.n_equations = len(self.measured) * d * int((free & ~only_fine).sum())

    @staticmethod
    def _covariance(per_node, interpolation, inflate):
        n, d = len(inflate), per_node.shape[1]
        blocks = (interpolation @ per_node.reshape(len(per_node), -1)).reshape(n, d, d)
        return block_diagonal(blocks * inflate[:, None, None])

    def fit(self, theta, fields, start, tell=None) -> list[TrialFit]:
        """Return the trials' fits for parameters θ = exp(fields @ x)."""
        lam, mu = self.lam @ theta + self.lam_known, self.mu @ theta + self.mu_known
        slope = (sp.diags(theta) @ fields).tocsr()
        fits = []
        for C, measured, u in zip(self.C, self.measured, start, strict=True):
            alike = fits[0] if self.shared and fits else None
            fits.append(self._fit_trial(C, measured, u, lam, mu, slope, alike))
            if tell:
                tell()
        return fits

    def _factorise(self, S):
        if not np.isfinite(S.data).all():
            raise self._diverged()
        if self.order is None:
            self.order = nested_dissection(S, self.places)
        try:
            return QuasiDefiniteSolver(S, self.order)
        except RuntimeError as singular:
            raise self._diverged() from singular

    def _diverged(self):
        return InputError(
            f"the {self.law.name} fit does not converge: a cell inverts; push less, use a coarser "
            "mesh or fewer sub-cells (refine), or check the registration"
        )

    def _fit_trial(self, C, measured, u, lam, mu, slope, alike):
        """Fit one trial; `alike` is another one that has the same K and S."""
        target = measured.ravel()
        for _ in range(1 if self.law.linear else 10):
            at = u.reshape(measured.shape)
            if alike is None:
                K = tangent_stiffness(self.mesh, self.law, at, lam, mu)[self.free]
                S = (K @ C @ K.T).tocsc()
                solver = self._factorise(S)
            else:
                K, S, solver = alike.K, alike.S, alike.solver
            r = internal_forces(self.mesh, self.law, at, lam, mu).ravel()[self.free]
            fit = TrialFit(u, K, S, r + K @ (target - u), solver)
            p = fit.solve(fit.r)
            fit.u = self._without_inversion(u, target - C @ (K.T @ p), measured.shape)
            fit.misfit = float(fit.r @ p)
            change, u = np.abs(fit.u - u).max(), fit.u
            if change < 1e-6 * np.abs(target).max():
                break
        if not np.isfinite(u).all():
            raise self._diverged()
        per_lam, per_mu = force_matrices(self.mesh, self.law, u.reshape(measured.shape))
        fit.R = ((per_lam @ self.lam + per_mu @ self.mu) @ slope).tocsr()[self.free]
        return fit

    def _without_inversion(self, u, new, shape):
        """Return new, halfway back to u for as long as it turns cells inside out that u does not.

        Nodes that are hardly measured go far in a step.
        """
        if self.law.linear:
            return new
        before = self.mesh.n_inverted(u.reshape(shape))
        for _ in range(HALVINGS):
            if self.mesh.n_inverted(new.reshape(shape)) <= before:
                break
            new = (u + new) / 2
        return new


class Prior:
    """Total variation of each field over common sides, and a weak anchor at the known material."""

    def __init__(self, problem: Problem, anchor: np.ndarray):
        unknowns = problem.unknowns
        n, self.n_fields = unknowns.n_groups, unknowns.per_group
        pairs, sizes = problem.mesh.interfaces
        pairs = unknowns.group[pairs]
        inside = (pairs >= 0).all(axis=1)
        # labels are few and well determined: a prior between them would only bias their contrast
        inside &= unknowns.per_cell
        pairs, sizes = pairs[inside], sizes[inside]
        m = len(pairs)
        rows = np.tile(np.arange(m), 2)
        signs = np.repeat([1.0, -1.0], m)
        one = sp.csr_matrix((signs, (rows, pairs.T.ravel())), (m, n))
        self.difference = sp.block_diag([one] * self.n_fields, format="csr")
        self.size = np.tile(sizes / (sizes.mean() if m else 1.0), self.n_fields)
        self.field = np.repeat(np.arange(self.n_fields), m)
        self.n_groups, self.anchor = n, anchor
        std = [ANCHOR_STD["modulus"], ANCHOR_STD["ratio"]][: self.n_fields]
        # of the mean of a field: an anchor at every cell would add up to a bias of the scale
        self.precision = np.repeat(1 / (n * np.square(std)), n)

    def weigh(self, weights):
        """Return P = Dᵀ diag(weights) D + anchor and a root of it."""
        D = self.difference
        P = (D.T @ sp.diags(weights) @ D + sp.diags(self.precision)).tocsc()
        root = sp.hstack([D.T @ sp.diags(np.sqrt(weights)), sp.diags(np.sqrt(self.precision))])
        return P, root.tocsr()

    def gradient(self, P, x):
        """Return P (x − anchor): the differences of the anchor vanish field by field."""
        return P @ (x - self.anchor)

    def variational_weights(self, x, variance):
        """Weights of the quadratic that bounds total variation, size and weight by field."""
        width = np.sqrt((self.difference @ x) ** 2 + variance)
        total = np.bincount(self.field, self.size * width, self.n_fields)
        weight = max(self.n_groups - 1, 1) / np.maximum(total, 1e-12)
        return weight[self.field] * self.size / width, weight

    def reweighted(self, x, variance=0.0):
        """Weights of reweighted total variation at x (of differences with some variance)."""
        return REWEIGHTING * self.size / ((self.difference @ x) ** 2 + variance + SMOOTHING**2)


class _Fit:
    def __init__(self, problem: Problem, progress: Progress):
        self.problem, self.progress = problem, progress
        unknowns = problem.unknowns
        flat = unknowns.flat_guess()
        self.refine = problem.refine or default_refinement(
            problem.mesh.n_cells, _typical_poisson(unknowns, flat), problem.mesh.dim,
            unknowns.per_cell,
        )  # fmt: skip
        self.forward = Equilibrium(problem, self.refine)
        self.fields, self.x = _fields(unknowns, flat)
        self.prior = Prior(problem, self.x.copy())
        # at rest: measured displacements may turn cells inside out
        self.start = [np.zeros(u.size) for u in self.forward.measured]
        self.scale = problem.noise.scale
        # in space the trials' factors, coupled by the parameters, fill up
        system = DirectSystem if problem.mesh.dim == 2 else AdjointSystem
        self.system = system(self._places(), self.forward.places)
        self.samples = None
        self.log = []
        self.at = (0.0, "regularized: first fit")

    def theta(self):
        return np.exp(self.fields @ self.x)

    def evaluate(self):
        self.fits = self.forward.fit(self.theta(), self.fields, self.start, self.tell)
        self.start = [fit.u for fit in self.fits]
        self.misfit = sum(fit.misfit for fit in self.fits)

    def _places(self):
        """Where the fields' parameters are: the mean of their groups' cells."""
        unknowns, mesh = self.problem.unknowns, self.problem.mesh
        cells = np.flatnonzero(~unknowns.known)
        group, count = unknowns.group[cells], np.bincount(unknowns.group[cells])[:, None]
        centres = np.stack([np.bincount(group, x) for x in mesh.centres[cells].T], axis=1) / count
        return np.tile(centres, (self.prior.n_fields, 1))

    def step(self, P):
        """Move x by one damped Gauss-Newton step; return its largest change."""
        gradient = self.prior.gradient(P, self.x)
        change = self.system.solve(-gradient, [-fit.r for fit in self.fits], tell=self.tell)
        size = np.abs(change).max()
        self.x = self.x + min(1.0, 1.0 / max(size, 1e-300)) * change
        return size

    def sample_posterior(self, root, m):
        """Set and return m samples of the Gaussian posterior around x, (n_fields·n_groups, m)."""
        rng = np.random.default_rng(0)  # the same numbers every time: else the steps never settle
        prior_part = root @ rng.standard_normal((root.shape[1], m))
        parts = []  # errors enter through K, with the covariance of the fit
        for fit, C in zip(self.fits, self.forward.C, strict=True):
            z = rng.standard_normal((fit.K.shape[1], m))
            parts.append(self.scale * (fit.K @ (_root(C, self.problem.mesh.dim) @ z)))
        near = self.samples if self.samples is not None and self.samples.shape[1] == m else None
        self.samples = self.system.solve(prior_part, parts, near, self.tell)
        return self.samples

    def run(self) -> Estimate:
        self._variational_stage()
        self._sharpening_stage()
        self._posterior()
        theta = self.theta()
        errors = theta[:, None] * (self.fields @ self.samples)
        if self.problem.noise.information is not None:
            # a fit may find the information too modest, but not call the map better for it
            errors = errors * max(1.0, 1.0 / self.scale)
        report = {
            "method": "regularized",
            "noise_scale": self.scale,
            "noise_given": self.problem.noise.scale is not None,
            "misfit": self.misfit / self.scale**2 / max(self.forward.n_equations, 1),
            "effective_parameters": self.effective,
            "prior_weight": [float(w) for w in self.weight] if len(self.prior.size) else [],
            "prior_rule": "variational Bayes of total variation, then reweighted",
            "refine": self.refine,
            "iterations": len(self.log),
            "equations": self.forward.n_equations,
            "parameters": len(theta),
            "convergence": self.log,
        }
        return estimate_from_theta(self.problem, theta, errors, **report)

    def _variational_stage(self):
        """Find σ and the weight of total variation together with a first map."""
        prior, n = self.prior, self.forward.n_equations
        variance = np.full(len(prior.size), 0.25)
        weights, self.weight = prior.variational_weights(self.x, variance)
        for iteration in range(VARIATIONAL_STEPS):
            self.evaluate()
            if self.scale is None:
                self.scale = self._floor(0.3 * self.misfit / n)
            P, root = prior.weigh(weights)
            self.system.factorise(P, self.fits, self.scale)
            samples = self.sample_posterior(root, self.system.samples)
            size = self.step(P)
            self.effective = len(self.x) - float((samples * (P @ samples)).sum(axis=0).mean())
            self.effective = min(max(self.effective, 0.0), len(self.x))
            variance = ((prior.difference @ samples) ** 2).mean(axis=1)
            weights, self.weight = prior.variational_weights(self.x, variance)
            before = self.scale
            if self.problem.noise.scale is None:
                self.scale = self._floor(self.misfit / max(n - self.effective, 0.05 * n))
            self._record(iteration, VARIATIONAL_STEPS, 0.0, size)
            if size < SETTLED["variational"] and abs(self.scale / before - 1) < 0.02:
                break

    def _sharpening_stage(self):
        """Take the contrast loss of total variation away, with σ as found."""
        if not len(self.prior.size):
            self.evaluate()
            return
        for iteration in range(SHARPENING_STEPS):
            self.evaluate()
            P, _ = self.prior.weigh(self.prior.reweighted(self.x))
            self.system.factorise(P, self.fits, self.scale)
            size = self.step(P)
            self._record(iteration, SHARPENING_STEPS, 0.5, size)
            if size < SETTLED["sharpening"]:
                break
        self.evaluate()

    def _posterior(self):
        """Sample around the sharpened map: the variational posterior of the reweighted prior.

        Two steps from the first stage's posterior, no more. Each step halves the standard
        deviation of flat regions; run to its end it would merge them into one unknown each and
        call their common bias, which no prior sees, certain. Two keep the truth within two
        standard deviations as often as they should (docs/benchmarks.md).
        """
        for _ in range(POSTERIOR_STEPS if len(self.prior.size) else 0):
            variance = ((self.prior.difference @ self.samples) ** 2).mean(axis=1)
            P, root = self.prior.weigh(self.prior.reweighted(self.x, variance))
            self.system.factorise(P, self.fits, self.scale)
            self.sample_posterior(root, SAMPLES)

    def _floor(self, variance):
        return float(max(np.sqrt(max(variance, 0.0)), 10 * self.problem.noise.round_off))

    def tell(self):
        """Say where the fit is, and let it be cancelled there."""
        self.progress(*self.at)

    def _record(self, iteration, steps, start, size):
        misfit = self.misfit / self.scale**2 / max(self.forward.n_equations, 1)
        self.log.append({"misfit": misfit, "step": float(size), "noise_scale": self.scale})
        self.at = (
            start + 0.5 * (iteration + 1) / steps,
            f"regularized: step {len(self.log)}, misfit {misfit:.3f}, largest change {size:.2g}",
        )
        self.tell()


def _fields(unknowns, flat):
    """Return X with log θ = X x, and x of the flat guess.

    The fields are log μ and log(λ/μ) (that is, ν), or log E: neighbouring tissues differ in
    stiffness more than in compressibility.
    """
    n = unknowns.n_groups
    if unknowns.per_group == 1:
        return sp.identity(n, format="csr"), np.log(flat)
    group = np.arange(n)
    rows = np.concatenate([2 * group, 2 * group, 2 * group + 1])
    cols = np.concatenate([group, n + group, group])
    fields = sp.csr_matrix((np.ones(3 * n), (rows, cols)), (2 * n, 2 * n))
    lam, mu = flat.reshape(-1, 2).T
    return fields, np.concatenate([np.log(mu), np.log(np.maximum(lam, 1e-3 * mu) / mu)])


def _typical_poisson(unknowns, flat):
    lam, mu = unknowns.moduli(flat)
    return float(np.median(lam / (2 * (lam + mu))))


def _root(C, d):
    """Return a root of a block diagonal covariance."""
    blocks = C.tobsr((d, d))
    blocks.sort_indices()
    return block_diagonal(np.linalg.cholesky(blocks.data))
