"""What the displacements say of a Poisson's ratio that was given, on independent forward data."""

import functools
from types import SimpleNamespace

import elastoidentify as ei
import forward
import numpy as np
import pytest
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.inverse.ratio_checks import contradicts, mean_strains
from elastoidentify.inverse.verdict import judge


@functools.cache
def _case(poisson, n=8):
    return forward.squares(n, poisson=poisson, radius=0.2)


def _identify(case, u, pad=None, young=1.0, **settings):
    labels = np.where(case.known, 1, np.where(case.from_edge < 0, 3, 2))
    settings = {"unknowns": "young", "poisson_ratio": case.poisson, "grouping": "label"} | settings
    settings["refine"] = 4
    known = {1: (young, case.poisson if pad is None else pad)}
    return ei.identify(
        case.points, case.cells, u, known, labels=labels,
        reaction_nodes=case.reaction, method="regularized", **settings,
    )  # fmt: skip


def _checks(result):
    return {row["label"]: row for row in result.report["poisson_checks"]}


def _noisy(case, seed):
    return case.noisy(0.01 * np.abs(case.displacements).max(), seed)


@pytest.mark.parametrize("poisson", [0.3, 0.45, 0.49])
def test_a_sound_body_raises_no_alarm_and_shows_the_ratio_that_it_has(poisson):
    case = _case(poisson, n=6)
    shifts = []
    for seed in range(2):
        for options in ({}, {"poisson_std": 0.05}, {"unknowns": "lambda-mu"}):
            result = _identify(case, _noisy(case, seed), **options)
            checks = _checks(result)
            assert not any(map(contradicts, checks.values())), checks
            assert set(checks) == ({1} if options else {1, 2, 3})
            shifts += [(row["shown"] - poisson) / row["std"] for row in checks.values()]
    print(f"shifts over their standard deviations: {np.round(shifts, 1)}")
    assert 0.1 < np.sqrt(np.mean(np.square(shifts))) < 1.8


@pytest.mark.parametrize(("pad", "tissue", "wrong"), [(0.40, 0.45, 1), (0.45, 0.47, 2)])
def test_a_wrong_ratio_is_found_named_and_said(pad, tissue, wrong):
    case = _case(0.45)
    options = {"poisson_std": 0.05} if wrong == 1 else {}
    result = _identify(case, _noisy(case, 1), pad, poisson_ratio=tissue, **options)
    row = _checks(result)[wrong]
    verdict = result.report["verdict"]
    print(row, verdict["sentence"])
    assert contradicts(row)
    assert row["shown"] == pytest.approx(0.45, abs=0.02)
    assert verdict["level"] != "trust"
    assert f"Poisson's ratio of label {wrong} was given as" in verdict["sentence"]


@pytest.mark.parametrize(("given", "level"), [(0.49, "trust with care"), (0.45, "do not trust")])
def test_in_plane_stress_more_than_any_material_spreads_is_said_not_blamed_on_the_ratio(
    given, level
):
    """Plane strain of ν is plane stress of ν/(1 − ν): 0.515 here, of a metal that yields, say."""
    case = _case(0.34)
    shear = 0.5 / 1.34
    result = _identify(
        case, _noisy(case, 1), given, young=2 * shear * (1 + given), poisson_ratio=given,
        plane="stress",
    )  # fmt: skip
    row, verdict = _checks(result)[2], result.report["verdict"]
    print(row, verdict["sentence"])
    assert row["shown"] == 0.5
    assert verdict["level"] == level
    if given == 0.49:
        assert 0.005 < row["beyond"] < 0.06  # one step from 0.49 goes too far
        assert "label 2 spreads sideways more than any material" in verdict["sentence"]
        truth = shear * np.where(case.from_edge < 0, 3.0, 1.0)
        np.testing.assert_allclose(result.mu, truth, rtol=0.1)


def test_the_shift_is_that_of_a_fit_with_the_ratio_free():
    """Two ways to the same ν: one step from the map with ν fixed, and the fit of both."""
    case = _case(0.45)
    u = _noisy(case, 2)
    fixed = _checks(_identify(case, u, poisson_ratio=0.455))[2]
    free = _identify(case, u, poisson_std=0.1).report["poisson"][0]
    assert free["label"] == 2
    assert fixed["shown"] == pytest.approx(free["poisson"], abs=0.005)
    assert fixed["std"] == pytest.approx(free["std"], rel=0.6)


def test_mean_strains_of_a_known_motion():
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    H = np.array([[0.02, 0.0], [0.0, -0.05]])

    problem = SimpleNamespace(
        mesh=make_mesh(points, np.array([[0, 1, 2], [0, 2, 3]])),
        labels=np.array([4, 7]),
        displacements=[points @ H.T, points @ -H.T],
    )
    rows = mean_strains(problem)
    assert [(row["label"], row["trial"]) for row in rows] == [(4, 1), (7, 1), (4, 2), (7, 2)]
    assert rows[0]["axial"] == pytest.approx(-0.05)
    assert rows[0]["lateral"] == pytest.approx(0.4)
    assert rows[1]["volume"] == pytest.approx(1.02 * 0.95 - 1)
    assert rows[2]["axial"] == pytest.approx(-0.02)


def test_the_verdict_tells_a_pad_from_tissue():
    cells = {"known": 1, "identified": 9, "not_determined": 0, "out_of_range": 0}
    report = {
        "cells": cells, "grouping": "cell", "large_push": False, "cut_nodes": 0, "lost_trials": [],
    }  # fmt: skip
    row = {"label": 1, "known": True, "given": 0.45, "shown": 0.38, "std": 0.004}
    pad = judge(report | {"poisson_checks": [row]}, False, False)
    tissue = judge(report | {"poisson_checks": [row | {"known": False}]}, False, False)
    assert (pad["level"], tissue["level"]) == ("trust with care", "do not trust")
    assert "out of the imaged plane" in pad["sentence"]
    assert "let it be estimated" in tissue["sentence"]
    sound = judge(report | {"poisson_checks": [row | {"shown": 0.46}]}, False, False)
    assert sound["level"] == "trust"
