"""Names of arrays on the wire, and the one place that writes and reads them."""

import json

import numpy as np
from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkIntArray, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkTable

from ..errors import InputError
from ..results import COMPONENTS, MU_IFS, QUANTITIES, is_found, mu_if
from .checks import cell_labels
from .convert import (
    DISPLACEMENT,
    displacement_names,
    get_array,
    get_text,
    has_array,
    information_name,
    mesh_to_vtk,
    set_array,
    set_text,
    to_json,
    vectors,
)
from .frame import write_frame, write_place

DISAGREEMENT = "Disagreement"
KNOWN = ("KnownYoungModulus", "KnownPoissonRatio")
REPORTS = {
    "identification": "IdentificationReport",
    "registration": "RegistrationReport",
    "provenance": "Provenance",
}
"""What a report is about → field data string (JSON)."""


# ---- writing


def write_label_mesh(mesh):
    """Return a vtkUnstructuredGrid of a LabelMesh."""
    grid = mesh_to_vtk(mesh.points, mesh.cells)
    set_array(grid.GetCellData(), "Label", np.asarray(mesh.labels, np.int32))
    grid.GetCellData().SetActiveScalars("Label")  # what a host shows first
    set_array(grid.GetPointData(), "ReactionNodes", np.asarray(mesh.reaction_nodes, np.uint8))
    set_array(grid.GetPointData(), "OuterBorder", mesh.outer_border)
    set_text(grid, "MeshNotes", "\n".join(mesh.notes))
    return grid


def write_displacements(grid, displacements):
    """Put displacements (t, n, 2 or 3) into the mesh, in place of those that it has."""
    data = grid.GetPointData()
    for name in displacement_names(grid):
        for array in (name, information_name(name), name.replace("Displacement", DISAGREEMENT)):
            data.RemoveArray(array)
    for number, displacement in enumerate(displacements, 1):
        set_array(data, f"Displacement_{number}", vectors(np.asarray(displacement, float)))
    write_place(grid)


def write_registration(grid, registration):
    """Put displacements, their information, their disagreement and the report into the mesh."""
    data = grid.GetPointData()
    write_displacements(grid, registration.displacements)
    for number, information in enumerate(registration.information, 1):
        name = f"DisplacementInformation_{number}"
        set_array(data, name, np.asarray(information, float))
        for component, axes in enumerate(COMPONENTS):
            data.GetArray(name).SetComponentName(component, axes)
    if len(registration.information):
        write_frame(grid)
    if registration.disagreement is not None:
        for number, pixels in enumerate(registration.disagreement, 1):
            set_array(data, f"{DISAGREEMENT}_{number}", np.asarray(pixels, float))
    set_text(grid, REPORTS["registration"], to_json(registration.report))


def write_identification(grid, result, order=None):
    """Put an IdentificationResult into the mesh; `order`: each result cell's number in it."""
    n_cells = grid.GetNumberOfCells()
    order = np.arange(n_cells) if order is None else order

    def put(name, values, dtype):
        array = np.empty(n_cells, dtype)
        array[order] = values
        set_array(grid.GetCellData(), name, array)

    for name, quantity in QUANTITIES.items():
        put(name, getattr(result, quantity.field), np.float64)
    grid.GetCellData().SetActiveScalars("Mu")  # what a host shows first
    put("Status", result.status, np.uint8)
    put("SequenceOrder", result.sequence_order, np.int32)
    for name in mu_if_names(grid):
        grid.GetCellData().RemoveArray(name)  # of an earlier run
    for one in (one for one in result.tried if one.result is not None):
        mu = np.where(is_found(one.result.status), one.result.mu, np.nan)
        put(mu_if(one.assumption.key), mu, np.float64)
    for number, residual in enumerate(result.residuals, 1):
        set_array(grid.GetPointData(), f"Residual_{number}", vectors(np.asarray(residual, float)))
    set_text(grid, REPORTS["identification"], to_json(result.report))


def mu_if_names(grid) -> list[str]:
    """Return the cell arrays of μ under other assumptions."""
    cells = grid.GetCellData()
    names = [cells.GetArrayName(number) or "" for number in range(cells.GetNumberOfArrays())]
    return [name for name in names if name in MU_IFS]


def write_outcome(outcome):
    """Return the vtkUnstructuredGrid with everything that the pipeline has found."""
    grid = write_label_mesh(outcome.mesh)
    if outcome.registration is None:
        write_displacements(grid, outcome.displacements)
    else:
        write_registration(grid, outcome.registration)
    write_identification(grid, outcome.result)
    write_provenance(grid, outcome.provenance)
    return grid


def write_provenance(grid, provenance: dict):
    """Put what made the result into the field data."""
    set_text(grid, REPORTS["provenance"], to_json(provenance))


def read_report(grid, about: str) -> dict:
    """Return a report of :data:`REPORTS`, empty where there is none."""
    return json.loads(get_text(grid, REPORTS[about]) or "{}")


# ---- reading


def outer_border_of(grid):
    """Return which nodes are on the body's own border, (n,) bool, or None where nothing says so."""
    points = grid.GetPointData()
    if not has_array(points, "OuterBorder"):
        return None
    return get_array(points, "OuterBorder") > 0.5


def displacement_of(grid, name: str) -> np.ndarray:
    """Return a displacement array, (n, 3)."""
    values = get_array(grid.GetPointData(), name).astype(float)
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise InputError(f"the point array {name!r} holds no vectors: it cannot be a displacement")
    return vectors(values)


def known_of(grid, order, by_label: dict):
    """Return what is known: by label, or, where the mesh says it cell by cell, (n_cells, 2).

    What is said by label is the user's last word, and replaces what the mesh has brought along.
    """
    cells = grid.GetCellData()
    if not any(has_array(cells, name) for name in KNOWN):
        return by_label
    known = np.column_stack([get_array(cells, name) for name in KNOWN]).astype(float)[order]
    labels = cell_labels(grid)
    for label, constants in by_label.items():
        here = np.zeros(1, bool) if labels is None else labels[order] == label
        if not here.any():
            there = () if labels is None else np.unique(labels).tolist()
            raise InputError(
                f"known label {label} does not occur in the mesh, its labels are "
                f"{', '.join(f'{one:g}' for one in there)}"
            )
        known[here] = constants
    return known


def trials_of(grid, chosen=None) -> list[str]:
    """Return the displacement arrays to use, in the order of the trials.

    Parameters
    ----------
    grid : vtkUnstructuredGrid
    chosen : list of str, optional
        All ``Displacement_k`` where not given.
    """
    standard = displacement_names(grid)
    if chosen is None:
        return standard
    others = [name for name in chosen if name not in standard]
    gone = [name for name in others if DISPLACEMENT.match(name)]  # of an earlier input
    return [n for n in standard if n in chosen] + [n for n in others if n not in gone]


# ---- tables


def label_table(grid) -> vtkTable:
    """Return the figures per label of a mesh with results."""
    return rows_to_table(read_report(grid, "identification").get("labels", []))


def rows_to_table(rows: list[dict]) -> vtkTable:
    """Return a vtkTable with a column per key of the rows; None and NaN are NaN."""
    table = vtkTable()
    for name in rows[0] if rows else ():
        values = [row.get(name) for row in rows]
        kinds = {type(value) for value in values if value is not None}
        if kinds <= {bool, int}:
            column = vtkIntArray()
        elif str in kinds:
            column = vtkStringArray()
        else:
            column = vtkDoubleArray()
            values = [float("nan") if value is None else float(value) for value in values]
        column.SetName(name)
        for value in values:
            column.InsertNextValue(value)
        table.AddColumn(column)
    return table
