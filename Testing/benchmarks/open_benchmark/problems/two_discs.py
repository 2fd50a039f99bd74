"""Two discs of different size and stiffness at three signal-to-noise ratios."""

import numpy as np
from elastoidentify.fem.forward import square_mesh

from .. import forward
from ..problem import Case, Truth

TITLE = "Two discs, 25, 30 and 35 dB"
SOURCE = (
    "After the static problem of weak neural variational inference (arXiv 2407.20697; MIT): "
    "unit square, 32×32 squares of triangles, ν = 0.45 known, discs of 1.6 at (0.7, 0.7), "
    "radius 0.2, and 1.1 at (0.35, 0.35), radius 0.15, taken as logarithms of E over the "
    "background's, noise 10^(−dB/20) of the root mean square. Theirs knows the load's stress "
    "at the top; here a strip above 0.95 is known, and the top is pushed straight and "
    "obliquely."
)
LEVELS = ("25 dB", "30 dB", "35 dB")
QUICK = None
_NU, _STRIP = 0.45, 0.95
_DISCS = {"disc 4.95:1": ((0.7, 0.7), 0.2, 1.6), "disc 3.0:1": ((0.35, 0.35), 0.15, 1.1)}


def _inside(x, centre, radius):
    return np.hypot(x[0] - centre[0], x[1] - centre[1]) < radius


def young(x):
    log = sum(value * _inside(x, *disc) for *disc, value in _DISCS.values())
    return np.exp(log) + 0 * x[0]


def make(level):
    points, cells = square_mesh(32, 32, 1.0, 1.0)
    u = forward.solve(
        points, (1.0, 1.0), (90, 90), young, lambda x: _NU + 0 * x[0],
        ((0, -0.01), (0.007, -0.007)),
    )  # fmt: skip
    x = points[cells].mean(axis=1).T
    strip, E = x[1] > _STRIP, young(x)
    ends = np.isclose(points[:, 1], 0) | np.isclose(points[:, 1], 1)
    noise = 10 ** (-float(level.split()[0]) / 20)
    case = Case(
        points, "triangle", cells, forward.noisy(u, noise), ends,
        forward.known_where(strip, 1.0, _NU), _NU,
    )  # fmt: skip
    regions = {name: _inside(x, *disc) & ~strip for name, (*disc, _) in _DISCS.items()}
    regions["background"] = ~strip & ~sum(regions.values()).astype(bool)
    return case, Truth(E, np.full(len(cells), _NU), regions)
