"""What is checked of a mesh from elsewhere before numbers are made of it.

Every function either returns arrays that can be used, with sentences on what was mended, or raises
InputError with one line. They are for the filters and for whoever reads a mesh.
"""

import numpy as np
from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid

from ..errors import InputError
from ..fem import soundness
from ..fem.contact import Pairs, on_two_sides
from ..fem.elements import CELL_TYPES
from ..fem.mesh import plane_frame
from ..results import to_matrices
from .convert import (
    displacement_names,
    get_array,
    has_array,
    information_name,
    mesh_blocks,
    mesh_points,
    mesh_to_vtk,
    set_array,
)

GHOSTS = "vtkGhostType"
DUPLICATE, HIDDEN = 1, 32  # bits of vtkGhostType of a cell that is another process' or blanked
NEAR_WHOLE = 1e-3
SAME = 1e-4  # of the largest displacement: what two copies of a node may differ by
ABSURD = 1e100  # no coordinate: its square would be no number


def sound_mesh(
    grid: vtkUnstructuredGrid, slip: Pairs = ()
) -> tuple[vtkUnstructuredGrid, list[str]]:
    """Return the mesh with what can be mended mended, and a sentence for each mending.

    Nodes at one place on the two sides of `slip`, pairs of labels, are as they should be.

    Ghost cells are taken out; nodes that are stored twice at one place, with the same displacement,
    become one; cells in several pieces are said.

    Raises
    ------
    InputError
        Cells overlap: more than two at one side, or neighbours on the same side of it.
    """
    notes = []
    grid = _without_ghosts(grid, notes)
    blocks, order = mesh_blocks(grid)
    if len({CELL_TYPES[kind].dim for kind, _ in blocks}) > 1:
        raise InputError("the mesh mixes planar and solid cells: keep cells of one dimension")
    points = mesh_points(grid)
    corners = points[np.concatenate([nodes.ravel() for _, nodes in blocks])]
    if not (np.abs(corners) < ABSURD).all():
        raise InputError(
            "the position of a node is not a number, or absurdly large: repair the mesh"
        )
    slides = _across_slip(grid, blocks, order, slip)
    first = soundness.coincident(points, blocks, joined=slides and (lambda p: ~slides(p)))
    doubled = first != np.arange(len(points))
    if doubled.any():
        if _move_together(grid, first):
            notes.append(
                f"{np.count_nonzero(doubled)} nodes were stored twice at the same place (a seam); "
                "they became one each."
            )
            grid = _merged(grid, first)
            blocks, order = mesh_blocks(grid)
            points = mesh_points(grid)
        else:
            notes.append(
                f"{np.count_nonzero(doubled)} nodes lie at the same place as another and move "
                "differently: the cells on the two sides are not connected there."
            )
    touching = blocks
    if slides := _across_slip(grid, blocks, order, slip):
        opposite = soundness.coincident(points, blocks, joined=slides)
        touching = [(kind, opposite[nodes]) for kind, nodes in blocks]
    count, part = soundness.pieces(len(points), touching)
    if count > 1:
        sizes = np.sort(np.bincount(part))[::-1]
        notes.append(
            f"The mesh is in {count} pieces that share no node (of {_listed(sizes)} cells): no "
            "force goes from one to another, so each needs known cells of its own."
        )
    _refuse_overlaps(points, blocks, order)
    return _with_whole_labels(grid), notes


def cell_labels(grid: vtkUnstructuredGrid) -> np.ndarray | None:
    """Return the cell array ``Label``, (n_cells,) int; None if there is none.

    Labels stored as floats are rounded when they are within 0.001 of a whole number.

    Raises
    ------
    InputError
        Labels that are no whole numbers, not finite or too large.
    """
    cells = grid.GetCellData()
    if not has_array(cells, "Label"):
        return None
    values = get_array(cells, "Label")
    if values.ndim != 1:
        raise InputError(f"the cell array 'Label' has {values.shape[1]} components: one is needed")
    if values.dtype.kind in "iu":
        bad = values > np.iinfo(np.int32).max
        whole = values
    else:
        whole = np.rint(np.nan_to_num(values, nan=0.5, posinf=0.5, neginf=0.5))
        bad = ~(np.abs(values - whole) <= NEAR_WHOLE) | (np.abs(whole) > np.iinfo(np.int32).max)
    if bad.any():
        cell = int(np.argmax(bad))
        raise InputError(
            f"the label of {np.count_nonzero(bad)} of {len(values)} cells is no whole number, the "
            f"first is cell {cell} with {values[cell]:g}: give every cell the number of its label"
        )
    return whole.astype(int)


def reaction_nodes(grid: vtkUnstructuredGrid) -> np.ndarray | None:
    """Return the point array ``ReactionNodes``, (n,); None if there is none."""
    points = grid.GetPointData()
    if not has_array(points, "ReactionNodes"):
        return None
    values = get_array(points, "ReactionNodes")
    if values.ndim != 1 or not np.isfinite(values).all():
        raise InputError(
            "the point array 'ReactionNodes' must have one number per node, 1 where an outside "
            "body may push, 2 where it may along the normal only, and 0 elsewhere: it has others"
        )
    return values


def information(grid: vtkUnstructuredGrid, trials: list[str]) -> np.ndarray | None:
    """Return (n_trials, n_nodes, 3, 3), or None unless every trial comes with its information.

    Raises
    ------
    InputError
        It has not six components.
    """
    points = grid.GetPointData()
    names = [information_name(name) for name in trials]
    given = [n != t and has_array(points, n) for n, t in zip(names, trials, strict=True)]
    if not given or not all(given):
        return None
    found = []
    for name in names:
        rows = get_array(points, name).astype(float)
        if rows.ndim != 2 or rows.shape[1] != 6:
            raise InputError(
                f"the point array {name!r} must have six components xx, yy, zz, xy, yz, xz"
            )
        found.append(to_matrices(rows))
    return np.stack(found)


def check_unit(
    mesh: vtkUnstructuredGrid,
    displacements: np.ndarray,
    trials: list[str],
    weights: np.ndarray | None = None,
) -> None:
    """Refuse displacements (t, n, 3) that differ by more than the mesh measures: another unit.

    Those of a trial without any weight (t, n, 3, 3) may be anything.
    """
    blocks, _ = mesh_blocks(mesh)
    used = np.unique(np.concatenate([nodes.ravel() for _, nodes in blocks]))
    size = float(np.linalg.norm(np.ptp(mesh_points(mesh)[used], axis=0)))
    for k, (u, name) in enumerate(zip(displacements[:, used], trials, strict=True)):
        if weights is not None and not weights[k].any():
            continue
        spread = float(np.abs(u - u.mean(axis=0)).max(initial=0.0))
        if spread > size > 0:
            raise InputError(
                f"the displacements {name!r} differ by up to {spread:.3g} on a mesh of size "
                f"{size:.3g}: bring both to one unit of length (mm and m?), or give displacements, "
                "not positions"
            )


# ---- mending


def _across_slip(grid, blocks, order, slip):
    """A function that tells which pairs of nodes slide on each other; None where none do."""
    labels = cell_labels(grid) if len(slip) else None
    if labels is None:
        return None
    return on_two_sides(grid.GetNumberOfPoints(), blocks, labels[order], slip)


def _with_whole_labels(grid):
    """Return the grid with labels of whole numbers, for those who read them from the result."""
    labels = cell_labels(grid)
    if labels is None or get_array(grid.GetCellData(), "Label").dtype.kind in "iu":
        return grid
    copy = vtkUnstructuredGrid()
    copy.ShallowCopy(grid)
    set_array(copy.GetCellData(), "Label", labels.astype(np.int32))
    return copy


def _without_ghosts(grid, notes):
    """Return the grid without cells that a parallel run has doubled or blanked out."""
    cells = grid.GetCellData()
    if not has_array(cells, GHOSTS):
        return grid
    ghost = (get_array(cells, GHOSTS).astype(int) & (DUPLICATE | HIDDEN)) != 0
    if not ghost.any():
        return grid
    if ghost.all():
        raise InputError("all cells of the mesh are ghost cells: nothing is left")
    notes.append(
        f"{np.count_nonzero(ghost)} ghost cells (copies for another process, or blanked) were "
        "taken out."
    )
    return _rebuilt(grid, np.flatnonzero(~ghost), np.arange(grid.GetNumberOfPoints()))


def _rebuilt(grid, cells, first):
    """Return a grid of the cells `cells`, their nodes renamed by `first`, with all its data.

    Nodes keep their numbers, except that those which `first` renames go.
    """
    blocks, order = mesh_blocks(grid)
    keep = np.zeros(grid.GetNumberOfCells(), bool)
    keep[cells] = True
    kept_nodes = np.flatnonzero(first == np.arange(len(first)))
    number = np.searchsorted(kept_nodes, first)
    parts, start, ids = [], 0, []
    for kind, nodes in blocks:
        here = order[start : start + len(nodes)]
        start += len(nodes)
        parts.append((kind, number[nodes[keep[here]]]))
        ids.append(here[keep[here]])
    made = mesh_to_vtk(mesh_points(grid)[kept_nodes], [p for p in parts if len(p[1])])
    _copy(grid.GetPointData(), made.GetPointData(), kept_nodes)
    _copy(grid.GetCellData(), made.GetCellData(), np.concatenate(ids))
    made.GetFieldData().ShallowCopy(grid.GetFieldData())
    return made


def _copy(source, target, rows):
    for number in range(source.GetNumberOfArrays()):
        array = source.GetArray(number)
        if array is not None and array.GetName() not in (None, GHOSTS):
            set_array(target, array.GetName(), get_array(source, array.GetName())[rows])


def _move_together(grid, first) -> bool:
    """Tell whether the copies of every node have the same displacements."""
    points = grid.GetPointData()
    for name in displacement_names(grid):
        u = get_array(points, name).astype(float)
        largest = np.nanmax(np.abs(u), initial=0.0)
        if np.nanmax(np.abs(u - u[first]), initial=0.0) > SAME * largest:
            return False
    return True


def _merged(grid, first):
    """Return the grid with each node's copies gone; what may push on one, may push on all."""
    made = _rebuilt(grid, np.arange(grid.GetNumberOfCells()), first)
    if has_array(made.GetPointData(), "ReactionNodes"):
        values = get_array(grid.GetPointData(), "ReactionNodes")
        anywhere = np.zeros(len(first), values.dtype)
        np.maximum.at(anywhere, first, values)
        kept = first == np.arange(len(first))
        set_array(made.GetPointData(), "ReactionNodes", anywhere[kept])
    return made


def _refuse_overlaps(points, blocks, order):
    if CELL_TYPES[blocks[0][0]].dim == 2:
        used = np.unique(np.concatenate([nodes.ravel() for _, nodes in blocks]))
        origin, axes = plane_frame(points[used])
        points = (points - origin) @ axes
    found = soundness.overlaps(points, blocks)
    if found is not None:
        cells, why = found
        raise InputError(
            f"cells overlap: {why}, for {len(cells)} cells, the first is cell {order[cells].min()}"
            ": the mesh is folded or has cells twice there; repair it"
        )


def _listed(numbers, most: int = 5) -> str:
    words = [str(number) for number in numbers[:most]]
    return ", ".join(words) + (" …" if len(numbers) > most else "")
