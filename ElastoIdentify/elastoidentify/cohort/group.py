"""All subjects on one page: ``python -m elastoidentify.cohort.group OUT SUBJECT…``."""

import csv
import io
import json
import math
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

from ..export.repeatability import read_rows
from ..imaging.io import make_folder, write_whole
from ..report.terminal import figure
from . import layout

FIGURES = {
    "Mu mean": "mean shear modulus of the label, weighted with the cells' sizes",
    "Mu standard error": "standard error of that mean",
    "Mu core": "mean shear modulus of the label's cells that touch no other label",
    "Mu core standard error": "standard error of that mean",
    "Mu spread": "standard deviation of the shear modulus between cells",
    "YoungModulus mean": "mean Young's modulus of the label",
    "YoungModulus standard error": "standard error of that mean",
    "Mu ratio": "mean shear modulus over that of the reference label",
    "Mu ratio standard error": "standard error of that ratio",
    "determined": "share of the label's size in which a value was found, 0 to 1",
}
COLUMNS = ["participant_id", "quality", "label", "name", "unit", *FIGURES, "message"]
QUALITY = {
    "good": "a map without warnings",
    "look": "a map with warnings, which are in the column message",
    "failed": "no map; the column message says why",
}


def collect(out: Path, subjects: Sequence[str]) -> list[dict]:
    """Return a row per subject and label that is not given, one row of a subject that failed."""
    rows = []
    for subject in subjects:
        start = {"participant_id": f"sub-{subject}"}
        made = {name: out / file for name, file in layout.outputs(subject).items()}
        if not all(file.is_file() for file in made.values()):
            rows.append(start | {"quality": "failed", "message": _last_words(out, subject)})
            continue
        warnings = _warnings(made["report"])
        start["quality"] = "look" if warnings else "good"
        for row in read_rows(made["table"]):
            if not row["given"]:
                rows.append(start | row | {"message": " | ".join(warnings)})
    return [{name: row.get(name, "n/a") for name in COLUMNS} for row in rows]


def _warnings(report: Path) -> list[str]:
    """Return the warnings of all steps of a run."""
    steps = json.loads(report.read_text(encoding="utf-8"))
    return [one for step in steps.values() if step for one in step.get("warnings", [])]


def _last_words(out: Path, subject: str) -> str:
    """Return why a subject failed: the last line of its log that is not empty."""
    log = out / layout.log(subject)
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n") if log.exists() else []
    lines = [line.strip() for line in lines if line.strip()]
    return lines[-1].split("\r")[-1].strip() if lines else "was not run"


def write_group(out: Path, subjects: Sequence[str]) -> list[Path]:
    """Write ``labels.tsv``, its data dictionary ``labels.json`` and ``index.html``.

    Parameters
    ----------
    out : Path
        The output folder of the cohort; they go to its folder ``group``.
    subjects : sequence of str
        All that should be there, without ``sub-``.

    Returns
    -------
    list of Path
    """
    rows, folder = collect(out, subjects), make_folder(out / "group")
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, delimiter="\t", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    texts = {
        "labels.tsv": text.getvalue(),
        "labels.json": json.dumps(_dictionary(rows), indent=1, ensure_ascii=False) + "\n",
        "index.html": _page(out, rows),
    }
    for name, content in texts.items():
        write_whole(folder / name, lambda part, c=content: part.write_text(c, encoding="utf-8"))
    return [folder / name for name in texts]


def _dictionary(rows: list[dict]) -> dict:
    """Return what every column means, as BIDS has it."""
    units = {row["unit"] for row in rows if row["unit"] != "n/a"}
    about = {name: {"Description": words} for name, words in FIGURES.items()}
    for name in about:
        if "ratio" not in name and name != "determined":
            about[name]["Units"] = ", ".join(sorted(units)) or "n/a"
    return {
        "participant_id": {"Description": "subject"},
        "quality": {"Description": "by the run's own warnings", "Levels": QUALITY},
        "label": {"Description": "label of the segmentation; given ones are left out"},
        "name": {"Description": "name of the label"},
        "unit": {"Description": "of the moduli"},
        **about,
        "message": {"Description": "warnings, or why there is no map"},
    }


# ---- the page

STYLE = """
body { font: 15px/1.45 system-ui, "DejaVu Sans", sans-serif; color: #1b1f24; max-width: 75rem;
       margin: 1.5rem auto; padding: 0 1rem; }
.all { display: grid; grid-template-columns: repeat(auto-fill, minmax(19rem, 1fr)); gap: 1rem; }
.one { border: 1px solid #d8dee4; border-top: .35rem solid #2c7fb8; padding: .6rem; }
.look { border-top-color: #d98200; } .failed { border-top-color: #b3261e; }
.one img { width: 100%; } .one h3 { margin: 0 0 .4rem; font-size: 1rem; }
.one p { margin: .3rem 0; font-size: .85rem; overflow-wrap: anywhere; }
svg { background: #f6f8fa; } svg text { font-size: 12px; }
"""


def _page(out: Path, rows: list[dict]) -> str:
    subjects = list(dict.fromkeys(row["participant_id"] for row in rows))
    first = {row["participant_id"]: row for row in reversed(rows)}
    counts = {name: sum(one["quality"] == name for one in first.values()) for name in QUALITY}
    summary = ", ".join(f"{count} {name}" for name, count in counts.items())
    cards = [
        _card(out, name, [r for r in rows if r["participant_id"] == name]) for name in subjects
    ]
    return "\n".join(
        ["<!DOCTYPE html>", '<html lang="en"><head><meta charset="utf-8">',
         f"<title>Cohort</title><style>{STYLE}</style></head><body>",
         f"<h1>{len(subjects)} subjects: {summary}</h1>",
         *_distributions(rows), "<h2>Subjects</h2>", '<div class="all">', *cards, "</div>",
         "</body></html>", ""]
    )  # fmt: skip


def _card(out: Path, name: str, rows: list[dict]) -> str:
    """Return a subject: thumbnail, figures, messages."""
    quality, parts = rows[0]["quality"], [f"<h3>{escape(name)}: {rows[0]['quality']}</h3>"]
    picture = layout.outputs(name.removeprefix("sub-"))["picture"]
    if quality != "failed":
        parts.append(f'<img loading="lazy" alt="map of {escape(name)}" src="../{escape(picture)}">')
        for row in rows:
            values = (
                f"{figure(_number(row['Mu mean']))} ± {figure(_number(row['Mu standard error']))}"
            )
            title = row["name"] if row["name"] not in ("", "n/a") else f"label {row['label']}"
            parts.append(f"<p>{escape(title)}: μ {values} {escape(row['unit'])}</p>")
    if rows[0]["message"] not in ("", "n/a"):
        parts.append(f"<p>{escape(rows[0]['message'])}</p>")
    return f'<div class="one {quality}">{"".join(parts)}</div>'


def _distributions(rows: list[dict]) -> list[str]:
    """Return the values of μ of every label on an axis of their own, a dot per subject."""
    parts = []
    labels = dict.fromkeys((row["label"], row["name"]) for row in rows if row["label"] != "n/a")
    for label, name in labels:
        values = [_number(row["Mu mean"]) for row in rows if row["label"] == label]
        values = sorted(value for value in values if math.isfinite(value))
        if not values:
            continue
        low, high = values[0], values[-1]
        span = (high - low) or 1.0
        dots = "".join(
            f'<circle cx="{20 + 560 * (value - low) / span:.1f}" cy="22" r="5" fill="#2c7fb8" '
            'fill-opacity=".5"/>'
            for value in values
        )
        unit = next(row["unit"] for row in rows if row["label"] == label)
        ends = f'<text x="20" y="50">{figure(low)}</text>'
        ends += f'<text x="580" y="50" text-anchor="end">{figure(high)} {escape(unit)}</text>'
        title = name if name not in ("", "n/a") else f"label {label}"
        parts.append(f"<h3>Shear modulus of {escape(title)}, {len(values)} subjects</h3>")
        parts.append(f'<svg width="600" height="58" role="img">{dots}{ends}</svg>')
    return parts


def _number(text) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        return math.nan


def main(arguments: list[str] | None = None) -> int:
    """Write the group's files and print which subjects failed."""
    out, *subjects = sys.argv[1:] if arguments is None else arguments
    files = write_group(Path(out), subjects)
    for row in collect(Path(out), subjects):
        if row["quality"] == "failed":
            print(f"failed: {row['participant_id']}: {row['message']}")
    print(f"wrote {', '.join(str(file) for file in files)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
