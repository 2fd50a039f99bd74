"""What could be seen: d′ against its definition, the said diameter against fits, and the plan."""

import elastoidentify as ei
import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.imaging.image import Image
from elastoidentify.inverse import regularized, visibility
from elastoidentify.inverse.conditions import conditions
from elastoidentify.planning import balanced, plan
from elastoidentify.study import Study

pytest.importorskip("skfem")
import forward
import slipping

pytestmark = pytest.mark.usefixtures("without_model_misfit")

CENTRE = (15.0, 12.0)  # of the lesion in forward.squares


def found(case, noise, seed=1, **options):
    return ei.identify(
        case.points, case.cells, case.noisy(1.5 * noise, seed), case.materials,
        reaction_nodes=case.reaction, method="regularized", look_at=CENTRE, **options,
    )  # fmt: skip


def test_detectability_is_the_part_of_a_change_that_nothing_else_explains(monkeypatch):
    """By finite differences of the forward problem and a dense least squares fit of the rest."""
    kept = {}

    def keep(self):
        kept["fit"], self.visible = self, None

    monkeypatch.setattr(regularized._Fit, "_visibility", keep)
    found(forward.squares(6, contrast=1.0), 0.005, refine=1)
    fit = kept["fit"]
    state, misfit, rng = fit.state, fit.misfit, np.random.default_rng(0)
    lesion, whole = rng.standard_normal((2, len(fit.x), 1))
    n = fit.forward.n_free

    def seen(x, eta):
        return fit.forward.settle(x, eta).eta.T[:, fit.forward.coarse].ravel()

    base = seen(fit.x, state.eta)
    columns = []
    for k in range(n, len(state.eta)):
        for t in range(state.eta.shape[1]):
            moved = state.eta.copy()
            moved[k, t] += 1.0
            columns.append(seen(fit.x, moved) - base)
    h = 1e-5
    columns.append((seen(fit.x + h * whole[:, 0], state.eta) - base) / h)
    change = (seen(fit.x + h * lesion[:, 0], state.eta) - base) / h
    J = np.stack(columns, axis=1)
    rest = change - J @ np.linalg.lstsq(J, change, rcond=None)[0]
    expected = np.linalg.norm(rest) / fit.scale  # every component has the same error here
    got = visibility.detectability(state, misfit, fit.scale, lesion, whole, 2)
    assert got == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_a_lesion_of_the_said_size_shows_and_a_smaller_one_does_not(noise=0.02):
    """Truth: quadratic cells on a finer mesh; the size is said of a body without a lesion."""
    sound = found(forward.squares(12, contrast=1.0), noise, refine=1)
    diameter = sound.report["smallest_visible"]["here"]

    def shown(size):
        """The share of the lesion's log-contrast that the map shows, median of three draws."""
        case = forward.squares(12, contrast=2.0, radius=size / 2 / forward.SIDE)
        inside = case.young > 1
        maps = [found(case, noise, seed, refine=1).mu[inside] for seed in (1, 2, 3)]
        return np.median([np.log2(mu / case.mu[~inside][0]).mean() for mu in maps])

    assert shown(0.6 * diameter) < 0.35
    assert 0.3 < shown(diameter) < 0.9
    assert shown(1.5 * diameter) > 0.6


def test_the_report_says_what_could_be_seen_and_less_noise_shows_more():
    case = forward.squares(8, contrast=1.0)
    fine, coarse = (found(case, noise).report["smallest_visible"] for noise in (0.002, 0.02))
    assert fine["typical"] <= fine["worst"]
    assert fine["here"] < coarse["here"]


def test_in_space_no_lesion_that_the_mesh_hardly_resolves_counts_as_seen():
    """A uniform body, strained alike everywhere, with hardly any noise: d′ is huge for any size."""
    points, cells = box_mesh((4, 4, 4), (1.0, 1.0, 1.0), "tetra")
    rng = np.random.default_rng(0)
    strains = 0.01 * rng.standard_normal((3, 3, 3))
    u = points @ strains + 1e-6 * rng.standard_normal((3, *points.shape))
    pad = points[cells].mean(axis=1)[:, 2] > 0.75
    outside = ((points < 1e-9) | (points > 1 - 1e-9)).any(axis=1)
    seen = ei.identify(
        points, [("tetra", cells)], u, np.where(pad[:, None], [1.0, 0.3], np.nan),
        reaction_nodes=outside, method="regularized", unknowns="young", poisson_ratio=0.3,
    ).report["smallest_visible"]  # fmt: skip
    assert seen["here"] >= 5 / 125 ** (1 / 3) - 1e-9  # 125 nodes


def block(rigid_below=True):
    """20 × 20 pixels of 1 mm: floor 4 (if asked), tissue 2, pad 1, indenter 5 on top (y up)."""
    labels = np.full((1, 28, 28), 0, np.uint8)
    labels[0, 4:20, 4:24], labels[0, 20:24, 4:24], labels[0, 24:27, 4:24] = 2, 1, 5
    if rigid_below:
        labels[0, 1:4, 4:24] = 4
    return Image(labels)


def study(**more):
    more = {"segmentation": block(), "rigid_labels": [4, 5]} | more
    return Study(known_materials={1: (5000.0, 0.45)}, method="regularized", **more)


def test_a_plan_compares_pushes_and_edge_lengths():
    rows = plan(study(), [(5, (0, -1, 0)), (5, (0.7, -0.7, 0))], edge_lengths=[4.0, 6.0])
    assert [(row.edge_length, row.pushes) for row in rows] == [
        (length, pushes) for length in (4.0, 6.0) for pushes in ((1,), (2,), (1, 2))
    ]
    assert rows[0].cells > rows[3].cells

    def size(row):
        return np.inf if row.typical is None else row.typical

    assert size(rows[2]) <= min(size(rows[0]), size(rows[1]))
    clean, noisy = (
        plan(study(noise=s), [(5, (0, -1, 0))], edge_lengths=[4.0]) for s in (1e-3, 0.1)
    )
    assert size(clean[0]) < size(noisy[0])


def test_a_plan_without_an_edge_length_says_that_it_took_twelve_voxels():
    fine = block().array.repeat(4, axis=1).repeat(4, axis=2)
    image = Image(fine, spacing=(0.25, 0.25, 0.25))
    (row,) = plan(study(segmentation=image), [(5, (0, -1, 0))])
    assert row.edge_length == 3.0


@pytest.mark.parametrize(
    ("pushes", "more", "said"),
    [
        ([], {}, "no pushes"),
        ([(2, (0, 1, 0))], {}, "not rigid"),
        ([(5, (0, 0, 0))], {}, "not all of them zero"),
        ([(5, (0, np.nan, 0))], {}, "finite"),
        ([(5, (0, 1, 0))], {"segmentation": None}, "no segmentation"),
        ([(5, (0, 1, 0))], {"grouping": "label"}, "grouping 'cell'"),
    ],
)
def test_plans_that_cannot_be_made_are_refused(pushes, more, said):
    with pytest.raises(InputError, match=said):
        plan(study(edge_length=5.0, **more), pushes)


def test_the_command_prints_and_writes_the_plan(tmp_path, capsys):
    from elastoidentify.cli import main
    from elastoidentify.imaging.io import write_image

    write_image(tmp_path / "labels.nrrd", block())
    words = ["--known", "1:E=5000,nu=0.45", "--rigid", "4", "--rigid", "5", "--edge-length", "4"]
    words += ["--push", "5:0,-1,0", "--at", "14,10,0", "--table", str(tmp_path / "plan.csv")]
    assert main(["plan", "--segmentation", str(tmp_path / "labels.nrrd"), *words]) == 0
    assert "smallest lesion" in capsys.readouterr().out
    assert "smallest lesion" in (tmp_path / "plan.csv").read_text()
    assert main(["plan", "--segmentation", str(tmp_path / "labels.nrrd"), *words[:-6]]) == 2


def test_a_planned_push_slides_where_labels_do():
    """Against scikit-fem: an arched pad that slides on tissue, in linear triangles."""
    body = slipping.slab(n=8, surface=slipping.arched, exact=True)
    young = np.where(body.labels == slipping.PAD_LABEL, slipping.E_PAD, slipping.E_TISSUE)
    young = np.where(body.inside, slipping.CONTRAST, 1) * young
    mesh = make_mesh(body.points, body.cells)
    there = conditions(mesh, body.reaction, labels=body.labels, slip=[(1, 2)])
    for u in body.displacements:
        wanted = np.where(body.reaction[:, None], u, 0.0)
        found = balanced(mesh, *lame_from_young(young, slipping.POISSON), there, wanted)
        np.testing.assert_allclose(found, u, atol=1e-5 * np.abs(u).max())


def test_a_plan_knows_that_a_pad_that_slides_takes_no_tissue_along():
    """Pushed along its flat underside it moves as a whole: nothing is seen in the tissue."""
    (stuck,), (sliding,) = (
        plan(study(edge_length=4.0, noise=0.003, slip=slip), [(5, (1, 0, 0))])
        for slip in ([], [(1, 2)])
    )
    assert stuck.typical is not None
    assert sliding.typical is None
