"""A map that is right, or says why it is not: the verdict, and meshes that were cut."""

import numpy as np
import pytest
from elastoidentify import InputError, identify
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.inverse.identify import check_input

pytest.importorskip("skfem")
import forward

NOISE = 0.01  # mm; 0.7 % of the push


@pytest.fixture(scope="module")
def case():
    return forward.squares(12)


@pytest.fixture(scope="module")
def fine():
    """Of cells that do not show beside the noise."""
    return forward.squares(16)


def border(points):
    return (np.isclose(points, 0) | np.isclose(points, forward.SIDE)).any(axis=1)


def found(case, keep=None, where=None, displacements=None, **options):
    """Identify a part of the case's cells, one unknown per label: 1 pad, 2 tissue, 3 inclusion."""
    labels = np.where(case.known, 1, np.where(case.young > 1, 3, 2))
    keep = np.ones(len(labels), bool) if keep is None else keep
    used, cells = np.unique(case.cells[keep], return_inverse=True)
    u = case.noisy(NOISE, 1) if displacements is None else displacements
    options = {
        "information": np.broadcast_to(np.eye(2) / NOISE**2, (*u[:, used].shape, 2)),
        "method": "regularized",
        "unknowns": "young",
        "poisson_ratio": case.poisson,
        "grouping": "label",
    } | options
    return identify(
        case.points[used],
        cells.reshape(-1, 3),
        u[:, used],
        {1: (1.0, case.poisson)},
        labels=labels[keep],
        reaction_nodes=case.reaction[used],
        outer_border=None if where is None else where[used],
        **options,
    )


def is_trusted(result):
    """The case's pushes are large and its data of small strain, which no fit can know."""
    reasons = [r for r in result.report["verdict"]["reasons"] if "small-strain" not in r]
    return result.report["verdict"]["level"] != "do not trust" and not reasons


def young_of(result):
    return {row["label"]: row["YoungModulus mean"] for row in result.statistics}


HALVES = {
    "right half": lambda x: x[:, 0] > 15.0,
    "left third": lambda x: x[:, 0] < 20.0,
    "a hole": lambda x: np.abs(x - (22.0, 12.0)).max(axis=1) > 3.0,
}


@pytest.mark.parametrize("part", HALVES)
def test_a_mesh_that_was_cut_gives_the_moduli_of_the_whole_and_says_so(fine, part):
    """Forward data of the whole body, quadratic cells on a finer mesh. Flat guess: 3 is 1."""
    keep = HALVES[part](fine.points[fine.cells].mean(axis=1))
    result = found(fine, keep, border(fine.points))
    young = young_of(result)
    assert abs(young[2] - 1) < 0.06
    assert abs(young[3] / 3 - 1) < 0.15
    assert any("the mesh was cut" in sentence for sentence in result.report["warnings"])
    assert result.report["verdict"]["level"] == "trust with care"
    assert result.report["verdict"]["noise_factor"] < 1.6


@pytest.mark.parametrize("part", ["right half", "left third"])
def test_a_cut_that_nothing_tells_of_is_not_trusted(case, part):
    """Without the body's border the cut counts as free of force: wrong, and the noise says so."""
    keep = HALVES[part](case.points[case.cells].mean(axis=1))
    result = found(case, keep)
    assert abs(young_of(result)[3] / 3 - 1) > 0.2
    assert result.report["verdict"]["level"] == "do not trust"
    assert "something may push at a border" in result.report["verdict"]["sentence"]


def test_a_whole_mesh_under_right_assumptions_is_trusted(fine):
    result = found(fine, where=border(fine.points))
    assert is_trusted(result)
    assert 0.5 < result.report["verdict"]["noise_factor"] < 1.4
    assert abs(young_of(result)[3] / 3 - 1) < 0.08


def test_a_wrong_poissons_ratio_is_not_trusted():
    case = forward.squares(12, poisson=0.495)
    result = found(case, poisson_ratio=0.45)
    assert result.report["verdict"]["level"] == "do not trust"
    assert "Poisson's ratio" in result.report["verdict"]["sentence"]


def test_motion_out_of_the_plane_is_not_trusted(case):
    """A stretch of 1 % across: seen in the plane as a shrinking that plane strain cannot have."""
    stretched = case.noisy(NOISE, 1) - 0.02 * (case.points - 15.0)
    result = found(case, displacements=stretched)
    assert result.report["verdict"]["level"] == "do not trust"


@pytest.mark.parametrize("pushes", [1, 2])
def test_pushes_of_one_direction_say_that_cells_cannot_be_read(pushes):
    case = forward.squares(8)
    one = case.displacements[:1] * np.arange(1, pushes + 1)[:, None, None]
    one = one + NOISE * np.random.default_rng(0).standard_normal(one.shape)
    cells = found(case, displacements=one, grouping="cell").report["verdict"]
    labels = found(case, displacements=one).report["verdict"]
    assert "one direction" in cells["sentence"]
    assert "one direction" not in labels["sentence"]


def test_a_trial_that_was_left_out_is_a_reason_for_care(case):
    information = np.broadcast_to(np.eye(2) / NOISE**2, (*case.displacements.shape, 2)).copy()
    information[1] = 0
    verdict = found(case, information=information).report["verdict"]
    assert "a trial was left out" in verdict["reasons"]


def test_noise_that_was_given_too_small_is_not_trusted(fine):
    result = found(fine, information=None, noise=NOISE / 20)
    assert result.report["verdict"]["level"] == "do not trust"
    assert result.report["verdict"]["noise_factor"] > 10
    assert is_trusted(found(fine, information=None, noise=NOISE))


def test_a_body_that_nobody_touches_is_refused_before_the_registration(case):
    labels = np.where(case.known, 1, 2)
    words = (case.points, case.cells, {1: (1.0, 0.43)})
    check_input(*words, n_trials=2, labels=labels, reaction_nodes=case.reaction)
    with pytest.raises(InputError, match="nothing touches the body"):
        check_input(*words, n_trials=2, labels=labels, reaction_nodes=0 * case.reaction)


@pytest.mark.parametrize("gap", [0, 1])
def test_a_pad_apart_from_the_tissue_is_refused_before_the_registration(gap):
    """Columns of pixels: pad below the indenter, a gap, tissue on the floor."""
    from elastoidentify.imaging.image import Image
    from elastoidentify.imaging.meshing import mesh_segmentation
    from elastoidentify.pipeline import cell_blocks

    labels = np.zeros((1, 40, 24), np.uint8)
    labels[0, 2:5, 2:22], labels[0, 5:15, 2:22], labels[0, 15 + gap : 33, 2:22] = 5, 1, 2
    labels[0, 33:36, 2:22] = 4
    made = mesh_segmentation(Image(labels), 5.0, rigid_labels=[4, 5])
    words = (made.points, cell_blocks(made.cells), {1: (1.0, 0.43)})
    more = {"n_trials": 2, "labels": made.labels, "reaction_nodes": made.reaction_nodes}
    if not gap:
        check_input(*words, **more)
        return
    with pytest.raises(InputError, match="leave no gap between the labels"):
        check_input(*words, **more)


def test_a_piece_that_nobody_touches_is_refused_though_another_one_is_touched(case):
    """Two bodies: pad and tissue, untouched; and a pad beside them that is pushed."""
    known = case.known
    n = len(case.points)
    points = np.vstack([case.points, case.points + np.array([50.0, 0.0])])
    cells = np.vstack([case.cells, case.cells[known] + n])
    labels = np.r_[np.where(known, 1, 2), np.ones(known.sum(), int)]
    reaction = np.r_[np.zeros(n, bool), case.reaction]
    with pytest.raises(InputError, match="nothing touches the body"):
        check_input(
            points, cells, {1: (1.0, 0.43)}, n_trials=2, labels=labels, reaction_nodes=reaction
        )


def test_the_meshers_border_is_that_of_the_finite_elements():
    from elastoidentify.imaging.image import Image
    from elastoidentify.imaging.meshing import mesh_segmentation

    labels = np.zeros((24, 24, 24), np.uint8)
    labels[3:21, 3:21, 3:21] = 1
    labels[9:15, 9:15, 9:15] = 2
    for segmentation in (Image(labels), Image(labels[12:13])):
        made = mesh_segmentation(segmentation, 5.0)
        points = made.points if made.cells.shape[1] == 4 else made.points[:, :2]
        mesh = make_mesh(points, [({3: "triangle", 4: "tetra"}[made.cells.shape[1]], made.cells)])
        np.testing.assert_array_equal(made.outer_border, mesh.boundary_nodes)


def test_cells_that_are_coarser_than_the_displacements_are_exact_are_not_called_a_wrong_model(fine):
    """A right model: only the cells' error is left, which the finer solution knows of."""
    noise = 0.0005
    information = np.broadcast_to(np.eye(2) / noise**2, (*fine.displacements.shape, 2))
    exact = {"displacements": fine.noisy(noise, 1), "information": information}
    verdict = found(fine, **exact).report["verdict"]
    assert verdict["noise_factor"] > 1.6
    assert verdict["level"] == "trust with care"
    assert "more exact than the cells" in verdict["sentence"]
    assert "the pad may slip" not in verdict["sentence"]
    wrong = found(fine, poisson_ratio=fine.poisson + 0.02, **exact).report["verdict"]
    assert wrong["level"] == "do not trust"
