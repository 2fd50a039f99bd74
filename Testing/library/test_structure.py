"""A map that shows nothing but noise says so, and what it would have shown; any other does not."""

import numpy as np
import pytest
from elastoidentify import identify
from elastoidentify.inverse.verdict import CARE, DISTRUST, TRUST, judge
from elastoidentify.report.sentences import report_lines, verdict_line

pytest.importorskip("skfem")
import forward

SOUND = {
    "cells": {"not_determined": 0, "known": 10, "identified": 90, "out_of_range": 0},
    "grouping": "cell", "large_push": False, "cut_nodes": 0, "lost_trials": [],
}  # fmt: skip
SEEN = {"contrast": 2.0, "here": 5.0, "typical": 6.0, "worst": 8.0}
NOTHING = {"apart": 0.3, "within": None, "noise": 3.3}


def found(contrast, noise, seed=1, labels=False, **options):
    """Identify the cells of a square, quadratic data; `noise` as a share of the push of 1.5 mm."""
    case = forward.squares(8, contrast=contrast, radius=0.2)
    if labels:
        options["labels"] = np.where(case.known, 1, np.where(case.from_edge < 0, 3, 2))
    options = {"unknowns": "young", "poisson_ratio": case.poisson} | options
    result = identify(
        case.points, case.cells, case.noisy(1.5 * noise, seed), case.materials,
        reaction_nodes=case.reaction, method="regularized", **options,
    )  # fmt: skip
    inside = (case.from_edge < 0) & ~case.known
    tissue = (case.from_edge > 0) & ~case.known
    shown = np.nanmedian(result.young[inside]) / np.nanmedian(result.young[tissue])
    said = "Nothing but noise was found" in result.report["verdict"]["sentence"]
    print(f"{contrast}:1, {noise:.1%}: shows {shown:.2f}; {result.report['structure']}")
    return result, shown, said


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_of_a_homogeneous_body_it_is_said_and_what_would_have_shown_and_it_is_trusted(noise):
    result, shown, said = found(1.0, noise)
    assert said and shown == pytest.approx(1, abs=0.05)
    sentence = verdict_line(result.report, "mm")
    assert "equally stiff everywhere" in sentence
    assert "A lesion of 2.00 times the stiffness would" in sentence
    assert report_lines(result.report)[0] == sentence
    assert sum("times the stiffness" in line for line in report_lines(result.report)) == 1
    assert result.report["verdict"]["level"] != DISTRUST


@pytest.mark.parametrize("unknowns", ["young", "lambda-mu"])
def test_of_a_lesion_that_is_clearly_seen_it_is_not_said(unknowns):
    more = {} if unknowns == "young" else {"unknowns": unknowns, "poisson_ratio": None}
    result, shown, said = found(3.0, 0.01, **more)
    assert shown > 2 and not said
    assert result.report["structure"]["apart"] > 3 * result.report["structure"]["noise"]
    assert sum("times the stiffness" in line for line in report_lines(result.report)) == 1


def test_of_a_lesion_that_drowns_in_noise_it_is_said():
    _, shown, said = found(3.0, 0.1)
    assert shown < 1.2 and said


def test_labels_that_differ_are_told_from_structure_within_them():
    """What is left within them is the cells that the lesion's edge cuts."""
    result, shown, said = found(3.0, 0.02, labels=True)
    assert shown > 2 and not said
    assert result.report["structure"]["within"] < result.report["structure"]["apart"] / 3
    report = SOUND | {"structure": {"apart": 20.0, "within": 1.0, "noise": 3.3}}
    assert "Within the labels nothing but noise" in judge(report, False, False)["sentence"]


def test_maps_of_labels_and_of_other_methods_are_not_asked():
    for options in ({"grouping": "label", "labels": True}, {"method": "global"}):
        case = forward.squares(6, contrast=1.0)
        if options.get("labels"):
            options["labels"] = np.where(case.known, 1, 2)
        result = identify(
            case.points, case.cells, case.displacements, case.materials,
            **{"method": "regularized", "reaction_nodes": case.reaction} | options,
        )  # fmt: skip
        assert result.report.get("structure") is None
        assert result.report["verdict"]["nothing_found"] == ""


@pytest.mark.parametrize(
    ("more", "level", "sizes"),
    [
        ({"smallest_visible": SEEN}, TRUST, True),
        ({"smallest_visible": SEEN | {"typical": None, "worst": None}}, CARE, True),
        ({"smallest_visible": None}, TRUST, False),  # of volumes that are too large for it
        ({"smallest_visible": SEEN, "typical_error": 0.5}, DISTRUST, False),
    ],
)
def test_what_goes_with_the_sentence(more, level, sizes):
    report = SOUND | {"structure": NOTHING} | more
    report["verdict"] = judge(report, False, False)
    assert report["verdict"]["level"] == level
    sentence = verdict_line(report, "cm")
    assert "Nothing but noise was found" in sentence
    assert ("A lesion of 2.00 times the stiffness would" in sentence) == sizes
    if level == TRUST and sizes:
        assert sentence.endswith("from about 6.00 cm across (everywhere from 8.00).")
    if level == CARE:
        assert "hardly show a lesion, of whatever size" in sentence


def test_of_a_map_without_a_value_nothing_is_said():
    """Where no cell is determined, that it is flat is no finding."""
    cells = SOUND["cells"] | {"identified": 0, "not_determined": 90}
    verdict = judge(SOUND | {"structure": NOTHING, "cells": cells}, False, False)
    assert verdict["level"] == DISTRUST
    assert verdict["nothing_found"] == ""
