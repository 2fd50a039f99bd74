"""Image pairs whose displacement is known exactly, to judge registrations by.

A block of tissue 208 pixels wide in an image of 256 × 256 pixels stands on the floor, holds an
inclusion eight times stiffer and is pushed from above. The displacement is a quadratic finite
element solution (scikit-fem), read as a cubic spline; that spline *is* the truth: the pushed image
is rendered by inverting it, from a source sampled four times finer than the images.

Index coordinates throughout: x along a row (i), y down the rows (j).
"""

from dataclasses import dataclass
from functools import cache
from importlib import metadata

import numpy as np
import scipy.sparse as sp
from elastoidentify.linalg.factor import Factoriser
from scipy import ndimage
from scipy.spatial import Delaunay

SIZE = 256
LOW, HIGH = 24.0, 232.0
INCLUSION = (152.0, 112.0, 30.0)
MARGIN, FINE = 40, 4
DIRECTIONS = {"straight": (0.0, 1.0), "oblique": (np.sqrt(0.5), np.sqrt(0.5))}


class Displacement:
    """A displacement given on a one-pixel grid that starts at −`MARGIN`, as a cubic spline."""

    def __init__(self, grid: np.ndarray):
        self._splines = [ndimage.spline_filter(one, 3, mode="nearest") for one in grid]

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Displacement (n, 2) at points (n, 2)."""
        where = points.T[::-1] + MARGIN
        return np.stack(
            [
                ndimage.map_coordinates(one, where, order=3, prefilter=False, mode="nearest")
                for one in self._splines
            ],
            1,
        )

    def gradient(self, points: np.ndarray, step: float = 1e-3) -> np.ndarray:
        """∂u_i/∂x_j, (n, 2, 2)."""
        shifts = step * np.eye(2)
        return np.stack([(self(points + s) - self(points - s)) / (2 * step) for s in shifts], 2)

    def origin_of(self, there: np.ndarray) -> np.ndarray:
        """The points x with x + u(x) = `there`, by Newton's method."""
        x = there - self(there)
        for _ in range(60):
            rest = there - x - self(x)
            if np.abs(rest).max() < 1e-6:
                return x
            step = np.linalg.solve(np.eye(2) + self.gradient(x), rest[..., None])[..., 0]
            x = x + np.clip(step, -4, 4)
        raise ArithmeticError("the displacement could not be inverted")


def unit_push(direction: str) -> np.ndarray:
    """Displacement grid (2, m, m) of a push of one pixel at the top."""
    return np.tensordot(DIRECTIONS[direction], axis_pushes(), 1)


@cache
def axis_pushes() -> np.ndarray:
    """Displacement grids (2, 2, m, m) of pushes of one pixel along x, and along y.

    Any other push is their sum, for the problem is linear.
    """
    import skfem

    ticks = np.arange(LOW, HIGH + 1, 2.0)
    basis = skfem.Basis(skfem.MeshQuad.init_tensor(ticks, ticks), skfem.ElementQuad2(), intorder=4)
    x, y = basis.doflocs
    top, floor = (np.repeat(np.isclose(y, end), 2) for end in (LOW, HIGH))
    u = top[:, None] * np.tile(np.eye(2), (len(y), 1))  # unknowns x, y, x, y, …; a column per push
    _solve(_stiffness(basis), u, ~top & ~floor, np.repeat(basis.doflocs.T, 2, axis=0))
    grid = np.full((2, 2, SIZE + 2 * MARGIN + 1, SIZE + 2 * MARGIN + 1), np.nan)
    i, j = (np.rint(one).astype(int) + MARGIN for one in (x, y))
    grid[..., j, i] = u.reshape(len(y), 2, 2).T
    return _extend(grid)


def _stiffness(basis):
    """Matrix of the block on equal squares, the unknowns of a node one after the other.

    The squares differ in their material only, so the products of gradients are made once.
    """
    x, y = basis.global_coordinates()
    cx, cy, radius = INCLUSION
    young, poisson = np.where((x - cx) ** 2 + (y - cy) ** 2 < radius**2, 8.0, 1.0), 0.47
    lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson)) * basis.dx
    mu = young / (2 * (1 + poisson)) * basis.dx
    slope = np.stack([one[0].grad[:, 0] for one in basis.basis])  # (nodes, 2, Gauss points)
    dilatation = np.einsum("aiq,bjq->qaibj", slope, slope)
    shear = np.einsum("akq,bkq,ij->qaibj", slope, slope, np.eye(2))
    shear += np.einsum("ajq,biq->qaibj", slope, slope)
    size = 2 * len(slope)
    local = (part.reshape(-1, size**2) for part in (dilatation, shear))
    values = sum(factor @ part for factor, part in zip((lam, mu), local, strict=True))
    rows = (2 * basis.element_dofs.T[:, :, None] + np.arange(2)).reshape(-1, size)
    place = np.repeat(rows, size, axis=1).ravel(), np.tile(rows, size).ravel()
    return sp.csr_matrix((values.ravel(), place))


def _solve(matrix, values, free, places):
    """Fill in the free rows of `values` (n, k), so that the equations of these rows hold."""
    factors = Factoriser(places[free])(matrix[free][:, free])
    values[free] = factors.solve(-(matrix[free][:, ~free] @ values[~free]))


def _extend(grids: np.ndarray) -> np.ndarray:
    """Fill the unknown (NaN) part of grids (..., m, m) harmonically, to 0 at their border."""
    grids = grids.copy()
    grids[..., [0, -1], :] = grids[..., [0, -1]] = 0.0
    size = grids.shape[-1]
    second = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(size, size))
    laplace = (sp.kron(second, sp.eye(size)) + sp.kron(sp.eye(size), second)).tocsr()
    flat = grids.reshape(-1, size**2).T.copy()
    free = np.isnan(flat[:, 0])
    _solve(laplace, flat, free, np.argwhere(np.ones((size, size))))
    return flat.T.reshape(grids.shape)


def mr_volume():
    """The MNI152 T1 template among the files of the nilearn wheel, (k, j, i) array."""
    import SimpleITK as sitk

    name = "mni_icbm152_t1_tal_nlin_sym_09a_converted.nii.gz"
    path = next(file.locate() for file in metadata.files("nilearn") if file.name == name)
    return sitk.GetArrayFromImage(sitk.ReadImage(str(path))).astype(float)


@cache
def source(texture: str) -> np.ndarray:
    """Spline coefficients of the fine image of the block, grey values 0 to 1."""
    count = (SIZE + 2 * MARGIN) * FINE
    ticks = np.arange(count) / FINE - MARGIN
    if texture == "speckle":
        random = np.random.default_rng(0).standard_normal((count, count))
        values = ndimage.gaussian_filter(random, 1.6 * FINE, mode="wrap")
        values = np.clip(0.5 + 0.17 * values / values.std(), 0.05, 1)
    elif texture == "mr":
        slice_ = mr_volume()[92]
        across = (ticks - (LOW + HIGH) / 2) * 118 / (HIGH - LOW)
        rows, columns = ((length - 1) / 2 + across for length in slice_.shape)
        where = np.meshgrid(rows, columns, indexing="ij")
        values = ndimage.map_coordinates(ndimage.gaussian_filter(slice_, 0.4), where, order=5)
        values = np.clip(values / slice_.max(), 0, 1)
        share = np.clip((values - 0.10) / 0.2, 0, 1)  # the background becomes plain soft tissue
        values = np.maximum(share * values + (1 - share) * 0.55, 0.05)
    else:
        raise ValueError(texture)
    inside = ((ticks >= LOW) & (ticks <= HIGH)).astype(float)
    block = ndimage.gaussian_filter(np.outer(inside, inside), 0.75 * FINE)
    return ndimage.spline_filter(0.03 + block * (values - 0.03), 5, mode="nearest")


def render(texture: str, points: np.ndarray) -> np.ndarray:
    """Grey values of the resting block at points (n, 2)."""
    where = (points.T[::-1] + MARGIN) * FINE
    return ndimage.map_coordinates(
        source(texture), where, order=5, prefilter=False, mode="nearest"
    ).reshape(SIZE, SIZE)


def rician(image: np.ndarray, noise: float, seed: int) -> np.ndarray:
    """The image as MR would see it: magnitude of a complex image with noise in both parts."""
    random = np.random.default_rng(seed)
    real, imaginary = noise * random.standard_normal((2, *image.shape))
    return np.hypot(image + real, imaginary) if noise else image


@dataclass
class Pair:
    """Rest and pushed image (256, 256) and the displacement as a function of points (n, 2)."""

    rest: np.ndarray
    pushed: np.ndarray
    displacement: Displacement


def make_pair(texture="speckle", direction="straight", push=0.05, noise=0.02, seed=1) -> Pair:
    """Make a pair: `push` as a share of the block's height, `noise` as a share of the range."""
    displacement = Displacement(unit_push(direction) * push * (HIGH - LOW))
    j, i = np.mgrid[:SIZE, :SIZE]
    grid = np.stack([i.ravel(), j.ravel()], 1).astype(float)
    rest, pushed = render(texture, grid), render(texture, displacement.origin_of(grid))
    return Pair(rician(rest, noise, 2 * seed), rician(pushed, noise, 2 * seed + 1), displacement)


def block_mesh(edge: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Irregular triangles on the block: points (n, 2), cells (m, 3), counter-clockwise."""
    count = round((HIGH - LOW) / edge)
    rows = round(count * 2 / np.sqrt(3))
    random = np.random.default_rng(seed)
    ticks = np.linspace(LOW, HIGH, count + 1)
    points = []
    for row, y in enumerate(np.linspace(LOW, HIGH, rows + 1)):
        x = ticks if row % 2 == 0 else np.r_[LOW, (ticks[:-1] + ticks[1:]) / 2, HIGH]
        inner = (x > LOW) & (x < HIGH) & (0 < row < rows)
        shift = random.uniform(-0.12, 0.12, (len(x), 2)) * edge * inner[:, None]
        points.append(np.stack([x, np.full(len(x), y)], 1) + shift)
    points = np.concatenate(points)
    cells = Delaunay(points).simplices
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    area = np.linalg.det(edges) / 2
    cells[area < 0] = cells[area < 0][:, ::-1]
    return points, cells[np.abs(area) > 0.05 * edge**2]


def cell_gradients(points, cells, displacement) -> np.ndarray:
    """∂u_i/∂x_j of the linear interpolation in every triangle, (m, 2, 2)."""
    edges, change = (
        np.swapaxes(values[cells[:, 1:]] - values[cells[:, :1]], 1, 2)
        for values in (points, displacement)
    )
    return change @ np.linalg.inv(edges)


def strain_error(points, cells, measured, true) -> float:
    """Root mean square error of the strain components xx, yy, xy over the cells."""
    error = cell_gradients(points, cells, measured - true)
    strain = (error + np.swapaxes(error, 1, 2)) / 2
    return float(np.sqrt(np.mean(strain[:, [0, 1, 0], [0, 1, 1]] ** 2)))


def rms(error: np.ndarray) -> float:
    """Root mean square length of vectors (n, d)."""
    return float(np.sqrt((error**2).sum(-1).mean()))
