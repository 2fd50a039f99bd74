"""Which assumption the displacements prefer: the right one, or none where all are as good.

Forward data of quadratic quadrilaterals on a finer mesh (`broken`, `slipping`), noise of 1 % of the
push, one unknown per label, homogeneous tissue.
"""

import csv
import json
from functools import cache

import numpy as np
import pytest
from elastoidentify import InputError, cli
from elastoidentify.errors import Cancelled
from elastoidentify.exploration import Assumption, Tried, explore, record, summary
from elastoidentify.fem.forward import square_mesh
from elastoidentify.inverse.identify import identify
from elastoidentify.results import Status

pytest.importorskip("skfem")
import broken
import slipping

PUSHES, NOISE = ((0, -0.3), (-0.21, -0.21)), 0.003
THIN = 0.45 / 1.45  # ν of plane strain that looks like ν = 0.45 in plane stress
YOUNG = {"unknowns": "young", "poisson_ratio": 0.45}
cached = cache(broken.body)


def square(seed=0, **kind):
    """What `explore` takes of a body of :mod:`broken`."""
    kind = {"n": 8, "contrast": 1.0, "pushes": PUSHES} | kind
    body = cached(**kind)
    u = body.noisy(NOISE, seed)
    mesh = {"labels": body.labels, "reaction_nodes": body.reaction}
    return (body.points, body.cells, u, {1: (1.0, body.poisson)}), mesh


def explored(case, **options):
    (points, cells, u, known), mesh = case
    information = np.broadcast_to(np.eye(2) / NOISE**2, (*u.shape, 2))
    options = YOUNG | {"grouping": "label", "refine": 1, "information": information} | options
    return explore(points, cells, u, known, **mesh, **options)


@pytest.mark.parametrize(
    ("right", "kind"),
    [
        ("slip", {"kind": "slip"}),
        ("stretch", {"kind": "stretch"}),
        ("poisson", {"kind": "poisson", "true_poisson": 0.49}),
    ],
)
def test_the_right_assumption_is_preferred_to_a_wrong_one(right, kind):
    said = summary(explored(square(**kind)))
    assert (said["preferred"], said["as_good"]) == (right, [])
    (row,) = [row for row in said["rows"] if row["preferred"]]
    assert row["assumption"] == right
    assert row["noise"] < 0.8
    assert 0.8 < row["noise over stated"] < 1.6  # the right one explains it


def test_a_thin_body_taken_for_a_thick_one_is_noticed():
    """Its plane stress is the plane strain of another material, which was solved."""
    (points, cells, u, _), mesh = square(poisson=THIN)
    pad = {1: (1.45 / (1 + THIN), 0.45)}
    assert summary(explored(((points, cells, u, pad), mesh)))["preferred"] == "plane_stress"


def test_of_a_sound_body_nothing_is_preferred_falsely():
    said = summary(explored(square()))
    assert said["preferred"] == "given"
    assert "slip" not in said["as_good"]  # and what is wrong is not called as good
    assert "stands" in said["sentence"]


def test_bodies_that_were_said_to_slide_and_stick_are_noticed():
    body = slipping.slab(8, stuck=True, pushes=PUSHES)
    share = NOISE / np.sqrt((body.displacements**2).mean())
    mesh = {"labels": body.labels, "reaction_nodes": body.reaction}
    known = {1: (slipping.E_PAD, slipping.POISSON)}
    case = (body.points, body.cells, body.noisy(share), known), mesh
    assert summary(explored(case, slip=[(1, 2)]))["preferred"] == "stuck"


# ---- what is said


def made_up(key, noise, evidence, like, **more):
    return Tried(Assumption(key, f"it is {key}", **more), like, "", noise, evidence)


@pytest.fixture(scope="module")
def sound():
    (points, cells, u, known), mesh = square()
    return identify(
        points, cells, u, known, **mesh, **YOUNG, grouping="label", method="regularized", refine=1
    )


def test_what_the_data_do_not_tell_apart_is_said(sound):
    given = made_up("given", 1.0, 0.0, sound)
    said = summary([given, made_up("a", 0.5, 100.0, sound), made_up("b", 0.51, 95.0, sound)])
    assert (said["preferred"], said["as_good"]) == ("a", ["b"])
    assert said["sentence"].endswith("does not tell this apart from the assumption that it is b.")
    assert "2 times smaller" in said["sentence"]


@pytest.mark.parametrize(("noise", "evidence"), [(0.99, 1000.0), (0.5, 5.0)])
def test_a_gain_that_is_small_or_may_be_chance_is_no_reason(sound, noise, evidence):
    given = made_up("given", 1.0, 0.0, sound)
    assert summary([given, made_up("a", noise, evidence, sound)])["preferred"] == "given"


def test_a_preferred_assumption_is_the_first_reason_of_the_verdict(sound):
    from copy import deepcopy

    result = deepcopy(sound)
    record(result, [made_up("given", 1.0, 0.0, sound), made_up("a", 0.5, 100.0, sound)])
    assert result.report["verdict"]["level"] != "trust"
    assert "that it is a" in result.report["verdict"]["reasons"][0]
    before = deepcopy(sound)
    record(before, [made_up("given", 1.0, 0.0, sound), made_up("a", 0.99, 1.0, sound)])
    assert before.report["verdict"] == sound.report["verdict"]


def test_an_assumption_that_cannot_be_tried_says_why():
    points, _ = square_mesh(4, 4, 30.0, 30.0)
    cells = np.array([[k, k + 1, k + 6, k + 5] for k in range(19) if k % 5 != 4])
    labels = np.where(points[cells].mean(axis=1)[:, 1] > 22, 1, 2)
    held = np.isclose(points[:, 1] % 30.0, 0)
    u = np.random.default_rng(0).normal(0, NOISE, (2, len(points), 2))
    u[0, :, 1] -= points[:, 1] / 100
    u[1, :, 0] -= points[:, 1] / 100
    tried = explored(
        ((points, cells, u, {1: (1.0, 0.45)}), {"labels": labels, "reaction_nodes": held})
    )
    (slip,) = [one for one in tried if one.assumption.key == "slip"]
    assert slip.result is None
    assert "triangles" in slip.refused
    assert len(summary(tried)["rows"]) == len(tried)


@pytest.mark.parametrize("method", ["sequential", "global"])
def test_methods_that_weigh_nothing_are_refused(method):
    with pytest.raises(InputError, match="does not weigh assumptions"):
        explored(square(), method=method)


def test_progress_grows_and_cancels():
    told = []

    def progress(fraction, text):
        told.append(fraction)
        if text.startswith("slip"):
            raise Cancelled

    (points, cells, u, known), mesh = square()
    with pytest.raises(Cancelled):
        explore(
            points, cells, u, known, **mesh, **YOUNG, grouping="label", refine=1, progress=progress
        )
    assert told == sorted(told)


# ---- files


def test_explore_writes_a_table_and_a_picture_beside_those_of_the_map(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    pytest.importorskip("SimpleITK")
    from elastoidentify.vtk_io.convert import get_array, mesh_to_vtk, set_array
    from elastoidentify.vtk_io.vtu import read_mesh, write_mesh

    (points, cells, u, _), mesh = square(kind="slip")
    grid = mesh_to_vtk(points, cells)
    set_array(grid.GetCellData(), "Label", mesh["labels"].astype(np.int32))
    set_array(grid.GetPointData(), "ReactionNodes", mesh["reaction_nodes"].astype(np.uint8))
    for k, trial in enumerate(u, 1):
        set_array(grid.GetPointData(), f"Displacement_{k}", np.pad(trial, ((0, 0), (0, 1))))
    write_mesh(tmp_path / "in.vtu", grid)
    words = "--known 1:E=1,nu=0.45 --unknowns young --poisson 0.45 --group label --sub-cells 1"
    words = ["identify", str(tmp_path / "in.vtu"), *words.split(), "--explore"]
    for name, end in (("output", "vtu"), ("picture", "png"), ("table", "csv"), ("report", "json")):
        words += [f"--{name}", str(tmp_path / f"map.{end}")]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert "speaks for another assumption, that the known body slides" in out.splitlines()[0]
    with (tmp_path / "map_explored.csv").open(encoding="utf-8") as file:
        rows = {row["assumption"]: row for row in csv.DictReader(file)}
    assert rows["slip"]["preferred"] == "True"
    assert float(rows["slip"]["evidence"]) > 10
    assert float(rows["slip"]["Mu of label 2"]) == pytest.approx(1 / 2.9, rel=0.05)
    assert (tmp_path / "map_explored.png").read_bytes().startswith(b"\x89PNG")
    report = json.loads((tmp_path / "map.json").read_text(encoding="utf-8"))["identification"]
    assert report["explored"]["preferred"] == "slip"
    assert all(row["noise over stated"] is None for row in report["explored"]["rows"])
    found = read_mesh(tmp_path / "map.vtu").GetCellData()
    tissue = get_array(found, "Status") != Status.KNOWN
    assert np.median(get_array(found, "MuIfSlip")[tissue]) == pytest.approx(1 / 2.9, rel=0.05)
    # of a map that is identified anew without, nothing of it stays
    words = ["identify", str(tmp_path / "map.vtu"), *(w for w in words[2:] if w != "--explore")]
    words[words.index("--output") + 1] = str(tmp_path / "again.vtu")
    assert cli.main(words) == 0
    assert read_mesh(tmp_path / "again.vtu").GetCellData().GetArray("MuIfSlip") is None
