"""What the image tells about a displacement: closed forms."""

import numpy as np
import pytest
from elastoidentify.imaging.registration.information import (
    displacement_information,
    noise_of_difference,
    simplices,
    strain_spread,
    voxels_in_cells,
)

SPACING = 8.0


def square_grid(count=8, first=10.0, edge=SPACING):
    """Quadrilaterals on a square grid: points (n, 2), cells (m, 4)."""
    x, y = np.meshgrid(*[first + edge * np.arange(count + 1)] * 2)
    number = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    cells = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], -1)
    return np.stack([x.ravel(), y.ravel()], 1), cells.reshape(-1, 4)


def test_voxels_are_found_once_with_shape_functions_that_reproduce_them():
    points, cells = square_grid()
    points += 0.3 * np.sin(points[:, ::-1])
    voxels, nodes, weights = voxels_in_cells(points, cells, (90, 100))
    assert len(np.unique(voxels)) == len(voxels)
    j, i = np.unravel_index(voxels, (90, 100))
    np.testing.assert_allclose(weights.sum(1), 1)
    found = np.einsum("va,vad->vd", weights, points[nodes])
    np.testing.assert_allclose(found, np.stack([i, j], 1), atol=1e-6)
    assert len(voxels) == pytest.approx(64 * SPACING**2, rel=0.05)


def test_the_voxels_of_hexahedra_fill_them():
    x = np.array([[i, j, k] for k in (2.0, 7.0) for j in (1.0, 6.0) for i in (3.0, 9.0)])
    hexahedron = np.array([[0, 1, 3, 2, 4, 5, 7, 6]])
    voxels, nodes, weights = voxels_in_cells(x, hexahedron, (10, 11, 12))
    assert len(voxels) == 6 * 6 * 7
    k, j, i = np.unravel_index(voxels, (10, 11, 12))
    found = np.einsum("va,vad->vd", weights, x[nodes])
    np.testing.assert_allclose(found, np.stack([i, j, k], 1), atol=1e-9)


def test_noise_is_estimated_through_edges_and_outliers():
    random = np.random.default_rng(0)
    difference = 3.0 * random.standard_normal(20000)
    difference[:1000] += 200
    assert noise_of_difference(difference) == pytest.approx(3.0, rel=0.1)


def plane_wave(shape=(90, 90), period=12.0, amplitude=1.0):
    """An image that varies along i only; mean squared gradient a²ω²/2."""
    i = np.arange(shape[1])
    return np.broadcast_to(amplitude * np.sin(2 * np.pi * i / period), shape).copy()


def test_information_of_a_plane_wave_is_its_gradient_over_the_noise():
    random = np.random.default_rng(1)
    noise, period, points = 0.05, 12.0, square_grid()
    wave = plane_wave(period=period)
    first, second = (wave + noise * random.standard_normal(wave.shape) for _ in range(2))
    information, share, found = displacement_information(
        first, second, *points, np.zeros_like(points[0]), resolution=16.0
    )
    assert found == pytest.approx(noise * np.sqrt(2), rel=0.05)
    middle = np.all((points[0] > 15) & (points[0] < 69), 1)
    omega = 2 * np.pi / period
    blurred = (np.exp(-((0.7 * omega) ** 2) / 2)) ** 2  # the derivative filter's own attenuation
    expected = SPACING**2 * blurred * omega**2 / 2 / (2 * noise**2)
    assert np.mean(information[middle, 0, 0]) == pytest.approx(expected, rel=0.1)
    np.testing.assert_allclose(share[middle], SPACING**2 / 16**2, rtol=0.05)
    # nothing is known across the wave
    assert np.max(information[middle, 1, 1]) < 0.01 * expected


def test_noise_alone_is_no_texture():
    random = np.random.default_rng(2)
    points, cells = square_grid()
    first, second = 10 + random.standard_normal((2, 90, 90))
    information, share, _ = displacement_information(
        first, second, points, cells, np.zeros_like(points)
    )
    std = 1 / np.sqrt(np.maximum(np.linalg.eigvalsh(information)[:, 1] / share, 1e-12))
    assert np.median(std) > 2  # pixels


def test_a_coarse_mesh_never_claims_more_than_the_registration_resolves():
    random = np.random.default_rng(3)
    wave = plane_wave((200, 200)) + plane_wave((200, 200)).T
    first, second = (wave + 0.05 * random.standard_normal(wave.shape) for _ in range(2))
    best = []
    for edge in (16.0, 32.0):
        points, cells = square_grid(5, edge=edge)
        information, share, _ = displacement_information(
            first, second, points, cells, np.zeros_like(points)
        )
        inner = ((points > points.min(0)) & (points < points.max(0))).all(1)
        best.append(np.mean(information[inner, 0, 0]))
        assert share.max() == pytest.approx(1.0, abs=1e-3)
    assert best[1] == pytest.approx(best[0], rel=0.15)


def test_a_change_of_strain_lowers_the_information_there():
    wave = plane_wave() + plane_wave().T
    points, cells = square_grid()
    bent = np.zeros_like(points)
    bent[:, 0] = 0.1 * np.maximum(points[:, 0] - 42, 0)  # the strain jumps at x = 42
    random = np.random.default_rng(4)
    images = [wave + 0.02 * random.standard_normal(wave.shape) for _ in range(2)]
    information, _, _ = displacement_information(*images, points, cells, bent)
    inner = (points[:, 1] > 20) & (points[:, 1] < 60)
    at = {x: information[inner & (points[:, 0] == x), 0, 0].mean() for x in (26, 42, 58)}
    assert at[42] < 0.3 * at[26] and at[42] < 0.3 * at[58]


def test_an_affine_displacement_has_no_strain_spread():
    points, cells = square_grid()
    affine = points @ np.array([[0.1, -0.2], [0.05, 0.3]])
    assert np.max(strain_spread(points, simplices(cells, 2), affine)) < 1e-20
