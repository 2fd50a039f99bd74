"""Conforming tetrahedra from a lattice that is pulled onto the borders between labels.

The smallest block that holds all labels is filled with a body-centred cubic lattice, whose
tetrahedra have dihedral angles of 45° to 90°. Where labels have flat borders across an axis, it has
flat layers. Each tetrahedron takes the label that is strongest at its centre; nodes between
tetrahedra of different labels are then moved onto the smoothed border between these labels, as far
as the cells around stay good. (The idea is that of Labelle and Shewchuk, Isosurface stuffing, ACM
Transactions on Graphics 26, 2007, and of its multi-label kin; here nodes are moved, but cells never
cut.)
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import ndimage, sparse

from ...progress import Progress, part, silent
from .grading import at, wanted_edges
from .lattice import body_centred_lattice
from .quality import dihedral_angles, tetrahedron_volumes

CELL_SIZE = 1.1  # side of a lattice cell over the edge length: makes the mean edge right
SMOOTHING = 0.15  # standard deviation of the smoothed labels over the edge length
LARGEST_MOVE = 0.45  # of the cell size, for a node on a border
GOOD_ANGLES = (12.0, 160.0)  # degrees; dihedral angles that moved nodes must leave
FLAT_BORDER = 0.4  # share of the cross-section over which labels change at a flat border
NEAR_PLANES = 0.24  # of the edge length; flat borders nearer than this are not told apart
SWEEPS = 6
REPAIRS = 100
STEP_BACK = 0.05  # of the way to the lattice
CORRECTIONS = 8  # rounds in which border nodes are moved for the right volumes
GOOD_VOLUME = 0.005  # relative error at which the rounds end
LARGEST_OFFSET = 0.45  # of a smoothed label; beyond, it hardly changes with the place


def mesh_tetrahedra(
    labels: np.ndarray,
    spacing: np.ndarray,
    edge_length: float,
    progress: Progress = silent,
    grading: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (n, 3), tetrahedra (m, 4) of positive volume and their labels (m,).

    Parameters
    ----------
    labels : ndarray of int, shape (nk, nj, ni)
        0 is background and is not meshed.
    spacing : ndarray, shape (3,)
        Voxel size along i, j, k.
    edge_length : float
        In the unit of `spacing`.
    grading : float
        How many times longer edges may be away from borders; what counts is the power of two below.

    Points are in scaled indices: voxel [k, j, i] has its centre at (i, j, k) · spacing.
    """
    progress(0.0, "Smooth labels")
    block = ndimage.find_objects((labels > 0).astype(np.int8))[0]
    labels = labels[block]
    fields = label_fields(labels, spacing, edge_length)
    progress(0.3, "Lattice")
    planes = flat_borders(labels, spacing, edge_length)
    levels = int(np.log2(grading))
    room = wanted_edges(labels, spacing, edge_length, grading) if levels else None
    points, cells = body_centred_lattice(
        planes, CELL_SIZE * edge_length, lambda places: at(room, spacing, places), levels
    )
    lattice = labelled(points, cells, fields, planes)
    points = lattice.points
    for sweep in range(SWEEPS):
        progress(0.4 + 0.4 * sweep / SWEEPS, "Nodes onto borders")
        points = onto_borders(even_out(points, lattice), lattice)
        points = stay_near(points, lattice, LARGEST_MOVE * CELL_SIZE * edge_length)
    names = lattice.names
    voxels = np.bincount(np.searchsorted(names, labels.ravel()))
    aim = np.where(names > 0, voxels * spacing.prod(), np.nan)
    area = border_areas(labels, spacing, names)
    points = with_volumes(points, lattice, aim, area, part(progress, 0.8, 1.0))
    meshed = lattice.meshed
    used, cells = np.unique(lattice.cells[meshed], return_inverse=True)
    start = np.array([extent.start for extent in block[::-1]]) * spacing
    return points[used] + start, cells.reshape(-1, 4), names[lattice.kind[meshed]]


@dataclass
class Lattice:
    """Tetrahedra before their nodes are moved, and what keeps each node where it is.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
    cells : ndarray of int, shape (m, 4)
    edges : ndarray of int, shape (e, 2)
    fields : list of l LabelField
    kind : ndarray of int, shape (m,)
        Which of the fields each cell belongs to.
    touches : ndarray of bool, shape (n, l)
        Whether a node has a cell of each field around it.
    held : ndarray of bool, shape (n, 3)
        Whether x, y, z of a node must stay.
    """

    points: np.ndarray
    cells: np.ndarray
    edges: np.ndarray
    fields: list["LabelField"]
    kind: np.ndarray
    touches: np.ndarray
    held: np.ndarray

    @property
    def names(self) -> np.ndarray:
        """The label of each field (l,)."""
        return np.array([field.label for field in self.fields])

    @property
    def meshed(self) -> np.ndarray:
        """Whether each cell is more than background (m,)."""
        return self.names[self.kind] > 0


def labelled(
    points: np.ndarray, cells: np.ndarray, fields: list["LabelField"], planes: list[np.ndarray]
) -> Lattice:
    """Return the lattice with the strongest label for each cell."""
    strength = np.stack([field(points[cells].mean(axis=1)) for field in fields])
    kind = strength.argmax(axis=0)
    touches = np.zeros((len(points), len(fields)), bool)
    touches[cells, kind[:, None]] = True
    held = (points == points.min(axis=0)) | (points == points.max(axis=0))
    lattice = Lattice(points, cells, unique_edges(cells), fields, kind, touches, held)
    lattice.held |= on_flat_borders(lattice, planes)
    return lattice


def with_volumes(
    points: np.ndarray, lattice: Lattice, aim: np.ndarray, area: np.ndarray, progress: Progress
) -> np.ndarray:
    """Return the points, those on borders moved so that labels have their volumes, cells good.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
    lattice : Lattice
    aim : ndarray, shape (l,)
        Volume of each label, NaN where any will do.
    area : ndarray, shape (l,)
        About the area of the border of each label.
    """
    steepness = lattice.fields[0].steepness
    offset, best, kept = np.zeros(len(aim)), np.inf, points
    for correction in range(CORRECTIONS):
        progress(correction / CORRECTIONS, "Volumes and angles")
        moved = repair(bulge(onto_borders(points, lattice, offset), lattice), lattice)
        volume = np.bincount(lattice.kind, tetrahedron_volumes(moved, lattice.cells), len(aim))
        missing = aim - volume
        error = np.nanmax(np.abs(missing) / aim)
        if error < best:
            best, kept = error, moved
        if error < GOOD_VOLUME:
            break
        shift = np.nan_to_num(missing / np.maximum(area, 1e-300))
        offset = np.clip(offset + shift * steepness, -LARGEST_OFFSET, LARGEST_OFFSET)
    return kept


def border_areas(labels: np.ndarray, spacing: np.ndarray, names: np.ndarray) -> np.ndarray:
    """Return the area (l,) of the voxel faces between each of the labels `names` and others."""
    area = np.zeros(len(names))
    for axis in range(3):
        swapped = np.moveaxis(labels, 2 - axis, 0)
        differs = swapped[1:] != swapped[:-1]
        touched = np.r_[swapped[1:][differs], swapped[:-1][differs]]
        faces = np.bincount(np.searchsorted(names, touched), minlength=len(names))
        area += faces * spacing.prod() / spacing[axis]
    return area


@dataclass
class LabelField:
    """How much of a label there is around a place: its smoothed indicator, from 0 to 1.

    Attributes
    ----------
    label : int
    values : ndarray, shape (k, j, i)
        On the part of the image where the label is near.
    start : ndarray, shape (3,)
        Index (i, j, k) of its first voxel.
    last : ndarray, shape (3,)
        Last index (i, j, k) of the labelled block; beyond, the border value holds.
    spacing : ndarray, shape (3,)
    smoothing : ndarray, shape (3,)
        Standard deviation of the smoothing along i, j, k, a length.
    """

    label: int
    values: np.ndarray
    start: np.ndarray
    last: np.ndarray
    spacing: np.ndarray
    smoothing: np.ndarray

    @property
    def steepness(self) -> float:
        """Difference of two labels' fields per length, on a flat border between them."""
        return float(2 / (np.sqrt(2 * np.pi) * self.smoothing.prod() ** (1 / 3)))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the values (n,) at points (n, 3) in scaled indices."""
        index = np.clip(points / self.spacing, 0, self.last) - self.start
        return ndimage.map_coordinates(self.values, index.T[::-1], order=1, mode="constant")

    def gradient(self, points: np.ndarray) -> np.ndarray:
        """Return the gradients (n, 3) at points (n, 3)."""
        steps = np.diag(self.spacing / 2)
        return np.stack([self(points + d) - self(points - d) for d in steps], axis=1) / self.spacing


def label_fields(labels: np.ndarray, spacing: np.ndarray, edge_length: float) -> list[LabelField]:
    """Return the smoothed indicator of every label, background included."""
    sigma = np.maximum(0.7, SMOOTHING * edge_length / spacing)
    margin = np.ceil(4 * sigma).astype(int)[::-1]
    last = np.array(labels.shape[::-1]) - 1
    names, numbers = np.unique(labels, return_inverse=True)
    fields = []
    for label, found in zip(
        names, ndimage.find_objects(numbers.reshape(labels.shape) + 1), strict=True
    ):
        box = tuple(
            slice(max(0, s.start - m), s.stop + m) for s, m in zip(found, margin, strict=True)
        )
        values = ndimage.gaussian_filter(
            (labels[box] == label).astype(np.float32), sigma[::-1], mode="nearest"
        )
        start = np.array([s.start for s in box])[::-1]
        fields.append(LabelField(int(label), values, start, last, spacing, sigma * spacing))
    return fields


def flat_borders(labels: np.ndarray, spacing: np.ndarray, edge_length: float) -> list[np.ndarray]:
    """Return where flat borders cross each axis, in scaled indices, in rising order.

    First and last are the ends of the array. In between come planes where the label changes over
    much of the cross-section (a pad on tissue, the side of a block on a wider floor), unless they
    are very near to a stronger one.
    """
    planes = []
    for axis in range(3):
        slices = np.moveaxis(labels, 2 - axis, 0)
        changes = (slices[1:] != slices[:-1]).mean(axis=(1, 2))
        found = [0, len(slices)]
        for k in np.argsort(-changes, kind="stable").tolist():
            if changes[k] < FLAT_BORDER:
                break
            if np.abs(np.array(found) - (k + 1)).min() * spacing[axis] > NEAR_PLANES * edge_length:
                found.append(k + 1)
        planes.append((np.sort(found) - 0.5) * spacing[axis])
    return planes


def on_flat_borders(lattice: Lattice, planes: list[np.ndarray]) -> np.ndarray:
    """Return which coordinates (n, 3) are those of a plane on which the node's border lies.

    There the border is known better than from the smoothed labels, which round edges and corners
    by up to the length of the smoothing.
    """
    shift = np.abs(onto_borders(lattice.points, lattice) - lattice.points)
    flat = np.stack([np.isin(lattice.points[:, k], planes[k]) for k in range(3)], axis=1)
    several = lattice.touches.sum(axis=1) > 1
    return flat & several[:, None] & (shift < lattice.fields[0].smoothing)


def unique_edges(cells: np.ndarray) -> np.ndarray:
    """Return the edges (e, 2), each once."""
    edges = np.sort(np.vstack([cells[:, pair] for pair in combinations(range(4), 2)]), axis=1)
    n = int(edges.max()) + 1
    keys = np.unique(edges[:, 0] * n + edges[:, 1])
    return np.c_[keys // n, keys % n]


def even_out(points: np.ndarray, lattice: Lattice) -> np.ndarray:
    """Return the nodes moved halfway to the mean of their neighbours.

    A node takes part only in what it lies on: one on a border looks at neighbours that touch the
    same labels, and one on a face of the block at neighbours on that face.
    """
    mean, count = mean_of_alike(points, lattice)
    enough = (count >= 2)[:, None] & ~lattice.held
    return np.where(enough, (points + mean) / 2, points)


def mean_of_alike(points: np.ndarray, lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of the neighbours (n, 3) that lie on all a node lies on; how many (n,)."""
    touches, held = lattice.touches, lattice.held
    first, second = np.vstack([lattice.edges, lattice.edges[:, ::-1]]).T
    alike = ~(touches[first] & ~touches[second]).any(axis=1)
    alike &= ~(held[first] & ~held[second]).any(axis=1)
    first, second = first[alike], second[alike]
    total = sparse.csr_matrix((np.ones(len(first)), (first, second)), shape=(len(points),) * 2)
    count = np.bincount(first, minlength=len(points))
    return total @ points / np.maximum(count, 1)[:, None], count


def bulge(points: np.ndarray, lattice: Lattice) -> np.ndarray:
    """Return the nodes on curved borders moved outward, so that flat cells hold their volume.

    Equilateral triangles of edge e with their corners on a sphere of radius R lie e²/(8R) below it
    in the mean, and the neighbours of a node e²/(2R) below the node: a quarter of the latter.
    """
    mean, count = mean_of_alike(points, lattice)
    curved = (lattice.touches.sum(axis=1) == 2) & (count >= 4)
    return np.where(curved[:, None] & ~lattice.held, points + (points - mean) / 4, points)


def onto_borders(
    points: np.ndarray, lattice: Lattice, offset: np.ndarray | float = 0.0, steps: int = 2
) -> np.ndarray:
    """Return the nodes that touch several labels moved to where these are equally strong.

    Newton's method on f_i(x) + offset_i = the same for all labels i of the node, with the shortest
    step: to a surface for two labels, to a line for three.
    """
    fields = lattice.fields
    offset = np.broadcast_to(offset, len(fields))
    longest = fields[0].spacing.max()
    nodes = np.flatnonzero(lattice.touches.sum(axis=1) > 1)
    points = points.copy()
    mine, free = lattice.touches[nodes], ~lattice.held[nodes]
    for _ in range(steps):
        value = np.zeros(mine.shape)
        slope = np.zeros((*mine.shape, 3))
        for k, field in enumerate(fields):
            here = mine[:, k]
            value[here, k] = field(points[nodes[here]]) + offset[k]
            slope[here, k] = field.gradient(points[nodes[here]])
        share = mine / mine.sum(axis=1, keepdims=True)
        value -= mine * (share * value).sum(axis=1, keepdims=True)
        slope -= mine[:, :, None] * np.einsum("nl,nld->nd", share, slope)[:, None]
        slope *= free[:, None]
        # The pseudo-inverse through the 3×3 normal matrix; weak directions are left alone.
        normal = np.einsum("nld,nle->nde", slope, slope)
        inverse = np.linalg.pinv(normal, rcond=0.05, hermitian=True)
        step = -np.einsum("nde,nle,nl->nd", inverse, slope, value)
        length = np.linalg.norm(step, axis=1, keepdims=True)
        points[nodes] += step * np.minimum(1, longest / np.maximum(length, 1e-12))
    return points


def stay_near(points: np.ndarray, lattice: Lattice, most: float) -> np.ndarray:
    """Return the points, those on borders no farther than `most` from where they began."""
    move = points - lattice.points
    length = np.linalg.norm(move, axis=1)
    factor = np.where(lattice.touches.sum(axis=1) > 1, most / np.maximum(length, most), 1.0)
    return lattice.points + move * factor[:, None]


def repair(points: np.ndarray, lattice: Lattice) -> np.ndarray:
    """Return the points with the nodes of poor cells moved back towards the lattice."""
    points, cells = points.copy(), lattice.cells[lattice.meshed]
    poor = np.arange(len(cells))
    for _ in range(REPAIRS):
        angles = dihedral_angles(points, cells[poor])
        bad = (angles.min(axis=1) < GOOD_ANGLES[0]) | (angles.max(axis=1) > GOOD_ANGLES[1])
        bad |= tetrahedron_volumes(points, cells[poor]) <= 0
        if not bad.any():
            break
        nodes = np.unique(cells[poor[bad]])
        points[nodes] += STEP_BACK * (lattice.points[nodes] - points[nodes])
        near = np.zeros(len(points), bool)
        near[nodes] = True
        poor = np.flatnonzero(near[cells].any(axis=1))
    return points
