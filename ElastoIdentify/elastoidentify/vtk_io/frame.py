"""Displacements and their information follow the mesh through VTK's Transform, or it is said.

VTK's filters turn and scale arrays of vectors, if they are told to, but know no symmetric tensors
of six components. So the axes along which the information was written go with the mesh as three
vectors per cell; what became of them is the map A by which displacements were changed, u' = A u,
and with it their inverse covariance, W' = A⁻ᵀ W A⁻¹.

The places at which displacements were measured go along as one more vector per node. Whatever turns
vectors as it turns points, or moves all points alike, leaves one constant distance between both.
"""

import numpy as np

from ..errors import InputError
from ..results import to_components, to_matrices
from .convert import (
    displacement_names,
    get_array,
    has_array,
    information_name,
    mesh_points,
    set_array,
)

FRAME = tuple(f"DisplacementFrame_{axis}" for axis in "xyz")
PLACE = "DisplacementPlace"
SAME = 1e-6
APART = 1e-5  # of the coordinates' size: what files of single precision leave


def write_place(grid):
    """Write where the displacements were measured into the nodes of the mesh."""
    set_array(grid.GetPointData(), PLACE, mesh_points(grid))


def write_frame(grid):
    """Write the axes of the displacements' information into the cells of the mesh."""
    for name, axis in zip(FRAME, np.eye(3), strict=True):
        set_array(grid.GetCellData(), name, np.tile(axis, (grid.GetNumberOfCells(), 1)))


def follow_frame(mesh):
    """Return the mesh with the information of its displacements in today's axes and unit.

    Raises
    ------
    InputError
        The nodes were moved otherwise than the displacements; the mesh was not changed by one
        linear map, or was flattened by it.
    """
    _refuse_moved(mesh)
    cells, points = mesh.GetCellData(), mesh.GetPointData()
    names = [information_name(name) for name in displacement_names(mesh)]
    names = [name for name in names if has_array(points, name)]
    if not names or not mesh.GetNumberOfCells() or not all(has_array(cells, n) for n in FRAME):
        return mesh
    axes = np.stack([get_array(cells, name) for name in FRAME], axis=2)  # (cells, 3, 3)
    if np.abs(axes - np.eye(3)).max() < SAME:
        return mesh
    change = axes[0]
    if np.abs(axes - change).max() > SAME * np.abs(change).max():
        raise InputError(
            "parts of the mesh were transformed differently: transform before the displacements "
            "are measured, or all parts alike"
        )
    if np.linalg.cond(change) > 1 / SAME:
        raise InputError("the mesh was flattened by a transform: keep all its directions")
    back = np.linalg.inv(change)
    followed = mesh.NewInstance()
    followed.ShallowCopy(mesh)
    for name in names:
        rows = back.T @ to_matrices(get_array(points, name).astype(float)) @ back
        set_array(followed.GetPointData(), name, to_components(rows))
    write_frame(followed)
    return followed


def _refuse_moved(mesh):
    points = mesh.GetPointData()
    if not has_array(points, PLACE) or not mesh.GetNumberOfPoints():
        return
    now, then = mesh_points(mesh), get_array(points, PLACE).astype(float)
    moved = now - then
    if np.ptp(moved, axis=0).max() > APART * max(np.abs(now).max(), np.abs(then).max()):
        raise InputError(
            "the nodes of the mesh were moved since the displacements were measured, and the "
            "displacements were not turned with them: in Transform switch on 'Transform All Input "
            "Vectors'; of a mesh that was warped by its displacements give the one at rest"
        )
