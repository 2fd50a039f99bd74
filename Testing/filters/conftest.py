"""What the tests of the VTK filters share."""

import numpy as np
import pytest

pytest.importorskip("vtkmodules", reason='VTK is not installed. To enable: pip install "vtk>=9.2"')

from elastoidentify.filters import LameIdentification, PushingPhantom
from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow


@pytest.fixture
def messages():
    """Call it for the lines that VTK showed the user since the test began."""
    before, window = vtkOutputWindow.GetInstance(), vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    yield lambda: [line for line in window.GetOutput().splitlines() if line]
    vtkOutputWindow.SetInstance(before)


@pytest.fixture
def phantom():
    """A small phantom, its pad of label 1 with E = 5000, ν = 0.43."""
    return PushingPhantom(resolution=4)


@pytest.fixture
def identification(phantom):
    """The identification of the phantom, connected, with the pad known."""
    identification = LameIdentification(known_materials={1: (5000.0, 0.43)}, method="global")
    identification.SetInputConnection(phantom.GetOutputPort())
    return identification


@pytest.fixture
def random():
    """Random numbers, the same in every run."""
    return np.random.default_rng(20)
