"""Regularized identification: fit the displacements of elastic equilibrium to the measured ones.

Finite element model updating. With parameters x (log-moduli), minimise over x and the displacements

    Σ misfit(u_t) / σ²  +  prior(x)    subject to  f(u_t; x) = 0 at the free nodes,

where the motion of the reaction nodes is free, so that no boundary condition is assumed. Its parts
have a module each: `parameterization` (x → λ, μ), `equilibrium` (u as a function of x and of the
held nodes' motion), `misfit` (a sum of measured terms), `prior` (a sum of terms), `newton_systems`
(the Gauss-Newton step and posterior samples). Here are the stages.

Stage one finds the noise σ and a first map by the variational Bayes treatment of total variation
(Babacan, Molina, Katsaggelos, IEEE Trans. Image Process. 17, 2008): no weight is set by hand, σ² is
the misfit over the equations that the effective parameters leave (the discrepancy principle in its
unbiased form). Stage two sharpens as far as the data bear it (:mod:`.sharpening`). The standard
deviations are those of the Gaussian that the same variational step puts around the map.
"""

import numpy as np

from ..progress import Progress, part, silent
from .astray import believing
from .equilibrium import Equilibrium
from .mesh_bias import affordable, bias_warning, contradicted, defect
from .misfit import Displacements, Misfit, beside
from .model_misfit import model_misfit
from .newton_systems import TOLERANCE, DirectSystem, ReducedSystem
from .out_of_plane import StretchParameters, warnings_of
from .poisson import far_warnings, parameters
from .prior import Prior, TotalVariation, anchor
from .problem import Estimate, Problem
from .ratio_checks import ratio_checks
from .sharpening import UNSHARPENED, rule, sharpen
from .structure import found_structure
from .visibility import resolved, smallest_visible

VARIATIONAL_STEPS, POSTERIOR_STEPS = 20, 2
NEAR = 0.3  # change of log-moduli after which the held nodes are where the step has put them
SETTLED = 0.1  # largest change of a log-modulus in the last variational step
# the figures from so few samples scatter by a fifth; those that are reported by a fourteenth
SAMPLES, FINAL_SAMPLES = 16, 100
MOST_FOR_THESE = 20_000  # parameters; beyond, or by products, the last samples are few as well
# on the way, by products: few and coarse samples tell the weights well enough
ROUGH_SAMPLES, ROUGH, FINE = 4, 0.03, 0.01
# degrees of freedom up to which it is said what could be seen, unasked; by products it costs little
MOST_LOOKED_AT = 20_000
MOST_FACTORISED = 8_000  # unknowns of a volume for which the model is looked at by factors
FEW = 100  # parameters for which all samples are taken always


def fit_displacements(problem: Problem, progress: Progress | None = None) -> Estimate:
    """Fit equilibrium displacements; see the module's text."""
    progress, left = progress or silent, 1.0

    def first_map(problem: Problem) -> _Fit:
        nonlocal left  # of the way; the first map takes half of that, however often it is made
        fit = _Fit(problem, part(progress, 1 - left, 1))
        left /= 2
        fit.first_map()
        return fit

    fit, astray = believing(problem, first_map)
    estimate = fit.run()
    estimate.astray = astray
    return estimate


def default_refinement(
    n_cells: int, poisson: float, dim: int, per_cell: bool = True, element: str = "linear"
) -> int:
    """Sub-cells per cell for the forward problem, from what the benchmark shows.

    Cells are too stiff where they cut the edge of an inclusion, linear ones near incompressibility,
    too. With one unknown per label the noise averages out and this bias is what remains.
    """
    if dim == 3:
        return 1
    locks = element == "linear" and (poisson > 0.48 or not per_cell)
    if n_cells <= 2_000 and locks:
        return 16
    return 4 if n_cells <= 6_000 else 1


class _Fit:
    def __init__(self, problem: Problem, progress: Progress):
        self.problem, self.progress = problem, progress
        unknowns, mesh = problem.unknowns, problem.mesh
        self.parameters = parameters(unknowns, mesh.centres)
        if problem.stretch is not None:
            self.parameters = StretchParameters(self.parameters, problem.stretch)
        self.x = self.parameters.start.copy()
        self.refine = problem.refine or default_refinement(
            mesh.n_cells, _typical_poisson(unknowns), mesh.dim, unknowns.per_cell, problem.element
        )
        self.forward = Equilibrium(problem, self.parameters, self.refine, problem.element)
        self.terms = [Displacements(self.forward)]
        self.n_equations = sum(term.n_equations for term in self.terms)
        self.variation = TotalVariation(mesh, self.parameters, problem.labels)
        self.prior = Prior([self.variation, anchor(self.parameters), *self.parameters.prior()])
        self.system = self._make_system()
        self.scale = problem.noise.scale
        self.samples = self.added = None  # added: noise on the measured numbers, per term and trial
        self.moved = np.inf  # largest change of a parameter that the held nodes may not follow
        self.log, self.rounds = [], 0  # rounds of sharpening
        self.at = (0.0, "regularized: first fit")

    def _make_system(self):
        mesh = self.problem.mesh
        if mesh.dim == 2 and len(self.terms) == 1:
            return self._factorised_system()
        return ReducedSystem(self.parameters.places, mesh.dim if self.forward.by_node else 1)

    def _factorised_system(self):
        forward = self.forward
        nodes = forward.mesh.points[forward.free // forward.mesh.dim]
        return DirectSystem(self.parameters.places, nodes)

    @property
    def by_products(self) -> bool:
        return isinstance(self.system, ReducedSystem)

    @property
    def final_samples(self) -> int:
        many = not self.by_products and self.parameters.n <= MOST_FOR_THESE
        return FINAL_SAMPLES if many else SAMPLES

    def first_fit(self):
        """Fit the held nodes' motion alone, to first order at rest: where all trials begin.

        At rest because measured displacements may turn cells inside out.
        """
        self.eta = self._nearest(self.forward.rest(self.x))

    def evaluate(self):
        """Balance the trials at x, as near to the measurements as they get, and linearise there."""
        self.state = self.forward.settle(self.x, self.eta, self.tell)
        if self.moved > NEAR:
            self.state.eta = self._nearest(self.state)
        self.eta = self.state.eta
        self.forward.add_slopes(self.state)
        self.misfit = Misfit(self.terms, self.state, self.added)

    def _nearest(self, state):
        """η with the held nodes' motion that fits best, to first order."""
        db = self.system.refit(state, Misfit(self.terms, state, self.added), self.tell)
        return self.forward.moved(state, None, db)

    def factorise(self):
        self.system.factorise(self.prior.hessian(), self.state, self.misfit, self.scale)

    def step(self, m: int = 0, tolerance: float = TOLERANCE):
        """Move by one damped Gauss-Newton step; return the largest change of a parameter.

        With m, draw as many samples of the posterior around x, to `tolerance`, in the same go: many
        columns cost little more than one.
        """
        force, numbers = -self.prior.gradient(self.x)[:, None], self.misfit.residuals()
        near = None
        if m:
            prior_part, errors = self._drawn(m)
            force = np.hstack([force, prior_part])
            numbers, near = beside(numbers, errors), self._near(m)
            tolerance = np.append(TOLERANCE, np.full(m, tolerance))
        if near:  # nothing is known of the step
            near = [np.pad(part, ((0, 0), (1, 0))) for part in (near[0], *near[1])]
            near = near[0], near[1:]
        dx, db = self.system.solve(force, numbers, near, self.tell, tolerance)
        if m:
            self.samples = dx[:, 1:], [b[:, 1:] for b in db]
        dx, db = dx[:, 0], [b[:, 0] for b in db]
        size = self.moved = np.abs(dx).max()
        damped = min(1.0, 1.0 / max(size, 1e-300))
        self.x = self.x + damped * dx
        self.eta = self.forward.moved(self.state, damped * dx, [damped * b for b in db])
        return size

    def sample_posterior(self, m, tolerance, shared=False):
        """Set and return m samples of the Gaussian posterior around x, (n_x, m).

        With `shared` trials have the errors in common that they really have.
        """
        near = self._near(m)
        self.samples = self.system.solve(*self._drawn(m, shared), near, self.tell, tolerance)
        return self.samples[0]

    def _drawn(self, m, shared=False):
        """m random forces on the parameters, and errors of the numbers, of which samples follow."""
        rng = np.random.default_rng(0)  # the same numbers every time: else the steps never settle
        root = self.prior.root()
        prior_part = root @ rng.standard_normal((root.shape[1], m))
        return prior_part, self.misfit.noise(rng, m, self.scale, shared)

    def _near(self, m):
        """The last samples, where there are m of them."""
        found = self.samples
        return found if found is not None and found[0].shape[1] == m else None

    def exact_posterior(self):
        """Set the columns of a root of the covariance as samples: their mean square is exact.

        For few parameters that costs no more than samples, whose standard deviations scatter by a
        fifth and depend on the axes.
        """
        n = self.parameters.n
        self.factorise()
        nothing = [[np.zeros((len(o.residual), n)) for o in term] for term in self.misfit.terms]
        covariance, *rest = self.system.solve(np.eye(n), nothing, tell=self.tell)
        covariance = covariance + self._shared_covariance(covariance, *rest)
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        root = vectors * np.sqrt(n * np.maximum(values, 0.0))
        # each twice: the cells' own error is added with either sign, and must not mix with them
        self.samples = (np.repeat(root, 2, axis=1), *rest)

    def _shared_covariance(self, dx, db):
        """What errors that trials have in common add to the covariance of x, (n_x, n_x).

        The estimate answers errors v with dx = Σ_t A_t v_t, A_tᵀ = W_t J_t H⁻¹ / σ², where dx and
        db are the columns of H⁻¹; errors of covariance ρ C between trials s ≠ t add ρ A_s C A_tᵀ.
        """
        seen, total = self.misfit.seen(dx, self.state.change(dx, db)), 0.0
        for term, parts in zip(self.misfit.terms, seen, strict=True):
            answers = [
                o.root.T @ (o.weight @ part) / np.sqrt(o.factor(self.scale))
                for o, part in zip(term, parts, strict=True)
            ]
            if term[0].shared:
                both = sum(answers)
                total = total + term[0].shared * (both.T @ both - sum(a.T @ a for a in answers))
        return total

    def first_map(self):
        """Make the map and find the noise of stage one."""
        self.first_fit()
        self._variational_stage()

    @property
    def computed(self) -> np.ndarray:
        """Displacements of the mesh's nodes in balance, (n_trials, n_nodes, d)."""
        return self._at_nodes(self.state.eta)

    @property
    def computed_errors(self) -> np.ndarray:
        """Samples of their error, (m, n_trials, n_nodes, d)."""
        return np.stack([self._at_nodes(d) for d in self.state.change(*self.samples)], axis=1)

    def _at_nodes(self, eta):
        return self.forward.displacements(eta)[:, : self.problem.mesh.n_nodes]

    def run(self) -> Estimate:
        """Go on from the first map to the end."""
        self.kept, self.other = sharpen(self)
        self._posterior()
        if not len(self.variation):  # else the system is that of the last samples
            self.factorise()
        self._mesh_bias()
        self.at = (0.985, "regularized: Poisson's ratios that were given")
        self.checks = ratio_checks(self)
        self._model_misfit()
        self._structure()
        self._visibility()
        return self._estimate()

    def _variational_stage(self):
        """Find σ and the weight of total variation together with a first map."""
        n, given = self.n_equations, self.problem.noise.scale
        rough = self.by_products and self.parameters.n > FEW
        samples = (ROUGH_SAMPLES, ROUGH) if rough else (SAMPLES, TOLERANCE)
        self.prior.variational(self.x)
        for iteration in range(VARIATIONAL_STEPS):
            self.evaluate()
            if self.scale is None:
                self.scale = self._floor(0.3 * self.misfit.value() / n)
            self.factorise()
            size = self.step(*samples)
            drawn, P = self.samples[0], self.prior.hessian()
            self.effective = len(self.x) - float((drawn * (P @ drawn)).sum(axis=0).mean())
            self.effective = min(max(self.effective, 0.0), len(self.x))
            self.prior.variational(self.x, drawn)
            before = self.scale
            self.first_noise = self._floor(self.misfit.value() / self._left())
            if given is None:
                self.scale = self.first_noise
            self.record(0.5 * (iteration + 1) / VARIATIONAL_STEPS, size)
            if size < SETTLED and abs(self.scale / before - 1) < 0.02:
                break

    def _posterior(self):
        """Sample around the sharpened map: the variational posterior of the reweighted prior.

        Two steps from the first stage's posterior, no more. Each step halves the standard
        deviation of flat regions; run to its end it would merge them into one unknown each and
        call their common bias, which no prior sees, certain. Two keep the truth within two
        standard deviations as often as they should (docs/benchmarks.md).
        """
        rough, fine = (ROUGH, FINE) if self.by_products else (TOLERANCE, TOLERANCE)
        sharpened = self.kept.exponent != UNSHARPENED
        others = None
        if self.other is not None:
            self.prior.variational(self.x, self.samples[0])
            self.factorise()
            others = self.sample_posterior(self.final_samples, fine, shared=True)
        steps = POSTERIOR_STEPS if sharpened else int(len(self.variation) > 0)
        for left in reversed(range(steps)):
            if sharpened:
                self.prior.reweighted(self.x, self.samples[0])
            self.factorise()
            m = SAMPLES if left else self.final_samples
            self.sample_posterior(m, rough if left else fine, shared=True)
        if self.parameters.n <= FEW:
            self.exact_posterior()
        if self.other is not None:
            both = np.hstack([self.samples[0], (self.other.x - self.x)[:, None] + others])
            self.samples = (both, *self.samples[1:])

    def _mesh_bias(self):
        """Estimate the shift of x that the cells' own error makes, where that is affordable."""
        self.bias = self.gap = self.mesh_error = None
        self.at = (0.98, "regularized: error of the cells")
        gap = affordable(self.forward) and defect(self.forward, self.state, self.tell)
        if not gap or contradicted(gap, [one.residual for one in self.misfit.terms[0]]):
            return
        self.gap = gap
        numbers, zero = self.misfit.of_first_term(gap), np.zeros((self.parameters.n, 1))
        stated = 1.0 if self.problem.noise.information is not None else self.scale
        size = self.misfit.gram(numbers, stated).item()
        self.mesh_error = float(np.sqrt(size / self.n_equations))
        self.bias = self.system.solve(zero, numbers, tell=self.tell)[0][:, 0]

    def _model_misfit(self):
        """Tell where the model does not fit: last, as it takes other matrices."""
        self.unexplained, system = None, self.system
        self.at = (0.99, "regularized: where the model does not fit")
        if self.by_products:
            if len(self.terms) > 1 or self._unknowns > MOST_FACTORISED:
                return
            system = self._factorised_system()
        self.unexplained = model_misfit(self, system, self.problem.noise.stated)

    @property
    def _unknowns(self):
        """Of the system by factors: parameters, and a multiplier for each force that balances."""
        return self.parameters.n + self.forward.n_free * len(self.problem.displacements)

    def _structure(self):
        """Tell whether a map of cells shows anything but noise."""
        self.structure, problem = None, self.problem
        unknowns, unknown = problem.unknowns, ~problem.unknowns.known
        if unknowns.per_cell:
            self.at = (0.99, "regularized: what stands out of the noise")
            labels = np.zeros(unknown.sum()) if problem.labels is None else problem.labels[unknown]
            self.structure = found_structure(
                self.state, self.misfit, self.scale * self._modesty, unknowns.per_group, labels,
                problem.mesh.dim, problem.noise.information is not None, self.bias, self.tell,
            )  # fmt: skip

    def _visibility(self):
        """Find how small a lesion could be that a map of cells would show."""
        self.visible, unknowns, mesh = None, self.problem.unknowns, self.problem.mesh
        place = self.problem.look_at
        small = self.by_products or self.forward.n_free <= MOST_LOOKED_AT
        if unknowns.per_cell and (small or place is not None):
            self.at = (0.99, "regularized: what could be seen")
            self.visible = smallest_visible(
                self.state, self.misfit, self.scale, unknowns.per_group,
                mesh.centres[~unknowns.known], float(np.median(mesh.volumes) ** (1 / mesh.dim)),
                place, self.tell, resolved(mesh.volumes.sum() / mesh.n_nodes, mesh.dim),
            )  # fmt: skip

    @property
    def _modesty(self):
        """Factor of the noise found: a fit may find the information given too modest, but not call
        the map better for it."""
        return 1.0 if self.problem.noise.information is None else max(1.0, 1.0 / self.scale)

    def _sampled(self):
        """Samples of the error of x that the measurements leave."""
        return self.samples[0] * self._modesty

    def _shifted(self, slope, values):
        """The cells' own error of μ, relative to it, and the warning that it calls for."""
        unknown = ~self.problem.unknowns.known
        bias, sampled = slope @ self.bias, slope @ self._sampled()
        std = np.sqrt((sampled**2).mean(axis=1))
        bias, std = (np.abs(part / values)[unknown] for part in (bias, std))
        sentence = bias_warning(bias, std, self.forward.element)
        return float(np.median(bias)), [sentence] if sentence else []

    def _estimate(self) -> Estimate:
        lam, mu = self.parameters.moduli(self.x)
        errors, shift, warnings = self._sampled(), None, []
        L, M = self.parameters.slopes(self.x)
        if self.bias is not None:
            shift, warnings = self._shifted(M, mu)
            # either way: it is an estimate of the size, and the map is not corrected by it
            errors = errors + self.bias[:, None] * (-1.0) ** np.arange(errors.shape[1])
        if self.kept.merged is not None:
            errors = _and_either_way(errors, self.kept.merged)
        ratios = self.parameters.ratios_found(self.x, errors)
        stretches = self.parameters.stretches_found(self.x, errors)
        weight = self.variation.field_weight if len(self.variation) else []
        report = {
            "method": "regularized",
            "noise_scale": self.scale,
            "noise_given": self.problem.noise.scale is not None,
            "noise_found": self._floor(self.misfit.value() / self._left()),
            "noise_before_sharpening": self.first_noise,
            "misfit": self.misfit.value() / self.scale**2 / max(self.n_equations, 1),
            "effective_parameters": self.effective,
            "prior_weight": [float(w) for w in weight],
            "prior_rule": rule(self.kept),
            "element": self.forward.element,
            "mesh_shift": shift,
            "mesh_error": self.mesh_error,
            "structure": self.structure,
            "smallest_visible": self.visible,
            "refine": self.refine,
            "factorisation": self.forward.factoriser.name,
            "iterations": len(self.log),
            "equations": self.n_equations,
            "parameters": self.parameters.n,
            "poisson": ratios,
            "out_of_plane": stretches,
            "poisson_checks": self.checks,
            "convergence": self.log,
        }
        warnings += far_warnings(ratios) + warnings_of(stretches)
        order = np.full(len(lam), -1)
        return Estimate(
            lam, mu, L @ errors, M @ errors, order, report, warnings, self.unexplained,
            self.parameters.stretches(self.x), self._edges(),
        )  # fmt: skip

    def _edges(self):
        """Pairs of cells at edges of the map that no label follows, (k, 2)."""
        found = self.variation.edges.reshape(self.variation.n_fields, -1).any(axis=0)
        pairs = np.flatnonzero(~self.problem.unknowns.known)[self.variation.pairs[found]]
        labels = self.problem.labels
        if labels is None:
            return pairs
        one, other = labels[pairs].T
        return pairs[one == other]

    def _left(self):
        """The equations that the parameters leave to judge the noise by."""
        return max(self.n_equations - self.effective, 0.05 * self.n_equations)

    def _floor(self, variance):
        return float(max(np.sqrt(max(variance, 0.0)), 10 * self.problem.noise.round_off))

    def tell(self):
        """Say where the fit is, and let it be cancelled there."""
        self.progress(*self.at)

    def record(self, done, size):
        """Note a step, the share of the fit that is done with it, and how far it went."""
        misfit = self.misfit.value() / self.scale**2 / max(self.n_equations, 1)
        self.log.append({"misfit": misfit, "step": float(size), "noise_scale": self.scale})
        self.at = (
            done,
            f"regularized: step {len(self.log)}, misfit {misfit:.3f}, largest change {size:.2g}",
        )
        self.tell()


def _and_either_way(errors, one):
    """Samples (n, m + 2) whose covariance is that of samples (n, m) and of an error ± one."""
    m = errors.shape[1]
    return np.hstack([errors * np.sqrt((m + 2) / m), np.outer(one, [1, -1]) * np.sqrt((m + 2) / 2)])


def _typical_poisson(unknowns):
    lam, mu = unknowns.moduli(unknowns.flat_guess())
    return float(np.median(lam / (2 * (lam + mu))))
