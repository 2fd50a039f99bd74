"""How much a figure changes when the same subject is measured again.

With s_i² the variance of the K_i repeats of subject i and m_i their mean,

    wSD² = Σ (K_i − 1) s_i² / Σ (K_i − 1)            within-subject variance
    wCV² = Σ (K_i − 1) (s_i / m_i)² / Σ (K_i − 1)     within-subject coefficient of variation
    RC   = 1.96 √2 wSD,    %RC = 1.96 √2 wCV          repeatability coefficient

A change of one subject that is larger than RC is real with 95 % confidence. Sources: D. L. Raunig
et al., Quantitative imaging biomarkers: a review of statistical methods for technical performance
assessment, Stat. Methods Med. Res. 24 (2015) 27–67 (QIBA); J. M. Bland and D. G. Altman,
Measurement error, BMJ 313 (1996) 744, and Statistical methods for assessing agreement, Lancet 327
(1986) 307.
"""

import csv
import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from ..errors import InputError
from ..imaging.io import check_outputs, write_whole
from ..report.table import number
from ..report.terminal import figure, table

FACTOR = 1.96 * 2**0.5
ENOUGH = 35
"""Subjects measured twice that QIBA asks of a test-retest study."""


@dataclass(frozen=True)
class Repeatability:
    """Figures of one label.

    Attributes
    ----------
    label : int
    name : str
    quantity, unit : str
    subjects, measurements : int
        That had a value at least twice, and how many values they had together.
    mean : float
        Of the subjects' means.
    within_sd, rc : float
        wSD and RC, in the unit of the quantity.
    within_cv, rc_percent : float
        wCV and %RC, in per cent.
    rc_percent_high : float
        Upper end of the one-sided 95 % confidence interval of %RC, from χ² of Σ (K_i − 1) degrees
        of freedom.
    bias, low, high : float
        Bland-Altman: mean of the differences (a repeat less the one before it) and bias ± 1.96 of
        their standard deviations.
    """

    label: int
    name: str
    quantity: str
    unit: str
    subjects: int
    measurements: int
    mean: float
    within_sd: float
    rc: float
    within_cv: float
    rc_percent: float
    rc_percent_high: float
    bias: float
    low: float
    high: float


def repeatability(
    repeats: Sequence[Sequence[float]],
    label: int = 0,
    name: str = "",
    quantity: str = "",
    unit: str = "",
) -> Repeatability:
    """Return the figures of one quantity.

    Parameters
    ----------
    repeats : sequence of sequences
        The values of every subject; NaN where a measurement failed. Subjects with fewer than two
        values say nothing, and are left out.
    label, name, quantity, unit
        What it is about.

    Raises
    ------
    InputError
        When no subject was measured twice, or a mean is not positive, so that there is no share
        of it.
    """
    values = [np.asarray(row, float)[np.isfinite(np.asarray(row, float))] for row in repeats]
    values = [row for row in values if len(row) > 1]
    if not values:
        raise InputError(
            f"{name or 'the figure'}: no subject has two values: give at least two results of one"
        )
    free = np.array([len(row) - 1 for row in values])
    means = np.array([row.mean() for row in values])
    variances = np.array([row.var(ddof=1) for row in values])
    if (means <= 0).any():
        raise InputError(
            f"{name or 'the figure'}: a subject's mean is {means.min():g}; a coefficient of "
            "variation is for positive figures"
        )
    within = float(np.sqrt(np.average(variances, weights=free)))
    relative = 100 * float(np.sqrt(np.average(variances / means**2, weights=free)))
    widest = np.sqrt(free.sum() / stats.chi2.ppf(0.05, free.sum()))
    differences = np.concatenate([np.diff(row) for row in values])
    bias = float(differences.mean())
    spread = 1.96 * float(differences.std(ddof=1)) if len(differences) > 1 else float("nan")
    return Repeatability(
        label,
        name,
        quantity,
        unit,
        len(values),
        int(sum(map(len, values))),
        float(means.mean()),
        within,
        FACTOR * within,
        relative,
        FACTOR * relative,
        FACTOR * relative * float(widest),
        bias,
        bias - spread,
        bias + spread,
    )


CORE, MEAN = "Mu core", "Mu mean"


def best_column(subjects: Sequence[Sequence[Sequence[Mapping]]]) -> str:
    """Return the figure that depends least on who segments, of those that every table has.

    ``Mu core`` where all labels that were measured are thick enough to have one, else ``Mu mean``.
    """
    rows = [row for one in subjects for table in one for row in table if not row.get("given")]
    measured = [row for row in rows if np.isfinite(number(row, MEAN))]
    cored = measured and all(np.isfinite(number(row, CORE)) for row in measured)
    return CORE if cored else MEAN


def repeatability_by_label(
    subjects: Sequence[Sequence[Sequence[Mapping]]], column: str = "Mu mean"
) -> tuple[list[Repeatability], dict[int, list[list[float]]], list[str]]:
    """Return the figures of every label.

    Parameters
    ----------
    subjects : sequence (subject) of sequences (measurement) of sequences (row) of mappings
        Rows of the tables of labels, see
        :func:`~elastoidentify.inverse.statistics.label_statistics` or :func:`read_rows`.
    column : str
        Which figure: ``Mu mean``, ``YoungModulus mean``, ``Mu ratio``….

    Returns
    -------
    figures : list of Repeatability
        Of the labels that are not given and were measured twice in some subject.
    values : {label: list (subject) of lists (measurement)}
        What they were computed from, NaN where a measurement lacks the label.
    notes : list of str
        Sentences: labels left out, too few subjects.

    Raises
    ------
    InputError
        Another column, tables in different units, no label that was measured twice.
    """
    tables = [rows for measurements in subjects for rows in measurements]
    if not any(column in row for rows in tables for row in rows):
        names = [key for rows in tables for row in rows for key in row if key.endswith(" mean")]
        raise InputError(
            f"column {column!r}: no table has it; there are {', '.join(dict.fromkeys(names))}"
        )
    units = {str(row.get("unit", "")) for rows in tables for row in rows}
    if len(units) > 1:
        raise InputError(
            f"the tables are in different units ({', '.join(sorted(units))}): make them anew with "
            "one --unit"
        )
    unit = "" if column.split()[0] == "PoissonRatio" or "ratio" in column else units.pop()
    names, given = {}, set()
    for row in (row for rows in tables for row in rows):
        names.setdefault(int(row["label"]), str(row.get("name") or ""))
        if row.get("given"):
            given.add(int(row["label"]))
    found, values, notes = [], {}, []
    for label in sorted(names.keys() - given):
        repeats = [[_of(rows, label, column) for rows in one] for one in subjects]
        name = names[label] or f"label {label}"
        if not any(np.isfinite(row).sum() > 1 for row in map(np.array, repeats)):
            notes.append(f"{name}: no subject has two values of it, so it is left out")
            continue
        values[label] = repeats
        found.append(repeatability(repeats, label, name, column, unit))
    if not found:
        raise InputError("no label was measured twice: give two or more results of one subject")
    fewest = min(one.subjects for one in found)
    if fewest < ENOUGH:
        notes.append(
            f"{fewest} subject{'s' if fewest > 1 else ''} measured repeatedly: QIBA asks for "
            f"{ENOUGH}; look at the upper end of the interval"
        )
    return found, values, notes


def _of(rows: Sequence[Mapping], label: int, column: str) -> float:
    """Return a label's figure in a table, NaN where it has none."""
    for row in rows:
        if int(row["label"]) == label:
            return number(row, column)
    return float("nan")


def read_rows(path: str | os.PathLike) -> list[dict]:
    """Return the rows of a result's table of labels, from its table (.csv) or its map (.vtu).

    Raises
    ------
    InputError
        No such file, or no table of ours.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.suffix.lower() == ".vtu":
        from .cell_map import read_cell_map

        rows = read_cell_map(path).report.get("labels", [])
    else:
        csv.field_size_limit(1 << 30)  # the provenance is one field
        try:
            with open(path, newline="", encoding="utf-8-sig") as stream:
                rows = list(csv.DictReader(stream))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"{path}: cannot be read as CSV ({error})") from None
    if not rows or "label" not in rows[0]:
        raise InputError(f"{path}: no table of labels; give the --table or the map of a result")
    return [{**row, "given": str(row.get("given")).lower() in ("true", "1")} for row in rows]


def repeatability_text(figures: Sequence[Repeatability]) -> str:
    """Return the figures for people, one line per label."""
    unit = f" ({figures[0].unit})" if figures[0].unit else ""
    header = [
        "label", "subjects", f"{figures[0].quantity}{unit}", "wSD", "RC", "wCV %", "RC %",
        "RC % at most", "bias",
    ]  # fmt: skip
    rows = [
        [
            one.name, str(one.subjects), figure(one.mean), figure(one.within_sd), figure(one.rc),
            figure(one.within_cv), figure(one.rc_percent), figure(one.rc_percent_high),
            figure(one.bias),
        ]
        for one in figures
    ]  # fmt: skip
    return table(header, rows)


def write_repeatability(path: str | os.PathLike, figures: Sequence[Repeatability]) -> None:
    """Write the figures as CSV, a row per label, whole or not at all."""
    import io

    check_outputs([path])
    text = io.StringIO()
    writer = csv.DictWriter(text, list(asdict(figures[0])), lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(one) for one in figures)
    write_whole(Path(path), lambda part: part.write_text(text.getvalue(), encoding="utf-8"))


def draw_bland_altman(
    path: str | os.PathLike,
    figures: Sequence[Repeatability],
    values: Mapping[int, Sequence[Sequence[float]]],
) -> None:
    """Draw differences over means, a panel per label, to a PNG, PDF or SVG file.

    Parameters
    ----------
    figures, values
        Of :func:`repeatability_by_label`.
    """
    from matplotlib.figure import Figure

    check_outputs([path])
    canvas = Figure(figsize=(4.2 * len(figures), 3.8), layout="constrained")
    panels = canvas.subplots(1, len(figures), squeeze=False)[0]
    for axes, one in zip(panels, figures, strict=True):
        _bland_altman(axes, one, values[one.label])
    write_whole(Path(path), lambda part: canvas.savefig(part, dpi=150))


def _bland_altman(axes, one: Repeatability, repeats) -> None:
    """Draw one panel: every repeat against the one before it."""
    pairs = np.array(
        [
            pair
            for row in repeats
            for kept in [[value for value in row if np.isfinite(value)]]
            for pair in itertools.pairwise(kept)
        ]
    )
    unit = f" ({one.unit})" if one.unit else ""
    axes.plot(pairs.mean(axis=1), np.diff(pairs, axis=1)[:, 0], "o", ms=5, mfc="none", color="C0")
    lines = ((one.bias, "-", "bias"), (one.low, "--", "−1.96 SD"), (one.high, "--", "+1.96 SD"))
    for height, style, words in lines:
        if np.isfinite(height):
            axes.axhline(height, ls=style, color="0.3", lw=1)
            axes.annotate(
                f"{words} {figure(height)}", (1, height), xycoords=("axes fraction", "data"),
                xytext=(-2, 2), textcoords="offset points", ha="right", fontsize=8,
            )  # fmt: skip
    axes.set_title(f"{one.name}: RC {figure(one.rc_percent)} %, wCV {figure(one.within_cv)} %")
    axes.set_xlabel(f"mean of {one.quantity}{unit}")
    axes.set_ylabel(f"difference{unit}")
    axes.margins(y=0.25)
