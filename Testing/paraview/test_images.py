"""The whole way from image files to stiffness in pvpython."""

import numpy as np
import pytest


def write(path, image):
    """Write an Image as .vti."""
    from elastoidentify.vtk_io import convert
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    writer = vtkXMLImageDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(convert.image_to_vtk(image))
    assert writer.Write() == 1


@pytest.mark.slow
def test_images_to_stiffness_by_proxies_gives_the_pipelines_bits(script, tmp_path):
    pytest.importorskip("vtkmodules")
    pytest.importorskip("skfem", reason="scikit-fem is not installed: pip install scikit-fem")
    from elastoidentify.imaging.phantom.planar import make_phantom
    from elastoidentify.study import Study
    from elastoidentify.vtk_io import convert
    from stored_registration import only_read, stored_outcome
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    phantom = make_phantom(pixels=96, elements=30, pushes=((0.0, 0.06), (0.04, 0.04)))
    write(tmp_path / "segmentation.vti", phantom.segmentation)
    write(tmp_path / "rest.vti", phantom.rest)
    for number, image in enumerate(phantom.pushed, 1):
        write(tmp_path / f"pushed{number}.vti", image)
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
