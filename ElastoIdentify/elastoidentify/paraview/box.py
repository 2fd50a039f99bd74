"""A box that is drawn with the mouse, as one more reaction box or sliding box.

ParaView's widget of a box moves one position and one length per axis; it has none for a table of
boxes. So the tables stay as they are, and the box in the view is added to the one that is chosen.
"""

from .. import filters
from ..options import Choice, Vector
from ..study import MeshOptions

ADDS = {"reaction": "reaction_boxes", "sliding": "sliding_boxes"}


class SegmentationToTriangleMesh(filters.SegmentationToTriangleMesh):
    __doc__ = filters.SegmentationToTriangleMesh.__doc__

    box_in_view = Choice(
        "none",
        "What the box that is drawn in the view is: one more of the reaction boxes or of the "
        "sliding boxes, or nothing.",
        ("none", *ADDS),
        group="Mesh",
    )
    box_corner = Vector((0.0, 0.0, 0.0), "Corner with the smallest coordinates of that box.")
    box_size = Vector((1.0, 1.0, 1.0), "Lengths of its edges.")

    def choices(self, table):
        """Return the settings of a table, with the box in its place."""
        chosen = super().choices(table)
        if table is MeshOptions and self.box_in_view != "none":
            name = ADDS[self.box_in_view]
            ends = zip(self.box_corner, self.box_size, strict=True)
            box = [x for corner, size in ends for x in sorted((corner, corner + size))]
            setattr(chosen, name, (*getattr(chosen, name), tuple(box)))
        return chosen
