"""The scripts in ParaView's pages run as they stand, but that registrations are stored."""

import re
import shutil
from pathlib import Path

import pytest
from paraview_host import mpirun, python_with, run

pytestmark = pytest.mark.slow

PAGE = Path(__file__).resolve().parents[2] / "docs" / "paraview.md"
IMAGES, CASES = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)


def test_the_script_from_images_to_maps_for_others(tmp_path):
    pytest.importorskip("skfem", reason="scikit-fem is not installed: pip install scikit-fem")
    from elastoidentify.imaging.io import read_image, read_segmentation, write_image
    from elastoidentify.imaging.phantom import make_phantom
    from elastoidentify.study import Study
    from stored_registration import only_read, store

    body = make_phantom(width=24, pixels=72, elements=24)  # edges of 4 mm are of 12 pixels
    names = ("rest.nii.gz", "pushed_1.nii.gz", "pushed_2.nii.gz")
    for name, image in zip(names, (body.rest, *body.pushed), strict=True):
        write_image(tmp_path / name, image)
    write_image(tmp_path / "seg.nrrd", body.segmentation)
    rest, *pushed = (read_image(tmp_path / name) for name in names)
    segmentation, _ = read_segmentation(tmp_path / "seg.nrrd")
    study = Study(
        segmentation=segmentation, rest=rest, pushed=pushed, edge_length=4.0, rigid_labels=[4]
    )
    store(study, body, tmp_path / "stored")

    script = IMAGES.replace("Mesh=mesh,", 'Mesh=mesh, Cache="stored",')
    assert script != IMAGES
    (tmp_path / "script.py").write_text(script, encoding="utf-8")
    lender = python_with("SimpleITK", "highdicom", "matplotlib")
    with only_read(tmp_path / "stored"):
        done = run("pvpython", "script.py", cwd=tmp_path, ELASTOIDENTIFY_PYTHON=lender)
    assert done.returncode == 0, done.stdout
    for name in ("stiffness.vtu", "case1_mu.nii.gz", "case1/mu.dcm", "case1.html"):
        assert (tmp_path / name).exists(), name


def test_the_script_for_a_volume_shows_the_ball_and_half_of_the_block(tmp_path):
    """On a piece of the page's block, with cells of the page's size."""
    pytest.importorskip("skfem", reason="scikit-fem is not installed: pip install scikit-fem")
    from elastoidentify.imaging.phantom import make_phantom_volume, write_phantom
    from elastoidentify.imaging.phantom.volume import Ball
    from elastoidentify.study import Study
    from hosts_page import block
    from stored_registration import only_read, store

    ball = Ball(0.5, 0.5, 0.4, 0.3, 3.0)
    body = make_phantom_volume(voxels=16, width=24.0, height=24.0, hidden=True, balls=[ball])
    write_phantom(tmp_path / "phantom", body)
    study = Study(
        segmentation=body.segmentation, rest=body.rest, pushed=body.pushed, edge_length=8.0,
        rigid_labels=body.rigid_labels,
    )  # fmt: skip
    store(study, body, tmp_path / "stored")
    page = PAGE.with_name("volumes.md").read_text(encoding="utf-8")
    script = block("In ParaView", "python", page, ElastixNodalDisplacement="Cache='stored'")
    (tmp_path / "ball.py").write_text(script + SEEN, encoding="utf-8")
    with only_read(tmp_path / "stored"):
        done = run("pvpython", "-W", "ignore", "ball.py", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    whole, inside, cut = map(float, re.search(r"^cells (.*)", done.stdout, re.M).group(1).split())
    assert 0 < inside < 0.25 * whole
    assert 0.4 * whole < cut < 0.7 * whole


SEEN = """
parts = (stiffness, stiff, half)
for part in parts:
    part.UpdatePipeline()
print("cells", *(part.GetDataInformation().GetNumberOfCells() for part in parts))
"""


def test_the_script_for_many_cases_on_two_ranks(blocks, tmp_path):
    shutil.copytree(blocks.parent, tmp_path, dirs_exist_ok=True)
    (tmp_path / "cases.py").write_text(CASES, encoding="utf-8")
    done = run("pvbatch", "cases.py", before=mpirun(2), cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert (tmp_path / "stiffness.vtm").exists()
