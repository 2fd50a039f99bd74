"""Noise floor, residual and displacement on real images, beside a public code.

    python Testing/benchmarks/noise_floor.py --data FOLDER

The images are other people's and not in this repository: FILES and those of `real_data.py` have
their addresses and checksums. The peer is AL-DIC (BSD-3-Clause): `pip install al-dic`. Where it is
not installed, our rows are printed alone.

Both codes measure at the same nodes, a square lattice of 16 pixels on the body: the nodes of ours
are the corners of triangles, those of AL-DIC the centres of its subsets. Inner nodes are counted.

No pair is known to be of an unmoved body. Between the two frames that are called still here the
plate hardly stretches (nobody says whether the load was the same), and the strip does so evenly, by
one small step. But the picture of the plate wanders by hundredths of a pixel, smoothly, as through
warm air. So the floor is given twice: after taking off the motion that is linear in the position,
and after taking off all that is smoother than waves of about 120 pixels. The second is what the
noise of the images does.
"""

import argparse
import logging
import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import real_data
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration.correlation import refine_displacement
from elastoidentify.imaging.registration.information import fit_grey_values, voxels_in_cells
from elastoidentify.imaging.registration.registration import register
from elastoidentify.workers.elastix_client import ElastixProcess
from real_data import MUDIC, Folder, Pair, Skip, compare, open_hole, tensile
from scipy import ndimage

DICE = "dicengine/dice, commit 5ebcdfa, tests/regression/dic_challenge_12/images"
FILES = {
    "oht_cfrp_10.tiff": (DICE, "419d2af33f7a1a327c9d00d7befd6684d95854e5352c012e136742a2f9267b39"),
    "oht_cfrp_11.tiff": (DICE, "f254453b8bb35de32f0480b5e504566d260f54996bc93929b4c2fff8804aa786"),
    "ut_152.tif": (MUDIC, "15ac22b1445944266956215366d049e0a4ce4beeb9fb5d3e05ac3950aff9a121"),
}
real_data.FILES.update(FILES)
STILL = {"oht_cfrp_0.bmp": "oht_cfrp_10.tiff", "oht_cfrp_4.bmp": "oht_cfrp_11.tiff"}
EDGE = 16  # pixels between nodes
MARGIN = 32  # pixels at the image's border that are left free
SMOOTH = 60.0  # pixels: half of the shortest wave that counts as smooth
WINDOWS = (16, 32)  # pixels across a subset of AL-DIC
WAVE, HEIGHT = 64.0, 0.5  # length and amplitude in pixels of the wave that is put on a real image
BLUR = 2.0  # pixels, at which it hardly matters how images are interpolated
DRAWS = 20  # of noise that is added to real images
BLOCK, RIM = 24, 6  # pixels of a block that the noise is read from, and of what is around it
HEAD = (
    "| method | floor, linear motion off | floor, smooth motion off | stated | found : stated |"
    " residual | : noise | wave | at the nodes |\n|---|---|---|---|---|---|---|---|---|"
)


class Still(Folder):
    """The last two frames of the plate under the names of the first and of a loaded one."""

    def grey(self, name: str) -> np.ndarray:
        return super().grey(STILL[name])[69:969, 49:329]  # as OpenCorr has cut them


@dataclass(frozen=True)
class Lattice:
    """Nodes on a body, and triangles between them; lengths in pixels."""

    points: np.ndarray  # (n, 2) x, y
    cells: np.ndarray  # (m, 3)
    inner: np.ndarray  # (n,) bool: all four squares around are there
    body: np.ndarray  # image, bool


@dataclass(frozen=True)
class Found:
    """What a method found at the nodes, in pixels, and what it states."""

    u: np.ndarray  # (n, 2), NaN where it found nothing
    covariance: np.ndarray | None = None  # (n, 2, 2)
    noise: float | None = None  # grey values, of one image


def lattice(body: np.ndarray) -> Lattice:
    """Squares of EDGE that are wholly on the body, each cut into two triangles."""
    height, width = ((n - 1 - 2 * MARGIN) // EDGE + 1 for n in body.shape)
    number = np.arange(height * width).reshape(height, width)
    cells, around = [], np.zeros(number.size, int)
    for row, column in np.ndindex(height - 1, width - 1):
        y, x = (MARGIN + EDGE * one for one in (row, column))
        if not body[y : y + EDGE + 1, x : x + EDGE + 1].all():
            continue
        a, b, d, c = number[row : row + 2, column : column + 2].ravel()
        around[[a, b, c, d]] += 1
        cells += [[a, b, c], [a, c, d]] if (row + column) % 2 else [[a, b, d], [b, c, d]]
    used, cells = np.unique(cells, return_inverse=True)
    points = MARGIN + EDGE * np.column_stack([used % width, used // width]).astype(float)
    return Lattice(points, cells.reshape(-1, 3), around[used] == 4, body)


# ---- the methods: (rest, pushed, lattice) to Found


def ours(worker: ElastixProcess, **options) -> Callable:
    """The registration with its defaults, or with other options."""

    def measure(rest, pushed, nodes):
        first, second = (Image(one.astype(np.float32)) for one in (rest, pushed))
        there = np.pad(nodes.points, ((0, 0), (0, 1)))
        found = register(first, [second], there, nodes.cells, elastix=worker, **options)
        xx, yy, xy = (found.information[0][:, k] for k in (0, 1, 3))
        information = np.stack([xx, xy, xy, yy], 1).reshape(-1, 2, 2)
        covariance = np.full(information.shape, np.nan)  # a node without weight states nothing
        weighted = np.linalg.det(information) > 0
        covariance[weighted] = np.linalg.inv(information[weighted])
        noise = found.report["trials"][0]["noise"]
        return Found(found.displacements[0][:, :2], covariance, noise)

    return measure


def peer(window: int) -> Callable:
    """AL-DIC with its defaults and square subsets of `window` pixels."""
    from al_dic.core.config import dicpara_default
    from al_dic.core.data_structures import GridxyROIRange
    from al_dic.core.pipeline import run_aldic

    def measure(rest, pushed, nodes):
        low, high = nodes.points.min(0).astype(int), nodes.points.max(0).astype(int)
        region = GridxyROIRange((low[0], high[0]), (low[1], high[1]))
        settings = dicpara_default(winsize=window, winstepsize=EDGE, gridxy_roi_range=region)
        masks = [nodes.body.astype(float)] * 2
        result = run_aldic(settings, [rest, pushed], masks, compute_strain=False)
        there, u = result.dic_mesh.coordinates_fem, result.result_disp[0].U.reshape(-1, 2)
        place = {tuple(one): k for k, one in enumerate(there)}
        nothing = np.full(2, np.nan)
        at = (place.get(tuple(one)) for one in nodes.points)
        return Found(np.array([nothing if k is None else u[k] for k in at]))

    return measure


def methods(worker: ElastixProcess) -> dict[str, Callable]:
    """Ours, and the peer where it is installed."""
    found = {"the default": ours(worker), "without the second step": ours(worker, refine=False)}
    try:
        return found | {f"AL-DIC, window {one}": peer(one) for one in WINDOWS}
    except ImportError as missing:
        print(f"AL-DIC is left out: {missing}: pip install al-dic", file=sys.stderr)
        return found


def measured(pair: Pair, nodes: Lattice, tools: dict[str, Callable]) -> dict[str, Found]:
    """What every method finds."""
    return {name: one(pair.rest, pair.pushed[0], nodes) for name, one in tools.items()}


# ---- the figures


def left_over(points: np.ndarray, u: np.ndarray, shortest: float | None = None) -> np.ndarray:
    """What is left of u after the best polynomial, scaled up by the freedom that it took.

    Parameters
    ----------
    points : (n, 2)
    u : (n, d)
    shortest : float, optional
        The degree along each axis is the extent over this length; default: 1, x, y.

    Returns
    -------
    (n, d)
    """
    extent = np.ptp(points, axis=0)
    place = 2 * (points - points.min(0)) / extent - 1
    degree = [1, 1] if shortest is None else np.maximum(np.round(extent / shortest), 1).astype(int)
    terms = np.polynomial.legendre.legvander2d(*place.T, degree)
    if shortest is None:
        terms = terms[:, :3]  # without x y
    left = u - terms @ np.linalg.lstsq(terms, u, rcond=None)[0]
    return left * np.sqrt(len(u) / (len(u) - terms.shape[1]))


def camera_noise(pair: Pair, nodes: Lattice, u: np.ndarray) -> float:
    """Standard deviation of one image's noise in grey values, from blocks of a still pair.

    The difference of two blocks, whole pixels apart, is fitted by gain, offset, and the gradient of
    their mean times a motion linear in the position. What is left is the noise of both, which
    nothing has interpolated.
    """
    squares, freedom = 0.0, 0
    for centre, motion in zip(nodes.points[nodes.inner], u[nodes.inner], strict=True):
        low = (centre - BLOCK // 2 - RIM).astype(int)
        places = (pair.rest, low), (pair.pushed[0], low + np.round(motion).astype(int))
        size = BLOCK + 2 * RIM
        first, second = (image[y : y + size, x : x + size] for image, (x, y) in places)
        left, terms = _block(first, second)
        squares += left @ left
        freedom += len(left) - terms
    return float(np.sqrt(squares / freedom / 2))


def _block(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, int]:
    """What is left of the difference inside the rim, and the number of terms that were fitted."""
    mean = (first + second) / 2
    slopes = [
        ndimage.shift(mean, -step, order=5, mode="nearest")
        - ndimage.shift(mean, step, order=5, mode="nearest")
        for step in (np.array([0.0, 0.5]), np.array([0.5, 0.0]))
    ]
    y, x = np.indices(mean.shape) / BLOCK
    columns = [np.ones_like(mean), mean, *(slope * one for slope in slopes for one in (1.0, x, y))]
    inside = np.s_[RIM:-RIM, RIM:-RIM]
    terms = np.column_stack([one[inside].ravel() for one in columns])
    difference = (second - first)[inside].ravel()
    return difference - terms @ np.linalg.lstsq(terms, difference, rcond=None)[0], terms.shape[1]


def second_step_noise(pair: Pair, nodes: Lattice, start: np.ndarray, noise: float) -> np.ndarray:
    """Scatter along x, y of the second step where noise is drawn anew for both images, in pixels.

    `start` is the displacement (n, 2) that the step corrects, `noise` that of one image.
    """
    draw, found = np.random.default_rng(1), []
    for _ in range(DRAWS):
        noisy = (one + draw.normal(0.0, noise, one.shape) for one in (pair.rest, pair.pushed[0]))
        found.append(refine_displacement(*noisy, nodes.points, nodes.cells, start))
    return np.sqrt(np.var(found, axis=0, ddof=1)[nodes.inner].mean(axis=0))


def waved(pair: Pair) -> Pair:
    """The same pair, the pushed image moved along x by a wave along y."""
    y, x = np.indices(pair.rest.shape)
    moved = ndimage.map_coordinates(pair.pushed[0], [y, x - wave(y)], order=5, mode="nearest")
    return replace(pair, pushed=[moved])


def wave(y: np.ndarray) -> np.ndarray:
    """Motion along x in pixels at the rows y."""
    return HEIGHT * np.sin(2 * np.pi * y / WAVE)


def blurred(pair: Pair) -> Pair:
    """The same pair without what is finer than BLUR."""
    rest, pushed = (ndimage.gaussian_filter(one, BLUR) for one in (pair.rest, pair.pushed[0]))
    return replace(pair, rest=rest, pushed=[pushed])


@dataclass(frozen=True)
class Beside:
    """What all methods found of one pair."""

    pair: Pair
    nodes: Lattice
    found: dict[str, Found]

    @cached_property
    def known(self) -> np.ndarray:
        """Nodes that every method found, (n,) bool."""
        return np.all([np.isfinite(one.u).all(1) for one in self.found.values()], axis=0)

    @cached_property
    def counted(self) -> np.ndarray:
        return self.known & self.nodes.inner

    @cached_property
    def pixels(self):
        """x, y, nodes and weights of the pixels in cells whose nodes are all known."""
        cells = self.nodes.cells[self.known[self.nodes.cells].all(1)]
        voxels, near, weights = voxels_in_cells(self.nodes.points, cells, self.pair.rest.shape)
        y, x = np.unravel_index(voxels, self.pair.rest.shape)
        return x, y, near, weights

    def between(self, u: np.ndarray) -> np.ndarray:
        """Displacement of the pixels, linear in the cells, whoever measured it."""
        _, _, near, weights = self.pixels
        return np.einsum("va,vad->vd", weights, u[near])

    def residual(self, name: str) -> float:
        """Root mean square difference of rest and warped pushed image in grey values.

        The pushed image is interpolated by a spline of degree 5; a gain and an offset are fitted.
        """
        x, y, *_ = self.pixels
        u = self.between(self.found[name].u)
        there = ndimage.map_coordinates(self.pair.pushed[0], [y + u[:, 1], x + u[:, 0]], order=5)
        here = self.pair.rest[y, x]
        gain, offset = fit_grey_values(here, there)
        return float(np.sqrt(np.mean((here - gain * there - offset) ** 2)))

    def floor(self, name: str) -> list[str]:
        """Scatter along x / y in pixels, beside what is stated."""
        points, found = self.nodes.points[self.counted], self.found[name]
        linear, smooth = (left_over(points, found.u[self.counted], h) for h in (None, SMOOTH))
        figures = [_two(one.std(axis=0)) for one in (linear, smooth)]
        if found.covariance is None:
            return [*figures, "–", "–"]
        variance = np.diagonal(found.covariance[self.counted], axis1=1, axis2=2)
        ratio = np.sqrt(np.nanmean(smooth**2 / variance))
        return [*figures, _two(np.sqrt(np.nanmean(variance, axis=0))), f"{ratio:.2f}"]

    def waves(self, name: str, after: np.ndarray) -> list[str]:
        """The part of the wave that is measured, in all pixels and at the nodes; 1 is all of it."""
        u = np.where(self.known[:, None], after - self.found[name].u, 0.0)
        _, y, *_ = self.pixels
        height = self.nodes.points[self.counted, 1]
        pairs = (self.between(u)[:, 0], wave(y)), (u[self.counted, 0], wave(height))
        return [f"{found @ true / (true @ true):.2f}" for found, true in pairs]

    def stretch(self) -> str:
        """Mean stretch along x / y in percent, from the default, in words."""
        terms = np.column_stack([np.ones(self.counted.sum()), self.nodes.points[self.counted]])
        slopes = np.linalg.lstsq(terms, self.found["the default"].u[self.counted], rcond=None)[0]
        return f"{100 * slopes[1, 0]:+.3f} / {100 * slopes[2, 1]:+.3f} %"

    def means(self) -> str:
        """Mean motion by method in words."""
        return "; ".join(
            f"{name} {_two(one.u[self.counted].mean(0))}" for name, one in self.found.items()
        )

    def apart(self, name: str) -> str:
        """How far the default is from another method, in words."""
        far = (self.found["the default"].u - self.found[name].u)[self.counted]
        mean, scatter = _two(far.mean(0), "+"), _two(far.std(0))
        within = np.percentile(np.linalg.norm(far, axis=1), 95)
        return (
            f"the default − {name}: mean {mean} px, standard deviation {scatter}, 95 % within "
            f"{within:.3f}"
        )


def _two(values, sign: str = "") -> str:
    return " / ".join(f"{one:{sign}.4f}" for one in values)


def show(name: str, pair: Pair, tools: dict[str, Callable], noise: float | None):
    """Print the figures of a pair; return what was found, and the noise of the camera.

    `noise` is that of a still pair of the same camera; None: the pair itself is still.
    """
    nodes = lattice(pair.labels > 0)
    both = Beside(pair, nodes, measured(pair, nodes, tools))
    still, default = noise is None, both.found["the default"]
    if still:
        noise = camera_noise(pair, nodes, default.u)
        waves = measured(waved(pair), nodes, tools)
    print(
        f"\n{name}: {both.counted.sum()} of {nodes.inner.sum()} inner nodes, moved by up to "
        f"{np.linalg.norm(default.u[both.counted], axis=1).max():.2f} px, stretched by "
        f"{both.stretch()}; noise of one image {noise:.2f} grey values, the registration says "
        f"{default.noise:.2f}\n\n{HEAD}",
        flush=True,
    )
    for method in tools:
        residual = both.residual(method)
        cells = both.floor(method) if still else ["–"] * 4
        cells += [f"{residual:.2f}", f"{residual / noise / np.sqrt(2):.2f}"]
        cells += both.waves(method, waves[method].u) if still else ["–"] * 2
        print(f"| {method} | {' | '.join(cells)} |", flush=True)
    print(*(both.apart(method) for method in list(tools)[1:]), sep="\n", flush=True)
    if still:
        start = both.found["without the second step"].u
        scatter = _two(second_step_noise(pair, nodes, start, noise))
        print(f"such noise drawn anew {DRAWS} times scatters the second step by {scatter} px")
        print("mean motion:", both.means())
        dull = Beside(pair, nodes, measured(blurred(pair), nodes, tools))
        print(f"mean motion of the images blurred by {BLUR:g} px:", dull.means(), flush=True)
    return both, noise


def beside_opencorr(both: Beside, path):
    """Print how far each method is from OpenCorr's table."""
    there = both.nodes.points[both.counted]
    for method, found in both.found.items():
        print(f"{method} in the place of ours:")
        compare(there, found.u[both.counted], Folder(path))


PAIRS = (
    (
        ("plate with a hole, frames 10 and 11", lambda path: open_hole(Still(path))),
        ("plate with a hole, frames 0 and 4", lambda path: open_hole(Folder(path))),
    ),
    (
        ("tensile strip, frames 151 and 152", lambda path: tensile(Folder(path), "ut_152.tif")),
        ("tensile strip, frames 151 and 170", lambda path: tensile(Folder(path))),
    ),
)  # of each camera a still pair and a loaded one


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default=os.environ.get("ELASTOIDENTIFY_REAL_DATA"))
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.getLogger("al_dic").setLevel(logging.ERROR)
    with ElastixProcess() as worker:
        tools = methods(worker)
        for camera in PAIRS:
            noise = None
            for name, pair in camera:
                try:
                    both, noise = show(name, pair(options.data), tools, noise)
                    if "frames 0 and 4" in name:
                        beside_opencorr(both, options.data)
                except Skip as reason:
                    print(f"{name} skipped: {reason}", file=sys.stderr)
                    break


if __name__ == "__main__":
    main()
