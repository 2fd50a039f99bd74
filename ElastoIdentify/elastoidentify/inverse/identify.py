"""Identification of the Lamé constants: one entry point over all methods."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph

from ..errors import InputError
from ..fem.assembly import internal_forces
from ..fem.constitutive import KINEMATICS, Kinematics
from ..fem.elastic_constants import (
    NEGLIGIBLE_LAMBDA,
    admissible,
    check_material,
    lambda_from_plane_stress,
    young_from_lame,
)
from ..fem.elements import CELL_TYPES
from ..fem.mesh import Mesh, plane_frame
from ..progress import Progress, silent
from ..results import Status
from .methods import METHODS
from .observations import DisplacementNoise
from .parameterization import Unknowns, make_unknowns
from .problem import Problem
from .statistics import CellErrors, cell_errors, label_statistics


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
    status: np.ndarray  # codes of elastoidentify.results.Status
    sequence_order: np.ndarray
    residuals: np.ndarray  # (n_trials, n_nodes, dim of the points given)
    report: dict = field(default_factory=dict)  # JSON-ready; report["warnings"]: list of sentences

    @property
    def statistics(self) -> list[dict]:
        """Figures per label, see :func:`~elastoidentify.inverse.statistics.label_statistics`."""
        return self.report["labels"]


def identify(
    points: np.ndarray,
    cells: np.ndarray | Sequence[tuple[str, np.ndarray]],
    displacements: np.ndarray,
    known: Mapping[int, tuple[float, float]] | np.ndarray,
    *,
    labels: np.ndarray | None = None,
    reaction_nodes: np.ndarray | None = None,
    method: str = "auto",
    kinematics: str = "small-strain",
    plane: str = "strain",
    unknowns: str = "lambda-mu",
    poisson_ratio: float | None = None,
    grouping: str = "cell",
    information: np.ndarray | None = None,
    noise: float | None = None,
    refine: int | None = None,
    reference_label: int | None = None,
    element: str = "locking-free",
    progress: Progress | None = None,
) -> IdentificationResult:
    """Identify λ and μ of every cell from the displacements of its nodes.

    Parameters
    ----------
    points : (n_nodes, 2) or (n_nodes, 3)
        Node positions at rest. A mesh of planar cells may lie in any plane of space.
    cells : (n_cells, k) int, or list of (kind, (n, k) int)
        Connectivity. One array: triangles (k=3); quads or tetrahedra (k=4, by the dimension of
        the points: use the list form to be explicit); hexahedra (k=8). List: blocks of kinds
        "triangle", "quad", "tetra", "hexahedron", VTK's node order; cells are numbered through.
    displacements : (n_trials, n_nodes, 2 or 3)
        Rest → pushed, in the length unit of the points.
    known : {label: (young, poisson)} or (n_cells, 2) array
        The known cells, by label or per cell (NaN: not known).
    labels : (n_cells,) int, optional
        Label of each cell; needed for known-by-label and for ``grouping="label"``.
    reaction_nodes : (n_nodes,) bool, optional
        True where an outside body may push: no balance equation there.
    method : "auto", "sequential", "global", "regularized"
    kinematics : "small-strain", "st-venant-kirchhoff", "neo-hookean"
    plane : "strain", "stress" (2-D only)
    unknowns : "lambda-mu", or "young" with `poisson_ratio`
    grouping : "cell", "label"
    information : (n_trials, n_nodes, d, d), optional
        Inverse covariance of the measured displacements (1/length²).
    noise : float, optional
        Standard deviation of a displacement component; estimated when not given.
    refine : int, optional
        1, 4 or 16: sub-cells per cell of the forward problem of the regularized method.
    element : "locking-free", "linear"
        Cells of the regularized method's forward problem: with the dilatation averaged over patches
        of neighbours, right near incompressibility, or plain ones.
    reference_label : int, optional
        Label to which the ratios of ``result.statistics`` refer; the largest unknown one.
    progress : callable, optional

    Raises
    ------
    InputError
        One line: what is wrong, where, how to mend it.
    """
    progress = progress or silent
    frame = _Frame(points, cells)
    setting = _setting(
        frame, known, labels=labels, reaction_nodes=reaction_nodes, method=method,
        kinematics=kinematics, plane=plane, unknowns=unknowns, poisson_ratio=poisson_ratio,
        grouping=grouping, noise=noise, refine=refine, reference_label=reference_label,
        element=element,
    )  # fmt: skip
    problem, labels = _problem(frame, setting, displacements, information), setting.labels
    warnings = frame.notes + _check_trials(problem, unknowns, grouping)
    warnings += _check_equations(problem.mesh, setting, len(problem.displacements), method)
    progress(0.0, "force balance")
    estimate = METHODS[method](problem, progress)
    result, errors = _result(problem, estimate, plane == "stress", warnings)
    result.report["labels"] = label_statistics(
        np.zeros(problem.mesh.n_cells, int) if labels is None else labels,
        problem.mesh.volumes, result.status, result.lam, result.mu, errors, reference_label,
    )  # fmt: skip
    result.residuals = frame.to_world(result.residuals)
    result.report |= {
        "kinematics": kinematics, "unknowns": unknowns, "grouping": grouping,
        "requested_method": method, "trials": len(problem.displacements),
        "plane": plane if problem.mesh.dim == 2 else None, "dimension": problem.mesh.dim,
    }  # fmt: skip
    progress(1.0, "identified")
    return result


def check_input(
    points: np.ndarray,
    cells: np.ndarray | Sequence[tuple[str, np.ndarray]],
    known: Mapping[int, tuple[float, float]] | np.ndarray,
    *,
    n_trials: int,
    **options,
) -> None:
    """Refuse, before any displacement is measured, what :func:`identify` would refuse.

    Parameters
    ----------
    points, cells, known
        As in :func:`identify`.
    n_trials : int
        How many displacements there will be.
    **options
        As in :func:`identify`.

    Raises
    ------
    InputError
    """
    options = {"method": "auto", "labels": None, "reaction_nodes": None} | options
    frame = _Frame(points, cells)
    setting = _setting(frame, known, **options)
    _check_equations(frame.mesh, setting, n_trials, options["method"])


class _Frame:
    """The mesh in its own dimension, and the way of vectors into it and back."""

    def __init__(self, points, cells):
        points = np.asarray(points, float)
        if points.ndim != 2 or points.shape[1] not in (2, 3):
            raise InputError(f"points must have shape (n, 2) or (n, 3), these have {points.shape}")
        if not np.isfinite(points).all():
            node = np.flatnonzero(~np.isfinite(points).all(axis=1))[0]
            raise InputError(f"the position of node {node} is not a finite number: repair the mesh")
        blocks, dim = _blocks(points, cells)
        self.world_dim, self.axes, self.notes = points.shape[1], None, []
        if points.shape[1] == 3 and dim == 2:
            origin, self.axes = plane_frame(points)
            points = (points - origin) @ self.axes
            if _turn_clockwise(points, blocks):
                self.axes = self.axes * [-1, 1]
                points = points * [-1, 1]
        self.mesh = Mesh(points, blocks)

    def to_plane(self, vectors):
        """Displacements (t, n, 2 or 3) in the mesh's dimension; out of plane is dropped, noted."""
        if vectors.shape[-1] == self.mesh.dim:
            return vectors
        if self.axes is None:
            if vectors.shape[-1] != 3 or self.mesh.dim != 2:
                raise InputError(
                    f"displacements have {vectors.shape[-1]} components, the mesh has "
                    f"{self.mesh.dim} dimensions"
                )
            axes = np.eye(3)[:, :2]
        else:
            axes = self.axes
        inside = vectors @ axes
        out = vectors - inside @ axes.T
        size = np.abs(out).max(initial=0.0)
        if size > 1e-9 * np.abs(vectors).max(initial=0.0):
            self.notes.append(
                f"displacements out of the mesh's plane (up to {size:.3g}) were dropped: "
                "a planar mesh knows in-plane motion only"
            )
        return inside

    def tensors_to_plane(self, tensors):
        """Information matrices (t, n, 3, 3) → (t, n, d, d), out-of-plane motion left free."""
        if tensors.shape[-1] == self.mesh.dim:
            return tensors
        axes = np.eye(3)[:, :2] if self.axes is None else self.axes
        return np.einsum("ia,tnij,jb->tnab", axes, tensors, axes)

    def to_world(self, vectors):
        """Vectors (…, d) in the dimension of the points that were given."""
        if self.axes is not None:
            return vectors @ self.axes.T
        return vectors


def _blocks(points, cells):
    """Blocks (kind, nodes, ids) and their dimension, from either form of `cells`."""
    if not (isinstance(cells, (list, tuple)) and len(cells) and isinstance(cells[0][0], str)):
        cells = np.asarray(cells, int)
        kinds = {3: "triangle", 8: "hexahedron", 4: "quad" if points.shape[1] == 2 else "tetra"}
        if cells.ndim != 2 or cells.shape[1] not in kinds:
            raise InputError(
                f"cells of shape {cells.shape}: give (n, 3), (n, 4) or (n, 8), or a list of "
                "(kind, array)"
            )
        cells = [(kinds[cells.shape[1]], cells)]
    blocks, start, dims = [], 0, set()
    for kind, nodes in cells:
        _choice("cell kind", kind, CELL_TYPES)
        nodes = np.asarray(nodes, int)
        if nodes.size == 0:
            continue
        if nodes.ndim != 2 or nodes.shape[1] != CELL_TYPES[kind].n_nodes:
            raise InputError(
                f"{kind} cells of shape {nodes.shape}: expected (n, {CELL_TYPES[kind].n_nodes})"
            )
        if nodes.min() < 0 or nodes.max() >= len(points):
            raise InputError(
                f"{kind} cells refer to nodes {nodes.min()}…{nodes.max()}, but the mesh has "
                f"{len(points)} nodes (counted from 0)"
            )
        blocks.append((kind, nodes, start + np.arange(len(nodes))))
        start += len(nodes)
        dims.add(CELL_TYPES[kind].dim)
    if not start:
        raise InputError(
            "the mesh has no cells: give triangles, quadrilaterals, tetrahedra or hexahedra"
        )
    if len(dims) > 1:
        raise InputError("the mesh mixes planar and solid cells: keep cells of one dimension")
    return blocks, dims.pop()


def _turn_clockwise(points, blocks):
    """Tell whether most planar cells turn clockwise in the frame chosen."""
    area = 0.0
    for _, nodes, _ in blocks:
        x = points[nodes]
        y = np.roll(x, -1, axis=1)
        area += np.sign((x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]).sum(axis=1)).sum()
    return area < 0


def _choice(what, value, options):
    if value not in options:
        raise InputError(f"{what} {value!r} is unknown: choose one of {', '.join(options)}")


@dataclass(frozen=True)
class _Setting:
    """All of a problem but its displacements."""

    law: Kinematics
    unknowns: Unknowns
    reaction: np.ndarray  # (n_nodes,) bool
    labels: np.ndarray | None
    noise: float | None
    refine: int | None
    element: str


def _setting(
    frame, known, *, labels, reaction_nodes, method, kinematics="small-strain", plane="strain",
    unknowns="lambda-mu", poisson_ratio=None, grouping="cell", noise=None, refine=None,
    reference_label=None, element="locking-free",
):  # fmt: skip
    """Check every choice; raise InputError for one that cannot be."""
    mesh = frame.mesh
    _choice("method", method, METHODS)
    _choice("kinematics", kinematics, KINEMATICS)
    _choice("plane", plane, ("strain", "stress"))
    _choice("unknowns", unknowns, ("lambda-mu", "young"))
    _choice("grouping", grouping, ("cell", "label"))
    _choice("element", element, ("locking-free", "linear"))
    plane_stress = plane == "stress" and mesh.dim == 2
    if plane_stress and kinematics != "small-strain":
        raise InputError(
            "plane stress is linear in the unknowns for small strain only: choose kinematics "
            "'small-strain' or plane 'strain'"
        )
    if unknowns == "young":
        if poisson_ratio is None:
            raise InputError("unknowns 'young' need Poisson's ratio of the unknown cells")
        check_material(1.0, poisson_ratio, "the unknown cells")
    if labels is not None:
        labels = np.asarray(labels)
        if labels.shape != (mesh.n_cells,):
            raise InputError(f"labels: {labels.shape} values for {mesh.n_cells} cells")
    elif grouping == "label":
        raise InputError("grouping by label needs the label of every cell")
    if reference_label is not None and (labels is None or reference_label not in labels):
        raise InputError(f"the reference label {reference_label} does not occur in the mesh")
    young, poisson = _known(known, labels, mesh.n_cells)
    made = make_unknowns(
        young, poisson, plane_stress=plane_stress,
        poisson_ratio=poisson_ratio if unknowns == "young" else None,
        labels=labels if grouping == "label" else None,
    )  # fmt: skip
    reaction = np.zeros(mesh.n_nodes, bool)
    if reaction_nodes is not None:
        reaction = np.asarray(reaction_nodes).astype(bool)
        if reaction.shape != (mesh.n_nodes,):
            raise InputError(f"reaction nodes: {reaction.shape} values for {mesh.n_nodes} nodes")
    if noise is not None and not (np.isfinite(noise) and noise > 0):
        raise InputError(f"noise is {noise:g}, it must be a positive length, or left out")
    if refine not in (None, 1, 4, 16):
        raise InputError(f"refine is {refine!r}, it must be 1, 4 or 16 sub-cells per cell")
    return _Setting(KINEMATICS[kinematics], made, reaction, labels, noise, refine, element)


def _problem(frame, setting, displacements, information):
    u = _displacements(frame, displacements)
    metric = _information(frame, information, u)
    if metric is not None and setting.noise is not None:
        frame.notes.append(
            "the noise given was not used: the displacement information says how large the error "
            "of every displacement is, up to one factor, which is estimated"
        )
    errors = DisplacementNoise(u, metric, setting.noise if metric is None else None)
    return Problem(
        frame.mesh, setting.law, u, setting.unknowns, setting.reaction, errors, setting.refine,
        setting.element, setting.labels,
    )  # fmt: skip


def _displacements(frame, displacements):
    u = np.asarray(displacements, float)
    if u.ndim == 2:
        u = u[None]
    if u.ndim != 3 or u.shape[1] != frame.mesh.n_nodes or len(u) == 0:
        raise InputError(
            f"displacements must have shape (trials, {frame.mesh.n_nodes} nodes, components), "
            f"these have {u.shape}"
        )
    bad = np.argwhere(~np.isfinite(u).all(axis=2))
    if len(bad):
        raise InputError(
            f"the displacement of trial {bad[0, 0] + 1} is not a finite number at {len(bad)} "
            f"node(s), the first is node {bad[0, 1]}: register again, or cut those cells off"
        )
    u = frame.to_plane(u)
    still = np.flatnonzero(np.abs(u).max(axis=(1, 2)) == 0)
    if len(still):
        raise InputError(
            f"trial {still[0] + 1} has no displacement at all: is the rest image its pushed image?"
        )
    return u


def _known(known, labels, n_cells):
    if isinstance(known, Mapping):
        young, poisson = np.full(n_cells, np.nan), np.full(n_cells, np.nan)
        if known and labels is None:
            raise InputError("known materials are given by label, but the cells have no labels")
        for label, (E, nu) in known.items():
            E, nu = check_material(E, nu, f"known label {label}")
            here = labels == label
            if not here.any():
                raise InputError(
                    f"known label {label} does not occur in the mesh, its labels are "
                    f"{', '.join(str(v) for v in np.unique(labels)[:20])}"
                )
            young[here], poisson[here] = E, nu
        return young, poisson
    known = np.asarray(known, float)
    if known.shape != (n_cells, 2):
        raise InputError(f"known materials: shape {known.shape}, expected ({n_cells}, 2) for E, ν")
    young, poisson = known.T
    half = np.flatnonzero(np.isnan(young) != np.isnan(poisson))
    if len(half):
        missing = "Young's modulus" if np.isnan(young[half[0]]) else "Poisson's ratio"
        raise InputError(
            f"{len(half)} known cell(s), the first is cell {half[0]}, have no {missing}: give both "
            "constants of a known cell, and NaN for both where it is not known"
        )
    good = np.isfinite(young) & (young > 0) & (poisson > -1) & (poisson < 0.5)
    bad = np.flatnonzero(~np.isnan(young) & ~good)
    if len(bad):
        check_material(*known[bad[0]], f"known cell {bad[0]}")
    return young, poisson


def _information(frame, information, u):
    if information is None:
        return None
    metric = np.asarray(information, float)
    if metric.ndim != 4 or metric.shape[:2] != u.shape[:2]:
        raise InputError(
            f"information must have shape (trials, nodes, d, d), this has {metric.shape}"
        )
    if metric.shape[2:] not in {(frame.mesh.dim,) * 2, (frame.world_dim,) * 2, (3, 3)}:
        raise InputError(
            f"information of {metric.shape[2]}×{metric.shape[3]} components per node for a mesh of "
            f"{frame.mesh.dim} dimensions"
        )
    if not np.isfinite(metric).all():
        raise InputError("the displacement information has values that are not finite numbers")
    metric = frame.tensors_to_plane(metric)
    if metric.max() <= 0:
        raise InputError(
            "the displacement information is zero everywhere: the rest image has no texture"
        )
    return metric


def _check_trials(problem, unknowns, grouping):
    """Return the warnings that the input alone calls for."""
    mesh, u, warnings = problem.mesh, problem.displacements, []
    flat = u.reshape(len(u), -1)
    flat = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    if len(u) > 1 and np.linalg.svd(flat, compute_uv=False)[-1] < 1e-2:
        warnings.append(
            "the trials are (nearly) proportional to each other and count as fewer: push in "
            "different directions"
        )
    per_cell = grouping == "cell" and unknowns == "lambda-mu"
    if mesh.dim == 3 and per_cell and len(u) < 4:
        warnings.append(
            f"{len(u)} trials in 3-D leave λ and μ of single cells undetermined in places: use "
            "four or more, or unknowns 'young'"
        )
    known = ~np.isnan(problem.unknowns.lam_known) & problem.unknowns.known
    lam, mu = problem.unknowns.lam_known[known], problem.unknowns.mu_known[known]
    if unknowns == "lambda-mu" and np.median(lam / (2 * (lam + mu))) > 0.45:
        warnings.append(
            "ν of the known material is near 0.5, where λ is barely visible in displacements: "
            "unknowns 'young' with a fixed ν are better determined"
        )
    strain = max(
        float(np.quantile(np.abs(block.gradient(v)).max(axis=(1, 2, 3)), 0.9))
        for block in mesh.blocks
        for v in u
    )
    if problem.law.linear and strain > 0.02:
        warnings.append(
            f"displacement gradients reach {strain:.0%} and small-strain kinematics are good to "
            "about 2 %: if the bodies were really pushed this far, choose 'neo-hookean'"
        )
    return warnings


def _check_equations(mesh, setting, n_trials, method):
    """Warn of fewer equations than unknowns; too few for the exact methods raise."""
    unknowns = setting.unknowns
    touched = (mesh.node_cells @ (~unknowns.known).astype(float) > 0) & ~setting.reaction
    equations = int(touched.sum()) * mesh.dim * n_trials
    if equations >= unknowns.n_params:
        return []
    sentence = (
        f"there are fewer equations ({equations}: {touched.sum()} free nodes × {mesh.dim} "
        f"components × {n_trials} trials) than unknowns ({unknowns.n_params})"
    )
    if method in ("sequential", "global") and equations < 0.8 * unknowns.n_params:
        raise InputError(
            f"{sentence}: add trials, choose unknowns 'young', group by label, or use method "
            "'regularized'"
        )
    return [f"{sentence}: some cells cannot be determined from the data alone"]


def _result(problem, estimate, plane_stress, warnings) -> tuple[IdentificationResult, CellErrors]:
    lam, mu = estimate.lam.copy(), estimate.mu.copy()
    lam_errors, mu_errors = estimate.lam_errors, estimate.mu_errors
    known = problem.unknowns.known
    if plane_stress:
        with np.errstate(divide="ignore", invalid="ignore"):
            gap = 2 * mu - lam
            lam_errors = (
                4 * (mu**2 / gap**2)[:, None] * lam_errors
                - 2 * (lam**2 / gap**2)[:, None] * mu_errors
            )
        lam = lambda_from_plane_stress(lam, mu)
    errors = cell_errors(
        lam, mu, *(np.where(known[:, None], 0.0, e) for e in (lam_errors, mu_errors))
    )
    lam_std, mu_std = errors.std("Lambda"), errors.std("Mu")
    status = np.full(len(mu), Status.IDENTIFIED, np.uint8)
    status[~admissible(lam, mu)] = Status.OUT_OF_RANGE
    with np.errstate(invalid="ignore"):
        lost = ~(np.isfinite(lam) & np.isfinite(mu) & (mu_std < np.abs(mu)))
        # λ of a material like cork is zero, and then its error is measured by μ
        lost |= ~(lam_std < np.maximum(np.abs(lam), NEGLIGIBLE_LAMBDA * np.abs(mu)))
    status[lost | ~_reached(problem)] = Status.NOT_DETERMINED
    status[known] = Status.KNOWN
    residuals = _residuals(problem, estimate)
    none = status == Status.NOT_DETERMINED
    young, poisson = young_from_lame(lam, mu)
    young_std, poisson_std = errors.std("YoungModulus"), errors.std("PoissonRatio")
    for array in (lam, mu, lam_std, mu_std, young, poisson, young_std, poisson_std):
        array[none] = np.nan
    order = np.where(none, -1, estimate.order).astype(np.int32)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = (mu_std / np.abs(mu))[~known & ~none]
    typical = float(np.median(error)) if error.size else None
    warnings = warnings + estimate.warnings + _found_warnings(status, known, typical)
    counts = {one.name.lower(): int((status == one).sum()) for one in Status}
    report = {**estimate.report, "cells": counts, "typical_error": typical, "warnings": warnings}
    result = IdentificationResult(
        lam, mu, young, poisson, lam_std, mu_std, young_std, poisson_std, status, order,
        residuals, report,
    )  # fmt: skip
    return result, errors


def _reached(problem):
    """Tell which cells a chain of balance equations ties to the known ones. (n_cells,) bool

    Beyond that the data have no scale: what a fit shows there is its prior.
    """
    unknowns, mesh = problem.unknowns, problem.mesh
    vertex = np.where(unknowns.known, unknowns.n_groups, unknowns.group)  # known cells are one
    free = mesh.node_cells[~problem.reaction].tocoo()
    n_rows, n = free.shape[0], unknowns.n_groups + 1
    edges = sp.coo_matrix(
        (np.ones(free.nnz, bool), (free.row, n_rows + vertex[free.col])), (n_rows + n,) * 2
    )
    piece = csgraph.connected_components(edges, directed=False)[1][n_rows:]
    return piece[vertex] == piece[-1]


def _found_warnings(status, known, typical):
    warnings, n = [], int((~known).sum())
    lost = int((status == Status.NOT_DETERMINED).sum())
    out = int((status == Status.OUT_OF_RANGE).sum())
    if lost:
        warnings.append(
            f"{lost} of {n} unknown cells are not determined by these data (Status 0, no value)"
        )
    if typical is not None and typical > 0.3:
        warnings.append(
            f"the typical error of μ is {typical:.0%} of its value: the map is mostly noise; use "
            "method 'regularized', larger pushes or better images"
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
    unknown_here = mesh.node_cells @ missing.astype(float) > 0
    residuals = np.stack(
        [internal_forces(mesh, problem.law, u, lam, mu) for u in problem.displacements]
    )
    residuals[:, problem.reaction] = 0
    residuals[:, unknown_here & ~problem.reaction] = np.nan
    return residuals
