"""Radiofrequency data of ultrasound: elastix follows their envelopes, the second step the waves.

A registration of the waves themselves would settle on any of them. The envelopes' is right to a
part of a wavelength, from where a few steps of image correlation on the mesh find the wave that
belongs to each node: their texture is finer than that of the envelope, and so is the displacement.
Where the pulled back waves do not agree around a node, a neighbouring wave was taken, or the push
has changed the echoes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...errors import InputError
from ...progress import Progress, part
from ..image import Image
from .correlation import carried_displacement, refine_displacement
from .information import displacement_information, voxels_in_cells
from .registration import (
    PixelFrame,
    Registration,
    check_image,
    on_grid_of,
    register,
    rest_and_pushed,
)
from .waves import agreement, envelope, wavelength

STEPS = 20  # at most; some five are usual
STILL = 0.02  # samples: a step after which no node moves more is the last
AGREE = 0.5  # correlation of the waves around a node below which it is not believed
AXES = "ijk"


def register_radiofrequency(
    axis: str,
    rest: Image | None,
    pushed: Sequence[Image],
    points: np.ndarray,
    cells: np.ndarray,
    *,
    reaction_nodes: np.ndarray | None = None,
    progress: Progress | None = None,
    **settings,
) -> Registration:
    """Measure the displacement of every mesh node in frames of radiofrequency data.

    Parameters
    ----------
    axis : "i", "j" or "k"
        Image axis along which the lines run, depth.
    rest, pushed, points, cells, reaction_nodes, progress, settings
        As of :func:`~elastoidentify.imaging.registration.register`, whose registration of the
        envelopes is what is followed.

    Returns
    -------
    Registration
        ``report["trials"]`` has two more figures: ``wave_agreement``, the median correlation of the
        waves around the nodes, and ``nodes_off_wave``.

    Raises
    ------
    InputError
        As :func:`~elastoidentify.imaging.registration.register`; where the data do not oscillate.
    """
    rest, pushed = rest_and_pushed(rest, pushed)
    names = ["rest", *(f"pushed (trial {number})" for number in range(1, len(pushed) + 1))]
    for image, name in zip([rest, *pushed], names, strict=True):
        check_image(image, name)
        _check_waves(image, name, axis)
    along = 2 - AXES.index(axis)
    every = max(1, round(wavelength(rest.array, along)))  # of the samples show an envelope
    found = register(
        *(_envelope(rest, along, every), [_envelope(one, along, every) for one in pushed]),
        points, cells, reaction_nodes=reaction_nodes, progress=part(progress, 0.0, 0.8), **settings,
    )  # fmt: skip
    trials = [on_grid_of(rest, image, name) for image, name in zip(pushed, names[1:], strict=True)]
    return follow(found, rest, trials, points, cells, reaction_nodes, part(progress, 0.8, 1.0))


def follow(
    found: Registration,
    rest: Image,
    pushed: Sequence[Image],
    points: np.ndarray,
    cells: np.ndarray,
    touched: np.ndarray | None = None,
    progress: Progress | None = None,
) -> Registration:
    """Carry a registration on by steps of image correlation on the waves of all trials.

    Trials whose waves do not agree keep what was found before, and the warnings say so.
    """
    progress = part(progress, 0.0, 1.0)
    frame = PixelFrame(rest)
    waves, index = frame.array(rest), frame.index(np.asarray(points, float))
    located = voxels_in_cells(index, cells, waves.shape)
    touched = None if touched is None else np.asarray(touched).astype(bool).ravel()
    displacements, information = found.displacements.copy(), found.information.copy()
    report = found.report | {"trials": [dict(one) for one in found.report["trials"]]}
    report["warnings"] = list(report["warnings"])
    for k, image in enumerate(pushed):
        progress(k / len(pushed), f"trial {k + 1} of {len(pushed)}: waves")
        if not information[k].any():
            continue
        start = found.displacements[k] @ rest.direction[:, frame.kept] / rest.spacing[frame.kept]
        one = _Waves(waves, frame.array(image), index, cells, frame.spacing, located)
        u, alike, warped = one.tracked(start)
        off = alike < AGREE
        report["trials"][k] |= {
            "wave_agreement": float(np.median(alike)), "nodes_off_wave": int(off.sum()),
        }  # fmt: skip
        report["warnings"] += _sentences(k + 1, alike, off)
        if np.median(alike) < AGREE:
            continue
        certain = one.information(u, warped, touched)
        certain[off | ~information[k].any(axis=1)] = 0.0
        information[k] = frame.information_to_world(certain)
        displacements[k] = frame.to_world(u * frame.spacing)
    progress(1.0, "registration done")
    return replace(found, displacements=displacements, information=information, report=report)


class _Waves:
    """The waves at rest and in one trial, and the mesh on them; lengths in samples."""

    def __init__(self, rest, pushed, index, cells, spacing, located):
        self.rest, self.pushed, self.index, self.cells = rest, pushed, index, cells
        self.spacing, self.located = spacing, located

    def tracked(self, u):
        """Return displacement, agreement, and the pulled back waves.

        Nodes on a wrong wave begin once more from where their neighbours are.
        """
        u = self._steps(u)
        alike, warped = agreement(self.rest, self.pushed, u, self.located)
        off = alike < AGREE
        if off.any() and off.mean() < 0.5:
            u = self._steps(self._carried(u, ~off))
            alike, warped = agreement(self.rest, self.pushed, u, self.located)
            u = self._carried(u, alike >= AGREE)
        return u, alike, warped

    def _steps(self, u):
        for _ in range(STEPS):
            before = u
            u = refine_displacement(
                self.rest, self.pushed, self.index, self.cells, u, self.spacing,
                located=self.located,
            )  # fmt: skip
            if np.abs(u - before).max() < STILL:
                break
        return u

    def _carried(self, u, trusted):
        pixels = self.index * self.spacing
        return carried_displacement(pixels, self.cells, u * self.spacing, trusted) / self.spacing

    def information(self, u, warped, touched):
        """Return the inverse covariance (n, d, d) in 1/pixel²."""
        seen = np.isfinite(warped)
        return displacement_information(
            self.rest, np.where(seen, warped, self.rest), self.index, self.cells,
            u * self.spacing, spacing=self.spacing, resolution=None, seen=seen, touched=touched,
            located=self.located,
        )[0]  # fmt: skip


def _check_waves(image: Image, name: str, axis: str) -> None:
    if image.size[AXES.index(axis)] == 1:
        raise InputError(
            f"the {name} image has one voxel along {axis}: name the axis along which the lines of "
            "radiofrequency data run"
        )
    if not (image.array < 0).any():
        raise InputError(
            f"the {name} image has no value below 0: radiofrequency data oscillate around 0; "
            "register envelopes and B-mode images without naming an axis"
        )


def _envelope(image: Image, along: int, every: int) -> Image:
    """The envelope of an image, on every so many samples."""
    spacing = image.spacing.copy()
    spacing[2 - along] *= every
    return replace(image, array=envelope(image.array, along, every), spacing=spacing)


def _sentences(trial: int, alike: np.ndarray, off: np.ndarray) -> list[str]:
    """What a person should know about the waves of one trial."""
    if np.median(alike) < AGREE:
        return [
            f"Trial {trial}: the radiofrequency data agree too little (correlation "
            f"{np.median(alike):.2f}) to follow their waves: the displacement is that of the "
            "envelopes. A smaller push changes the echoes less."
        ]
    if off.any():
        return [
            f"Trial {trial}: around {off.sum()} mesh nodes the radiofrequency data agree too "
            f"little (correlation below {AGREE:g}): their displacement is taken from the nodes "
            "around them and has no weight."
        ]
    return []
