"""Figures per label: what was found, how it differs from cell to cell, and its standard error.

Two figures that must never be mixed: the *spread* is how much the values of a label's cells differ
from each other; the *standard error* is how far the label's mean may be from the truth, by the
errors of the displacements.
"""

from dataclasses import dataclass

import numpy as np

from ..fem.elastic_constants import young_from_lame
from ..results import VALUES, Status, is_found

LEAST_CORE = 6  # cells, with a value; fewer scatter more than who segments


@dataclass(frozen=True)
class CellErrors:
    """Samples of the errors of all cells, alike in column k: what was wrong together.

    Attributes
    ----------
    Mu, Lambda, YoungModulus, PoissonRatio : (n_cells, m)
    """

    Mu: np.ndarray
    Lambda: np.ndarray
    YoungModulus: np.ndarray
    PoissonRatio: np.ndarray

    def std(self, quantity: str) -> np.ndarray:
        """Return the root mean square over the samples, (n_cells,)."""
        return np.sqrt((getattr(self, quantity) ** 2).mean(axis=1))


def cell_errors(lam, mu, lam_errors, mu_errors) -> CellErrors:
    """Propagate samples of the errors of λ and μ to E and ν, to first order.

    With s = λ + μ: ∂E/∂λ = μ²/s², ∂E/∂μ = (3λ² + 4λμ + 2μ²)/s², ∂ν/∂λ = μ/2s², ∂ν/∂μ = −λ/2s².

    Parameters
    ----------
    lam, mu : (n_cells,)
    lam_errors, mu_errors : (n_cells, m)
    """
    lam, mu = lam[:, None], mu[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        square = (lam + mu) ** 2
        young = (mu**2 * lam_errors + (3 * lam**2 + 4 * lam * mu + 2 * mu**2) * mu_errors) / square
        poisson = (mu * lam_errors - lam * mu_errors) / (2 * square)
    return CellErrors(mu_errors, lam_errors, young, poisson)


def label_statistics(
    labels: np.ndarray,
    sizes: np.ndarray,
    core: np.ndarray,
    status: np.ndarray,
    lam: np.ndarray,
    mu: np.ndarray,
    errors: CellErrors,
    reference: int | None = None,
) -> list[dict]:
    """Return a row of figures for every label.

    Parameters
    ----------
    labels, sizes, status, lam, mu : (n_cells,)
        Sizes are areas or volumes.
    core : (n_cells,) bool
        Whether a cell shares no node with another label, see :func:`core_of`.
    errors : CellErrors
    reference : int, optional
        Label to which the ratios refer. None: the largest one that is not given.

    Returns
    -------
    list of dict
        ``label``; ``given`` (all its cells were known beforehand); ``cells``; ``size`` (area or
        volume of all of them); ``determined`` (share of that size in cells whose μ is known or
        identified, 0 to 1). For each quantity, over the cells that have it: ``mean`` (weighted with
        the cells' sizes), ``median``, ``spread`` (weighted standard deviation between cells),
        ``standard error`` of the mean; ``core``, the mean of the label's core, and ``core standard
        error``: the core of a label that was drawn somewhat too large is still all of it, so that
        it matters less who segments; NaN where fewer than six of its cells are that far inside.
        ``Mu ratio`` of the means to that of the label ``reference``, and its standard error, in
        which errors that both have in common cancel. NaN where nothing was found.
    """
    found = is_found(status)
    values = dict(zip(("YoungModulus", "PoissonRatio"), young_from_lame(lam, mu), strict=True))
    values |= {"Lambda": lam, "Mu": mu}
    reference = _reference(labels, sizes, status) if reference is None else reference
    base = _label_mean(values["Mu"], errors.Mu, np.where(found & (labels == reference), sizes, 0))
    rows = []
    for label in np.unique(labels):
        here = labels == label
        weights = np.where(here & found, sizes, 0.0)
        row = {
            "label": int(label),
            "given": bool((status[here] == Status.KNOWN).all()),
            "cells": int(here.sum()),
            "size": float(sizes[here].sum()),
            "determined": float(weights.sum() / sizes[here].sum()),
        }
        for quantity in VALUES:
            name = quantity.array
            here_found = np.where(here & is_found(status, name), sizes, 0.0)
            row |= _figures(name, values[name], getattr(errors, name), here_found, core)
        row |= _ratio(_label_mean(values["Mu"], errors.Mu, weights), base)
        rows.append(row | {"reference": reference})
    return rows


def core_of(node_cells, labels: np.ndarray) -> np.ndarray:
    """Return which cells (n_cells,) share no node with a cell of another label.

    Parameters
    ----------
    node_cells : (n_nodes, n_cells) sparse
        1 where a node is of a cell.
    labels : (n_cells,)
    """
    names, number = np.unique(labels, return_inverse=True)
    of_label = node_cells @ np.eye(len(names), dtype=bool)[number]
    border = (of_label > 0).sum(axis=1) > 1
    return ~(node_cells.T @ border).astype(bool)


def _reference(labels, sizes, status) -> int:
    """Return the largest label that is not given, of those found if any is."""
    names = np.unique(labels)
    rated = [
        (
            not (status[labels == name] == Status.KNOWN).all(),
            sizes[(labels == name) & is_found(status)].sum(),
        )
        for name in names
    ]
    return int(names[max(range(len(names)), key=rated.__getitem__)])


def _label_mean(values, errors, weights):
    """Return the weighted mean and samples of its error; NaN where no cell has a weight."""
    here = weights > 0
    if not here.any():
        return np.nan, np.full(errors.shape[1], np.nan)
    share = weights[here] / weights[here].sum()
    return float(share @ values[here]), share @ errors[here]


def _figures(name, values, errors, weights, core) -> dict[str, float]:
    mean, error = _label_mean(values, errors, weights)
    core = core & (weights > 0)
    enough = core.sum() >= LEAST_CORE
    inner, inner_error = _label_mean(values, errors, np.where(core & enough, weights, 0.0))
    here = weights > 0
    spread = median = np.nan
    if here.any():
        median = float(np.median(values[here]))
        off = values[here] - median  # so that equal values have no spread at all
        off -= np.average(off, weights=weights[here])
        spread = float(np.sqrt(np.average(off**2, weights=weights[here])))
    return {
        f"{name} mean": mean,
        f"{name} median": median,
        f"{name} spread": spread,
        f"{name} standard error": float(np.sqrt((error**2).mean())),
        f"{name} core": inner,
        f"{name} core standard error": float(np.sqrt((inner_error**2).mean())),
    }


def _ratio(one, base) -> dict[str, float]:
    """Return the ratio of two means; d(a/b) = (da − (a/b) db)/b."""
    (value, error), (base_value, base_error) = one, base
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.float64(value) / base_value
        spread = (error - ratio * base_error) / base_value
    return {"Mu ratio": float(ratio), "Mu ratio standard error": float(np.sqrt((spread**2).mean()))}
