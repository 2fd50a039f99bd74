"""Angles, areas and volumes of cells: how good a mesh is."""

from itertools import combinations

import numpy as np


def triangle_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the signed areas (m,) of plane triangles; positive is counter-clockwise.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
    triangles : ndarray of int, shape (m, 3)
    """
    a, b, c = points[triangles].transpose(1, 2, 0)
    return 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def triangle_angles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the angle at each corner in degrees, shape (m, 3); points (n, 2) or (n, 3)."""
    corners = points[triangles]
    angles = np.empty(triangles.shape)
    for k in range(3):
        u = corners[:, (k + 1) % 3] - corners[:, k]
        v = corners[:, (k + 2) % 3] - corners[:, k]
        lengths = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
        cosine = np.einsum("md,md->m", u, v) / np.maximum(lengths, 1e-300)
        angles[:, k] = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return angles


def tetrahedron_volumes(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the signed volumes (m,); positive when node 3 sees 0, 1, 2 clockwise (VTK's order)."""
    u, v, w = _edges(points, tetrahedra)
    return (_cross(u, v) * w).sum(axis=0) / 6


def cell_sizes(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the areas or volumes (m,) of triangles or tetrahedra with points (n, 3)."""
    if cells.shape[1] == 4:
        return np.abs(tetrahedron_volumes(points, cells))
    a, b, c = (points[cells[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def dihedral_angles(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the angles between the faces of each tetrahedron in degrees, shape (m, 6)."""
    u, v, w = _edges(points, tetrahedra)
    normals = [_cross(v, w), _cross(w, u), _cross(u, v)]  # of the faces opposite to nodes 1, 2, 3
    normals.insert(0, -sum(normals))
    for normal in normals:
        normal /= np.maximum(np.sqrt((normal**2).sum(axis=0)), 1e-300)
    cosines = np.stack([-(m * n).sum(axis=0) for m, n in combinations(normals, 2)])
    return np.degrees(np.arccos(np.clip(cosines, -1, 1))).T


def _edges(points: np.ndarray, tetrahedra: np.ndarray) -> list[np.ndarray]:
    """Return the edges from node 0 of each tetrahedron to the others, three arrays (3, m)."""
    columns = np.ascontiguousarray(points.T)
    start = columns[:, tetrahedra[:, 0]]
    return [columns[:, tetrahedra[:, k]] - start for k in (1, 2, 3)]


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return u × v of arrays (3, m)."""
    return np.stack(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )


def border_sides(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sides that one cell alone has, (s, k − 1), and that cell's other corner, (s,)."""
    corners = np.sort(cells, axis=1)
    sides = np.concatenate([np.delete(corners, k, axis=1) for k in range(corners.shape[1])])
    sides, first, count = np.unique(sides, axis=0, return_index=True, return_counts=True)
    return sides[count == 1], corners.T.ravel()[first[count == 1]]
