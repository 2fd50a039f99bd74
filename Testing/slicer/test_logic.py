"""The module's logic on Slicer's own MRML: same numbers as the library, wherever the image lies."""

import json
import os
from functools import partial

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")

import option_samples  # noqa: E402
import vtk  # noqa: E402
from elastoidentify import InputError, identify  # noqa: E402
from elastoidentify.errors import Cancelled  # noqa: E402
from elastoidentify.imaging.image import Image  # noqa: E402
from elastoidentify.imaging.meshing import mesh_segmentation  # noqa: E402
from elastoidentify.imaging.phantom import make_phantom_volume  # noqa: E402
from elastoidentify.imaging.phantom.planar import Inclusion, make_phantom  # noqa: E402
from elastoidentify.imaging.registration import Registration  # noqa: E402
from elastoidentify.options import keywords  # noqa: E402
from elastoidentify.pipeline import cell_blocks, known_by_label, make_mesh, run  # noqa: E402
from elastoidentify.results import QUANTITIES  # noqa: E402
from elastoidentify.study import IdentificationOptions  # noqa: E402
from elastoidentify.vtk_io.arrays import read_report  # noqa: E402
from ElastoIdentifyLib import images, outputs, parameters, sample  # noqa: E402
from ElastoIdentifyLib.request import (  # noqa: E402
    KNOWN,
    Material,
    Request,
    materials_to_text,
)
from stored_registration import only_read, stored_outcome  # noqa: E402
from vtk.util.numpy_support import vtk_to_numpy  # noqa: E402

from ElastoIdentify import (  # noqa: E402
    ElastoIdentifyLogic,
    ElastoIdentifyTest,
    loadSample,
    loadSampleVolume,
)

pytestmark = pytest.mark.usefixtures("warm")

FLIP = np.array([-1.0, -1.0, 1.0])
CELL_ARRAYS = (
    "Label",
    "Lambda",
    "Mu",
    "YoungModulus",
    "PoissonRatio",
    "LambdaStd",
    "MuStd",
    "Status",
    "SequenceOrder",
)


def cell_data(result, name):
    return slicer.util.arrayFromModelCellData(result.model, name)


def node_ids():
    nodes = slicer.mrmlScene.GetNodes()
    return sorted(nodes.GetItemAsObject(n).GetID() for n in range(nodes.GetNumberOfItems()))


def oblique_transform(name="Table"):
    turn = 0.3
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    matrix[:3, 3] = 40.0, -7.0, 3.0
    tilt = np.eye(4)
    tilt[1:3, 1:3] = [[0.8, -0.6], [0.6, 0.8]]
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", name)
    node.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(tilt @ matrix))
    return node


def test_the_modules_own_tests_pass():
    test = ElastoIdentifyTest()
    test.runTest()


def test_map_equals_the_librarys_in_lps():
    """What Slicer shows in RAS is what the library finds in the LPS world of the file."""
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    request = Request(**inputs)
    study = request.study()
    mesh = mesh_segmentation(
        in_lps(study.segmentation), study.edge_length, rigid_labels=study.rigid_labels
    )
    shifts = images.nodal_displacements(request.transforms, mesh.points * FLIP, False)
    direct = identify(
        mesh.points,
        cell_blocks(mesh.cells),
        shifts * FLIP,
        known_by_label(study),
        labels=mesh.labels,
        reaction_nodes=mesh.reaction_nodes.astype(bool),
        **keywords(study, IdentificationOptions),
    )
    grid = result.model.GetMesh()
    assert np.allclose(vtk_to_numpy(grid.GetPoints().GetData()), mesh.points * FLIP, atol=1e-9)
    assert (cell_data(result, "Status") == direct.status).all()
    for name, values in (("Mu", direct.mu), ("Lambda", direct.lam), ("YoungModulus", direct.young)):
        assert np.allclose(cell_data(result, name), values, rtol=1e-9, equal_nan=True), name
    for number, shift in enumerate(shifts, 1):
        stored = vtk_to_numpy(grid.GetPointData().GetArray(f"Displacement_{number}"))
        assert np.allclose(stored, shift, atol=1e-9)


def test_image_segmentation_and_transforms_under_a_parent_transform_give_the_same_map():
    inputs, young = sample.add_exact_push()
    plain = ElastoIdentifyLogic().process(**inputs)
    table = oblique_transform()
    for node in (inputs["restVolume"], inputs["segmentation"]):
        node.SetAndObserveTransformNodeID(table.GetID())
    # The pushes move with the table: world → table → push → world.
    matrix = slicer.util.arrayFromTransformMatrix(table)
    moved = []
    for push in inputs["transforms"]:
        chain = vtk.vtkGeneralTransform()
        chain.PostMultiply()
        chain.Concatenate(slicer.util.vtkMatrixFromArray(np.linalg.inv(matrix)))
        chain.Concatenate(push.GetTransformToParent())
        chain.Concatenate(slicer.util.vtkMatrixFromArray(matrix))
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTransformNode")
        node.SetAndObserveTransformToParent(chain)
        moved.append(node)
    result = ElastoIdentifyLogic().process(**{**inputs, "transforms": moved})
    # The triangulation may turn out another way where four nodes lie on a circle, so the answer
    # is compared with the truth and the nodes with the nodes.
    points, there = (
        vtk_to_numpy(one.model.GetMesh().GetPoints().GetData()) for one in (plain, result)
    )
    expected = (np.c_[points, np.ones(len(points))] @ matrix.T)[:, :3]
    assert np.allclose(there, expected, atol=1e-9)
    assert (
        np.bincount(cell_data(result, "Status")) == np.bincount(cell_data(plain, "Status"))
    ).all()
    truth = np.array([young[label] for label in cell_data(result, "Label")])
    assert np.allclose(cell_data(result, "YoungModulus"), truth, rtol=1e-6)


def test_a_nonlinear_parent_transform_is_refused_with_the_way_out():
    inputs, _ = sample.add_exact_push()
    inputs["restVolume"].SetAndObserveTransformNodeID(inputs["transforms"][0].GetID())
    with pytest.raises(InputError, match="harden it in the Transforms module"):
        ElastoIdentifyLogic().process(**inputs)


def test_transforms_to_rest_are_inverted():
    """A registration with the rest image fixed stores the way from pushed to rest."""
    inputs, young = sample.add_exact_push()
    inverse = []
    for push in inputs["transforms"]:
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTransformNode")
        node.SetAndObserveTransformFromParent(push.GetTransformToParent())
        inverse.append(node)
    result = ElastoIdentifyLogic().process(
        **{**inputs, "transforms": inverse, "transformsToRest": True}
    )
    truth = np.array([young[label] for label in cell_data(result, "Label")])
    found = cell_data(result, "Status") > 0
    assert found.mean() > 0.5
    assert np.abs(cell_data(result, "YoungModulus") / truth - 1)[found].max() < 1e-6


def test_the_picked_slice_of_a_volume_gives_the_map_of_that_slice():
    inputs, _ = sample.add_exact_push()
    flat = ElastoIdentifyLogic().process(**inputs)
    rest = inputs["restVolume"]
    slab = np.repeat(slicer.util.arrayFromVolume(rest), 5, axis=0)
    matrix = images.ijk_to_world(rest)
    matrix[:3, 3] -= 2 * matrix[:3, 2]  # slice 2 lies where the single slice was
    volume = slicer.util.addVolumeFromArray(slab, matrix, "Slab")
    names = ["indenter", "pad", "tissue", "floor"]
    labels = images.segmentation_image(inputs["segmentation"], names, rest)
    segmentation = sample.segmentation_from_image(
        Image(np.repeat(labels.array, 5, axis=0)),
        dict(enumerate(names, 1)),
        "Slab segments",
        volume,
    )
    request = {**inputs, "restVolume": volume, "segmentation": segmentation, "sliceIndex": 2}
    result = ElastoIdentifyLogic().process(**request)
    a, b = (vtk_to_numpy(r.model.GetMesh().GetPoints().GetData()) for r in (flat, result))
    assert np.allclose(a, b, atol=1e-9)
    assert np.allclose(cell_data(flat, "Mu"), cell_data(result, "Mu"), rtol=1e-6, equal_nan=True)


def test_a_whole_volume_gives_tetrahedra_and_its_known_affine_answer():
    """Uniform strain in one material: with one unknown per label, E is that of the pad."""
    labels = np.ones((12, 12, 12), np.uint8)
    labels[:, 6:, :] = 2
    rest = slicer.util.addVolumeFromArray(labels.astype(np.int16), np.diag([2, 2, 2, 1.0]), "Cube")
    segmentation = sample.segmentation_from_image(
        Image(labels), {1: "pad", 2: "tissue"}, "Cube segments", rest
    )
    pushes = []
    for strain in (np.diag([0.002, -0.01, 0.002]), np.array([[0, 0.01, 0], [0, 0, 0], [0, 0, 0]])):
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode")
        matrix = np.eye(4)
        matrix[:3, :3] += strain
        node.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(matrix))
        pushes.append(node)
    result = ElastoIdentifyLogic().process(
        restVolume=rest,
        segmentation=segmentation,
        transforms=pushes,
        materials={"pad": Material(KNOWN, 7.0, 0.3)},
        wholeVolume=True,
        edgeLength=6.0,
        options={
            "method": "global",
            "unknowns": "young",
            "poisson_ratio": 0.3,
            "grouping": "label",
        },
    )
    assert result.model.GetMesh().GetCellType(0) == vtk.VTK_TETRA
    tissue = cell_data(result, "Label") == 2
    assert np.allclose(cell_data(result, "YoungModulus")[tissue], 7.0, rtol=1e-6)


def test_inputs_are_left_alone_and_temporary_nodes_are_gone():
    inputs, _ = sample.add_exact_push()
    before = node_ids()
    Request(**inputs).study()
    assert node_ids() == before


def test_cancel_leaves_the_scene_as_it_was():
    inputs, _ = sample.add_exact_push()
    before = node_ids()

    def cancel(fraction, text):
        raise Cancelled

    with pytest.raises(Cancelled):
        ElastoIdentifyLogic().process(progress=cancel, **inputs)
    assert node_ids() == before


def test_failure_leaves_the_scene_as_it_was_and_says_why():
    inputs, _ = sample.add_exact_push()
    before = node_ids()
    with pytest.raises(InputError, match="edge length"):
        ElastoIdentifyLogic().process(**{**inputs, "edgeLength": 500.0})
    assert node_ids() == before


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"restVolume": None}, "choose a rest volume"),
        ({"transforms": []}, "choose pushed volumes"),
        ({"segmentation": None}, "choose a segmentation"),
        ({"materials": {}}, "say which segment is known"),
        ({"materials": {"pad": Material(KNOWN, -1.0, 0.3)}}, "Young's modulus of pad"),
        ({"materials": {"pad": Material(KNOWN, 1.0, 0.5)}}, "Poisson's ratio of pad"),
        ({"edgeLength": -1.0}, "edge length must be positive"),
        (
            {
                "materials": {
                    name: Material(KNOWN) for name in ("indenter", "pad", "tissue", "floor")
                }
            },
            "no segment is unknown",
        ),
    ],
)
def test_what_is_missing_is_named(change, reason):
    inputs, _ = sample.add_exact_push()
    assert reason in Request(**{**inputs, **change}).missing()


def test_the_grid_transform_of_a_trial_moves_the_nodes_as_measured():
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    points = vtk_to_numpy(result.model.GetMesh().GetPoints().GetData())
    assert len(result.transforms) == 2
    for number, node in enumerate(result.transforms, 1):
        shift = images.nodal_displacements([node], points, False)[0]
        measured = vtk_to_numpy(
            result.model.GetMesh().GetPointData().GetArray(f"Displacement_{number}")
        )
        assert np.abs(shift - measured).max() < 0.05 * np.abs(measured).max()


def test_table_holds_the_statistics_of_each_segment():
    inputs, young = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    table = result.table.GetTable()
    column = {
        table.GetColumnName(c): [
            table.GetValue(r, c).ToString() for r in range(table.GetNumberOfRows())
        ]
        for c in range(table.GetNumberOfColumns())
    }
    assert column["name"] == ["pad", "tissue"]
    assert column["given"] == ["1", "0"]
    assert column["unit"] == ["kPa", "kPa"]
    labels = cell_data(result, "Label")
    assert [int(n) for n in column["cells"]] == [(labels == 2).sum(), (labels == 3).sum()]
    medians = [float(value) for value in column["YoungModulus median"]]
    assert np.allclose(medians, [young[2], young[3]], rtol=1e-6)
    series = result.chart.GetNthPlotSeriesNode(0)
    error = float(column["Mu standard error"][1])
    written = result.chart.GetXAxisTitle()
    assert written.startswith("pad 1.92, tissue 5.77")  # what is given has no error
    assert not np.isfinite(error) or written.endswith(f" ± {error:.1g}")
    assert series.GetYColumnName() in column
    assert series.GetLabelColumnName() in column


def test_undetermined_cells_are_nan_and_have_a_model_of_their_own():
    """Uniform strains say the same thing in every trial: too little for a value per cell."""
    inputs, _ = sample.add_exact_push()
    pushes = []
    for strain in (np.diag([0.0, 0.01, 0.0]), 0.01 * np.eye(3)[[1, 0, 2]] * [1, 0, 0]):
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode")
        matrix = np.eye(4)
        matrix[:3, :3] += strain
        node.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(matrix))
        pushes.append(node)
    result = ElastoIdentifyLogic().process(**{**inputs, "transforms": pushes})
    status = cell_data(result, "Status")
    assert (status == 0).any()
    assert np.isnan(cell_data(result, "Mu")[status == 0]).all()
    assert np.isfinite(cell_data(result, "Mu")[status > 0]).all()
    assert result.undetermined.GetMesh().GetNumberOfCells() == (status == 0).sum()
    assert not result.undetermined.GetDisplayNode().GetScalarVisibility()
    report = ElastoIdentifyLogic.report(result)
    assert f"{(status == 0).sum()} not determined" in report


def test_everything_is_in_one_folder_and_is_replaced_together():
    inputs, _ = sample.add_exact_push()
    logic = ElastoIdentifyLogic()
    before = node_ids()
    first = logic.process(**inputs)
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    parents = {hierarchy.GetItemParent(hierarchy.GetItemByDataNode(node)) for node in first.nodes()}
    assert parents == {first.folder}
    outputs.remove_result(first.model)
    left = set(node_ids()) - set(before)
    kept = {slicer.mrmlScene.GetNodeByID(node_id).GetClassName() for node_id in left}
    assert kept <= {"vtkMRMLColorTableNode", "vtkMRMLColorTableStorageNode"}


def test_a_saved_scene_comes_back_whole(tmp_path):
    inputs, _ = sample.add_exact_push()
    logic = ElastoIdentifyLogic()
    parameters = logic.getParameterNode()
    result = logic.process(**inputs)
    parameters.restVolume = inputs["restVolume"]
    parameters.edgeLength = 6.5
    parameters.method = "global"
    parameters.resultModel = result.model
    arrays = {name: cell_data(result, name).copy() for name in CELL_ARRAYS}
    points = vtk_to_numpy(result.model.GetMesh().GetPoints().GetData()).copy()
    shift = images.nodal_displacements(result.transforms, points, False)
    name, title = result.model.GetName(), "μ (kPa)"
    filed = folder_of(result.model)
    path = str(tmp_path / "scene.mrb")
    assert slicer.mrmlScene.WriteToMRB(path, None)

    slicer.mrmlScene.Clear(0)
    assert not slicer.util.getNodesByClass("vtkMRMLModelNode")
    assert slicer.mrmlScene.ReadFromMRB(path)

    model = slicer.mrmlScene.GetFirstNode(name, "vtkMRMLModelNode", None, True)
    for array, values in arrays.items():
        assert np.array_equal(
            slicer.util.arrayFromModelCellData(model, array), values, equal_nan=True
        ), array
    grid = model.GetMesh()
    assert np.allclose(vtk_to_numpy(grid.GetPoints().GetData()), points, atol=1e-9)
    report = grid.GetFieldData().GetAbstractArray("IdentificationReport").GetValue(0)
    assert json.loads(report)["method"] == "global"
    display = model.GetDisplayNode()
    assert display.GetActiveScalarName() == "Mu"
    assert display.GetVisibility2D()
    assert display.GetColorNode() is not None
    legend = slicer.modules.colors.logic().GetColorLegendDisplayNode(model)
    assert legend.GetTitleText() == title
    transforms = [
        node
        for node in slicer.util.getNodesByClass("vtkMRMLGridTransformNode")
        if node.GetAttribute(outputs.RESULT)
    ]
    assert np.allclose(images.nodal_displacements(transforms, points, False), shift, atol=1e-5)
    tables = [
        n for n in slicer.util.getNodesByClass("vtkMRMLTableNode") if "segments" in n.GetName()
    ]
    assert tables[0].GetNumberOfRows() == 2
    again = logic.getParameterNode()
    assert (again.edgeLength, again.method) == (6.5, "global")
    assert again.restVolume.GetName() == "Block"
    assert again.resultModel is model
    assert filed == folder_of(model)
    assert filed[0] == f"{name} map"
    assert len(filed[1]) == 6  # model, two transforms, table, plot series, chart
    (chart,) = slicer.util.getNodesByClass("vtkMRMLPlotChartNode")
    series = chart.GetNthPlotSeriesNode(0)
    assert series.GetTableNode() is tables[0]
    assert series.GetYColumnName() == "Mu mean"
    assert all(not node.GetDisplayNode().GetVisibility() for node in transforms)


def folder_of(model):
    """Name of the folder of a result, and the names of what is in it."""
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    folder = hierarchy.GetItemParent(hierarchy.GetItemByDataNode(model))
    inside = vtk.vtkIdList()
    hierarchy.GetItemChildren(folder, inside)
    names = [hierarchy.GetItemName(inside.GetId(n)) for n in range(inside.GetNumberOfIds())]
    return hierarchy.GetItemName(folder), sorted(names)


def test_the_sample_is_made_without_network_and_says_what_its_segments_are(monkeypatch):
    import socket

    def refuse(*_, **__):
        raise AssertionError("the sample asked for the network")

    told = []
    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(slicer.util, "showStatusMessage", lambda text, _: told.append(text))
    rest, *pushed, segmentation = loadSample()
    shares = [int(text.split(": ")[1].split(" %")[0]) for text in told]
    assert len(shares) > 3
    assert shares == sorted(shares)
    assert rest.GetName() == "Phantom rest"
    assert len(pushed) == 2
    request = Request(restVolume=rest, pushedVolumes=pushed, segmentation=segmentation)
    assert request.missing() == ""
    roles = {name: material.role for _, name, material in request.segments().values()}
    assert roles == {
        "pad": "known",
        "tissue": "unknown",
        "inclusion": "unknown",
        "indenter": "rigid",
        "floor": "rigid",
    }


def test_the_3d_sample_is_a_volume_that_only_needs_apply(monkeypatch):
    monkeypatch.setattr(slicer.util, "showStatusMessage", lambda text, _: None)
    small = partial(make_phantom_volume, voxels=16, elements=4)
    monkeypatch.setattr(sample, "make_phantom_volume", lambda **o: small(balls=o["balls"]))
    rest, *pushed, segmentation = loadSampleVolume()
    assert min(rest.GetImageData().GetDimensions()) > 8
    assert len(pushed) >= 2
    request = Request(restVolume=rest, pushedVolumes=pushed, segmentation=segmentation)
    assert request.missing() == ""


def test_phantom_images_lie_where_the_library_puts_them():
    """A phantom with an oblique, shifted frame: voxel centres in RAS are its LPS ones, flipped."""
    turn = 0.3
    direction = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [np.sin(turn), 0, -np.cos(turn)], [0, 1.0, 0]]
    )
    image = Image(np.arange(60.0).reshape(1, 6, 10), [5, -8, 20], [1.5, 0.5, 3.0], direction)
    volume = sample.volume_from_image(image, "Tilted")
    back = images.image_from_volume(volume)
    index = np.array([[0, 0, 0], [9, 5, 0], [3, 2, 0]])
    assert np.allclose(back.index_to_world(index), image.index_to_world(index) * FLIP)
    assert (back.array == image.array).all()


def in_lps(image):
    """The same image in the LPS world of files."""
    return Image(image.array, FLIP * image.origin, image.spacing, FLIP[:, None] * image.direction)


@pytest.fixture(scope="module")
def oblique_phantom():
    """A phantom whose slice is turned about two axes of the patient."""
    turn, tilt = 0.3, 0.2
    about_s = [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    about_l = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    return make_phantom(
        inclusions=[Inclusion(contrast=3.0)],
        pixels=144,
        elements=24,
        origin=(30.0, -14.0, 8.0),
        direction=np.array(about_s) @ about_l,
    )


def test_oblique_images_give_the_bits_of_the_pipeline_and_the_librarys_map_in_lps(
    oblique_phantom, tmp_path
):
    """All of the way but elastix itself, whose answer is stored."""
    inputs = sample.phantom_nodes(oblique_phantom)
    inputs["options"] |= {"grouping": "label", "cache": str(tmp_path)}
    outcome = stored_outcome(Request(**inputs).study(), oblique_phantom, tmp_path)
    steps = []
    with only_read(tmp_path):
        result = ElastoIdentifyLogic().process(
            progress=lambda fraction, text: steps.append(fraction), **inputs
        )
    assert steps == sorted(steps)
    grid = result.model.GetMesh()
    points = vtk_to_numpy(grid.GetPoints().GetData())
    np.testing.assert_array_equal(points, outcome.mesh.points)
    for name, quantity in QUANTITIES.items():
        expected = getattr(outcome.result, quantity.field)
        np.testing.assert_array_equal(cell_data(result, name), expected, err_msg=name)
    measured = outcome.registration
    for name, values in (
        ("Displacement", measured.displacements),
        ("DisplacementInformation", measured.information),
        ("Disagreement", measured.disagreement),
    ):
        for number, expected in enumerate(values, 1):
            stored = vtk_to_numpy(grid.GetPointData().GetArray(f"{name}_{number}"))
            np.testing.assert_array_equal(stored, expected, err_msg=name)
    exact = oblique_phantom.displacements(points * FLIP) * FLIP
    pixel = oblique_phantom.frame.spacing.max()
    assert np.sqrt(np.mean((measured.displacements - exact) ** 2)) < 0.3 * pixel

    labels, mu = cell_data(result, "Label"), cell_data(result, "Mu")
    median = {
        name: np.median(mu[labels == oblique_phantom.label(name)])
        for name in ("pad", "tissue", "inclusion")
    }
    assert median["pad"] == pytest.approx(5.0 / 2 / 1.45)
    assert median["tissue"] == pytest.approx(3.0 / 2 / 1.45, rel=0.25)
    assert median["inclusion"] / median["tissue"] == pytest.approx(3.0, rel=0.25)
    assert "cells identified" in ElastoIdentifyLogic.report(result)

    # the library in LPS, on what Slicer has measured: vectors and matrices turned from RAS
    study = Request(**inputs).study()
    study.rest, study.segmentation = in_lps(study.rest), in_lps(study.segmentation)
    study.pushed = [in_lps(image) for image in study.pushed]
    assert np.allclose(study.rest.origin, oblique_phantom.rest.origin)
    assert np.allclose(study.rest.direction, oblique_phantom.rest.direction)
    information = measured.information * [1, 1, 1, 1, -1, -1]
    turned = Registration(measured.displacements * FLIP, information, None, {})
    there = run(study, registration=turned)
    assert np.allclose(points, there.mesh.points * FLIP, atol=1e-9)
    assert (cell_data(result, "Status") == there.result.status).all()
    for name, values in (("Mu", there.result.mu), ("Lambda", there.result.lam)):
        assert np.allclose(cell_data(result, name), values, rtol=1e-9, equal_nan=True), name


def test_no_file_stays_behind(tmp_path, monkeypatch):
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    inputs, _ = sample.add_exact_push()
    ElastoIdentifyLogic().process(**inputs)
    assert os.listdir(tmp_path) == []


# ---- every option of the table


@pytest.mark.parametrize("name", parameters.options())
def test_every_option_arrives_from_the_parameter_node_in_the_study(name):
    inputs, _ = sample.add_exact_push()
    node = ElastoIdentifyLogic().getParameterNode()
    option = parameters.options()[name]
    for field, value in inputs.items():
        if field in ("restVolume", "segmentation", "transforms"):
            setattr(node, field, value)
    node.useTransforms = True
    node.materials = materials_to_text(inputs["materials"])
    if name == "slice_index":  # the block is one slice: the option is that of volumes
        node.sliceIndex = 3
        assert ElastoIdentifyLogic.request(node).sliceIndex == 3
        return
    plain = getattr(ElastoIdentifyLogic.request(node).study(), name)
    start = option.default if option.form_start is None else option.form_start
    start, other = ("kPa", "MPa") if name == "unit" else (start, option_samples.sample(option))
    assert plain == start  # Slicer's segments are given in kPa
    setattr(node, parameters.field(name), parameters.in_field(option, other))
    study = ElastoIdentifyLogic.request(node).study()
    assert getattr(study, name) == other != start


@pytest.mark.parametrize("option", option_samples.needing(), ids=option_samples.option_id)
def test_an_option_that_is_not_used_is_in_the_report(option):
    inputs, _ = sample.add_exact_push()
    inputs["options"] = {"method": "global", option.name: option_samples.sample(option)}
    report = ElastoIdentifyLogic.report(ElastoIdentifyLogic().process(**inputs))
    assert f"{option.name} says something only with" in report


def test_segments_that_slide_are_said_by_their_names():
    names, option = {3: "Pad", 7: "My tissue"}, parameters.options()["slip"]
    assert parameters.rows_of_text("Pad:My tissue", option, names) == ((3, 7),)
    with pytest.raises(InputError, match="no segment 'Lesion'"):
        parameters.rows_of_text("Pad:Lesion", option, names)
    with pytest.raises(InputError, match="of the form Pad:Tissue"):
        parameters.rows_of_text("Pad", option, names)


def test_images_boxes_and_materials_arrive_in_the_study():
    inputs, _ = sample.add_exact_push()
    rest = inputs["restVolume"]
    mask = slicer.util.addVolumeFromArray(np.ones((1, 40, 40), np.uint8), np.eye(4), "Mask")
    push = slicer.util.addVolumeFromArray(np.full((1, 40, 40), 7, np.int16), np.eye(4), "Push")
    roi = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLMarkupsROINode", "Contact")
    roi.SetXYZ(1.0, 2.0, 3.0)
    roi.SetRadiusXYZ(4.0, 5.0, 6.0)
    node = ElastoIdentifyLogic().getParameterNode()
    node.restVolume, node.segmentation, node.maskVolume = rest, inputs["segmentation"], mask
    node.pushedVolumes, node.reactionRois = [push], [roi]
    node.materials = materials_to_text(inputs["materials"])
    study = ElastoIdentifyLogic.request(node).study()
    assert study.mask.array.all()
    assert [image.array[0, 0, 0] for image in study.pushed] == [7]
    assert np.allclose(study.reaction_boxes, [(-3, 5, -3, 7, -3, 9)])
    assert study.known_materials == ((2, 5.0, 0.3),)
    assert study.rigid_labels == (1, 4)


def test_the_map_says_how_it_was_made_and_by_whom():
    inputs, _ = sample.add_exact_push()
    grid = ElastoIdentifyLogic().process(**inputs).model.GetMesh()
    made = read_report(grid, "provenance")
    assert made["inputs"]["rest"]["name"] == inputs["restVolume"].GetName()
    assert made["options"]["method"] == "global"
    assert made["options"]["known_materials"] == [[2, 5.0, 0.3]]


def test_slicer_gives_the_bits_of_the_library_on_the_same_displacements():
    inputs, _ = sample.add_exact_push()
    grid = ElastoIdentifyLogic().process(**inputs).model.GetMesh()
    request = Request(**inputs)
    study = request.study()
    mesh = make_mesh(study)
    moved = images.nodal_displacements(request.transforms, mesh.points, request.transformsToRest)
    found = run(study, mesh=mesh, displacements=moved).result
    for name, quantity in QUANTITIES.items():
        values = vtk_to_numpy(grid.GetCellData().GetArray(name))
        np.testing.assert_array_equal(values, getattr(found, quantity.field), err_msg=name)
