"""Figures per label: what was found, how it scatters, how much of the label was found at all."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..imaging.io import write_whole
from .terminal import figure, table

QUANTITIES = ("Mu", "Lambda", "YoungModulus", "PoissonRatio")
SYMBOLS = {"Mu": "μ", "Lambda": "λ", "YoungModulus": "E", "PoissonRatio": "ν"}
RESULT_ARRAYS = ("Label", "Status", *QUANTITIES, "MuStd", "LambdaStd")
FOUND = (1, 2)  # Status of known and identified cells
ROUND_OFF = 1e-9  # share of a value below which its error says nothing


def label_rows(arrays: Mapping[str, np.ndarray], truth: Mapping[int, Mapping] | None = None):
    """Return a row of figures for every label.

    Parameters
    ----------
    arrays : mapping of cell arrays (n_cells,)
        ``Label``, ``Status``, ``Mu``, ``MuStd``, ``Lambda``, ``LambdaStd``, ``YoungModulus``,
        ``PoissonRatio``.
    truth : {label: {quantity: value}}, optional
        True values, for phantoms.

    Returns
    -------
    list of dict
        ``label``, ``cells``, ``identified`` (share of the cells that are known or identified, 0 to
        1), ``known`` (given, not found), then for every quantity its ``median``, ``mean`` and
        ``spread`` (standard deviation over those cells); for μ and λ also ``std``, the median of
        their own standard deviations; ``true`` where `truth` has it.
    """
    rows = []
    for label in np.unique(arrays["Label"]):
        here = arrays["Label"] == label
        found = here & np.isin(arrays["Status"], FOUND)
        row = {
            "label": int(label),
            "cells": int(here.sum()),
            "identified": float(found.sum() / here.sum()),
            "known": bool((arrays["Status"][here] == 1).all()),
        }
        for quantity in QUANTITIES:
            values = arrays[quantity][found]
            row |= {
                f"{quantity} median": float(np.median(values)) if found.any() else np.nan,
                f"{quantity} mean": float(values.mean()) if found.any() else np.nan,
                f"{quantity} spread": float(values.std()) if found.any() else np.nan,
            }
            if f"{quantity}Std" in arrays:
                stds = arrays[f"{quantity}Std"][found]
                row[f"{quantity} std"] = float(np.median(stds)) if found.any() else np.nan
            if truth is not None:
                row[f"{quantity} true"] = truth.get(int(label), {}).get(quantity, np.nan)
        rows.append(row)
    return rows


def write_table(path: str | Path, rows: list[dict]) -> None:
    """Write rows of :func:`label_rows` as CSV, whole or not at all; moduli as they were given."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(Path(path), lambda part: part.write_text(text.getvalue(), encoding="utf-8"))


def table_text(rows: list[dict], unit: str = "", names: Mapping[int, str] | None = None) -> str:
    """Return the figures of μ, E and ν for people, one line per label.

    ``±`` is the typical (median) standard deviation of a cell's μ.
    """
    unit = f" ({unit})" if unit else ""
    true = any(np.isfinite(row.get("Mu true", np.nan)) for row in rows)
    header = ["label", "cells", "found", f"μ median{unit}", "±", "spread", f"E median{unit}", "ν"]
    if true:
        header.append(f"μ true{unit}")
    lines = []
    for row in rows:
        name = (names or {}).get(row["label"], "")
        line = [
            f"{row['label']} {name}".strip(),
            str(row["cells"]),
            "given" if row["known"] else f"{100 * row['identified']:.0f} %",
            figure(row["Mu median"]),
            "" if row["known"] else _error(row["Mu std"], row["Mu median"]),
            "" if row["known"] else _error(row["Mu spread"], row["Mu median"]),
            figure(row["YoungModulus median"]),
            figure(row["PoissonRatio median"]),
        ]
        lines.append([*line, figure(row["Mu true"])] if true else line)
    return table(header, lines)


def _error(error: float, value: float) -> str:
    """Return an error for people: 0 where it is the round-off of exact data."""
    return "0" if error <= ROUND_OFF * abs(value) else figure(error)
