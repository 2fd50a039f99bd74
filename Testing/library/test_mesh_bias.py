"""The shift of a map by the cells' own error, against the shift found with true data."""

import elastoidentify as ei
import forward
import numpy as np
import pytest


def _by_label(case, element, refine=1):
    labels = np.where(case.known, 1, np.where(case.young > 1, 3, 2))
    u = case.noisy(1e-4 * np.abs(case.displacements).max(), 0)
    return labels, ei.identify(
        case.points, case.cells, u, case.materials, reaction_nodes=case.reaction, labels=labels,
        grouping="label", method="regularized", unknowns="young", poisson_ratio=case.poisson,
        element=element, refine=refine,
    )  # fmt: skip


def test_the_shift_by_locking_is_in_the_standard_deviation_and_said():
    case = forward.squares(12, poisson=0.495, radius=0.25)
    labels, result = _by_label(case, "linear")
    young = result.young[labels == 3][0]
    std = (result.mu_std / result.mu)[labels == 3][0]
    print(f"inclusion {young:.2f} for 3, stated ± {std:.0%}; {result.report['warnings']}")
    assert young > 3.5  # it locks
    assert 0.4 < std / np.log(young / 3) < 2
    (said,) = [text for text in result.report["warnings"] if "the mesh itself shifts" in text]
    assert "locking-free" in said


def test_cells_without_locking_are_near_enough_and_nothing_is_said():
    case = forward.squares(12, poisson=0.495, radius=0.25)
    labels, result = _by_label(case, "locking-free", refine=4)
    young = result.young[labels == 3][0]
    print(f"inclusion {young:.3f} for 3")
    assert young == pytest.approx(3, rel=0.05)
    assert result.report["mesh_shift"] < 0.03
    assert not any("the mesh itself" in text for text in result.report["warnings"])


def test_noise_beyond_the_given_one_is_kept_in_the_report():
    case = forward.squares(8)
    std = 0.01 * np.abs(case.displacements).max()
    result = ei.identify(
        case.points, case.cells, case.noisy(std, 0), case.materials, method="regularized",
        reaction_nodes=case.reaction, unknowns="young", poisson_ratio=0.43, noise=std / 3,
    )  # fmt: skip
    assert result.report["noise_scale"] == std / 3
    assert result.report["noise_found"] > 2 * std / 3
