"""Maps of a hidden lesion when an assumption is wrong, told and not told, beside the strain image.

    python Testing/benchmarks/evidence.py [--only WORD] [--pictures FOLDER] [--squares 16]
                                          [--sub-cells N]

Forward data of `Testing/broken.py` and `Testing/slipping.py`: quadratic quadrilaterals of
scikit-fem on a finer mesh, small strain, two pushes of 5 %, a disc of 3:1 and 30 % of the width
that has no label. White noise, stated as the displacements' information, of 1 % of the push where
no other is named. What registration adds is in the benchmark that starts from images
(images_to_moduli.py).

Columns: contrast (median of the lesion over that of the tissue further than a radius away), the
best Dice index of "stiffer than a threshold", false alarms (share of that tissue above 1.25 times
its median), both for the map and for the strain image (1 over the axial strain of the first push
per cell); the noise found over that stated, and the verdict. The flat guess has contrast 1, the
Dice index of the whole tissue and no false alarms.
"""

import argparse
import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import broken
import slipping
from contact import glued
from elastoidentify import identify
from exploration import NOISE, THIN
from open_benchmark.methods.strain_image import _axial_strain
from open_benchmark.problem import Case

FREE = {"unknowns": "lambda-mu"}
YOUNG = {"unknowns": "young", "poisson_ratio": 0.45}
WIDTH = YOUNG | {"poisson_std": 0.05}
STRETCH = YOUNG | {"out_of_plane_std": 0.01}
ONE = ((0, -1.5),)
bodies, slabs = cache(broken.body), cache(slipping.slab)


@dataclass
class Row:
    """A line of the table: how the body is made, and what is told of it."""

    name: str
    told: str
    options: dict
    body: dict = field(default_factory=dict)
    noise: float = 1.0  # times NOISE
    change: object = None  # of what is measured: a function of the arrays


def wild(arrays, rng):
    """6 % of the nodes are lost by up to 2 mm, and their information does not know."""
    u = arrays["displacements"]
    lost = rng.random(u.shape[1]) < 0.06
    u[:, lost] += rng.uniform(-2, 2, (len(u), lost.sum(), 2))


def cut(arrays, rng):
    """The right third was clipped away; the mesh still knows its outer border."""
    points, cells = arrays["points"], arrays["cells"]
    arrays["outer_border"] = (np.isclose(points, 0) | np.isclose(points, broken.SIDE)).any(axis=1)
    keep = points[cells].mean(axis=1)[:, 0] < 21
    for name in ("cells", "labels", "young"):
        arrays[name] = arrays[name][keep]


ROWS = (
    Row("nothing is wrong", "λ, μ sought", FREE),
    Row("nothing is wrong", "ν = 0.45", YOUNG),
    Row("no lesion", "λ, μ sought", FREE, {"contrast": 1.0}),
    Row("1.5 : 1", "λ, μ sought", FREE, {"contrast": 1.5}),
    Row("6 : 1", "λ, μ sought", FREE, {"contrast": 6.0}),
    Row("12 % of the width", "λ, μ sought", FREE, {"radius": 1.8}),
    Row("noise 5 %", "λ, μ sought", FREE, noise=5),
    Row("noise 10 %", "λ, μ sought", FREE, noise=10),
    Row("one push", "λ, μ sought", FREE, {"pushes": ONE}),
    Row("ν is 0.49", "ν = 0.45", YOUNG, {"kind": "poisson", "true_poisson": 0.49}),
    Row("ν is 0.49", "0.45 ± 0.05", WIDTH, {"kind": "poisson", "true_poisson": 0.49}),
    Row("ν is 0.49", "λ, μ sought", FREE, {"kind": "poisson", "true_poisson": 0.49}),
    Row("ν is 0.47", "ν = 0.45", YOUNG, {"kind": "poisson", "true_poisson": 0.47}),
    Row("ν is 0.499", "ν = 0.45", YOUNG, {"kind": "poisson", "true_poisson": 0.499}),
    Row("ν is 0.499", "λ, μ sought", FREE, {"kind": "poisson", "true_poisson": 0.499}),
    Row("pad slides", "stuck", YOUNG, {"kind": "contact"}),
    Row("pad slides", "slip", YOUNG | {"slip": [(1, 2)]}, {"kind": "contact"}),
    Row("stretched by 0.5 %", "plane strain", YOUNG, {"kind": "stretch"}),
    Row("stretched by 0.5 %", "λ, μ sought", FREE, {"kind": "stretch"}),
    Row("stretched by 0.5 %", "stretch ± 1 %", STRETCH, {"kind": "stretch"}),
    Row("thin body", "plane strain", YOUNG, {"poisson": THIN}),
    Row("thin body", "plane stress", YOUNG | {"plane": "stress"}, {"poisson": THIN}),
    Row("fibres in the lesion", "isotropic", YOUNG, {"kind": "fibres"}),
    Row("6 % of the nodes lost", "λ, μ sought", FREE, change=wild),
    Row("right third cut away", "the outer border", FREE, change=cut),
)


def arrays_of(row: Row, n: int) -> dict:
    """Return points, cells, labels, exact displacements, reaction nodes, true E, known material."""
    kind = dict(row.body)
    if kind.get("kind") == "contact":
        case = slabs(n)
        case = case if "slip" in row.options else glued(case)
        young = np.where(case.labels == 1, slipping.E_PAD, slipping.E_TISSUE)
        young = np.where(case.inside, slipping.CONTRAST * slipping.E_TISSUE, young)
        known = (slipping.E_PAD, slipping.POISSON)
    else:
        case = bodies(n=n, **kind)
        young, known = case.young, (1.0, 0.45)
        if kind.get("poisson") == THIN:  # its plane stress is the plane strain that was solved
            known = (1.45 / (1 + THIN), 0.45)
    return {
        "points": case.points, "cells": case.cells, "labels": case.labels, "young": young,
        "displacements": case.displacements.copy(), "reaction": case.reaction, "known": known,
        "outer_border": None,
    }  # fmt: skip


def measured(row: Row, n: int, refine: int | None, seed: int = 1):
    """Return the arrays with noise, and the result."""
    a, rng = arrays_of(row, n), np.random.default_rng(seed)
    a["displacements"] += row.noise * NOISE * rng.standard_normal(a["displacements"].shape)
    if row.change is not None:
        row.change(a, rng)
    u = a["displacements"]
    result = identify(
        a["points"], a["cells"], u, {1: a["known"]}, labels=a["labels"],
        reaction_nodes=a["reaction"], outer_border=a["outer_border"], method="regularized",
        refine=refine,
        information=np.broadcast_to(np.eye(2) / (row.noise * NOISE) ** 2, (*u.shape, 2)),
        **row.options,
    )  # fmt: skip
    return a, result


def strain_image(a) -> np.ndarray:
    """Return 1 over the axial strain of the first push, (n_cells,)."""
    known = np.where(a["labels"][:, None] == 1, a["known"], np.nan)
    case = Case(a["points"], "triangle", a["cells"], a["displacements"], a["reaction"], known)
    return 1 / np.maximum(_axial_strain(case), 1e-9)


def scores(a, values) -> str:
    """Return contrast, Dice and false alarms as columns; the lesion is where E is largest."""
    tissue = a["labels"] != 1
    inside = tissue & (a["young"] > 1.2 * np.median(a["young"][tissue]))
    middle = a["points"][a["cells"]].mean(axis=1)
    far = tissue & ~inside
    if inside.any():
        centre = middle[inside].mean(axis=0)
        radius = np.linalg.norm(middle[inside] - centre, axis=1).max()
        far &= np.linalg.norm(middle - centre, axis=1) > 2 * radius
    if not np.isfinite(values[far]).any():
        return "– | – | –"
    usual = np.nanmedian(values[far])
    alarms = np.mean(values[far] > 1.25 * usual)
    if not inside.any():
        return f"– | – | {alarms:.0%}"
    with np.errstate(invalid="ignore"):
        found = [_dice(tissue & (values > t), inside) for t in np.unique(values[tissue])[::-1]]
    inner = values[inside][np.isfinite(values[inside])]
    contrast = f"{np.median(inner) / usual:.2f}" if inner.size else "–"
    return f"{contrast} | {max(found):.2f} | {alarms:.0%}"


def _dice(called, true) -> float:
    return float(2 * (called & true).sum() / (called.sum() + true.sum()))


def picture(path: Path, cases) -> None:
    """Draw a good map, one that is not to be trusted, and the strain image beside each."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2 * len(cases), figsize=(4.1 * 2 * len(cases), 4.3))
    for k, (row, a, result) in enumerate(cases):
        tissue = a["labels"] != 1
        strain = strain_image(a)
        strain *= a["known"][0] * np.median(1 / strain[~tissue])
        for axis, values, title in (
            (axes[2 * k], result.young, f"map: {row.name}, told: {row.told}"),
            (axes[2 * k + 1], strain, "strain image of the same push"),
        ):
            high = 1.3 * np.max(a["young"])
            drawn = axis.tripcolor(
                *a["points"].T, a["cells"], np.ma.masked_invalid(values), cmap="viridis",
                vmin=0, vmax=high,
            )  # fmt: skip
            circle = plt.Circle(broken.CENTRE, broken.RADIUS, fill=False, color="w", ls="--")
            axis.add_patch(circle)
            axis.axhline(broken.SIDE - broken.STRIP, color="w", lw=1)
            axis.set(aspect="equal", xticks=[], yticks=[])
            axis.set_title(title, fontsize=10)
            figure.colorbar(drawn, ax=axis, label="Young's modulus (pad: 1)", shrink=0.8)
        level = result.report["verdict"]["level"]
        axes[2 * k].set_xlabel(f"verdict: {level}", fontsize=12, fontweight="bold")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="rows whose name or telling holds this word")
    parser.add_argument("--squares", type=int, default=16)
    parser.add_argument("--sub-cells", dest="refine", type=int, help="default: the method's own")
    parser.add_argument("--pictures", type=Path)
    arguments = parser.parse_args()
    if arguments.pictures:
        chosen = [ROWS[1], next(row for row in ROWS if row.name == "ν is 0.49")]
        cases = [(row, *measured(row, arguments.squares, arguments.refine)) for row in chosen]
        picture(arguments.pictures / "evidence_maps.png", cases)
        return
    print("| what is true | told | map: contrast | Dice | false alarms | noise | verdict "
          "| strain: contrast | Dice | false alarms |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for row in ROWS:
        if arguments.only not in f"{row.name} {row.told}":
            continue
        a, result = measured(row, arguments.squares, arguments.refine)
        verdict = result.report["verdict"]
        print(
            f"| {row.name} | {row.told} | {scores(a, result.young)} "
            f"| {verdict['noise_factor']:.2f} | {verdict['level']} "
            f"| {scores(a, strain_image(a))} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
