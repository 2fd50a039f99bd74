"""Image files by File ▸ Open's way, in the oblique place that they say."""

import sys

import numpy as np
from elastoidentify.vtk_io.convert import image_from_vtk
from paraview.simple import *  # noqa: F403

folder, axes = sys.argv[1], np.reshape(list(map(float, sys.argv[2:11])), (3, 3))
assert "SimpleITK" not in sys.modules

for name in ("rest.nrrd", "rest.mha", "rest.nii.gz"):
    opened = OpenDataFile(f"{folder}/{name}")  # noqa: F405
    assert type(opened).__name__ == "ElastoIdentifyImage", (name, opened)
    image = image_from_vtk(servermanager.Fetch(opened))  # noqa: F405
    np.testing.assert_allclose(image.direction, axes, atol=1e-6)
    np.testing.assert_array_equal(image.array.ravel(), np.arange(120))
    assert opened.PointData[0].Name == "rest"

series = OpenDataFile([f"{folder}/push_1.nrrd", f"{folder}/push_2.nrrd"])  # noqa: F405
assert list(series.TimestepValues) == [0.0, 1.0]
series.UpdatePipeline(1.0)
assert series.PointData[0].Name == "push"

dicom = OpenDataFile(f"{folder}/series")  # noqa: F405
image = image_from_vtk(servermanager.Fetch(dicom))  # noqa: F405
np.testing.assert_array_equal(image.array.ravel(), np.arange(480))

try:
    OpenDataFile(f"{folder}/cut.nrrd").UpdatePipeline()  # noqa: F405
except Exception as error:
    assert "cut.nrrd: the file is damaged or incomplete" in str(error), error
else:
    raise AssertionError("a damaged file was read")
assert "SimpleITK" not in sys.modules
print("done")
