"""Repeatability figures against closed forms."""

import math

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.export.repeatability import (
    best_column,
    draw_bland_altman,
    read_rows,
    repeatability,
    repeatability_by_label,
    repeatability_text,
    write_repeatability,
)
from elastoidentify.report.table import write_table


def test_pairs_give_the_closed_form():
    # of a pair s² = d²/2, so wSD² = Σ d²/2n; a difference of 2 % of the mean in all: wCV = √2 %
    means = np.array([1000.0, 2000.0, 4000.0])
    found = repeatability(np.column_stack([0.99 * means, 1.01 * means]))
    differences = 0.02 * means
    assert found.within_sd == pytest.approx(np.sqrt((differences**2 / 2).mean()))
    assert found.rc == pytest.approx(1.96 * np.sqrt((differences**2).mean()))
    assert found.within_cv == pytest.approx(np.sqrt(2))
    assert found.rc_percent == pytest.approx(1.96 * 2)
    assert found.bias == pytest.approx(differences.mean())
    half = 1.96 * differences.std(ddof=1)
    assert (found.low, found.high) == pytest.approx((found.bias - half, found.bias + half))


def test_repeats_are_weighted_with_their_degrees_of_freedom():
    found = repeatability([[1.0, 1.0, 1.0, 1.0, 1.0], [9.0, 11.0]])
    assert found.within_sd == pytest.approx(np.sqrt((4 * 0 + 1 * 2) / 5))
    assert (found.subjects, found.measurements) == (2, 7)


def test_a_known_spread_is_found_and_lies_below_the_upper_bound():
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(200):
        truth = rng.uniform(2000, 8000, 35)
        found = repeatability(truth[:, None] * (1 + 0.05 * rng.standard_normal((35, 2))))
        inside += found.rc_percent_high > 1.96 * np.sqrt(2) * 5
    assert found.within_cv == pytest.approx(5, rel=0.3)
    assert 180 <= inside <= 200  # 95 % of 200, within 3 standard deviations


def test_nothing_measured_twice_is_refused():
    with pytest.raises(InputError, match="no subject has two values"):
        repeatability([[1.0], [2.0, np.nan]])


def test_the_core_is_compared_where_every_label_has_one():
    def tables(*cores):
        given = {"label": 1, "given": True, "Mu mean": 9.0, "Mu core": math.nan}
        return [
            [[given, {"label": 2, "given": False, "Mu mean": 2.0, "Mu core": core}]]
            for core in cores
        ]

    assert best_column(tables(2.1, "2.2")) == "Mu core"
    assert best_column(tables(2.1, "")) == "Mu mean"
    assert best_column(tables(2.1, math.nan)) == "Mu mean"
    assert best_column([[rows(1.0), rows(2.0)]]) == "Mu mean"  # a table of an earlier version


def rows(tissue, inclusion=None, unit="Pa"):
    """A table of labels with a given pad."""
    made = [
        {"label": 1, "name": "pad", "unit": unit, "given": True, "Mu mean": 1724.0},
        {"label": 2, "name": "tissue", "unit": unit, "given": False, "Mu mean": tissue},
    ]
    if inclusion is not None:
        made.append({"label": 3, "name": "", "unit": unit, "given": False, "Mu mean": inclusion})
    return made


def test_tables_and_their_files_give_the_same_figures(tmp_path):
    subjects = [[rows(99.0, 300.0), rows(101.0, 310.0)], [rows(198.0), rows(202.0)]]
    found, values, notes = repeatability_by_label(subjects)
    assert [one.name for one in found] == ["tissue", "label 3"]
    assert found[0].rc_percent == pytest.approx(1.96 * 2) and found[1].subjects == 1
    assert values[2] == [[99.0, 101.0], [198.0, 202.0]]
    assert "QIBA asks for 35" in notes[-1]
    for number, table in enumerate(t for one in subjects for t in one):
        write_table(tmp_path / f"{number}.csv", table, {"options": "x" * 200_000})
    files = [[read_rows(tmp_path / f"{2 * k + r}.csv") for r in (0, 1)] for k in (0, 1)]
    assert repr(repeatability_by_label(files)[0]) == repr(found)


def test_figures_are_written_and_drawn(tmp_path):
    rng = np.random.default_rng(2)
    subjects = [[rows(*rng.uniform(90, 110, 2)) for _ in range(3)] for _ in range(8)]
    found, values, _ = repeatability_by_label(subjects)
    assert "wCV %" in repeatability_text(found)
    write_repeatability(tmp_path / "figures.csv", found)
    assert (tmp_path / "figures.csv").read_text().splitlines()[0].startswith("label,name,quantity")
    draw_bland_altman(tmp_path / "picture.png", found, values)
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_different_units_and_other_columns_are_refused():
    with pytest.raises(InputError, match=r"different units \(Pa, kPa\)"):
        repeatability_by_label([[rows(1.0), rows(2.0, unit="kPa")]])
    with pytest.raises(InputError, match="column 'mu': no table has it; there are Mu mean"):
        repeatability_by_label([[rows(1.0), rows(2.0)]], "mu")
