"""Where a registration cannot know, it says so: lost nodes, nodes out of view, edges of contact."""

import threading
import time

import numpy as np
import pytest
from elastoidentify.errors import Cancelled, InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration import together
from elastoidentify.imaging.registration.correlation import (
    carried_displacement,
    refine_displacement,
)
from elastoidentify.imaging.registration.information import contact_edge, strain_spread
from elastoidentify.imaging.registration.registration import NOT_SEEN, SIX, register
from elastoidentify.progress import silent
from hosts import has_elastix
from scipy import ndimage

SHAPE = (96, 112)


def triangles(low, high, step=12.0):
    """Points (n, 2) of a rectangle and its triangles."""
    x, y = (np.linspace(a, b, round((b - a) / step) + 1) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    number = np.arange(len(points)).reshape(len(y), len(x))
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    return points, np.stack([[a, b, c], [a, c, d]]).reshape(2, 3, -1).transpose(0, 2, 1).reshape(
        -1, 3
    )


def speckle(seed=0):
    values = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(SHAPE), 1.6)
    return 100 + 20 * values / values.std()


def squeeze(points):
    """A smooth displacement (n, 2): down by up to 6 pixels at the top, 3 pixels to the right."""
    return np.column_stack([0 * points[:, 0] + 3.0, 6.0 * (1 - points[:, 1] / SHAPE[0])])


class KnownElastix:
    """Answers like elastix, but knows the displacement; misplaces points by `miss` px at `lost`."""

    def __init__(self, rest, pushed, lost=None, miss=0.0):
        self.rest, self.pushed, self.lost, self.miss = rest, pushed, lost, miss

    def register(self, fixed, moving, spacing, maps, points, *, warp=True, **_):
        j, i = np.mgrid[: SHAPE[0], : SHAPE[1]]
        grid = np.column_stack([i.ravel(), j.ravel()]).astype(float)
        if np.array_equal(fixed, self.rest):
            mapped, there = points + squeeze(points), grid + squeeze(grid)
            if self.lost is not None:
                mapped[self.lost, 0] += self.miss
        else:
            mapped, there = (p - squeeze(inverse(p)) for p in (points, grid))
        if not warp:
            return mapped, None
        warped = ndimage.map_coordinates(moving, there.T[::-1], order=3, mode="nearest")
        gone = ((there < -0.5) | (there > np.array(SHAPE[::-1]) - 0.5)).any(1)
        return mapped, np.where(gone, NOT_SEEN, warped).reshape(SHAPE).astype(np.float32)


def inverse(points):
    """Where each of the points came from."""
    origin = points
    for _ in range(50):
        origin = points - squeeze(origin)
    return origin


def pair(noise=1.0):
    """Rest and pushed image, float32."""
    j, i = np.mgrid[: SHAPE[0], : SHAPE[1]]
    grid = np.column_stack([i.ravel(), j.ravel()]).astype(float)
    rest, random = speckle(), np.random.default_rng(1)
    pushed = ndimage.map_coordinates(rest, inverse(grid).T[::-1], order=3, mode="mirror")
    images = rest, pushed.reshape(SHAPE)
    return [(one + noise * random.standard_normal(SHAPE)).astype(np.float32) for one in images]


def found_by(elastix, points, cells, **options):
    world = np.column_stack([points, 0 * points[:, 0]])
    images = Image(elastix.rest), [Image(elastix.pushed)]
    return register(*images, world, cells, elastix=elastix, **options)


def matrices(information):
    """(n, 2, 2) of (n, 6)."""
    full = np.zeros((len(information), 3, 3))
    for component, (a, b) in enumerate(SIX):
        full[:, a, b] = full[:, b, a] = information[:, component]
    return full[:, :2, :2]


def test_nodes_that_the_two_registrations_place_apart_lose_their_weight_and_follow_others():
    points, cells = triangles((16, 12), (88, 84))
    lost = np.linalg.norm(points - [52, 48], axis=1) < 13
    found = found_by(KnownElastix(*pair(), lost, 9.0), points, cells)
    figures = found.report["trials"][0]
    assert figures["nodes_disagreeing"] == lost.sum() == 5
    assert (found.disagreement[0][lost] > 8).all() and (found.disagreement[0][~lost] < 0.1).all()
    assert not found.information[0][lost].any()
    assert (np.linalg.eigvalsh(matrices(found.information[0][~lost]))[:, 0] > 10).all()
    error = np.linalg.norm(found.displacements[0][:, :2] - squeeze(points), axis=1)
    assert error.max() < 0.3
    (warning,) = found.report["warnings"]
    assert warning.startswith("Trial 1: 5 mesh nodes") and "1 pixel apart" in warning


def test_a_disagreement_of_less_than_a_pixel_is_a_variance():
    points, cells = triangles((16, 12), (88, 84))
    lost = np.linalg.norm(points - [52, 48], axis=1) < 5
    one_way, both_ways = (
        found_by(KnownElastix(*pair(), lost, 0.6), points, cells, backward=backward)
        for backward in (False, True)
    )
    figures = both_ways.report["trials"][0]
    assert figures["nodes_disagreeing"] == 0 and not both_ways.report["warnings"]
    before, after = (
        np.linalg.inv(matrices(one.information[0])[lost][0]) for one in (one_way, both_ways)
    )
    assert np.allclose(after - before, 0.6**2 / 4 * np.eye(2), rtol=1e-6)


def test_nodes_that_leave_the_pushed_image_are_carried_on_with_an_honest_error():
    points, cells = triangles((39.5, 12), (111.5, 84))
    found = found_by(KnownElastix(*pair()), points, cells)
    leaving = points[:, 0] > 108.6
    figures = found.report["trials"][0]
    assert figures["nodes_leaving"] == leaving.sum() == 7 and figures["nodes_disagreeing"] == 0
    assert figures["similarity_after"] > 0.98
    assert figures["noise"] == pytest.approx(1.0, rel=0.2)  # not what is missing beyond the border
    error = found.displacements[0][:, :2] - squeeze(points)
    weight = matrices(found.information[0])
    chi = np.einsum("na,nab,nb->n", error, weight, error) / 2
    assert chi[leaving].mean() < 2 and np.abs(error).max() < 1.0
    assert (
        np.linalg.eigvalsh(weight)[~leaving, 0].min()
        > 4 * np.linalg.eigvalsh(weight)[leaving].min()
    )
    assert any("7 mesh nodes leave the pushed image" in text for text in found.report["warnings"])


def test_the_second_step_is_not_misled_by_what_has_left_the_image():
    points, cells = triangles((39.5, 12), (111.5, 84))
    rest, pushed = pair(noise=0.0)
    found = refine_displacement(rest, pushed, points, cells, squeeze(points))
    assert np.abs(found - squeeze(points)).max() < 0.2


def test_a_uniform_strain_is_carried_on_exactly():
    points, cells = triangles((0, 0), (60, 48))
    gradient = np.array([[0.02, -0.05], [0.03, -0.04]])
    exact = points @ gradient.T + [1.0, -2.0]
    inner = ((points > 0) & (points < [60, 48])).all(1) & (points[:, 0] < 40)
    wrong = np.where(inner[:, None], exact + 7.0, exact)
    assert np.allclose(carried_displacement(points, cells, wrong, ~inner), exact, atol=1e-5)
    apart = np.vstack([points, points + 100.0])  # a second body in which nothing is known
    both = np.vstack([cells, cells + len(points)])
    trusted = np.concatenate([~inner, np.zeros(len(points), bool)])
    found = carried_displacement(apart, both, np.vstack([wrong, exact]), trusted)
    assert np.allclose(found, np.vstack([exact, exact]), atol=1e-5)


def test_the_strain_that_ends_at_a_rigid_body_counts_as_a_change_of_strain():
    points, cells = triangles((0, 0), (60, 48))
    gradient = np.array([[0.02, -0.05], [0.03, -0.04]])
    touched = np.isclose(points[:, 1], 0)
    spread = strain_spread(points, cells, points @ gradient.T, touched) / (gradient**2).sum()
    ends = touched & np.isin(points[:, 0], [0, 60])
    assert np.array_equal(np.flatnonzero(ends), contact_edge(cells, touched))
    assert np.allclose(spread[touched & ~ends], 1) and np.allclose(spread[ends], 9)
    assert np.allclose(spread[~touched], 0)


def test_reaction_nodes_of_another_mesh_are_refused():
    points, cells = triangles((16, 12), (88, 84))
    with pytest.raises(InputError, match="reaction_nodes has 3 values"):
        found_by(KnownElastix(*pair()), points, cells, reaction_nodes=np.ones(3))


# ---- several at once


def test_trials_in_several_processes_give_what_one_gives(monkeypatch):
    points, cells = triangles((16, 12), (88, 84))
    rest, pushed = pair()
    started = []

    def start(progress):
        started.append(KnownElastix(rest, pushed))
        started[-1].close = lambda: started.append("closed")
        return started[-1]

    monkeypatch.setattr(together, "ElastixProcess", start)
    world = np.column_stack([points, 0 * points[:, 0]])
    images = Image(rest), [Image(pushed), Image(pushed[::-1]), Image(pushed)]
    seen = []
    found = [
        register(*images, world, cells, workers=n, progress=lambda f, text: seen.append(f))
        for n in (1, 3)
    ]
    for name in ("displacements", "information", "disagreement"):
        assert np.array_equal(*(getattr(one, name) for one in found))
    assert found[0].report == found[1].report
    assert started.count("closed") * 2 == len(started) >= 4


def test_tasks_run_at_once_and_tell_their_progress_in_one_voice():
    here, told = threading.Barrier(2, timeout=20), []

    def task(progress):
        progress(0.5, "half")
        here.wait()  # both are running, or this fails
        return threading.get_ident()

    found = together.run_together([task, task], 2, lambda *what: told.append(what))
    assert len(set(found)) == 2 and threading.get_ident() not in found
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0


@pytest.mark.parametrize("who", ["the user", "a task"])
def test_one_who_stops_stops_all(who):
    stopped = []

    def endless(progress):
        try:
            while True:
                progress(0.1, "working")
                time.sleep(0.01)
        except Cancelled:
            stopped.append(True)
            raise

    def failing(progress):
        time.sleep(0.1)
        raise InputError("no")

    def cancel(fraction, text):
        if text:
            raise Cancelled

    tasks, progress = ([endless] * 2, cancel) if who == "the user" else ([endless, failing], silent)
    with pytest.raises(Cancelled if who == "the user" else InputError):
        together.run_together(tasks, 2, progress)
    assert stopped


def test_a_failing_forward_registration_ends_the_backward_one_too():
    class Failing(KnownElastix):
        def register(self, *arguments, **options):
            raise InputError("elastix could not register the images")

    points, cells = triangles((16, 12), (88, 84))
    with pytest.raises(InputError, match="could not register"):
        found_by(Failing(*pair()), points, cells)


def test_volumes_use_the_cores_and_slices_do_not():
    assert together.engines_for(2, 3, None) == 1
    assert 1 <= together.engines_for(3, 3, None) <= 3
    assert together.engines_for(2, 3, 2) == 2 and together.engines_for(3, 1, 9) == 2


# ---- with elastix


def cropped(image, rows, columns):
    """The part of a planar image without so many rows and columns at both ends."""
    array = image.array[:, rows : image.array.shape[1] - rows, columns:-columns]
    origin = image.index_to_world(np.array([[columns, rows, 0]]))[0]
    return Image(array, origin, image.spacing, image.direction)


@pytest.mark.slow
@pytest.mark.skipif(not has_elastix(), reason='pip install "elastoidentify[registration]"')
def test_errors_at_plates_and_at_a_border_that_cuts_the_tissue_are_as_large_as_stated():
    """Mean of eᵀC⁻¹e / 2 below 2 for every group of nodes; 1 is perfect."""
    pytest.importorskip("skfem")
    from elastoidentify.imaging.meshing import mesh_segmentation
    from elastoidentify.imaging.phantom import make_phantom
    from elastoidentify.workers.elastix_client import ElastixProcess

    phantom = make_phantom(pixels=112, elements=40, pushes=[(0.035, 0.035)], seed=3)
    images = phantom.rest, *phantom.pushed, phantom.segmentation
    cut = phantom.frame.margin[0] + 10
    with ElastixProcess() as elastix:
        for name, (rest, *pushed, labels) in {
            "whole": images,
            "cut": [cropped(image, 0, cut) for image in images],
        }.items():
            pixel = rest.spacing[0]
            mesh = mesh_segmentation(labels, 12 * pixel, rigid_labels=phantom.rigid_labels)
            found = register(
                rest, pushed, mesh.points, mesh.cells,
                reaction_nodes=mesh.reaction_nodes, elastix=elastix,
            )  # fmt: skip
            error = (found.displacements - phantom.displacements(mesh.points))[..., :2]
            held = mesh.reaction_nodes.astype(bool)
            for trial, figures in enumerate(found.report["trials"]):
                assert figures["similarity_after"] > 0.98
                weight = matrices(found.information[trial])
                chi = np.einsum("na,nab,nb->n", error[trial], weight, error[trial]) / 2
                print(name, trial, chi[held].mean(), chi[~held].mean(), figures["nodes_leaving"])
                assert chi[held].mean() < 2 and chi[~held].mean() < 2
                assert np.linalg.norm(error[trial], axis=1).max() < 1.5 * pixel
                if name == "cut":
                    assert figures["nodes_leaving"] > 5
