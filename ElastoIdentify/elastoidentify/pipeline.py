"""The pipeline: mesh → register → identify, on plain arrays.

Every host calls :func:`run`, or one of the three steps. What goes in is a
:class:`~elastoidentify.study.Study`, or for a single step anything that has the options of its
table; what comes out can be pickled, so that a host can have the work done by a process in the
background (:mod:`elastoidentify.workers.job`)::

    from elastoidentify.imaging.io import read_image
    from elastoidentify.pipeline import run
    from elastoidentify.study import Study

    study = Study(
        segmentation=read_image("labels.nrrd"), rest=read_image("rest.nrrd"),
        pushed=[read_image("push_1.nrrd"), read_image("push_2.nrrd")],
        edge_length=7.0, known_materials={1: (5000.0, 0.45)}, kinematics="neo-hookean",
    )
    outcome = run(study)
    outcome.result.mu, outcome.result.statistics, outcome.warnings
"""

import time
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from .errors import InputError
from .exploration import check_method, explore, record
from .fem.soundness import node_pieces
from .imaging.meshing import LabelMesh, mesh_segmentation
from .imaging.slices import slice_of_image, slice_with_points
from .inverse.identify import check_input, identify
from .inverse.result import IdentificationResult
from .options import keywords, unused
from .progress import Progress, part, silent
from .provenance import provenance
from .results import to_matrices
from .study import IdentificationOptions, MeshOptions, RegistrationOptions, Study


@dataclass
class Outcome:
    """What came out.

    Attributes
    ----------
    mesh : LabelMesh
    displacements : (t, n, 3)
        Rest → pushed, world axes.
    result : IdentificationResult
    registration : Registration or None
        None where the displacements were given.
    warnings : list of str
        Of all steps, in their order.
    provenance : dict
        JSON-ready, see :func:`~elastoidentify.provenance.provenance`.
    """

    mesh: LabelMesh
    displacements: np.ndarray
    result: IdentificationResult
    registration: object = None
    warnings: list[str] = field(default_factory=list)
    provenance: dict = field(default_factory=dict)


def run(
    study: Study,
    *,
    mesh: LabelMesh | None = None,
    displacements: np.ndarray | None = None,
    registration=None,
    names: Mapping[int, str] | None = None,
    inputs: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Do a whole study.

    Parameters
    ----------
    study : Study
    mesh : LabelMesh, optional
        Used instead of meshing the segmentation.
    displacements : (t, n, 3), optional
        Of the nodes of `mesh`, rest → pushed; used instead of a registration.
    registration : Registration, optional
        Of an earlier run on the same images and `mesh`.
    names : {label: name}, optional
        For the table of labels.
    inputs : {name: fingerprint}, optional
        Of the files that were read, for the provenance.
    progress : callable, optional

    Raises
    ------
    InputError
        One line: what is wrong, where, how to mend it. All that can be found without a registration
        is found before it.
    Cancelled
        By the progress callable.
    """
    progress, start = progress or silent, time.monotonic()
    from_images = displacements is None and registration is None
    if from_images:
        check_images(study)
    if study.segmentation is not None and not study.edge_length:
        study = copy(study)  # the caller's stays; the provenance says what was taken
        study.edge_length = default_edge_length(_meshed(study))
    mesh = mesh or make_mesh(study, part(progress, 0.0, 0.05))
    if from_images:
        check(study, mesh)
        registration = measure(
            study,
            mesh.points,
            mesh.cells,
            reaction_nodes=mesh.reaction_nodes,
            progress=part(progress, 0.05, 0.7),
        )
    if displacements is None:
        displacements = registration.displacements
    result = identify_mesh(
        study,
        mesh.points,
        cell_blocks(mesh.cells),
        displacements,
        labels=mesh.labels,
        reaction_nodes=mesh.reaction_nodes,
        information=None if registration is None else to_matrices(registration.information),
        names=names,
        progress=part(progress, 0.7, 1.0),
    )
    progress(1.0, "done")
    warnings = list(mesh.notes)
    warnings += [] if registration is None else registration.report.get("warnings", [])
    warnings += result.report.get("warnings", [])
    made = provenance(study, inputs, time.monotonic() - start)
    return Outcome(mesh, np.asarray(displacements), result, registration, warnings, made)


# ---- checks


def check_images(study: Study) -> None:
    """Refuse images that no registration could use, before anything is done."""
    images = [image for image in (study.rest, *study.pushed) if image is not None]
    if not study.pushed:
        raise InputError("no images: give a rest image and at least one pushed image")
    if len(images) < 2:
        raise InputError(
            "one image is nothing to compare: add the image at rest, or a second pushed one to "
            "measure from one push to the other"
        )
    names = [] if study.rest is None else ["the rest image"]
    names += [f"pushed image {number}" for number in range(1, len(study.pushed) + 1)]
    for second in range(1, len(images)):
        for first in range(second):
            a, b = images[first].array, images[second].array
            if a is b or (a.shape == b.shape and np.array_equal(a, b)):
                raise InputError(
                    f"{names[first]} and {names[second]} are the same image, voxel by voxel: was "
                    "one file given twice?"
                )


def check(study: Study, mesh: LabelMesh) -> None:
    """Refuse what the identification would refuse after the registration.

    Raises
    ------
    InputError
    """
    check_input(
        mesh.points,
        cell_blocks(mesh.cells),
        known_by_label(study),
        n_trials=len(study.pushed) - (study.rest is None),
        labels=mesh.labels,
        reaction_nodes=mesh.reaction_nodes,
        **keywords(study, IdentificationOptions),
    )
    if study.explore:
        check_method(study.method)


# ---- the three steps


def make_mesh(options: MeshOptions, progress: Progress | None = None) -> LabelMesh:
    """Mesh the segmentation, or one slice of it."""
    if options.segmentation is None:
        raise InputError("no segmentation given: add a labelmap")
    image = _meshed(options)
    chosen = keywords(options, MeshOptions)
    chosen["edge_length"] = chosen["edge_length"] or default_edge_length(image)
    return mesh_segmentation(
        image, **chosen, seen=getattr(options, "rest", None), progress=progress
    )


def _meshed(options: MeshOptions):
    """Return the part of the segmentation that is meshed: all of it, or one slice."""
    image = options.segmentation
    if options.slice_axis == "none":
        return image
    axis = "ijk".index(options.slice_axis)
    index = options.slice_index if options.slice_index >= 0 else image.size[axis] // 2
    return slice_of_image(image, axis, index)


def default_edge_length(image) -> float:
    """Return twelve voxels: the finest edge at which registration still adds information."""
    return 12.0 * min(image.pixel_sides, default=1.0)


def measure(
    options: RegistrationOptions,
    points: np.ndarray,
    cells: np.ndarray,
    *,
    reaction_nodes: np.ndarray | None = None,
    elastix=None,
    progress: Progress | None = None,
):
    """Return the Registration of the images at the mesh's nodes.

    At `reaction_nodes` an outside body touches, and the strain ends. `elastix` is what registers,
    see :func:`~elastoidentify.imaging.registration.register`.

    A planar mesh in a slice of volumes is registered in that slice.
    """
    # scipy.ndimage and more: not for a look at the mesh
    from .imaging.registration import register, register_radiofrequency

    rest, pushed, mask = options.rest, list(options.pushed), options.mask
    if cells.shape[1] == 3:
        rest, pushed, mask = _slices(rest, pushed, mask, points)
    chosen = keywords(options, RegistrationOptions)
    if len(options.slip):
        chosen["sides"] = node_pieces(len(points), cells)
    axis = options.radiofrequency
    measured = register if axis == "none" else partial(register_radiofrequency, axis)
    return measured(
        rest,
        pushed,
        points,
        cells,
        mask=mask,
        reaction_nodes=reaction_nodes,
        **chosen,
        elastix=elastix,
        progress=progress,
    )


def _slices(rest, pushed, mask, points):
    """Return the slices of all images in which a planar mesh lies.

    A volume whose slices lie otherwise than those of the first is put on its grid before.
    """
    from .imaging.registration import on_grid_of

    whole = pushed[0] if rest is None else rest

    def cut(image, name):
        if image is None:
            return None
        try:
            return slice_with_points(image, points)
        except InputError:
            if image is whole or whole.planar_axis is not None:
                raise
            return slice_with_points(on_grid_of(whole, image, name), points)

    names = [f"pushed (trial {number})" for number in range(1, len(pushed) + 1)]
    moved = [cut(image, name) for image, name in zip(pushed, names, strict=True)]
    return cut(rest, "rest"), moved, cut(mask, "mask")


def identify_mesh(
    options: IdentificationOptions,
    points: np.ndarray,
    cells,
    displacements: np.ndarray,
    *,
    known=None,
    names: Mapping[int, str] | None = None,
    progress: Progress | None = None,
    **mesh,
) -> IdentificationResult:
    """Identify on a mesh with displacements.

    Parameters
    ----------
    options : has the options of IdentificationOptions
    points, cells, displacements
        As in :func:`~elastoidentify.identify`.
    known : (n_cells, 2), optional
        E and ν cell by cell, instead of the known materials of the options.
    names : {label: name}, optional
        For the table of labels.
    **mesh
        labels, reaction_nodes, information of :func:`~elastoidentify.identify`.
    """
    known = known_by_label(options) if known is None else known
    explores = getattr(options, "explore", False)
    if explores:
        check_method(options.method)
    chosen = {**mesh, **keywords(options, IdentificationOptions)}
    result = identify(
        points, cells, displacements, known, **chosen,
        progress=part(progress, 0.0, 0.2 if explores else 1.0),
    )  # fmt: skip
    result.report["warnings"] = unused(options, IdentificationOptions) + result.report["warnings"]
    if explores:
        tried = explore(
            points, cells, displacements, known, **chosen, result=result,
            progress=part(progress, 0.2, 1.0),
        )  # fmt: skip
        record(result, tried)
    result.report["labels"] = [
        _with_names_and_units(row, options, result.report["dimension"], names or {})
        for row in result.statistics
    ]
    return result


def _with_names_and_units(row: dict, options, dimension: int, names: Mapping[int, str]) -> dict:
    """Say of a row of the table of labels what it is about, and in which units its figures are."""
    start = {"label": row["label"], "name": names.get(row["label"], "")}
    units = {"unit": options.unit, "size unit": options.length_unit + "²³"[dimension - 2]}
    return start | row | units


def known_by_label(options) -> dict[int, tuple[float, float]]:
    """Return {label: (young, poisson)}."""
    return {label: (young, poisson) for label, young, poisson in options.known_materials}


def cell_blocks(cells: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Name the kind of the cells of a label mesh: triangles or tetrahedra."""
    return [({3: "triangle", 4: "tetra"}[cells.shape[1]], cells)]
