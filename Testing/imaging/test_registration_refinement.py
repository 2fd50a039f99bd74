"""The second step: what smooth deformations miss is found in the images."""

import numpy as np
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.imaging.registration.correlation import equilibrium_gap, refine_displacement
from scipy import ndimage
from scipy.spatial import Delaunay


def grid(count, edge, first):
    x, y = np.meshgrid(*[first + edge * np.arange(count + 1)] * 2)
    number = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    cells = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], -1)
    return np.stack([x.ravel(), y.ravel()], 1).astype(float), cells.reshape(-1, 4)


def shifted_pair(shift, blank=0):
    """A texture and its copy shifted exactly (Fourier) along i, j; the first columns blank."""
    noise = np.random.default_rng(0).standard_normal((160, 160))
    rest = ndimage.gaussian_filter(noise, 1.6, mode="wrap")
    rest /= rest.std()
    pushed = np.fft.ifft2(ndimage.fourier_shift(np.fft.fft2(rest), shift[::-1])).real
    for image in (rest, pushed):
        image[:, :blank] = 0.0
    return rest, pushed


def lengths(vectors):
    return np.linalg.norm(vectors, axis=1)


def test_a_wrong_start_is_corrected_where_there_is_texture_and_does_no_harm_where_not():
    shift = np.array([1.3, -0.7])
    rest, pushed = shifted_pair(shift, blank=60)
    points, cells = grid(8, 12.0, 32.0)
    start = shift + 0.3 * np.sin(points / 25)
    found = refine_displacement(rest, pushed, points, cells, start)
    seen, blind = points[:, 0] > 80, points[:, 0] < 45
    before, after = (lengths(u - shift) for u in (start, found))
    assert after[seen].mean() < 0.1 * before[seen].mean()
    assert after[blind].mean() < 1.2 * before[blind].mean()


def test_images_without_texture_change_nothing():
    points, cells = grid(8, 12.0, 32.0)
    start = np.sin(points / 25)
    blank = np.zeros((160, 160))
    np.testing.assert_array_equal(refine_displacement(blank, blank, points, cells, start), start)


def test_taller_pixels_and_a_turned_mesh_give_the_same_displacement():
    """Every second row left out: the same body on pixels twice as tall; cells turned round."""
    shift = np.array([1.3, -0.8])
    rest, pushed = shifted_pair(shift)
    points, cells = grid(8, 12.0, 32.0)
    start = shift + 0.3 * np.sin(points / 25)
    square = refine_displacement(rest, pushed, points, cells, start)
    half = np.array([1.0, 0.5])
    tall = refine_displacement(
        *(ndimage.gaussian_filter1d(one, 0.5, axis=0)[::2] for one in (rest, pushed)),
        points * half,
        cells[:, ::-1],
        start * half,
        spacing=np.array([1.0, 2.0]),
    )
    assert lengths(square - shift).mean() < 0.03
    assert lengths(tall / half - shift).mean() < 0.05


def test_a_balanced_displacement_has_no_gap_and_an_unbalanced_one_has():
    points, cells = grid(6, 1.0, 0.0)
    gap = equilibrium_gap(make_mesh(points, cells))
    affine = points @ np.array([[0.1, -0.2], [0.05, 0.3]])
    wavy = np.sin(3 * points[:, ::-1])
    sizes = [u.ravel() @ gap @ u.ravel() for u in (affine, wavy)]
    assert sizes[0] < 1e-10 < 1e-2 < sizes[1]


def test_tetrahedra_follow_a_volume():
    noise = np.random.default_rng(0).standard_normal((40, 40, 40))
    rest = ndimage.gaussian_filter(noise, 1.6, mode="wrap")
    shift = np.array([0.8, -0.5, 0.3])
    pushed = np.fft.ifftn(ndimage.fourier_shift(np.fft.fftn(rest), shift[::-1])).real
    ticks = np.arange(4.0, 36.0, 7.5)
    points = np.stack([axis.ravel() for axis in np.meshgrid(ticks, ticks, ticks)], 1)
    cells = Delaunay(points + 1e-3 * np.sin(7 * points)).simplices
    start = shift + 0.3 * np.sin(points / 9)
    found = refine_displacement(rest, pushed, points, cells, start)
    assert lengths(found - shift).mean() < 0.2 * lengths(start - shift).mean()


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
