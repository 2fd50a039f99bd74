"""The scores, the same for every method.

All are of the cells that are unknown to a method. A cell that a method leaves open counts as the
flat guess in `rms`, `median_error`, `contrast`, `cnr` and `dice`; how many it left open is `found`.
"""

import numpy as np

from .problem import Case, Estimate, Truth

COLUMNS = {
    "rms": "RMS of 2(E−Ê)/(E+Ê)",
    "median_error": "median error",
    "contrast": "contrast",
    "cnr": "CNR",
    "dice": "Dice",
    "coverage": "within 2 std",
    "found": "found",
}


def score(case: Case, truth: Truth, estimate: Estimate) -> dict:
    """Return the scores of one estimate, ready for JSON."""
    unknown = ~case.is_known
    flat = np.nanmean(case.known[:, 0])
    young = np.asarray(estimate.young, float)
    E = np.where(np.isfinite(young), young, flat)
    ratio = 2 * (truth.young - E) / (truth.young + np.maximum(E, 0))
    out = {
        "rms": float(np.sqrt(np.mean(np.clip(ratio, -2, 2)[unknown] ** 2))),
        "median_error": float(np.median(np.abs(E / truth.young - 1)[unknown])),
        "found": float(np.isfinite(young)[unknown].mean()),
        "coverage": _coverage(young, estimate.young_std, truth.young, unknown),
    }
    if case.poisson is None and estimate.poisson is not None:
        error = np.abs(estimate.poisson / truth.poisson - 1)[unknown]
        out["poisson_median_error"] = (
            float(np.nanmedian(error)) if np.isfinite(error).any() else None
        )
    background = truth.regions.get("background")
    regions = [name for name in truth.regions if name != "background"]
    out["regions"] = {
        name: _region(truth.regions[name], background, E, truth.young) for name in regions
    }
    return out


def _coverage(young, std, true, unknown):
    """Share of the cells found whose truth lies within two of the stated standard deviations."""
    if std is None:
        return None
    judged = unknown & np.isfinite(young) & np.isfinite(std)
    return float((np.abs(young - true) <= 2 * std)[judged].mean()) if judged.any() else None


def _region(inside, outside, E, true):
    """Contrast of medians, contrast-to-noise ratio, Dice of what exceeds the middle."""
    contrast = np.median(true[inside]) / np.median(true[outside])
    spread = E[inside].var() + E[outside].var()
    gap = E[inside].mean() - E[outside].mean()
    middle = np.median(true[outside]) * np.sqrt(contrast)
    both = inside | outside
    called = (middle < E if contrast > 1 else middle > E) & both
    return {
        "true_contrast": float(contrast),
        "contrast": float(np.median(E[inside]) / np.median(E[outside])),
        # Varghese and Ophir, IEEE Trans. Ultrason. Ferroelectr. Freq. Control 45, 1998
        "cnr": float(np.sqrt(2 * gap**2 / spread)) if spread > 0 else None,
        "dice": float(2 * (called & inside).sum() / (called.sum() + inside.sum())),
    }
