"""A pushing phantom: rest and pushed images of a block whose stiffness is known everywhere.

The block stands on a floor and carries a pad of known stiffness, on which an indenter pushes. Its
tissue has the texture of a real image, its pad a speckle. The push is solved on a fine grid of
quadratic quadrilaterals, which no identification uses, and the pushed images are rendered by
inverse mapping from an oversampled source, so that nothing but the physics is shared between the
phantom and what identifies it.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from scipy import ndimage

from ...errors import InputError
from ...progress import Progress, part, silent
from ..image import Image
from ..io import make_folder, write_image, write_whole
from .push import Deformation, solve_pushes
from .push_slip import slipping_at
from .texture import sample_texture, speckle

PAD, TISSUE, INCLUSION, INDENTER, FLOOR = "pad", "tissue", "inclusion", "indenter", "floor"

OVERSAMPLING = 4  # source samples per pixel
SIGNAL = 1000.0  # grey value of the brightest tissue, as scanners store it
BACKGROUND, PLATE = 0.03, 0.12  # signal of air and of the rigid plates, of the brightest tissue


@dataclass(frozen=True)
class Inclusion:
    """A disc in the tissue.

    Parameters
    ----------
    x, y : float
        Centre, in widths of the block from its left edge and in heights from its top.
    radius : float
        In widths of the block.
    contrast : float
        Its Young's modulus over that of the tissue around it.
    """

    x: float = 0.55
    y: float = 0.6
    radius: float = 0.15
    contrast: float = 3.0


@dataclass(frozen=True)
class Material:
    """What one label is made of: Young's modulus (Pa) and Poisson's ratio; None: rigid."""

    name: str
    young: float | None
    poisson: float | None


@dataclass(frozen=True)
class Frame:
    """The block's place in the image; lengths in mm, (x, y) along columns and rows.

    The block covers 0…width × 0…height; its edges are pixel edges.
    """

    width: float
    height: float
    pixels: tuple[int, int]
    margin: tuple[int, int]
    origin: np.ndarray
    direction: np.ndarray

    @property
    def spacing(self) -> np.ndarray:
        """Pixel size (x, y)."""
        return np.array([self.width, self.height]) / self.pixels

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return tuple(self.pixels[a] + 2 * self.margin[a] for a in (1, 0))

    def pixel_centres(self, oversampling: int = 1, border: int = 0) -> tuple[np.ndarray, ...]:
        """Return x (columns) and y (rows) of the image's samples, with `border` pixels around."""
        return tuple(
            ((np.arange((n + 2 * border) * oversampling) + 0.5) / oversampling - border - m) * s
            for n, m, s in zip(self.shape[::-1], self.margin, self.spacing, strict=True)
        )

    @property
    def body_axes(self) -> np.ndarray:
        """World unit vectors of the block's x and y, (2, 3)."""
        return self.direction[:, :2].T

    def to_body(self, points: np.ndarray) -> np.ndarray:
        """Map world points (n, 3) to (x, y) of the block, shape (n, 2)."""
        pixel_corner = (np.array(self.margin) - 0.5) * self.spacing
        return (np.asarray(points, float) - self.origin) @ self.direction[:, :2] - pixel_corner

    def image(self, array: np.ndarray) -> Image:
        """Return the planar image of an array (rows, columns)."""
        return Image(array, self.origin, [*self.spacing, self.spacing.min()], self.direction)


@dataclass(frozen=True)
class Phantom:
    """Images of a push, and everything that is known about it."""

    rest: Image
    pushed: list[Image]
    segmentation: Image
    young: Image
    poisson: Image
    materials: dict[int, Material]
    pushes: np.ndarray  # (t, 3) world displacement of the indenter, mm
    frame: Frame  # of a volume: VolumeFrame
    deformations: list[Deformation] = field(repr=False)
    parameters: dict = field(repr=False)

    @property
    def lam(self) -> Image:
        """True λ in Pa; NaN outside of the block."""
        young, nu = self.young.array, self.poisson.array
        return self.young.with_array(young * nu / ((1 + nu) * (1 - 2 * nu)))

    @property
    def mu(self) -> Image:
        """True μ in Pa; NaN outside of the block."""
        return self.young.with_array(self.young.array / (2 * (1 + self.poisson.array)))

    def label(self, name: str) -> int:
        """Return the first label made of the material `name`."""
        return next(label for label, material in self.materials.items() if material.name == name)

    @property
    def rigid_labels(self) -> list[int]:
        """Labels of the indenter and the floor."""
        return [label for label, material in self.materials.items() if material.young is None]

    def displacements(self, points: np.ndarray) -> np.ndarray:
        """Return the true displacement of world points (n, 3) in every trial: (t, n, 3), mm."""
        body = self.frame.to_body(points)
        return np.array([field(body) @ self.frame.body_axes for field in self.deformations])

    def knowledge(self) -> dict:
        """Return what is known, ready for JSON: materials, pushes, and how it was made."""
        return {
            "materials": {str(label): asdict(m) for label, m in self.materials.items()},
            "rigid_labels": self.rigid_labels,
            "pushes_mm": self.pushes.tolist(),
            "units": {"length": "mm", "modulus": "Pa"},
            **self.parameters,
        }


def make_phantom(
    texture: Image | None = None,
    *,
    inclusions: Sequence[Inclusion] = (Inclusion(),),
    pad: float = 0.25,
    floor: float = 0.115,
    pushes: Sequence[tuple[float, float]] = ((0.0, 0.05), (0.035, 0.035)),
    tissue_young: float = 3000.0,
    pad_young: float = 5000.0,
    poisson: float = 0.45,
    noise: float = 0.02,
    seed: int = 0,
    width: float | None = None,
    height: float | None = None,
    pixels: int = 208,
    anisotropy: float = 1.0,
    margin: float = 0.115,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    direction: np.ndarray | None = None,
    kinematics: str = "small-strain",
    elements: int = 80,
    slip: bool = False,
    solver: Callable | None = None,
    progress: Progress | None = None,
) -> Phantom:
    """Make a phantom: images of a block at rest and pushed, with all that is known about it.

    Parameters
    ----------
    texture : Image, optional
        Planar image (see :func:`~elastoidentify.imaging.phantom.texture.slice_of`) that gives
        the tissue its texture, centre on centre, at its own scale. None: speckle.
    inclusions : sequence of Inclusion
    pad, floor : float
        Thickness of the pad, and of the rigid floor and indenter, in heights of the block.
    pushes : sequence of (x, y)
        Displacement of the indenter per trial, in heights of the block, x to the right (along
        columns), y down (along rows). The indenter and the floor stick to the block.
    tissue_young, pad_young : float
        Young's moduli, Pa.
    poisson : float
        Poisson's ratio of pad, tissue and inclusions.
    noise : float
        Rician noise, as a share of the brightest tissue's signal.
    seed : int
        Of the speckle and the noise.
    width, height : float, optional
        Of the block, mm. Default: 0.6 of the texture's smaller side (120 mm without a texture),
        and as high as wide.
    pixels : int
        Across the block's width.
    anisotropy : float
        Height of a pixel over its width.
    margin : float
        Air on both sides, in widths of the block.
    origin, direction
        Of the images, as in :class:`Image`.
    kinematics : "small-strain", "neo-hookean"
        Of the push.
    elements : int
        Quadratic quadrilaterals across the block's width.
    slip : bool
        The pad slides on the tissue without friction instead of sticking to it.
    solver : callable, optional
        ``solve_pushes`` of :mod:`.push`, or of :mod:`.push_quads`, which needs no scikit-fem.
    progress : callable, optional

    Raises
    ------
    InputError
        A parameter out of range, an inclusion that leaves the tissue, a push that folds the block.
    """
    check_parameters(pad, poisson, noise, pixels, anisotropy, tissue_young, pad_young, pushes)
    progress = progress or silent
    if width is None:
        width = 120.0 if texture is None else 0.6 * _smaller_side(texture)
    frame = _frame(width, height or width, pixels, anisotropy, margin, floor, origin, direction)
    discs = [_disc(inclusion, frame, pad) for inclusion in inclusions]

    def moduli(x, y):
        young = np.full(np.shape(x), float(tissue_young))
        for (centre_x, centre_y, radius), inclusion in zip(discs, inclusions, strict=True):
            inside = np.hypot(x - centre_x, y - centre_y) < radius
            young[inside] = inclusion.contrast * tissue_young
        young[np.asarray(y) < pad * frame.height] = pad_young
        return young, np.full(np.shape(x), float(poisson))

    shifts = np.asarray(pushes, float) * frame.height
    solver = solver or (slipping_at(pad) if slip else solve_pushes)
    deformations = solver(
        frame.width,
        frame.height,
        frame.margin[0] * frame.spacing[0],
        moduli,
        shifts,
        elements=elements,
        kinematics=kinematics,
        progress=part(progress, 0.0, 0.6),
    )

    rng = np.random.default_rng(seed)
    source = _source(frame, texture, pad, rng)
    x, y = frame.pixel_centres()
    centres = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    images = [_render(source, frame, centres)]
    for trial, deformation in enumerate(deformations, 1):
        progress(0.6 + 0.4 * trial / (len(deformations) + 1), f"rendering trial {trial}")
        images.append(_render(source, frame, deformation.inverse(centres)))
    level = noise * np.percentile(images[0], 99)
    rest, *pushed = (frame.image(rician(image, level, rng).astype(np.float32)) for image in images)

    labels, materials = _labels(frame, pad, discs, x, y)
    material_table = _materials(materials, inclusions, tissue_young, pad_young, poisson)
    truth = _truth(labels, material_table)
    return Phantom(
        rest,
        pushed,
        frame.image(labels),
        frame.image(truth[0]),
        frame.image(truth[1]),
        material_table,
        shifts @ frame.direction[:, :2].T,
        frame,
        deformations,
        {
            "block_mm": [frame.width, frame.height],
            "pad": pad,
            "inclusions": [asdict(inclusion) for inclusion in inclusions],
            "pushes": np.asarray(pushes, float).tolist(),
            "noise": noise,
            "noise_grey_values": float(level),
            "seed": seed,
            "kinematics": kinematics,
            "elements": elements,
            "slip": slip,
        },
    )


def write_phantom(folder: str | Path, phantom: Phantom) -> list[Path]:
    """Write a phantom's images, segmentation, true maps (NRRD) and ``phantom.json`` to a folder.

    Returns
    -------
    list of Path
        The files: ``rest``, ``pushed_1``…, ``segmentation``, ``true_young``, ``true_poisson``,
        ``true_lambda``, ``true_mu``, ``phantom.json``.
    """
    folder = make_folder(folder)
    images = {"rest": phantom.rest}
    images |= {f"pushed_{trial}": image for trial, image in enumerate(phantom.pushed, 1)}
    images |= {
        "segmentation": phantom.segmentation,
        "true_young": phantom.young,
        "true_poisson": phantom.poisson,
        "true_lambda": phantom.lam,
        "true_mu": phantom.mu,
    }
    for name, image in images.items():
        write_image(folder / f"{name}.nrrd", image)
    text = json.dumps(phantom.knowledge(), indent=2) + "\n"
    write_whole(folder / "phantom.json", lambda file: file.write_text(text, encoding="utf-8"))
    return [*(folder / f"{name}.nrrd" for name in images), folder / "phantom.json"]


def check_parameters(pad, poisson, noise, pixels, anisotropy, tissue_young, pad_young, pushes):
    """Raise InputError for a parameter that makes no phantom."""
    rules = (
        (0 < pad < 1, f"pad thickness {pad:g}: give a share of the height between 0 and 1"),
        (-1 < poisson < 0.5, f"Poisson's ratio {poisson:g}: give a value between -1 and 0.5"),
        (0 <= noise < 1, f"noise {noise:g}: give a share of the signal, 0.02 for 2 %"),
        (pixels >= 16, f"{pixels} pixels across the block: give at least 16"),
        (anisotropy > 0, f"pixel anisotropy {anisotropy:g}: give a positive ratio"),
        (tissue_young > 0 and pad_young > 0, "Young's moduli must be positive"),
        (len(pushes) > 0, "no push: give at least one trial"),
    )
    for fine, message in rules:
        if not fine:
            raise InputError(message)


def _smaller_side(texture: Image) -> float:
    """Return the smaller in-plane extent of a planar image."""
    sides = np.delete(np.array(texture.size) * texture.spacing, texture.planar_axis)
    return float(sides.min())


def _frame(width, height, pixels, anisotropy, margin, floor, origin, direction) -> Frame:
    """Place the block in its image, edges on pixel edges."""
    pixel = width / pixels
    rows = max(round(height / (pixel * anisotropy)), 8)
    return Frame(
        float(width),
        float(height),
        (pixels, rows),
        (max(round(margin * pixels), 2), max(round(floor * rows), 2)),
        np.asarray(origin, float),
        np.eye(3) if direction is None else np.asarray(direction, float),
    )


def _disc(inclusion: Inclusion, frame: Frame, pad: float) -> tuple[float, float, float]:
    """Return centre x, y and radius of an inclusion in mm, once it lies in the tissue."""
    x, y = inclusion.x * frame.width, inclusion.y * frame.height
    radius = inclusion.radius * frame.width
    inside = radius <= x <= frame.width - radius
    inside &= pad * frame.height + radius <= y <= frame.height - radius
    if not (inside and radius > 0 and inclusion.contrast > 0):
        raise InputError(
            f"inclusion x={inclusion.x:g}, y={inclusion.y:g}, radius={inclusion.radius:g}, "
            f"contrast={inclusion.contrast:g} leaves the tissue or has no stiffness: x and y are "
            f"shares of the block, which is tissue from y={pad:g} to 1"
        )
    return x, y, radius


def _labels(frame: Frame, pad: float, discs, x, y) -> tuple[np.ndarray, list[str]]:
    """Return the labelmap (rows, columns) and the material name of labels 1, 2, …"""
    names = [PAD, TISSUE]
    inside_x = (x > 0) & (x < frame.width)
    labels = np.zeros((len(y), len(x)), np.uint8)
    labels[np.ix_((y > 0) & (y < frame.height), inside_x)] = 2
    for centre_x, centre_y, radius in discs:
        names.append(INCLUSION if len(discs) == 1 else f"{INCLUSION} {len(names) - 1}")
        labels[np.hypot(x - centre_x, y[:, None] - centre_y) < radius] = len(names)
    labels[np.ix_((y > 0) & (y < pad * frame.height), inside_x)] = 1
    for name, rows in ((INDENTER, y < 0), (FLOOR, y > frame.height)):
        names.append(name)
        labels[rows] = len(names)
    return labels, names


def _materials(names, inclusions, tissue_young, pad_young, poisson) -> dict[int, Material]:
    """Return the material of each label; None moduli for the rigid ones."""
    contrasts = [inclusion.contrast for inclusion in inclusions]
    young = [pad_young, tissue_young, *(c * tissue_young for c in contrasts), None, None]
    return {
        label: Material(name, e, None if e is None else poisson)
        for label, (name, e) in enumerate(zip(names, young, strict=True), 1)
    }


def _truth(labels: np.ndarray, materials: dict[int, Material]) -> tuple[np.ndarray, np.ndarray]:
    """Return maps of E and ν, NaN in air and rigid bodies."""
    rows = [(np.nan, np.nan)]
    rows += [
        (m.young or np.nan, np.nan if m.poisson is None else m.poisson) for m in materials.values()
    ]
    young, poisson = np.array(rows, float).T
    return young[labels], poisson[labels]


def _source(frame: Frame, texture: Image | None, pad: float, rng) -> np.ndarray:
    """Return spline coefficients of the block's signal at rest, oversampled, noise-free."""
    x, y = frame.pixel_centres(OVERSAMPLING, _border(frame))
    grain = 1.6 * OVERSAMPLING
    signal = speckle((len(y), len(x)), grain, rng)
    if texture is not None:
        tissue = sample_texture(texture, x - frame.width / 2, y - frame.height / 2)
        in_pad = ndimage.gaussian_filter1d(
            (y < pad * frame.height).astype(float), 0.5 * OVERSAMPLING
        )
        signal = tissue + in_pad[:, None] * (signal - tissue)
    inside = np.outer((y > 0) & (y < frame.height), (x > 0) & (x < frame.width)).astype(float)
    plates = np.broadcast_to(((y < 0) | (y > frame.height))[:, None], inside.shape).astype(float)
    inside, plates = (ndimage.gaussian_filter(a, 0.75 * OVERSAMPLING) for a in (inside, plates))
    signal = BACKGROUND + inside * (signal - BACKGROUND) + plates * (PLATE - BACKGROUND)
    return ndimage.spline_filter(SIGNAL * signal, 5, mode="nearest")


def _border(frame: Frame) -> int:
    """Return the width in pixels of the source's border around the image."""
    return max(frame.margin)


def _render(source: np.ndarray, frame: Frame, points: np.ndarray) -> np.ndarray:
    """Sample the source at block coordinates (n, 2), one per pixel; returns (rows, columns)."""
    border = np.array(frame.margin) + _border(frame)
    samples = (points / frame.spacing + border) * OVERSAMPLING - 0.5
    values = ndimage.map_coordinates(
        source, samples[:, ::-1].T, order=5, prefilter=False, mode="nearest"
    )
    return values.reshape(frame.shape)


def rician(image: np.ndarray, level: float, rng: np.random.Generator) -> np.ndarray:
    """Return the magnitude of a signal with Gaussian noise in both channels (MR magnitude)."""
    real, imaginary = level * rng.standard_normal((2, *image.shape))
    return np.hypot(image + real, imaginary)
