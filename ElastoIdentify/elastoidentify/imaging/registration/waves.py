"""Arrays of ultrasound's radiofrequency data: lines of echoes that oscillate with the carrier."""

import numpy as np
from scipy import ndimage
from scipy.signal import hilbert

from .correlation import warped_values
from .information import fit_grey_values

DYNAMIC_RANGE = 50.0  # dB below the brightest that an envelope shows
BRIGHTEST = 99.5  # percentile
CARRIES = 3.0, 16.0  # samples: a wavelength within which data are taken for radiofrequency
OSCILLATES = 0.3  # how far below 0 the autocorrelation of such data falls
LEVEL = 0.05  # largest mean over standard deviation of what oscillates around 0


def wavelength(array: np.ndarray, axis: int) -> float:
    """Return the mean wavelength along an axis, in samples, from the phase from one to the next."""
    signal = np.moveaxis(hilbert(array.astype(float), axis=axis), axis, -1)
    turn = np.angle(np.vdot(signal[..., :-1], signal[..., 1:]))
    return float(2 * np.pi / abs(turn)) if turn else np.inf


def envelope(array: np.ndarray, axis: int, every: int) -> np.ndarray:
    """Return the log-envelope of lines along an axis, in dB, one in `every` samples."""
    size = np.abs(hilbert(array.astype(float), axis=axis))
    size = ndimage.gaussian_filter1d(size, every / 2, axis=axis) if every > 1 else size
    size = size[(slice(None),) * axis + (slice(None, None, every),)]
    floor = 10 ** (-DYNAMIC_RANGE / 20)
    level = np.log10(np.maximum(size / np.percentile(size, BRIGHTEST), floor))
    return (20 * level + DYNAMIC_RANGE).astype(np.float32)


def waves_along(array: np.ndarray) -> int | None:
    """Return the axis along which an array oscillates as radiofrequency data do, or None."""
    array = np.asarray(array, float)
    deviation = array.std()
    if not deviation > 0 or abs(array.mean()) > LEVEL * deviation:
        return None
    for axis in range(array.ndim):
        if array.shape[axis] > 4 * CARRIES[1]:
            lines = np.moveaxis(array, axis, -1)
            lags = range(1, int(CARRIES[1] / 2) + 1)
            alike = [np.mean(lines[..., :-lag] * lines[..., lag:]) / deviation**2 for lag in lags]
            shortest, longest = (size / 2 for size in CARRIES)
            if min(alike) < -OSCILLATES and shortest <= 1 + int(np.argmin(alike)) <= longest:
                return axis
    return None


def as_seen(array: np.ndarray) -> np.ndarray:
    """Return what people look at: an image as it is, of radiofrequency data the envelope."""
    axis = waves_along(array)
    return array if axis is None else envelope(array, axis, 1)


def agreement(rest, pushed, displacement, located) -> tuple[np.ndarray, np.ndarray]:
    """Compare two arrays around every node, the second pulled back by a displacement.

    Parameters
    ----------
    rest, pushed : (nj, ni) or (nk, nj, ni)
    displacement : (n, d)
        Of the nodes, in voxels.
    located : tuple
        Of :func:`~.information.voxels_in_cells`.

    Returns
    -------
    agreement : (n,)
        Correlation around the node, from −1 to 1; 0 where there is no voxel.
    warped : array like `rest`
        The second array pulled back, in the grey values of the first; NaN where nothing is seen.
    """
    voxels, near, weights = located
    values, seen = warped_values(pushed, rest.shape, displacement, located)
    own = rest.ravel()[voxels].astype(float)
    gain, offset = fit_grey_values(own[seen], values[seen]) if seen.any() else (1.0, 0.0)
    levelled = gain * values + offset

    def around(product):
        product = (product * seen)[:, None] * weights
        return np.bincount(near.ravel(), product.ravel(), minlength=len(displacement))

    with np.errstate(divide="ignore", invalid="ignore"):
        alike = around(own * levelled) / np.sqrt(around(own**2) * around(levelled**2))
    warped = np.full(rest.size, np.nan)
    warped[voxels[seen]] = levelled[seen]
    return np.nan_to_num(alike), warped.reshape(rest.shape)
