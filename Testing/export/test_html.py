"""The page of a case: one file that says everything and asks for nothing."""

import base64
from html.parser import HTMLParser

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.export.html import verdict_of, write_html
from elastoidentify.fem.forward import square_mesh
from elastoidentify.report.picture import draw

VOID = {"meta", "img", "br", "hr", "link"}


class Page(HTMLParser):
    """Text, pictures and addresses of a page; fails where tags do not nest."""

    def __init__(self, text):
        super().__init__()
        self.open, self.rows, self.words, self.images, self.addresses = [], [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag == "img":
            self.images.append(attributes["src"])
        self.addresses += [value for name, value in attributes.items() if name in ("href", "src")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1].append(data)


def row(label, name, mean, error, given=False, determined=1.0):
    made = {
        "label": label, "name": name, "unit": "kPa", "size unit": "mm²", "given": given,
        "cells": 9, "size": 120.0, "determined": determined, "PoissonRatio mean": 0.45,
        "Mu ratio": mean / 2, "Mu ratio standard error": error / 2,
    }  # fmt: skip
    for quantity, factor in (("Mu", 1.0), ("YoungModulus", 2.9)):
        for figure, value in (("mean", mean), ("median", mean), ("spread", 0.2)):
            made[f"{quantity} {figure}"] = factor * value
        made[f"{quantity} standard error"] = factor * error
    return made


ROWS = [
    row(1, "pad", 1.724, 0.0, given=True),
    row(2, "tissue <b>", 2.0, 0.05, determined=0.5),
    row(3, "inclusion", 6.0, 0.6),
]
REPORT = {
    "method": "regularized", "kinematics": "neo-hookean", "trials": 2, "unknowns": "young",
    "grouping": "cell", "misfit": 1.1, "warnings": ["the misfit is large & the noise small"],
}  # fmt: skip
MADE = {
    "elastoidentify": "0.2.0", "python": "3.11", "libraries": {"numpy": "2"}, "duration_s": 3.0,
    "finished": "2026-01-01", "inputs": {"rest": {"name": "r.nrrd", "sha256": "ab12"}},
    "options": {"edge_length": 7.0},
}  # fmt: skip


def picture(folder):
    points, cells = square_mesh(4, 4)
    points = np.column_stack([points, np.zeros(len(points))])
    mu = np.linspace(1, 5, len(cells))
    arrays = {"Mu": mu, "MuStd": mu / 9, "Lambda": 9 * mu, "Status": np.full(len(mu), 2)}
    draw(folder / "map.png", points, [("triangle", cells)], arrays, unit="kPa")
    return folder / "map.png"


def test_a_page_has_everything_and_needs_nothing_else(tmp_path):
    drawn = picture(tmp_path)
    write_html(
        tmp_path / "case.html", REPORT, ROWS, title="Case <7>", provenance=MADE,
        pictures=[("Shear modulus", drawn)],
    )  # fmt: skip
    page = Page((tmp_path / "case.html").read_text(encoding="utf-8"))
    text = "".join(page.words)
    assert all(address.startswith("data:") for address in page.addresses)
    data = page.images[0].removeprefix("data:image/png;base64,")
    assert base64.b64decode(data) == drawn.read_bytes()
    header, pad, tissue, inclusion = page.rows
    assert header[3] == "μ (kPa)" and header[1] == "Size (mm²)"
    assert pad[0] == "1 pad" and "given" in pad and not any("±" in one for one in pad[:8])
    assert tissue[0] == "2 tissue <b>" and "50 %" in tissue
    assert "6.00 ± 0.600" in inclusion and "17.4 ± 1.74" in inclusion
    assert "Case <7>" in text and "misfit is large & the noise" in text
    assert "SHA-256 ab12" in text and "elastoidentify 0.2.0" in text


def test_the_verdict_is_of_the_worst_label_and_the_size_that_was_found():
    assert verdict_of(ROWS, ["one"]) == (
        "The stiffness of 2 of 2 labels was found, in 75 % of their size; the standard error of a "
        "label's mean is at most 10 %; 1 warning, to be read first."
    )
    nothing = [row(2, "tissue", np.nan, np.nan, determined=0.0)]
    assert verdict_of(nothing).startswith("No label's stiffness could be determined; no warnings")


def test_figures_that_json_made_null_stay_empty(tmp_path):
    lines = [{**ROWS[1], "Mu mean": None, "Mu standard error": None}]
    write_html(tmp_path / "case.html", REPORT, lines, verdict="My own.")
    assert "My own." in (tmp_path / "case.html").read_text(encoding="utf-8")


def test_what_no_page_can_hold_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"ends in \.html"):
        write_html(tmp_path / "case.pdf", REPORT, ROWS)
    with pytest.raises(InputError, match="is no PNG"):
        write_html(tmp_path / "case.html", REPORT, ROWS, pictures=[("a", b"GIF89a")])
    with pytest.raises(InputError, match="no.png: cannot be read"):
        write_html(tmp_path / "case.html", REPORT, ROWS, pictures=[("a", tmp_path / "no.png")])
    assert not list(tmp_path.iterdir())
