"""Conforming tetrahedra from a lattice that is pulled onto the borders between labels."""

import numpy as np

from ...errors import InputError
from ...progress import Progress, silent


def mesh_tetrahedra(
    labels: np.ndarray, spacing: np.ndarray, edge_length: float, progress: Progress = silent
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (n, 3), tetrahedra (m, 4) and their labels (m,)."""
    raise InputError("volumes cannot be meshed yet: give one slice")
