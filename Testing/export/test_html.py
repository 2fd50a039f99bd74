"""The page of a case: whole in itself, true to the result, safe with any name."""

import html
import re
from base64 import b64decode
from html.parser import HTMLParser

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.export.cell_map import CellMap
from elastoidentify.export.html import verdict, with_error, write_html
from elastoidentify.fem.forward import square_mesh
from elastoidentify.imaging.image import Image
from elastoidentify.provenance import provenance
from elastoidentify.study import Study

pytest.importorskip("matplotlib", reason="needs matplotlib: pip install .[all]")

ROWS = [
    {
        "label": 1, "name": "pad", "given": True, "cells": 4, "size": 25.0, "determined": 1.0,
        "Mu mean": 1724.1, "Mu standard error": 0.0, "YoungModulus mean": 5000.0,
        "PoissonRatio mean": 0.45, "Mu ratio": 0.9, "reference": 2, "size unit": "mm²",
    },
    {
        "label": 2, "name": "tissue <b>", "given": False, "cells": 28, "size": 175.0,
        "determined": 0.875, "Mu mean": 1934.56, "Mu median": 1900.0, "Mu spread": 210.0,
        "Mu standard error": 43.21, "YoungModulus mean": 5610.2,
        "YoungModulus standard error": 125.3, "PoissonRatio mean": 0.4499,
        "PoissonRatio standard error": 0.0123, "Mu ratio": 1.0, "reference": 2,
    },
]  # fmt: skip


class Page(HTMLParser):
    """Text, table cells and references of a page; every tag must be closed."""

    VOID = ("meta", "img", "br")

    def __init__(self, text):
        super().__init__()
        self.open, self.cells, self.words, self.references = [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.references += [v for k, v in attributes if k in ("src", "href", "srcset", "action")]
        if tag not in self.VOID:
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


def case(**more):
    points, cells = square_mesh(4, 4, 10.0, 20.0)
    points = np.column_stack([points, np.zeros(len(points))])
    mu = np.linspace(1500.0, 2500.0, len(cells))
    status = np.where(np.arange(len(cells)) % 8 == 0, 0, 2)
    report = {
        "labels": ROWS, "method": "regularized", "kinematics": "neo-hookean", "trials": 2,
        "unknowns": "young", "grouping": "label", "warnings": ["few nodes", "few nodes"],
    }  # fmt: skip
    made = provenance(Study(), {"rest": {"name": "a&b.nrrd", "sha256": "00ff"}}, 3.0)
    values = {"Mu": mu, "MuStd": 0.1 * mu, "Lambda": 9 * mu}
    labels = 1 + (np.arange(len(cells)) >= 4)
    return CellMap(
        points, [("triangle", cells)], values, status, labels, provenance=made, report=report | more
    )


def written(tmp_path, result, rest=None, **more):
    write_html(tmp_path / "case.html", result, rest, **more)
    return (tmp_path / "case.html").read_text(encoding="utf-8")


def test_the_page_has_figures_with_errors_warnings_and_provenance(tmp_path):
    text = written(tmp_path, case(), title="Case <7>", warnings=["blurred"])
    page = Page(text)
    words = " ".join(page.words)
    cells = page.cells[10:]
    assert page.cells[4] == "μ(kPa)" and page.cells[2] == "size(mm²)"
    assert cells[10:] == [
        "2 tissue <b>", "28", "175", "88 %", "1.935 ± 0.043", "1.90", "0.210", "5.61 ± 0.13",
        "0.450 ± 0.012", "1",
    ]  # fmt: skip
    assert cells[3] == "given" and cells[4] == "1.72" and cells[9] == "0.900"
    assert "Case <7>" in words and "blurred" in words and "a&b.nrrd, SHA-256 00ff" in words
    assert words.count("few nodes") == 1 and "Warnings (2)" in words
    assert "method: regularized, neo-hookean, 2 trials" in words


def test_the_page_refers_to_nothing_outside_of_itself(tmp_path):
    rest = Image(np.random.default_rng(0).uniform(size=(1, 30, 20)), (-2, -2, 0), (0.7, 0.8, 1))
    text = written(tmp_path, case(), rest)
    (picture,) = Page(text).references
    kind, data = picture.split(",", 1)
    assert kind == "data:image/png;base64" and b64decode(data)[:8] == b"\x89PNG\r\n\x1a\n"
    assert not re.search(r"https?://|<script|url\(", text)


def test_the_verdict_is_the_reports_own_or_how_much_was_found(tmp_path):
    said = {"level": "do not trust", "sentence": "Not <b>!", "reasons": ["the pad slips", "ν"]}
    assert verdict(case(verdict=said)) == "Not <b>!"
    page = written(tmp_path, case(verdict=said))
    assert page.count("Not &lt;b&gt;!") == 1 and '<p class="verdict bad">' in page
    assert "<li>the pad slips</li>" in page
    assert verdict(case()) == "28 of 32 cells have a value (88 %)."
    assert verdict(case(), ["a", "b"]).endswith("(88 %); 2 warnings below.")


def test_values_and_errors_end_at_the_same_digit():
    assert with_error(1234.567, 12.34) == "1235 ± 12"
    assert with_error(0.45, 0.0012) == "0.4500 ± 0.0012"
    assert with_error(1234.567, 1234.0) == "1200 ± 1200"
    assert with_error(5000.0, 1e-9) == "5000"
    assert with_error(5.0, float("nan")) == "5.00"
    assert with_error(float("nan"), 1.0) == "–"


def test_noise_is_said_in_the_measure_that_it_has(tmp_path):
    assert "0.700 mm per displacement component" in written(tmp_path, case(noise_scale=0.7))
    text = written(tmp_path, case(noise_scale=0.7), informed=True)
    assert "0.700 × what the images' information predicts" in html.unescape(text)


def test_a_map_from_elsewhere_has_a_page_too(tmp_path):
    result = case()
    result.report, result.provenance, result.unit = {}, {}, "stone"
    text = written(tmp_path, result)
    assert "no figures per label" in text and "the result does not say" in text


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"\.html"):
        write_html(tmp_path / "case.pdf", case())
    assert list(tmp_path.iterdir()) == []
