"""Filters in a VTK pipeline: they run when they must, fail as they should, and go when deleted."""

import gc
import weakref

import numpy as np
import pytest
from elastoidentify import Cancelled, InputError
from elastoidentify.filters import Filter, LameIdentification, PushingPhantom
from elastoidentify.filters.base import Port
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import (
    vtkImageData,
    vtkMultiBlockDataSet,
    vtkUnstructuredGrid,
)
from vtkmodules.vtkCommonExecutionModel import vtkAlgorithm
from vtkmodules.vtkFiltersCore import vtkThreshold


class Counter(Filter):
    """Passes a mesh through, counts its runs, and does what a test asks for on the way."""

    ports = (Port("mesh", "vtkUnstructuredGrid"),)

    def __init__(self, work=lambda mesh, progress: None):
        super().__init__()
        self._work, self._runs = work, 0

    def execute(self, mesh, progress):
        self._runs += 1
        self._work(mesh, progress)
        return mesh


def mesh_of(filter):
    filter.Update()
    return filter.GetOutput()


def refuse(mesh, progress):
    raise InputError("this mesh is not good: take another")


def test_filters_chain_by_connection_and_run_only_when_something_changed(phantom):
    first, last = Counter(), Counter()
    first.SetInputConnection(phantom.GetOutputPort())
    threshold = vtkThreshold()
    threshold.SetInputConnection(first.GetOutputPort())
    last.SetInputConnection(threshold.GetOutputPort())
    for _ in range(3):
        last.Update()
    assert (first._runs, last._runs) == (1, 1)
    phantom.resolution = 4  # as it was
    last.Update()
    assert (first._runs, last._runs) == (1, 1)
    phantom.resolution = 5
    last.Update()
    assert (first._runs, last._runs) == (2, 2)
    last.Modified()
    last.Update()
    assert (first._runs, last._runs) == (2, 3)


def test_identification_runs_again_only_when_the_choice_of_trials_changes(identification):
    identification.Update()
    time = identification.GetMTime()
    identification.Update()  # listing the arrays must not count as a change
    assert identification.GetMTime() == time
    identification.GetDisplacementArraySelection().DisableArray("Displacement_2")
    assert identification.GetMTime() > time


def test_a_pipeline_of_fifty_filters_works(phantom):
    chain = [Counter() for _ in range(50)]
    for before, after in zip([phantom, *chain], chain, strict=False):
        after.SetInputConnection(before.GetOutputPort())
    assert mesh_of(chain[-1]).GetNumberOfCells() == 32
    assert {filter._runs for filter in chain} == {1}


@pytest.mark.skipif(not hasattr(vtkAlgorithm, "__rshift__"), reason="this VTK has no >>")
def test_filters_chain_with_the_arrow(phantom):
    last = LameIdentification(known_materials={1: (5000.0, 0.43)}, method="global")
    pipeline = phantom >> Counter() >> last
    assert pipeline().GetNumberOfCells() == 32
    assert pipeline.update().output.GetCellData().HasArray("Mu")
    last.known_materials = {9: (1.0, 0.3)}
    with pytest.raises(InputError, match="9"):
        pipeline.update()


def test_a_filter_is_a_function_of_its_input(phantom):
    identification = LameIdentification(known_materials={1: (5000.0, 0.43)}, method="global")
    found = identification(mesh_of(phantom))
    assert found.GetCellData().HasArray("Mu")
    assert identification.GetNumberOfInputConnections(0) == 0
    with pytest.raises(InputError):
        identification(vtkUnstructuredGrid())
    assert identification.GetNumberOfInputConnections(0) == 0


# ---- failing


def test_failure_raises_shows_one_line_and_leaves_an_empty_output(phantom, messages):
    filter = Counter(refuse)
    filter.SetInputConnection(phantom.GetOutputPort())
    with pytest.raises(InputError, match="this mesh is not good"):
        filter.Update()
    assert messages() == ["ERROR: Counter: this mesh is not good: take another"]
    assert filter.GetLastError() == "Counter: this mesh is not good: take another"
    assert filter.GetOutput().GetNumberOfCells() == 0


def test_failure_raises_each_time_and_is_over_when_mended(phantom):
    filter = Counter(refuse)
    filter.SetInputConnection(phantom.GetOutputPort())
    for update in (filter.Update, filter.Update, filter.update, filter.UpdateWholeExtent, filter):
        with pytest.raises(InputError):
            update()
    filter._work = lambda mesh, progress: None
    assert mesh_of(filter).GetNumberOfCells() == 32
    assert filter.last_error == ""


def test_failure_after_success_does_not_keep_the_old_output(phantom):
    filter = Counter()
    filter.SetInputConnection(phantom.GetOutputPort())
    filter.Update()
    filter._work = refuse
    filter.Modified()
    with pytest.raises(InputError):
        filter.Update()
    assert filter.GetOutput().GetNumberOfCells() == 0


def test_failure_of_a_filter_before_is_raised_and_later_ones_do_not_run(phantom, messages):
    first, last = Counter(refuse), Counter()
    threshold = vtkThreshold()
    first.SetInputConnection(phantom.GetOutputPort())
    threshold.SetInputConnection(first.GetOutputPort())
    last.SetInputConnection(threshold.GetOutputPort())
    with pytest.raises(InputError, match="this mesh is not good"):
        last.Update()
    assert last._runs == 0
    assert len(messages()) == 1


def test_a_mistake_in_a_filter_raises_as_what_it_is(phantom, messages):
    filter = Counter(lambda mesh, progress: {}["lost"])
    filter.SetInputConnection(phantom.GetOutputPort())
    with pytest.raises(KeyError, match="lost"):
        filter.Update()
    assert messages() == ["ERROR: Counter: KeyError: 'lost'"]


def test_missing_and_wrong_inputs_are_named(messages):
    filter = LameIdentification()
    with pytest.raises(InputError, match="no mesh given: connect a vtkPointSet"):
        filter.Update()
    filter.SetInputData(vtkImageData())
    with pytest.raises(InputError, match="vtkImageData, but a vtkPointSet is required"):
        filter.Update()
    assert len(messages()) == 2


# ---- progress and cancel


def test_progress_shows_text_and_fraction(phantom):
    def work(mesh, progress):
        progress(0.25, "a quarter")
        progress(0.75, "three quarters")

    filter, seen = Counter(work), []
    filter.SetInputConnection(phantom.GetOutputPort())
    filter.AddObserver(
        "ProgressEvent", lambda *_: seen.append((filter.GetProgress(), filter.GetProgressText()))
    )
    filter.Update()
    assert (0.25, "a quarter") in seen and (0.75, "three quarters") in seen


def test_abort_cancels_without_an_error_line_and_the_next_update_runs(phantom, messages):
    def work(mesh, progress):
        progress(0.1, "begun")
        progress(0.2, "not reached when aborted")
        reached.append(True)

    filter, reached = Counter(work), []
    filter.SetInputConnection(phantom.GetOutputPort())
    observer = filter.AddObserver("ProgressEvent", lambda *_: filter.SetAbortExecute(1))
    with pytest.raises(Cancelled):
        filter.Update()
    assert not reached and filter.GetOutput().GetNumberOfCells() == 0 and not messages()
    filter.RemoveObserver(observer)
    assert mesh_of(filter).GetNumberOfCells() == 32 and reached


# ---- blocks


def test_blocks_are_cases_of_their_own(phantom):
    other = PushingPhantom(resolution=6, inclusion_contrast=5.0)
    blocks = vtkMultiBlockDataSet()
    blocks.SetBlock(0, mesh_of(phantom))
    blocks.SetBlock(1, mesh_of(other))
    identification = LameIdentification(known_materials={1: (5000.0, 0.43)}, method="global")
    identification.SetInputData(blocks)
    found = mesh_of(identification)
    assert found.IsA("vtkMultiBlockDataSet")
    for number in range(2):
        cells = found.GetBlock(number).GetCellData()
        mu, truth = (vtk_to_numpy(cells.GetArray(name)) for name in ("Mu", "TrueMu"))
        np.testing.assert_allclose(mu, truth, rtol=1e-8)


def test_a_block_that_fails_raises_and_the_others_are_done(phantom):
    blocks = vtkMultiBlockDataSet()
    blocks.SetBlock(0, vtkUnstructuredGrid())
    blocks.SetBlock(1, mesh_of(phantom))
    identification = LameIdentification(known_materials={1: (5000.0, 0.43)}, method="global")
    identification.SetInputData(blocks)
    with pytest.raises(InputError, match="no cells"):
        identification.Update()
    assert identification.GetOutput().GetBlock(1).GetCellData().HasArray("Mu")
    with pytest.raises(InputError, match="no cells"):
        identification.Update()


# ---- leaks


def test_deleted_filters_and_their_data_go_away():
    def chain():
        phantom = PushingPhantom(resolution=4)
        identification = LameIdentification(known_materials={1: (5000.0, 0.43)}, method="global")
        identification.SetInputConnection(phantom.GetOutputPort())
        identification.Update()
        identification.known_materials = {9: (5000.0, 0.43)}
        with pytest.raises(InputError):
            identification.Update()
        return [weakref.ref(x) for x in (phantom, identification, identification.GetOutput())]

    references = chain()
    gc.collect()
    assert [reference() for reference in references] == [None, None, None]
