"""Body-centred cubic lattices of tetrahedra, with larger cells where larger ones will do.

A lattice of cubes, each with a node at its centre: between the centres of two neighbouring cubes
and an edge of the face that they share lies a tetrahedron. Where cubes may be larger, eight become
one, as in an octree, and neighbours (across a face, an edge or a corner) differ by a factor of two
at most. What is split then follows from the nodes that are there: an edge with a node of smaller
cubes in its middle halves its tetrahedra, and between a cube and the four smaller ones beyond a
face each quarter of the face is cut in two from the middle of the face. All are shapes of Labelle
and Shewchuk (Isosurface stuffing, ACM Transactions on Graphics 26, 2007), with dihedral angles of
45° to 120°.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from .quality import tetrahedron_volumes

BITS = 20  # of a place along one axis, in a key
CORNER, CENTRE, FACE = 0, 1, 2  # kinds of nodes; FACE + axis: in the middle of a face on a plane


@dataclass
class Cubes:
    """Cubes that fill a block, all on one grid of the smallest.

    Attributes
    ----------
    ticks : list of three ndarray
        Where the planes between the smallest cubes lie.
    flat : list of three ndarray of int
        Which of the ticks are planes that tetrahedra do not cross; first and last are among them.
    level : ndarray of int, shape (nx, ny, nz)
        Of the cube in which each of the smallest lies: 2^level as long as the smallest.
    """

    ticks: list[np.ndarray]
    flat: list[np.ndarray]
    level: np.ndarray

    @property
    def shape(self) -> np.ndarray:
        return np.array(self.level.shape)

    @cached_property
    def within_slab(self) -> tuple[np.ndarray, np.ndarray]:
        """Place and count (3, nx, ny, nz) of the smallest cubes between their planes."""
        places, counts = [], []
        for flat in self.flat:
            counts.append(np.repeat(np.diff(flat), np.diff(flat)))
            places.append(np.arange(flat[-1]) - np.repeat(flat[:-1], np.diff(flat)))
        return tuple(np.stack(np.meshgrid(*one, indexing="ij")) for one in (places, counts))

    def firsts(self, axis: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return the place (n, 3) and level (n,) of each cube, in layers along an axis."""
        first = (self.within_slab[0] % 2**self.level == 0).all(axis=0)
        place = np.argwhere(first)
        place = place[np.argsort(place[:, axis], kind="stable")]
        return place, self.level[tuple(place.T)]

    def points(self, doubled: np.ndarray) -> np.ndarray:
        """Return the points (n, 3) at places (n, 3) in halves of the smallest cubes."""
        ticks = zip(self.ticks, doubled.T, strict=True)
        return np.stack([np.interp(d / 2, np.arange(len(t)), t) for t, d in ticks], axis=1)


def body_centred_lattice(
    planes: list[np.ndarray], size: float, room=None, levels: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Fill a block with a body-centred lattice that has flat layers at the given planes.

    On the planes (first and last: the faces of the block) the centre of a face stands for the
    centre of the cube beyond. On those within the block lie the smallest cubes.

    Parameters
    ----------
    planes : list of three ndarray
        Coordinates along x, y and z, at least two each.
    size : float
        Side of the smallest cubes, met as nearly as the planes allow.
    room : callable, optional
        Takes points (n, 3) and returns how many times `size` cubes around may be long. Default: 1.
    levels : int
        The largest cubes are 2^levels as long as the smallest.

    Returns
    -------
    points : ndarray, shape (n, 3)
    cells : ndarray of int, shape (m, 4)
        All of positive volume.
    """
    ticks, flat = map(list, zip(*(divided(axis, size) for axis in planes), strict=True))
    cubes = Cubes(ticks, flat, np.zeros([len(t) - 1 for t in ticks], int))
    if levels:
        middles = grid_points([(t[1:] + t[:-1]) / 2 for t in ticks])
        grow(cubes, room(middles).reshape(cubes.level.shape), levels)
    nodes = np.vstack([*between_alike(cubes), *between_unlike(cubes)])
    kept, cells = np.unique(_keys(nodes), return_inverse=True)
    points = cubes.points(_places(kept))
    cells = cells.reshape(-1, 4)
    turned = tetrahedron_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    return points, cells


def divided(planes: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the gaps between planes cut into equal parts of about `size`, and where planes are."""
    parts = np.maximum(1, np.rint(np.diff(planes) / size)).astype(int)
    flat = np.r_[0, np.cumsum(parts)]
    return np.interp(np.arange(flat[-1] + 1), flat, planes), flat


def grid_points(axes: list) -> np.ndarray:
    """Return the points (n, 3) of the grid with the given coordinates along each axis."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def grow(cubes: Cubes, room: np.ndarray, levels: int) -> None:
    """Make one cube of eight wherever there is room, and all around are half as long at least."""
    place, count = cubes.within_slab
    index, shape = np.indices(cubes.level.shape), cubes.shape[:, None, None, None]
    for level in range(1, levels + 1):
        side = 2**level
        block = {"size": side, "origin": -(side // 2)}  # of this cube and those after it
        around = {"size": side + 2, "origin": -(side // 2)}
        fits = (place > 0) | (index == 0)
        fits &= (place + side < count) | (index + side == shape)
        starts = (fits & (place % side == 0)).all(axis=0)
        starts &= ndimage.minimum_filter(room, **block) >= side
        starts &= ndimage.minimum_filter(cubes.level, **around, mode="nearest") >= level - 1
        first = np.argwhere(starts).T
        for offset in np.ndindex(side, side, side):
            cubes.level[tuple(first + np.array(offset)[:, None])] = level


def between_alike(cubes: Cubes) -> list[np.ndarray]:
    """Return the tetrahedra (m, 4, 4) about faces with cubes of one size, or a plane, behind.

    Nodes are (kind, place) with places in halves of the smallest cubes.
    """
    found, middles = [], _middles(cubes)
    for axis in range(3):
        ahead = np.eye(3, dtype=int)[axis]
        place, level = cubes.firsts(axis)
        side = 2**level
        on_plane = np.isin(place[:, axis] + side, cubes.flat[axis])
        beyond = np.minimum(place + side[:, None] * ahead, cubes.shape - 1)
        alike = ~on_plane & (cubes.level[tuple(beyond.T)] == level)
        start = np.isin(place[:, axis], cubes.flat[axis])
        for here, way in ((alike, 1), (on_plane, 1), (start, -1)):
            centre = 2 * place[here] + side[here, None]
            face = centre + way * side[here, None] * ahead
            one = _nodes(CENTRE, centre)
            other = _nodes(FACE + axis, face)
            if here is alike:
                other = _nodes(CENTRE, centre + 2 * side[here, None] * ahead)
            found += _about_face(one, other, face, side[here], axis, middles)
    return found


def _about_face(one, other, face, side, axis, middles) -> list[np.ndarray]:
    """Join two nodes with each edge of the face between them, or with its halves."""
    found, corners = [], _corners(face, side, axis)
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        middle = (a + b) // 2
        halved = np.isin(_flat(middle), middles) & (side > 1)
        a, middle, b = (_nodes(CORNER, end) for end in (a, middle, b))
        for these, first, second in ((~halved, a, b), (halved, a, middle), (halved, middle, b)):
            found.append(np.stack([n[these] for n in (one, other, first, second)], axis=1))
    return found


def between_unlike(cubes: Cubes) -> list[np.ndarray]:
    """Return the tetrahedra (m, 4, 4) about faces with one larger cube behind."""
    found = []
    within = cubes.within_slab[0]
    for axis in range(3):
        ahead = np.eye(3, dtype=int)[axis]
        place, level = cubes.firsts(axis)
        for way in (1, -1):
            side = 2**level
            beyond = place + (side[:, None] if way == 1 else -1) * ahead
            inside = ((beyond >= 0) & (beyond < cubes.shape)).all(axis=1)
            larger = inside.copy()
            larger[inside] = cubes.level[tuple(beyond[inside].T)] > level[inside]
            beyond, side = beyond[larger], side[larger]
            start = beyond - within[(slice(None), *beyond.T)].T % (2 * side[:, None])
            small = 2 * place[larger] + side[:, None]
            large = 2 * start + 2 * side[:, None]
            face = small + way * side[:, None] * ahead
            middle = large - way * 2 * side[:, None] * ahead  # of the larger cube's face
            corner = 2 * face - middle
            for other in (k for k in range(3) if k != axis):
                halfway = middle.copy()
                halfway[:, other] = corner[:, other]
                triangle = [_nodes(CORNER, node) for node in (middle, corner, halfway)]
                for centre in (small, large):
                    found.append(np.stack([_nodes(CENTRE, centre), *triangle], axis=1))
    return found


def _corners(face, side, axis) -> list[np.ndarray]:
    """Return the four corners of faces, around, in halves of the smallest cubes."""
    one, other = (np.eye(3, dtype=int)[k] for k in range(3) if k != axis)
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return [face + side[:, None] * (a * one + b * other) for a, b in signs]


def _middles(cubes: Cubes) -> np.ndarray:
    """Return where edges of larger cubes may be halved: the corners of all but the largest."""
    if not cubes.level.any():
        return np.empty(0, int)
    place, level = cubes.firsts()
    small = level < cubes.level.max()
    offsets = 2 * np.array(list(np.ndindex(2, 2, 2)))
    side = 2 ** level[small]
    return np.unique(_flat((2 * place[small])[:, None] + side[:, None, None] * offsets))


def _nodes(kind: int, place: np.ndarray) -> np.ndarray:
    return np.insert(place, 0, kind, axis=1)


def _flat(place: np.ndarray) -> np.ndarray:
    return (place[..., 0] << 2 * BITS) | (place[..., 1] << BITS) | place[..., 2]


def _keys(nodes: np.ndarray) -> np.ndarray:
    return (nodes[..., 0] << 3 * BITS) | _flat(nodes[..., 1:])


def _places(keys: np.ndarray) -> np.ndarray:
    return np.stack([keys >> 2 * BITS, keys >> BITS, keys], axis=1) & (1 << BITS) - 1
