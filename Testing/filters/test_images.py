"""From images to a mesh with displacements, by the filters."""

import json

import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.filters import (
    ElastixNodalDisplacement,
    LameIdentification,
    PushingPhantom,
    SegmentationToTriangleMesh,
)
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.meshing import mesh_segmentation
from elastoidentify.results import to_matrices
from elastoidentify.vtk_io import convert
from vtkmodules.vtkCommonDataModel import vtkImageData


def disc_in_square(depth=1):
    """A labelmap: tissue 2 with a disc 3, a rigid plate 4 on top, air around."""
    j, i = np.mgrid[:48, :48]
    labels = np.zeros((48, 48), np.int16)
    labels[8:40, 8:40] = 2
    labels[np.hypot(i - 24, j - 26) < 7] = 3
    labels[4:8, 8:40] = 4
    return np.repeat(labels[None], depth, axis=0)


def oblique_image(array):
    """An image in an oblique place of the world."""
    axes, _ = np.linalg.qr(np.array([[1.0, 0.2, 0.1], [-0.3, 1.0, 0.2], [0.1, -0.1, 1.0]]))
    return Image(array, [5.0, -7.0, 11.0], [0.5, 0.5, 1.5], axes)


@pytest.fixture
def segmentation():
    return oblique_image(disc_in_square())


def mesh_by_filter(image, **settings):
    mesher = SegmentationToTriangleMesh(**settings)
    mesher.SetInputData(convert.image_to_vtk(image))
    mesher.Update()
    return mesher.GetOutput()


def test_mesh_is_the_librarys_with_labels_and_reaction_nodes(segmentation):
    settings = {"rigid_labels": [4], "reaction_boxes": [(0.0, 99.0, -99.0, 99.0)]}
    grid = mesh_by_filter(segmentation, edge_length=3.0, **settings)
    expected = mesh_segmentation(segmentation, 3.0, **settings)
    np.testing.assert_array_equal(convert.mesh_points(grid), expected.points)
    np.testing.assert_array_equal(convert.simplices(grid), expected.cells)
    label = convert.get_array(grid.GetCellData(), "Label")
    np.testing.assert_array_equal(label, expected.labels)
    assert label.dtype == np.int32 and set(label) == {2, 3}
    reaction = convert.get_array(grid.GetPointData(), "ReactionNodes")
    np.testing.assert_array_equal(reaction, expected.reaction_nodes)
    assert reaction.dtype == np.uint8 and 0 < reaction.sum() < len(reaction)
    assert convert.get_text(grid, "MeshNotes") == "\n".join(expected.notes)


def test_a_slice_of_a_volume_is_meshed_in_its_plane():
    volume = oblique_image(disc_in_square(depth=5))
    grid = mesh_by_filter(volume, edge_length=3.0, slice_axis="k", slice_index=2)
    assert convert.mesh_blocks(grid)[0][0][0] == "triangle"
    depth = volume.world_to_index(convert.mesh_points(grid))[:, 2]
    np.testing.assert_allclose(depth, 2.0, atol=1e-9)


def test_a_volume_becomes_tetrahedra():
    grid = mesh_by_filter(oblique_image(disc_in_square(depth=12)), edge_length=5.0)
    assert convert.mesh_blocks(grid)[0][0][0] == "tetra"
    assert set(convert.get_array(grid.GetCellData(), "Label")) == {2, 3, 4}


def test_labels_stored_as_floats_are_good_and_grey_values_are_not(segmentation):
    as_float = segmentation.with_array(segmentation.array.astype(np.float32))
    whole = mesh_by_filter(segmentation, edge_length=4.0)
    assert mesh_by_filter(as_float, edge_length=4.0).GetNumberOfCells() == whole.GetNumberOfCells()
    with pytest.raises(InputError, match="whole numbers"):
        mesh_by_filter(segmentation.with_array(segmentation.array * 0.3))


def test_the_labels_of_the_image_can_be_picked_as_rigid(segmentation):
    mesher = SegmentationToTriangleMesh(edge_length=4.0)
    mesher.SetInputData(convert.image_to_vtk(segmentation))
    mesher.UpdateInformation()
    labels = mesher.GetRigidLabelSelection()
    names = [labels.GetArrayName(i) for i in range(labels.GetNumberOfArrays())]
    assert names == ["2", "3", "4"]
    mesher.Update()
    assert set(convert.get_array(mesher.GetOutput().GetCellData(), "Label")) == {2, 3, 4}
    labels.EnableArray("4")
    mesher.Update()
    assert set(convert.get_array(mesher.GetOutput().GetCellData(), "Label")) == {2, 3}


# ---- registration


@pytest.fixture(scope="module")
def phantom():
    """A small phantom with images, 1.25 mm pixels."""
    from elastoidentify.imaging.phantom.planar import make_phantom

    return make_phantom(pixels=96, elements=30, pushes=((0.0, 0.06), (0.04, 0.04)))


def connected(mesh, rest, pushed, **settings):
    registration = ElastixNodalDisplacement(**settings)
    registration.SetMesh(mesh)
    registration.SetRestImage(rest)
    for image in pushed:
        registration.AddPushedImage(image)
    return registration


def test_pushed_images_are_added_and_cleared_without_touching_the_others(segmentation):
    image = convert.image_to_vtk(segmentation)
    mesh = SegmentationToTriangleMesh(edge_length=4.0)
    mesh.SetInputData(image)
    registration = connected(mesh, image, [image])
    registration.AddInputData(image)
    assert [registration.GetNumberOfInputConnections(port) for port in range(3)] == [1, 1, 2]
    registration.ClearPushedImages()
    assert [registration.GetNumberOfInputConnections(port) for port in range(3)] == [1, 1, 0]
    with pytest.raises(InputError, match="no pushed images given"):
        registration.Update()


def test_what_is_no_image_is_refused_by_its_role(segmentation):
    image, mesh = convert.image_to_vtk(segmentation), PushingPhantom()
    with pytest.raises(InputError, match="expected a data object or a filter, not str"):
        connected(mesh, "rest.nrrd", [image])
    with pytest.raises(InputError, match="pushed image of trial 2 has no point array"):
        connected(mesh, image, [image, vtkImageData()]).Update()


def test_failed_registration_is_one_line_and_no_output(segmentation):
    constant = convert.image_to_vtk(segmentation.with_array(np.ones((1, 48, 48))))
    mesh = mesh_by_filter(segmentation, edge_length=4.0)
    registration = connected(mesh, constant, [constant])
    with pytest.raises(InputError, match="rest image is 1 everywhere"):
        registration.Update()
    assert registration.GetOutput().GetNumberOfPoints() == 0


def test_the_arrays_of_a_registration_replace_those_of_an_earlier_one(segmentation):
    from elastoidentify.imaging.registration.registration import Registration
    from elastoidentify.vtk_io.arrays import write_registration

    grid = mesh_by_filter(segmentation, edge_length=4.0)
    nodes = grid.GetNumberOfPoints()
    for trials, backward in ((2, True), (1, False)):
        pixels = np.full((trials, nodes), 0.25) if backward else None
        arrays = np.ones((trials, nodes, 3)), np.ones((trials, nodes, 6))
        write_registration(grid, Registration(*arrays, pixels, {"warnings": []}))
        data = grid.GetPointData()
        names = {data.GetArrayName(i) for i in range(data.GetNumberOfArrays())}
        assert ("Displacement_2" in names) == ("DisplacementInformation_2" in names) == (trials > 1)
        assert ("Disagreement_1" in names) == ("Disagreement_2" in names) == backward
        if backward:
            assert (convert.get_array(data, "Disagreement_2") == 0.25).all()


@pytest.mark.slow
def test_images_to_stiffness_by_filters_alone(phantom):
    """The whole chain; what it finds is held against the phantom's truth."""
    mesher = SegmentationToTriangleMesh(edge_length=15.0, rigid_labels=phantom.rigid_labels)
    mesher.SetInputData(convert.image_to_vtk(phantom.segmentation))
    rest, *pushed = map(convert.image_to_vtk, (phantom.rest, *phantom.pushed))
    registration = connected(mesher, rest, pushed, backward=False)
    seen = []
    registration.AddObserver("ProgressEvent", lambda *_: seen.append(registration.GetProgress()))
    pad = phantom.label("pad")
    material = phantom.materials[pad]
    identification = LameIdentification(
        known_materials={pad: (material.young, material.poisson)},
        method="regularized",
        unknowns="young",
        poisson_ratio=0.45,
        grouping="label",
    )
    identification.SetInputConnection(registration.GetOutputPort())
    identification.Update()

    found = identification.GetOutput()
    points, cells = found.GetPointData(), found.GetCellData()
    truth = phantom.displacements(convert.mesh_points(found))
    pixel = phantom.rest.spacing[0]
    for number, exact in enumerate(truth, 1):
        measured = convert.get_array(points, f"Displacement_{number}")
        assert np.sqrt(np.mean((measured - exact)[:, :2] ** 2)) < 0.5 * pixel
        information = convert.get_array(points, f"DisplacementInformation_{number}")
        assert information.shape == (found.GetNumberOfPoints(), 6)
        assert np.all(np.linalg.eigvalsh(to_matrices(information)) > -1e-9)
    report = json.loads(convert.get_text(found, "RegistrationReport"))
    assert len(report["trials"]) == 2 and isinstance(report["warnings"], list)
    assert len(seen) > 10 and seen == sorted(seen)

    label, young = (convert.get_array(cells, name) for name in ("Label", "YoungModulus"))
    by_label = {part: np.median(young[label == part]) for part in np.unique(label)}
    contrast = by_label[phantom.label("inclusion")] / by_label[phantom.label("tissue")]
    assert 3.0 * 0.75 < contrast < 3.0 * 1.25
