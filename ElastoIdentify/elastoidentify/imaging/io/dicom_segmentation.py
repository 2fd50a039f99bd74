"""DICOM segmentation objects (SEG) and structure sets (RTSTRUCT) as labelmaps with names.

Source of the attributes: DICOM PS3.3, C.8.20 (segmentation) and C.8.8.5, C.8.8.6 (structure sets).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..image import Image
from .damage import damaged
from .dicom import SEGMENTATION_CLASSES, files_of, frames_of, header, pixels, understood
from .stack import Frame, frame_axes

STRUCTURES = "1.2.840.10008.5.1.4.1.1.481.3"
SURFACES = "1.2.840.10008.5.1.4.1.1.66.5"
OWN_GRID = 256  # pixels across, where contours bring no image's grid
HALF = 0.5  # share of a voxel that a fractional segment must fill
OFF_PLANE = 1e-2  # of a slice: what a contour's points may lie off their plane


def find(path: Path) -> Path | None:
    """Return the segmentation object that `path` is or holds, None if it is or holds images."""
    found, images = [], 0
    for file in files_of(path):
        data = header(file)
        if str(data.get("SOPClassUID", "")) in SEGMENTATION_CLASSES:
            found.append(file)
        elif "Rows" in data:
            images += 1
    if len(found) > 1:
        names = ", ".join(file.name for file in found[:6])
        raise InputError(f"{path}: has {len(found)} segmentations ({names}); give one of them")
    return found[0] if found else None


def read(path: Path, reference: Image | None = None) -> tuple[Image, dict[int, str]]:
    """Read a segmentation object or structure set; see :func:`~..io.read_segmentation`."""
    data = header(path)
    kind = str(data.SOPClassUID)
    with understood(path):
        if kind == STRUCTURES:
            return _structures(path, data, reference)
        if kind == SURFACES:
            raise InputError(f"{path}: surfaces are not read; export the segmentation as labelmap")
        return _segments(path, data)


# ---- segmentation objects


def _segments(path: Path, data) -> tuple[Image, dict[int, str]]:
    names = {}
    for item in data.get("SegmentSequence") or []:
        names[int(item.SegmentNumber)] = _name(item)
    if not names:
        raise damaged(path, "it names no segment")
    frames = frames_of(data)
    if any(one.position is None or one.orientation is None for one in frames):
        raise InputError(
            f"{path}: its frames have no place in space (a slide's tiles?); export it as labelmap"
        )
    labels = str(data.get("SegmentationType", "BINARY")).upper() == "LABELMAP"
    numbers = [0 if labels else _segment_of(path, data, one) for one in frames]
    volume, slices, notes = _grid(path, frames)
    stored = pixels(path)
    if len(stored) < len(frames):
        raise damaged(path, "it has fewer frames than it claims")
    made = np.zeros((volume[0], *stored.shape[1:3]), np.int32)
    threshold = 1
    if str(data.get("SegmentationType", "BINARY")).upper() == "FRACTIONAL":
        threshold = HALF * int(data.get("MaximumFractionalValue", 255))
        notes.append("is fractional: voxels that a segment fills by half or more are its own")
    covered = 0
    for one, number, where in zip(frames, numbers, slices, strict=True):
        values = stored[one.index]
        here = values > 0 if labels else values >= threshold
        covered += int(np.count_nonzero(made[where][here]))
        made[where][here] = values[here] if labels else number
    if covered:
        notes.append(f"segments overlap in {covered} voxels, which the later one keeps")
    unknown = set(np.unique(made)) - {0} - set(names)
    if unknown:
        raise damaged(path, f"it uses the segment {min(unknown)}, which it does not name")
    image = Image(made, volume[1], volume[2], volume[3], tuple(notes))
    return image, names


def _name(item) -> str:
    """Return a segment's name, with the meaning of its code where that says more."""
    label = str(item.get("SegmentLabel", "") or "").strip()
    codes = item.get("SegmentedPropertyTypeCodeSequence")
    meaning = str(codes[0].get("CodeMeaning", "") or "").strip() if codes else ""
    if label and meaning and meaning.lower() not in label.lower():
        return f"{label} ({meaning})"
    return label or meaning or f"segment {item.SegmentNumber}"


def _segment_of(path: Path, data, one: Frame) -> int:
    own = data.PerFrameFunctionalGroupsSequence[one.index]
    shared = data.get("SharedFunctionalGroupsSequence") or [{}]
    for where in (own, shared[0]):
        found = where.get("SegmentIdentificationSequence")
        if found:
            return int(found[0].ReferencedSegmentNumber)
    raise damaged(path, f"its frame {one.index + 1} belongs to no segment")


def _grid(path: Path, frames: list[Frame]):
    """Return the grid of all frames, and the slice of each; empty slices may be left out.

    Returns
    -------
    (number of slices, origin, spacing, direction), slices (n,), notes
    """
    rows = frame_axes(frames)
    if max(np.abs(one.orientation - frames[0].orientation).max() for one in frames) > 2e-3:
        raise InputError(f"{path}: frames in more than one orientation; export it as labelmap")
    positions = np.array([one.position for one in frames])
    along = positions @ rows[2]
    places = np.unique(np.round(along / frames[0].spacing.min(), 3)) * frames[0].spacing.min()
    step = abs(frames[0].step or 0.0)
    if len(places) > 1:
        least = float(np.diff(places).min())
        if not step or least < 0.9 * step:
            step = least
    step = step or abs(frames[0].thickness or 0.0) or 1.0
    slices = (along - along.min()) / step
    side = positions - positions[0] - np.outer(along - along[0], rows[2])
    whole = np.rint(slices).astype(int)
    if np.abs(slices - whole).max() > 0.1 or np.abs(side).max() > 0.1 * frames[0].spacing.min():
        raise InputError(
            f"{path}: its frames are not evenly spaced, or are tilted; export it as labelmap"
        )
    first = positions[along.argmin()]
    spacing = np.array([*frames[0].spacing, step])
    if whole.max() > 100_000:
        raise damaged(path, "its frames lie too far apart")
    return (int(whole.max()) + 1, first, spacing, rows.T), whole, []


# ---- structure sets


@dataclass
class _Contour:
    label: int
    points: np.ndarray  # (n, 3), LPS


def _structures(path: Path, data, reference: Image | None) -> tuple[Image, dict[int, str]]:
    names, numbers = {}, {}
    for label, item in enumerate(data.get("StructureSetROISequence") or [], 1):
        numbers[int(item.ROINumber)] = label
        names[label] = str(item.get("ROIName", "") or f"structure {item.ROINumber}")
    contours, skipped = [], 0
    for item in data.get("ROIContourSequence") or []:
        label = numbers.get(int(item.get("ReferencedROINumber", -1)))
        for contour in item.get("ContourSequence") or []:
            values = np.array(contour.get("ContourData") or [], float)
            if label is None or values.size % 3 or not np.isfinite(values).all():
                raise damaged(path, "a contour is no list of points")
            points = values.reshape(-1, 3)
            planar = str(contour.get("ContourGeometricType", "CLOSED_PLANAR"))
            if len(points) < 3 or planar not in ("CLOSED_PLANAR", "CLOSEDPLANAR_XOR"):
                skipped += 1
                continue
            contours.append(_Contour(label, points))
    if not contours:
        raise InputError(f"{path}: a structure set without closed contours; nothing to mesh")
    notes = [f"{skipped} points or open contours were left out"] if skipped else []
    grid = reference if reference is not None and _fits(contours, reference) else None
    if grid is None:
        grid = _own_grid(contours)
        notes.append(
            "its contours were filled on a grid of their own"
            + (", since they do not lie in the image's slices" if reference is not None else "")
        )
    made = _filled(contours, grid, notes)
    used = set(np.unique(made).tolist())
    empty = [name for label, name in names.items() if label not in used]
    if empty:
        notes.append(f"without a voxel: {', '.join(empty[:6])}")
    names = {label: name for label, name in names.items() if label in used}
    return Image(made, grid.origin, grid.spacing, grid.direction, tuple(notes)), names


def _fits(contours: list[_Contour], grid: Image) -> bool:
    """Tell whether every contour lies in a plane of k (or at least as flat as half a slice)."""
    spread = max(np.ptp(grid.world_to_index(one.points)[:, 2]) for one in contours)
    return spread < (0.5 if grid.size[2] > 1 else np.inf)


def _own_grid(contours: list[_Contour]) -> Image:
    """Return an empty grid in the planes of the contours."""
    largest = max(contours, key=lambda one: np.ptp(one.points, axis=0).max())
    centre = largest.points.mean(axis=0)
    normal = np.linalg.svd(largest.points - centre, full_matrices=False)[2][2]
    normal = normal * np.sign(normal[np.abs(normal).argmax()])
    first = np.eye(3)[np.argsort(np.abs(normal), kind="stable")[0]]
    first = first - normal * (first @ normal)
    first /= np.linalg.norm(first)
    direction = np.column_stack([first, np.cross(normal, first), normal])
    every = np.concatenate([one.points for one in contours]) @ direction
    planes = np.sort([float(np.median(one.points @ normal)) for one in contours])
    gaps = np.diff(planes)
    pixel = float(np.ptp(every[:, :2], axis=0).max()) / OWN_GRID
    gaps = gaps[gaps > 1e-3 * max(pixel, 1e-9)]
    step = float(gaps.min()) if len(gaps) else pixel
    low = np.array([*(every[:, :2].min(axis=0) - 2 * pixel), planes[0]])
    high = np.array([*(every[:, :2].max(axis=0) + 2 * pixel), planes[-1]])
    spacing = np.array([pixel, pixel, step])
    size = np.ceil((high - low) / spacing - 1e-6).astype(int) + 1
    if size.prod() > 2_000_000_000 or not pixel > 0:
        raise InputError("the contours make no grid: their planes lie too unevenly")
    return Image(np.zeros(size[::-1], np.uint8), direction @ low, spacing, direction)


def _filled(contours: list[_Contour], grid: Image, notes: list[str]) -> np.ndarray:
    """Return the labels of voxels whose centres lie inside contours.

    A structure's contours in one plane are combined by exclusive or, so that one inside another is
    a hole. A slice between two planes of contours takes the nearer one's.
    """
    made = np.zeros(grid.array.shape, np.int32)
    covered = between = 0
    for label in dict.fromkeys(one.label for one in contours):
        index = [grid.world_to_index(one.points) for one in contours if one.label == label]
        height = np.array([np.median(points[:, 2]) for points in index])
        if grid.size[2] == 1:
            height = np.zeros(len(index))
        planes = np.unique(np.round(height, 2))
        apart = float(np.diff(planes).max()) if len(planes) > 1 else 1.0
        for k in range(grid.size[2]):
            nearest = planes[np.abs(planes - k).argmin()]
            if abs(nearest - k) > 0.5 and not planes[0] < k < planes[-1]:
                continue
            if abs(nearest - k) > apart / 2 + 1e-6:
                continue
            between += abs(nearest - k) > 0.5
            inside = np.zeros(made.shape[1:], bool)
            for points, where in zip(index, np.round(height, 2), strict=True):
                if where == nearest:
                    inside ^= polygon(points[:, :2], made.shape[1:])
            covered += int(np.count_nonzero(made[k][inside]))
            made[k][inside] = label
    if between:
        notes.append(f"{between} slices between contours were given those of the nearest")
    if covered:
        notes.append(f"structures overlap in {covered} voxels, which the later one keeps")
    return made


def polygon(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return which pixel centres lie inside a polygon, by the parity of crossings to their left.

    Parameters
    ----------
    corners : (n, 2)
        x, y; pixel centres are at whole numbers.
    shape : (rows, columns)
    """
    rows, columns = shape
    flips = np.zeros((rows, columns + 1), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        low, high = sorted((y0, y1))
        first, last = max(int(np.ceil(low)), 0), min(int(np.ceil(high)) - 1, rows - 1)
        if last < first:
            continue
        y = np.arange(first, last + 1)
        x = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
        column = np.clip(np.ceil(x), 0, columns).astype(int)
        flips[y, column] ^= True
    return np.logical_xor.accumulate(flips[:, :columns], axis=1)
