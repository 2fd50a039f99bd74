"""A volume from its files to moduli: labels, tetrahedra, registration, one modulus per label.

A block of soft tissue with a stiff ball and a known pad stands on a floor and is pushed by an
indenter, straight and obliquely. Its equilibrium is solved on quadratic bricks that identification
does not use; its images are speckle with noise, lying askew in the world, with voxels that are no
cubes.
"""

import numpy as np
import pytest
from elastoidentify.cli import main
from elastoidentify.imaging.phantom import Ball, make_phantom_volume, write_phantom
from elastoidentify.vtk_io.vtu import read_mesh
from scipy.spatial.transform import Rotation
from vtkmodules.util.numpy_support import vtk_to_numpy

pytest.importorskip("itk", reason="needs itk-elastix")

POISSON = 0.4


def volume_phantom():
    """A block of 64 mm with a ball 3 times as stiff as its tissue."""
    return make_phantom_volume(
        balls=[Ball(z=0.375, radius=17 / 64)],
        pushes=[(0, 0, -0.056), (0.0375, 0.019, -0.0375)],
        poisson=POISSON,
        voxels=64,
        anisotropy=4 / 3,
        origin=(-40.0, 120.0, 300.0),
        direction=Rotation.from_euler("zyx", (20, -30, 40), degrees=True).as_matrix(),
        elements=12,
    )


@pytest.mark.slow
def test_a_volume_goes_from_files_to_the_moduli_of_its_labels(tmp_path):
    phantom = volume_phantom()
    write_phantom(tmp_path, phantom)
    words = ["run", "--rest", tmp_path / "rest.nrrd", "--edge-length", 9]
    words += ["--segmentation", tmp_path / "segmentation.nrrd"]
    for trial in (1, 2):
        words += ["--pushed", tmp_path / f"pushed_{trial}.nrrd"]
    for label in phantom.rigid_labels:
        words += ["--rigid", label]
    pad = phantom.label("pad")
    words += ["--known", f"{pad}:E={phantom.materials[pad].young},nu={POISSON}"]
    words += ["--unknowns", "young", "--poisson", POISSON, "--group", "label"]
    words += ["--method", "regularized", "-o", tmp_path / "map.vtu"]
    assert main([str(word) for word in words]) == 0
    cells = read_mesh(tmp_path / "map.vtu").GetCellData()
    labels, young = (vtk_to_numpy(cells.GetArray(name)) for name in ("Label", "YoungModulus"))
    found = {
        name: np.median(young[labels == phantom.label(name)]) for name in ("tissue", "inclusion")
    }
    assert found["tissue"] == pytest.approx(3000, rel=0.1)
    assert found["inclusion"] / found["tissue"] == pytest.approx(3, rel=0.1)


def test_the_command_makes_a_volume_whose_ball_the_segmentation_hides(tmp_path, capsys):
    from elastoidentify.cli import main
    from elastoidentify.imaging.io import read_image

    words = ["phantom", "--out", str(tmp_path / "p"), "--image", "speckle", "--pixels", "20"]
    assert main([*words, "--3d", "--hidden", "--push", "0,0,-0.05", "--push", "0.03,0,-0.03"]) == 0
    said = capsys.readouterr().out
    assert "elastoidentify run" in said and said.count("--pushed") == 2
    labels = read_image(tmp_path / "p" / "segmentation.nrrd").array
    young = read_image(tmp_path / "p" / "true_young.nrrd").array
    assert labels.ndim == 3 and min(labels.shape) > 8
    in_tissue = np.unique(young[labels == 2])
    assert np.isclose(in_tissue.max(), 9000) and np.isclose(in_tissue.min(), 3000)
    assert main([*words, "--3d", "--push", "0,0.05"]) == 2
    assert "with --3d it takes 3 numbers" in capsys.readouterr().err
