"""docs/open-benchmark.md and its picture, from the JSON of results."""

from pathlib import Path

from . import methods, problems

DOCS = Path(__file__).resolve().parents[3] / "docs"
BEGIN, END = "<!-- made by run.py --page: do not edit from here -->", "<!-- to here -->"
HEAD = (
    "| level | method | RMS | median error | found | contrast (true) | CNR | Dice | within 2 std "
    "| forward solves | MiB |\n|---|---|---|---|---|---|---|---|---|---|---|"
)
PICTURE = "open_benchmark.png"
LOWEST = 1e-3  # RMS that is drawn: what is exact up to round-off would take the whole scale


def write(results: dict) -> None:
    """Put tables and picture of the results between the marks of the page."""
    page = DOCS / "open-benchmark.md"
    text = page.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    results = _ordered(results)
    made = "\n\n".join([_first(results), *(_problem(name, results[name]) for name in results)])
    page.write_text(f"{before}{BEGIN}\n\n{made}\n\n{END}{rest.split(END)[1]}", encoding="utf-8")
    _picture(results)


def _ordered(results):
    """Return the results in the order of the problems and of their levels."""
    return {
        name: {level: results[name][level] for level in levels if level in results[name]}
        for name in problems.NAMES
        if name in results
        for levels in [problems.load(name).LEVELS]
    }


def _scored(level):
    return {name: one for name, one in level.items() if "rms" in one}


def _first(results):
    """Who comes first on which level, by RMS."""
    rows = ["| problem, level | first by RMS | RMS | next | RMS |\n|---|---|---|---|---|"]
    for name, levels in results.items():
        for level, found in levels.items():
            ranked = sorted(_scored(found).items(), key=lambda one: one[1]["rms"])
            if len(ranked) > 1:
                both = [f"{methods.load(m).TITLE} | {one['rms']:.3f}" for m, one in ranked[:2]]
                rows.append(f"| {problems.load(name).TITLE}, {level} | " + " | ".join(both) + " |")
    return "## Who is first\n\n" + "\n".join(rows)


def _problem(name, levels):
    problem = problems.load(name)
    rows, aside, flat = [HEAD], [], {}
    for level, found in levels.items():
        ranked = sorted(_scored(found).items(), key=lambda one: one[1]["rms"])
        rows += [_row(level, method, one) for method, one in ranked]
        rows += [
            f"| {level} | *{code}, published* | {rms:.3f} |" + " – |" * 8
            for code, rms in getattr(problem, "PUBLISHED", {}).get(level, {}).items()
        ]
        for method, one in found.items():
            for how in ("skipped", "failed"):
                if how in one:
                    flat.setdefault((methods.load(method).TITLE, f"{how}: {one[how]}"), []).append(
                        level
                    )
    for (title, why), where in flat.items():
        aside.append(f"- {title} ({', '.join(where)}) {why}")
    cells = sorted(
        {one["cells"] for found in levels.values() for one in found.values() if "cells" in one}
    )
    count = f" {', '.join(map(str, cells))} cells." if cells else ""
    parts = [f"## {problem.TITLE}", problem.SOURCE + count]
    parts += ["\n".join(rows)] if len(rows) > 1 else []
    return "\n\n".join([*parts, *(["\n".join(aside)] if aside else [])])


def _row(level, method, one):
    regions = one["regions"].values()
    contrast = "; ".join(f"{r['contrast']:.2f} ({r['true_contrast']:.2f})" for r in regions)
    cnr = "; ".join("∞" if r["cnr"] is None else f"{r['cnr']:.1f}" for r in regions)
    dice = "; ".join(f"{r['dice']:.2f}" for r in regions)
    cover = "–" if one["coverage"] is None else f"{one['coverage']:.0%}"
    solves = one["forward_solves"]
    cost = f"{solves:.0f}" if solves >= 1 else "< 1"
    return (
        f"| {level} | {methods.load(method).TITLE} | {one['rms']:.3f} | {one['median_error']:.1%} "
        f"| {one['found']:.0%} | {contrast or '–'} | {cnr or '–'} | {dice or '–'} | {cover} "
        f"| {cost} | {one['memory_mib']:.0f} |"
    )


def _picture(results):
    """RMS of every method on every level, one panel per problem."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = [name for name, levels in results.items() if any(map(_scored, levels.values()))]
    rows = -(-len(shown) // 3)
    figure, axes = plt.subplots(
        rows, 3, figsize=(12, 3.4 * rows), squeeze=False, layout="constrained"
    )
    colours = dict(zip(methods.NAMES, plt.get_cmap("tab10").colors, strict=False))
    for axis, name in zip(axes.flat, shown, strict=False):
        levels = results[name]
        for method in methods.NAMES:
            at = [
                (level, max(f[method]["rms"], LOWEST))
                for level, f in levels.items()
                if "rms" in f.get(method, {})
            ]
            if at:
                wide = 2.5 if method == "regularized" else 1.2
                label = methods.load(method).TITLE
                axis.plot(*zip(*at, strict=True), "o-", lw=wide, color=colours[method], label=label)
        axis.set_title(problems.load(name).TITLE, fontsize=10)
        axis.set_yscale("log")
        axis.set_ylabel("RMS of 2(E−Ê)/(E+Ê)", fontsize=8)
        axis.tick_params(which="both", labelsize=8)
        axis.set_ylim(bottom=max(axis.get_ylim()[0], 0.8 * LOWEST))
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    lines = {line.get_label(): line for axis in axes.flat for line in axis.get_lines()}
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(DOCS / "pictures" / PICTURE, dpi=90)
    plt.close(figure)
