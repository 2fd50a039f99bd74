"""Grids in every orientation, and a small map with known values to put on them."""

from itertools import permutations, product

import numpy as np
from elastoidentify.export.cell_map import CellMap
from elastoidentify.fem.forward import box_mesh
from elastoidentify.imaging.image import Image
from scipy.spatial.transform import Rotation

TURN = Rotation.from_euler("zyx", (25, -35, 50), degrees=True).as_matrix()
SIZE, SPACING, ORIGIN = (6, 5, 4), (1.1, 1.7, 2.3), (-183.25, 97.5, 412.125)


def directions():
    """All 48 axis orders and flips, and the same number of oblique grids."""
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            straight = np.eye(3)[:, order] * signs
            yield straight
            yield TURN @ straight


def grid(direction, size=SIZE, seed=0):
    """An image of this direction matrix, with random grey values."""
    array = np.random.default_rng(seed).integers(1, 999, size[::-1]).astype(np.int16)
    return Image(array, ORIGIN, SPACING, direction)


def boxes(image, values=None, margin=1.0, **more):
    """A map of hexahedra that covers all of an image but `margin` voxels on each side.

    Its cells are one voxel each, so what every voxel must be is known without looking for it.
    """
    size = np.array(image.size) - 2 * margin
    points, cells = box_mesh(tuple(size.astype(int)), size)
    points = image.index_to_world(points + margin - 0.5)
    if np.linalg.det(image.direction) < 0:  # keep the cells' volumes positive
        cells = cells[:, [4, 5, 6, 7, 0, 1, 2, 3]]
    n = len(cells)
    rng = np.random.default_rng(1)
    status = rng.choice([0, 1, 2, 2, 2], n)
    mu = np.where(status == 0, np.nan, rng.uniform(500, 9000, n) if values is None else values)
    return CellMap(
        points,
        [("hexahedron", cells)],
        {"Mu": mu, "MuStd": 0.1 * mu, "YoungModulus": 2.9 * mu, "YoungModulusStd": 0.3 * mu},
        status,
        1 + np.arange(n) % 3,
        label_names={1: "pad", 2: "tissue", 3: "inclusion"},
        provenance={"elastoidentify": "9.9", "inputs": {"rest": {"name": "r", "sha256": "00"}}},
        report={"method": "regularized", "kinematics": "neo-hookean", "warnings": ["a warning"]},
        **more,
    )


def expected(image, values, margin=1, outside=np.nan):
    """The values of :func:`boxes` on the image's grid, by its construction."""
    array = np.full(image.array.shape, outside, float)
    inner = tuple(slice(margin, n - margin) for n in image.array.shape)
    array[inner] = np.reshape(values, [n - 2 * margin for n in image.array.shape])
    return array
