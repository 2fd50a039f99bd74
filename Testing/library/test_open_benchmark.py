"""The open benchmark: scores against closed forms, every file complete, the quick subset runs."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("skfem")
BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
from open_benchmark import methods, problems, run, scores  # noqa: E402
from open_benchmark.problem import Case, Estimate, Truth  # noqa: E402


def row_of_cells(n=12):
    """A row of quads: two known cells, then a soft half and a half three times as stiff."""
    x, y = np.meshgrid(np.arange(n + 1.0), [0.0, 1.0])
    a = np.arange(n)
    cells = np.column_stack([a, a + 1, a + n + 2, a + n + 1])
    known = np.where(a[:, None] < 2, [1.0, 0.3], np.nan)
    points, nobody = np.column_stack([x.ravel(), y.ravel()]), np.zeros(2 * n + 2, bool)
    case = Case(points, "quad", cells, np.zeros((1, 2 * n + 2, 2)), nobody, known, 0.3)
    stiff = a >= n // 2 + 1
    regions = {"lesion": stiff, "background": ~stiff & (a >= 2)}
    return case, Truth(np.where(stiff, 3.0, 1.0), np.full(n, 0.3), regions)


def test_the_truth_has_no_error_and_full_marks():
    case, truth = row_of_cells()
    found = scores.score(case, truth, Estimate(truth.young, 0.1 * truth.young))
    lesion = found["regions"]["lesion"]
    assert found["rms"] == found["median_error"] == 0
    assert found["coverage"] == found["found"] == lesion["dice"] == 1
    assert lesion["contrast"] == lesion["true_contrast"] == 3
    assert lesion["cnr"] is None  # no spread at all


def test_what_is_left_open_counts_as_the_flat_guess_and_is_said():
    case, truth = row_of_cells()
    nothing = scores.score(case, truth, Estimate(np.full(12, np.nan), np.full(12, np.nan)))
    flat = scores.score(case, truth, Estimate(np.ones(12)))
    assert nothing["rms"] == flat["rms"] == pytest.approx(np.sqrt(np.mean([0] * 5 + [1] * 5)))
    assert (nothing["found"], flat["found"]) == (0, 1)
    assert nothing["coverage"] is flat["coverage"] is None
    assert flat["regions"]["lesion"]["dice"] == 0


def test_a_negative_modulus_is_as_wrong_as_can_be_and_no_more():
    case, truth = row_of_cells()
    assert scores.score(case, truth, Estimate(np.full(12, -5.0)))["rms"] == 2


def test_coverage_counts_two_standard_deviations():
    case, truth = row_of_cells()
    off = truth.young * np.where(np.arange(12) % 2, 1.19, 1.21)
    assert scores.score(case, truth, Estimate(off, 0.1 * truth.young))["coverage"] == 0.5


@pytest.mark.parametrize("name", problems.NAMES)
def test_a_problem_says_where_it_comes_from(name):
    problem = problems.load(name)
    assert problem.TITLE and len(problem.SOURCE) > 80 and callable(problem.make)
    assert problem.QUICK is None or problem.QUICK in problem.LEVELS
    assert set(getattr(problem, "PUBLISHED", {})) <= set(problem.LEVELS)


@pytest.mark.parametrize("name", methods.NAMES)
def test_a_method_says_how_it_is_run(name):
    method = methods.load(name)
    assert method.TITLE and method.SOURCE and callable(method.estimate)


def test_the_strain_image_is_exact_where_the_force_is_the_same_everywhere():
    case, truth = row_of_cells()
    stretch = np.concatenate([[0], np.cumsum(0.01 / truth.young)])
    u = np.column_stack([np.tile(stretch, 2), np.zeros(26)])
    pulled = Case(case.points, "quad", case.cells, u[None], case.reaction, case.known, 0.3, axis=0)
    found = methods.load("strain_image").estimate(pulled)
    np.testing.assert_allclose(found.young, truth.young, rtol=1e-12)


@pytest.mark.slow
def test_the_quick_subset_runs_and_the_regularized_fit_comes_first(tmp_path, monkeypatch):
    monkeypatch.delenv("ELASTOIDENTIFY_TORCH_FEM_PYTHON", raising=False)
    out = tmp_path / "results.json"
    run.main(["--quick", "--out", str(out)])
    results = json.loads(out.read_text())
    for name, levels in results.items():
        ((_, found),) = levels.items()
        rms = {method: one["rms"] for method, one in found.items() if "rms" in one}
        assert {"sequential", "global_all", "regularized", "strain_image", "flat_guess"} == set(rms)
        assert min(rms, key=rms.get) == "regularized", (name, rms)
        assert "ELASTOIDENTIFY_TORCH_FEM_PYTHON" in found["torch_fem_direct"]["skipped"]
        assert found["regularized"]["forward_solves"] > 1
        assert found["regularized"]["machine"]["cores"] >= 1
    assert results["inclusion"]["1.7 %"]["regularized"]["rms"] < 0.081  # half of OpenQSEI's


def test_the_page_is_made_of_the_results_that_are_kept():
    results = json.loads(run.RESULTS.read_text(encoding="utf-8"))
    text = (BENCHMARKS.parents[1] / "docs" / "open-benchmark.md").read_text(encoding="utf-8")
    for name, levels in results.items():
        assert f"## {problems.load(name).TITLE}" in text
        for found in levels.values():
            for one in found.values():
                assert "rms" not in one or f"| {one['rms']:.3f} |" in text
