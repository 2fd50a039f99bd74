"""What a run warns of reaches the window, the data and the script."""

import warnings

import numpy as np
import pytest
from elastoidentify.filters import LameIdentification, PushingPhantom
from elastoidentify.filters.base import WARNINGS
from elastoidentify.vtk_io import convert


def rows(grid):
    """The warnings in the field data."""
    array = grid.GetFieldData().GetAbstractArray(WARNINGS)
    return [] if array is None else convert.all_texts(array)


def large_push(**settings):
    """An identification of so large a push that small strain is warned of."""
    found = LameIdentification(method="global", **settings)
    found.SetInputData(PushingPhantom(resolution=4, pushes=[(0, -0.03), (0.03, -0.03)])())
    return found


def test_a_warning_is_a_row_of_field_data_and_a_warning_of_python():
    found = large_push()
    with pytest.warns(UserWarning, match="LameIdentification: .*neo-hookean"):
        found.Update()
    told = rows(found.GetOutput())
    assert len(told) >= 1 and all(line.startswith("LameIdentification: ") for line in told)
    assert sum("neo-hookean" in line for line in told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found.Update()  # nothing was run, nothing is told again
    again = LameIdentification(method="global")
    with pytest.warns(UserWarning):
        assert rows(again(found.GetOutput())) == told  # of the new run, not twice


def test_a_run_shows_its_warnings_in_the_window_once(messages):
    with pytest.warns(UserWarning):
        large_push().Update()
    shown = [line for line in messages() if "neo-hookean" in line]
    assert len(shown) == 1 and shown[0].startswith("WARNING: LameIdentification: ")


def test_without_warnings_nothing_is_written():
    phantom = PushingPhantom(resolution=4, pushes=[(0, -0.001), (0.001, -0.001)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grid = LameIdentification(method="global")(phantom.update().output)
    assert rows(grid) == []
    assert np.isfinite(convert.get_array(grid.GetCellData(), "Mu")).all()
