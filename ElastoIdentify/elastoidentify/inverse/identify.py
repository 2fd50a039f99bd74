"""Identification of the Lamé constants: one entry point over all methods."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..fem.constitutive import KINEMATICS, Kinematics, NeoHookeanPlaneStress
from ..fem.mesh import Mesh
from ..progress import Progress, silent
from ..study import check_material
from . import astray, border, motion
from .balance_system import BalanceSystem
from .border import Frame
from .conditions import conditions, contact_report
from .inverted import folded, may_be_mended, mended
from .methods import METHODS
from .model_misfit import summary
from .observations import DisplacementNoise, scale_from_known_cells
from .parameterization import Unknowns, make_unknowns
from .poisson import free as free_ratio
from .problem import Astray, Problem
from .ratio_checks import mean_strains
from .result import IdentificationResult, result_of
from .statistics import core_of, label_statistics
from .verdict import judge

FAR = 10.0  # times the noise given: what the data may show before it is said
LARGE_GRADIENT = 0.02  # of displacements: what small strain is good to
WIDEST_RATIO = 0.25  # standard deviation of ν: wider, it would reach past −1
FEW_EQUATIONS = 4  # of which not even a factor of ten can be read


def identify(
    points: np.ndarray,
    cells: np.ndarray | Sequence[tuple[str, np.ndarray]],
    displacements: np.ndarray,
    known: Mapping[int, tuple[float, float]] | np.ndarray,
    *,
    labels: np.ndarray | None = None,
    reaction_nodes: np.ndarray | None = None,
    outer_border: np.ndarray | None = None,
    slip: Sequence[tuple[int, int]] = (),
    method: str = "auto",
    kinematics: str = "small-strain",
    plane: str = "strain",
    unknowns: str = "lambda-mu",
    poisson_ratio: float | None = None,
    poisson_std: float | None = None,
    out_of_plane: float | Sequence[float] = (),
    out_of_plane_std: float | None = None,
    grouping: str = "cell",
    information: np.ndarray | None = None,
    noise: float | None = None,
    refine: int | None = None,
    reference_label: int | None = None,
    element: str = "locking-free",
    look_at: Sequence[float] | None = None,
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
    reaction_nodes : (n_nodes,), optional
        1 where an outside body may push: no balance equation there. 2 where it may along the
        normal only: the tissue slides on it without friction.
    outer_border : (n_nodes,) bool, optional
        True for the nodes of the body's own border. Where the mesh ends and this is False it was
        cut (by Clip, say): what lies beyond may push, so those nodes count as reaction nodes.
    slip : sequence of (label, label)
        Pairs of labels that slide on each other without friction: only normal traction is passed
        on. Along their interface each has nodes of its own, at the same places.
    method : "auto", "sequential", "global", "regularized"
    kinematics : "small-strain", "st-venant-kirchhoff", "neo-hookean"
    plane : "strain", "stress" (2-D only)
    unknowns : "lambda-mu", or "young" with `poisson_ratio`
    poisson_std : float, optional
        Standard deviation of `poisson_ratio`: then ν is estimated with the map, one per label, by
        the regularized method. None or 0: ν is what it was said to be.
    out_of_plane : sequence of float, optional
        Stretch across the plane (length ratio − 1), one per trial, or one for all; for planar
        meshes in plane strain, which is a stretch of 0.
    out_of_plane_std : float, optional
        Its standard deviation: then it is estimated with the map, one per trial, by the regularized
        method. None or 0: it is what it was said to be.
    grouping : "cell", "label"
    information : (n_trials, n_nodes, d, d), optional
        Inverse covariance of the measured displacements (1/length²). It says that they come from
        images: a node's errors in two trials are then correlated by ½, as the rest image is one.
    noise : float, optional
        Standard deviation of a displacement component; estimated when not given.
    refine : int, optional
        1, 4 or 16: sub-cells per cell of the forward problem of the regularized method.
    element : "locking-free", "linear"
        Cells of the regularized method's forward problem: with the dilatation averaged over patches
        of neighbours, right near incompressibility, or plain ones.
    reference_label : int, optional
        Label to which the ratios of ``result.statistics`` refer; the largest unknown one.
    look_at : (2,) or (3,), optional
        A place in the points' coordinates: ``report["smallest_visible"]["here"]`` says how small a
        lesion of twice the stiffness a map of cells would show there.
    progress : callable, optional

    Raises
    ------
    InputError
        One line: what is wrong, where, how to mend it.
    """
    progress = progress or silent
    frame = Frame(points, cells)
    u = border.displacements(frame, displacements)
    labels = border.cell_labels(labels, frame.mesh.n_cells)
    slip = border.slip_pairs(slip, labels)
    frame.close_seams(u, labels, slip)
    setting = _setting(
        frame, known, labels=labels, reaction_nodes=reaction_nodes, outer_border=outer_border,
        slip=slip, method=method, kinematics=kinematics, plane=plane, unknowns=unknowns,
        poisson_ratio=poisson_ratio, poisson_std=poisson_std, grouping=grouping, noise=noise,
        refine=refine, reference_label=reference_label, element=element,
    )  # fmt: skip
    stretch = border.stretches(
        out_of_plane, out_of_plane_std, len(u), frame.mesh.dim, plane, method
    )
    metric = border.information(frame, information, len(u))
    lost = border.lost_trials(frame, metric, len(u))
    trials = 1 + np.flatnonzero(~lost)
    metric = None if metric is None else metric[~lost]
    problem = _problem(frame, setting, u[~lost], metric, trials, method)
    if look_at is not None:
        problem = replace(problem, look_at=frame.place(look_at))
    if stretch is not None:
        here = replace(stretch, centre=stretch.centre[~lost], trials=trials)
        problem = replace(problem, stretch=here)
    labels = setting.labels
    apart = _apart(problem.mesh, problem.unknowns, problem.conditions.pairs)
    gradient = _typical_gradient(problem)
    large_push = bool(problem.law.linear and gradient > LARGE_GRADIENT)
    warnings = frame.notes + _check_trials(problem, unknowns, grouping, gradient, large_push)
    warnings += _check_equations(problem.mesh, setting, len(trials), method)
    contact, said = contact_report(problem.conditions, problem.displacements)
    warnings += said
    progress(0.0, "force balance")
    if apart.any():
        warnings.append(
            f"{apart.sum()} cells, the first is cell {np.flatnonzero(apart)[0]}, share no node, "
            "directly or through others, with a known cell: nothing can be said about them"
        )
        estimate = METHODS[method](_without(problem, setting, apart), progress)
        estimate = _spread(problem.mesh, estimate, ~apart)
    else:
        estimate = METHODS[method](problem, progress)
    far = estimate.astray or astray.nothing(problem)
    if far.lost.any():
        warnings += astray.sentences(trials, far.lost, frame.nodes)
        problem = astray.without(problem, far.lost > 0)
    warnings += _check_noise(problem, estimate)
    result, errors = result_of(problem, estimate, plane == "stress", warnings)
    labels = np.zeros(problem.mesh.n_cells, int) if labels is None else labels
    result.report["labels"] = label_statistics(
        labels, problem.mesh.volumes, core_of(problem.mesh.node_cells, labels),
        result.status, result.lam, result.mu, errors, reference_label,
    )  # fmt: skip
    residuals = np.full((len(u), *result.residuals.shape[1:]), np.nan)
    residuals[~lost] = result.residuals
    result.residuals = frame.to_world(residuals)
    result.report |= {
        "kinematics": kinematics, "unknowns": unknowns, "grouping": grouping,
        "strains": mean_strains(problem),
        "requested_method": method, "trials": len(trials),
        "lost_trials": (1 + np.flatnonzero(lost)).tolist(), "cut_nodes": setting.cut_nodes,
        "large_push": large_push, "contact": contact,
        "inverted_cells": np.flatnonzero(problem.inverted).tolist(),
        "nodes_astray": [[int(trials[t]), int(frame.nodes[n])] for t, n in np.argwhere(far.lost)],
        "patch_astray": astray.patch(far.patch, border.numbers(points, "points")[frame.nodes]),
        "plane": plane if problem.mesh.dim == 2 else None, "dimension": problem.mesh.dim,
        "model_misfit": estimate.misfit and summary(
            problem.mesh, frame.centres(points), problem.unknowns.known, estimate.misfit
        ),
        "model_misfit_missing": _why_no_misfit(estimate),
    }  # fmt: skip
    result.report["verdict"] = judge(
        result.report, problem.noise.information is not None, problem.one_direction
    )
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
    options = {
        "method": "auto", "labels": None, "reaction_nodes": None, "outer_border": None, "slip": ()
    } | options  # fmt: skip
    frame = Frame(points, cells)
    stretch = (options.pop(name, default)
               for name, default in (("out_of_plane", ()), ("out_of_plane_std", None)))  # fmt: skip
    plane, method = options.get("plane", "strain"), options["method"]
    border.stretches(*stretch, n_trials, frame.mesh.dim, plane, method)
    setting = _setting(frame, known, **options)
    mesh, pairs = frame.mesh, _conditions(frame.mesh, setting).pairs
    apart, (_, piece) = _apart(mesh, setting.unknowns, pairs), border.pieces_of(mesh, pairs)
    pushed = np.isin(piece, piece[mesh.node_cells.T @ setting.reaction.astype(float) > 0])
    if not (pushed & ~apart & ~setting.unknowns.known).any():
        raise InputError(
            "nothing touches the body: no node is at a rigid label, in a reaction box or at the "
            "image's border, so nothing can push it; name the indenter and the floor as rigid "
            "labels, or draw reaction boxes where they touch"
        )
    _check_equations(mesh, setting, n_trials, options["method"])


@dataclass(frozen=True)
class _Setting:
    """All of a problem but its displacements."""

    law: Kinematics
    unknowns: Unknowns
    make_unknowns: Callable[[np.ndarray], Unknowns]  # of some cells, (n_cells,) bool
    reaction: np.ndarray  # (n_nodes,) bool
    cut_nodes: int  # of them, where the mesh ends though the body goes on
    labels: np.ndarray | None
    slip: list
    sliding: np.ndarray  # (n_nodes,) bool: reaction nodes on which an outside body slides
    noise: float | None
    refine: int | None
    element: str


def _setting(
    frame, known, *, labels, reaction_nodes, outer_border, slip, method, kinematics="small-strain",
    plane="strain", unknowns="lambda-mu", poisson_ratio=None, poisson_std=None, grouping="cell",
    noise=None, refine=None, reference_label=None, element="locking-free",
):  # fmt: skip
    """Check every choice; raise InputError for one that cannot be."""
    mesh = frame.mesh
    border.choice("method", method, METHODS)
    border.choice("kinematics", kinematics, KINEMATICS)
    border.choice("plane", plane, ("strain", "stress"))
    border.choice("unknowns", unknowns, ("lambda-mu", "young"))
    border.choice("grouping", grouping, ("cell", "label"))
    border.choice("element", element, ("locking-free", "linear"))
    plane_stress = plane == "stress" and mesh.dim == 2
    if plane_stress and kinematics != "small-strain":
        _check_plane_stress(kinematics, unknowns, poisson_std)
    if unknowns == "young":
        if poisson_ratio is None:
            raise InputError("unknowns 'young' need Poisson's ratio of the unknown cells")
        check_material(1.0, poisson_ratio, "the unknown cells")
    _check_poisson_std(poisson_std, unknowns, method)
    labels = border.cell_labels(labels, mesh.n_cells)
    if labels is None and grouping == "label":
        raise InputError("grouping by label needs the label of every cell")
    if reference_label is not None and (labels is None or reference_label not in labels):
        raise InputError(f"the reference label {reference_label} does not occur in the mesh")
    slip = border.slip_pairs(slip, labels)
    border.check_slip(mesh, labels, slip)
    young, poisson = border.known_materials(known, labels, mesh.n_cells)

    def unknowns_of(cells):
        here = None if labels is None else labels[cells]
        made = make_unknowns(
            young[cells], poisson[cells], plane_stress=plane_stress,
            poisson_ratio=poisson_ratio if unknowns == "young" else None,
            labels=here if grouping == "label" else None,
        )  # fmt: skip
        if not poisson_std:
            return made
        return free_ratio(made, poisson_ratio, poisson_std, here)

    law = KINEMATICS[kinematics]
    if plane_stress and not law.linear:
        law = NeoHookeanPlaneStress(np.where(np.isnan(poisson), poisson_ratio, poisson))
    marks = border.reaction_nodes(reaction_nodes, frame.n_given)
    reaction = frame.anywhere(marks != 0)
    sliding = reaction & ~frame.anywhere((marks != 0) & (marks != border.SLIDES))
    cut = _cut_nodes(frame, outer_border, reaction)
    if noise is not None and not (np.isfinite(noise) and noise > 0):
        raise InputError(f"noise is {noise:g}, it must be a positive length, or left out")
    if refine not in (None, 1, 4, 16):
        raise InputError(f"refine is {refine!r}, it must be 1, 4 or 16 sub-cells per cell")
    made = unknowns_of(np.full(mesh.n_cells, True))
    return _Setting(
        law, made, unknowns_of, reaction | cut, int(cut.sum()), labels, slip,
        sliding, noise, refine, element,
    )  # fmt: skip


def _check_plane_stress(kinematics, unknowns, poisson_std):
    """Refuse what would make the forces of a thin sheet no longer linear in the unknowns."""
    if kinematics == "neo-hookean" and unknowns == "young" and not poisson_std:
        return
    raise InputError(
        "plane stress is linear in the unknowns for small strain, and for 'neo-hookean' where "
        "Poisson's ratio is given exactly (unknowns 'young', no standard deviation of it): choose "
        "one of them, or plane 'strain'"
    )


def _check_poisson_std(std, unknowns, method):
    """Refuse a width of Poisson's ratio that means nothing, or that nothing would use."""
    if std is None or std == 0:
        return
    if not 0 < std <= WIDEST_RATIO:
        raise InputError(
            f"the standard deviation of Poisson's ratio is {std:g}, it must lie between 0 (ν is "
            f"exactly as given) and {WIDEST_RATIO:g}"
        )
    if unknowns != "young":
        raise InputError(
            "a standard deviation of Poisson's ratio was given, and unknowns 'lambda-mu' leave "
            "Poisson's ratio free without any: choose unknowns 'young', or leave it out"
        )
    if method in ("sequential", "global"):
        raise InputError(
            f"method '{method}' cannot estimate Poisson's ratio together with the map: choose "
            "method 'regularized', or a standard deviation of 0 (ν is exactly as given)"
        )


def _cut_nodes(frame, outer_border, reaction):
    """Tell where the mesh ends though the body goes on. (n_nodes,) bool"""
    mesh = frame.mesh
    if outer_border is None:
        return np.zeros(mesh.n_nodes, bool)
    outer_border = np.asarray(outer_border).astype(bool)
    if outer_border.shape != (frame.n_given,):
        raise InputError(f"outer border: {outer_border.shape} values for {frame.n_given} nodes")
    outer_border = frame.anywhere(outer_border)
    cut = mesh.boundary_nodes & ~outer_border & ~reaction
    if cut.any():
        frame.notes.append(
            f"the mesh was cut: at {np.count_nonzero(cut)} of its border nodes the body goes on; "
            "what lies beyond may push there, so no force balance is asked of them. Cells at the "
            "cut are less certain; identify the whole mesh and cut the map afterwards"
        )
    return cut


def _problem(frame, setting, u, metric, trials, method):
    """The Problem of the trials that are left; their numbers are for what is said about them."""
    border.check_displacements(frame, u, trials)
    given, (u, unbelieved) = u, (frame.to_plane(u[:, frame.nodes]), None)
    errors = _metric(setting.noise, metric, u)
    still = np.array([errors is not None and motion.is_still(frame.mesh.points, v, errors[t])
                      for t, v in enumerate(u)])  # fmt: skip
    frame.notes += motion.still_notes(trials[still])
    frame.notes += motion.order_notes(frame, given[~still], trials[~still])
    inside_out = np.stack([folded(frame.mesh, v) for v in u])
    # the other methods take every displacement as it is
    if may_be_mended(inside_out) and method in ("auto", "regularized"):
        spoiled = mended(frame.mesh, u, inside_out)
        frame.notes += spoiled.sentences(trials)
        u, unbelieved = spoiled.displacements, spoiled.nodes
    frame.notes += motion.size_notes(frame, u[~still], trials[~still])
    frame.notes += motion.folded_notes(frame, u, trials)
    if metric is not None and setting.noise is not None:
        frame.notes.append(
            "the noise given was not used: the displacement information says how large the error "
            "of every displacement is, up to one factor, which is estimated"
        )
    errors = DisplacementNoise(u, metric, setting.noise if metric is None else None, unbelieved)
    return Problem(
        frame.mesh, setting.law, u, setting.unknowns, setting.reaction, errors, setting.refine,
        setting.element, setting.labels, setting.slip, setting.sliding,
        inverted=inside_out.any(axis=0), still=still,
    )  # fmt: skip


def _metric(noise, information, u):
    """Return what is said of the errors of u (t, n, d) as inverse covariances; None: nothing."""
    if information is not None or noise is None:
        return information
    return np.broadcast_to(np.eye(u.shape[2]) / noise**2, (*u.shape, u.shape[2]))


def _conditions(mesh, setting):
    return conditions(mesh, setting.reaction, setting.sliding, setting.labels, setting.slip)


def _apart(mesh, unknowns, pairs):
    """Tell which cells lie in pieces of the mesh without a known cell. (n_cells,) bool"""
    known = unknowns.known
    n_pieces, piece = border.pieces_of(mesh, pairs)
    apart = ~np.isin(piece, piece[known])
    if apart[~known].all():
        raise InputError(
            f"the mesh is in {n_pieces} pieces that share no node, and every unknown cell lies in "
            "one without a known cell, where no force reaches it: leave no gap between the labels "
            "of a segmentation, merge the nodes that neighbouring cells store separately, or name "
            "the labels that slide in slip"
        )
    return apart


def _without(problem, setting, apart):
    """Return the problem without some cells: a fit of loose pieces may fail and takes the rest."""
    keep = ~apart
    number = np.cumsum(keep) - 1
    blocks = [(b.cell.name, b.nodes[keep[b.ids]], number[b.ids[keep[b.ids]]])
              for b in problem.mesh.blocks if keep[b.ids].any()]  # fmt: skip
    nodes = np.unique(np.concatenate([n.ravel() for _, n, _ in blocks]))
    blocks = [(kind, np.searchsorted(nodes, n), ids) for kind, n, ids in blocks]
    u, metric = problem.displacements[:, nodes], problem.noise.information
    return replace(
        problem,
        law=problem.law.of(np.flatnonzero(keep)),
        mesh=Mesh(problem.mesh.points[nodes], blocks),
        displacements=u,
        unknowns=setting.make_unknowns(keep),
        reaction=problem.reaction[nodes],
        noise=DisplacementNoise(
            u,
            None if metric is None else metric[:, nodes],
            problem.noise.scale,
            problem.noise.lost[:, nodes],
        ),
        labels=None if problem.labels is None else problem.labels[keep],
        sliding=problem.sliding[nodes],
    )


def _spread(mesh, estimate, keep):
    """Return the estimate on the mesh, from one at the cells `keep` (n_cells,) bool."""

    def spread(values, fill):
        everywhere = np.full((len(keep), *values.shape[1:]), fill, values.dtype)
        everywhere[keep] = values
        return everywhere

    arrays = {name: spread(getattr(estimate, name), np.nan)
              for name in ("lam", "mu", "lam_errors", "mu_errors")}  # fmt: skip
    misfit = estimate.misfit
    if misfit is not None:
        share, stress = spread(misfit.share, np.nan), spread(misfit.stress, np.nan)
        misfit = replace(misfit, share=share, stress=stress)
    edges = None if estimate.edges is None else np.flatnonzero(keep)[estimate.edges]
    order, far = spread(estimate.order, -1), estimate.astray
    if far is not None:
        nodes = mesh.node_cells @ keep.astype(float) > 0
        far = Astray(*(np.zeros((len(off), mesh.n_nodes)) for off in (far.lost, far.patch)))
        far.lost[:, nodes], far.patch[:, nodes] = estimate.astray.lost, estimate.astray.patch
    return replace(estimate, **arrays, order=order, misfit=misfit, edges=edges, astray=far)


def _check_noise(problem, estimate):
    """Say where the noise given is far below what the data show."""
    given = problem.noise.scale
    if given is None:
        return []
    system = BalanceSystem(
        problem.mesh, problem.law, problem.displacements, problem.unknowns, problem.reaction,
        problem.conditions, problem.laws(),
    )  # fmt: skip
    shown, equations = scale_from_known_cells(system, problem.noise)
    where = "the balance of forces among the known cells"
    if equations < FEW_EQUATIONS or not shown > FAR * given:
        shown = given * np.sqrt(estimate.report.get("misfit", 0.0))
        where = "what the fit leaves of the displacements"
    if not shown > FAR * given:
        return []
    return [
        f"the noise was given as {given:.2g}, but {where} shows about {shown:.2g}: the standard "
        "deviations are too small, and noise is taken for stiffness; leave the noise out to have "
        "it estimated"
    ]


def _check_trials(problem, unknowns, grouping, gradient, large_push):
    """Return the warnings that the input alone calls for."""
    mesh, u, warnings = problem.mesh, problem.displacements, []
    if len(u) > 1 and problem.one_direction:
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
    if large_push:
        warnings.append(
            f"displacement gradients reach {gradient:.0%} and small-strain kinematics are good to "
            "about 2 %: if the bodies were really pushed this far, choose 'neo-hookean'"
        )
    return warnings


def _typical_gradient(problem) -> float:
    """Return the size of displacement gradients that a tenth of the cells exceed."""
    return max(
        float(np.quantile(np.abs(block.gradient(v)).max(axis=(1, 2, 3)), 0.9))
        for block in problem.mesh.blocks
        for v in problem.displacements
    )


def _check_equations(mesh, setting, n_trials, method):
    """Warn of fewer equations than unknowns; too few for the exact methods raise."""
    unknowns = setting.unknowns
    there = _conditions(mesh, setting)
    touched = there.members @ (mesh.node_cells @ (~unknowns.known).astype(float)) > 0
    per_trial = int(touched[there.free_slots // mesh.dim].sum())
    equations, nodes = per_trial * n_trials, int((touched & there.asked).sum())
    if not equations:
        raise InputError(
            "there is no equation: every node of an unknown cell is marked as a reaction node; "
            "mark only those where an outside body may push"
        )
    if equations >= unknowns.n_params:
        return []
    sentence = (
        f"there are fewer equations ({equations}: {nodes} free nodes × {per_trial / nodes:.3g} "
        f"components × {n_trials} trials) than unknowns ({unknowns.n_params})"
    )
    if method in ("sequential", "global") and equations < 0.8 * unknowns.n_params:
        raise InputError(
            f"{sentence}: add trials, choose unknowns 'young', group by label, or use method "
            "'regularized'"
        )
    return [f"{sentence}: some cells cannot be determined from the data alone"]


def _why_no_misfit(estimate):
    """Say why nothing tells where the model does not fit, "" where something does."""
    if estimate.misfit is not None:
        return ""
    if estimate.report["method"] != "regularized":
        return "the regularized method alone can tell"
    return "it takes the covariance of the forces of all nodes, too many in a volume of this size"
