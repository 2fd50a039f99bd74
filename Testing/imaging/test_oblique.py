"""The same body in an upright and in an oblique image, from files to moduli.

The oblique image lies askew in the world, far from its origin, and its pixels are taller than wide:
another grid, another noise, another mesh. The body is the same, so its moduli must be.
"""

import numpy as np
import pytest
from elastoidentify.cli import main
from elastoidentify.imaging.io import read_image
from elastoidentify.imaging.phantom.planar import Inclusion, make_phantom, write_phantom
from elastoidentify.imaging.phantom.texture import mni152_path, slice_of
from elastoidentify.vtk_io.vtu import read_mesh
from quick_elastix import quick_parameters
from scipy.spatial.transform import Rotation
from vtkmodules.util.numpy_support import vtk_to_numpy

pytest.importorskip("itk", reason="needs itk-elastix")

DIRECTION = Rotation.from_euler("zyx", (25, -35, 50), degrees=True).as_matrix()
PLACES = {
    "upright": {},
    "oblique": {"origin": (-83.0, 211.0, 37.5), "direction": DIRECTION, "anisotropy": 1.2},
}
PAD, TISSUE, INCLUSION = 1, 2, 3


def young_by_label(folder, place):
    """Return E of tissue and inclusion (Pa) and the mesh, by `elastoidentify run` on files."""
    made = make_phantom(
        slice_of(read_image(mni152_path()), index=92),
        inclusions=[Inclusion(contrast=3.0)],
        kinematics="neo-hookean",
        elements=28,
        **place,
    )
    write_phantom(folder, made)
    pad = made.materials[PAD]
    words = ["run", "--rest", folder / "rest.nrrd", "--segmentation", folder / "segmentation.nrrd"]
    for trial in (1, 2):
        words += ["--pushed", folder / f"pushed_{trial}.nrrd"]
    for label in made.rigid_labels:
        words += ["--rigid", label]
    edge = 12 * made.frame.width / made.frame.pixels[0]
    words += ["--edge-length", edge, "--known", f"{PAD}:E={pad.young},nu={pad.poisson}"]
    words += ["--method", "regularized", "--kinematics", "neo-hookean", "--group", "label"]
    words += ["--unknowns", "young", "--poisson", pad.poisson, "-o", folder / "map.vtu"]
    words += ["--parameters", quick_parameters(folder)]
    assert main([str(word) for word in words]) == 0
    grid = read_mesh(folder / "map.vtu")
    labels, young = (
        vtk_to_numpy(grid.GetCellData().GetArray(name)) for name in ("Label", "YoungModulus")
    )
    return np.array([np.median(young[labels == one]) for one in (TISSUE, INCLUSION)]), grid


@pytest.mark.slow
@pytest.mark.usefixtures("waiting_elastix")
def test_an_oblique_anisotropic_image_gives_the_moduli_of_the_upright_one(tmp_path):
    upright, _ = young_by_label(tmp_path / "upright", PLACES["upright"])
    oblique, grid = young_by_label(tmp_path / "oblique", PLACES["oblique"])
    points = vtk_to_numpy(grid.GetPoints().GetData())
    normal = (points - points[0]) @ DIRECTION[:, 2]
    assert np.abs(normal).max() < 1e-6 * np.ptp(points)  # the mesh lies in the image's own plane
    assert np.abs(points.mean(axis=0) - PLACES["oblique"]["origin"]).min() > 10
    np.testing.assert_allclose(oblique, upright, rtol=0.02)
    np.testing.assert_allclose(upright, (3000, 9000), rtol=0.08)
