"""From a labelled image to a conforming mesh: triangles for a slice, tetrahedra for a volume.

One module per idea, all plain numpy and scipy:

=================  ==========================================================================
`segmentation`     the public function: checks, one transform to the world, notes for people
`regions`          islands and holes smaller than a cell
`interfaces`       the network of borders between labels: smooth, corners kept, resampled
`triangles`        conforming triangles between the borders
`grading`          how long edges may be away from borders
`lattice`          body-centred cubic tetrahedra, larger where there is room
`tetrahedra`       conforming tetrahedra from a lattice that is pulled onto the borders
`reactions`        nodes where an outside body may push
`quality`          angles, areas, volumes
=================  ==========================================================================
"""

from .segmentation import LabelMesh, mesh_segmentation

__all__ = ["LabelMesh", "mesh_segmentation"]
