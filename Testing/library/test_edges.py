"""Edges of a map: no pull across them, and cells that may lie on either side."""

import elastoidentify as ei
import forward
import numpy as np
import pytest
from elastoidentify.inverse import sharpening
from elastoidentify.inverse.edges import with_edges
from elastoidentify.inverse.statistics import cell_errors


def test_a_cell_at_an_edge_may_be_of_its_other_side():
    lam, mu = np.array([4.0, 4, 12, 12]), np.array([1.0, 1, 3, 3])
    measured = cell_errors(lam, mu, 0.2 * np.ones((4, 6)), 0.1 * np.ones((4, 6)))
    both = with_edges(measured, lam, mu, np.array([[1, 2]]))
    assert both.std("Mu") == pytest.approx(np.hypot(0.1, [0, 1, 1, 0]))
    assert both.std("Lambda") == pytest.approx(np.hypot(0.2, [0, 4, 4, 0]))
    assert both.std("PoissonRatio") == pytest.approx(measured.std("PoissonRatio"))
    young = mu * (3 * lam + 2 * mu) / (lam + mu)
    edge = [0, *2 * [(young[2] - young[1]) / 2], 0]
    assert both.std("YoungModulus") == pytest.approx(np.hypot(measured.std("YoungModulus"), edge))


def test_of_several_neighbours_the_farthest_counts():
    nothing = cell_errors(*np.zeros((2, 3)) + 1.0, *np.zeros((2, 3, 4)))
    mu = np.array([1.0, 2.0, 5.0])
    both = with_edges(nothing, mu, mu, np.array([[0, 1], [0, 2], [1, 0]]))
    assert both.std("Mu") == pytest.approx([2.0, 0.5, 2.0])


def fit(case, std, seed, **options):
    return ei.identify(
        case.points, case.cells, case.noisy(std, seed), case.materials,
        reaction_nodes=case.reaction, method="regularized", unknowns="young",
        poisson_ratio=case.poisson, **options,
    )  # fmt: skip


def ratio_of(result, case):
    inside = case.from_edge < 0
    return np.mean(result.young[inside]) / np.mean(result.young[~inside & ~case.known])


@pytest.fixture(scope="module")
def weak():
    """A disc of 1.6:1, 3 % of noise, and its labels."""
    case = forward.published(contrast=1.6, edge=2.4, poisson=0.45, pushes=((0, -1.5), (1, -1)))
    labels = np.where(case.known, 1, np.where(case.from_edge < 0, 3, 2))
    return case, 0.03 * np.abs(case.displacements).max(), labels


def test_a_weak_lesion_that_is_found_has_the_contrast_of_a_fit_per_label(weak, monkeypatch):
    """Which no prior pulls at, and which has the same errors of the cells."""
    case, std, labels = weak
    seeds = (1, 2)
    alone = [ratio_of(fit(case, std, s, labels=labels, grouping="label"), case) for s in seeds]
    refitted = [ratio_of(fit(case, std, s), case) for s in seeds]
    monkeypatch.setattr(sharpening, "EDGE", np.inf)
    pulled = [ratio_of(fit(case, std, s), case) for s in seeds]
    print(f"true 1.6, per label {np.round(alone, 3)}, map {np.round(refitted, 3)}, with the pull "
          f"{np.round(pulled, 3)}, flat guess 1")  # fmt: skip
    assert refitted == pytest.approx(alone, rel=0.03)
    assert np.mean(pulled) < 0.96 * np.mean(alone)


def test_the_prior_does_not_merge_labels(weak):
    """Of this draw the map without labels is flat."""
    case, std, labels = weak
    by_label = fit(case, std, 0, labels=labels, grouping="label").statistics[-1]
    row = fit(case, std, 0, labels=labels).statistics[-1]
    value, error = row["Mu ratio"], row["Mu ratio standard error"]
    print(f"true 1.6, per label {by_label['Mu ratio']:.2f}, map {value:.2f} ± {error:.2f}")
    assert value == pytest.approx(by_label["Mu ratio"], rel=0.05)
    assert 0.6 < error / by_label["Mu ratio standard error"] < 2


@pytest.mark.parametrize("contrast", [1.5, 3.0])
def test_most_of_a_lesion_that_the_mesh_cuts_is_held_by_the_standard_deviations(contrast):
    case = forward.squares(12, contrast=contrast, radius=0.2)
    inside, held, closer = case.from_edge < 0, [], []
    for seed in range(2):
        result = fit(case, 0.01 * np.abs(case.displacements).max(), seed)
        held.append((np.abs(result.young - case.young) <= 2 * result.young_std)[inside].mean())
        closer.append(np.nanmean(np.abs(np.log(result.young / case.young))[inside]))
    print(f"{contrast}:1, within two std {held}, |log| error {np.mean(closer):.3f}, "
          f"flat guess {np.log(contrast):.3f}")  # fmt: skip
    assert np.mean(held) >= 0.85
    assert np.mean(closer) < np.log(contrast) / 2


def test_labels_say_where_an_edge_is():
    case = forward.squares(8, contrast=3.0, radius=0.25)
    std = 0.005 * np.abs(case.displacements).max()
    labels = np.where(case.known, 1, np.where(case.from_edge < 0, 3, 2))
    named = fit(case, std, 0, labels=labels).young_std
    alone = fit(case, std, 0).young_std
    centres = case.points[case.cells].mean(axis=1)
    beside = (np.abs(case.from_edge) < 2) & ~case.known & (centres[:, 1] < 20)
    assert np.median(named[beside]) < 0.5 * np.median(alone[beside])
