"""One page per case: verdict, picture, figures per label, warnings, and how it was made.

The page is one file without a reference to any other: it can be mailed, archived and printed.
Moduli are in kPa where the unit is known, as the ISMRM's guidelines for elastography ask (Manduca
et al., Magn. Reson. Med. 85:2377, 2021), and never called "stiffness" without saying which.
"""

import base64
import html
import json
import math
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..imaging.image import Image
from ..imaging.io import check_outputs, write_whole
from ..report.sentences import provenance_lines, report_lines, verdict_line
from ..report.table import ROUND_OFF, number
from ..report.terminal import figure
from ..results import is_found
from .cell_map import CellMap

SUFFIXES = (".html", ".htm")
HEADER = ("label", "cells", "size", "found", "μ", "median μ", "spread of μ", "E", "ν", "μ ratio")
MOODS = {"trust": "", "trust with care": "doubtful", "do not trust": "bad"}
"""Level of a verdict → how its box is coloured."""
NO_TABLE = "the result has no figures per label"

STYLE = """
:root{color-scheme:light}
body{font:16px/1.5 system-ui,sans-serif;color:#1b1b1b;background:#fff;max-width:76rem;
margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem}
h2{font-size:1.1rem;margin-top:2rem}
.verdict{border-left:.4rem solid #0072b2;background:#f1f6fa;padding:.8rem 1rem;font-size:1.1rem}
.verdict.doubtful{border-color:#e69f00;background:#fdf8ec}
.verdict.bad{border-color:#d55e00;background:#fdf1ec}
img{max-width:100%;height:auto}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{text-align:right;padding:.3rem .7rem;border-bottom:1px solid #ccc;white-space:nowrap}
th:first-child,td:first-child{text-align:left}
thead th{border-bottom:2px solid #444}
.small{font-size:.85rem;color:#555}
details li{overflow-wrap:anywhere}
@media print{details>*{display:block}body{margin:0;max-width:none}}
"""


def write_html(
    path: str | os.PathLike,
    result: CellMap,
    rest: Image | None = None,
    *,
    title: str = "",
    warnings: Sequence[str] = (),
    informed: bool = False,
) -> None:
    """Write the page of a case, whole or not at all.

    Parameters
    ----------
    path : path
        Ends in .html.
    result : CellMap
    rest : Image, optional
        Rest image, for the picture.
    title : str
        By default the file's name.
    warnings : sequence of str
        Of the steps before the identification, whose own are in the result's report.
    informed : bool
        The displacements came with their information, which the noise is then a multiple of.

    Raises
    ------
    InputError
        Another suffix, or a folder that cannot be written to.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: name a file that ends in {' or '.join(SUFFIXES)}")
    check_outputs([path])
    said = list(dict.fromkeys([*warnings, *result.report.get("warnings", [])]))
    text = page(result, title or path.stem, said, _picture(result, rest), informed)
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def page(
    result: CellMap,
    title: str,
    warnings: Sequence[str],
    picture: bytes = b"",
    informed: bool = False,
) -> str:
    """Return the page.

    Parameters
    ----------
    result : CellMap
    title : str
    warnings : sequence of str
    picture : bytes
        PNG; none where empty.
    informed : bool
        See :func:`write_html`.
    """
    made = result.provenance
    said = result.report.get("verdict") or {}
    mood = MOODS.get(said.get("level"), "doubtful" if warnings else "")
    reasons = said.get("reasons", ())  # a single one is in the sentence
    report = {key: value for key, value in result.report.items() if key != "verdict"}
    parts = [
        f"<h1>{_text(title)}</h1>",
        f'<p class="small">{_text(_made_by(made))}</p>',
        f'<p class="{f"verdict {mood}".strip()}">{_text(verdict(result, warnings))}</p>',
        _list(reasons if len(reasons) > 1 else ()),
        _image(picture),
        "<h2>Figures per label</h2>",
        _table(result),
        f"<h2>Warnings ({len(warnings)})</h2>",
        _list(warnings) or "<p>None.</p>",
        "<h2>How it was found</h2>",
        _list(report_lines(report, informed, result.length_unit) if report else []),
        "<h2>Where it comes from</h2>",
        "<details><summary>versions, inputs by their SHA-256, every option as used</summary>",
        _list(_provenance(made)),
        "</details>",
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "img-src data:; style-src 'unsafe-inline'\">\n"
        f"<title>{_text(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body>\n</html>\n"
    )


def verdict(result: CellMap, warnings: Sequence[str] = ()) -> str:
    """Return the sentence on top: the report's own verdict, else how much was found."""
    said = result.report.get("verdict")
    if said:
        return verdict_line(result.report, result.length_unit)
    found, count = int(is_found(result.status).sum()), len(result.status)
    trouble = f"; {len(warnings)} warning{'s' * (len(warnings) > 1)} below" if warnings else ""
    return f"{found} of {count} cells have a value ({100 * found / count:.0f} %){trouble}."


# ---- parts


def _text(value) -> str:
    return html.escape(str(value))


def _list(lines: Sequence[str]) -> str:
    items = "\n".join(f"<li>{_text(line)}</li>" for line in lines)
    return f"<ul>\n{items}\n</ul>" if items else ""


def _image(picture: bytes) -> str:
    if not picture:
        return ""
    data = base64.b64encode(picture).decode()
    words = "Rest image, shear modulus, first Lamé constant and uncertainty of the shear modulus"
    return f'<img alt="{words}" src="data:image/png;base64,{data}">'


def _picture(result: CellMap, rest: Image | None) -> bytes:
    """Return the map's picture as PNG."""
    from ..report.picture import draw

    nothing = np.full(len(result.status), np.nan)
    arrays = {name: result.values.get(name, nothing) for name in ("Mu", "MuStd", "Lambda")}
    arrays |= {"Status": np.asarray(result.status), "Label": np.asarray(result.labels)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.png"
        draw(
            file, result.points, result.blocks, arrays, rest,
            unit=result.unit, length=result.length_unit,
        )  # fmt: skip
        return file.read_bytes()


def _made_by(made: dict) -> str:
    version = f"ElastoIdentify {made.get('elastoidentify', '')}".strip()
    return f"{version}, {made['finished']}" if made.get("finished") else version


def _provenance(made: dict) -> list[str]:
    """Return the lines of a whole provenance; of one from elsewhere what it says."""
    try:
        return provenance_lines(made)
    except (KeyError, TypeError, AttributeError):
        return [f"{key}: {json.dumps(value, default=str)}" for key, value in made.items()] or [
            "the result does not say"
        ]


def _table(result: CellMap) -> str:
    """Return the figures per label with their standard errors."""
    rows = result.report.get("labels") or []
    if not rows:
        return f"<p>{NO_TABLE}</p>"
    factor, unit = _kilopascal(result)
    size = rows[0].get("size unit") or f"{result.length_unit}{'²³'[result.dimension - 2]}"
    units = ["", "", size, "", unit, unit, unit, unit, "", ""]
    head = "".join(
        f"<th>{_text(name)}{f'<br>({_text(u)})' if u else ''}</th>"
        for name, u in zip(HEADER, units, strict=True)
    )
    body = "\n".join(
        "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in _cells(row, factor)) + "</tr>"
        for row in rows
    )
    note = (
        "± is the standard error of the label's mean, from the errors of the displacements; the "
        "spread is how much its cells differ from each other. Means are weighted with the cells' "
        "sizes. Ratios refer to "
        + _text(result.name_of(rows[0].get("reference", rows[0]["label"])))
        + "."
    )
    return (
        f'<div class="wide"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n'
        f'</table></div>\n<p class="small">{note}</p>'
    )


def _kilopascal(result: CellMap) -> tuple[float, str]:
    """Return what moduli are multiplied with, and their unit then."""
    try:
        return result.to_kilopascal, "kPa"
    except InputError:
        return 1.0, result.unit


def _cells(row: dict, factor: float) -> list[str]:
    given = bool(row.get("given"))

    def measured(name: str, scale: float = 1.0, value: str = "mean", error="standard error") -> str:
        stated = math.nan if given else scale * number(row, f"{name} {error}")
        return with_error(scale * number(row, f"{name} {value}"), stated)

    return [
        f"{row['label']} {row.get('name') or ''}".strip(),
        str(row.get("cells", "")),
        figure(number(row, "size")),
        "given" if given else f"{100 * number(row, 'determined'):.0f} %",
        measured("Mu", factor),
        figure(factor * number(row, "Mu median")),
        "" if given else figure(factor * number(row, "Mu spread")),
        measured("YoungModulus", factor),
        measured("PoissonRatio"),
        measured("Mu", value="ratio", error="ratio standard error")
        if row["label"] != row.get("reference")
        else "1",
    ]


def with_error(value: float, error: float) -> str:
    """Return value ± error for people, both to the error's second significant digit."""
    if not math.isfinite(value):
        return "–"
    if not math.isfinite(error) or error <= ROUND_OFF * abs(value):
        return figure(value)
    decimals = 1 - math.floor(math.log10(error))
    value, error = round(value, decimals), round(error, decimals)
    shown = max(decimals, 0)
    return f"{value:.{shown}f} ± {error:.{shown}f}"
