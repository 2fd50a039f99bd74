"""How far a map is sharpened: the second stage of the regularized fit, and which map it keeps.

Total variation reweighted by its own result (Candès, Wakin, Boyd, J. Fourier Anal. Appl. 14, 2008)
has no scale of its own and so takes the contrast loss of total variation away: right for tissue
made of flat pieces. Where stiffness varies smoothly it makes steps of it, and calls them certain;
at high noise it can lose a lesion. What a body is made of the data say: of maps that are sharpened
more, less and not at all the one is kept whose displacements are expected to be nearest to the true
ones, by Stein's unbiased estimate of that risk (Ann. Statist. 9, 1981),

    |y − u(y)|² / σ²  +  2 df,        df = E[w · (u(y + σw) − u(y))] / σ,        w ~ N(0, 1),

with the degrees of freedom df found by fitting anew with noise added (Ramani, Blu, Unser, IEEE
Trans. Image Process. 17, 2008). It is as large as the noise itself, so that what a fit spends on
choosing its steps counts, which derivatives at the map do not see.

The estimate wants errors that are independent from node to node. Those of a registration, of cells
that an edge cuts or of a law that is not quite right are alike over many nodes, and look just like
tissue that varies. So each degree of freedom is charged WARY instead of 2 in the choice, as
overdispersed counts are (Burnham and Anderson, Model Selection and Multimodel Inference, 2002), σ²
is what the sharpest map finds, and a sharper map is left only for a gain beyond chance. Where
Stein's own estimate does not confirm the choice, both maps stand: errors are samples of either.
Displacements that come with their information are a registration's: the unsharpened map would fit
their errors, so the sharpest map is taken. A weak lesion that it merges with the tissue looks just
like such errors: what the unsharpened map showed within a region of the sharpened one, common to
several cells, is counted as an error of either sign.
"""

from dataclasses import dataclass, replace

import numpy as np

from .misfit import beside, difference

STEPS = 15
SETTLED, ROUGHLY = 0.05, 0.1  # largest change of a log-modulus in the last step; with noise added
# exponents of the reweighted prior, p(jump) ∝ |jump|^−e, by dimension, the sharpest first (a closed
# surface has many more sides than a closed line, and each costs)
EXPONENTS = {2: (3.0, 0.75), 3: (0.5,)}
UNSHARPENED = 0.0
DRAWS, MANY = 2, 3_000  # of added noise; parameters from which one does, as chance averages out
CERTAIN = 1.0  # standard deviations of what draws leave to chance, beyond which no more are taken
WARY = 3.5  # charge for a degree of freedom, chosen on the bodies that docs/theory.md names
# free degrees of freedom, by dimension, beyond which fitting anew costs too much; by products it is
# a fifteenth of the whole
LIMIT = {2: 50_000, 3: 100_000}
EDGE, REFITS = 0.1, 4  # jump of a log-modulus that is an edge; steps with each boundary one jump


@dataclass(frozen=True)
class Map:
    """One of the maps to choose from."""

    exponent: float
    x: np.ndarray
    eta: np.ndarray
    residuals: list
    merged: np.ndarray | None = None  # (n,) what a map of a registration lost in its regions


def sharpen(fit) -> tuple[Map, Map | None]:
    """Leave a fit at the map that is kept, evaluated; return that map, and the other one.

    Parameters
    ----------
    fit : object
        A regularized fit after its variational stage, with ``x``, ``eta``, ``samples``, ``prior``,
        ``variation``, ``misfit``, ``system``, ``scale``, ``added``, ``rounds``, ``evaluate``,
        ``factorise``, ``step``, ``record``.

    Returns
    -------
    kept : Map
    other : Map or None
        The unsharpened map, where the data cannot tell which of the two is right.
    """
    fit.evaluate()
    if not len(fit.variation):
        return _here(fit, UNSHARPENED), None
    plain, exponents = _here(fit, UNSHARPENED), EXPONENTS[fit.problem.mesh.dim]
    if fit.problem.noise.information is not None:
        kept = _refitted(fit, _sharpened(fit, exponents[0]))
        return replace(kept, merged=fit.variation.merged(plain.x - kept.x)), None
    if fit.forward.n_free > LIMIT[fit.problem.mesh.dim]:
        return _refitted(fit, _sharpened(fit, exponents[0])), plain
    stein, kept = Stein(fit, plain), None
    for exponent in exponents:
        _go_to(fit, plain)
        one = _sharpened(fit, exponent)
        if kept is None:
            stein.noise = max(stein.misfit(one) / max(fit.n_equations, 1), 1e-9)
            kept = one
        elif stein.prefers(one, kept, WARY):
            kept = one
        sure = stein.prefers(kept, plain, 2)
        if sure:
            break
    if stein.prefers(plain, kept, WARY):
        kept = plain
    _go_to(fit, kept)
    if kept is plain:
        fit.prior.variational(fit.x, fit.samples[0])
        return kept, None
    return _refitted(fit, kept), None if sure else plain


def rule(kept: Map) -> str:
    """Return how a map's prior came about, for the report."""
    first = "variational Bayes of total variation"
    if kept.exponent == UNSHARPENED:
        return first
    return f"{first}, then reweighted with the exponent {kept.exponent:g}"


class Stein:
    """Stein's estimate of the maps' risks, with the same added noise for all.

    Parameters
    ----------
    fit : object
        Evaluated at the unsharpened map.
    """

    def __init__(self, fit, plain: Map):
        self.fit, rng = fit, np.random.default_rng(0)
        fit.factorise()
        draws = DRAWS if len(fit.x) < MANY else 1
        self.added = [fit.misfit.noise(rng, 1, fit.scale) for _ in range(draws)]
        self.noise = 1.0  # variance of the noise, in units of that of the variational stage
        self.drawn = {}  # what each draw tells of a map's freedom, by exponent
        self.starts, nothing = [], np.zeros((len(fit.x), 1))
        for noise in self.added:
            dx, db = fit.system.solve(nothing, noise, tell=fit.tell)
            seen = fit.misfit.seen(dx, fit.state.change(dx, db))
            eta = fit.forward.moved(fit.state, dx[:, 0], [b[:, 0] for b in db])
            left = difference(plain.residuals, difference(seen, noise))
            self.starts.append(Map(UNSHARPENED, plain.x + dx[:, 0], eta, left))

    def prefers(self, one: Map, other: Map, charge: float) -> bool:
        """Tell whether one map's risk is below the other's by more than chance.

        A draw costs a fit. Of the difference of two maps' freedom it tells wᵀ (A − B) w, with A and
        B their answers to noise, which scatters by √2 |A − B|; were both projections, one within
        the other, that would be √(2 |df_A − df_B|).
        """
        apart = difference(one.residuals, other.residuals)
        doubt = 2 * np.sqrt(max(self._product(apart, apart), 0.0) / self.noise)
        for draws in range(1, len(self.added) + 1):
            freedom = self.freedom(other, draws) - self.freedom(one, draws)
            gain = (self.misfit(other) - self.misfit(one)) / self.noise + charge * freedom
            scatter = charge * np.sqrt(2 * max(abs(freedom), 1.0) / draws)
            if abs(gain - doubt) > CERTAIN * scatter:
                break
        return bool(gain > doubt)

    def misfit(self, one: Map) -> float:
        """Return |y − u(y)|² / σ², with σ of the variational stage."""
        return self._product(one.residuals, one.residuals)

    def freedom(self, one: Map, draws: int) -> float:
        """Return df of a map, by so many draws."""
        drawn = self.drawn.setdefault(one.exponent, [])
        for draw in range(len(drawn), draws):
            noise = self.added[draw]
            answer = difference(noise, difference(self._again(one, draw), one.residuals))
            drawn.append(self._product(noise, answer))
        return sum(drawn[:draws]) / draws

    def _again(self, one, draw):
        """What the same way leaves of the measured numbers with the draw's noise added."""
        start = self.starts[draw]
        if one.exponent == UNSHARPENED:  # to first order
            return start.residuals
        self.fit.added = self.added[draw]
        _go_to(self.fit, start)
        residuals = _sharpened(self.fit, one.exponent, ROUGHLY).residuals
        self.fit.added = None
        return residuals

    def _product(self, a, b):
        """Σ aᵀ W b / σ² of numbers per term and trial."""
        return float(self.fit.misfit.gram(beside(a, b), self.fit.scale)[0, 1])


def _sharpened(fit, exponent, settled=SETTLED) -> Map:
    """Reweight and step until the map settles, from where the fit is."""
    fit.variation.sharpening = exponent
    most = len(EXPONENTS[fit.problem.mesh.dim]) * (1 + DRAWS)
    for iteration in range(STEPS):
        if iteration:
            fit.evaluate()
        fit.prior.reweighted(fit.x, None)
        fit.factorise()
        size = fit.step()
        fit.record(0.5 + 0.48 * (fit.rounds + (iteration + 1) / STEPS) / most, size)
        if size < settled:
            break
    fit.rounds += 1
    fit.evaluate()
    return _here(fit, exponent)


def _refitted(fit, kept: Map) -> Map:
    """Fit the regions of a sharpened map once more, each boundary between two as one jump.

    The force of the reweighted prior across a boundary is e / jump per side: all sides together
    take a tenth of a weak lesion's contrast.
    """
    fit.variation.sharpening = kept.exponent
    fit.variation.find_regions(fit.x, EDGE)
    for _ in range(REFITS):
        fit.prior.reweighted(fit.x, None)
        fit.factorise()
        size = fit.step()
        fit.evaluate()
        if size < SETTLED:
            break
    fit.prior.reweighted(fit.x, None)
    return _here(fit, kept.exponent)


def _here(fit, exponent) -> Map:
    return Map(exponent, fit.x, fit.eta, fit.misfit.residuals())


def _go_to(fit, one: Map):
    if fit.x is one.x and fit.eta is one.eta:
        return  # it is there
    fit.x, fit.eta, fit.moved = one.x, one.eta, np.inf
    fit.evaluate()
