"""Reports as lines for people."""

from ..inverse.verdict import DISTRUST
from .terminal import figure, seconds


def report_lines(report: dict, informed: bool = False, length: str = "mm") -> list[str]:
    """Return what a person should know of an IdentificationReport, without the warnings.

    Parameters
    ----------
    report : dict
    informed : bool
        The displacements came with their information, which the noise is then a multiple of.
    length : str
        Unit of the displacements.
    """
    lines = [verdict_line(report, length)] if "verdict" in report else []
    lines += [
        f"method: {report.get('method')}, {report.get('kinematics')}, "
        f"{_count(report.get('trials'), 'trial')}, unknowns {report.get('unknowns')} per "
        f"{report.get('grouping')}"
    ]
    if report.get("auto"):
        lines.append(f"chosen because: {report['auto']}")
    if report.get("noise_scale") is not None:
        given = bool(report.get("noise_given"))
        size = (
            f"{figure(report['noise_scale'])} × what the images' information predicts"
            if informed and not given
            else f"{figure(report['noise_scale'])} {length} per displacement component"
        )
        lines.append(f"noise: {size} ({'given' if given else 'estimated'})")
    if report.get("prior_weight"):
        weights = ", ".join(figure(weight) for weight in report["prior_weight"])
        lines.append(
            f"prior: weight {weights} chosen by {report.get('prior_rule')}; "
            f"{figure(report.get('effective_parameters'))} effective of "
            f"{report.get('parameters')} parameters"
        )
    if report.get("misfit") is not None:
        lines.append(f"misfit: {figure(report['misfit'])} (1: as large as the noise)")
    if report.get("model_misfit_missing"):
        lines.append(
            f"where the model does not fit: not looked at ({report['model_misfit_missing']}; "
            "ModelMisfit is NaN)"
        )
    if report.get("smallest_visible") and not _said_before(report):
        lines.append(visible_line(report["smallest_visible"], length))
    return lines + explored_lines(report.get("explored"))


def explored_lines(explored: dict | None) -> list[str]:
    """Return what came of other assumptions, a line each; none where none were tried."""
    if not explored:
        return []
    return [f"other assumptions: {explored['sentence']}", *map(_tried, explored["rows"])]


def _tried(row: dict) -> str:
    start = f"if {row['words']}"
    if row["refused"]:
        return f"{start}: could not be tried: {row['refused']}"
    name = f" ({row['options']})" if row["options"] else ""
    return (
        f"{start}{name}: {figure(row['noise'])} times the noise, "
        f"evidence {row['evidence']:+.0f}; {row['verdict']}{_figures(row)}"
    )


def _figures(row: dict) -> str:
    """μ of the labels, with their standard errors."""
    start, end = "Mu of label ", ", standard error"
    labels = [key for key in row if key.startswith(start) and not key.endswith(end)]
    said = [
        f"{key.removeprefix(start)}: {figure(row[key])} ± {figure(row[key + end], 2)}"
        for key in labels
    ]
    return f"; μ of label {', '.join(said)}" if said else ""


def verdict_line(report: dict, length: str = "mm") -> str:
    """Return the verdict; of a map that shows nothing, with what it would have shown."""
    sentence = report["verdict"]["sentence"]
    if not _said_before(report):
        return sentence
    seen = visible_line(report["smallest_visible"], length)
    return f"{sentence} {seen[0].upper()}{seen[1:]}."


def _said_before(report):
    """Tell whether the verdict says what could be seen."""
    said = report.get("verdict", {})
    return bool(
        said.get("nothing_found") and said["level"] != DISTRUST and report.get("smallest_visible")
    )


def visible_line(seen: dict, length: str) -> str:
    """Return which lesions this map would show, and so what its silence means."""
    lesion = f"a lesion of {figure(seen['contrast'])} times the stiffness"
    if seen["typical"] is None:
        return f"{lesion} would hardly show, of whatever size: more pushes, less noise"
    worst = (
        "not everywhere" if seen["worst"] is None else f"everywhere from {figure(seen['worst'])}"
    )
    at_worst = f" ({worst})" if seen["worst"] != seen["typical"] else ""
    return f"{lesion} would show from about {figure(seen['typical'])} {length} across{at_worst}"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


def provenance_lines(made: dict) -> list[str]:
    """Return how a result was made, a line per fact."""
    versions = ", ".join(f"{name} {version}" for name, version in made["libraries"].items())
    lines = [
        f"elastoidentify {made['elastoidentify']} (Python {made['python']}, {versions})",
        f"finished {made['finished']}"
        + ("" if made.get("duration_s") is None else f" after {seconds(made['duration_s'])}"),
    ]
    for name, prints in made["inputs"].items():
        several = prints if isinstance(prints, list) else [prints]
        for number, one in enumerate(several, 1):
            title = f"{name} {number}" if len(several) > 1 else name
            lines.append(f"{title}: {one['name'] or 'in memory'}, SHA-256 {one['sha256']}")
    lines += [f"{name}: {_value(value)}" for name, value in made["options"].items()]
    return lines


def _value(value) -> str:
    if isinstance(value, (list, tuple)):
        return "; ".join(_row(row) for row in value) or "none"
    return "none" if value in (None, "") else str(value)


def _row(row) -> str:
    return ", ".join(map(str, row)) if isinstance(row, (list, tuple)) else str(row)
