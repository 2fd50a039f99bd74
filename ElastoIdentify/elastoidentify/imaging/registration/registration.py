"""Displacements of mesh nodes between a rest image and pushed images, by elastix.

The images are registered in pixel units: voxel (0, 0, 0) is the origin, the axes are the image's
own, and the unit of length is the geometric mean of the voxel sizes. So the parameters mean the
same for every image, whatever its orientation, origin and spacing, a control-point cell holds the
same number of voxels, and the smoothness of the deformation is isotropic in the tissue.
"""

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ...errors import InputError
from ...progress import Progress, part, silent
from ...workers.elastix_client import ElastixProcess
from ..image import Image
from .cache import RegistrationCache, key_of
from .correlation import carried_displacement, refine_displacement
from .information import (
    cell_gradients,
    displacement_information,
    fit_grey_values,
    signed_volumes,
    simplices,
    voxels_in_cells,
)
from .parameter_files import control_point_spacing, load_parameters
from .together import Engines, engines_for, run_together
from .waves import waves_along

SMALLEST_IMAGE = 16  # voxels along an axis of a planar image
THINNEST_VOLUME = 8  # voxels along an axis of a volume
LEAST_SIMILARITY = 0.5
LARGEST_DISAGREEMENT = 1.0  # pixels, median over the nodes
SMALLEST_PUSH = 0.5  # pixels
BLIND = 1.0  # pixels of uncertainty at which a node counts as without texture
CARRIED = 0.5  # pixels that such nodes are right to, carried by their surroundings
APART = 1.0  # pixels between forward and backward registration at which a node is not believed
NOT_SEEN = -1e30  # what elastix writes where the pushed image shows nothing
SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))  # xx, yy, zz, xy, yz, xz


@dataclass
class Registration:
    """Displacements measured in images, and how far to trust them.

    Attributes
    ----------
    displacements : (t, n, 3)
        Rest → pushed, world axes, the images' length unit.
    information : (t, n, 6)
        Inverse covariance of each displacement [xx, yy, zz, xy, yz, xz], 1/length².
    disagreement : (t, n) or None
        Distance in pixels by which going to the pushed image and back misses the node.
    report : dict
        JSON-ready. ``report["trials"]``: figures per trial; ``report["warnings"]``: sentences.
    """

    displacements: np.ndarray
    information: np.ndarray
    disagreement: np.ndarray | None
    report: dict = field(default_factory=dict)


@dataclass(frozen=True)
class PixelFrame:
    """The coordinates that elastix works in: index times spacing, in pixels of mean size.

    Parameters
    ----------
    image : Image
        Its grid defines the frame.
    """

    image: Image

    @property
    def kept(self) -> list[int]:
        """The image axes that are registered: two of a planar image, three of a volume."""
        return [axis for axis in range(3) if axis != self.image.planar_axis]

    @property
    def pixel(self) -> float:
        """World length of one pixel: the geometric mean of the voxel sizes."""
        return float(np.exp(np.log(self.image.spacing[self.kept]).mean()))

    @property
    def spacing(self) -> np.ndarray:
        """Voxel size along the kept axes in pixels, (d,)."""
        return self.image.spacing[self.kept] / self.pixel

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array that is registered, last axis first."""
        return tuple(self.image.size[axis] for axis in reversed(self.kept))

    def array(self, image: Image) -> np.ndarray:
        """The values of an image on this grid, (nj, ni) or (nk, nj, ni) float32."""
        return np.asarray(image.array, np.float32).reshape(self.shape)

    def index(self, points: np.ndarray) -> np.ndarray:
        """Continuous voxel indices (n, d) of world points (n, 3)."""
        return self.image.world_to_index(points)[:, self.kept]

    def to_world(self, vectors: np.ndarray) -> np.ndarray:
        """World vectors (..., 3) of vectors (..., d) in pixels."""
        return vectors @ self.image.direction[:, self.kept].T * self.pixel

    def information_to_world(self, information: np.ndarray) -> np.ndarray:
        """Six components (..., 6) in 1/length² of matrices (..., d, d) in 1/pixel²."""
        axes = self.image.direction[:, self.kept]
        world = axes @ information @ axes.T / self.pixel**2
        return np.stack([world[..., a, b] for a, b in SIX], -1)


# --- the input -------------------------------------------------------------------------------


def check_image(image: Image, name: str) -> None:
    """Refuse an image that cannot be registered, in one line that says how to mend it."""
    array = np.asarray(image.array)
    if array.dtype.kind not in "biuf":
        raise InputError(
            f"the {name} image has values of type {array.dtype}: convert it to grey values"
        )
    bad = array.size - np.count_nonzero(np.isfinite(array))
    if bad:
        raise InputError(
            f"the {name} image has {bad} voxels that are not numbers (NaN or infinite), "
            f"{100 * bad / array.size:.2g} %: replace them, for example by 0"
        )
    if array.min() == array.max():
        raise InputError(
            f"the {name} image is {array.min():g} everywhere: without texture there is nothing to "
            "register; check that the right file, slice and value range were read"
        )
    lengths = [length for length in image.size if length > 1]
    least = THINNEST_VOLUME if len(lengths) == 3 else SMALLEST_IMAGE
    if len(lengths) < 2 or min(lengths) < least:
        raise InputError(
            f"the {name} image has {' × '.join(map(str, image.size))} voxels, too few to register: "
            f"at least {SMALLEST_IMAGE} along the axes of a slice or {THINNEST_VOLUME} of a volume "
            "are needed"
        )


def _corners(image: Image) -> np.ndarray:
    """Indices of the eight outer corners of the box that the voxels fill, (8, 3)."""
    ends = [(-0.5, length - 0.5) for length in image.size]
    return np.array([[i, j, k] for i in ends[0] for j in ends[1] for k in ends[2]])


def _box(image: Image) -> str:
    """The world box of an image in words."""
    corners = image.index_to_world(_corners(image))
    low, high = (np.round(end, 3).tolist() for end in (corners.min(0), corners.max(0)))
    return f"{low} to {high}"


def on_grid_of(rest: Image, image: Image, name: str, order: int = 1) -> Image:
    """Return `image` on the voxel grid of `rest`; it must cover the same box of the world.

    Resampled (spline of the given order) only where the voxels do not already coincide.

    Raises
    ------
    InputError
        A corner of the box is off by more than one voxel of the coarser image.
    """
    planar = [axis for axis in range(3) if rest.size[axis] == 1]
    if (rest.planar_axis is None) != (image.planar_axis is None):
        kinds = ["a slice" if one.planar_axis is not None else "a volume" for one in (rest, image)]
        raise InputError(
            f"the rest image is {kinds[0]} and the {name} image {kinds[1]}: take the same slice "
            "out of the volume, or use volumes throughout"
        )
    near = rest.world_to_index(image.index_to_world(_corners(image)))
    miss = np.abs(_corners(rest)[:, None] - near).max(2).min(1)
    coarser = max(1.0, *(np.sort(rest.size) / np.sort(image.size)))
    if miss.max() > coarser:
        boxes = [_box(one) for one in (rest, image)]
        raise InputError(
            f"the {name} image covers another part of the world than the rest image: {boxes[1]} "
            f"instead of {boxes[0]}: crop or resample it to the rest image's extent"
        )
    if image.size == rest.size and np.abs(_corners(rest) - near).max() < 1e-3:
        return rest.with_array(image.array)
    grid = np.meshgrid(*[np.arange(n) for n in rest.size], indexing="ij")
    index = np.stack([axis.ravel() for axis in grid], 1)
    source = image.world_to_index(rest.index_to_world(index))
    source[:, planar] = 0.0
    values = ndimage.map_coordinates(
        np.asarray(image.array, np.float32), source.T[::-1], order=order, mode="nearest"
    )
    return rest.with_array(values.reshape(rest.size).transpose(2, 1, 0))


def _check_mesh(frame: PixelFrame, points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Check that the mesh lies in the image. Returns which nodes are outside, (n,) bool."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"mesh points must be (n, 3) world positions, not {points.shape}")
    if not np.isfinite(points).all():
        raise InputError("the mesh has nodes whose position is not a number")
    dimension = len(frame.kept)
    corners = simplices(cells, dimension)
    fits = corners.shape[1] == dimension + 1
    if fits and dimension == 3:  # quadrilaterals have four nodes too
        fits = np.abs(signed_volumes(points, corners)).max() > 1e-9 * np.ptp(points) ** 3
    if not fits:
        meant = "tetrahedra or hexahedra" if dimension == 3 else "triangles or quadrilaterals"
        raise InputError(
            f"the images are {'volumes' if dimension == 3 else 'slices'} and the mesh's cells have "
            f"{np.shape(cells)[1]} nodes: a mesh of {meant} is needed"
        )
    index = frame.image.world_to_index(points)
    size = np.array(frame.image.size)
    if dimension == 2:
        axis = frame.image.planar_axis
        off = np.abs(index[:, axis]).max()
        if off > 1.0:
            raise InputError(
                f"the mesh lies up to {off * frame.image.spacing[axis]:.4g} away from the plane of "
                "the image slice: mesh the segmentation of that same slice"
            )
    kept = frame.kept
    outside = ((index < -0.501) | (index > size - 0.499))[:, kept].any(1)
    if outside.mean() > 0.5:
        low, high = points.min(0), points.max(0)
        raise InputError(
            f"{100 * outside.mean():.0f} % of the mesh nodes lie outside the rest image (mesh from "
            f"{np.round(low, 2).tolist()} to {np.round(high, 2).tolist()}): mesh and images must "
            "share one world (LPS in files, RAS in Slicer)"
        )
    return outside


# --- figures of quality ----------------------------------------------------------------------


def similarity(first: np.ndarray, second: np.ndarray) -> float:
    """Normalised correlation of two arrays, −1 to 1; 0 where one is constant."""
    first, second = (np.asarray(values, float) - np.mean(values) for values in (first, second))
    size = np.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / size) if size > 0 else 0.0


def folded_share(points: np.ndarray, displaced: np.ndarray, corners: np.ndarray) -> float:
    """Share of the cells that the displacement turns inside out."""
    before, after = (signed_volumes(where, corners) for where in (points, displaced))
    return float(np.mean(before * after <= 0))


def _lost(figures: dict) -> bool:
    """True if the registration of a trial cannot be believed."""
    disagreement = figures["disagreement_median"]
    return figures["similarity_after"] < LEAST_SIMILARITY or (
        disagreement is not None and disagreement > LARGEST_DISAGREEMENT
    )


def _trial_warnings(trial: int, figures: dict) -> list[str]:
    """What a person should know about one trial, in words."""
    before, after = figures["similarity_before"], figures["similarity_after"]
    found = []
    if _lost(figures):
        text = f"the registration did not find the push: similarity after registration {after:.2f}"
        text += f" (before {before:.2f}, 1 is perfect)"
        if figures["disagreement_median"] is not None:
            text += f", forward and backward differ by {figures['disagreement_median']:.1f} pixels"
        found.append(
            text + "; check that the rest and the pushed image show the same slice of the same "
            "patient and that the push is not too large (reference='previous' takes small steps)"
        )
    elif after < before - 0.02:
        found.append(
            f"the images agree less after the registration ({after:.2f}) than before "
            f"({before:.2f}): do not trust this trial"
        )
    if figures["nodes_disagreeing"]:
        found.append(
            f"{figures['nodes_disagreeing']} mesh nodes are placed more than {APART:g} pixel apart "
            "by the forward and the backward registration: their displacement is taken from the "
            "nodes around them and has no weight"
        )
    if figures["nodes_leaving"]:
        found.append(
            f"{figures['nodes_leaving']} mesh nodes leave the pushed image: their displacement is "
            "carried on from the nodes that stay and has little weight; a larger field of view "
            "would show them"
        )
    if figures["folded_cells"] > 0:
        found.append(
            f"{100 * figures['folded_cells']:.2g} % of the cells are turned inside out by the "
            "measured displacement: the registration is lost there, or the push is very large"
        )
    if figures["nodes_without_texture"] > 0.02:
        found.append(
            f"{100 * figures['nodes_without_texture']:.0f} % of the mesh nodes lie where the image "
            f"has too little texture to see a shift of {BLIND:g} pixel in every direction: the "
            "displacement there is carried over from the surroundings and has little weight"
        )
    if figures["largest_displacement_pixels"] < SMALLEST_PUSH:
        found.append(
            f"the largest displacement is {figures['largest_displacement_pixels']:.2f} pixels, "
            "hardly more than the error of a registration: push further, or check that the pushed "
            "image is not the rest image"
        )
    return [f"Trial {trial}: {text}." for text in found]


def _comparison_warnings(displacements: np.ndarray, pixel: float) -> list[str]:
    """Trials that say the same thing twice. `displacements` is (t, n, 3) in the world."""
    found = []
    for first in range(len(displacements)):
        for second in range(first + 1, len(displacements)):
            a, b = displacements[first].ravel(), displacements[second].ravel()
            sizes = np.linalg.norm(a), np.linalg.norm(b)
            if min(sizes) < 0.1 * pixel * np.sqrt(len(a)):
                continue
            cosine = a @ b / (sizes[0] * sizes[1])
            pair = f"Trials {first + 1} and {second + 1}"
            if np.linalg.norm(a - b) < 0.02 * max(sizes):
                found.append(f"{pair} show the same push: was one image given twice?")
            elif abs(cosine) > 0.995:
                found.append(
                    f"{pair} push in the same way, {abs(b @ a) / sizes[0] ** 2:.2g} times as far: "
                    "together they tell little more than one of them; push from another side."
                )
    return found


def rest_and_pushed(rest: Image | None, pushed: Sequence[Image]) -> tuple[Image, list[Image]]:
    """Return the image at rest, for which the first pushed one stands in, and those pushed."""
    pushed = list(pushed)
    if rest is None and pushed:
        rest, pushed = pushed[0], pushed[1:]
    if rest is None or not pushed:
        raise InputError("at least two images are needed: one at rest and one pushed")
    return rest, pushed


def _waves_warnings(frame: PixelFrame, rest: Image) -> list[str]:
    """What is to be said where images are compared that look like radiofrequency data."""
    along = waves_along(frame.array(rest))
    if along is None:
        return []
    axis = "ijk"[frame.kept[::-1][along]]
    return [
        f"The images oscillate around 0 along {axis}, as radiofrequency data of ultrasound do: "
        f"name that axis (radiofrequency={axis}), so that their envelopes are registered first."
    ]


# --- the registration ------------------------------------------------------------------------


def register(
    rest: Image | None,
    pushed: Sequence[Image],
    points: np.ndarray,
    cells: np.ndarray,
    *,
    parameters: str | Path | Sequence[str | Path] | None = None,
    mask: Image | None = None,
    reference: str = "rest",
    backward: bool = True,
    refine: bool = True,
    sides: np.ndarray | None = None,
    reaction_nodes: np.ndarray | None = None,
    workers: int | None = None,
    cache: str | Path | None = None,
    elastix: ElastixProcess | None = None,
    progress: Progress | None = None,
) -> Registration:
    """Measure the displacement of every mesh node in every trial.

    Parameters
    ----------
    rest : Image or None
        The image at rest, on which the mesh was made. None: the first pushed image takes its
        place, and the displacements are those from trial 1 to the other trials.
    pushed : sequence of Image
        One per trial, of the same physical extent as `rest`.
    points : (n, 3)
        Node positions in the world.
    cells : (m, k) int
        Triangles or quadrilaterals (planar images), tetrahedra or hexahedra (volumes).
    parameters : str, Path or several, optional
        elastix parameter files or names of shipped maps, see
        :func:`~elastoidentify.imaging.registration.parameter_files.load_parameters`.
    mask : Image, optional
        Samples are drawn where it is not 0. A tight mask makes the registration worse: the edge of
        the object is its best landmark.
    reference : "rest" or "previous"
        "previous": each pushed image is registered to the one before it and the displacements are
        composed, for a series of ever larger pushes.
    backward : bool
        Also register from pushed to rest, which doubles the time and tells the disagreement.
    refine : bool
        Correct the displacements by one step of image correlation on the mesh, see
        :func:`~elastoidentify.imaging.registration.correlation.refine_displacement`: noisier,
        with less bias where the strain jumps.
    sides : (n,) int, optional
        Which of several bodies that slide on each other each node belongs to; no cell has nodes of
        two. Each body is registered by itself, with samples from everywhere but the others, since
        B-splines would smear the jump between them.
    reaction_nodes : (n,) bool, optional
        Nodes that an outside body touches (the mesher's ``reaction_nodes``). The strain ends there
        at once, which neither B-splines nor cells follow: their information says so.
    cache : path, optional
        Folder in which finished registrations are kept, so that a run that was killed goes on where
        it was.
    workers : int, optional
        Registrations at once, each in an elastix process of about 0.9 GB. Default: one for slices,
        for volumes one per core, at most four. The result does not depend on it.
    elastix : ElastixProcess, optional
        A worker that is kept warm for several calls; it is left open, unless cancelled.
    progress : callable, optional

    Returns
    -------
    Registration

    Raises
    ------
    InputError
        Images or mesh cannot be used, itk-elastix is missing, or a trial was clearly not found.
    Cancelled
        By the progress callback. No process and no file stays behind.
    """
    progress = progress or silent
    rest, pushed = rest_and_pushed(rest, pushed)
    if reference not in ("rest", "previous"):
        raise InputError(f'reference is "rest" or "previous", not {reference!r}')
    points, cells = np.asarray(points, float), np.asarray(cells)
    check_image(rest, "rest")
    frame = PixelFrame(rest)
    trials = []
    for number, image in enumerate(pushed, 1):
        check_image(image, f"pushed (trial {number})")
        trials.append(frame.array(on_grid_of(rest, image, f"pushed (trial {number})")))
    outside = _check_mesh(frame, points, cells)
    maps, warnings = load_parameters(parameters, len(frame.kept))
    waves = _waves_warnings(frame, rest)
    warnings += waves
    mask_array = None
    if mask is not None:
        mask_array = frame.array(on_grid_of(rest, mask, "mask", order=0)) != 0
        if not mask_array.any():
            raise InputError("the mask is empty: no voxel of it differs from 0")

    touched = None
    if reaction_nodes is not None:
        touched = np.asarray(reaction_nodes).astype(bool).ravel()
        if len(touched) != len(points):
            raise InputError(
                f"reaction_nodes has {len(touched)} values and the mesh {len(points)} nodes: give "
                "one per node"
            )

    work = _Work(
        frame, frame.array(rest), points, cells, maps, mask_array, outside, refine, touched
    )
    if sides is not None and len(np.unique(sides)) > 1:
        work.sides = np.unique(sides, return_inverse=True)[1].ravel()
    work.cache = None if cache is None else RegistrationCache(cache)
    at_once = engines_for(len(frame.kept), len(trials), workers)
    with Engines(elastix) as engines:
        figures = work.run(engines, trials, reference, backward, at_once, progress)
    progress(1.0, "registration done")

    sentences = [_trial_warnings(number, one) for number, one in enumerate(figures, 1)]
    if all(_lost(one) for one in figures):
        raise InputError(" ".join([found[0] for found in sentences] + waves))
    warnings += [sentence for found in sentences for sentence in found]
    for k, one in enumerate(figures):
        if _lost(one):
            work.information[k] = 0.0  # what was not found has no weight
    if outside.any():
        warnings.append(
            f"{np.count_nonzero(outside)} mesh nodes lie outside the image; their displacement is "
            "extrapolated and has no weight."
        )
    displacements = frame.to_world(work.displacements)
    warnings += _comparison_warnings(displacements, frame.pixel)
    report = {
        "trials": figures,
        "warnings": warnings,
        "pixel": frame.pixel,
        "reference": reference,
        "parameters": "bspline" if parameters is None else str(parameters),
    }
    return Registration(
        displacements,
        frame.information_to_world(work.information),
        work.disagreement if backward else None,
        report,
    )


def _named_task(name: str, task):
    """Put a name before what a task tells its progress."""
    return lambda progress: task(lambda fraction, text: progress(fraction, f"{name}: {text}"))


class _Work:
    """One call of :func:`register`, in pixels: arrays filled trial by trial."""

    def __init__(self, frame, rest, points, cells, maps, mask, outside, refine, touched):
        self.frame, self.rest, self.mask = frame, rest, mask
        self.maps = [one | {"DefaultPixelValue": [f"{NOT_SEEN:g}"]} for one in maps]
        self.index, self.cells, self.outside = frame.index(points), cells, outside
        self.refine, self.touched, self.cache = refine, touched, None
        self.corners = simplices(cells, len(frame.kept))
        self.sides = None
        self.located = voxels_in_cells(self.index, cells, rest.shape)
        self.inside = self.located[0]
        if len(self.inside) < 16:
            raise InputError("the mesh covers hardly a voxel of the rest image: check its units")

    def run(self, engines, trials, reference, backward, at_once, progress) -> list[dict]:
        """Register every trial, so many at once. Returns the figures of each."""
        count, (nodes, dimension) = len(trials), self.index.shape
        self.displacements = np.zeros((count, nodes, dimension))
        self.information = np.zeros((count, nodes, dimension, dimension))
        self.disagreement = np.zeros((count, nodes))
        start = self.index * self.frame.spacing
        forth = [Future() for _ in trials]  # T(points) and the warped image of each
        figures = [None] * count
        composed = reference == "previous"
        images = [self.rest, *trials[:-1]] if composed else [self.rest] * count

        def go(k, progress):
            points = forth[k - 1].result()[0] if composed and k else start
            try:
                forth[k].set_result(self._one(engines, images[k], trials[k], points, progress))
            except BaseException as error:  # whoever waits for it must not wait for ever
                forth[k].set_exception(error)
                raise
            if not backward:
                finish(k, None)

        def come_back(k, progress):
            reached, _ = forth[k].result()
            points = forth[k - 1].result()[0] if composed and k else start
            pair = trials[k], images[k]
            back, _ = self._one(engines, *pair, reached, progress, warp=False)
            finish(k, np.linalg.norm(back - points, axis=1))

        def finish(k, miss):
            reached, warped = forth[k].result()
            self.disagreement[k] = 0.0 if miss is None else miss
            doubt = self._doubt(reached, self.disagreement[k])
            self.displacements[k] = self._measured(trials[k], reached - start, doubt)
            figures[k] = self._judge(k, images[k], trials[k], warped, miss, doubt)

        ways = [("", go), (" back", come_back)][: 2 if backward else 1]
        tasks = [
            _named_task(f"trial {k + 1} of {count}{name}", partial(way, k))
            for name, way in ways
            for k in range(count)
        ]
        run_together(tasks, at_once, progress)
        return figures

    def _doubt(self, reached, miss) -> "_Doubt":
        """Which nodes leave the pushed image, and which were not found there."""
        place = reached / self.frame.spacing
        leaving = ((place < -0.5) | (place > np.array(self.rest.shape[::-1]) - 0.5)).any(1)
        return _Doubt(leaving & ~self.outside, (miss > APART) & ~leaving & ~self.outside)

    def _measured(self, trial, displacement, doubt):
        """The displacement in pixels, carried on where it is in doubt, after the second step."""
        spacing = self.frame.spacing
        if doubt.any.any() and doubt.any.mean() < 0.5:
            pixels = self.index * spacing
            displacement = carried_displacement(pixels, self.cells, displacement, ~doubt.any)
        if not self.refine:
            return displacement
        voxels = refine_displacement(
            self.rest,
            trial,
            self.index,
            self.cells,
            displacement / spacing,
            spacing,
            located=self.located,
        )
        return np.where(self.outside[:, None], displacement, voxels * spacing)

    def _one(self, engines, fixed, moving, points, progress, warp=True):
        """Register one pair, each body by itself. Returns T(points) and the warped image."""
        mask = self.mask if fixed is self.rest else None
        if self.sides is None:
            return self._pair(engines, fixed, moving, points, mask, progress, warp)
        of_cell = self.sides[self.cells[:, 0]]
        covered = [
            voxels_in_cells(points / self.frame.spacing, self.cells[of_cell == side], fixed.shape)[
                0
            ]
            for side in range(of_cell.max() + 1)
        ]
        reached, warped = points.copy(), None
        for side, own in enumerate(covered):
            seen = np.ones(fixed.shape, bool) if mask is None else mask.copy()
            for other in covered[:side] + covered[side + 1 :]:
                seen.ravel()[other] = False
            found, image = self._pair(
                engines, fixed, moving, points, seen, part(progress, side / len(covered),
                (side + 1) / len(covered)), warp,
            )  # fmt: skip
            nodes = self.sides == side
            reached[nodes] = found[nodes]
            if warp:
                warped = image.copy() if warped is None else warped
                warped.ravel()[own] = image.ravel()[own]
        return reached, warped

    def _pair(self, engines, fixed, moving, points, mask, progress, warp):
        settings = self.frame.spacing, self.maps

        def answer():
            with engines.one(progress) as elastix:
                return elastix.register(
                    fixed, moving, *settings, points, mask=mask, warp=warp, progress=progress
                )

        if self.cache is None:
            return answer()
        arrays = {"fixed": fixed, "moving": moving, "points": points, "mask": mask}
        about = {"spacing": list(map(float, settings[0])), "maps": self.maps, "warp": warp}
        key = key_of(arrays, about)
        found = self.cache.read(key)
        if found is None:
            found = answer()
            self.cache.write(key, found)
        return found

    def _judge(self, k, image, trial, warped, miss, doubt) -> dict:
        """Fill in the information of trial k and return its figures."""
        seen = warped > NOT_SEEN / 2
        inside = self.inside[seen.ravel()[self.inside]]
        if len(inside) < 16:
            seen, inside = np.ones_like(seen), self.inside  # nothing matches: the figures say so
        gain, offset = fit_grey_values(image.ravel()[inside], warped.ravel()[inside])
        levelled = np.where(seen, gain * warped + offset, image)
        smooth = [ndimage.gaussian_filter(one, 1.0) for one in (image, trial, levelled)]
        rest, before, after = (one.ravel()[inside] for one in smooth)
        moved = self.displacements[k]
        information, share, noise = displacement_information(
            image,
            levelled,
            self.index,
            self.cells,
            moved,
            spacing=self.frame.spacing,
            resolution=None if self.refine else control_point_spacing(self.maps),
            seen=seen,
            touched=self.touched,
            located=self.located,
        )
        information[self.outside | doubt.leaving] = 0.0
        weakest = np.linalg.eigvalsh(information)[:, 0] / np.maximum(share, 1e-9)
        self.information[k] = self._with_doubt(information, share, moved, miss, doubt)
        believed = np.ones(len(moved), bool) if miss is None else ~doubt.leaving & ~self.outside
        apart = None if miss is None or not believed.any() else miss[believed]
        pixels = self.index * self.frame.spacing
        return {
            "similarity_before": similarity(rest, before),
            "similarity_after": similarity(rest, after),
            "folded_cells": folded_share(pixels, pixels + moved, self.corners),
            "nodes_outside": float(self.outside.mean()),
            "nodes_leaving": int(doubt.leaving.sum()),
            "nodes_disagreeing": int(doubt.lost.sum()),
            "nodes_without_texture": float(np.mean(weakest < 1 / BLIND**2)),
            "disagreement_median": None if apart is None else float(np.median(apart)),
            "disagreement_largest": None if apart is None else float(apart.max()),
            "noise": float(noise / np.sqrt(2)),
            "largest_displacement_pixels": float(np.linalg.norm(moved, axis=1).max()),
            "independent_share": float(share.mean()),
        }

    def _with_doubt(self, information, share, moved, miss, doubt):
        """Add what the surroundings tell, take off what the doubts are.

        A node is carried by its surroundings to half a pixel; one that leaves the image is carried
        on over the distance to the nearest that stays, and errs by the strain times the distance.
        The disagreement of forward and backward registration is the difference of two errors of
        one size: a variance of its square over 2 d per component.
        """
        dimension = information.shape[-1]
        pixels = self.index * self.frame.spacing
        variance = np.full(len(pixels), CARRIED**2)
        stays = ~doubt.any & ~self.outside
        if doubt.leaving.any() and stays.any():
            far = cKDTree(pixels[stays]).query(pixels[doubt.leaving])[0]
            strain2 = (cell_gradients(pixels, self.corners, moved) ** 2).sum(1).mean()
            variance[doubt.leaving] += strain2 * far**2
        carried = np.where(self.outside | doubt.lost, 0.0, share) / variance
        total = information + carried[:, None, None] * np.eye(dimension)
        total[doubt.lost] = 0.0
        if miss is None:
            return total
        strength, axes = np.linalg.eigh(total)
        # nothing comes back from where the pushed image ends
        apart = np.where(doubt.leaving, 0.0, miss**2 / (2 * dimension))
        strength = strength / (1 + apart[:, None] * np.maximum(strength, 0.0))
        return np.einsum("nab,nb,ncb->nac", axes, strength, axes)


@dataclass(frozen=True)
class _Doubt:
    """Nodes whose displacement is not to be believed, two masks (n,)."""

    leaving: np.ndarray  # leave the pushed image
    lost: np.ndarray  # forward and backward registration do not agree

    @property
    def any(self) -> np.ndarray:
        return self.leaving | self.lost
