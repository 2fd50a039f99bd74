"""The pipeline's steps on VTK's meshes and images: what the filters and the command line do.

`options` is anything that has the options of the step's table: a filter, or a study.
"""

import numpy as np

from .. import pipeline
from ..errors import InputError
from ..provenance import provenance
from .arrays import (
    displacement_of,
    known_of,
    outer_border_of,
    trials_of,
    write_identification,
    write_label_mesh,
    write_provenance,
    write_registration,
)
from .checks import cell_labels, check_unit, information, reaction_nodes, sound_mesh
from .convert import mesh_blocks, mesh_points, simplices
from .frame import follow_frame


def meshed(options, progress=None):
    """Return the mesh of a segmentation as vtkUnstructuredGrid."""
    return write_label_mesh(pipeline.make_mesh(options, progress))


def displaced(mesh, options, progress=None):
    """Return the mesh with the displacements that images show."""
    found = pipeline.measure(
        options,
        mesh_points(mesh),
        simplices(mesh),
        reaction_nodes=reaction_nodes(mesh),
        progress=progress,
    )
    grid = _copied(mesh)
    write_registration(grid, found)
    return grid


def identified(mesh, options, trials=None, inputs=None, progress=None):
    """Return the mesh with the result arrays.

    Parameters
    ----------
    mesh : vtkUnstructuredGrid
    options : has the options of IdentificationOptions
    trials : list of str, optional
        Displacement arrays to use; all ``Displacement_k`` where not given.
    inputs : dict, optional
        For the provenance.
    progress : callable, optional
    """
    mesh, notes = sound_mesh(follow_frame(mesh), options.slip)
    blocks, order = mesh_blocks(mesh)
    trials = trials_of(mesh, trials)
    if not trials:
        raise InputError(
            "no displacements: the mesh needs a point array Displacement_1, and one more per "
            "further trial"
        )
    displacements = np.stack([displacement_of(mesh, name) for name in trials])
    weights = information(mesh, trials)
    check_unit(mesh, displacements, trials, weights)
    labels = cell_labels(mesh)
    result = pipeline.identify_mesh(
        options,
        mesh_points(mesh),
        blocks,
        displacements,
        known=known_of(mesh, order, pipeline.known_by_label(options)),
        labels=None if labels is None else labels[order],
        reaction_nodes=reaction_nodes(mesh),
        outer_border=outer_border_of(mesh),
        information=weights,
        progress=progress,
    )
    result.report["warnings"] = notes + result.report["warnings"]
    grid = _copied(mesh)
    write_identification(grid, result, order)
    write_provenance(grid, provenance(options, inputs))
    return grid


def _copied(mesh):
    grid = mesh.NewInstance()
    grid.ShallowCopy(mesh)
    return grid
