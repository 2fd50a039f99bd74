"""Poisson's ratio found together with the map: forward data from quadratic cells, finer mesh."""

import functools

import elastoidentify as ei
import forward
import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.fem.elastic_constants import lame_from_young, plane_stress_lambda
from elastoidentify.fem.forward import box_mesh, solve_push, square_mesh
from elastoidentify.inverse import poisson
from elastoidentify.inverse.parameterization import LogParameters, make_unknowns

pytestmark = pytest.mark.usefixtures("without_model_misfit")


def _identify(case, u, given, std, **settings):
    settings = {"method": "regularized", "refine": 1} | settings
    return ei.identify(
        case.points, case.cells, u, case.materials, reaction_nodes=case.reaction,
        unknowns="young", poisson_ratio=given, poisson_std=std, **settings,
    )  # fmt: skip


@functools.cache
def _small():
    return forward.squares(6)


def _unknowns(plane_stress=False, labels=(0, 5, 5, 7, 7)):
    """One known cell and four unknown ones of two labels."""
    known = np.arange(5) == 0
    young, nu = np.where(known, 2.0, np.nan), np.where(known, 0.3, np.nan)
    made = make_unknowns(young, nu, plane_stress=plane_stress, poisson_ratio=0.45)
    return poisson.free(made, 0.45, 0.05, np.array(labels))


@pytest.mark.parametrize("value", [-0.999, -0.3, 0.0, 0.45, 0.499, 0.49999])
def test_the_ratio_is_bent_at_its_ends_only(value):
    q = poisson.unbent(value)
    nu, slope = poisson.ratio(q)
    step = 1e-7
    (after, _), (before, _) = poisson.ratio(q + step), poisson.ratio(q - step)
    assert nu == pytest.approx(value, abs=1e-12)
    assert slope == pytest.approx((after - before) / (2 * step), rel=1e-5)
    if -0.95 < value < 0.47:
        assert (q, slope) == pytest.approx((value, 1.0), abs=1e-6)


def test_no_parameter_leads_out_of_what_a_stable_material_may_have():
    nu, slope = poisson.ratio(np.array([-1e3, -1.5, 0.6, 1e3]))
    assert ((nu >= -1) & (nu <= 0.5) & (slope >= 0)).all()


@pytest.mark.parametrize("plane_stress", [False, True])
def test_moduli_and_slopes_are_those_of_young_and_poisson(plane_stress):
    parameters = poisson.parameters(
        _unknowns(plane_stress), np.random.default_rng(0).random((5, 2))
    )
    x = parameters.start + np.array([0.3, -0.2, 0.1, 0.5, 0.7, -1.0])
    lam, mu = parameters.moduli(x)
    nu = 0.45 + 0.05 * np.array([0.7, 0.7, -1.0, -1.0])
    E = np.exp(x[:4])
    true_lam, true_mu = lame_from_young(E, nu)
    if plane_stress:
        true_lam = plane_stress_lambda(true_lam, true_mu)
    np.testing.assert_allclose(lam[1:], true_lam, rtol=2e-4)
    np.testing.assert_allclose(mu[1:], true_mu, rtol=1e-5)
    steps = 1e-6 * np.eye(6)
    by_difference = np.array(
        [np.subtract(parameters.moduli(x + h), parameters.moduli(x - h)) / 2e-6 for h in steps]
    )
    for slope, expected in zip(
        parameters.slopes(x), np.moveaxis(by_difference, 0, -1), strict=True
    ):
        np.testing.assert_allclose(slope.toarray(), expected, rtol=1e-6, atol=1e-7)


def test_known_cells_keep_their_ratio_and_without_labels_there_is_one():
    unknowns = _unknowns(labels=(5, 5, 5, 7, 7))
    parameters = poisson.parameters(unknowns, np.zeros((5, 2)))
    lam, mu = parameters.moduli(parameters.start + 1.0)
    assert (lam[0], mu[0]) == pytest.approx(lame_from_young(2.0, 0.3))
    assert unknowns.ratio.labels.tolist() == [5, 7]
    alone = poisson.free(unknowns, 0.45, 0.05, None)
    assert poisson.parameters(alone, np.zeros((5, 2))).n == 5


def test_without_width_nothing_changes():
    case = _small()
    u = case.noisy(0.02, seed=0)
    labels = np.where(case.known, 1, 2)
    fixed = _identify(case, u, 0.43, None, labels=labels)
    zero = _identify(case, u, 0.43, 0.0, labels=labels)
    for name in ("lam", "mu", "young", "poisson", "mu_std", "poisson_std"):
        np.testing.assert_array_equal(getattr(fixed, name), getattr(zero, name))
    centres = case.points[case.cells].mean(axis=1)
    assert type(poisson.parameters(make_unknowns(*case.materials.T), centres)) is LogParameters


@pytest.mark.parametrize(
    ("true", "given"),
    [
        (0.495, 0.45),
        *(pytest.param(*pair, marks=pytest.mark.slow)
          for pair in ((0.45, 0.40), (0.45, 0.47), (0.49, 0.45))),
    ],
)  # fmt: skip
def test_the_lesion_is_found_though_poissons_ratio_was_given_wrong(true, given):
    case = forward.squares(10, poisson=true, radius=0.2)
    noise = 0.02 * np.abs(case.displacements).max()
    u, again = (case.noisy(noise, seed) for seed in (1, 2))
    free, redrawn = (_identify(case, noisy, given, 0.05) for noisy in (u, again))
    inside, far = case.from_edge < -1, (case.from_edge > 3) & ~case.known
    contrast = [np.median(r.mu[inside]) / np.median(r.mu[far]) for r in (free, redrawn)]
    (found,) = free.report["poisson"]
    flat = np.median(np.abs(case.mu[far][0] / case.mu[inside] - 1))
    print(
        f"ν {true} given {given}: contrast {contrast[0]:.2f}, {contrast[1]:.2f} for 3, "
        f"ν {found['poisson']:.4f} ± {found['std']:.4f}; flat guess off by {flat:.0%}"
    )
    assert np.mean(contrast) == pytest.approx(3, rel=0.2)
    assert (free.mu[far] < 1.25 * np.median(free.mu[far])).mean() > 0.97  # no false lesion
    assert abs(found["poisson"] - true) < 3 * found["std"] + 0.001
    assert free.poisson[~case.known] == pytest.approx(found["poisson"], abs=1e-9)
    assert free.poisson[case.known] == pytest.approx(true, abs=1e-12)
    assert np.abs(free.young / case.young - 1)[far].mean() < 0.1


def test_each_label_has_its_own_ratio():
    """Labels of ν 0.45 and 0.3 side by side, in small strain as in plane stress."""
    points, cells = square_mesh(10, 10, 30.0, 30.0)
    centre = points[cells].mean(axis=1)
    label = np.where(centre[:, 1] > 22.5, 1, np.where(centre[:, 0] > 15, 3, 2))
    nu, young = np.array([0, 0.4, 0.45, 0.3])[label], np.array([0, 1.0, 1.0, 2.0])[label]
    ends = (points[:, 1] == 0) | (points[:, 1] == 30)
    moved = np.flatnonzero(ends)
    for plane in ("strain", "stress"):
        lam, mu = lame_from_young(young, nu)
        if plane == "stress":
            lam = plane_stress_lambda(lam, mu)
        u = [
            solve_push(points, cells, lam, mu, moved, np.where(points[ends, 1:] == 30, push, 0.0))
            for push in ((0, -1.0), (-0.7, -0.7))
        ]
        u = np.array(u) + 0.002 * np.random.default_rng(0).standard_normal((2, len(points), 2))
        result = ei.identify(
            points, cells, u, {1: (1.0, 0.4)}, labels=label, reaction_nodes=ends, plane=plane,
            unknowns="young", poisson_ratio=0.4, poisson_std=0.1, grouping="label", refine=1,
            element="linear",
        )  # fmt: skip
        rows = {row["label"]: row for row in result.report["poisson"]}
        for one, true in ((2, 0.45), (3, 0.3)):
            print(plane, one, rows[one])
            assert abs(rows[one]["poisson"] - true) < 3 * rows[one]["std"]
            assert rows[one]["std"] < 0.05
            row = next(r for r in result.statistics if r["label"] == one)
            assert row["PoissonRatio mean"] == pytest.approx(rows[one]["poisson"])
            assert row["PoissonRatio standard error"] == pytest.approx(rows[one]["std"], rel=1e-6)
        assert result.report["auto"].startswith("regularized")


def test_what_the_data_do_not_tell_stays_as_it_was_given():
    """With hardly any information ν keeps the prior's centre and its width."""
    case = _small()
    result = _identify(case, case.noisy(1e-4, 0), 0.43, 0.05, noise=100.0)
    (row,) = result.report["poisson"]
    assert (row["poisson"], row["std"]) == pytest.approx((0.43, 0.05), rel=0.35)


def _coverage(n, seeds):
    case = forward.squares(n, poisson=0.45, radius=0.25)
    size = 0.01 * np.abs(case.displacements).max()
    labels = np.where(case.known, 1, np.where(case.from_edge < 0, 3, 2))
    rows = [
        _identify(
            case, case.noisy(size, seed), 0.43, 0.05, labels=labels, grouping="label", noise=size,
            refine=4,
        ).report["poisson"]
        for seed in range(seeds)
    ]  # fmt: skip
    value, std = (
        np.array([[one[key] for one in row] for row in rows]) for key in ("poisson", "std")
    )
    return value, std


@pytest.mark.slow
def test_standard_deviations_of_the_ratio_are_the_scatter_of_repeated_measurements():
    value, std = _coverage(8, seeds=24)
    scatter, stated = value.std(axis=0, ddof=1), std.mean(axis=0)
    within = (np.abs(value - 0.45) < 2 * std).mean(axis=0)
    print(f"scatter {scatter}, stated {stated}, within two standard deviations {within}")
    assert (0.65 * scatter < stated).all()
    assert (stated < 2.5 * scatter).all()
    assert (within >= 0.87).all()


@pytest.mark.slow
def test_in_space_too():
    points, cells = box_mesh((4, 4, 5), (30.0, 30.0, 30.0))
    centre = points[cells].mean(axis=1)
    inside = np.linalg.norm(centre - [15, 15, 12], axis=1) < 8
    young, known = np.where(inside, 3.0, 1.0), centre[:, 2] > 24
    lam, mu = lame_from_young(young, 0.47)
    ends = (points[:, 2] == 0) | (points[:, 2] == 30)
    moved = np.flatnonzero(ends)
    u = [
        solve_push(points, cells, lam, mu, moved, np.where(points[ends, 2:] == 30, push, 0.0),
                   kinematics="neo-hookean")
        for push in ((0, 0, -1.5), (1.1, 0, -1.1), (0, 1.1, -1.1))
    ]  # fmt: skip
    u = np.array(u) + 0.01 * np.random.default_rng(0).standard_normal((3, len(points), 3))
    result = ei.identify(
        points, cells, u, np.where(known[:, None], [1.0, 0.47], np.nan), reaction_nodes=ends,
        unknowns="young", poisson_ratio=0.43, poisson_std=0.05, method="regularized",
        kinematics="neo-hookean", element="linear",
    )  # fmt: skip
    (row,) = result.report["poisson"]
    print(row, np.median(result.young[inside]))
    assert abs(row["poisson"] - 0.47) < 3 * row["std"]
    assert np.median(result.young[inside]) == pytest.approx(3, rel=0.2)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"unknowns": "lambda-mu"}, "'lambda-mu' leave Poisson's ratio free"),
        ({"method": "sequential"}, "'sequential' cannot estimate"),
        ({"method": "global"}, "'global' cannot estimate"),
        ({"poisson_std": 0.4}, "between 0"),
        ({"poisson_std": -0.1}, "between 0"),
        ({"poisson_std": np.nan}, "between 0"),
        ({"poisson_ratio": None}, "need Poisson's ratio"),
    ],
)
def test_combinations_that_cannot_be_are_refused(settings, words):
    case = _small()
    settings = {"unknowns": "young", "poisson_ratio": 0.43, "poisson_std": 0.05} | settings
    with pytest.raises(InputError, match=words):
        ei.identify(
            case.points, case.cells, case.displacements, case.materials,
            reaction_nodes=case.reaction, **settings,
        )  # fmt: skip


def test_a_ratio_far_from_the_one_given_is_said():
    row = {"label": 2, "poisson": 0.31, "std": 0.01, "given": 0.45, "given_std": 0.03}
    assert "label 2 comes out as 0.310 ± 0.010" in poisson.far_warnings([row])[0]
    assert not poisson.far_warnings([row | {"poisson": 0.40}])
