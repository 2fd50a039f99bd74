"""The push of a phantom by this package's own elements, for hosts that have no scikit-fem.

Less independent than :func:`~elastoidentify.imaging.phantom.push.solve_pushes`: the elements are
those that identification could use too, on a finer and regular grid.
"""

import numpy as np

from ...fem.elastic_constants import lame_from_young
from ...fem.forward import box_mesh, solve_push
from ...progress import Progress, silent
from .push import AIR_STIFFNESS, Deformation, Moduli


def solve_pushes_on_quads(
    width: float,
    height: float,
    margin: float,
    moduli: Moduli,
    pushes: np.ndarray,
    *,
    elements: int = 120,
    kinematics: str = "small-strain",
    progress: Progress | None = None,
) -> list[Deformation]:
    """Push a block that stands on a floor, in plane strain, on linear quadrilaterals.

    Arguments and result as in :func:`~elastoidentify.imaging.phantom.push.solve_pushes`. The air
    beside the block is a material a million times softer than the softest tissue, which follows
    the block.
    """
    progress = progress or silent
    size = width / elements
    beside = int(np.ceil(margin / size)) + 2
    columns, rows = elements + 2 * beside, max(round(height / size), 4)
    points, cells = box_mesh((columns, rows), (columns * size, height), "quad")
    points[:, 0] -= beside * size

    centres = points[cells].mean(axis=1)
    young, poisson = (np.array(values, float) for values in moduli(*centres.T))
    air = (centres[:, 0] < 0) | (centres[:, 0] > width)
    young[air], poisson[air] = AIR_STIFFNESS * young.min(), 0.0
    lam, mu = lame_from_young(young, poisson)
    on_indenter, on_floor = (np.isclose(points[:, 1], edge) for edge in (0.0, height))
    moved = np.flatnonzero(on_indenter | on_floor)

    deformations = []
    for trial, push in enumerate(np.asarray(pushes, float)):
        progress(trial / len(pushes), f"pushing trial {trial + 1}")
        given = on_indenter[moved, None] * push
        u = solve_push(points, [("quad", cells)], lam, mu, moved, given, kinematics=kinematics)
        grid = u.reshape(rows + 1, columns + 1, 2).transpose(2, 0, 1)
        step = (size, height / rows)
        deformations.append(Deformation.of_grid((points[0, 0], 0.0), step, grid))
    return deformations
