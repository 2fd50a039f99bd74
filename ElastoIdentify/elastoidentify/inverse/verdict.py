"""May this map be trusted? One sentence, from what the fit knows of itself."""

from .inverted import MOST
from .observations import CONTRADICTED
from .ratio_checks import contradicts, reason, reason_of_spread, spreads_too_much

NOISE_FACTOR = 1.6
"""Found over stated noise from which the model is in doubt.

Sound maps of image phantoms have 0.6 to 1.4, maps under a wrong assumption (slip, plane, ν, a cut
border) 2.2 to 8.9.
"""

SOME_MISFIT, MUCH_MISFIT = 0.15, 0.4
"""Shares of the tissue that the model does not fit: of which chance makes less, and of which the
rest of the map cannot be better."""

ASSUMED = (
    "so something that is assumed is not so: the pad may slip, the tissue may move out of the "
    "imaged plane, Poisson's ratio may be wrong, or something may push at a border"
)

TRUST, CARE, DISTRUST = "trust", "trust with care", "do not trust"


def judge(report: dict, informed: bool, one_direction: bool) -> dict:
    """Return the verdict on a map.

    Parameters
    ----------
    report : dict
        Of the identification: method, grouping, noise_scale, noise_given, misfit, mesh_error,
        cells, typical_error, lost_trials, cut_nodes, inverted_cells, nodes_astray,
        patch_astray, imbalance, large_push, model_misfit, structure, smallest_visible.
    informed : bool
        The displacements came with their information.
    one_direction : bool
        All pushes are proportional to each other.

    Returns
    -------
    dict
        ``level`` (one of "trust", "trust with care", "do not trust"), ``sentence`` for a
        radiologist, ``reasons`` (list of sentences), ``noise_factor`` (found over stated noise, or
        None where nothing was stated), ``nothing_found`` (the sentence that says that a map of
        cells shows nothing but noise, "" where it shows more, or is none of cells).
    """
    bad, doubtful = [], []
    factor = noise_factor(report, informed)
    coarse = factor is not None and NOISE_FACTOR < factor <= _of_the_mesh(report)
    if coarse:
        doubtful.append(
            f"the displacements are more exact than the cells, whose own error is "
            f"{report['mesh_error']:.2g} times what is stated of the displacements, which hides "
            "whether the model fits: take smaller cells"
        )
    elif factor is not None and factor > NOISE_FACTOR:
        bad.append(
            f"the displacements miss the balance of forces by {factor:.2g} times what their stated "
            f"noise explains, {ASSUMED}; try a standard deviation of Poisson's ratio, slip, a "
            "stretch out of the plane (out_of_plane_std 0.01), plane stress, or reaction nodes at "
            "that border"
        )
    imbalance = report.get("imbalance")
    if imbalance is not None and imbalance > CONTRADICTED:
        bad.append(
            f"the displacements miss the balance of forces by {imbalance:.2g} times what the noise "
            f"that was given, or that the known cells show, explains, {ASSUMED}, or nodes were "
            "lost; take method 'regularized', which tells more"
        )
    cells = report["cells"]
    unknown = sum(cells.values()) - cells["known"]
    open_share = cells["not_determined"] / max(unknown, 1)
    if open_share == 1:
        bad.append(
            "nothing could be determined; for a nearly incompressible tissue try unknowns 'young' "
            "with Poisson's ratio 0.45 and its standard deviation 0.05"
        )
    elif open_share > 0.3:
        doubtful.append(f"{open_share:.0%} of the unknown cells are not determined")
    if cells["out_of_range"] > 0.02 * unknown:
        bad.append(
            f"{cells['out_of_range'] / unknown:.0%} of the cells came out with values that no "
            "material has"
        )
    typical = report.get("typical_error")
    if typical is not None and typical > 0.3:
        bad.append(f"the typical error of a cell is {typical:.0%}: the map is mostly noise")
    inverted_share = len(report.get("inverted_cells", ())) / sum(cells.values())
    if inverted_share:
        (bad if inverted_share > MOST else doubtful).append(
            f"the displacements turn {len(report['inverted_cells'])} cells inside out: the "
            "registration was lost there"
        )
    if report.get("nodes_astray"):
        nodes = len(report["nodes_astray"])
        doubtful.append(
            f"the displacements of {nodes} node{'s' if nodes > 1 else ''} were not believed: the "
            "registration was lost there"
        )
    patch = report.get("patch_astray")
    if patch:
        bad.append(
            f"{patch['nodes']} displacements around ({_place(patch['centre'])}) are off by up to "
            f"{patch['off']:.2g} from what an elastic body does: the registration was lost there, "
            "or something slips"
        )
    local = report.get("model_misfit")
    if local and local["share"] > SOME_MISFIT:
        much = local["share"] > MUCH_MISFIT and not coarse
        (bad if much else doubtful).append(_where(local))
    for row in report.get("poisson_checks", ()):
        if contradicts(row):
            (doubtful if row["known"] else bad).append(reason(row))
        elif spreads_too_much(row):
            doubtful.append(reason_of_spread(row))
    if one_direction and report["grouping"] == "cell":
        doubtful.append(
            "all pushes have one direction, which cannot tell a stiff cell from the path of the "
            "force: read labels, not cells, or push from another side"
        )
    if report["large_push"]:
        doubtful.append("the push is too large for small-strain kinematics: take neo-hookean")
    if report["cut_nodes"]:
        doubtful.append("the mesh was cut")
    if report["lost_trials"]:
        doubtful.append("a trial was left out")
    # of a map without a value nothing can be said, not that it is flat either
    nothing = _nothing(report.get("structure")) if open_share < 1 else ""
    seen = report.get("smallest_visible")
    if nothing and seen and seen["typical"] is None:
        doubtful.append("it would hardly show a lesion, of whatever size")
    return _said(bad, doubtful, factor, nothing)


def _of_the_mesh(report: dict) -> float:
    """Return found over stated noise up to which the cells' own error may be the cause."""
    return NOISE_FACTOR * (1 + (report.get("mesh_error") or 0.0) ** 2) ** 0.5


def _nothing(structure: dict | None) -> str:
    """Say that a map of cells shows nothing but noise, "" where it shows more or nothing tells."""
    if not structure:
        return ""
    if structure["apart"] < structure["noise"]:
        return (
            "Nothing but noise was found: the tissue is equally stiff everywhere, as far as these "
            "images tell."
        )
    if structure["within"] is not None and structure["within"] < structure["noise"]:
        return (
            "Within the labels nothing but noise was found: they differ from each other, and each "
            "is equally stiff everywhere, as far as these images tell."
        )
    return ""


def doubted(verdict: dict, reason: str) -> dict:
    """Return a verdict with one more reason for care, the first of all."""
    reasons = [reason[0].lower() + reason[1:], *verdict["reasons"]]
    bad = verdict["level"] == DISTRUST
    both = (reasons, []) if bad else ([], reasons)
    return _said(*both, verdict["noise_factor"], verdict["nothing_found"])


def _place(centre) -> str:
    return ", ".join(f"{x:.3g}" for x in centre)


def _where(local) -> str:
    return (
        f"the model does not fit in {local['share']:.0%} of the tissue, most of all around "
        f"({_place(local['centre'])}), where its stress is off by some {local['stress']:.0%} "
        "(ModelMisfit)"
    )


def noise_factor(report: dict, informed: bool) -> float | None:
    """Return the noise found over the noise stated; None where nothing was stated."""
    scale = report.get("noise_scale")
    if report.get("noise_given"):
        found = report.get("noise_found")
        return None if found is None or not scale else float(found / scale)
    return scale if informed and scale is not None else None


def _said(bad, doubtful, factor, nothing) -> dict:
    level = DISTRUST if bad else CARE if doubtful else TRUST
    start = {
        TRUST: "Trust this map, each value within its stated error",
        CARE: "Trust this map with care",
        DISTRUST: "Do not trust this map",
    }[level]
    reasons = bad + doubtful
    sentence = f"{start}: {'; '.join(reasons)}." if reasons else f"{start}."
    return {
        "level": level,
        "sentence": f"{sentence} {nothing}".strip(),
        "reasons": reasons,
        "noise_factor": factor,
        "nothing_found": nothing,
    }
