"""The numerical example of the source paper: a square of 32 triangles, two pushes, Lamé constants.

The lower half is unknown, the upper half known; the bottom stands on the floor, the top is moved.
Three blocks of results: what the paper prints; data and identification with the same kinematics,
which is exact for any push; and finite-strain data identified with small strain, which shows what
a large push does to a linear identification.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..fem.elastic_constants import lame_from_young
from ..fem.forward import solve_push, square_mesh
from ..inverse.identify import identify
from ..progress import Progress, silent

YOUNG, POISSON = 5.0e3, 0.43  # Pa, the same in all cells
SQUARES, WIDTH = 4, 0.2  # per edge; m
UNKNOWN, KNOWN = 1, 2  # labels of T0…T15 and T16…T31
SHOWN = (13, 14)  # the cells of the paper's table, found at node P13

ROWS = (
    ((0.0, 0.025), (0.025, 0.025)),
    ((0.0, 0.03), (0.03, 0.03)),
    ((0.0, 0.05), (0.05, 0.05)),
    ((0.0, 0.05), (0.1, 0.1)),
)
"""Displacement of the top nodes (to the left, down) in the two trials of each row, m."""

PRINTED = (
    (1.12e4, 1.89e3, 0.93e4, 1.70e3),
    (1.10e4, 1.87e3, 1.10e4, 1.73e3),
    (2.07e4, 0.76e3, 1.11e4, 1.01e3),
    (2.09e4, 0.77e3, 1.10e4, 1.01e3),
)
"""λ13, μ13, λ14, μ14 as the paper prints them, Pa."""

BLOCKS = (
    ("small-strain", "small-strain"),
    ("st-venant-kirchhoff", "small-strain"),
    ("neo-hookean", "small-strain"),
    ("st-venant-kirchhoff", "st-venant-kirchhoff"),
    ("neo-hookean", "neo-hookean"),
)
"""Kinematics of the forward data, and of the identification."""

SHORT = {"small-strain": "small", "st-venant-kirchhoff": "SVK", "neo-hookean": "neo"}


@dataclass(frozen=True)
class Example:
    """The paper's square: points (25, 2), cells (32, 3), labels (32,), true λ, μ (32,)."""

    points: np.ndarray
    cells: np.ndarray
    labels: np.ndarray
    lam: np.ndarray
    mu: np.ndarray

    @property
    def floor(self) -> np.ndarray:
        """Nodes that stand on the floor."""
        return np.isclose(self.points[:, 1], 0)

    @property
    def top(self) -> np.ndarray:
        """Nodes that are moved."""
        return np.isclose(self.points[:, 1], WIDTH)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    `shown` are λ13, μ13, λ14, μ14 in Pa (NaN: not determined), `error` is the largest relative
    error of those of the 32 unknowns that were found, `missing` how many were not; `note` says why
    there are no figures.
    """

    data: str
    kinematics: str
    method: str
    row: int
    shown: np.ndarray | None = None
    error: float = np.nan
    missing: int = 0
    note: str = ""


def example(pattern: str = "paper") -> Example:
    """Return the paper's square, or one with another mesh pattern."""
    points, cells = square_mesh(SQUARES, SQUARES, WIDTH, WIDTH, pattern)
    labels = np.where(points[cells].mean(1)[:, 1] < WIDTH / 2, UNKNOWN, KNOWN)
    lam, mu = lame_from_young(YOUNG, POISSON)
    return Example(points, cells, labels, np.full(len(cells), lam), np.full(len(cells), mu))


def pushed(square: Example, row: int, kinematics: str) -> np.ndarray:
    """Return the displacements (2, 25, 2) of the two trials of a row.

    Raises
    ------
    InputError
        The push turns a cell inside out.
    """
    moved = np.flatnonzero(square.floor | square.top)
    trials = []
    for left, down in ROWS[row]:
        target = np.where(square.top[moved, None], (-left, -down), 0.0)
        trials.append(
            solve_push(
                square.points, square.cells, square.lam, square.mu, moved, target,
                kinematics=kinematics,
            )
        )  # fmt: skip
    return np.array(trials)


def identified(square: Example, displacements: np.ndarray, kinematics: str, method: str):
    """Identify the lower half, and return the IdentificationResult."""
    return identify(
        square.points,
        square.cells,
        displacements,
        {KNOWN: (YOUNG, POISSON)},
        labels=square.labels,
        reaction_nodes=square.floor | square.top,
        method=method,
        kinematics=kinematics,
    )


def errors(square: Example, result) -> np.ndarray:
    """Return the relative errors of λ and μ of the unknown cells, (32,); NaN: not determined."""
    unknown = square.labels == UNKNOWN
    found = np.concatenate([result.lam[unknown], result.mu[unknown]])
    return np.abs(found / np.concatenate([square.lam[unknown], square.mu[unknown]]) - 1)


def table2(
    methods: tuple[str, ...] = ("sequential", "global"), progress: Progress | None = None
) -> list[Row]:
    """Return every line of the table, block by block."""
    progress = progress or silent
    square, rows = example(), []
    for number, (data, kinematics) in enumerate(BLOCKS):
        for row in range(len(ROWS)):
            progress((number + row / len(ROWS)) / len(BLOCKS), f"{data} data, {kinematics}")
            try:
                displacements = pushed(square, row, data)
            except InputError:
                note = "the forward solution turns a cell inside out"
                rows.append(Row(data, kinematics, "", row, note=note))
                continue
            for method in methods:
                result = identified(square, displacements, kinematics, method)
                shown = np.stack([result.lam, result.mu], 1)[list(SHOWN)].ravel()
                error = errors(square, result)
                missing = int(np.isnan(error).sum())
                largest = float(np.nanmax(error)) if missing < len(error) else np.nan
                rows.append(Row(data, kinematics, method, row, shown, largest, missing))
    return rows


def table2_text(rows: list[Row]) -> str:
    """Return the paper's table beside ours, for people."""
    from ..report.terminal import table

    lam, mu = lame_from_young(YOUNG, POISSON)
    header = ["", *(f"{c}{cell}" for cell in SHOWN for c in "λμ"), "largest error"]
    lines = [["truth", *([f"{lam:.3g}", f"{mu:.3g}"] * 2), ""]]
    text = [
        "Lamé constants (Pa) of T13 and T14, from two pushes (left, down) of the top of a 0.2 m "
        "square.",
        "small → neo: small-strain data, identified with neo-Hookean kinematics (SVK: St. Venant–"
        "Kirchhoff).",
        "The last column is the largest relative error of the 32 unknowns; -: not determined.",
        "",
    ]
    for row, printed in enumerate(PRINTED):
        first, second = ROWS[row]
        lines.append([f"pushes {first} and {second} m", *[""] * 5])
        lines.append(["  paper", *(f"{value:.2e}" for value in printed), ""])
        for one in rows:
            if one.row != row:
                continue
            name = f"  {SHORT[one.data]} → {SHORT[one.kinematics]}, {one.method}".rstrip(", ")
            if one.shown is None:
                lines.append([name, *["-"] * 4, one.note])
                continue
            shown = ["-" if np.isnan(value) else f"{value:.2e}" for value in one.shown]
            missing = f" ({one.missing} not found)" if one.missing else ""
            lines.append([name, *shown, f"{one.error:.1e}{missing}"])
    return "\n".join([*text, table(header, lines)])
