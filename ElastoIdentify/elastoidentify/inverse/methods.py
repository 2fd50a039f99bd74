"""The identification methods by name. To add one, add a function Problem → Estimate here."""

import numpy as np

from ..errors import InputError
from ..fem.elastic_constants import NEGLIGIBLE_LAMBDA
from ..linalg.front_qr import FrontQR
from ..progress import Progress, part
from .balance_system import BalanceSystem
from .inverted import named
from .observations import CONTRADICTED, propagate
from .problem import Estimate, Problem, estimate_from_theta
from .sequential import plan_walk

# The walk is trusted as long as the typical error of μ that it predicts stays below this.
TRUSTED_ERROR = 0.05
MOST_LOST = 0.01  # share of the cells on its way that it may lose


class Folded(InputError):
    """The law has no stress where measured displacements turn a cell inside out."""


def _system(problem: Problem) -> BalanceSystem:
    system = BalanceSystem(
        problem.mesh, problem.law, problem.displacements, problem.unknowns, problem.reaction,
        problem.conditions, problem.laws(),
    )  # fmt: skip
    if not (np.isfinite(system.A.data).all() and np.isfinite(system.b).all()):
        raise Folded(
            f"the displacements turn cells inside out ({named(np.flatnonzero(problem.inverted))}), "
            f"where the {problem.law.name} law has no stress: take method 'regularized', or check "
            "the registration"
        )
    return system


def sequential(problem: Problem, progress: Progress | None = None) -> Estimate:
    """Walk from node to node, away from the known cells (source paper)."""
    system = _system(problem)
    walk = plan_walk(system, part(progress, 0, 0.8))
    theta = walk.solve(system.b[:, None])[:, 0]
    noise = propagate(system, problem.noise, theta, walk.solve)
    per_group = problem.unknowns.per_group
    size = np.abs(theta).reshape(-1, per_group)
    # λ of a material like cork is zero, and then its error is measured by μ
    size = np.maximum(size, NEGLIGIBLE_LAMBDA * size[:, -1:])
    with np.errstate(invalid="ignore"):
        lost = ~(np.sqrt((noise.errors**2).mean(axis=1)).reshape(-1, per_group) < size)
    # a cell whose error has outgrown its value takes along all that was found from it
    theta[np.repeat(walk.spoiled(lost.any(axis=1)), per_group)] = np.nan
    return estimate_from_theta(
        problem, theta, noise.errors, walk.order, method="sequential", noise_scale=noise.scale,
        redundant_equations=noise.redundancy, imbalance=noise.excess, equations=len(system.b),
        parameters=len(theta), steps=len(walk.steps),
    )  # fmt: skip


def global_(problem: Problem, progress: Progress | None = None) -> Estimate:
    """Solve all balance equations by least squares; null space by a rank-revealing QR."""
    system = _system(problem)
    per_group = problem.unknowns.per_group
    factor = FrontQR.revealing(
        system.A,
        system.b,
        np.repeat(system.node_level, system.rows_per_node),
        np.repeat(system.group_level, per_group),
        part(progress, 0, 0.9),
        system.column_errors(),
    )
    theta = factor.solution()
    free = factor.undetermined()
    theta[free] = np.nan

    def solve(right):
        found = factor.pseudo_inverse(right)
        found[free] = np.nan
        return found

    noise = propagate(system, problem.noise, theta, solve)
    return estimate_from_theta(
        problem, theta, noise.errors, method="global", noise_scale=noise.scale,
        redundant_equations=noise.redundancy, imbalance=noise.excess, equations=len(system.b),
        parameters=len(theta), null_space=len(factor.dependent),
        conditioning=factor.condition(),
    )  # fmt: skip


def regularized(problem: Problem, progress: Progress | None = None) -> Estimate:
    """Fit displacements of elastic equilibrium, with a total variation prior."""
    from .regularized import fit_displacements

    return fit_displacements(problem, progress)


def auto(problem: Problem, progress: Progress | None = None) -> Estimate:
    """Walk; where the walk's own propagated error forbids trust, go on to the regularized fit."""
    why = _needs_the_fit(problem)
    try:
        walked = None if why else sequential(problem, part(progress, 0, 0.2))
    except Folded:
        walked, why = None, "the displacements turn cells inside out"
    if walked is None:
        return _fitted(problem, progress, why)
    cells = ~problem.unknowns.known & (walked.order >= 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = walked.mu_std[cells] / walked.mu[cells]
    # given up on the way, or no stable material: then the others' own errors are not to be believed
    error[~(error >= 0)] = np.inf
    typical = float(np.median(error)) if error.size else np.inf
    lost = float(np.mean(error >= 1)) if error.size else 1.0
    # with no equation left over the noise is unknown, and round-off stands in its place
    unheard = problem.noise.scale is None and not walked.report["redundant_equations"]
    excess = walked.report["imbalance"] or 0.0
    contradicted = excess > CONTRADICTED
    if typical <= TRUSTED_ERROR and lost < MOST_LOST and not unheard and not contradicted:
        walked.report["auto"] = (
            f"sequential: its propagated error of μ is {typical:.1e} of the value (median)"
        )
        return walked
    if error.size and unheard:
        why = "the sequential method leaves no equation over from which its error could be told"
    elif contradicted:
        why = (
            f"the balance of forces is missed by {excess:.2g} times what the noise among the known "
            "cells explains"
        )
    elif np.isfinite(typical) and typical > TRUSTED_ERROR:
        why = (
            f"the sequential method's propagated error of μ is {typical:.1e} of the value "
            f"(median), more than {TRUSTED_ERROR:g}"
        )
    elif error.size:
        why = (
            "the sequential method's propagated error of μ exceeds the value in "
            f"{lost:.0%} of the cells"
        )
    else:
        why = "the sequential method finds no node to start from"
    return _fitted(problem, part(progress, 0.2, 1), why)


def _needs_the_fit(problem: Problem) -> str:
    """Return why nothing but the regularized fit will do, "" where others may."""
    if problem.unknowns.ratio is not None:
        return "it alone estimates Poisson's ratio with the map"
    if problem.stretch is not None and problem.stretch.std:
        return "it alone estimates the stretch out of the plane"
    if problem.noise.lost.any():
        return "it alone does without the displacements of some nodes"
    return ""


def _fitted(problem: Problem, progress, why: str) -> Estimate:
    estimate = regularized(problem, progress)
    estimate.report["auto"] = f"regularized: {why}"
    return estimate


METHODS = {
    "auto": auto,
    "sequential": sequential,
    "global": global_,
    "regularized": regularized,
}
