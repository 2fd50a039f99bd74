"""A map on an image's grid, against other ways to find the cell of a point."""

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.export.sampling import cell_of_voxels, sample
from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.slices import slice_of_image
from export_grids import TURN, boxes, directions, expected, grid
from scipy.spatial import Delaunay


@pytest.mark.parametrize("turn", [np.eye(3), TURN])
@pytest.mark.parametrize("flip", [1, -1])
def test_tetrahedra_are_those_that_another_search_finds(turn, flip):
    rng = np.random.default_rng(3)
    image = Image(np.zeros((17, 21, 25)), (5, -7, 9), (0.8, 1.1, 1.3), turn * [1, flip, 1])
    index = rng.uniform(2, 14, (60, 3))
    mesh = Delaunay(index)
    found = cell_of_voxels(image, image.index_to_world(index), [("tetra", mesh.simplices)])
    k, j, i = np.indices(found.shape)
    centres = np.stack([i, j, k], -1).reshape(-1, 3)
    assert np.array_equal(found.ravel(), mesh.find_simplex(centres))


def test_distorted_hexahedra_are_those_that_vtk_finds():
    from elastoidentify.vtk_io.convert import mesh_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkStaticCellLocator

    points, cells = box_mesh((4, 3, 3), (12, 10, 9))
    points = points + np.random.default_rng(4).uniform(-0.7, 0.7, points.shape)
    image = Image(np.zeros((12, 13, 15)), (-1.03, -1.01, -1.02))
    found = cell_of_voxels(image, points, [("hexahedron", cells)])
    locator = vtkStaticCellLocator()
    locator.SetDataSet(mesh_to_vtk(points, [("hexahedron", cells)]))
    locator.BuildLocator()
    k, j, i = np.indices(found.shape)
    centres = image.index_to_world(np.stack([i, j, k], -1).reshape(-1, 3))
    assert np.array_equal(found.ravel(), [locator.FindCell(point) for point in centres])


@pytest.mark.parametrize("direction", list(directions()))
def test_every_orientation_gives_every_voxel_its_own_cell(direction):
    image = grid(direction)
    made = boxes(image)
    cells = cell_of_voxels(image, made.points, made.blocks)
    np.testing.assert_array_equal(
        sample(cells, made.values["Mu"]), expected(image, made.values["Mu"])
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_planar_mesh_fills_the_slice_of_a_volume_that_it_lies_in(axis):
    image = grid(TURN, (14, 13, 12))
    points, cells = square_mesh(8, 8, 9.0, 9.0)
    index = np.insert(points + 1.2, axis, 4.0, axis=1)
    found = cell_of_voxels(image, image.index_to_world(index), [("triangle", cells)])
    others = np.delete(found, 4, axis=2 - axis)
    assert (others == -1).all()
    flat = slice_of_image(image, axis, 4)
    alone = cell_of_voxels(flat, image.index_to_world(index), [("triangle", cells)])
    assert np.array_equal(alone.squeeze(2 - axis), found.take(4, axis=2 - axis))
    # 9 x 9 voxel centres lie in 1.2 … 10.2, each of them in the square it must lie in
    assert (alone >= 0).sum() == 81
    at = np.argwhere(alone.squeeze(2 - axis) >= 0)[:, ::-1]
    numbers = alone[alone >= 0]
    square = np.floor((at - 1.2) / 9.0 * 8).astype(int)
    assert np.array_equal(numbers // 2, square @ [1, 8])


def test_a_plane_that_crosses_a_volume_obliquely_is_seen_once_per_column():
    image = Image(np.zeros((20, 10, 10)))
    points, cells = square_mesh(3, 3, 7.0, 7.0)
    points = np.column_stack([points + 1.1, 2.0 + 0.5 * points[:, 0]])
    found = cell_of_voxels(image, points, [("triangle", cells)])
    k, j, i = np.nonzero(found >= 0)
    assert len(k) == 49 and len(np.unique(j * 10 + i)) == 49
    assert np.abs(k - (2.0 + 0.5 * (i - 1.1))).max() <= 0.5


def test_an_image_that_the_mesh_does_not_lie_in_is_refused():
    image = grid(np.eye(3))
    made = boxes(image)
    with pytest.raises(InputError, match="no voxel of the image lies in the mesh"):
        cell_of_voxels(image, made.points + 100, made.blocks)
