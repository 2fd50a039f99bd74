"""Whole volumes: a heterogeneous block in an oblique volume, from nodes to the 3-D map."""

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")

import vtk  # noqa: E402
from elastoidentify import identify  # noqa: E402
from elastoidentify.fem.elastic_constants import lame_from_young  # noqa: E402
from elastoidentify.fem.forward import solve_push  # noqa: E402
from elastoidentify.imaging.image import Image  # noqa: E402
from elastoidentify.imaging.meshing import mesh_segmentation  # noqa: E402
from elastoidentify.imaging.phantom import Ball, make_phantom_volume  # noqa: E402
from elastoidentify.options import keywords  # noqa: E402
from elastoidentify.pipeline import cell_blocks, known_by_label, make_mesh  # noqa: E402
from elastoidentify.results import QUANTITIES  # noqa: E402
from elastoidentify.study import IdentificationOptions  # noqa: E402
from ElastoIdentifyLib import images, sample  # noqa: E402
from ElastoIdentifyLib.request import KNOWN, RIGID, Material, Request  # noqa: E402
from stored_registration import only_read, stored_outcome  # noqa: E402
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy  # noqa: E402

from ElastoIdentify import ElastoIdentifyLogic  # noqa: E402

pytestmark = pytest.mark.usefixtures("warm")

FLIP = np.array([-1.0, -1.0, 1.0])
NAMES = {1: "indenter", 2: "pad", 3: "tissue", 4: "inclusion", 5: "floor"}
PAD, TISSUE, INCLUSION = 2, 3, 4
POISSON = 0.4


def axes_of_the_volume():
    """Voxel axes: turned about two axes of the patient, of three lengths, not right-handed."""
    a, b = 0.5, -0.4
    about_s = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_r = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    return about_s @ about_r @ np.diag([1.5, 1.2, -2.0])


def block():
    """A block of 24 × 24 × 34 mm under an indenter, on a floor; the pushes are along k."""
    labels = np.zeros((21, 26, 22), np.uint8)  # k, j, i
    for label, first, last in ((1, 1, 3), (2, 3, 7), (3, 7, 18), (5, 18, 20)):
        labels[first:last, 3:23, 3:19] = label
    labels[10:14, 9:17, 8:14] = INCLUSION
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes_of_the_volume(), (31.0, -52.0, 17.0)
    rest = slicer.util.addVolumeFromArray((50 * labels).astype(np.int16), matrix, "Solid")
    segmentation = sample.segmentation_from_image(Image(labels), NAMES, "Solid segments", rest)
    return {
        "restVolume": rest,
        "segmentation": segmentation,
        "materials": {
            "pad": Material(KNOWN, 5.0, POISSON),
            "indenter": Material(RIGID),
            "floor": Material(RIGID),
        },
        "wholeVolume": True,
        "edgeLength": 6.0,
        "options": {"method": "global", "unknowns": "young", "poisson_ratio": POISSON},
    }


def stiffness(mesh):
    """True E in kPa: the pad 5, tissue 8 to 12 from side to side, an inclusion of 30."""
    across = mesh.points[mesh.cells].mean(axis=1) @ axes_of_the_volume()[:, 0]
    across = (across - across.min()) / np.ptp(across)
    return np.select([mesh.labels == PAD, mesh.labels == INCLUSION], [5.0, 30.0], 8 + 4 * across)


def pushes(mesh):
    """The displacements of three pushes and a twist of the top, exact on the mesh."""
    axes = axes_of_the_volume()
    axes = axes / np.linalg.norm(axes, axis=0)
    moved = np.flatnonzero(mesh.reaction_nodes)
    height = mesh.points[moved] @ axes[:, 2]
    at_top = (height < height.mean())[:, None]
    centre = mesh.points[moved].mean(axis=0)
    twist = 0.02 * np.cross(axes[:, 2], mesh.points[moved] - centre) + 0.5 * axes[:, 2]
    lam, mu = lame_from_young(stiffness(mesh), POISSON)
    shifts = [axes @ push for push in ([0, 0, 0.5], [0.5, 0, 0.4], [0, 0.5, 0.3])]
    return np.array(
        [
            solve_push(mesh.points, mesh.cells, lam, mu, moved, at_top * shift)
            for shift in (*shifts, twist)
        ]
    )


def spline(points, displacement):
    """A transform node that takes the nodes of the mesh to where they are when pushed."""
    found = vtk.vtkThinPlateSplineTransform()
    found.SetBasisToR()
    for setter, places in (
        (found.SetSourceLandmarks, points),
        (found.SetTargetLandmarks, points + displacement),
    ):
        landmarks = vtk.vtkPoints()
        landmarks.SetData(numpy_to_vtk(np.ascontiguousarray(places), deep=True))
        setter(landmarks)
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTransformNode", "Solid push")
    node.SetAndObserveTransformToParent(found)
    return node


@pytest.fixture
def solid():
    """Inputs with exact transforms, and the result."""
    inputs = block()
    mesh = make_mesh(Request(**inputs, transforms=[None]).study())
    inputs["transforms"] = [spline(mesh.points, shift) for shift in pushes(mesh)]
    return inputs, mesh, ElastoIdentifyLogic().process(**inputs)


def cell_data(result, name):
    return slicer.util.arrayFromModelCellData(result.model, name)


def test_the_map_of_an_oblique_heterogeneous_volume_is_the_truth_and_the_librarys(solid):
    inputs, mesh, result = solid
    truth, status = stiffness(mesh), cell_data(result, "Status")
    assert result.model.GetMesh().GetCellType(0) == vtk.VTK_TETRA
    assert set(cell_data(result, "Label")) == {PAD, TISSUE, INCLUSION}
    found = status == 2
    assert found[mesh.labels != PAD].mean() > 0.9
    assert found[mesh.labels == INCLUSION].all()
    assert np.abs(cell_data(result, "YoungModulus") / truth - 1)[status > 0].max() < 1e-7

    # the same from the arrays in the LPS world of files
    study = Request(**inputs).study()
    image = study.segmentation
    lps = Image(image.array, FLIP * image.origin, image.spacing, FLIP[:, None] * image.direction)
    there = mesh_segmentation(lps, study.edge_length, rigid_labels=study.rigid_labels)
    points = vtk_to_numpy(result.model.GetMesh().GetPoints().GetData())
    assert np.allclose(points, there.points * FLIP, atol=1e-9)
    shifts = images.nodal_displacements(inputs["transforms"], there.points * FLIP, False) * FLIP
    direct = identify(
        there.points,
        cell_blocks(there.cells),
        shifts,
        known_by_label(study),
        labels=there.labels,
        reaction_nodes=there.reaction_nodes.astype(bool),
        **keywords(study, IdentificationOptions),
    )
    assert (direct.status == status).all()
    for name, values in (("Mu", direct.mu), ("Lambda", direct.lam), ("YoungModulus", direct.young)):
        assert np.allclose(cell_data(result, name), values, rtol=1e-9, equal_nan=True), name


def test_table_transforms_and_open_cells_of_a_volume(solid):
    _, mesh, result = solid
    status = cell_data(result, "Status")
    table = result.table.GetTable()
    rows = {
        table.GetValueByName(row, "name").ToString(): row for row in range(table.GetNumberOfRows())
    }
    assert list(rows) == ["pad", "tissue", "inclusion"]
    median = table.GetValueByName(rows["inclusion"], "YoungModulus median").ToDouble()
    assert median == pytest.approx(30.0, rel=1e-6)
    tissue = (mesh.labels == TISSUE) & (status == 2)
    median = table.GetValueByName(rows["tissue"], "YoungModulus median").ToDouble()
    assert median == pytest.approx(np.median(stiffness(mesh)[tissue]), rel=1e-5)
    if (status == 0).any():
        assert np.isnan(cell_data(result, "Mu")[status == 0]).all()
        assert result.undetermined.GetMesh().GetNumberOfCells() == (status == 0).sum()
    for node, exact in zip(result.transforms, pushes(mesh), strict=True):
        shift = images.nodal_displacements([node], mesh.points, False)[0]
        assert np.abs(shift - exact).max() < 0.1 * np.abs(exact).max()


# ---- from 3-D images


@pytest.mark.slow
def test_oblique_3d_images_give_the_bits_of_the_pipeline_and_the_moduli_of_the_segments(tmp_path):
    """All of the way but elastix itself, whose answer is stored.

    One unknown per segment: tissue within 10 %, inclusion within 25 %, for it is three cells wide,
    and its linear cells are too stiff.
    """
    axes = axes_of_the_volume()
    phantom = make_phantom_volume(
        balls=[Ball(z=0.4, radius=0.28)],
        pushes=[(0, 0, -0.07), (0.05, 0, -0.05)],
        tissue_young=4000.0,
        poisson=POISSON,
        width=43.2,
        height=57.6,
        voxels=36,
        origin=(-31.0, 52.0, 17.0),
        direction=FLIP[:, None] * axes / np.linalg.norm(axes, axis=0),
        elements=8,
    )
    inputs = sample.phantom_nodes(phantom) | {"wholeVolume": True, "edgeLength": 11.0}
    inputs["options"] |= {"grouping": "label", "cache": str(tmp_path)}
    outcome = stored_outcome(Request(**inputs).study(), phantom, tmp_path)
    with only_read(tmp_path):
        result = ElastoIdentifyLogic().process(**inputs)
    for name, quantity in QUANTITIES.items():
        expected = getattr(outcome.result, quantity.field)
        np.testing.assert_array_equal(cell_data(result, name), expected, err_msg=name)
    labels, young = cell_data(result, "Label"), cell_data(result, "YoungModulus")
    for name, truth, within in (
        ("pad", 5.0, 1e-6),
        ("tissue", 4.0, 0.1),
        ("inclusion", 12.0, 0.25),
    ):
        found = np.median(young[labels == phantom.label(name)])
        print(f"{name}: {found:.2f} kPa for {truth:g} (flat guess: 5)")
        assert found == pytest.approx(truth, rel=within), name
