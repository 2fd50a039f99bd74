"""Forward data of bodies in space that break one assumption each, as :mod:`broken` in the plane.

A pad that slides on a block with a hidden ball (:mod:`slipping`, quadratic hexahedra), told that it
sticks or that it slides, and the pushed cube with a ball (:mod:`cube`, quadratic bricks that do not
lock), told its Poisson's ratio or another one.
"""

from dataclasses import dataclass
from functools import cache

import cube
import numpy as np
import slipping
from elastoidentify.fem.forward import box_mesh

PAD = 2  # label; 1 is all the rest


@dataclass
class Volume:
    """What identifies; lengths in units of the body's height."""

    points: np.ndarray
    cells: list  # of one kind, as identify takes them
    displacements: np.ndarray  # exact, (t, n, 3)
    labels: np.ndarray
    pad: tuple[float, float]  # E and ν that are given of it
    poisson: float  # that is given of the rest
    young: np.ndarray  # true E per cell
    offending: np.ndarray  # (m,) bool: where the model error lives
    slip: tuple = ()

    @property
    def reaction(self):
        height = self.points[:, 2]
        return (height < 1e-9) | (height > height.max() - 1e-9)

    def noisy(self, share, seed=0):
        """Displacements with noise of a share of the body's height, and the noise itself."""
        std = share * self.points[:, 2].max()
        noise = np.random.default_rng(seed).standard_normal(self.displacements.shape)
        return self.displacements + std * noise, std


def block(told_to_slip: bool, n: int = 6) -> Volume:
    """Return n³ hexahedra, the top of which slide on the rest."""
    made = _slipping(n)
    points, u, cells, slip = made.points, made.displacements, made.cells, ((1, PAD),)
    pad = made.labels == slipping.PAD_LABEL
    centres = points[cells].mean(axis=1)
    at_pad = np.abs(centres[:, 2] - centres[pad, 2].min()) < 1.01 * slipping.SIDE / n
    if not told_to_slip:
        points, u, cells, slip = *_glued(points, u, cells), ()
    young = np.where(made.inside, slipping.CONTRAST, 1.0) * slipping.E_TISSUE
    return Volume(
        points, [("hexahedron", cells)], u, np.where(pad, PAD, 1),
        (slipping.E_PAD, slipping.POISSON), slipping.POISSON,
        np.where(pad, slipping.E_PAD, young), at_pad & (not told_to_slip), slip,
    )  # fmt: skip


@cache
def _slipping(n):
    return slipping.block(n)


def _glued(points, u, cells):
    """One node where two bodies have one each; it moves as both of them on average."""
    points, one = np.unique(np.round(points, 9), axis=0, return_inverse=True)
    one = one.ravel()
    count = np.bincount(one)
    means = [[np.bincount(one, x) / count for x in trial.T] for trial in u]
    return points, np.array(means).transpose(0, 2, 1), one[cells]


def pushed_cube(poisson: float, told: float, n: int = 6, fine: int = 8) -> Volume:
    """Return 6 n³ tetrahedra of the cube with a ball; `fine`³ bricks make the displacements."""
    points, cells = box_mesh((n, n, n), (1.0, 1.0, 1.0), "tetra")
    u = cube.truth(fine, poisson, "ball").at(points)[:3]
    centres = points[cells].mean(axis=1)
    pad = centres[:, 2] > cube.PAD
    return Volume(
        points, [("tetra", cells)], u, np.where(pad, PAD, 1), (1.0, poisson), told,
        np.where(cube.inside(centres, "ball"), cube.CONTRAST, 1.0), ~pad & (told != poisson),
    )  # fmt: skip
