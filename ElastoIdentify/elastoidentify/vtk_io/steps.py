"""The pipeline's steps on VTK's meshes and images: what the filters and the command line do.

`options` is anything that has the options of the step's table: a filter, or a study.
"""

import numpy as np

from .. import pipeline
from ..errors import InputError
from ..provenance import provenance
from .arrays import (
    displacement_of,
    information_of,
    known_of,
    labels_of,
    reaction_nodes_of,
    trials_of,
    write_identification,
    write_label_mesh,
    write_provenance,
    write_registration,
)
from .convert import mesh_blocks, mesh_points, simplices


def meshed(options, progress=None):
    """Return the mesh of a segmentation as vtkUnstructuredGrid."""
    return write_label_mesh(pipeline.make_mesh(options, progress))


def displaced(mesh, options, progress=None):
    """Return the mesh with the displacements that images show."""
    found = pipeline.measure(options, mesh_points(mesh), simplices(mesh), progress)
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
    blocks, order = mesh_blocks(mesh)
    trials = trials_of(mesh, trials)
    if not trials:
        raise InputError(
            "no displacements: the mesh needs a point array Displacement_1, and one more per "
            "further trial"
        )
    result = pipeline.identify_mesh(
        options,
        mesh_points(mesh),
        blocks,
        np.stack([displacement_of(mesh, name) for name in trials]),
        known=known_of(mesh, order, pipeline.known_by_label(options)),
        labels=labels_of(mesh, order),
        reaction_nodes=reaction_nodes_of(mesh),
        information=information_of(mesh, trials),
        progress=progress,
    )
    grid = _copied(mesh)
    write_identification(grid, result, order)
    write_provenance(grid, provenance(options, inputs))
    return grid


def _copied(mesh):
    grid = mesh.NewInstance()
    grid.ShallowCopy(mesh)
    return grid
