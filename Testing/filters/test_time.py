"""A push per time step: the steps of an image or mesh series are trials."""

import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.filters import (
    ElastixNodalDisplacement,
    Filter,
    LameIdentification,
    PushingPhantom,
)
from elastoidentify.vtk_io import convert
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline


class Series(Filter):
    """A source with one data object per time step."""

    def __init__(self, steps, times=None):
        type(self).output_types = (steps[0].GetClassName(),)
        super().__init__()
        self._steps = steps
        self._times = times or list(np.arange(len(steps)) * 0.5)
        self._asked = []

    def RequestInformation(self, request, inInfo, outInfo):
        info = outInfo.GetInformationObject(0)
        info.Set(Pipeline.TIME_STEPS(), self._times, len(self._times))
        info.Set(Pipeline.TIME_RANGE(), [self._times[0], self._times[-1]], 2)
        return 1

    def RequestData(self, request, inInfo, outInfo):
        info = outInfo.GetInformationObject(0)
        asked = Pipeline.UPDATE_TIME_STEP()
        self._asked.append(info.Get(asked) if info.Has(asked) else self._times[0])
        info.Get(convert.vtkUnstructuredGrid.DATA_OBJECT()).ShallowCopy(
            self._steps[self._times.index(self._asked[-1])]
        )
        return 1


def one_push(push):
    """A phantom's mesh with one displacement."""
    phantom = PushingPhantom(resolution=4, pushes=[push])
    phantom.Update()
    return phantom.GetOutput()


PUSHES = [(0.0, -0.01), (0.01, -0.01), (0.01, 0.0)]


def test_every_step_of_a_mesh_series_is_a_trial_when_asked_for():
    series = Series([one_push(push) for push in PUSHES])
    identification = LameIdentification(
        known_materials={1: (5000.0, 0.43)}, method="global", time_steps_as_trials=True
    )
    identification.SetInputConnection(series.GetOutputPort())
    identification.Update()
    found = identification.GetOutput()
    cells, points = found.GetCellData(), found.GetPointData()
    assert convert.displacement_names(found) == [f"Displacement_{k}" for k in (1, 2, 3)]
    np.testing.assert_allclose(
        convert.get_array(cells, "Mu"), convert.get_array(cells, "TrueMu"), rtol=1e-8
    )
    together = PushingPhantom(resolution=4, pushes=PUSHES)
    together.Update()
    for name in convert.displacement_names(found):
        there = convert.get_array(together.GetOutput().GetPointData(), name)
        np.testing.assert_array_equal(convert.get_array(points, name), there)
    runs = len(series._asked)
    identification.Update()
    assert len(series._asked) == runs == 3


def test_otherwise_a_mesh_series_is_identified_step_by_step():
    both = PushingPhantom(resolution=4)
    both.Update()
    series = Series([both.GetOutput(), one_push(PUSHES[0])])
    identification = LameIdentification(known_materials={1: (5000.0, 0.43)}, method="global")
    identification.SetInputConnection(series.GetOutputPort())
    identification.Update()
    assert series._asked == [0.0]
    assert identification.GetOutput().GetPointData().HasArray("Residual_2")


def test_a_series_of_different_meshes_is_refused_and_the_next_run_starts_anew():
    other = PushingPhantom(resolution=5)
    other.Update()
    series = Series([one_push(PUSHES[0]), other.GetOutput(), one_push(PUSHES[1])])
    identification = LameIdentification(
        known_materials={1: (5000.0, 0.43)}, method="global", time_steps_as_trials=True
    )
    identification.SetInputConnection(series.GetOutputPort())
    for _ in range(2):
        with pytest.raises(InputError, match="36 nodes at time step 1 and 25 at the first"):
            identification.Update()
    series._steps[1] = one_push(PUSHES[2])
    series.Modified()
    identification.Update()
    assert len(convert.displacement_names(identification.GetOutput())) == 3


def test_every_step_of_a_pushed_image_series_is_a_trial(monkeypatch):
    def image(value):
        data = vtkImageData()
        data.SetDimensions(3, 3, 1)
        convert.set_array(data.GetPointData(), "Grey", np.full(9, value))
        return data

    seen = []
    monkeypatch.setattr(
        "elastoidentify.imaging.registration.register",
        lambda rest, pushed, *rest_of_it, **settings: (
            seen.append([float(p.array[0, 0, 0]) for p in pushed]) or 1 / 0
        ),
    )
    registration = ElastixNodalDisplacement()
    registration.SetMesh(one_push(PUSHES[0]))
    registration.SetRestImage(image(0.0))
    registration.AddPushedImage(Series([image(1.0), image(2.0), image(3.0)]))
    registration.AddPushedImage(image(4.0))
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            registration.Update()
        assert seen.pop() == [1.0, 2.0, 3.0, 4.0]
    registration.time_steps_as_trials = False
    with pytest.raises(ZeroDivisionError):
        registration.Update()
    assert seen.pop() == [1.0, 4.0]
