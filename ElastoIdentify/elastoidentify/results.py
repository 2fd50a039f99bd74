"""The vocabulary of results: what is found, how it is called, and what a cell's status means.

Every host and every report takes names, symbols, units and codes from here.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "xz")
"""Order of the components of a symmetric matrix on the wire."""

_I, _J = np.array([["xyz".index(axis) for axis in name] for name in COMPONENTS]).T


def to_matrices(rows: np.ndarray) -> np.ndarray:
    """Return symmetric matrices (…, 3, 3) of rows (…, 6) in the order of :data:`COMPONENTS`."""
    rows = np.asarray(rows)
    full = np.empty((*rows.shape[:-1], 3, 3), rows.dtype)
    full[..., _I, _J] = full[..., _J, _I] = rows
    return full


def to_components(matrices: np.ndarray) -> np.ndarray:
    """Return rows (…, 6) of symmetric matrices (…, 3, 3); the inverse of :func:`to_matrices`."""
    return np.asarray(matrices)[..., _I, _J]


class Status(IntEnum):
    """What is known of a cell."""

    NOT_DETERMINED = 0
    KNOWN = 1
    IDENTIFIED = 2
    OUT_OF_RANGE = 3
    SHEAR_ONLY = 4  # μ is determined, λ is not, nor what follows from both: E and ν

    @property
    def words(self) -> str:
        """For people: ``not determined``."""
        return self.name.lower().replace("_", " ")


FOUND = (Status.KNOWN, Status.IDENTIFIED)
"""The status of cells whose values can all be read."""


def is_found(status: np.ndarray, array: str = "Mu") -> np.ndarray:
    """Tell which cells have a value of a quantity, μ unless it is said, that can be read."""
    shear = array in ("Mu", "MuStd")
    return np.isin(status, (*FOUND, Status.SHEAR_ONLY) if shear else FOUND)


@dataclass(frozen=True)
class Quantity:
    """A result, cell by cell.

    Parameters
    ----------
    array : str
        Name of the cell array on the wire.
    field : str
        Attribute of :class:`~elastoidentify.IdentificationResult`.
    symbol, words : str
        For people.
    is_modulus : bool
        Has the unit of the known Young's modulus; otherwise it is a pure number.
    error_of : str
        Array whose standard deviation this one is; empty for values.
    """

    array: str
    field: str
    symbol: str
    words: str
    is_modulus: bool = True
    error_of: str = ""

    def title(self, unit: str) -> str:
        """Return symbol and unit for a legend: ``μ (kPa)``."""
        return f"{self.symbol} ({unit})" if self.is_modulus and unit else self.symbol


VALUES = (
    Quantity("Mu", "mu", "μ", "shear modulus"),
    Quantity("Lambda", "lam", "λ", "first Lamé constant"),
    Quantity("YoungModulus", "young", "E", "Young's modulus"),
    Quantity("PoissonRatio", "poisson", "ν", "Poisson's ratio", is_modulus=False),
)
ERRORS = tuple(
    Quantity(
        f"{one.array}Std",
        f"{one.field}_std",
        f"std of {one.symbol}",
        f"standard deviation of the {one.words}",
        one.is_modulus,
        one.array,
    )
    for one in VALUES
)
CHECKS = (
    Quantity(
        "ModelMisfit",
        "model_misfit",
        "model misfit",
        "share of the local misfit that noise does not explain",
        is_modulus=False,
    ),
)
"""How well the model fits, 0 (as well as noise lets it) to 1; NaN where nothing tells."""

QUANTITIES = {one.array: one for one in (*VALUES, *ERRORS, *CHECKS)}
"""Name of the cell array → quantity, values first."""

ASSUMPTIONS = (
    "poisson", "lambda_mu", "slip", "stuck", "stretch", "plane_stress", "plane_strain",
    "neo_hookean",
)  # fmt: skip
"""What may be tried in place of what was given, see :mod:`elastoidentify.exploration`."""


def mu_if(assumption: str) -> str:
    """Return the cell array of μ under an assumption that was tried: ``MuIfSlip``."""
    return "MuIf" + "".join(word.capitalize() for word in assumption.split("_"))


MU_IFS = {
    mu_if(one): Quantity(mu_if(one), "mu", f"μ if {one.replace('_', ' ')}", "shear modulus")
    for one in ASSUMPTIONS
}
"""Name of the cell array → quantity, of μ under what was tried."""
