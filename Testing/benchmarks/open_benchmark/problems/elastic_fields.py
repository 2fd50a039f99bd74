"""Fields of E and ν, both unknown in every cell, three loads, little noise: as ElastNet's are."""

import numpy as np
from elastoidentify.fem.forward import box_mesh

from .. import forward
from ..problem import Case, Truth

TITLE = "Fields of E and ν"
SOURCE = (
    "After ElastNet (Chen & Gu), whose data set could not be had: smooth random fields, E "
    "from 0.1 to 1, ν from 0.2 to 0.45, plane stress, three loads, noise 1/1000 of the "
    "displacements' root mean square. Their networks get strains and the mean of E; here a "
    "strip of an eighth is known."
)
LEVELS = ("32×32", "64×64", "256×256")  # cells; the noise is the same
QUICK = None
_LOADS = (0, 0.01), (0.01, 0), (0.007, 0.007)
_STRIP = 0.875


def _field(x, seed, low, high):
    """A sum of eight waves, none shorter than 0.28 of the width, pressed between low and high."""
    rng, total = np.random.default_rng(seed), 0.0 * x[0]
    for _ in range(8):
        k, phase = 2 * np.pi * rng.uniform(-2.5, 2.5, 2), rng.uniform(0, 2 * np.pi)
        total = total + np.cos(k[0] * x[0] + k[1] * x[1] + phase)
    return low * (high / low) ** (0.5 + 0.5 * np.tanh(total / 3))


def young(x):
    return np.where(x[1] > _STRIP, 0.5, _field(x, 1, 0.1, 1.0))


def poisson(x):
    return np.where(x[1] > _STRIP, 0.3, _field(x, 2, 0.2, 0.45))


def make(level):
    n = int(level.split("×")[0])
    points, cells = box_mesh((n, n), (1.0, 1.0), "quad")
    finer = {32: 88, 64: 88, 256: 256}[n]
    u = forward.solve(
        points, (1.0, 1.0), (finer, finer), young, poisson, _LOADS, plane="stress"
    )  # fmt: skip
    centres = points[cells].mean(axis=1).T
    E, nu, strip = young(centres), poisson(centres), centres[1] > _STRIP
    ends = np.isclose(points[:, 1], 0) | np.isclose(points[:, 1], 1)
    case = Case(
        points, "quad", cells, forward.noisy(u, 1e-3), ends, forward.known_where(strip, E, nu),
        plane="stress",
    )  # fmt: skip
    return case, Truth(E, nu)
