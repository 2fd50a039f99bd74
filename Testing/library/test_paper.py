"""The source paper's numerical example: exact for any push when the kinematics match."""

import numpy as np
import pytest
from elastoidentify.examples import paper


@pytest.fixture(scope="module")
def rows():
    return paper.table2()


def test_the_square_is_numbered_as_in_the_paper():
    square = paper.example()
    assert (len(square.points), len(square.cells)) == (25, 32)
    assert np.flatnonzero(square.labels == paper.UNKNOWN).tolist() == list(range(16))
    around = {node: np.flatnonzero((square.cells == node).any(1)).tolist() for node in (14, 13, 5)}
    assert around[14] == [15, 22, 23]
    assert around[13] == [13, 14, 15, 20, 21, 22]
    assert around[5][0] == 0
    assert np.isclose(square.lam[0], 1.07e4, rtol=5e-3)
    assert np.isclose(square.mu[0], 1.75e3, rtol=5e-3)


@pytest.mark.parametrize("method", ["sequential", "global"])
@pytest.mark.parametrize("row", range(4))
def test_small_strain_data_give_all_32_unknowns_to_1e_8(rows, row, method):
    line = next(
        one for one in rows if (one.row, one.method, one.data) == (row, method, "small-strain")
    )
    assert line.missing == 0
    assert line.error < 1e-8
    assert np.allclose(line.shown, [0.43 * 5e3 / (1.43 * 0.14), 5e3 / 2.86] * 2, rtol=1e-8)


@pytest.mark.parametrize("method", ["sequential", "global"])
@pytest.mark.parametrize(
    ("kinematics", "row"),
    [("neo-hookean", row) for row in range(4)] + [("st-venant-kirchhoff", row) for row in range(3)],
)
def test_finite_strain_data_give_all_32_unknowns_with_matching_kinematics(
    rows, kinematics, row, method
):
    line = next(
        one
        for one in rows
        if (one.data, one.kinematics, one.row, one.method) == (kinematics, kinematics, row, method)
    )
    assert line.missing == 0
    assert line.error < 1e-6


def test_the_largest_push_inverts_a_cell_of_st_venant_kirchhoff_and_this_is_said(rows):
    lines = [one for one in rows if one.data == "st-venant-kirchhoff" and one.row == 3]
    assert lines
    assert all(one.shown is None and "inside out" in one.note for one in lines)


def test_small_strain_identification_of_finite_strain_data_is_never_taken_for_the_truth(rows):
    for one in rows:
        if one.data != one.kinematics and one.shown is not None:
            assert one.missing > 0 or one.error > 0.05


def test_the_table_shows_the_papers_figures_and_ours(rows):
    text = paper.table2_text(rows)
    for figure in ("1.12e+04", "1.89e+03", "2.09e+04", "7.70e+02"):
        assert figure in text
    assert text.count("small → small") == 8
