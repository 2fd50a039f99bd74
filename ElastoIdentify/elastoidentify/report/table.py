"""The figures per label as a file and for people."""

import csv
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path

from ..imaging.io import write_whole
from .terminal import figure, table

ROUND_OFF = 1e-9  # share of a value below which its error says nothing


def write_table(path: str | Path, rows: list[dict], provenance: Mapping | None = None) -> None:
    """Write the rows of a result's statistics as CSV, whole or not at all.

    Parameters
    ----------
    path : path
    rows : list of dict
        See :func:`~elastoidentify.inverse.statistics.label_statistics`; every row says its units.
    provenance : mapping, optional
        Where the result comes from; the last column, JSON.
    """
    made = {} if provenance is None else {"provenance": json.dumps(provenance, default=str)}
    text, names = io.StringIO(), list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, [*names, *made], lineterminator="\n")
    writer.writeheader()
    writer.writerows({**row, **made} for row in rows)
    write_whole(Path(path), lambda part: part.write_text(text.getvalue(), encoding="utf-8"))


def with_truth(rows: list[dict], truth: Mapping[int, Mapping[str, float]]) -> list[dict]:
    """Return rows with the true values of a phantom: ``Mu true`` and so on."""
    names = {name for values in truth.values() for name in values}
    return [
        {
            **row,
            **{f"{n} true": truth.get(row["label"], {}).get(n, math.nan) for n in sorted(names)},
        }
        for row in rows
    ]


def table_text(rows: list[dict], unit: str = "") -> str:
    """Return the figures of μ, E and ν for people, one line per label.

    ``±`` is the standard error of the label's mean; the spread is from cell to cell.
    """
    unit = f" ({unit})" if unit else ""
    true = any(math.isfinite(number(row, "Mu true")) for row in rows)
    header = ["label", "cells", "found", f"μ mean{unit}", "±", "median", "spread"]
    header += [f"E mean{unit}", "±", "ν", "μ ratio", "±"]
    header += [f"μ true{unit}"] if true else []
    return table(header, [_line(row, true) for row in rows])


def _line(row: dict, true: bool) -> list[str]:
    def error(quantity: str, statistic: str = "standard error", of: str = "mean") -> str:
        if row["given"]:
            return ""
        return _error(number(row, f"{quantity} {statistic}"), number(row, f"{quantity} {of}"))

    line = [
        f"{row['label']} {row.get('name', '')}".strip(),
        str(row["cells"]),
        "given" if row["given"] else f"{100 * row['determined']:.0f} %",
        figure(number(row, "Mu mean")),
        error("Mu"),
        figure(number(row, "Mu median")),
        error("Mu", "spread"),
        figure(number(row, "YoungModulus mean")),
        error("YoungModulus"),
        figure(number(row, "PoissonRatio mean")),
        figure(number(row, "Mu ratio")),
        _error(number(row, "Mu ratio standard error"), number(row, "Mu ratio")),
    ]
    return [*line, figure(number(row, "Mu true"))] if true else line


def number(row: Mapping, key: str) -> float:
    """Return a figure of a row; NaN where there is none (JSON has None, CSV nothing)."""
    value = row.get(key)
    return math.nan if value in (None, "") else float(value)


def _error(error: float, value: float) -> str:
    """Return an error for people: 0 where it is the round-off of exact data."""
    return "0" if error <= ROUND_OFF * abs(value) else figure(error)
