"""Images of a slice with a lesion that the segmentation does not know."""

import importlib.util

import numpy as np

from ..problem import Case, Skip, Truth

TITLE = "Hidden lesion from images, 2-D"
SOURCE = (
    "Our own phantom, at settings that no choice of the product was made on: speckle, 160 "
    "pixels across the block, lesion 4:1 of radius 0.14 in none of the labels, pushed by 5 % "
    "straight and obliquely (neo-Hookean, quadratic quadrilaterals on a finer mesh), Rician "
    "noise; displacements and their information by this product's registration, the same for "
    "every method."
)
LEVELS = ("noise 1 %", "noise 4 %")
QUICK = None


def make(level):
    need_elastix()
    from elastoidentify.imaging.phantom.planar import Inclusion, make_phantom

    lesion = Inclusion(0.42, 0.57, 0.14, 4.0)
    phantom = make_phantom(
        inclusions=[lesion], pixels=160, seed=41, noise=float(level.split()[1]) / 100,
        kinematics="neo-hookean",
    )  # fmt: skip
    return from_phantom(phantom, 10, "neo-hookean")


def need_elastix():
    if importlib.util.find_spec("itk") is None:
        raise Skip("it needs itk-elastix: pip install '.[registration]'")


def from_phantom(phantom, edge, kinematics):
    """Mesh and register a phantom, its inclusions hidden where the segmentation shows them."""
    from elastoidentify.imaging.meshing import mesh_segmentation
    from elastoidentify.imaging.registration.registration import register
    from elastoidentify.pipeline import cell_blocks
    from elastoidentify.results import to_matrices

    labels = phantom.segmentation.array
    named = phantom.materials.items()
    shown = [label for label, one in named if one.name.startswith("inclusion")]
    hidden = phantom.segmentation.with_array(np.where(np.isin(labels, shown), 2, labels))
    mesh = mesh_segmentation(
        hidden, edge * phantom.rest.spacing[0], rigid_labels=phantom.rigid_labels
    )  # fmt: skip
    reaction = mesh.reaction_nodes.astype(bool)
    found = register(
        phantom.rest, phantom.pushed, mesh.points, mesh.cells, reaction_nodes=reaction
    )  # fmt: skip
    ((kind, cells),) = cell_blocks(mesh.cells)
    d = mesh.cells.shape[1] - 1
    E, nu = _at(phantom.young, mesh.points[cells].mean(axis=1)), phantom.materials[2].poisson
    pad = mesh.labels == 1
    known = np.where(pad[:, None], [phantom.materials[1].young, nu], np.nan)
    case = Case(
        mesh.points[:, :d], kind, cells, found.displacements[..., :d], reaction, known, nu,
        kinematics=kinematics, information=to_matrices(found.information)[..., :d, :d],
        axis=d - 1,
    )  # fmt: skip
    lesion = (1.5 * phantom.materials[2].young < E) & ~pad
    regions = {"lesion": lesion, "background": ~lesion & ~pad}
    return case, Truth(E, np.full(len(E), nu), regions)


def _at(image, points):
    """Values of the nearest voxels."""
    index = np.linalg.solve(image.direction * image.spacing, (points - image.origin).T)
    i, j, k = np.rint(index).astype(int)
    return image.array[k, j, i]
