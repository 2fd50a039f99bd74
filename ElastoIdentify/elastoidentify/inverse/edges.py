"""Cells at an edge of a map: on which side of it do they lie?

A map of cells can put an edge between cells only. Where the mesh does not follow a lesion, the
lesion's outline runs through cells, and a cell at the edge found may have the material of either
side: its error is half of the jump, whatever the displacements say. Where cells of two labels meet
the segmentation says where the edge is.
"""

import numpy as np

from .statistics import CellErrors, cell_errors


def with_edges(errors: CellErrors, lam, mu, pairs: np.ndarray | None) -> CellErrors:
    """Add to samples of errors that a cell at an edge may lie on its other side.

    Parameters
    ----------
    errors : CellErrors
        m samples.
    lam, mu : (n_cells,)
    pairs : (k, 2) int or None
        Cells on either side of the edges.

    Returns
    -------
    CellErrors
        2 m samples: the covariance is the sum of both.
    """
    if pairs is None or not len(pairs):
        return errors
    far = _farthest(mu, pairs)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], errors.Mu.shape)
    halves = (signs * (one[far] - one)[:, None] / 2 for one in (lam, mu))
    sides = cell_errors(lam, mu, *halves)
    names = ("Mu", "Lambda", "YoungModulus", "PoissonRatio")
    both = {n: np.sqrt(2) * np.hstack([getattr(errors, n), getattr(sides, n)]) for n in names}
    return CellErrors(**both)


def _farthest(values, pairs):
    """Of each cell the neighbour across an edge that differs most, or the cell itself."""
    here, there = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.argsort(np.abs(values[there] - values[here]), kind="stable")
    farthest = np.arange(len(values))
    farthest[here[order]] = there[order]  # of a cell that comes several times the last one stays
    return farthest
