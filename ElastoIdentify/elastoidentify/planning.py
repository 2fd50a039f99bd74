"""Before anybody is imaged: which pushes and which cells would show a lesion of a size.

The segmentation is meshed, tissue of one stiffness is pushed (on a mesh finer than the one that is
judged), the displacements get the errors that a registration has, and the study's own
identification says how small a lesion its map would show
(:mod:`elastoidentify.inverse.visibility`).
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from scipy.spatial import cKDTree

from .errors import InputError
from .fem.assembly import tangent_stiffness
from .fem.constitutive import KINEMATICS
from .fem.elastic_constants import lame_from_young
from .fem.mesh import Mesh
from .imaging.image import Image
from .inverse.border import SLIDES, Frame
from .inverse.conditions import Conditions, conditions
from .pipeline import cell_blocks, default_edge_length, identify_mesh, make_mesh
from .progress import Progress, part, silent
from .study import Study, check_material

NOISE = 0.05  # of a voxel: the error of a registration where there is texture
FEW_PUSHES = 3  # whose combinations are all tried
HARDLY = 1e-12  # of the stiffness, by which a body that slides on all sides is held where it is
MOST_CELLS = {2: 60_000, 3: 60_000}  # of the finer mesh on which the push is computed


@dataclass(frozen=True)
class Seen:
    """What one choice of cells and pushes would show.

    Attributes
    ----------
    edge_length : float
    cells : int
    pushes : tuple of int
        Which pushes, from 1.
    noise : float
        Standard deviation of a displacement component that was assumed.
    typical, worst : float or None
        Smallest visible diameter at half of the places, and wherever it was looked; None: a lesion
        of no size is seen there.
    here : float or None
        At the place that was asked for, else as `typical`.
    """

    edge_length: float
    cells: int
    pushes: tuple[int, ...]
    noise: float
    typical: float | None
    worst: float | None
    here: float | None


def plan(
    study: Study,
    pushes: Sequence[tuple[int, Sequence[float]]],
    *,
    tissue: tuple[float, float] | None = None,
    edge_lengths: Sequence[float] = (),
    place: Sequence[float] | None = None,
    progress: Progress | None = None,
) -> list[Seen]:
    """Return what each edge length and each set of pushes would show.

    Parameters
    ----------
    study : Study
        Segmentation, known materials, rigid labels, and choices of the identification; no images.
        Its noise is the error of the displacements, by default 0.05 of the smallest voxel.
    pushes : sequence of (label, displacement)
        Per trial the rigid label that pushes, and its motion in the world (3,), length. The other
        rigid bodies stand still.
    tissue : (E, ν), optional
        Of all unknown labels; by default as the first known material.
    edge_lengths : sequence of float, optional
        By default the study's own.
    place : (3,), optional
        Where a lesion is expected, in the world.
    progress : callable, optional

    Raises
    ------
    InputError
    """
    progress = progress or silent
    _check(study, pushes, place)
    known = {int(row[0]): tuple(row[1:]) for row in study.known_materials}
    tissue = check_material(*tissue, "the tissue") if tissue else next(iter(known.values()))
    image = study.segmentation
    noise = study.noise or NOISE * image.pixel_sides.min()
    sets = _sets(len(pushes))
    lengths = [one or default_edge_length(image) for one in edge_lengths or [study.edge_length]]
    study = copy(study)  # the caller's keeps its edge length and noise
    study.noise = noise
    rows = []
    for k, length in enumerate(lengths):
        study.edge_length = length
        step = part(progress, k / len(lengths), (k + 1) / len(lengths))
        mesh = make_mesh(study, part(step, 0.0, 0.05))
        frame = Frame(mesh.points, cell_blocks(mesh.cells))
        moduli = np.array([known.get(label, tissue) for label in mesh.labels.tolist()])
        u = np.array([_push(frame, study, mesh, moduli, *one) for one in pushes])
        u += noise * np.random.default_rng(0).standard_normal(u.shape)
        u = frame.to_world(u)
        for j, chosen in enumerate(sets):
            result = identify_mesh(
                study, mesh.points, cell_blocks(mesh.cells), u[[n - 1 for n in chosen]],
                labels=mesh.labels, reaction_nodes=mesh.reaction_nodes, look_at=place,
                progress=part(step, 0.1 + 0.9 * j / len(sets), 0.1 + 0.9 * (j + 1) / len(sets)),
            )  # fmt: skip
            rows.append(_row(length, mesh, chosen, noise, result))
    progress(1.0, "planned")
    return rows


def _row(length, mesh, chosen, noise, result):
    seen = result.report.get("smallest_visible")
    if seen is None:
        raise InputError(
            "what would be seen is known of maps of cells by the regularized method: choose method "
            "'regularized' and grouping 'cell'"
        )
    return Seen(
        length, len(mesh.cells), chosen, noise, seen["typical"], seen["worst"], seen["here"]
    )


def _check(study: Study, pushes, place) -> None:
    if study.segmentation is None:
        raise InputError("no segmentation given: add a labelmap")
    if not study.known_materials:
        raise InputError("no known material: name the pad's label, Young's modulus and ratio")
    if not pushes:
        raise InputError("no pushes: name a rigid label and its motion for each trial")
    for label, motion in pushes:
        if label not in study.rigid_labels:
            raise InputError(
                f"push by label {label}: it is not rigid; the rigid labels are "
                f"{', '.join(map(str, study.rigid_labels)) or 'none'}"
            )
        if len(motion) != 3 or not np.isfinite(motion).all() or not np.any(motion):
            raise InputError(f"push {motion}: give three finite numbers, not all of them zero")
    if place is not None and (len(place) != 3 or not np.isfinite(place).all()):
        raise InputError(f"place {place}: give three coordinates in the world")


def _sets(n: int) -> list[tuple[int, ...]]:
    """Sets of trials: all of them where they are few, else each alone and all together."""
    if n <= FEW_PUSHES:
        return [one for m in range(1, n + 1) for one in combinations(range(1, n + 1), m)]
    return [*((k,) for k in range(1, n + 1)), tuple(range(1, n + 1))]


def _push(frame: Frame, study: Study, mesh, moduli, label: int, motion) -> np.ndarray:
    """Displacements (n_nodes, d) of the nodes when a rigid label moves and the others stand."""
    marks = mesh.reaction_nodes
    held = frame.anywhere(marks != 0)
    sticking = frame.anywhere((marks != 0) & (marks != SLIDES))
    moving = held.copy()
    moving[held] = _touches(study.segmentation, mesh.points[frame.nodes[held]], label)
    if not moving.any():
        raise InputError(f"push by label {label}: it touches no node of the mesh")
    motion = np.asarray(motion, float)
    wanted = np.zeros((frame.mesh.n_nodes, frame.mesh.dim))
    wanted[moving] = motion if frame.axes is None else motion @ frame.axes
    fine, parent, between = frame.mesh, np.arange(frame.mesh.n_cells), sp.identity(len(held))
    children = {2: 4, 3: 8}[fine.dim]
    if fine.n_cells * children <= MOST_CELLS[fine.dim]:
        fine, parent, between = fine.refined()
    held = between @ held.astype(float) > 1 - 1e-9
    sliding = held & (between @ sticking.astype(float) < 1 - 1e-9)
    there = conditions(fine, held, sliding, mesh.labels[parent], study.slip)
    u = balanced(fine, *lame_from_young(*moduli[parent].T), there, between @ wanted)
    return u[: frame.mesh.n_nodes]


def balanced(mesh: Mesh, lam, mu, there: Conditions, wanted: np.ndarray) -> np.ndarray:
    """Return the displacements in small strain of a body whose held nodes are moved.

    Parameters
    ----------
    lam, mu : (n_cells,)
    there : Conditions
        Which motions are held, and which are free: along those the forces balance.
    wanted : (n_nodes, d)
        Of the held motions.

    Returns
    -------
    (n_nodes, d)
    """
    K = tangent_stiffness(mesh, KINEMATICS["small-strain"], np.zeros_like(wanted), lam, mu)
    held = there.held @ (there.held.T @ wanted.ravel())
    F = there.free
    free = F.T @ K @ F
    hardly = HARDLY * free.diagonal().max() * sp.identity(free.shape[0])
    u = held - F @ spl.spsolve((free + hardly).tocsc(), F.T @ (K @ held))
    return u.reshape(wanted.shape)


def _touches(image: Image, points: np.ndarray, label: int) -> np.ndarray:
    """Tell which points (n, 3) lie nearer to a voxel of a label than two voxels."""
    voxels = np.argwhere(image.array == label)[:, ::-1]
    tree = cKDTree(image.index_to_world(voxels))
    return tree.query(points)[0] < 2 * image.pixel_sides.max()


def plan_rows(rows: Sequence[Seen], unit: str = "mm") -> list[Mapping[str, object]]:
    """Return the rows of a table for people and files; inf where no lesion would be seen."""

    def size(value):
        return float("inf") if value is None else value

    return [
        {
            f"edge length ({unit})": one.edge_length,
            "cells": one.cells,
            "pushes": "+".join(map(str, one.pushes)),
            f"noise ({unit})": one.noise,
            f"smallest lesion there ({unit})": size(one.here),
            f"smallest lesion, typical ({unit})": size(one.typical),
            f"smallest lesion, everywhere ({unit})": size(one.worst),
        }
        for one in rows
    ]
