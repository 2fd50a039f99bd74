"""Does the body go on beyond its labels? Told from the rest image beside the mesh's free border.

Around a body there is air, water or gel: darker, or without texture. Where the image goes on beyond
a border as it does inside, tissue was cut there, or something touches it, and pushes: balance of
forces asked of such nodes bends the map.
"""

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..image import Image
from .quality import border_sides

WINDOW = 5  # voxels, of which brightness and texture are taken
AWAY = 4.0  # voxels from the border, so that the window holds one side of it
TEXTURE = 0.5  # times the median inside
LEVELS = 0.1, 0.9  # quantiles of the brightness inside, the range of which is widened by half
SHARE = 0.1  # of the free border from which it is said
FEWEST = 3  # sides of cells


def surroundings_notes(
    points: np.ndarray, cells: np.ndarray, reaction: np.ndarray, image: Image
) -> list[str]:
    """Say where the image goes on beyond the free border of a mesh.

    Parameters
    ----------
    points : (n, 3)
        World coordinates.
    cells : (m, 3) or (m, 4) int
    reaction : (n,)
        0 where the border is taken to be free.
    image : Image
        At rest.
    """
    if min((n for n in image.size if n > 1), default=0) < 3 * WINDOW:
        return []
    sides, outward, size = _border(points, cells)
    free = (reaction[sides] == 0).any(axis=1)
    if not free.any():
        return []
    far, border = AWAY * image.pixel_sides.max(), cKDTree(points[np.unique(sides)])
    image = _around(image, points, far)
    centres, outward, size = points[sides].mean(axis=1)[free], outward[free], size[free]
    level, texture = _maps(image)
    inside = _sampled(level, texture, image, points[cells].mean(axis=1))
    inside = inside[np.isfinite(inside).all(axis=1)]
    places = centres + far * outward
    beyond = _sampled(level, texture, image, places)
    # in a cleft the other side of it is near
    seen = np.isfinite(beyond).all(axis=1) & (border.query(places)[0] > 0.9 * far)
    if min(len(inside), seen.sum()) < FEWEST:
        return []
    low, high = np.quantile(inside[:, 0], LEVELS)
    as_inside = seen & (np.abs(beyond[:, 0] - (low + high) / 2) < high - low)
    as_inside &= beyond[:, 1] > TEXTURE * np.median(inside[:, 1])
    share = size[as_inside].sum() / size[seen].sum()
    if share < SHARE or as_inside.sum() < FEWEST:
        return []
    place = np.average(centres[as_inside], axis=0, weights=size[as_inside])
    return [
        f"Beyond {100 * share:.0f} % of the border that is taken to be free the image goes on as "
        f"it does inside, around ({', '.join(f'{x:.3g}' for x in place)}): where tissue is cut "
        "off, or something touches it, it may be pushed, and a reaction box is needed."
    ]


def _border(points, cells):
    """Sides of cells on the mesh's border, the direction out of the mesh there, and their size."""
    sides, against = border_sides(cells)
    along = np.swapaxes(points[sides[:, 1:]] - points[sides[:, :1]], 1, 2)
    q, r = np.linalg.qr(along)
    away = points[sides[:, 0]] - points[against]
    away = away - np.einsum("nij,nkj,nk->ni", q, q, away)
    size = np.abs(np.diagonal(r, axis1=1, axis2=2).prod(axis=1))
    return sides, away / np.linalg.norm(away, axis=1, keepdims=True), size


def _around(image, points, far):
    """The part of the image that reaches `far` and a window beyond points (n, 3)."""
    index = image.world_to_index(points)
    margin = far / image.spacing + WINDOW
    low = np.maximum(np.floor(index.min(axis=0) - margin), 0).astype(int)
    high = np.minimum(np.ceil(index.max(axis=0) + margin), np.array(image.size) - 1).astype(int)
    if (low > high).any():
        return image  # they are apart, which is said elsewhere
    part = tuple(slice(a, b + 1) for a, b in zip(low[::-1], high[::-1], strict=True))
    origin = image.index_to_world(low[None])[0]
    return Image(image.array[part], origin, image.spacing, image.direction)


def _maps(image):
    """Mean and standard deviation of the grey values around every voxel."""
    grey = image.array.astype(np.float32)
    window = [min(WINDOW, n) for n in grey.shape]
    level = ndimage.uniform_filter(grey, window)
    middle = level.mean()  # squares about it keep their digits
    square = ndimage.uniform_filter((grey - middle) ** 2, window)
    return level, np.sqrt(np.maximum(square - (level - middle) ** 2, 0.0))


def _sampled(level, texture, image, places):
    """Both maps at world places (n, 3), (n, 2); NaN beyond the image."""
    index = image.world_to_index(places)
    if image.planar_axis is not None:
        index[:, image.planar_axis] = 0.0
    edge = (WINDOW - 1) / 2
    thin = np.array(image.size) == 1
    there = ((index >= edge) & (index <= np.array(image.size) - 1 - edge)) | thin
    found = [
        ndimage.map_coordinates(one, index.T[::-1], order=0, mode="nearest")
        for one in (level, texture)
    ]
    return np.where(there.all(axis=1)[:, None], np.stack(found, axis=1), np.nan)
