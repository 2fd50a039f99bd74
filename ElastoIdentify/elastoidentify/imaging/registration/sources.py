"""Displacements that were measured elsewhere, brought to the nodes of a mesh.

Three sources: an image of displacement vectors, an ITK transform file, a table of measured points.
All are in the world of files (LPS), in the length unit of the mesh, rest → pushed.
"""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.ndimage import map_coordinates

from ...errors import InputError
from ...progress import Progress, silent

COLUMNS = ("x", "y", "z", "u", "v", "w")
_CHUNK = 5000  # points between two looks at the progress callback


@dataclass
class MeasuredDisplacement:
    """Displacement at mesh nodes from another source.

    Attributes
    ----------
    displacement : (n, 3)
        World axes, rest → pushed. Where not covered: that of the nearest place that is.
    covered : (n,) bool
        True where the source has data around the node.
    information : (n, 6) or None
        Inverse covariance [xx, yy, zz, xy, yz, xz], 0 where not covered; None when the noise of
        the source is not known.
    notes : list of str
        Sentences for the report.
    """

    displacement: np.ndarray
    covered: np.ndarray
    information: np.ndarray | None = None
    notes: list[str] = field(default_factory=list)


def displacement_from_field(
    path: str | Path, points: np.ndarray, *, noise: float | None = None
) -> MeasuredDisplacement:
    """Read an image of displacement vectors and interpolate it linearly at the nodes.

    Parameters
    ----------
    path : str or Path
        NRRD, MHA, NIfTI…: two components on a 2-D grid or three on a 3-D one (a slice too), along
        the world axes.
    points : (n, 3)
        World positions (LPS).
    noise : float, optional
        Standard deviation of a component of the displacement.

    Raises
    ------
    InputError
        Not such an image, not finite, or it covers less than half of the nodes.
    """
    sitk = _simpleitk()
    try:
        image = sitk.ReadImage(str(path))
    except RuntimeError as error:
        raise InputError(f"cannot read the displacement field {path}: {_reason(error)}") from None
    dimension, components = image.GetDimension(), image.GetNumberOfComponentsPerPixel()
    if components != dimension or dimension not in (2, 3):
        raise InputError(
            f"{path} holds {components} number(s) per voxel of a {dimension}-D image: "
            "a displacement field has one vector component per dimension"
        )
    vectors = sitk.GetArrayFromImage(image).astype(float)
    if not np.isfinite(vectors).all():
        raise InputError(f"the displacement field {path} holds values that are not numbers")
    points = _checked(points)
    axes = np.reshape(image.GetDirection(), (dimension, dimension)) * image.GetSpacing()
    index = (points[:, :dimension] - image.GetOrigin()) @ np.linalg.inv(axes).T
    size = np.array(image.GetSize())
    covered = ((index > -0.501) & (index < size - 0.499)).all(1)
    found = np.zeros_like(points)
    for axis in range(dimension):
        found[:, axis] = map_coordinates(vectors[..., axis], index.T[::-1], order=1, mode="nearest")
    return _result(found, covered, noise, f"the displacement field {path}")


def displacement_from_transform(
    path: str | Path,
    points: np.ndarray,
    *,
    noise: float | None = None,
    progress: Progress | None = None,
) -> MeasuredDisplacement:
    """Read an ITK transform file and evaluate T(x) − x at the nodes.

    The transform maps points of the rest image to points of the pushed image, as registrations
    with the rest image fixed write it. Where a B-spline or a displacement field ends, ITK returns
    the point itself: such nodes count as not covered.

    Parameters and errors as for :func:`displacement_from_field`.
    """
    sitk = _simpleitk()
    try:
        transform = sitk.ReadTransform(str(path))
    except RuntimeError as error:
        raise InputError(f"cannot read the transform {path}: {_reason(error)}") from None
    points, progress = _checked(points), progress or silent
    dimension = transform.GetDimension()
    found = np.zeros_like(points)
    for start in range(0, len(points), _CHUNK):
        progress(start / len(points), "evaluating the transform")
        here = points[start : start + _CHUNK, :dimension]
        there = [transform.TransformPoint(point) for point in here.tolist()]
        found[start : start + _CHUNK, :dimension] = np.array(there) - here
    limited = not transform.IsLinear()
    covered = (found != 0).any(1) if limited else np.ones(len(points), bool)
    return _result(found, covered, noise, f"the transform {path}")


def displacement_from_points(
    table: str | Path | np.ndarray, points: np.ndarray, *, noise: float | None = None
) -> MeasuredDisplacement:
    """Interpolate measured points linearly (Delaunay triangulation) at the nodes.

    Parameters
    ----------
    table : str, Path or (p, 6) array
        CSV file with the columns x, y, z, u, v, w in its first line (any order, others ignored), or
        the array of those: positions at rest and displacements.
    points : (n, 3)
        World positions.
    noise : float, optional
        Standard deviation of a component of the measured displacements.

    Raises
    ------
    InputError
        The table cannot be used, or it covers less than half of the nodes.
    """
    name = "the table" if isinstance(table, np.ndarray) else f"the table {table}"
    rows = table if isinstance(table, np.ndarray) else read_point_table(table)
    rows = np.asarray(rows, float)
    if rows.ndim != 2 or rows.shape[1] != 6:
        raise InputError(f"{name} must have six columns {', '.join(COLUMNS)}, not {rows.shape}")
    bad = ~np.isfinite(rows).all(1)
    if bad.any():
        raise InputError(
            f"{name} has values that are not numbers in {np.count_nonzero(bad)} of {len(rows)} "
            f"points, the first is point {np.argmax(bad) + 1}: leave those points out"
        )
    points = _checked(points)
    centre = rows[:, :3].mean(0)
    sizes, frame = np.linalg.svd(rows[:, :3] - centre, full_matrices=True)[1:]
    rank = int(np.sum(sizes > 1e-6 * sizes[0])) if len(rows) else 0
    if rank < 2 or len(rows) < 3:
        raise InputError(f"{name} has points on one line only: at least a plane of them is needed")
    there, here = ((where - centre) @ frame[:rank].T for where in (rows[:, :3], points))
    found = LinearNDInterpolator(there, rows[:, 3:])(here)
    covered = np.isfinite(found).all(1)
    found[~covered] = NearestNDInterpolator(there, rows[:, 3:])(here[~covered])
    return _result(found, covered, noise, name)


def read_point_table(path: str | Path) -> np.ndarray:
    """Read the columns x, y, z, u, v, w of a CSV file. Returns (p, 6)."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as stream:
            lines = [line for line in csv.reader(stream) if any(cell.strip() for cell in line)]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the table {path}: {error}") from None
    header = [cell.strip().lower() for cell in lines[0]] if lines else []
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise InputError(
            f"the first line of {path} lacks the column(s) {', '.join(missing)}: name the columns "
            "x,y,z,u,v,w (position at rest, displacement)"
        )
    chosen = [header.index(name) for name in COLUMNS]
    rows = np.empty((len(lines) - 1, 6))
    for number, line in enumerate(lines[1:]):
        try:
            rows[number] = [float(line[column]) for column in chosen]
        except (ValueError, IndexError):
            raise InputError(
                f"row {number + 2} of {path} is not numbers in every column: {','.join(line)!r}"
            ) from None
    return rows


def _checked(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"mesh points must be finite world positions (n, 3), not {points.shape}")
    return points


def _result(found, covered, noise, name) -> MeasuredDisplacement:
    """Put a result together; refuse one that covers less than half of the nodes."""
    share = covered.mean() if len(covered) else 0.0
    if share < 0.5:
        raise InputError(
            f"{name} covers only {100 * share:.0f} % of the mesh nodes: both must be in one world "
            "(LPS, same length unit), and the source must reach over the mesh"
        )
    notes = []
    if share < 1:
        weight = "has no weight" if noise else "counts in full: give the noise to take that away"
        notes.append(
            f"{np.count_nonzero(~covered)} of {len(covered)} mesh nodes lie where {name} has no "
            f"data; their displacement is that of the nearest place and {weight}."
        )
    information = None
    if noise is not None:
        if not noise > 0:
            raise InputError(f"the noise of {name} must be a positive length, not {noise}")
        information = np.zeros((len(covered), 6))
        information[covered, :3] = 1.0 / noise**2
    return MeasuredDisplacement(found, covered, information, notes)


def _reason(error: RuntimeError) -> str:
    """The telling line of a SimpleITK error."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else "unknown format"


def _simpleitk():
    try:
        import SimpleITK
    except ImportError:
        raise InputError(
            "reading displacement fields and transforms needs SimpleITK, install it with: "
            'pip install "elastoidentify[registration]"'
        ) from None
    return SimpleITK
