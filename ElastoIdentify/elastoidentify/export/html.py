"""One page per case: verdict, pictures, table, warnings, provenance; one file, no network needed."""

import base64
import math
import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from ..errors import InputError
from ..imaging.io import check_outputs, write_whole
from ..report.sentences import provenance_lines, report_lines
from ..report.table import ROUND_OFF
from ..report.terminal import figure

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.45 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1b1f24;
       max-width: 62rem; margin: 1.5rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0 0 .3rem; }
h2 { font-size: 1.05rem; margin: 1.4rem 0 .4rem; }
.verdict { font-size: 1.1rem; border-left: .35rem solid #2c7fb8; background: #f0f6fa;
           padding: .6rem .9rem; margin: .8rem 0; }
.verdict.caution { border-color: #d98200; background: #fdf6e9; }
figure { margin: .8rem 0; }
figure img { max-width: 100%; height: auto; }
figcaption { color: #57606a; font-size: .9rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #d8dee4;
         white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
thead th { border-bottom: 2px solid #1b1f24; }
.made { font-size: .8rem; color: #57606a; overflow-wrap: anywhere; }
@media print { body { margin: 0; max-width: none; } h2 { break-after: avoid; } }
"""


def write_html(
    path: str | os.PathLike,
    report: Mapping,
    rows: Sequence[Mapping],
    *,
    title: str = "Stiffness map",
    verdict: str = "",
    pictures: Sequence[tuple[str, str | os.PathLike | bytes]] = (),
    warnings: Sequence[str] | None = None,
    provenance: Mapping | None = None,
    length: str = "mm",
    informed: bool = False,
) -> None:
    """Write the page of a case, whole or not at all.

    Parameters
    ----------
    path : path
        .html or .htm.
    report : mapping
        The IdentificationReport: method, noise, misfit, warnings.
    rows : sequence of mappings
        The table of labels, see :func:`~elastoidentify.inverse.statistics.label_statistics`.
    title : str
    verdict : str
        One sentence on how far the map can be trusted; by default :func:`verdict_of`.
    pictures : sequence of (caption, PNG file or its bytes)
        Embedded.
    warnings : sequence of str, optional
        Of all steps; by default the report's.
    provenance : mapping, optional
        See :func:`~elastoidentify.provenance.provenance`.
    length : str
        Unit of the displacements.
    informed : bool
        See :func:`~elastoidentify.report.sentences.report_lines`.

    Raises
    ------
    InputError
        Another suffix, a picture that is missing or no PNG, a folder that cannot be written to.
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{path}: name a file that ends in .html")
    check_outputs([path])
    warnings = list(report.get("warnings", []) if warnings is None else warnings)
    sentence = verdict or verdict_of(rows, warnings)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="verdict{" caution" if warnings else ""}">{escape(sentence)}</p>',
        *(_figure(caption, picture) for caption, picture in pictures),
        *_table(rows),
        *_list("Warnings" if warnings else "", warnings),
        *_list("How it was found", report_lines(dict(report), informed, length)),
        *_list("How it was made", provenance_lines(provenance) if provenance else [], "made"),
    ]
    text = "\n".join(
        ["<!DOCTYPE html>", '<html lang="en">', "<head>", '<meta charset="utf-8">',
         '<meta name="viewport" content="width=device-width, initial-scale=1">',
         '<meta name="generator" content="ElastoIdentify">',
         f"<title>{escape(title)}</title>", f"<style>{STYLE}</style>", "</head>", "<body>",
         *parts, "</body>", "</html>", ""]
    )  # fmt: skip
    write_whole(Path(path), lambda part: part.write_text(text, encoding="utf-8"))


def verdict_of(rows: Sequence[Mapping], warnings: Sequence[str] = ()) -> str:
    """Return one sentence: what was found, how well, and whether there is something to read.

    Parameters
    ----------
    rows : sequence of mappings
        The table of labels.
    warnings : sequence of str
    """
    sought = [row for row in rows if not row.get("given")]
    found = [row for row in sought if math.isfinite(_number(row, "Mu mean"))]
    if not found:
        start = "No label's stiffness could be determined"
    else:
        errors = [_number(row, "Mu standard error") / _number(row, "Mu mean") for row in found]
        worst = max((error for error in errors if math.isfinite(error)), default=math.nan)
        size = sum(_number(row, "size") for row in sought)
        part = sum(_number(row, "size") * _number(row, "determined") for row in sought)
        names = "label" if len(sought) == 1 else "labels"
        start = f"The stiffness of {len(found)} of {len(sought)} {names} was found"
        if size > 0:
            start += f", in {100 * part / size:.0f} % of their size"
        if math.isfinite(worst):
            start += f"; the standard error of a label's mean is at most {figure(100 * worst, 2)} %"
    many = len(warnings)
    end = {0: "no warnings", 1: "1 warning, to be read first"}.get(
        many, f"{many} warnings, to be read first"
    )
    return f"{start}; {end}."


def _figure(caption: str, picture) -> str:
    if not isinstance(picture, bytes):
        try:
            picture = Path(picture).read_bytes()
        except OSError as error:
            raise InputError(f"{picture}: cannot be read ({error.strerror})") from None
    if not picture.startswith(b"\x89PNG"):
        raise InputError(f"picture {caption!r}: is no PNG, which a page can hold")
    data = base64.b64encode(picture).decode("ascii")
    words = escape(caption)
    return (
        f'<figure><img alt="{words}" src="data:image/png;base64,{data}">'
        f"<figcaption>{words}</figcaption></figure>"
    )


def _table(rows: Sequence[Mapping]) -> list[str]:
    """Return the table of labels: values with ± their standard error."""
    if not rows:
        return []
    unit = _in_brackets(rows[0].get("unit"))
    size = _in_brackets(rows[0].get("size unit"))
    header = [
        "Label", f"Size{size}", "Found", f"μ{unit}", f"Median{unit}", f"Spread{unit}", f"E{unit}",
        "ν", "μ ratio",
    ]  # fmt: skip
    head = "".join(f"<th>{escape(one)}</th>" for one in header)
    body = [
        "<tr>" + "".join(f"<td>{escape(one)}</td>" for one in _cells(row)) + "</tr>" for row in rows
    ]
    return [
        "<h2>Per label</h2>",
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>',
        *body,
        "</tbody></table></div>",
        '<p class="made">± is the standard error of the label\'s mean; the spread is from cell to '
        "cell.</p>",
    ]


def _in_brackets(unit) -> str:
    return f" ({unit})" if unit else ""


def _cells(row: Mapping) -> list[str]:
    given = bool(row.get("given"))
    share = _number(row, "determined")
    return [
        f"{row.get('label', '')} {row.get('name') or ''}".strip(),
        figure(_number(row, "size")),
        "given" if given else (f"{100 * share:.0f} %" if math.isfinite(share) else ""),
        _with_error(row, "Mu", given),
        figure(_number(row, "Mu median")),
        "" if given else figure(_number(row, "Mu spread")),
        _with_error(row, "YoungModulus", given),
        _with_error(row, "PoissonRatio", True),
        _pair(_number(row, "Mu ratio"), _number(row, "Mu ratio standard error")),
    ]


def _with_error(row: Mapping, quantity: str, given: bool) -> str:
    error = math.nan if given else _number(row, f"{quantity} standard error")
    return _pair(_number(row, f"{quantity} mean"), error)


def _pair(value: float, error: float) -> str:
    text = figure(value)
    return f"{text} ± {figure(error)}" if error > ROUND_OFF * abs(value) else text


def _number(row: Mapping, key: str) -> float:
    value = row.get(key)
    return math.nan if value in (None, "") else float(value)


def _list(heading: str, lines: Sequence[str], kind: str = "") -> list[str]:
    if not lines:
        return []
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return [f"<h2>{escape(heading)}</h2>", f'<ul class="{kind}">{items}</ul>']
