"""What a method found, made into what users get: values, errors, the status of every cell.

A value is given where it is determined: where its standard deviation is below it. μ may be and λ
not; then μ is given alone.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph

from ..fem.assembly import internal_forces
from ..fem.elastic_constants import (
    NEGLIGIBLE_LAMBDA,
    admissible,
    lambda_from_plane_stress,
    young_from_lame,
)
from ..results import VALUES, Status, is_found
from .edges import with_edges
from .problem import Estimate, Problem
from .statistics import CellErrors, cell_errors


@dataclass
class IdentificationResult:
    """What was found, cell by cell, in the unit of the known material's Young's modulus.

    All cell arrays have shape (n_cells,) and the cell order of the input.
    """

    lam: np.ndarray
    mu: np.ndarray
    young: np.ndarray
    poisson: np.ndarray
    lam_std: np.ndarray
    mu_std: np.ndarray
    young_std: np.ndarray
    poisson_std: np.ndarray
    model_misfit: np.ndarray  # share of the local misfit that noise does not explain; NaN: unknown
    status: np.ndarray  # codes of elastoidentify.results.Status
    sequence_order: np.ndarray
    residuals: np.ndarray  # (n_trials, n_nodes, dim of the points given)
    report: dict = field(default_factory=dict)  # JSON-ready; report["warnings"]: list of sentences
    tried: list = field(default_factory=list, repr=False)  # of elastoidentify.exploration.Tried

    @property
    def statistics(self) -> list[dict]:
        """Figures per label, see :func:`~elastoidentify.inverse.statistics.label_statistics`."""
        return self.report["labels"]


def result_of(
    problem: Problem, estimate: Estimate, plane_stress: bool, warnings: list[str]
) -> tuple[IdentificationResult, CellErrors]:
    """Return the result, its report without what only the caller knows, and samples of its errors.

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
    plane_stress : bool
        The estimate's λ is λ*.
    warnings : list of str
        That come before those of the result.
    """
    known = problem.unknowns.known
    lam, mu, *samples = _moduli(estimate, plane_stress)
    errors = cell_errors(lam, mu, *(np.where(known[:, None], 0.0, e) for e in samples))
    status = _status(problem, lam, mu, errors)
    errors = with_edges(errors, lam, mu, estimate.edges)
    values = {"mu": mu, "lam": lam} | dict(
        zip(("young", "poisson"), young_from_lame(lam, mu), strict=True)
    )
    for one in VALUES:
        values[f"{one.field}_std"] = errors.std(one.array)
        shown = is_found(status, one.array) | (status == Status.OUT_OF_RANGE)
        for name in (one.field, f"{one.field}_std"):
            values[name] = np.where(shown, values[name], np.nan)
    none = status == Status.NOT_DETERMINED
    with np.errstate(invalid="ignore", divide="ignore"):
        error = (values["mu_std"] / np.abs(values["mu"]))[~known & ~none]
    typical = float(np.median(error)) if error.size else None
    warnings = (
        warnings
        + estimate.warnings
        + _found_warnings(status, known, typical, estimate.report["method"])
    )
    warnings += _why_nothing(problem, status)
    counts = {one.name.lower(): int((status == one).sum()) for one in Status}
    return IdentificationResult(
        **values,
        model_misfit=np.full(len(mu), np.nan) if estimate.misfit is None else estimate.misfit.share,
        status=status,
        sequence_order=np.where(none, -1, estimate.order).astype(np.int32),
        residuals=_residuals(problem, estimate),
        report=estimate.report | {"cells": counts, "typical_error": typical, "warnings": warnings},
    ), errors


def _moduli(estimate, plane_stress):
    """Return λ, μ (n_cells,) and samples of their errors; in plane stress from λ* to λ."""
    lam, mu = estimate.lam, estimate.mu
    lam_errors, mu_errors = estimate.lam_errors, estimate.mu_errors
    if not plane_stress:
        return lam, mu, lam_errors, mu_errors
    with np.errstate(divide="ignore", invalid="ignore"):
        by_lam, by_mu = 4 * mu**2 / (2 * mu - lam) ** 2, -2 * lam**2 / (2 * mu - lam) ** 2
        lam_errors = by_lam[:, None] * lam_errors + by_mu[:, None] * mu_errors
    return lambda_from_plane_stress(lam, mu), mu, lam_errors, mu_errors


def _status(problem, lam, mu, errors):
    """Tell what is known of every cell, by the errors that the measurements leave. (n_cells,)"""
    status = np.full(len(mu), Status.IDENTIFIED, np.uint8)
    status[~admissible(lam, mu)] = Status.OUT_OF_RANGE
    with np.errstate(invalid="ignore"):
        lost = ~(errors.std("Mu") < np.abs(mu))
        # λ of a material like cork is zero, and then its error is measured by μ
        size = np.maximum(np.abs(lam), NEGLIGIBLE_LAMBDA * np.abs(mu))
        no_lambda = ~(errors.std("Lambda") < size)
        if problem.unknowns.ratio is not None:  # λ follows from ν, whose error is stated
            no_lambda[:] = False
        lost |= no_lambda & ~(mu > 0)
    status[no_lambda] = Status.SHEAR_ONLY
    status[lost | ~_reached(problem)] = Status.NOT_DETERMINED
    status[problem.inverted] = Status.NOT_DETERMINED  # no body moves so
    status[problem.unknowns.known] = Status.KNOWN
    return status


def _reached(problem):
    """Tell which cells a chain of balance equations ties to the known ones. (n_cells,) bool

    Beyond that the data have no scale: what a fit shows there is its prior.
    """
    unknowns, mesh = problem.unknowns, problem.mesh
    vertex = np.where(unknowns.known, unknowns.n_groups, unknowns.group)  # known cells are one
    there = problem.conditions
    free = (there.members @ mesh.node_cells)[there.asked].tocoo()
    n_rows, n = free.shape[0], unknowns.n_groups + 1
    edges = sp.coo_matrix(
        (np.ones(free.nnz, bool), (free.row, n_rows + vertex[free.col])), (n_rows + n,) * 2
    )
    piece = csgraph.connected_components(edges, directed=False)[1][n_rows:]
    return piece[vertex] == piece[-1]


def _why_nothing(problem, status):
    """Say what about the reaction nodes leaves most cells undetermined."""
    unknown = ~problem.unknowns.known
    if (status[unknown] == Status.NOT_DETERMINED).mean() <= 0.5:
        return []
    free = ~problem.reaction[problem.mesh.boundary_nodes]
    if free.all():
        return [
            "no node on the surface is marked as a reaction node, so that balance was asked also "
            "where the body is held or pushed: mark those nodes (reaction nodes, in files the "
            "point array ReactionNodes)"
        ]
    return []


def _found_warnings(status, known, typical, method):
    warnings, n = [], int((~known).sum())
    lost = int((status == Status.NOT_DETERMINED).sum())
    out = int((status == Status.OUT_OF_RANGE).sum())
    shear_only = int((status == Status.SHEAR_ONLY).sum())
    if shear_only:
        warnings.append(
            f"in {shear_only} of {n} unknown cells μ alone is determined (Status 4: λ, E and ν "
            "have no value)"
        )
    if lost:
        warnings.append(
            f"{lost} of {n} unknown cells are not determined by these data (Status 0, no value)"
        )
    if typical is not None and typical > 0.3:
        other = "" if method == "regularized" else "method 'regularized', "
        warnings.append(
            f"the typical error of μ is {typical:.0%} of its value: the map is mostly noise; use "
            f"{other}larger pushes, better images or one unknown per label"
        )
    if out:
        warnings.append(
            f"{out} of {n} unknown cells came out with moduli that no stable material has "
            "(Status 3): noise, or kinematics that do not fit the push"
        )
    return warnings


def _residuals(problem, estimate):
    """Force left over at every free node with the values found; NaN where they are missing."""
    mesh = problem.mesh
    missing = ~(np.isfinite(estimate.lam) & np.isfinite(estimate.mu))
    lam, mu = (np.where(missing, 0, x) for x in (estimate.lam, estimate.mu))
    there = problem.conditions
    unknown_here = there.members @ (mesh.node_cells @ missing.astype(float)) > 0
    residuals = np.stack(
        [
            there.left(internal_forces(mesh, law, u, lam, mu))
            for u, law in zip(problem.displacements, problem.laws(estimate.stretches), strict=True)
        ]
    )
    residuals[:, unknown_here & ~problem.reaction] = np.nan
    return residuals
