"""Image files in pvpython: read as they lie in the world, and the whole way to stiffness."""

import sys

import numpy as np
import pytest


def test_paraview_opens_images_with_their_orientation_by_another_python(script, tmp_path):
    """ParaView's own Python is left without SimpleITK and pydicom, as the launcher leaves it."""
    sitk = pytest.importorskip("SimpleITK", reason="needs SimpleITK: pip install SimpleITK")
    files = pytest.importorskip("dicom_files", reason="needs pydicom: pip install pydicom")
    axes, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    axes *= np.sign(np.linalg.det(axes))
    image = sitk.GetImageFromArray(np.arange(120, dtype=np.int16).reshape(4, 5, 6))
    image.SetDirection(axes.ravel().tolist())
    for name in ("rest.nrrd", "rest.mha", "rest.nii.gz", "push_1.nrrd", "push_2.nrrd"):
        sitk.WriteImage(image, str(tmp_path / name))
    (tmp_path / "cut.nrrd").write_bytes((tmp_path / "rest.nrrd").read_bytes()[:-9])
    (tmp_path / "series").mkdir()
    files.write_series(tmp_path / "series", files.volume(), files.oblique())
    script(
        "reading.py",
        tmp_path,
        *axes.ravel(),
        what="pvpython",
        ELASTOIDENTIFY_PARAVIEW_SITE="",
        ELASTOIDENTIFY_PYTHON=sys.executable,
    )


@pytest.mark.slow
def test_images_to_stiffness_by_proxies_gives_the_pipelines_bits(script, tmp_path):
    pytest.importorskip("vtkmodules")
    pytest.importorskip("skfem", reason="scikit-fem is not installed: pip install scikit-fem")
    from elastoidentify.imaging.io import write_image
    from elastoidentify.imaging.phantom.planar import make_phantom
    from elastoidentify.study import Study
    from elastoidentify.vtk_io import convert
    from stored_registration import only_read, stored_outcome
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    phantom = make_phantom(pixels=96, elements=30, pushes=((0.0, 0.06), (0.04, 0.04)))
    write_image(tmp_path / "segmentation.nrrd", phantom.segmentation)
    write_image(tmp_path / "rest.nrrd", phantom.rest)
    for number, image in enumerate(phantom.pushed, 1):
        write_image(tmp_path / f"pushed{number}.nrrd", image)
    pad = phantom.label("pad")
    material = phantom.materials[pad]
    study = Study(
        segmentation=phantom.segmentation,
        rest=phantom.rest,
        pushed=phantom.pushed,
        edge_length=15.0,
        rigid_labels=phantom.rigid_labels,
        known_materials={pad: (material.young, material.poisson)},
    )
    stored = tmp_path / "stored"
    stored_outcome(study, phantom, stored)
    rigid = ",".join(map(str, phantom.rigid_labels))
    with only_read(stored):
        script("image_chain.py", tmp_path, pad, material.young, material.poisson, rigid, stored)

    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(tmp_path / "stiffness.vtu"))
    reader.Update()
    cells = reader.GetOutput().GetCellData()
    label, young = (convert.get_array(cells, name) for name in ("Label", "YoungModulus"))
    inclusion, tissue = (
        np.median(young[label == phantom.label(name)]) for name in ("inclusion", "tissue")
    )
    assert 3.0 * 0.75 < inclusion / tissue < 3.0 * 1.25
