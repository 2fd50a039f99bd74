"""Tissue textures for phantoms: slices of real images, and speckle."""

from importlib import metadata
from pathlib import Path

import numpy as np
from scipy import ndimage

from ...errors import InputError
from ...installation import hint
from ..image import Image

MNI152_T1 = "mni_icbm152_t1_tal_nlin_sym_09a_converted.nii.gz"


def mni152_path() -> Path:
    """Return the MNI152 T1 template (a real MR average, 1 mm) that the nilearn wheel ships.

    The file is found through the wheel's list of files; nilearn itself is not imported.

    Raises
    ------
    InputError
        nilearn is not installed.
    """
    try:
        files = metadata.files("nilearn") or []
    except metadata.PackageNotFoundError:
        files = []
    for file in files:
        if file.name == MNI152_T1 and Path(file.locate()).is_file():
            return Path(file.locate())
    raise InputError(
        f"the MNI152 template is missing, {hint('demo')} (it comes with the nilearn package), or "
        "name an image of your own with --image"
    )


def slice_of(image: Image, axis: int | None = None, index: int | None = None) -> Image:
    """Return one slice of a volume as a planar image; a planar image as it is.

    Parameters
    ----------
    image : Image
    axis : 0, 1 or 2, optional
        Image axis i, j or k that the slice is normal to. Default: the one nearest to the third
        world axis (axial in LPS).
    index : int, optional
        Voxel index along that axis. Default: the middle.

    Returns
    -------
    Image
        In-plane axes point along the world axes' positive sense as far as they can, so that its
        array looks as a radiologist expects an axial slice: left of the patient on the right,
        front up.
    """
    if image.planar_axis is None:
        axis = int(np.abs(image.direction[2]).argmax()) if axis is None else axis
        if axis not in (0, 1, 2):
            raise InputError(f"slice axis {axis}: give 0, 1 or 2")
        count = image.size[axis]
        index = count // 2 if index is None else index
        if not 0 <= index < count:
            raise InputError(f"slice {index} is outside of the image: give 0 to {count - 1}")
        array = image.array.take([index], axis=2 - axis)
        first = np.zeros(3)
        first[axis] = index
        image = Image(array, image.index_to_world(first[None])[0], image.spacing, image.direction)
    return _upright(image)


def _upright(image: Image) -> Image:
    """Flip the image axes that point against their main world axis; the world stays the same."""
    main = np.abs(image.direction).argmax(0)
    sign = np.where(image.direction[main, range(3)] < 0, -1, 1)
    last = np.where(sign < 0, np.array(image.size) - 1, 0)
    return Image(
        image.array[tuple(slice(None, None, s) for s in sign[::-1])],
        image.index_to_world(last[None])[0],
        image.spacing,
        image.direction * sign,
    )


def in_plane(image: Image) -> tuple[np.ndarray, np.ndarray]:
    """Return the 2-D array (rows, columns) of a planar image and its (column, row) spacing."""
    thin = image.planar_axis
    if thin is None:
        raise InputError("a texture is a planar image: choose a slice of the volume")
    columns, rows = (axis for axis in range(3) if axis != thin)
    return image.array.take(0, axis=2 - thin), image.spacing[[columns, rows]]


def sample_texture(image: Image, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Sample a planar image around its centre, grey values scaled to 0.1…1.

    Parameters
    ----------
    image : Image
        Planar.
    x, y : (nx,), (ny,)
        Positions along columns and rows from the image's centre, in the image's length unit.
        Beyond the border the image is mirrored.

    Returns
    -------
    (ny, nx) array
        The 1st percentile of the result is 0.1, not 0: a dark voxel of tissue still has signal.
    """
    array, spacing = in_plane(image)
    array = ndimage.gaussian_filter(np.asarray(array, float), 0.4)
    centre = (np.array(array.shape) - 1) / 2
    rows, columns = centre[0] + y / spacing[1], centre[1] + x / spacing[0]
    grid = np.meshgrid(rows, columns, indexing="ij")
    values = ndimage.map_coordinates(array, grid, order=3, mode="mirror")
    low, high = np.percentile(values, (1, 99))
    if not high - low > 1e-9 * max(abs(high), abs(low)):
        raise InputError("the texture image is constant where it is used: choose another slice")
    return np.clip(0.1 + 0.9 * (values - low) / (high - low), 0.05, 1.1)


def sample_volume(image: Image, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Sample a volume around its centre, grey values scaled to 0.1…1.

    Parameters
    ----------
    image : Image
    x, y, z : (nx,), (ny,), (nz,)
        Positions along columns, rows and slices from the image's centre, in its length unit.
        Beyond the border the image is mirrored.

    Returns
    -------
    (nz, ny, nx) array
        Scaled as by :func:`sample_texture`.
    """
    if image.planar_axis is not None:
        raise InputError("the texture of a volume is a volume: this image has one slice only")
    values = ndimage.gaussian_filter(np.asarray(image.array, float), 0.4)
    for axis, at in enumerate((z, y, x)):  # a grid of places: one axis after the other
        index = (values.shape[axis] - 1) / 2 + at / image.spacing[2 - axis]
        coefficients = ndimage.spline_filter1d(values, 3, axis, mode="mirror")
        weights = _spline_weights(index, values.shape[axis])
        values = np.moveaxis(np.tensordot(weights, coefficients, (1, axis)), 0, axis)
    low, high = np.percentile(values, (1, 99))
    if not high - low > 1e-9 * max(abs(high), abs(low)):
        raise InputError("the texture image is constant where it is used: choose another image")
    return np.clip(0.1 + 0.9 * (values - low) / (high - low), 0.05, 1.1)


def _spline_weights(index: np.ndarray, count: int) -> np.ndarray:
    """Cubic B-splines of `count` samples, mirrored at both ends, at places `index`: (n, count)."""
    weights = np.zeros((len(index), count))
    for tap in range(-1, 3):
        sample = np.floor(index).astype(int) + tap
        distance = np.abs(index - sample)
        near = 2 / 3 - distance**2 + distance**3 / 2
        value = np.where(distance < 1, near, np.maximum(2 - distance, 0) ** 3 / 6)
        folded = np.abs(sample) % (2 * count - 2)
        folded = np.minimum(folded, 2 * count - 2 - folded)
        np.add.at(weights, (np.arange(len(index)), folded), value)
    return weights


def speckle(shape: tuple[int, ...], grain: float, rng: np.random.Generator) -> np.ndarray:
    """Return a random texture of mean 0.5 with grains of standard deviation `grain` samples."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), grain, mode="wrap")
    return np.clip(0.5 + 0.17 * noise / noise.std(), 0.05, 1.0)
