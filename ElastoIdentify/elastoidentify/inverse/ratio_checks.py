"""What the displacements say of every Poisson's ratio that was given: a free check of ν and plane.

A pad of given E and ν that is pushed also shows its ν: by how much it grows sideways and loses
area. So does the tissue. Raw strains do not tell, since a pad that sticks is not free to grow; the
fit knows how it is held. With j the change of the computed displacements per ν of some cells,
everything else as found, r the residuals and J the fit's own derivatives, ν + δ fits best with

    δ = jᵀW r / jᵀW (j − J h),     h = (P + JᵀWJ)⁻¹ JᵀW j,     variance σ² / jᵀW (j − J h)

and the cells' own error (:mod:`.mesh_bias`) added to it. This is one Gauss-Newton step of one more
parameter (as in a score test: Rao, Proc. Camb. Philos. Soc. 44, 1948). Motion out of the imaged
plane shows as a ν that the pad does not have.
"""

import numpy as np

from ..fem.elastic_constants import young_from_lame
from .misfit import beside, difference
from .newton_systems import COARSE
from .poisson import of_unit_young

# shifts of ν worth a sentence, of known cells (which the map feels little) and of unknown ones
NOTABLE = {True: 0.02, False: 0.01}
CERTAIN = 4.0  # and how many standard deviations they must be
LARGEST = 0.5  # ν of a material that is alike in all directions


def ratio_checks(fit) -> list[dict]:
    """Return what the displacements say of each ν that the fit took as given.

    Parameters
    ----------
    fit : a fit at its map, with a factorised system there

    Returns
    -------
    list of dict
        ``label``; ``known`` (its E was given, too); ``given``, ``shown``, ``std``: ν; ``beyond``:
        by how much the displacements show more than ½ in plane stress, where ``shown`` ends there.
        Labels whose ν cannot be told are left out.
    """
    given = list(_given(fit.problem))
    if not given:
        return []
    rows = []
    shifts = _shifts(fit, [cells for *_, cells in given])
    for (label, known, cells), (shift, std) in zip(given, shifts, strict=True):
        nu = float(_ratio_and_young(fit, cells)[0].mean())
        if np.isfinite(std):
            shown = float(nu + shift)
            beyond = max(shown - LARGEST, 0.0) if fit.problem.unknowns.plane_stress else 0.0
            rows.append(
                {"label": label, "known": known, "given": nu, "shown": shown - beyond, "std": std,
                 "beyond": beyond}
            )  # fmt: skip
    return rows


def _given(problem):
    """Yield label, known, cells (n_cells,) bool of every given ν."""
    unknowns, labels = problem.unknowns, problem.labels
    labels = np.zeros(len(unknowns.group), int) if labels is None else labels
    for label in np.unique(labels[unknowns.known]):
        yield int(label), True, unknowns.known & (labels == label)
    if unknowns.per_group == 1 and unknowns.ratio is None:
        for label in np.unique(labels[~unknowns.known]):
            yield int(label), False, ~unknowns.known & (labels == label)


def _ratio_and_young(fit, cells):
    lam, mu = (part[cells] for part in fit.parameters.moduli(fit.x))
    young, nu = young_from_lame(lam, mu)
    if fit.problem.unknowns.plane_stress:  # λ* = Eν/(1 − ν²), μ = E/(2(1 + ν))
        nu = lam / (lam + 2 * mu)
        young = 2 * (1 + nu) * mu
    return nu, young


def _shifts(fit, labels):
    """δ and its standard deviation for the cells of each label; NaN: displacements do not tell."""
    state, misfit, forward = fit.state, fit.misfit, fit.forward
    m, slopes = len(labels), np.zeros((2, len(labels[0]), len(labels)))
    for k, cells in enumerate(labels):
        nu, young = _ratio_and_young(fit, cells)
        for of_cell, slope in zip(
            slopes[..., k], of_unit_young(nu, fit.problem.unknowns.plane_stress)[1], strict=True
        ):
            of_cell[cells] = young * slope
    by_lam, by_mu = (slope[forward.parent] for slope in slopes)
    loads = []
    for u in forward.displacements(state.eta):
        per_lam, per_mu = forward.cells.force_matrices(u)
        loads.append(-(forward.Z.T @ (per_lam @ by_lam + per_mu @ by_mu))[: state.n_free])
    held = np.zeros((forward.n_eta - state.n_free, m))
    change = [np.vstack([free, held]) for free in state.solve(loads)]
    j = misfit.seen(None, change)
    nothing = np.zeros((fit.parameters.n, m))
    dx, db = fit.system.solve(nothing, j, tell=fit.tell, tolerance=COARSE)
    left = difference(j, misfit.seen(dx, state.change(dx, db)))
    curvature = np.diag(misfit.gram(beside(j, left), fit.scale)[:m, m:])
    score = misfit.gram(beside(j, misfit.residuals()), fit.scale)[:m, m]
    # the finite elements' own error, which looks like a ν, too
    of_cells = np.zeros(m)
    if fit.gap:
        gap = misfit.of_first_term(fit.gap)
        of_cells = misfit.gram(beside(left, gap), fit.scale)[:m, m]
    return [
        (s / c, float(np.hypot(1 / np.sqrt(c), g / c))) if c > 0 else (np.nan, np.nan)
        for s, c, g in zip(score, curvature, of_cells, strict=True)
    ]


def contradicts(row: dict) -> bool:
    """Tell whether the displacements contradict a ν that was given."""
    return abs(row["shown"] - row["given"]) > _least(row)


def spreads_too_much(row: dict) -> bool:
    """Tell whether the displacements show more than the ν of any isotropic material.

    In plane stress, where λ* = 2μν/(1 − ν) hardly changes near ν = ½: the map is then that of the
    nearest ν that a material can have, and `shown` is that.
    """
    return row.get("beyond", 0.0) > _least(row)


def _least(row):
    # a little more: 0.5 − 0.49 is above 0.01 by rounding
    return max(NOTABLE[row["known"]], CERTAIN * row["std"]) + 1e-9


def mean_strains(problem) -> list[dict]:
    """Return the mean strain of each label in each trial, as measured.

    Returns
    -------
    list of dict
        ``label``; ``trial``, from 1; ``axial``: the largest compression (negative); ``lateral``
        over it, with the sign of Poisson's ratio: in plane strain ν/(1 − ν) where nothing holds
        the sides, and less where they stick; ``volume``: the change of area or volume, relative.
    """
    mesh = problem.mesh
    labels = np.zeros(mesh.n_cells, int) if problem.labels is None else problem.labels
    names, number = np.unique(labels, return_inverse=True)
    d, rows = mesh.dim, []
    for trial, u in enumerate(problem.displacements, 1):
        H = np.empty((mesh.n_cells, d, d))
        for block in mesh.blocks:
            H[block.ids] = block.gradient(u).mean(axis=1)
        size = np.bincount(number.ravel(), mesh.volumes)
        for k, name in enumerate(names):
            here = number.ravel() == k
            mean = np.einsum("c,cij->ij", mesh.volumes[here], H[here]) / size[k]
            axial, *lateral = np.linalg.eigvalsh((mean + mean.T) / 2)
            rows.append(
                {"label": int(name), "trial": trial, "axial": float(axial),
                 "lateral": float(-np.mean(lateral) / axial) if axial else np.nan,
                 "volume": float(np.linalg.det(np.eye(d) + mean) - 1)}
            )  # fmt: skip
    return rows


def reason(row: dict) -> str:
    """Say that the displacements contradict a ν that was given, and what to try."""
    what = "which was not asked to be estimated: it makes lesions that are not there; let it be "
    what += "estimated (unknowns 'young', standard deviation of Poisson's ratio 0.05)"
    if row["known"]:
        what = "so check it; if it is right, the body moves out of the imaged plane, or slips"
    return (
        f"Poisson's ratio of label {row['label']} was given as {row['given']:.3g}, and its "
        f"displacements show about {min(max(row['shown'], -0.99), 0.5):.2f}, {what}"
    )


def reason_of_spread(row: dict) -> str:
    """Say that the displacements show more than the ν of any isotropic material."""
    return (
        f"label {row['label']} spreads sideways more than any material that is alike in all "
        "directions: it may yield, have fibres, or move out of the imaged plane"
    )
