"""Images and meshes keep their place, order and values on the way from VTK and back."""

import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.slices import slice_of_image, slice_with_points
from elastoidentify.results import to_matrices
from elastoidentify.vtk_io import convert
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import (
    VTK_POLYGON,
    VTK_QUAD,
    VTK_TRIANGLE,
    VTK_WEDGE,
    vtkImageData,
    vtkUnstructuredGrid,
)


def rotation(random):
    """A random rotation matrix."""
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def oblique(random, extent=(0, 4, 0, 3, 0, 2)):
    """A vtkImageData in an oblique place, its voxels numbered."""
    data = vtkImageData()
    data.SetExtent(extent)
    data.SetOrigin(10.0, -20.0, 30.0)
    data.SetSpacing(0.5, 1.0, 2.5)
    data.SetDirectionMatrix(rotation(random).ravel())
    convert.set_array(data.GetPointData(), "Grey", np.arange(data.GetNumberOfPoints(), dtype=float))
    return data


@pytest.mark.parametrize("extent", [(0, 4, 0, 3, 0, 2), (3, 7, -2, 1, 5, 7)])
def test_voxels_of_an_oblique_image_keep_their_world_position(random, extent):
    data = oblique(random, extent)
    image = convert.image_from_vtk(data)
    for index in [(0, 0, 0), (4, 0, 0), (0, 3, 0), (1, 2, 2)]:
        absolute = [i + first for i, first in zip(index, extent[::2], strict=True)]
        there = np.zeros(3)
        data.TransformIndexToPhysicalPoint(absolute, there)
        np.testing.assert_allclose(image.index_to_world([index])[0], there, atol=1e-12)
        here = data.ComputePointId(absolute)
        assert image.array[index[::-1]] == data.GetPointData().GetArray("Grey").GetValue(here)


def test_an_image_comes_back_as_it_was(random):
    image = convert.image_from_vtk(oblique(random))
    again = convert.image_from_vtk(convert.image_to_vtk(image))
    for name in ("array", "origin", "spacing", "direction"):
        np.testing.assert_array_equal(getattr(again, name), getattr(image, name))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slice_stays_in_its_place(random, axis):
    image = convert.image_from_vtk(oblique(random))
    cut = slice_of_image(image, axis, 1)
    assert cut.planar_axis == axis
    index = np.array([2, 2, 1])
    index[axis] = 1
    in_cut = index.copy()
    in_cut[axis] = 0
    np.testing.assert_allclose(
        cut.index_to_world([in_cut]), image.index_to_world([index]), atol=1e-12
    )
    assert cut.array[tuple(in_cut[::-1])] == image.array[tuple(index[::-1])]
    with pytest.raises(InputError, match="is not in 0…"):
        slice_of_image(image, axis, 99)


def test_images_without_grey_values_are_refused(random):
    with pytest.raises(InputError, match="the rest image has no point array: it has none"):
        convert.image_from_vtk(vtkImageData(), "rest image")
    data = oblique(random)
    with pytest.raises(InputError, match="no point array 'Gray': it has 'Grey'"):
        convert.image_from_vtk(data, array="Gray")
    convert.set_array(data.GetPointData(), "Colour", np.zeros((data.GetNumberOfPoints(), 3)))
    with pytest.raises(InputError, match="3 values per voxel"):
        convert.image_from_vtk(data, array="Colour")


def mixed_mesh():
    """Two triangles with a quad between them in the order of the cells."""
    points = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]], float)
    grid = vtkUnstructuredGrid()
    grid.SetPoints(convert.mesh_to_vtk(points, np.array([[0, 1, 3]])).GetPoints())
    for kind, nodes in [
        (VTK_TRIANGLE, (0, 1, 3)),
        (VTK_QUAD, (1, 2, 5, 4)),
        (VTK_TRIANGLE, (1, 4, 3)),
    ]:
        grid.InsertNextCell(kind, len(nodes), nodes)
    return grid


def test_mixed_cells_become_blocks_with_their_numbers():
    blocks, order = convert.mesh_blocks(mixed_mesh())
    assert [kind for kind, _ in blocks] == ["triangle", "quad"]
    np.testing.assert_array_equal(blocks[0][1], [[0, 1, 3], [1, 4, 3]])
    np.testing.assert_array_equal(blocks[1][1], [[1, 2, 5, 4]])
    np.testing.assert_array_equal(order, [0, 2, 1])


@pytest.mark.parametrize(
    ("kind", "nodes"), [("triangle", 3), ("quad", 4), ("tetra", 4), ("hexahedron", 8)]
)
def test_cells_come_back_as_they_were(random, kind, nodes):
    points = random.normal(size=(20, 3))
    cells = np.array([random.permutation(20)[:nodes] for _ in range(7)])
    grid = convert.mesh_to_vtk(points, [(kind, cells)])
    np.testing.assert_array_equal(convert.mesh_points(grid), points)
    blocks, order = convert.mesh_blocks(grid)
    assert blocks[0][0] == kind
    np.testing.assert_array_equal(blocks[0][1], cells)
    np.testing.assert_array_equal(order, np.arange(7))


def test_other_kinds_of_cells_are_named():
    grid = mixed_mesh()
    grid.InsertNextCell(VTK_WEDGE, 6, range(6))
    grid.InsertNextCell(VTK_POLYGON, 3, (0, 1, 3))
    with pytest.raises(InputError, match=r"vtkPolygon, vtkWedge.*Threshold"):
        convert.mesh_blocks(grid)
    with pytest.raises(InputError, match="mixes triangle and quad"):
        convert.simplices(mixed_mesh())


def test_arrays_keep_type_and_name(random):
    grid = mixed_mesh()
    for values in (
        np.array([1, 2, 3], np.int32),
        np.array([0, 1, 1], np.uint8),
        random.normal(size=(3, 6)),
    ):
        convert.set_array(grid.GetCellData(), "A", values)
        back = convert.get_array(grid.GetCellData(), "A")
        np.testing.assert_array_equal(back, values)
        assert back.dtype == values.dtype
    with pytest.raises(InputError, match="no cell array 'B': it has 'A'"):
        convert.get_array(grid.GetCellData(), "B")


def test_trials_are_sorted_by_number_not_by_letter():
    grid = mixed_mesh()
    for name in ("Displacement_10", "Displacement_2", "Displacement_1", "DisplacementX", "Other"):
        convert.set_array(grid.GetPointData(), name, np.zeros((6, 3)))
    names = ["Displacement_1", "Displacement_2", "Displacement_10"]
    assert convert.displacement_names(grid) == names


def test_information_rows_become_symmetric_matrices():
    matrix = to_matrices(np.array([[1, 2, 3, 4, 5, 6]]))[0]
    np.testing.assert_array_equal(matrix, [[1, 4, 6], [4, 2, 5], [6, 5, 3]])


def test_a_planar_mesh_picks_its_slice_of_a_volume(random):
    image = Image(random.normal(size=(5, 6, 7)), [1.0, 2, 3], [0.5, 1, 2], rotation(random))
    index = np.column_stack([random.uniform(0, 6, 9), random.uniform(0, 5, 9), np.full(9, 3.0)])
    cut = slice_with_points(image, image.index_to_world(index))
    np.testing.assert_array_equal(cut.array[0], image.array[3])
    with pytest.raises(InputError, match="lies in no slice"):
        slice_with_points(image, image.index_to_world(random.uniform(0, 4, (9, 3))))
    with pytest.raises(InputError, match="outside the images"):
        slice_with_points(image, image.index_to_world(index + 9 * np.eye(3)[2]))


def test_text_in_field_data_comes_back():
    grid = mixed_mesh()
    convert.set_text(grid, "Report", convert.to_json({"µ": np.float64(1.5), "n": np.arange(2)}))
    assert convert.get_text(grid, "Report") == '{"\\u00b5": 1.5, "n": [0, 1]}'
    assert convert.get_text(grid, "Nothing") == ""
    assert vtk_to_numpy(grid.GetPoints().GetData()).shape == (6, 3)
