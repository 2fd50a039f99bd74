"""Layers in simple shear keep their volume: μ follows from the shear stress, λ does not show.

The stress is the same in both layers, so that each layer's slope times its μ is, too: the closed
form that the maps are compared with.
"""

import csv
from functools import cache

import numpy as np
import pytest
from elastoidentify import identify
from elastoidentify.export.cell_map import CellMap
from elastoidentify.export.fem import filled_constants
from elastoidentify.report.table import table_text, write_table
from elastoidentify.results import Status, is_found

PAD, TISSUE = 1, 2
YOUNG, POISSON, RATIO, SLOPE = 5e3, 0.4, 3.0, 0.01
TRUE_MU = RATIO * YOUNG / (2 * (1 + POISSON))
NO_VALUE = ("lam", "lam_std", "young", "young_std", "poisson", "poisson_std")


def layers(n=6):
    """Points, cells, labels, and the displacements of one trial: the lower half is the tissue."""
    x, y = (axis.ravel() / n for axis in np.mgrid[: n + 1, : n + 1])
    points, first = np.column_stack([x, y]), (n + 1) * np.repeat(range(n), n) + np.tile(range(n), n)
    cells = first[:, None] + [0, n + 1, n + 2, 1]
    labels = np.where(points[cells].mean(axis=1)[:, 1] > 0.5, PAD, TISSUE)
    along = SLOPE * np.where(y <= 0.5, y / RATIO, 0.5 / RATIO + y - 0.5)
    return points, cells, labels, np.column_stack([along, 0 * along])


@cache
def identified(noise=0.0, stretch=0.0, **options):
    points, cells, labels, u = layers()
    edge = (np.abs(points - 0.5) == 0.5).any(axis=1)
    u = np.repeat(u[None], 3, axis=0) + noise * np.random.default_rng(0).normal(size=(3, *u.shape))
    u[1:, :, 1] += stretch * points[:, 1] * np.array([[1.0], [2.0]])
    known = {PAD: (YOUNG, POISSON)}
    return labels == TISSUE, identify(
        points, [("quad", cells)], u, known, labels=labels, reaction_nodes=edge, **options
    )


def assert_mu_alone(tissue, result):
    assert (result.status[tissue] == Status.SHEAR_ONLY).all()
    for name in NO_VALUE:
        assert np.isnan(getattr(result, name)[tissue]).all(), name
    assert (
        f"in {tissue.sum()} of {tissue.sum()} unknown cells μ alone"
        in result.report["warnings"][-1]
    )


@pytest.mark.parametrize("grouping", ["cell", "label"])
def test_exact_shear_gives_the_closed_form_for_mu_and_nothing_for_lambda(grouping):
    tissue, result = identified(method="global", grouping=grouping)
    assert_mu_alone(tissue, result)
    np.testing.assert_allclose(result.mu[tissue], TRUE_MU, rtol=1e-8)


@pytest.mark.parametrize("grouping", ["cell", "label"])
def test_noisy_shear_gives_mu_with_a_standard_deviation_that_holds(grouping):
    tissue, result = identified(1e-5, method="regularized", grouping=grouping)
    assert_mu_alone(tissue, result)
    off = np.abs(result.mu[tissue] - TRUE_MU)
    assert (off < 2 * result.mu_std[tissue]).mean() > 0.9
    assert off.max() < 0.05 * TRUE_MU < 0.1 * TRUE_MU < TRUE_MU - result.mu[~tissue].max()


def test_where_the_layers_are_squeezed_too_lambda_shows_again():
    """The status is of the data and not of the shape: the same mesh with a change of volume."""
    tissue, result = identified(1e-5, stretch=0.01, method="regularized", grouping="label")
    assert (result.status[tissue] == Status.IDENTIFIED).all()
    assert np.isfinite(result.lam[tissue]).all()


def test_the_tables_have_mu_and_no_other_constant(tmp_path):
    _, result = identified(1e-5, method="regularized", grouping="label")
    (row,) = (row for row in result.statistics if row["label"] == TISSUE)
    assert row["determined"] == pytest.approx(1.0)
    assert abs(row["Mu mean"] - TRUE_MU) < 3 * row["Mu standard error"]
    assert np.isnan([row["YoungModulus mean"], row["Lambda mean"], row["PoissonRatio mean"]]).all()
    assert "100 %" in table_text(result.statistics, "Pa").splitlines()[-1]
    write_table(tmp_path / "labels.csv", result.statistics)
    with (tmp_path / "labels.csv").open(encoding="utf-8") as file:
        found = [row for row in csv.DictReader(file) if row["label"] == str(TISSUE)]
    assert found[0]["YoungModulus mean"] == "nan" and float(found[0]["Mu mean"]) == row["Mu mean"]


def test_programs_that_need_both_constants_get_mu_and_a_mean_of_nu():
    points, cells, labels, _ = layers()
    tissue, result = identified(1e-5, method="regularized", grouping="label")
    values = {"Mu": result.mu, "YoungModulus": result.young, "PoissonRatio": result.poisson}
    solid = np.column_stack([points, 0 * points[:, 0]])
    made = CellMap(solid, [("quad", cells)], values, result.status, labels)
    assert not made.lacks("Mu").any()
    assert (made.lacks("YoungModulus") == tissue).all()
    young, poisson, (note,) = filled_constants(made, "label")
    np.testing.assert_allclose(poisson[tissue], POISSON)  # of the pad: the only one that is known
    np.testing.assert_allclose(young[tissue], 2 * (1 + POISSON) * result.mu[tissue])
    assert note == f"{tissue.sum()} cells of which μ alone is known got a mean ν"


def test_is_found_tells_quantities_apart():
    status = np.array([0, 1, 2, 3, 4])
    assert is_found(status).tolist() == [False, True, True, False, True]
    assert is_found(status, "YoungModulus").tolist() == [False, True, True, False, False]
