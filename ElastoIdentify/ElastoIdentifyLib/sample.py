"""Nodes to try the module on: the phantoms of Sample Data, and a push with a known answer."""

import numpy as np
import slicer
import vtk
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import solve_push
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.phantom import Ball, make_phantom_volume
from elastoidentify.imaging.phantom.planar import (
    FLOOR,
    INCLUSION,
    INDENTER,
    PAD,
    TISSUE,
    Inclusion,
    make_phantom,
)
from elastoidentify.imaging.phantom.push_quads import solve_pushes_on_quads
from elastoidentify.pipeline import make_mesh
from slicer.i18n import tr as _
from vtk.util.numpy_support import numpy_to_vtk

from .request import KNOWN, RIGID, Material, Request, tag_segment

LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0])
COLOURS = {
    PAD: (0.95, 0.85, 0.35),
    TISSUE: (0.85, 0.55, 0.5),
    INCLUSION: (0.65, 0.2, 0.3),
    INDENTER: (0.6, 0.65, 0.7),
}


def volume_from_image(image: Image, name: str):
    """Add a scalar volume node of an image whose world is LPS, as files have it."""
    matrix = np.eye(4)
    matrix[:3, :3] = LPS_TO_RAS @ image.axes
    matrix[:3, 3] = LPS_TO_RAS @ image.origin
    return slicer.util.addVolumeFromArray(image.array, matrix, name)


def segmentation_from_image(image: Image, names: dict[int, str], name: str, reference):
    """Add a segmentation node of a label image, one segment per label, on a reference volume."""
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLSegmentationNode", name)
    node.CreateDefaultDisplayNodes()
    node.SetReferenceImageGeometryParameterFromVolumeNode(reference)
    for label, segment in names.items():
        colour = COLOURS.get(segment, (0.5, 0.55, 0.6))
        segment_id = node.GetSegmentation().AddEmptySegment(segment, segment, colour)
        mask = (image.array == label).astype(np.uint8)
        slicer.util.updateSegmentBinaryLabelmapFromArray(mask, node, segment_id, reference)
    node.GetDisplayNode().SetOpacity2DFill(0.2)
    return node


def phantom_nodes(phantom, name: str = "Phantom") -> dict:
    """Add a phantom's images and segmentation; returns fields of a Request."""
    rest = volume_from_image(phantom.rest, f"{name} rest")
    pushed = [
        volume_from_image(image, f"{name} pushed {number}")
        for number, image in enumerate(phantom.pushed, 1)
    ]
    names = {label: material.name for label, material in phantom.materials.items()}
    segmentation = segmentation_from_image(
        phantom.segmentation, names, f"{name} segmentation", rest
    )
    pad = phantom.materials[phantom.label(PAD)]
    materials = {PAD: Material(KNOWN, pad.young / 1000, pad.poisson)}
    materials |= {names[label]: Material(RIGID) for label in phantom.rigid_labels}
    for segment, material in materials.items():
        tag_segment(segmentation, segment, material)
    return {
        "restVolume": rest,
        "pushedVolumes": pushed,
        "segmentation": segmentation,
        "materials": materials,
        "edgeLength": round(12 * float(phantom.frame.spacing.max()), 1),
        "options": {"kinematics": phantom.parameters["kinematics"]},
        "unit": "kPa",
    }


def add_phantom(progress=None) -> list:
    """Add the Sample Data phantom: a stiff inclusion under a pad, 3 times its surroundings.

    Parameters
    ----------
    progress : callable(fraction, text), optional

    Returns
    -------
    list
        Its nodes, the rest volume first.
    """
    return _added(
        lambda: make_phantom(
            None,
            inclusions=[Inclusion(contrast=3.0)],
            solver=solve_pushes_on_quads,  # Slicer has no scikit-fem
            elements=120,
            progress=progress,
        )
    )


def add_phantom_volume(progress=None) -> list:
    """Add the 3-D phantom of Sample Data: a stiff ball under a pad, 3 times its surroundings.

    Parameters
    ----------
    progress : callable(fraction, text), optional

    Returns
    -------
    list
        Its nodes, the rest volume first.
    """
    ball = Ball(z=0.4, radius=0.25)
    return _added(
        lambda: make_phantom_volume(balls=[ball], voxels=40, elements=8, progress=progress),
        "Phantom 3-D",
    )


def _added(make, *name) -> list:
    """Add the phantom that `make` makes, and return its nodes."""
    with slicer.util.tryWithErrorDisplay(_("The phantom could not be made."), waitCursor=True):
        inputs = phantom_nodes(make(), *name)
    return [inputs["restVolume"], *inputs["pushedVolumes"], inputs["segmentation"]]


# ---- a push with a known answer


def add_exact_push(pad_young: float = 5.0, tissue_young: float = 15.0, poisson: float = 0.3):
    """Add a block on a floor under an indenter, pushed twice, as an oblique image and transforms.

    The displacements are the exact solution on the mesh that the module will make, carried by
    thin-plate splines through its nodes.

    Returns
    -------
    inputs : dict
        Fields of a Request.
    young : {label: float}
        The answer, by the value of the model's cell array Label.
    """
    turn, spacing, size = 0.4, 1.5, 40
    direction = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]]
    )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = direction * spacing, (12.0, -30.0, 7.0)
    labels = np.zeros((1, size, size), np.uint8)
    for label, first, last in ((1, 4, 8), (2, 8, 16), (3, 16, 32), (4, 32, 36)):
        labels[:, first:last, 6:34] = label
    rest = slicer.util.addVolumeFromArray((100 * labels).astype(np.int16), matrix, "Block")
    names = {1: INDENTER, 2: PAD, 3: TISSUE, 4: FLOOR}
    segmentation = segmentation_from_image(Image(labels), names, "Block segments", rest)
    request = Request(
        restVolume=rest,
        segmentation=segmentation,
        transforms=[None],  # stands for those that are made below
        materials={
            PAD: Material(KNOWN, pad_young, poisson),
            INDENTER: Material(RIGID),
            FLOOR: Material(RIGID),
        },
        edgeLength=6.0,
        options={"method": "global", "unknowns": "young", "poisson_ratio": poisson},
    )
    mesh = make_mesh(request.study())
    request.transforms = [
        _spline(mesh.points, displacement, direction[:, 2], f"Block push {number}")
        for number, displacement in enumerate(
            _exact_pushes(mesh, direction, {2: pad_young, 3: tissue_young}, poisson), 1
        )
    ]
    return vars(request), {2: pad_young, 3: tissue_young}


def _exact_pushes(mesh, direction, young, poisson) -> np.ndarray:
    """Return the displacements (2, n, 3) of a push down and of one down and sideways."""
    plane = mesh.points @ direction[:, :2]
    moduli = np.array([young[label] for label in mesh.labels])
    lam, mu = lame_from_young(moduli, poisson)
    moved = np.flatnonzero(mesh.reaction_nodes)
    at_top = plane[moved, 1] < plane[:, 1].mean()
    height = np.ptp(plane[:, 1])
    return np.array(
        [
            solve_push(plane, mesh.cells, lam, mu, moved, at_top[:, None] * height * push)
            @ direction[:, :2].T
            for push in (np.array([0.0, 0.01]), np.array([0.008, 0.008]))
        ]
    )


def _spline(points: np.ndarray, displacement: np.ndarray, normal: np.ndarray, name: str):
    """Add a transform node that takes every point to where the displacement takes it."""
    spline = vtk.vtkThinPlateSplineTransform()
    spline.SetBasisToR()
    # Two sheets beside the plane, with the same displacement: a spline in space needs them.
    sheets = [points, points[::7] + 20 * normal, points[::7] - 20 * normal]
    shifts = [displacement, displacement[::7], displacement[::7]]
    for setter, places in (
        (spline.SetSourceLandmarks, np.vstack(sheets)),
        (spline.SetTargetLandmarks, np.vstack(sheets) + np.vstack(shifts)),
    ):
        landmarks = vtk.vtkPoints()
        landmarks.SetData(numpy_to_vtk(places, deep=True))
        setter(landmarks)
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTransformNode", name)
    node.SetAndObserveTransformToParent(spline)
    return node
