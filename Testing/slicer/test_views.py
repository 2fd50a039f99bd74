"""What the slice view and the 3-D view show, drawn by Slicer's own displayable managers."""

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")

from elastoidentify.vtk_io.convert import mesh_to_vtk  # noqa: E402
from ElastoIdentifyLib import images, sample  # noqa: E402
from ElastoIdentifyLib.outputs import cube_helix  # noqa: E402
from ElastoIdentifyLib.request import Request  # noqa: E402
from ElastoIdentifyLib.views import mend_camera, turn_to_map  # noqa: E402
from standins.application import LayoutManager  # noqa: E402
from standins.views import slice_view, space_view  # noqa: E402

from ElastoIdentify import ElastoIdentifyLogic, loadSample  # noqa: E402

pytestmark = pytest.mark.usefixtures("warm")


def screen_axes(volume):
    """Right, up and towards the viewer, for the plane of a volume of one slice."""
    axes = images.ijk_to_world(volume)[:3, :3]
    axes = axes / np.linalg.norm(axes, axis=0)
    return np.column_stack([axes[:, 0], -axes[:, 1], axes[:, 2]])


def share_of(pixels, colour, tolerance=6):
    return float((np.abs(pixels.astype(int) - colour).max(axis=-1) <= tolerance).mean())


@pytest.fixture
def pictures():
    """Pictures before and after the map is there, and the result."""
    inputs, _ = sample.add_exact_push()
    axes = screen_axes(inputs["restVolume"])
    with slice_view(inputs["restVolume"], axes) as flat, space_view() as space:
        before = flat.array().copy(), space.array().copy()
        result = ElastoIdentifyLogic().process(**inputs)
        space.look(axes @ [0.2, -0.3, 1.0], axes[:, 1])
        yield before, (flat.array().copy(), space.array().copy()), result


def test_the_map_is_seen_over_the_image_in_the_slice_view(pictures):
    (before, _), (after, _), _ = pictures
    assert before.max() > 150
    assert np.ptp(before, axis=-1).max() == 0  # an image without colour
    coloured = np.ptp(after.astype(int), axis=-1) > 8
    # pad and tissue cover 28 × 24 of 40 × 40 voxels, and the view shows a margin
    assert 0.25 < coloured.mean() < 0.55


def test_both_stiffnesses_have_the_ends_of_the_colour_table_in_3d(pictures):
    _, (_, after), _ = pictures
    low, high = (cube_helix(np.array([b]))[0] * 255 for b in (0.15, 0.85))
    assert share_of(after, low) > 0.03
    assert share_of(after, high) > 0.08


def test_the_legend_is_drawn_with_its_title(pictures):
    _, (flat, _), _ = pictures
    corner = flat[:, -130:]
    assert share_of(corner, np.array([255, 255, 255]), 2) > 0.002  # letters
    colours = {tuple(pixel) for pixel in corner[250:500, -40:].reshape(-1, 3)}
    assert len(colours) > 60  # the bar


def test_cells_that_are_not_determined_are_seen_grey_in_both_views():
    """Uniform strains leave many cells open: no colour of the scale may be there."""
    inputs, _ = sample.add_exact_push()
    inputs["transforms"] = []
    for strain in (np.diag([0.0, 0.01, 0.0]), [[0, 0.01, 0], [0, 0, 0], [0, 0, 0]]):
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode")
        matrix = np.eye(4)
        matrix[:3, :3] += strain
        node.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(matrix))
        inputs["transforms"].append(node)
    axes = screen_axes(inputs["restVolume"])
    with slice_view(inputs["restVolume"], axes) as flat, space_view() as space:
        before = flat.array().astype(int)
        result = ElastoIdentifyLogic().process(**inputs)
        status = slicer.util.arrayFromModelCellData(result.model, "Status")
        assert (status == 0).mean() > 0.1
        space.look(axes @ [0.2, -0.3, 1.0], axes[:, 1])
        after, deep = flat.array().astype(int), space.array().astype(int)
        result.model.GetDisplayNode().SetVisibility(False)
        empty = space.array().astype(int)
    # how many cells are open hangs on the mesh; whatever their share, they are seen
    covered = (np.abs(deep - empty).max(axis=-1) > 4).mean()
    grey = share_of(deep, np.array([140, 140, 140]))
    assert grey / covered == pytest.approx((status == 0).mean(), rel=0.3)
    changed = np.abs(after - before).max(axis=-1) > 4
    grey = changed & (np.ptp(after, axis=-1) <= 2)
    coloured = np.ptp(after, axis=-1) > 8
    # as many pixels per cell of either kind, but for the legend and the edges of the grey cells
    assert grey.sum() / coloured.sum() == pytest.approx(
        (status == 0).sum() / (status > 0).sum(), rel=0.3
    )


@pytest.fixture
def layouts():
    """The application's layouts and slice views, as with a main window."""
    slicer.app.layouts = LayoutManager()
    yield slicer.app.layouts
    slicer.app.layouts._close()
    slicer.app.layouts = None


def views_of_layout(layouts):
    nodes = layouts.layoutLogic().GetViewNodes()
    views = [nodes.GetItemAsObject(n) for n in range(nodes.GetNumberOfItems())]
    return {view.GetClassName(): view for view in views}


def test_the_layout_shows_slice_3d_table_and_chart_of_the_result(layouts):
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    ElastoIdentifyLogic.showResult(result, Request(**inputs))
    views = views_of_layout(layouts)
    assert sorted(views) == [
        "vtkMRMLPlotViewNode",
        "vtkMRMLSliceNode",
        "vtkMRMLTableViewNode",
        "vtkMRMLViewNode",
    ]
    assert views["vtkMRMLTableViewNode"].GetTableNodeID() == result.table.GetID()
    assert views["vtkMRMLPlotViewNode"].GetPlotChartNodeID() == result.chart.GetID()
    assert views["vtkMRMLSliceNode"].GetID() == "vtkMRMLSliceNodeRed"
    composite = layouts.mrmlSliceLogics().GetItemAsObject(0).GetSliceCompositeNode()
    assert composite.GetBackgroundVolumeID() == inputs["restVolume"].GetID()


@pytest.mark.parametrize("plane", ["axial", "coronal", "sagittal"])
def test_the_map_is_seen_in_the_3d_view_with_the_camera_that_slicer_starts_with(layouts, plane):
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    turn = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode")
    turn.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(turns(plane)))
    for node in (inputs["restVolume"], result.model):
        node.SetAndObserveTransformNodeID(turn.GetID())
    for node in (inputs["restVolume"], result.model):
        node.HardenTransform()
    ElastoIdentifyLogic.showResult(result, Request(**inputs))
    with space_view(node=views_of_layout(layouts)["vtkMRMLViewNode"]) as space:
        ElastoIdentifyLogic.showResult(result, Request(**inputs))
        after = space.array()
    low, high = (cube_helix(np.array([b]))[0] * 255 for b in (0.15, 0.85))
    assert share_of(after, low) > 0.03
    assert share_of(after, high) > 0.08


def test_a_camera_that_sees_the_map_along_its_edge_is_turned_and_another_is_left(layouts):
    """As in a scene that is opened where another was closed: the camera stands at its start."""
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    ElastoIdentifyLogic.showResult(result, Request(**inputs))
    with space_view(node=views_of_layout(layouts)["vtkMRMLViewNode"]) as space:
        camera = slicer.util.getNodesByClass("vtkMRMLCameraNode")[0]
        camera.SetFocalPoint(0, 0, 0)
        camera.SetPosition(0, 500, 0)
        camera.SetViewUp(0, 0, 1)
        mend_camera(result.model)
        seen = space.array()
        place = camera.GetPosition()
        mend_camera(result.model)
        assert camera.GetPosition() == place
    low, high = (cube_helix(np.array([b]))[0] * 255 for b in (0.15, 0.85))
    assert share_of(seen, low) > 0.03
    assert share_of(seen, high) > 0.08


def test_without_a_main_window_nothing_is_shown_and_nothing_fails():
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    before = slicer.mrmlScene.GetNumberOfNodes()
    ElastoIdentifyLogic.showResult(result, Request(**inputs))
    assert slicer.mrmlScene.GetNumberOfNodes() == before


@pytest.mark.parametrize("plane", ["axial", "coronal", "sagittal"])
def test_the_red_view_turns_into_the_plane_of_the_map(layouts, plane):
    """The map of slice 1 of an oblique slab under a parent transform lies in the red view."""
    inputs, _ = sample.add_exact_push()
    matrix = images.ijk_to_world(inputs["restVolume"])
    matrix[:3, 2] *= -1  # right-handed or not
    matrix = turns(plane) @ matrix
    volume = slicer.util.addVolumeFromArray(np.ones((5, 40, 40)), matrix, "Slab")
    table = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode")
    shift = np.eye(4)
    shift[:3, 3] = 30.0, -11.0, 4.0
    table.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(shift))
    volume.SetAndObserveTransformNodeID(table.GetID())
    in_slice = np.array([[8, 8, 1, 1], [30, 8, 1, 1], [30, 34, 1, 1], [8, 34, 1, 1]])
    points = (in_slice @ (shift @ matrix).T)[:, :3]
    model = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode")
    model.SetAndObserveMesh(mesh_to_vtk(points, np.array([[0, 1, 2], [0, 2, 3]])))

    layouts.setLayout(slicer.vtkMRMLLayoutNode.SlicerLayoutFourUpView)
    red = slicer.mrmlScene.GetNodeByID("vtkMRMLSliceNodeRed")
    turn_to_map(red, model, Request(restVolume=volume, sliceAxis=2, sliceIndex=1))

    to_slice = np.linalg.inv(slicer.util.arrayFromVTKMatrix(red.GetSliceToRAS()))
    seen = np.c_[points, np.ones(len(points))] @ to_slice.T
    assert np.abs(seen[:, 2]).max() < 1e-6
    right, up = np.linalg.inv(to_slice)[:3, :2].T
    if plane == "sagittal":
        assert up[2] > 0.5
        assert right[1] < -0.5  # anterior on the left
    else:
        assert right[0] < -0.5  # patient's left on the right
        assert up[1 if plane == "axial" else 2] > 0.5


def turns(plane):
    """A rotation that brings a nearly axial plane near the named one."""
    axes = {"axial": (0, 1, 2), "coronal": (0, 2, 1), "sagittal": (2, 0, 1)}[plane]
    turn = np.eye(4)
    turn[:3, :3] = np.eye(3)[list(axes)]
    return turn


def test_the_sample_is_seen_in_the_red_view(layouts):
    layouts.setLayout(slicer.vtkMRMLLayoutNode.SlicerLayoutFourUpView)
    rest = loadSample()[0]
    red = slicer.mrmlScene.GetNodeByID("vtkMRMLSliceNodeRed")
    to_slice = np.linalg.inv(slicer.util.arrayFromVTKMatrix(red.GetSliceToRAS()))
    width, height, depth = rest.GetImageData().GetDimensions()
    assert depth == 1
    corners = [
        [0, 0, 0, 1],
        [width - 1, 0, 0, 1],
        [0, height - 1, 0, 1],
        [width - 1, height - 1, 0, 1],
    ]
    seen = np.array(corners) @ images.ijk_to_world(rest).T @ to_slice.T
    assert np.abs(seen[:, 2]).max() < 1e-6
    half = np.array(red.GetFieldOfView()[:2]) / 2
    assert (np.abs(seen[:, :2]) < half + 1).all()
    for number in range(layouts.mrmlSliceLogics().GetNumberOfItems()):
        composite = layouts.mrmlSliceLogics().GetItemAsObject(number).GetSliceCompositeNode()
        assert composite.GetBackgroundVolumeID() == rest.GetID()


def test_a_view_that_is_younger_than_the_map_shows_the_legend_too(layouts):
    inputs, _ = sample.add_exact_push()
    result = ElastoIdentifyLogic().process(**inputs)
    with space_view() as space:
        legend_letters = lambda: share_of(space.array()[:, -130:], np.full(3, 255), 2)  # noqa: E731
        before = legend_letters()
        ElastoIdentifyLogic.showResult(result, Request(**inputs))
        assert before == 0.0
        assert legend_letters() > 0.002


def test_the_pictures_of_the_documentation_can_be_made(tmp_path):
    from standins.pictures import make_pictures

    made = make_pictures(tmp_path, small=True)
    assert all(path.stat().st_size > 2000 for path in made)
