"""Slices with their places put together to a volume, or one sentence why they are none."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import InputError

PLANES = ("sagittal", "coronal", "axial")
STEP_TOLERANCE = 0.01  # of the step: what slices may be off an even spacing
MOST_TOLERANCE = 0.1  # of the step, however coarsely the positions are rounded
SIDE_TOLERANCE = 0.1  # of a pixel: what slices may be shifted against each other
SAME_DIRECTION = 2e-3  # radians between slices of one orientation


@dataclass
class Frame:
    """One slice of a DICOM file.

    Attributes
    ----------
    data : pydicom Dataset
        Of its file, without pixels.
    index : int
        Which frame of the file.
    position : (3,) or None
    orientation : (2, 3) or None
        Unit vectors of a row (index i) and of a column (index j).
    spacing : (2,)
        Along i and j.
    step, thickness : float or None
    slope, intercept : float
    keys : {attribute: text}
        What may tell several images at one place apart.
    number : int or None
        InstanceNumber.
    digits : (int, int)
        Decimals that position and orientation were written with.
    film : bool
        A picture in a sequence of times without places.
    """

    data: object
    index: int
    position: np.ndarray | None
    orientation: np.ndarray | None
    spacing: np.ndarray
    step: float | None = None
    thickness: float | None = None
    slope: float = 1.0
    intercept: float = 0.0
    keys: dict[str, str] = field(default_factory=dict)
    number: int | None = None
    digits: tuple[int, int] = (0, 0)
    film: bool = False
    notes: list[str] = field(default_factory=list)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return int(self.data.Columns), int(self.data.Rows)

    @property
    def identity(self):
        """The same for a file that lies in the folder twice."""
        uid = str(self.data.get("SOPInstanceUID", ""))
        return (uid or self.data.filename, self.index)


@dataclass
class Volume:
    """Frames in order of their places, and the grid they make."""

    frames: list[Frame]
    origin: np.ndarray
    spacing: np.ndarray
    direction: np.ndarray
    notes: list[str] = field(default_factory=list)


def orientation_name(frame: Frame) -> str:
    """Return "axial", "oblique sagittal" … or "" where the orientation is not known."""
    if frame.orientation is None:
        return ""
    normal = np.abs(np.cross(frame.orientation[0], frame.orientation[1]))
    name = PLANES[int(normal.argmax())]
    return name if normal.max() > 0.999 else f"oblique {name}"


def same_place(frames: list[Frame]) -> list[list[Frame]]:
    """Return the images that lie on top of each other: times, echoes, kinds.

    One list of all frames where there is one image per place, or where they are not so regular that
    they can be told apart (:func:`stack` then says why).
    """
    given, frames = frames, list({one.identity: one for one in frames}.values())
    if len(frames) < 2 or any(one.position is None or one.orientation is None for one in frames):
        return [given]
    if len({one.size for one in frames}) > 1 or len(_orientations(frames)) > 1:
        return [given]
    place = _places(frames)
    count = Counter(place)
    times = max(count.values())
    if times == 1 or set(count.values()) != {times}:
        return [given]
    for key in dict.fromkeys(key for one in frames for key in one.keys):
        groups = {}
        for one, where in zip(frames, place, strict=True):
            groups.setdefault(one.keys.get(key, ""), []).append((where, one))
        if len(groups) == times and all(
            len({w for w, _ in g}) == len(count) for g in groups.values()
        ):
            ordered = sorted(groups.items(), key=lambda item: _natural(item[0]))
            return [[one for _, one in group] for _, group in ordered]
    if any(one.number is None for one in frames):
        return [given]
    ordered = sorted(zip(place, frames, strict=True), key=lambda item: (item[0], item[1].number))
    return [[one for _, one in ordered[time::times]] for time in range(times)]


def _natural(text: str):
    """A key that sorts numbers as numbers and other texts after them."""
    try:
        return (0, float(text), text)
    except ValueError:
        return (1, 0.0, text)


def stack(path: Path, frames: list[Frame], pixels: Callable[[Frame], np.ndarray]) -> Volume:
    """Put frames of one series in order.

    Parameters
    ----------
    path : Path
        For messages.
    frames : list of Frame
    pixels : callable
        The values of a frame, to tell a slice given twice from two at one place.

    Raises
    ------
    InputError
        Slices of several sizes or orientations, missing, doubled or unevenly spaced ones, a gantry
        tilt, files without a place.
    """
    notes = list(dict.fromkeys(note for one in frames for note in one.notes))
    distinct = list({one.identity: one for one in frames}.values())
    if len(distinct) < len(frames):
        notes.append(f"{len(frames) - len(distinct)} slices are there twice and were taken once")
    frames = distinct
    if len(frames) == 1:
        return _single(frames[0], notes)
    _check_alike(path, frames)
    frames = _one_each(path, frames, pixels, notes)
    if len(frames) == 1:
        return _single(frames[0], notes)
    rows = frame_axes(frames)
    along = np.array([one.position for one in frames]) @ rows[2]
    order = np.argsort(along, kind="stable")
    frames = [frames[k] for k in order]
    positions = np.array([one.position for one in frames])
    step = _check_steps(path, frames, positions, rows)
    notes += _numbering_notes(frames)
    said = abs(frames[0].step or 0.0)
    if said and step / said > 1.5 and abs(step / said - round(step / said)) < 0.05:
        notes.append(
            f"the slices are {step:.4g} mm apart and the files say {said:.4g} mm: every second one "
            "or more may be missing"
        )
    spacing = np.array([*frames[0].spacing, step])
    return Volume(frames, positions[0], spacing, rows.T, notes)


def _single(frame: Frame, notes: list[str]) -> Volume:
    direction = np.eye(3) if frame.orientation is None else frame_axes([frame]).T
    origin = np.zeros(3) if frame.position is None else frame.position
    depth = abs(frame.step or frame.thickness or 0.0) or 1.0
    return Volume([frame], origin, np.array([*frame.spacing, depth]), direction, notes)


def frame_axes(frames: list[Frame]) -> np.ndarray:
    """Return the unit vectors of i, j, k as rows, at right angles to rounding."""
    row, column = np.mean([one.orientation for one in frames], axis=0)
    row = row / np.linalg.norm(row)
    normal = np.cross(row, column)
    normal /= np.linalg.norm(normal)
    return np.array([row, np.cross(normal, row), normal])


def _orientations(frames: list[Frame]) -> list[list[Frame]]:
    """Return the frames by orientation, the largest group first."""
    groups: list[list[Frame]] = []
    for one in frames:
        for group in groups:
            if np.abs(one.orientation - group[0].orientation).max() <= SAME_DIRECTION:
                group.append(one)
                break
        else:
            groups.append([one])
    return sorted(groups, key=len, reverse=True)


def _check_alike(path: Path, frames: list[Frame]) -> None:
    """Refuse frames that cannot be slices of one volume."""
    sizes = Counter(one.size for one in frames).most_common()
    if len(sizes) > 1:
        said = ", ".join(f"{n} of {size[0]} × {size[1]}" for size, n in sizes[:4])
        raise InputError(
            f"{path}: slices of several sizes ({said} pixels); keep those of one size (a localizer "
            "may be among them)"
        )
    for what in ("position", "orientation"):
        lacking = [one for one in frames if getattr(one, what) is None]
        if lacking:
            raise InputError(
                f"{path}: {len(lacking)} of {len(frames)} pictures have no {what}, the first is "
                f"{Path(lacking[0].data.filename).name}: they are no volume; give a single file"
            )
    groups = _orientations(frames)
    if len(groups) > 1:
        said = ", ".join(f"{len(group)} {orientation_name(group[0])}" for group in groups[:4])
        raise InputError(
            f"{path}: slices in more than one orientation ({said}); keep those of one orientation "
            "(a localizer may be among them)"
        )
    spacings = np.array([one.spacing for one in frames])
    if (np.abs(spacings - spacings[0]) > 1e-3 * spacings[0]).any():
        raise InputError(f"{path}: slices with pixels of several sizes; keep those of one size")


def _places(frames: list[Frame]) -> np.ndarray:
    """Return a number for each frame, the same for frames at one place, in order of place."""
    rows = frame_axes(frames)
    along = np.array([one.position for one in frames]) @ rows[2]
    order = np.argsort(along, kind="stable")
    apart = np.diff(along[order]) > 1e-3 * frames[0].spacing.min()
    number = np.empty(len(frames), int)
    number[order] = np.concatenate([[0], np.cumsum(apart)])
    return number


def _one_each(path: Path, frames: list[Frame], pixels, notes: list[str]) -> list[Frame]:
    """Return one frame per place; equal copies are dropped, different ones are refused."""
    place, kept, copies = _places(frames), {}, 0
    for one, where in zip(frames, place.tolist(), strict=True):
        if where not in kept:
            kept[where] = one
            continue
        first = kept[where]
        apart = np.abs(one.position - first.position).max()
        if apart > 0.1 * one.spacing.min() or not np.array_equal(pixels(one), pixels(first)):
            names = [Path(f.data.filename).name for f in (first, one)]
            raise InputError(
                f"{path}: two different images at one place ({names[0]} and {names[1]}): several "
                "times or series are mixed; keep one image per place"
            )
        copies += 1
    if copies:
        notes.append(f"{copies} slices are there twice and were taken once")
    return list(kept.values())


def _check_steps(path: Path, frames: list[Frame], positions: np.ndarray, rows: np.ndarray) -> float:
    """Return the distance of the slices, or refuse uneven or tilted ones.

    Positions may be rounded to the digits that the file has them with.
    """
    along = positions @ rows[2]
    steps = np.diff(along)
    usual = float(np.sort(steps)[(len(steps) - 1) // 2])  # of two, that without a gap
    rounding = np.sqrt(3) / 2 * _last_digit(one.digits[0] for one in frames)
    even = min(STEP_TOLERANCE * usual + rounding, MOST_TOLERANCE * usual)
    index = np.arange(len(along))
    mean = (along[-1] - along[0]) / index[-1]
    off = np.abs(along - along[0] - mean * index - np.mean(along - along[0] - mean * index))
    worst = int(np.abs(steps - usual).argmax())
    if abs(steps[worst] - usual) > 2 * even or off.max() > even:
        missing = steps[worst] / usual
        guess = round(missing) - 1
        why = (
            f"{guess} slice{'s' if guess > 1 else ''} may be missing there"
            if guess >= 1 and abs(missing - guess - 1) < 0.1
            else "slices may be missing, or resample the series first"
        )
        raise InputError(
            f"{path}: the slices are not evenly spaced: {usual:.4g} mm as a rule, "
            f"{steps[worst]:.4g} mm between slices {worst + 1} and {worst + 2}; {why}"
        )
    side = positions - positions[0] - np.outer(along - along[0], rows[2])
    turn = _last_digit(one.digits[1] for one in frames) * (along[-1] - along[0])
    allowed = SIDE_TOLERANCE * frames[0].spacing.min() + 2 * rounding + turn
    shifted = np.linalg.norm(side, axis=1)
    if shifted.max() > allowed:
        line = np.outer((along - along[0]) / (along[-1] - along[0]), side[-1])
        angle = np.degrees(np.arctan2(shifted[-1], along[-1] - along[0]))
        if np.linalg.norm(side - line, axis=1).max() <= allowed:
            raise InputError(
                f"{path}: the slices are sheared by a gantry tilt of {angle:.3g}°; resample them "
                "onto a straight grid first (3D Slicer does so on loading, dcm2niix on converting)"
            )
        raise InputError(
            f"{path}: the slices are shifted sideways against each other by up to "
            f"{shifted.max():.3g} mm; resample the series first"
        )
    return float(mean)


def _last_digit(digits) -> float:
    """Return what numbers with so many decimals are rounded to; whole numbers are exact."""
    most = max(digits)
    return 10.0**-most if most > 0 else 0.0


def _numbering_notes(frames: list[Frame]) -> list[str]:
    """Return a sentence when the numbers of the files say that slices at the ends are missing."""
    count = len(frames)
    said = frames[0].data.get("ImagesInAcquisition")
    numbers = {one.number for one in frames if one.number is not None}
    gap = max(numbers) - min(numbers) + 1 - count if len(numbers) == count else 0
    if said and str(said).isdigit() and int(said) > count and len(numbers) == count:
        return [f"the series has {said} images by its own count and {count} are there"]
    if 0 < gap < count:
        return [f"the numbers of the slices have gaps: {gap} may be missing at an end"]
    return []
