"""From images, or from displacements, to the map: mesh, register, identify.

One :class:`Job` in, one :class:`Outcome` out, both plain arrays that can be pickled, so that a host
can have the work done by a process in the background (:mod:`elastoidentify.workers.job`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .errors import InputError
from .imaging.image import Image
from .imaging.meshing import LabelMesh, mesh_segmentation
from .inverse.identify import STATUS_IDENTIFIED, STATUS_KNOWN, IdentificationResult, identify
from .progress import Progress, part, silent

SYMMETRIC = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])
"""Where the entries of a symmetric matrix are in its components xx, yy, zz, xy, yz, xz."""

SUMMARY_QUANTITIES = {
    "Lambda": "lam",
    "Mu": "mu",
    "YoungModulus": "young",
    "PoissonRatio": "poisson",
}


@dataclass
class Job:
    """What is to be done.

    Parameters
    ----------
    segmentation : Image
        Labels; 0 is background. One slice, or a volume.
    edge_length : float
        Of the cells, in the world's length unit.
    known : {label: (young, poisson)}
    rest, pushed : Image, list of Image
        One pushed image per trial. Not needed where `displacements` are given.
    rigid_labels, reaction_boxes
        As in :func:`~elastoidentify.imaging.meshing.mesh_segmentation`.
    parameters : str, optional
        elastix parameters, as in :func:`~elastoidentify.imaging.registration.register`.
    mesh : LabelMesh, optional
        Used instead of meshing the segmentation.
    displacements : (t, n, 3), optional
        Of the nodes of `mesh`, rest → pushed; used instead of a registration.
    options : dict
        Keywords of :func:`~elastoidentify.inverse.identify.identify`: method, kinematics, …
    """

    segmentation: Image | None
    edge_length: float
    known: dict[int, tuple[float, float]]
    rest: Image | None = None
    pushed: list[Image] = field(default_factory=list)
    rigid_labels: Sequence[int] = ()
    reaction_boxes: Sequence[Sequence[float]] = ()
    parameters: str | None = None
    mesh: LabelMesh | None = None
    displacements: np.ndarray | None = None
    options: dict = field(default_factory=dict)


@dataclass
class Outcome:
    """What came out. Arrays as in LabelMesh, Registration and IdentificationResult."""

    mesh: LabelMesh
    displacements: np.ndarray
    information: np.ndarray | None
    result: IdentificationResult
    warnings: list[str]


def make_mesh(job: Job, progress: Progress | None = None) -> LabelMesh:
    """Mesh the segmentation of a job."""
    return mesh_segmentation(
        job.segmentation,
        job.edge_length,
        rigid_labels=job.rigid_labels,
        reaction_boxes=job.reaction_boxes,
        progress=progress,
    )


def run(job: Job, progress: Progress | None = None) -> Outcome:
    """Do a job.

    Raises
    ------
    InputError
        One line: what is wrong, where, how to mend it.
    Cancelled
        By the progress callable.
    """
    progress = progress or silent
    mesh = job.mesh or make_mesh(job, part(progress, 0.0, 0.05))
    warnings = list(mesh.notes)
    displacements, information = job.displacements, None
    if displacements is None:
        from .imaging.registration.registration import register

        if job.rest is None or not job.pushed:
            raise InputError("no images: give a rest image and at least one pushed image")
        registration = register(
            job.rest,
            job.pushed,
            mesh.points,
            mesh.cells,
            parameters=job.parameters,
            progress=part(progress, 0.05, 0.7),
        )
        displacements, information = registration.displacements, registration.information
        warnings += registration.report.get("warnings", [])
    result = identify(
        mesh.points,
        cell_blocks(mesh.cells),
        displacements,
        job.known,
        labels=mesh.labels,
        reaction_nodes=mesh.reaction_nodes.astype(bool),
        information=None if information is None else information[..., SYMMETRIC],
        progress=part(progress, 0.7, 1.0),
        **job.options,
    )
    progress(1.0, "done")
    return Outcome(
        mesh,
        np.asarray(displacements),
        information,
        result,
        warnings + result.report.get("warnings", []),
    )


def cell_blocks(cells: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Name the kind of the cells of a label mesh: triangles or tetrahedra."""
    return [({3: "triangle", 4: "tetra"}[cells.shape[1]], cells)]


def summarise(labels: np.ndarray, result: IdentificationResult) -> dict[int, dict[str, float]]:
    """Say for every label how many cells it has, what was found in them, and in how many.

    Returns
    -------
    {label: {"cells", "identified", "Mu mean", "Mu std", "Mu median", "Lambda mean", …}}
        ``identified`` is the share of cells, 0 to 1, that are known or identified; the figures are
        over those cells (std: their spread; NaN where there are none).
    """
    found = np.isin(result.status, (STATUS_KNOWN, STATUS_IDENTIFIED))
    table = {}
    for label in np.unique(labels):
        here = labels == label
        row = {"cells": int(here.sum()), "identified": float(found[here].mean())}
        for name, attribute in SUMMARY_QUANTITIES.items():
            values = getattr(result, attribute)[here & found]
            values = values[np.isfinite(values)]
            for statistic in (np.mean, np.std, np.median):
                row[f"{name} {statistic.__name__}"] = (
                    float(statistic(values)) if len(values) else float("nan")
                )
        table[int(label)] = row
    return table
