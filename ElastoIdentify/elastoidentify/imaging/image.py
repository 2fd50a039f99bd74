"""An image with its place in the world, in ITK's convention."""

from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError


@dataclass(frozen=True)
class Image:
    """A scalar image on a regular grid.

    Always three-dimensional: a planar image is a volume with one axis of length 1 (of any
    orientation). Voxel centres are at integer indices.

    Parameters
    ----------
    array : ndarray, shape (nk, nj, ni)
        Values; the *last* axis is the first image axis i, as SimpleITK and VTK store it.
    origin : ndarray, shape (3,)
        World position of the centre of voxel (0, 0, 0), usually mm in LPS.
    spacing : ndarray, shape (3,)
        Distance of voxel centres along i, j, k.
    direction : ndarray, shape (3, 3)
        Columns are the unit vectors of the i, j, k axes in the world.
    notes : tuple of str
        Sentences on what was assumed when it was read.
    """

    array: np.ndarray
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    spacing: np.ndarray = field(default_factory=lambda: np.ones(3))
    direction: np.ndarray = field(default_factory=lambda: np.eye(3))
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        array = np.asarray(self.array)
        if array.ndim == 2:
            array = array[None]
        if array.ndim != 3:
            raise InputError(
                f"an image needs 2 or 3 dimensions and one value per voxel, this array has shape "
                f"{array.shape}: convert colour images to grey first"
            )
        object.__setattr__(self, "array", array)
        for name, shape in (("origin", (3,)), ("spacing", (3,)), ("direction", (3, 3))):
            object.__setattr__(self, name, np.array(getattr(self, name), float).reshape(shape))

    @property
    def size(self) -> tuple[int, int, int]:
        """Number of voxels along i, j, k."""
        return self.array.shape[::-1]

    @property
    def axes(self) -> np.ndarray:
        """Columns: the world vectors of one index step along i, j, k. Shape (3, 3)."""
        return self.direction * self.spacing

    @property
    def planar_axis(self) -> int | None:
        """The axis (0, 1, 2 for i, j, k) of length 1 of a one-slice image, None for a volume."""
        thin = [axis for axis in range(3) if self.size[axis] == 1]
        return thin[-1] if thin else None

    @property
    def pixel_sides(self) -> np.ndarray:
        """Spacing along the axes on which the image has more than one voxel, at most (3,)."""
        return self.spacing[np.array(self.size) > 1]

    def index_to_world(self, index: np.ndarray) -> np.ndarray:
        """Map continuous indices (n, 3), ordered i, j, k, to world points (n, 3)."""
        return np.asarray(index, float) @ self.axes.T + self.origin

    def world_to_index(self, points: np.ndarray) -> np.ndarray:
        """Map world points (n, 3) to continuous indices (n, 3), ordered i, j, k."""
        return (np.asarray(points, float) - self.origin) @ np.linalg.inv(self.axes).T

    def with_array(self, array: np.ndarray) -> "Image":
        """Return another image of the same geometry."""
        return Image(array, self.origin, self.spacing, self.direction, self.notes)
