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
their errors, so the sharpest map is taken as it is.
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
WARY = 3.5  # charge for a degree of freedom, chosen on the bodies that docs/theory.md names
LIMIT = 50_000  # free degrees of freedom beyond which fitting anew costs too much
EDGE, REFITS = 0.1, 4  # jump of a log-modulus that is an edge; steps with each boundary one jump


@dataclass(frozen=True)
class Map:
    """One of the maps to choose from."""

    exponent: float
    x: np.ndarray
    eta: np.ndarray
    residuals: list
    misfit: float = 0.0  # |y − u(y)|² / σ², with σ of the variational stage
    freedom: float = 0.0  # df


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
        return _refitted(fit, _sharpened(fit, exponents[0])), None
    if fit.forward.n_free > LIMIT:
        return _refitted(fit, _sharpened(fit, exponents[0])), plain
    stein = Stein(fit, plain)
    plain, kept = stein.judged(plain), None
    for exponent in exponents:
        _go_to(fit, plain)
        one = stein.judged(_sharpened(fit, exponent))
        if kept is None:
            stein.noise = max(one.misfit / max(fit.n_equations, 1), 1e-9)
            kept = one
        elif stein.gain(one, kept, WARY) > stein.doubt(one, kept):
            kept = one
        sure = stein.gain(kept, plain, 2) > stein.doubt(kept, plain)
        if sure:
            break
    if stein.gain(plain, kept, WARY) > stein.doubt(plain, kept):
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
    """The parts of Stein's estimate for each map, with the same added noise for all.

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
        self.starts, nothing = [], np.zeros((len(fit.x), 1))
        for noise in self.added:
            dx, db = fit.system.solve(nothing, noise, tell=fit.tell)
            seen = fit.misfit.seen(dx, fit.state.change(dx, db))
            eta = fit.forward.moved(fit.state, dx[:, 0], [b[:, 0] for b in db])
            left = difference(plain.residuals, difference(seen, noise))
            self.starts.append(Map(UNSHARPENED, plain.x + dx[:, 0], eta, left))

    def judged(self, one: Map) -> Map:
        """Return the map with its misfit and freedom."""
        freedom = 0.0
        for noise, again in zip(self.added, self._again(one), strict=True):
            answer = difference(noise, difference(again, one.residuals))
            freedom += self._product(noise, answer) / len(self.added)
        return replace(one, misfit=self._product(one.residuals, one.residuals), freedom=freedom)

    def _again(self, one):
        """What the same way leaves of the measured numbers with noise added, per draw."""
        fit = self.fit
        for noise, start in zip(self.added, self.starts, strict=True):
            if one.exponent == UNSHARPENED:  # to first order
                yield start.residuals
                continue
            fit.added = noise
            _go_to(fit, start)
            yield _sharpened(fit, one.exponent, ROUGHLY).residuals
            fit.added = None

    def gain(self, one: Map, other: Map, charge: float) -> float:
        """Return by how much the risk of one is below that of the other."""
        return (other.misfit - one.misfit) / self.noise + charge * (other.freedom - one.freedom)

    def doubt(self, one: Map, other: Map) -> float:
        """Return the standard deviation of the gain that the noise makes."""
        apart = difference(one.residuals, other.residuals)
        return 2 * np.sqrt(max(self._product(apart, apart), 0.0) / self.noise)

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
    fit.x, fit.eta = one.x, one.eta
    fit.evaluate()
