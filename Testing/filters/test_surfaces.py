"""Meshes that come as surfaces, as slices and most readers give them."""

import numpy as np
import pytest
from elastoidentify import InputError
from elastoidentify.filters import LameIdentification, PushingPhantom
from elastoidentify.vtk_io import convert
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter


def surface(shape):
    """The phantom as vtkPolyData."""
    geometry = vtkGeometryFilter()
    geometry.SetInputData(PushingPhantom(shape=shape, resolution=4)())
    geometry.Update()
    return geometry.GetOutput()


@pytest.mark.parametrize("shape", ["triangles", "quads"])
def test_a_surface_gives_the_map_of_its_mesh(shape):
    data = surface(shape)
    assert data.IsA("vtkPolyData")
    found = LameIdentification(method="global")(data)
    assert found.IsA("vtkUnstructuredGrid")
    cells = found.GetCellData()
    mu, truth = (convert.get_array(cells, name) for name in ("Mu", "TrueMu"))
    np.testing.assert_allclose(mu, truth, rtol=1e-6)


def test_an_image_is_no_mesh():
    found = LameIdentification()
    found.SetInputData(vtkImageData())
    with pytest.raises(InputError, match="vtkPointSet"):
        found.Update()
