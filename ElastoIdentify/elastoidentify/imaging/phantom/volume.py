"""A pushing phantom in space: volumes of a block whose stiffness is known everywhere.

The block stands on a floor and carries a pad of known stiffness, on which an indenter pushes. A
stiff ball lies in its tissue, drawn in the segmentation or hidden from it. The push is solved on
quadratic bricks, which no identification uses, and the pushed volumes are rendered by inverse
mapping from an oversampled source, so that nothing but the physics is shared between the phantom
and what identifies it.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy import ndimage

from ...errors import InputError
from ...progress import Progress, part, silent
from ..image import Image
from .planar import (
    BACKGROUND,
    FLOOR,
    INCLUSION,
    INDENTER,
    PAD,
    PLATE,
    SIGNAL,
    TISSUE,
    Material,
    Phantom,
    check_parameters,
    rician,
)
from .push_bricks import solve_pushes_on_bricks
from .texture import sample_volume, speckle

OVERSAMPLING = 2  # source samples per voxel
PUSHES = ((0.0, 0.0, -0.05), (0.035, 0.0, -0.035), (0.0, 0.035, -0.035))


@dataclass(frozen=True)
class Ball:
    """A ball in the tissue.

    Parameters
    ----------
    x, y, z : float
        Centre: in widths of the block from its left and front sides, in heights from its floor.
    radius : float
        In widths of the block.
    contrast : float
        Its Young's modulus over that of the tissue around it.
    """

    x: float = 0.5
    y: float = 0.5
    z: float = 0.4
    radius: float = 0.2
    contrast: float = 3.0


@dataclass(frozen=True)
class VolumeFrame:
    """The block's place in the volume; lengths in mm, (x, y, z) along columns, rows, slices.

    The block covers 0…size, z from the floor up; its faces are voxel faces.
    """

    size: np.ndarray
    voxels: np.ndarray
    margin: np.ndarray
    origin: np.ndarray
    direction: np.ndarray

    @property
    def spacing(self) -> np.ndarray:
        """Voxel size (x, y, z)."""
        return self.size / self.voxels

    @property
    def shape(self) -> tuple[int, int, int]:
        """Slices, rows and columns of the volume."""
        return tuple((self.voxels + 2 * self.margin)[::-1])

    @property
    def body_axes(self) -> np.ndarray:
        """World unit vectors of the block's x, y and z, (3, 3)."""
        return self.direction.T

    def centres(self, oversampling: int = 1, border: int = 0) -> list[np.ndarray]:
        """Return x, y and z of the volume's samples, with `border` voxels around."""
        return [
            ((np.arange((n + 2 * border) * oversampling) + 0.5) / oversampling - border - m) * s
            for n, m, s in zip(self.shape[::-1], self.margin, self.spacing, strict=True)
        ]

    def to_body(self, points: np.ndarray) -> np.ndarray:
        """Map world points (n, 3) to (x, y, z) of the block."""
        corner = (self.margin - 0.5) * self.spacing
        return (np.asarray(points, float) - self.origin) @ self.direction - corner

    def image(self, array: np.ndarray) -> Image:
        """Return the volume of an array (slices, rows, columns)."""
        return Image(array, self.origin, self.spacing, self.direction)


def make_phantom_volume(
    texture: Image | None = None,
    *,
    balls: Sequence[Ball] = (Ball(),),
    hidden: bool = False,
    pad: float = 0.25,
    floor: float = 0.1,
    pushes: Sequence[tuple[float, float, float]] = PUSHES,
    tissue_young: float = 3000.0,
    pad_young: float = 5000.0,
    poisson: float = 0.45,
    noise: float = 0.02,
    seed: int = 0,
    width: float | None = None,
    height: float | None = None,
    voxels: int = 48,
    anisotropy: float = 1.0,
    margin: float = 0.125,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    direction: np.ndarray | None = None,
    kinematics: str = "small-strain",
    elements: int | None = None,
    solver: Callable = solve_pushes_on_bricks,
    progress: Progress | None = None,
) -> Phantom:
    """Make a phantom: volumes of a block at rest and pushed, with all that is known about it.

    Parameters
    ----------
    texture : Image, optional
        Volume that gives the tissue its texture, centre on centre, at its own scale and along its
        own axes. None: speckle.
    balls : sequence of Ball
    hidden : bool
        The balls are in the truth and in the push, not in the segmentation.
    pad, floor : float
        Thickness of the pad, and of the rigid floor and indenter, in heights of the block.
    pushes : sequence of (x, y, z)
        Displacement of the indenter per trial, in heights of the block, z up (along slices). The
        indenter and the floor stick to the block.
    tissue_young, pad_young : float
        Young's moduli, Pa.
    poisson : float
        Poisson's ratio of pad, tissue and balls.
    noise : float
        Rician noise, as a share of the brightest tissue's signal.
    seed : int
        Of the speckle and the noise.
    width, height : float, optional
        Of the block, mm; it is as deep as wide. Default: half of the texture's smallest side
        (64 mm without a texture), and as high as wide.
    voxels : int
        Across the block's width.
    anisotropy : float
        Distance of slices over the width of a voxel.
    margin : float
        Air on the four sides, in widths of the block.
    origin, direction
        Of the volumes, as in :class:`Image`.
    kinematics : "small-strain", "neo-hookean"
        Of the push.
    elements : int
        Quadratic bricks across the block's width. The pad's border should be a border of bricks.
        Default: one for three voxels, 4 to 16.
    solver : callable
        :func:`.push_bricks.solve_pushes_on_bricks`, or one with the same arguments.
    progress : callable, optional

    Returns
    -------
    Phantom
        As of :func:`.planar.make_phantom`; ``frame`` is a :class:`VolumeFrame`.

    Raises
    ------
    InputError
        A parameter out of range, a ball that leaves the tissue, a push that folds the block.
    """
    check_parameters(pad, poisson, noise, voxels, anisotropy, tissue_young, pad_young, pushes)
    progress = progress or silent
    if width is None:
        width = 64.0 if texture is None else 0.5 * float((texture.size * texture.spacing).min())
    size = np.array([width, width, height or width], float)
    if elements is None:  # in fours, as the pad is a quarter
        elements = min(max(voxels // 12 * 4, 4), 16)
    frame = _frame(size, voxels, anisotropy, margin, floor, origin, direction)
    spheres = [_sphere(ball, size, pad) for ball in balls]

    def moduli(x, y, z):
        young = np.full(np.shape(x), float(tissue_young))
        for (centre, radius), ball in zip(spheres, balls, strict=True):
            inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 < radius**2
            young[inside] = ball.contrast * tissue_young
        young[z > (1 - pad) * size[2]] = pad_young
        return young, np.full(np.shape(x), float(poisson))

    shifts = np.asarray(pushes, float) * size[2]
    deformations = solver(
        size,
        moduli,
        shifts,
        elements=elements,
        kinematics=kinematics,
        progress=part(progress, 0.0, 0.4),
    )

    rng = np.random.default_rng(seed)
    progress(0.4, "texture")
    source = _source(frame, texture, pad, rng)
    x, y, z = frame.centres()
    centres = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1).reshape(-1, 3)
    images = [_render(source, frame, centres)]
    for trial, deformation in enumerate(deformations, 1):
        progress(0.5 + 0.5 * trial / (len(deformations) + 1), f"rendering trial {trial}")
        images.append(_render(source, frame, deformation.inverse(centres)))
    level = noise * np.percentile(images[0], 99)
    rest, *pushed = (frame.image(rician(image, level, rng).astype(np.float32)) for image in images)

    shown = [] if hidden else list(zip(spheres, balls, strict=True))
    labels, materials = _labels(frame, pad, shown, (tissue_young, pad_young, poisson))
    young, ratio = moduli(*(column.reshape(frame.shape) for column in centres.T))
    solid = np.isin(labels, [n for n, material in materials.items() if material.young is not None])
    return Phantom(
        rest,
        pushed,
        frame.image(labels),
        frame.image(np.where(solid, young, np.nan)),
        frame.image(np.where(solid, ratio, np.nan)),
        materials,
        shifts @ frame.body_axes,
        frame,
        deformations,
        {
            "block_mm": size.tolist(),
            "pad": pad,
            "inclusions": [asdict(ball) for ball in balls],
            "hidden": bool(hidden),
            "pushes": np.asarray(pushes, float).tolist(),
            "noise": noise,
            "noise_grey_values": float(level),
            "seed": seed,
            "kinematics": kinematics,
            "elements": elements,
        },
    )


def _frame(size, voxels, anisotropy, margin, floor, origin, direction) -> VolumeFrame:
    """Place the block in its volume, faces on voxel faces."""
    slices = max(round(size[2] / (size[0] / voxels * anisotropy)), 8)
    beside = max(round(margin * voxels), 2)
    return VolumeFrame(
        size,
        np.array([voxels, voxels, slices]),
        np.array([beside, beside, max(round(floor * slices), 2)]),
        np.asarray(origin, float),
        np.eye(3) if direction is None else np.asarray(direction, float),
    )


def _sphere(ball: Ball, size: np.ndarray, pad: float) -> tuple[np.ndarray, float]:
    """Return centre and radius of a ball in mm, once it lies in the tissue."""
    centre, radius = np.array([ball.x, ball.y, ball.z]) * size, ball.radius * size[0]
    room = size * [1, 1, 1 - pad]
    inside = ((centre >= radius) & (centre <= room - radius)).all()
    if not (inside and radius > 0 and ball.contrast > 0):
        raise InputError(
            f"ball x={ball.x:g}, y={ball.y:g}, z={ball.z:g}, radius={ball.radius:g}, "
            f"contrast={ball.contrast:g} leaves the tissue or has no stiffness: x, y and z are "
            f"shares of the block, which is tissue up to z={1 - pad:g}"
        )
    return centre, radius


def _labels(frame: VolumeFrame, pad: float, shown, moduli):
    """Return the labelmap (slices, rows, columns) and the material of labels 1, 2, …"""
    tissue_young, pad_young, poisson = moduli
    materials = [Material(PAD, pad_young, poisson), Material(TISSUE, tissue_young, poisson)]
    x, y, z = frame.centres()
    x_inside, y_inside = (((a > 0) & (a < n)) for a, n in zip((x, y), frame.size, strict=False))
    in_block = x_inside & y_inside[:, None] & ((z > 0) & (z < frame.size[2]))[:, None, None]
    labels = np.where(in_block, 2, 0).astype(np.uint8)
    for number, ((centre, radius), ball) in enumerate(shown, 1):
        name = INCLUSION if len(shown) == 1 else f"{INCLUSION} {number}"
        materials.append(Material(name, ball.contrast * tissue_young, poisson))
        distance = (x - centre[0]) ** 2 + ((y - centre[1]) ** 2)[:, None]
        distance = distance + ((z - centre[2]) ** 2)[:, None, None]
        labels[distance < radius**2] = len(materials)
    labels[in_block & (z > (1 - pad) * frame.size[2])[:, None, None]] = 1
    for name, slices in ((INDENTER, z > frame.size[2]), (FLOOR, z < 0)):
        materials.append(Material(name, None, None))
        labels[slices] = len(materials)
    return labels, dict(enumerate(materials, 1))


def _source(frame: VolumeFrame, texture: Image | None, pad: float, rng) -> np.ndarray:
    """Return spline coefficients of the block's signal at rest, oversampled, noise-free."""
    x, y, z = frame.centres(OVERSAMPLING, _border(frame))
    signal = speckle((len(z), len(y), len(x)), 1.6 * OVERSAMPLING, rng)
    if texture is not None:
        middle = frame.size / 2
        tissue = sample_volume(texture, x - middle[0], y - middle[1], z - middle[2])
        in_pad = (z > (1 - pad) * frame.size[2]).astype(float)
        in_pad = ndimage.gaussian_filter1d(in_pad, 0.5 * OVERSAMPLING)[:, None, None]
        signal = tissue + in_pad * (signal - tissue)

    def softened(inside):  # a border as an imaging system shows it
        return ndimage.gaussian_filter1d(inside.astype(float), 0.75 * OVERSAMPLING)

    in_x, in_y, in_z = (
        softened((a > 0) & (a < n)) for a, n in zip((x, y, z), frame.size, strict=True)
    )
    plates = softened((z < 0) | (z > frame.size[2]))
    inside = in_z[:, None, None] * (in_y[:, None] * in_x)
    signal = BACKGROUND + inside * (signal - BACKGROUND)
    signal += plates[:, None, None] * (PLATE - BACKGROUND)
    return ndimage.spline_filter(SIGNAL * signal, 3, mode="nearest", output=np.float32)


def _border(frame: VolumeFrame) -> int:
    """Return the width in voxels of the source's border around the volume."""
    return int(frame.margin.min())


def _render(source: np.ndarray, frame: VolumeFrame, points: np.ndarray) -> np.ndarray:
    """Sample the source at block coordinates (n, 3), one per voxel: (slices, rows, columns)."""
    border = frame.margin + _border(frame)
    samples = (points / frame.spacing + border) * OVERSAMPLING - 0.5
    values = ndimage.map_coordinates(
        source, samples[:, ::-1].T, output=float, order=3, prefilter=False, mode="nearest"
    )
    return values.reshape(frame.shape)
