"""The second step: what smooth deformations miss is found in the images."""

import numpy as np
from elastoidentify.imaging.refinement import refine_displacement
from scipy import ndimage


def grid(count, edge, first):
    x, y = np.meshgrid(*[first + edge * np.arange(count + 1)] * 2)
    number = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    cells = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], -1)
    return np.stack([x.ravel(), y.ravel()], 1).astype(float), cells.reshape(-1, 4)


def test_a_wrong_start_is_corrected_where_there_is_texture_and_kept_where_not():
    """A shift known exactly (Fourier), a start that is off by a smooth 0.3 px."""
    noise = np.random.default_rng(0).standard_normal((160, 160))
    rest = ndimage.gaussian_filter(noise, 1.6, mode="wrap")
    rest /= rest.std()
    shift = np.array([1.3, -0.7])  # along i, j
    pushed = np.fft.ifft2(ndimage.fourier_shift(np.fft.fft2(rest), shift[::-1])).real
    for image in (rest, pushed):
        image[:, :60] = 0.0  # nothing to see on the left
    points, cells = grid(8, 12.0, 32.0)
    start = shift + 0.3 * np.sin(points / 25)
    found = refine_displacement(rest, pushed, points, cells, start)
    seen, blind = points[:, 0] > 80, points[:, 0] < 45
    before, after = (np.linalg.norm(u - shift, axis=1)[seen].mean() for u in (start, found))
    assert after < 0.3 * before
    np.testing.assert_allclose(found[blind], start[blind], atol=1e-6)


def test_a_strain_jump_that_the_mesh_can_follow_is_sharpened():
    """Rest compressed on the right half only; the start is smoothed over the jump."""
    fine = ndimage.gaussian_filter(np.random.default_rng(1).standard_normal((160, 160)), 1.6)
    j, i = np.mgrid[:160, :160].astype(float)

    def displacement(x):
        return -0.08 * np.maximum(x - 80, 0)

    origin = np.where(i > 80, 80 + (i - 80) / 0.92, i)
    pushed = ndimage.map_coordinates(fine, [j, origin], order=3, mode="nearest")
    points, cells = grid(10, 12.0, 20.0)
    true = np.stack([displacement(points[:, 0]), np.zeros(len(points))], 1)
    start = true.copy()
    start[:, 0] -= 0.4 * np.exp(-(((points[:, 0] - 80) / 12) ** 2))
    found = refine_displacement(fine, pushed, points, cells, start)
    inner = (np.abs(points[:, 0] - 80) < 30) & (np.abs(points[:, 1] - 80) < 50)
    errors = [np.sqrt(np.mean((u - true)[inner] ** 2)) for u in (start, found)]
    assert errors[1] < 0.6 * errors[0]
