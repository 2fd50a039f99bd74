"""The same inputs give the same numbers, bit for bit: Python, VTK filter, command line."""

import numpy as np
import pytest
from elastoidentify import pipeline
from elastoidentify.cli import main
from elastoidentify.filters import LameIdentification, PushingPhantom
from elastoidentify.results import QUANTITIES
from elastoidentify.study import Study
from elastoidentify.vtk_io import convert
from elastoidentify.vtk_io.arrays import read_report, write_label_mesh
from elastoidentify.vtk_io.vtu import read_mesh, write_mesh

OPTIONS = {"method": "regularized", "kinematics": "neo-hookean", "unit": "kPa"}
PAD = (1, 5.0, 0.43)


@pytest.fixture(scope="module")
def pushed():
    """A block under noisy displacements that come with their information."""
    phantom = PushingPhantom(resolution=8, noise=2e-5, kinematics="neo-hookean")
    phantom.Update()
    grid = phantom.GetOutput()
    n = grid.GetNumberOfPoints()
    rows = np.tile([1.0, 2.0, 1.0, 0.2, 0.0, 0.0], (n, 1)) / 4e-10
    for number in (1, 2):
        convert.set_array(grid.GetPointData(), f"DisplacementInformation_{number}", rows)
    return grid


def arrays(grid):
    return {name: convert.get_array(grid.GetCellData(), name) for name in (*QUANTITIES, "Status")}


def same(one, other):
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


def test_filter_command_line_and_python_give_the_same_bits(pushed, tmp_path):
    by_filter = LameIdentification(known_materials=[PAD], **OPTIONS)(pushed)
    same(arrays(by_filter), arrays(LameIdentification(known_materials=[PAD], **OPTIONS)(pushed)))

    write_mesh(tmp_path / "in.vtu", pushed)
    words = ["--known", "1:E=5,nu=0.43", "--method", "regularized", "--unit", "kPa"]
    words += ["--kinematics", "neo-hookean", "-o", str(tmp_path / "out.vtu")]
    assert main(["identify", str(tmp_path / "in.vtu"), *words]) == 0
    by_command = read_mesh(tmp_path / "out.vtu")
    same(arrays(by_filter), arrays(by_command))

    points = pushed.GetPointData()
    result = pipeline.identify_mesh(
        Study(known_materials=[PAD], **OPTIONS),
        convert.mesh_points(pushed),
        convert.mesh_blocks(pushed)[0],
        np.stack([convert.get_array(points, f"Displacement_{k}") for k in (1, 2)]),
        labels=convert.get_array(pushed.GetCellData(), "Label"),
        reaction_nodes=convert.get_array(points, "ReactionNodes").astype(bool),
        outer_border=convert.get_array(points, "OuterBorder").astype(bool),
        information=pipeline.to_matrices(
            np.stack([convert.get_array(points, f"DisplacementInformation_{k}") for k in (1, 2)])
        ),
    )
    by_python = {name: getattr(result, one.field) for name, one in QUANTITIES.items()}
    same(by_python | {"Status": result.status}, arrays(by_filter))

    tables = [read_report(grid, "identification")["labels"] for grid in (by_filter, by_command)]
    assert tables[0] == tables[1]
    assert [row["Mu mean"] for row in tables[0]] == [row["Mu mean"] for row in result.statistics]


def test_every_output_of_the_command_line_says_how_it_was_made(pushed, tmp_path, capsys):
    import csv
    import json

    write_mesh(tmp_path / "in.vtu", pushed)
    outputs = {word: tmp_path / f"o.{kind}" for word, kind in (
        ("--output", "vtu"), ("--table", "csv"), ("--picture", "png"), ("--report", "json")
    )}  # fmt: skip
    words = [str(word) for pair in outputs.items() for word in pair]
    assert main(["identify", str(tmp_path / "in.vtu"), "--known", "1:E=5,nu=0.43", *words]) == 0
    made = read_report(read_mesh(outputs["--output"]), "provenance")
    row = next(csv.DictReader(outputs["--table"].open(encoding="utf-8")))
    assert json.loads(row["provenance"]) == made
    assert json.loads(outputs["--report"].read_text())["provenance"] == made
    from PIL import Image

    assert json.loads(Image.open(outputs["--picture"]).text["Description"]) == made
    assert made["options"]["known_materials"] == [[1, 5.0, 0.43]]
    assert made["inputs"]["mesh"]["name"] == "in.vtu"
    capsys.readouterr()
    assert main(["info", str(outputs["--output"])]) == 0
    said = capsys.readouterr().out
    assert made["inputs"]["mesh"]["sha256"] in said and "known_materials: 1, 5.0, 0.43" in said
    assert "edge_length" not in said  # of the mesh nothing is known


def test_the_provenance_says_the_edge_length_that_was_taken():
    from elastoidentify.imaging.image import Image
    from elastoidentify.study import Study

    labels = np.zeros((3, 40, 60), np.uint8)
    labels[:, 10:40, 12:48], labels[:, 10:20, 12:48] = 2, 1
    study = Study(segmentation=Image(labels, spacing=(0.5, 0.5, 0.25)), slice_axis="k",
                  known_materials=[(1, 5.0, 0.45)], method="regularized")  # fmt: skip
    mesh = pipeline.make_mesh(study)
    height = mesh.points[:, 1].max() - mesh.points[:, 1]
    u = 0.02 * np.stack([np.stack([0 * height, height, 0 * height], 1), mesh.points * [-1, 0, 0]])
    outcome = pipeline.run(study, displacements=u)
    assert outcome.provenance["options"]["edge_length"] == 6.0  # twelve pixels of the slice
    assert study.edge_length == 0.0


def test_a_mesh_that_says_nothing_of_its_making_is_no_result(tmp_path, capsys):
    from elastoidentify.imaging.image import Image
    from elastoidentify.imaging.meshing import mesh_segmentation

    labels = np.zeros((1, 20, 20), np.uint8)
    labels[0, 4:16, 4:16] = 1
    write_mesh(tmp_path / "m.vtu", write_label_mesh(mesh_segmentation(Image(labels), 4.0)))
    assert main(["info", str(tmp_path / "m.vtu")]) == 2
    assert "no result of ours" in capsys.readouterr().err
