"""Volumes near incompressibility; truth from quadratic bricks on another mesh (cube.py)."""

import elastoidentify as ei
import numpy as np
import pytest
from cube import CONTRAST, PAD, inside, truth
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh, solve_push
from elastoidentify.linalg.factor import CHOICE, Factoriser, Pardiso, factorisation
from elastoidentify.linalg.fronts import Fronts
from elastoidentify.linalg.ldl import QuasiDefiniteSolver
from scipy import linalg

pytestmark = pytest.mark.usefixtures("without_model_misfit")


class Cube:
    def __init__(self, kind="tetra", n=8, poisson=0.495, noise=0.02, seed=1):
        self.points, cells = box_mesh((n,) * 3, (1.0,) * 3, kind)
        self.cells, self.poisson = [(kind, cells)], poisson
        u = truth(8, poisson).at(self.points)
        self.noise = noise * np.abs(u).max()
        self.u = u + self.noise * np.random.default_rng(seed).standard_normal(u.shape)
        centre = self.points[cells].mean(axis=1)
        self.known = centre[:, 2] > PAD
        self.young = np.where(inside(centre, "box"), CONTRAST, 1.0)
        self.labels = np.where(self.known, 3, np.where(self.young > 1, 2, 1))
        self.ends = (self.points[:, 2] < 1e-9) | (self.points[:, 2] > 1 - 1e-9)

    def identify(self, **settings):
        return ei.identify(
            self.points, self.cells, self.u,
            np.where(self.known[:, None], [1.0, self.poisson], np.nan), labels=self.labels,
            method="regularized", unknowns="young", poisson_ratio=self.poisson,
            reaction_nodes=self.ends, **settings,
        )  # fmt: skip

    def medians(self, result):
        tissue = (self.young == 1) & ~self.known
        return np.median(result.young[self.young > 1]), np.median(result.young[tissue])


def test_labels_in_tetrahedra_are_right_at_0_495_where_plain_cells_are_off_by_factors():
    cube = Cube()
    result = cube.identify(grouping="label")
    inclusion, tissue = cube.medians(result)
    locked, _ = cube.medians(cube.identify(grouping="label", element="linear"))
    print(f"inclusion {inclusion:.2f}, tissue {tissue:.3f}; plain cells {locked:.1f}")
    assert inclusion == pytest.approx(3, rel=0.08)
    assert tissue == pytest.approx(1, rel=0.04)
    assert locked > 6
    assert result.report["noise_found"] == pytest.approx(cube.noise, rel=0.15)
    error = np.abs(np.log(result.young / cube.young))[~cube.known]
    assert (error < 2 * (result.mu_std / result.mu)[~cube.known]).mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
def test_a_map_per_cell_and_its_standard_deviations_hold_near_incompressibility(kind):
    cube = Cube(kind)
    result = cube.identify()
    error = np.abs(result.young / cube.young - 1)[~cube.known]
    within = np.abs(np.log(result.young / cube.young)) < 2 * result.mu_std / result.mu
    print(
        f"{cube.medians(result)}, mean error {error.mean():.3f}, {within[~cube.known].mean():.1%}"
    )
    assert error.mean() < 0.08  # 0.11: the flat guess
    assert within[~cube.known].mean() > 0.9


def test_the_same_volume_gives_the_same_map_whatever_makes_the_factors(monkeypatch):
    cube = Cube(n=4)
    cube.u = cube.u[:2]  # fewer trials, the same factors
    first, second = cube.identify(), cube.identify()
    np.testing.assert_array_equal(first.young, second.young)
    np.testing.assert_array_equal(first.mu_std, second.mu_std)
    monkeypatch.setattr(Factoriser, "__call__", _dense)
    other = cube.identify()
    unknown = ~cube.known
    apart = np.abs(first.mu - other.mu)[unknown]
    # steps end at a tolerance: cells that hardly anything determines may end a little elsewhere
    assert np.median(apart / first.mu[unknown]) < 0.005
    assert (apart < 0.5 * first.mu_std[unknown]).all()


def _dense(self, matrix):
    """Factors that share nothing with ours, symmetric as conjugate gradients want them."""

    class Dense:
        def __init__(self):
            self.factor = linalg.cho_factor(matrix.toarray())

        def solve(self, right):
            return linalg.cho_solve(self.factor, right)

    return Dense()


KINDS = {"fronts": Fronts, "superlu": QuasiDefiniteSolver, "pardiso": Pardiso}
needs_pardiso = pytest.mark.skipif(
    factorisation() != "pardiso", reason='PARDISO: pip install ".[fast]"'
)


@pytest.mark.parametrize("name", ["fronts", pytest.param("pardiso", marks=needs_pardiso)])
@pytest.mark.parametrize("definite", [True, False])
def test_every_factoriser_solves_as_superlu_does(name, definite):
    import scipy.sparse as sp

    n = 2000
    A = sp.diags([4.0, -1.0, -1.0, 0.5, 0.5], [0, 1, -1, 40, -40], (n, n), format="csr")
    if not definite:
        signs = sp.diags(np.where(np.arange(n) % 3, 1.0, -1.0))
        A = (A.multiply(0.05) + 4 * signs).tocsr()
    places = np.column_stack([np.arange(n) % 40, np.arange(n) // 40]).astype(float)
    right = np.random.default_rng(0).standard_normal((n, 3))
    found = {}
    for one in (name, "superlu"):
        factoriser = Factoriser(places, definite)
        factoriser.name = one
        factors = factoriser(A)
        assert isinstance(factors, KINDS[one])
        assert factors.entries > 0
        found[one] = factors.solve(right)
        np.testing.assert_array_equal(factors.solve(right), found[one])
        assert np.abs(A @ found[one] - right).max() < 1e-10
        assert factors.solve(right[:, 0]).shape == (n,)
        other = factoriser(A + A)  # in the order that was found
        np.testing.assert_allclose(other.solve(right), found[one] / 2, atol=1e-10)
    np.testing.assert_allclose(found[name], found["superlu"], atol=1e-10)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_fronts_solve_quasi_definite_systems_like_the_fits(scale):
    """Against dense LAPACK: blocks of both signs, an unknown coupled to all, all in one place."""
    import scipy.sparse as sp

    random = np.random.default_rng(1)
    p, m = 300, 500
    P = sp.diags([2.5, -1.0, -1.0], [0, 1, -1], (p, p))
    S = scale * sp.diags([4.0, 1.0, 1.0, -0.5, -0.5], [0, 1, -1, 25, -25], (m, m))
    R = sp.random(m, p, 0.004, random_state=random).tolil()
    R[:, 0] = 0.1
    A = sp.bmat([[P, R.T], [R, -S]], format="csc")
    right = random.standard_normal((p + m, 2))
    expected = np.linalg.solve(A.toarray(), right)
    for places in (random.uniform(size=(p + m, 2)), np.zeros((p + m, 2))):
        factors = Factoriser(places, definite=False)(A)
        assert isinstance(factors, Fronts)
        np.testing.assert_allclose(factors.solve(right), expected, rtol=1e-6, atol=1e-8)


def test_a_factoriser_takes_other_numbers_and_other_zeros_of_its_pattern():
    """With entries left out the plan of the fronts is kept, with others it is made anew."""
    import scipy.sparse as sp

    n, random = 600, np.random.default_rng(2)
    factoriser, plans = Factoriser(random.uniform(size=(n, 2))), []
    factoriser.name = "fronts"
    for step, shift in ((1, 1), (1, 1), (2, 1), (7, 1), (1, 5), (3, 1)):
        off = random.uniform(0.1, 1.0, n - shift) * (np.arange(n - shift) % step == 0)
        A = sp.diags([off, 3.0, off], [-shift, 0, shift], (n, n), format="csr")
        A.eliminate_zeros()
        x = random.standard_normal(n)
        factors = factoriser(A)
        assert isinstance(factors, Fronts)
        np.testing.assert_allclose(factors.solve(A @ x), x, rtol=1e-10)
        plans.append(factoriser.plan)
    assert all(plan is plans[0] for plan in plans[:4])
    assert plans[3] is not plans[4] is not plans[5]


def test_a_body_that_buckles_is_left_to_superlu():
    """Its matrix is symmetric, but some pivots have the wrong sign."""
    import scipy.sparse as sp

    A = sp.diags([1.0, 2.0, 2.0], [0, 1, -1], (400, 400), format="csc")
    x = np.linspace(-1, 1, 400)
    factors = Factoriser(np.arange(400.0)[:, None])(A)
    assert isinstance(factors, QuasiDefiniteSolver)
    np.testing.assert_allclose(A @ factors.solve(A @ x), A @ x, atol=1e-6)


def test_the_environment_can_ask_for_superlu(monkeypatch):
    monkeypatch.setenv(CHOICE, "superlu")
    factorisation.cache_clear()
    assert Factoriser(np.zeros((10_000, 3))).name == "superlu"
    factorisation.cache_clear()


def test_a_singular_matrix_is_refused():
    import scipy.sparse as sp

    with pytest.raises(RuntimeError):
        Factoriser(np.zeros((3, 1)))(sp.diags([1.0, np.nan, 1.0], format="csr"))


@pytest.mark.parametrize("law", ["neo-hookean", "st-venant-kirchhoff"])
def test_a_finite_push_of_the_same_cells_is_read_in_space(law):
    points, cells = box_mesh((4, 4, 4), (1.0,) * 3, "hexahedron")
    centre = points[cells].mean(axis=1)
    stiff, pad = inside(centre, "box"), centre[:, 2] > PAD
    moduli = lame_from_young(np.where(stiff, 3.0, 1.0), 0.4)
    ends = (points[:, 2] == 0) | (points[:, 2] == 1)
    moved = np.flatnonzero(ends)
    on_top = points[moved, 2:] > 0.5
    u = np.array([
        solve_push(points, cells, *moduli, moved, on_top * np.array(push), kinematics=law)
        for push in ((0, 0, -0.1), (0.06, 0, -0.07))
    ])  # fmt: skip
    u += 1e-4 * np.random.default_rng(0).standard_normal(u.shape)
    known, noise = np.where(pad[:, None], [1.0, 0.4], np.nan), {}
    for kinematics in (law, "small-strain"):
        result = ei.identify(
            points, cells, u, known, kinematics=kinematics, reaction_nodes=ends, grouping="label",
            labels=np.where(pad, 3, np.where(stiff, 2, 1)), method="regularized",
            unknowns="young", poisson_ratio=0.4, element="linear",
        )  # fmt: skip
        noise[kinematics] = result.report["noise_found"]
        if kinematics == law:
            assert np.median(result.young[stiff]) == pytest.approx(3, rel=0.02)
            assert np.median(result.young[~stiff & ~pad]) == pytest.approx(1, rel=0.01)
    assert noise[law] == pytest.approx(1e-4, rel=0.2)
    assert noise["small-strain"] > 5 * noise[law]  # the wrong law does not fit, and it shows
