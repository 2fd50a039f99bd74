"""The picture of maps under several assumptions: side by side, in one colour scale."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..imaging.io import write_whole
from .picture import (
    MODULI,
    _colour_bar,
    _drawing,
    _frame,
    _highest,
    _marks,
    _outline,
    _polygons,
    _scale_bar,
    _unit,
    _window,
)
from .terminal import figure as number

COLUMNS = 4
MOODS = {"trust": "#1a7f37", "trust with care": "#9a6700", "do not trust": "#b3261e"}
"""Colours of verdicts that are told apart without colour vision, too: they are written as well."""


def draw(
    path: str | Path,
    points: np.ndarray,
    blocks: list[tuple[str, np.ndarray]],
    labels: np.ndarray,
    panels: Sequence[tuple[Mapping, np.ndarray]],
    *,
    unit: str = "Pa",
    length: str = "mm",
) -> None:
    """Draw μ under each assumption to a PNG, PDF or SVG file, whole or not at all.

    Below each map: how large the noise must be under its assumption, the evidence for it, and the
    verdict. The preferred one has a frame.

    Parameters
    ----------
    path : path
    points : (n, 3)
    blocks : list of (kind, (m, k) int)
    labels : (n_cells,)
    panels : sequence of (row, μ)
        A row of :func:`elastoidentify.exploration.summary`, and μ of every cell, NaN where there is
        none.
    unit, length : str
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    frame = _frame(points, None)
    drawing = _drawing(points, blocks, labels, frame)
    window = _window(drawing, None, frame)
    size = window[1] - window[0]
    preferred = next(mu for row, mu in panels if row["preferred"])
    factor, name = _unit(preferred, unit)
    high = _highest(preferred[np.isfinite(preferred)] * factor)  # others may be wild

    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    height = float(np.clip(3.0 * size[1] / size[0], 1.2, 6.0)) + 1.3
    figure = Figure(figsize=(3.2 * columns + 1.0, height * rows), layout="constrained", dpi=140)
    FigureCanvasAgg(figure)
    axes = list(np.ravel(figure.subplots(rows, columns, squeeze=False)))
    for one in axes:
        one.set(xlim=window[:, 0], ylim=window[::-1, 1], aspect="equal", xticks=[], yticks=[])
        one.spines[:].set_visible(False)
    for one in axes[len(panels) :]:
        one.set_visible(False)
    for one, (row, mu) in zip(axes, panels, strict=False):
        patches = _polygons(one, drawing, mu[drawing.cells] * factor, MODULI, 0.0, high)
        _mark_open(one, drawing, mu)
        _outline(one, drawing)
        _say(one, row)
        bar = patches
    _scale_bar(axes[0], window, length, "black")
    extend = "max" if any((mu * factor > high).any() for _, mu in panels) else "neither"
    label = f"shear modulus μ ({name})" if name else "shear modulus μ"
    _colour_bar(figure, axes[columns - 1], bar, label, extend)
    style = {"bbox_inches": "tight", "pad_inches": 0.1}
    suffix = Path(path).suffix.lower().lstrip(".")
    write_whole(Path(path), lambda part: figure.savefig(part, format=suffix, **style))


def _mark_open(axes, drawing, mu) -> None:
    """Hatch the cells without a value."""
    from matplotlib.collections import PolyCollection

    open_ = np.flatnonzero(~np.isfinite(mu[drawing.cells]))
    style = next(iter(_marks().values()))
    axes.add_collection(PolyCollection([drawing.polygons[i] for i in open_], **style))


def _say(axes, row: Mapping) -> None:
    """Write what is assumed above a map, and what came of it below."""
    given = row["assumption"] == "given"
    title = "as given" if given else f"if {row['words']}"
    style = {"fontsize": 9.5, "fontweight": "bold" if row["preferred"] else "normal"}
    axes.set_title("\n".join(textwrap.wrap(title, 34)), **style)
    said = "" if given else f"noise × {number(row['noise'], 2)}, evidence {row['evidence']:+.0f}"
    if row["noise over stated"] is not None:
        stated = f"{number(row['noise over stated'], 2)} × the noise stated"
        said = stated if given else f"{stated}, evidence {row['evidence']:+.0f}"
    if row["preferred"]:
        axes.spines[:].set(visible=True, linewidth=2.0, color="0.2")
        said = f"{said}\npreferred by the displacements".strip()
    axes.set_xlabel(said, fontsize=9)
    axes.text(
        0.5, -0.02, row["verdict"], transform=axes.transAxes, ha="center", va="top", fontsize=9.5,
        color=MOODS[row["verdict"]], fontweight="bold",
    )  # fmt: skip
    axes.xaxis.labelpad = 16
