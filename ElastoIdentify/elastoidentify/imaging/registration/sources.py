"""Displacements that were measured elsewhere, brought to the nodes of a mesh.

Three sources: an image of displacement vectors, an ITK transform file, a table of measured points.
All are in the world of files (LPS), in the length unit of the mesh, rest → pushed.
"""

import csv
import re
import struct
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.ndimage import map_coordinates

from ...errors import InputError
from ...progress import Progress, silent
from ...workers.elastix_client import CLEAN_PATH, candidate_interpreters, worker_environment
from ..io.damage import heard
from ..io.itk import Voxels, read_voxels, simpleitk
from ..io.writing import last_line

COLUMNS = ("x", "y", "z", "u", "v", "w")
SMALL_PUSH = 1e-4  # of the size of the mesh
MODELLING = "displacement field type"  # key that 3D Slicer writes into a NRRD header
LONGEST_TRIAL = 45.0  # seconds for reading an HDF5 file; in a damaged one the library may not end
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
    path = Path(path)
    voxels = read_voxels(path)
    vectors = _vectors(voxels, path)
    points = _checked(points)
    axes = voxels.direction * voxels.spacing
    index = (points - voxels.origin) @ np.linalg.inv(axes).T
    size = np.array(vectors.shape[2::-1])
    if voxels.planar:  # a grid of two dimensions serves every z
        index[:, 2] = 0
    covered = ((index > -0.501) & (index < size - 0.499)).all(1)
    found = np.zeros_like(points)
    for axis in range(vectors.shape[-1]):
        found[:, axis] = map_coordinates(vectors[..., axis], index.T[::-1], order=1, mode="nearest")
    return _result(found, covered, noise, f"the displacement field {path}", points)


def _vectors(voxels: Voxels, path: Path) -> np.ndarray:
    """Return the vectors of a field (nk, nj, ni, 2 or 3), or refuse what is none."""
    array = voxels.array
    components = array.shape[3] if array.ndim == 4 else 1
    flat = 1 in array.shape[:3]
    if components == 1 or components not in ((2, 3) if flat else (3,)):
        dimension = 2 if voxels.planar else 3
        raise InputError(
            f"{path} holds {components} number(s) per voxel of a {dimension}-D image: "
            "a displacement field has one vector component per dimension"
        )
    if np.iscomplexobj(array):
        raise InputError(f"{path}: complex values; a displacement field has plain numbers")
    kind = voxels.fields.get(MODELLING, "").lower()
    if kind.startswith("model"):
        raise InputError(
            f"{path}: 3D Slicer has marked this field as a modelling transform, which leads from "
            "the pushed image to the rest image; invert the transform there and save it again"
        )
    if not np.isfinite(array).all():
        raise InputError(f"the displacement field {path} holds values that are not numbers")
    return array.astype(float)


def displacement_from_transform(
    path: str | Path,
    points: np.ndarray,
    *,
    noise: float | None = None,
    progress: Progress | None = None,
) -> MeasuredDisplacement:
    """Read an ITK transform file and evaluate T(x) − x at the nodes.

    The transform maps points of the rest image to points of the pushed image, as registrations
    with the rest image fixed write it. Where the grid of a B-spline or of a displacement field
    ends, in a composite too, nodes count as not covered; their displacement is that of the nearest
    place on the grid.

    Parameters and errors as for :func:`displacement_from_field`.
    """
    transform = _read_transform(Path(path))
    points, progress = _checked(points), progress or silent
    dimension = transform.GetDimension()
    if dimension not in (2, 3):
        raise InputError(f"{path}: a transform of {dimension} dimensions; 2 or 3 are needed")
    found, covered = np.zeros_like(points), np.ones(len(points), bool)
    with heard():
        parts = [(part, _grid(part, path)) for part in _parts(transform)]
    for start in range(0, len(points), _CHUNK):
        progress(start / len(points), "evaluating the transform")
        here = points[start : start + _CHUNK, :dimension]
        there, inside = _mapped(parts, here)
        found[start : start + _CHUNK, :dimension] = there - here
        covered[start : start + _CHUNK] = inside
    if not np.isfinite(found).all():
        raise InputError(f"{path}: the transform gives values that are not numbers; it is damaged")
    return _result(found, covered, noise, f"the transform {path}", points)


def _read_transform(path: Path):
    sitk = simpleitk()
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read the transform {path}: {error.strerror}") from None
    if re.search(rb"^\s*\(Transform ", content[:4096], re.M):
        raise InputError(
            f"{path}: parameters of elastix, no ITK transform; have transformix write the "
            "deformation field (-def all) and give that as a field"
        )
    if content.startswith(b"#Insight Transform"):
        _check_transform_text(path, content)
    elif content.startswith(b"\x89HDF"):
        _try_elsewhere(path)
    elif path.suffix.lower() == ".mat":
        _check_matlab(path, content)
    try:
        with heard():
            return sitk.ReadTransform(str(path))
    except (RuntimeError, UnicodeError, MemoryError) as error:
        if re.search(r"Inverse\w*Transform", str(error)):
            raise InputError(
                f"{path}: 3D Slicer has saved this transform as the inverse of one (a modelling "
                "transform, pushed to rest); invert it there and save it again, or convert it to a "
                "grid transform"
            ) from None
        raise InputError(f"cannot read the transform {path}: {last_line(error)}") from None


_TRIAL = """
import SimpleITK as sitk
t = sitk.ReadTransform(sys.argv[1])
t.TransformPoint((0.0,) * t.GetDimension())
print("read", flush=True)
"""


def _try_elsewhere(path: Path) -> None:
    """Read an HDF5 file in another process first: a damaged one can end the process that reads it.

    Where no other Python with SimpleITK is found, as in some hosts, the file is trusted.
    """
    python = next(iter(candidate_interpreters()), None)
    if python is None:
        return
    try:
        done = subprocess.run(
            [python, "-c", CLEAN_PATH + _TRIAL, str(path.resolve())],
            env=worker_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=LONGEST_TRIAL,
        )
    except (OSError, subprocess.TimeoutExpired):
        raise _damaged(path) from None
    if done.returncode < 0 or done.returncode > 128 or b"infinite loop" in done.stderr:
        raise _damaged(path)


def _check_matlab(path: Path, content: bytes) -> None:
    """Refuse a MATLAB file (level 4) whose matrices are not as long as their headers say.

    Source of the layout: MAT-File Format, The MathWorks, "Level 4 MAT-File Format".
    """
    at, size = 0, {0: 8, 10: 4}  # of double and single values, little-endian
    while at < len(content):
        if len(content) - at < 20:
            raise _damaged(path)
        kind, rows, columns, imaginary, length = struct.unpack_from("<5i", content, at)
        plain = kind in size and imaginary == 0 and min(rows, columns, length - 1) >= 0
        at += 20 + length + (rows * columns * size[kind] if plain else 0)
        if not plain or at > len(content) or columns != 1:
            raise _damaged(path)


def _check_transform_text(path: Path, content: bytes) -> None:
    """Refuse a text file whose numbers are not as many as its grids need; ITK does not look."""
    parts = re.split(rb"^#Transform.*$", content, flags=re.M)[1:]
    for part in parts:
        lines = dict(
            re.findall(rb"^(Transform|Parameters|FixedParameters):[ \t]*(.*)$", part, re.M)
        )
        name = lines.get(b"Transform", b"")
        gridded = re.match(rb"(DisplacementField|BSpline)\w*?_(?:double|float)_(\d)", name)
        if not gridded:
            continue
        try:
            numbers, fixed = (
                np.array(lines[key].split(), float) for key in (b"Parameters", b"FixedParameters")
            )
        except (KeyError, ValueError):
            raise _damaged(path) from None
        _check_counts(path, len(numbers), fixed, int(gridded.group(2)))


def _check_counts(path, count: int, fixed: np.ndarray, dimension: int) -> None:
    """Refuse a grid whose parameters are not as many as its places times the dimension."""
    if len(fixed) != 3 * dimension + dimension**2 or not np.isfinite(fixed).all():
        raise _damaged(path)
    turn = fixed[3 * dimension :].reshape(dimension, dimension)
    spacing = fixed[2 * dimension : 3 * dimension]
    if count != np.prod(fixed[:dimension]) * dimension or (spacing <= 0).any():
        raise _damaged(path)
    if abs(np.linalg.det(turn)) < 1e-6:
        raise _damaged(path)


def _damaged(path) -> InputError:
    return InputError(
        f"{path}: the transform is damaged or incomplete (its numbers do not fit its grid); save "
        "it again"
    )


def _mapped(parts, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return T(points) (n, d), and whether every part (transform, grid) has data there (n,).

    A part with a grid is evaluated at the nearest place of the grid, and its displacement there is
    taken: ITK itself gives no displacement beyond a grid.
    """
    there, inside = points, np.ones(len(points), bool)
    for part, grid in parts:
        at = there
        if grid is not None:
            origin, axes, low, high = grid
            index = (there - origin) @ np.linalg.inv(axes).T
            slack = 1e-3
            inside &= ((index >= low - slack) & (index <= high + slack)).all(axis=1)
            edge = 1e-9 * np.maximum(np.abs(high), 1)  # the last place itself is outside for ITK
            at = np.clip(index, low + edge, high - edge) @ axes.T + origin
        moved = np.array([part.TransformPoint(point) for point in at.tolist()]).reshape(at.shape)
        there = there + (moved - at) if grid is not None else moved
    return there, inside


def _parts(transform) -> list:
    """Return the transforms that make up one, in the order in which points go through them."""
    transform = transform.Downcast()
    if transform.GetName() != "CompositeTransform":
        return [transform]
    numbers = reversed(range(transform.GetNumberOfTransforms()))
    return [part for n in numbers for part in _parts(transform.GetNthTransform(n))]


def _grid(transform, path):
    """Return where a transform has data: origin, axes, lowest and highest index; None: everywhere.

    Of a displacement field the outer edges of its voxels, of a B-spline its domain.
    """
    dimension, name = transform.GetDimension(), transform.GetName()
    if name == "DisplacementFieldTransform":
        fixed = np.array(transform.GetFixedParameters())
        _check_counts(path, transform.GetNumberOfParameters(), fixed, dimension)
        size, origin, spacing = fixed[: 3 * dimension].reshape(3, dimension)
        axes = fixed[3 * dimension :].reshape(dimension, dimension) * spacing
        return origin, axes, np.full(dimension, -0.5), size - 0.5
    if name.startswith("BSplineTransform"):
        origin = np.array(transform.GetTransformDomainOrigin())
        turn = np.reshape(transform.GetTransformDomainDirection(), (dimension, dimension))
        lengths = np.array(transform.GetTransformDomainPhysicalDimensions())
        if not np.isfinite([*origin, *lengths]).all() or min(lengths) <= 0:
            raise _damaged(path)
        if abs(np.linalg.det(turn)) < 1e-6:
            raise _damaged(path)
        return origin, turn * lengths, np.zeros(dimension), np.ones(dimension)
    return None


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
    if np.ma.isMaskedArray(rows) and np.ma.getmaskarray(rows).any():
        raise InputError(f"{name} has masked values: leave those points out")
    if np.iscomplexobj(rows):
        raise InputError(f"{name} has complex numbers: give real ones")
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
    rank = 0
    if len(rows) >= 3:
        centre = rows[:, :3].mean(0)
        sizes, frame = np.linalg.svd(rows[:, :3] - centre, full_matrices=True)[1:]
        rank = int(np.sum(sizes > 1e-6 * sizes[0]))
    if rank < 2:
        raise InputError(f"{name} has points on one line only: at least a plane of them is needed")
    there, here = ((where - centre) @ frame[:rank].T for where in (rows[:, :3], points))
    found = LinearNDInterpolator(there, rows[:, 3:])(here)
    covered = np.isfinite(found).all(1)
    found[~covered] = NearestNDInterpolator(there, rows[:, 3:])(here[~covered])
    return _result(found, covered, noise, name, points)


def read_point_table(path: str | Path) -> np.ndarray:
    """Read the columns x, y, z, u, v, w of a CSV file. Returns (p, 6).

    Columns are separated by commas, semicolons or tabs; with the latter two, numbers may have a
    decimal comma. UTF-8, or UTF-16 with its mark.
    """
    try:
        lines, separator = _cells(Path(path))
    except (OSError, UnicodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot read the table {path}: {reason}") from None
    header = [cell.strip().lower() for cell in lines[0]] if lines else []
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise InputError(
            f"the first line of {path} lacks the column(s) {', '.join(missing)}: name the columns "
            "x,y,z,u,v,w (position at rest, displacement), separated by commas"
        )
    twice = [name for name in COLUMNS if header.count(name) > 1]
    if twice:
        raise InputError(f"the first line of {path} names the column {twice[0]} twice")
    chosen = [header.index(name) for name in COLUMNS]
    rows = np.empty((len(lines) - 1, 6))
    for number, line in enumerate(lines[1:]):
        while len(line) > len(header) and not line[-1].strip():
            line = line[:-1]
        if len(line) > len(header):
            raise InputError(
                f"row {number + 2} of {path} has {len(line)} cells under {len(header)} columns: "
                "are there decimal commas between commas? Write numbers with points, or separate "
                "columns with semicolons"
            )
        try:
            rows[number] = [_number(line[column], separator) for column in chosen]
        except (ValueError, IndexError):
            raise InputError(
                f"row {number + 2} of {path} is not numbers in every column: "
                f"{separator.join(line)[:80]!r}"
            ) from None
    return rows


def _cells(path: Path) -> tuple[list[list[str]], str]:
    """Return the cells of a table, row by row, and what separates them."""
    raw = path.read_bytes()
    coded = raw.startswith((b"\xff\xfe", b"\xfe\xff"))
    text = raw.decode("utf-16" if coded else "utf-8-sig")
    first = next((line for line in text.splitlines() if line.strip()), "")
    separator = max((",", ";", "\t"), key=first.count)
    rows = csv.reader(text.splitlines(), delimiter=separator)
    return [line for line in rows if any(cell.strip() for cell in line)], separator


def _number(cell: str, separator: str) -> float:
    cell = cell.strip()
    if "_" in cell:  # which Python allows in numbers
        raise ValueError(cell)
    if separator != "," and "," in cell and "." not in cell:
        cell = cell.replace(",", ".", 1)
    return float(cell)


def _checked(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"mesh points must be finite world positions (n, 3), not {points.shape}")
    return points


def _result(found, covered, noise, name, points) -> MeasuredDisplacement:
    """Put a result together; refuse one that covers less than half of the nodes."""
    share = covered.mean() if len(covered) else 0.0
    if share < 0.5:
        raise InputError(
            f"{name} covers only {100 * share:.0f} % of the mesh nodes: both must be in one world "
            "(LPS, same length unit), and the source must reach over the mesh"
        )
    notes = _size_notes(found[covered], points, name)
    if share < 1:
        weight = "has no weight" if noise else "counts in full: give the noise to take that away"
        notes.append(
            f"{np.count_nonzero(~covered)} of {len(covered)} mesh nodes lie where {name} has no "
            f"data; their displacement is that of the nearest place and {weight}."
        )
    information = None
    if noise is not None:
        if not (np.isfinite(noise) and noise > 1e-150):  # its square is to be a number
            raise InputError(f"the noise of {name} must be a positive length, not {noise}")
        information = np.zeros((len(covered), 6))
        information[covered, :3] = 1.0 / noise**2
    return MeasuredDisplacement(found, covered, information, notes)


def _size_notes(found: np.ndarray, points: np.ndarray, name: str) -> list[str]:
    """Compare displacements with the size of the mesh: another unit of length shows there.

    Raises
    ------
    InputError
        They differ by more than the size of the mesh.
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    spread = float(np.abs(found - found.mean(axis=0)).max(initial=0.0))
    if spread > size > 0:
        raise InputError(
            f"{name} has displacements that differ by {spread:.3g} on a mesh of size {size:.3g}: "
            "bring both to one unit of length (mm and m?), or give displacements, not positions"
        )
    if not found.any():
        return [f"{name[0].upper()}{name[1:]} is zero at every node."]
    if 0 < spread < SMALL_PUSH * size:
        return [
            f"{name[0].upper()}{name[1:]} has displacements that differ by {spread:.2g} only on a "
            f"mesh of size {size:.3g}: are both in one unit of length?"
        ]
    return []
