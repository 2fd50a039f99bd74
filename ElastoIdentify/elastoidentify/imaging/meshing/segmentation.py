"""The public function: a labelled image in, a mesh in the world out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real

import numpy as np

from ...errors import InputError
from ...fem.contact import split_nodes
from ...progress import Progress, part
from ..image import Image
from .fit import fit_notes
from .grading import wanted_edges
from .quality import border_sides, cell_sizes, dihedral_angles, triangle_angles
from .reactions import check_boxes, inside_box, on_image_border
from .regions import remove_islands
from .surroundings import surroundings_notes
from .tetrahedra import mesh_tetrahedra
from .triangles import mesh_triangles

MOST_CELLS = 2_000_000
MOST_GRADING = 8  # times the edge length
WRONG_SIZE = 0.03  # relative error of a label's area or volume; beyond it, the notes say so
STICKS, SLIDES = 1, 2  # marks of reaction nodes
NEAR_WHOLE = 1e-3  # labels stored as floats may be off a whole number by so much
POOR_ANGLE = {2: 25.0, 3: 10.0}  # degrees; below it, the notes say so


@dataclass
class LabelMesh:
    """A conforming mesh with one label per cell.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        World coordinates, in the length unit of the image.
    cells : ndarray of int, shape (m, 3) or (m, 4)
        Triangles or tetrahedra. Tetrahedra have positive volume; triangles run counter-clockwise
        seen from where the largest component of their plane's normal points to (for a slice in the
        xy plane: counter-clockwise in x, y).
    labels : ndarray of int32, shape (m,)
    reaction_nodes : ndarray of uint8, shape (n,)
        1 where an outside body may push, so that no force balance may be asked of the node; 2 where
        it may along the normal only, because tissue slides on it.
    notes : list of str
        Sentences for people: what was left out, and where the mesh is poor.
    """

    points: np.ndarray
    cells: np.ndarray
    labels: np.ndarray
    reaction_nodes: np.ndarray
    notes: list[str] = field(default_factory=list)

    @property
    def outer_border(self) -> np.ndarray:
        """1 for the nodes of the mesh's border: what is cut off later is told by it. (n,) uint8"""
        border = np.zeros(len(self.points), np.uint8)
        border[border_sides(self.cells)[0]] = 1
        return border


def mesh_segmentation(
    segmentation: Image,
    edge_length: float,
    *,
    grading: float = 1.0,
    rigid_labels: int | Sequence[int] = (),
    reaction_boxes: Sequence[Sequence[float]] = (),
    sliding_labels: int | Sequence[int] = (),
    sliding_boxes: Sequence[Sequence[float]] = (),
    slip: Sequence[tuple[int, int]] = (),
    border_reactions: bool = True,
    seen: Image | None = None,
    progress: Progress | None = None,
) -> LabelMesh:
    """Cover the labels of a segmentation with a conforming mesh that follows their borders.

    Parameters
    ----------
    segmentation : Image
        Labels, whole numbers; 0 is background. One slice of any orientation gives triangles in its
        plane, a volume gives tetrahedra. Labels reach to the outer edge of their voxels, also at
        the image border.
    edge_length : float
        Edge length of the cells, in world units (usually mm).
    grading : float
        How many times longer edges may be away from the borders between labels: 1 (everywhere the
        same), 2, 4 or 8; of other numbers the power of two below counts. They grow as they are far
        from a border: see `grading.wanted_edges`.
    rigid_labels : int or sequence of int
        Labels of bodies that do not deform (floor, indenter). They get no cells; the nodes they
        share with other labels become reaction nodes.
    reaction_boxes : sequence of (x0, x1, y0, y1) or (x0, x1, y0, y1, z0, z1)
        World boxes whose nodes become reaction nodes.
    sliding_labels : int or sequence of int
        Those of the rigid labels on which tissue slides without friction.
    sliding_boxes : as reaction_boxes
        World boxes in whose nodes an outside body pushes along the normal only. Where it may also
        push otherwise, that counts.
    slip : sequence of (label, label)
        Labels that slide on each other without friction: each gets nodes of its own along their
        interface. At its ends inside the body both keep one node.
    border_reactions : bool
        Whether nodes on the image border become reaction nodes: what lies beyond is not seen and
        may push.
    seen : Image, optional
        The image that was segmented (the rest image). The border of a labelmap that was cropped
        inside it is free surface, and a labelmap that does not fit it is noted; so is where the
        image goes on beyond a free border as it does inside.
    progress : callable, optional

    Raises
    ------
    InputError
        If the segmentation holds no label, or values that are no labels; if the edge length is not
        positive, larger than every region, or gives more than two million cells; if the grading is
        below 1 or above 8; if a rigid label is absent or a box is malformed.
    """
    progress = part(progress, 0.0, 1.0)
    labels = checked_labels(segmentation)
    boxes = [("Reaction", *box) for box in enumerate(check_boxes(reaction_boxes), 1)]
    boxes += [("Sliding", *box) for box in enumerate(check_boxes(sliding_boxes, "sliding box"), 1)]
    rigid_labels = np.atleast_1d(rigid_labels).tolist()
    check_rigid(labels, rigid_labels)
    sliding_labels = np.atleast_1d(sliding_labels).tolist()
    check_contact(labels, rigid_labels, sliding_labels, slip)
    check_grading(grading)
    smallest = check_edge_length(labels, segmentation, edge_length, grading)

    progress(0.0, "Islands")
    labels, removed = remove_islands(labels, smallest)
    notes = fit_notes(segmentation, seen) if seen is not None else []
    notes += island_notes(removed, edge_length)
    if segmentation.planar_axis is None:
        points, cells, cell_labels = mesh_tetrahedra(
            labels, segmentation.spacing, edge_length, part(progress, 0.02, 0.95), grading
        )
        index = points / segmentation.spacing
    else:
        across = segmentation.planar_axis
        along = [axis for axis in range(3) if axis != across]
        plane, cells, cell_labels = mesh_triangles(
            labels.squeeze(2 - across),
            segmentation.spacing[along],
            edge_length,
            part(progress, 0.02, 0.95),
            grading,
        )
        index = np.zeros((len(plane), 3))
        index[:, along] = plane / segmentation.spacing[along]
    points = segmentation.index_to_world(index)
    cells = oriented(points, cells)
    voxel = np.delete(segmentation.spacing, [] if cells.shape[1] == 4 else across).prod()
    notes += size_notes(labels, voxel, points, cells, cell_labels)

    sticks, slides = np.zeros((2, len(points)), bool)
    rigid = np.isin(cell_labels, rigid_labels)
    if rigid.all():
        raise InputError(
            f"only rigid labels are large enough for edge length {edge_length:g}: use a smaller one"
        )
    used, kept = np.unique(cells[~rigid], return_inverse=True)
    for label in rigid_labels:
        shared = np.intersect1d(cells[cell_labels == label], used)
        (slides if label in sliding_labels else sticks)[shared] = True
        if not len(shared):
            notes.append(f"Rigid label {label} touches no other label: it holds no node.")
    cell_labels = cell_labels[~rigid]
    cells, origin = split_nodes(kept.reshape(len(cell_labels), -1), cell_labels, slip)
    used = used[origin]
    points, sticks, slides = points[used], sticks[used], slides[used]
    notes += slip_notes(cells, cell_labels, slip)
    if border_reactions:
        sticks |= on_image_border(points, segmentation, seen)
    for kind, number, bounds in boxes:
        inside = inside_box(points, bounds, 1e-6 * edge_length)
        (slides if kind == "Sliding" else sticks)[inside] = True
        if not inside.any():
            notes.append(f"{kind} box {number} holds no node of the mesh.")
    reaction = np.where(sticks, STICKS, np.where(slides, SLIDES, 0))
    if not reaction.any():
        notes.append(
            "No node is a reaction node: every node is taken to be free of outside forces."
        )
    if seen is not None:
        notes += surroundings_notes(points, cells, reaction, seen)
    notes += quality_notes(points, cells)
    progress(1.0, "Mesh")
    return LabelMesh(points, cells, cell_labels.astype(np.int32), reaction.astype(np.uint8), notes)


def checked_labels(segmentation: Image) -> np.ndarray:
    """Return the labels as int32, or raise `InputError`."""
    values = segmentation.array
    if not ((segmentation.spacing > 0) & np.isfinite(segmentation.spacing)).all():
        raise InputError(
            f"the segmentation has the voxel spacing {segmentation.spacing.tolist()}: give lengths "
            "above 0"
        )
    if values.dtype.kind not in "buif":
        raise InputError(
            f"the segmentation has values of type {values.dtype}: labels are whole numbers"
        )
    if not np.isfinite(values).all():
        raise InputError(
            "the segmentation has values that are not finite: set background voxels to 0"
        )
    if values.dtype.kind == "f":
        whole = np.rint(values)
        if (np.abs(values - whole) > NEAR_WHOLE).any():
            raise InputError(
                "the segmentation has fractional values: give a labelmap with whole numbers, not "
                "an image or a probability map"
            )
        values = whole
    if values.size and values.min() < 0:
        raise InputError(
            f"the segmentation has negative labels (down to {values.min():g}): use 0 for "
            "background and numbers above 0 for labels"
        )
    if not values.any():
        raise InputError("the segmentation has no label above 0: there is nothing to mesh")
    if values.max() > np.iinfo(np.int32).max:
        raise InputError(f"the segmentation has a label too large for a mesh ({values.max():g})")
    return values.astype(np.int32)


def check_rigid(labels: np.ndarray, rigid_labels: Sequence[int]) -> None:
    """Raise `InputError` unless the rigid labels are there and leave something to mesh."""
    present = [int(label) for label in np.unique(labels) if label > 0]
    absent = [label for label in rigid_labels if label not in present]
    if absent:
        raise InputError(
            f"rigid label {absent[0]} is not in the segmentation, which has {named(present)}"
        )
    if set(present) <= set(rigid_labels):
        raise InputError("all labels are rigid: nothing is left to mesh")


def check_contact(labels, rigid_labels, sliding_labels, slip) -> None:
    """Raise `InputError` for a sliding label that is not rigid, or a slip of none or one label."""
    for label in sliding_labels:
        if label not in rigid_labels:
            raise InputError(
                f"sliding label {label} is not rigid: name it among the rigid labels, too, or give "
                "the pair of labels that slide on each other in slip"
            )
    for first, second in slip:
        for label in (first, second):
            if label in rigid_labels:
                raise InputError(
                    f"slip {first}:{second}: label {label} is rigid: name it in the sliding labels"
                )
            if not (labels == label).any():
                raise InputError(
                    f"slip {first}:{second}: label {label} is not in the segmentation, which has "
                    f"{named(np.unique(labels[labels > 0]))}"
                )


def slip_notes(cells: np.ndarray, cell_labels: np.ndarray, slip) -> list[str]:
    """Return a sentence per pair of labels that still share nodes."""
    notes = []
    for first, second in slip:
        one, other = (np.unique(cells[cell_labels == label]) for label in (first, second))
        shared = len(np.intersect1d(one, other))
        if shared:
            notes.append(
                f"Labels {first} and {second} slide on each other but share {shared} nodes, where "
                "their interface ends inside the body."
            )
    return notes


def check_edge_length(
    labels: np.ndarray, segmentation: Image, edge_length: float, grading: float = 1.0
) -> float:
    """Return the voxels of one cell, or raise `InputError`."""
    if not (isinstance(edge_length, Real) and 0 < edge_length < np.inf):
        raise InputError(f"edge length is {edge_length}: give a length above 0 in world units")
    dimension = 3 if segmentation.planar_axis is None else 2
    sizes = np.delete(segmentation.spacing, [] if dimension == 3 else segmentation.planar_axis)
    # A cell: the equilateral triangle; the tetrahedron of a body-centred cubic lattice.
    shape = np.sqrt(3) / 4 if dimension == 2 else 1 / 12
    voxels_per_cell = shape * edge_length**dimension / sizes.prod()
    count = np.count_nonzero(labels) / voxels_per_cell
    if count > MOST_CELLS and grading > 1:
        flat = labels if dimension == 3 else labels.squeeze(2 - segmentation.planar_axis)
        longer = wanted_edges(flat, sizes, edge_length, grading)
        count = (longer[flat > 0] ** -float(dimension)).sum() / voxels_per_cell
    if count > MOST_CELLS:
        least = edge_length * (count / MOST_CELLS) ** (1 / dimension)
        raise InputError(
            f"edge length {edge_length:g} would give about {count:.1e} cells: use {least:.2g} or "
            "more"
        )
    largest = np.unique(labels[labels > 0], return_counts=True)[1].max()
    if largest < voxels_per_cell:
        most = edge_length * (largest / voxels_per_cell) ** (1 / dimension)
        raise InputError(
            f"edge length {edge_length:g} is larger than every label: use less than {most:.2g}"
        )
    return voxels_per_cell


def check_grading(grading: float) -> None:
    """Raise `InputError` unless edges may become longer by a sensible factor."""
    if not (isinstance(grading, Real) and 1 <= grading <= MOST_GRADING):
        raise InputError(
            f"grading is {grading}: give how many times longer edges may be away from borders, 1 "
            f"(nowhere) to {MOST_GRADING}"
        )


def oriented(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return cells with positive orientation in the world, as `LabelMesh` says."""
    corners = points[cells]
    edges = corners[:, 1:] - corners[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    if cells.shape[1] == 4:
        size = np.einsum("md,md->m", normal, edges[:, 2])
    else:
        size = normal[:, np.abs(normal.sum(axis=0)).argmax()]
    cells = cells.copy()
    cells[size < 0] = cells[size < 0][:, [1, 0, *range(2, cells.shape[1])]]
    return cells


def island_notes(removed: dict[int, int], edge_length: float) -> list[str]:
    """Return a sentence per label from which small regions were taken."""
    notes = []
    for label, count in removed.items():
        plural, were = ("s", "were") if count > 1 else ("", "was")
        what = f"island{plural} of label {label}" if label else f"hole{plural}"
        notes.append(
            f"{count} {what} smaller than one cell of edge {edge_length:g} {were} given to the "
            "labels around."
        )
    return notes


def size_notes(
    labels: np.ndarray,
    voxel: float,
    points: np.ndarray,
    cells: np.ndarray,
    cell_labels: np.ndarray,
) -> list[str]:
    """Return a sentence per label whose area or volume in the mesh is not that of its voxels."""
    names, voxels = np.unique(labels[labels > 0], return_counts=True)
    number = np.searchsorted(names, cell_labels)
    found = np.bincount(number, cell_sizes(points, cells), len(names)) / (voxels * voxel)
    size = "area" if cells.shape[1] == 3 else "volume"
    notes = []
    for name, ratio in zip(names, found, strict=True):
        if ratio == 0:
            notes.append(f"The mesh has no cell of label {name}: too thin for this edge length.")
        elif abs(ratio - 1) > WRONG_SIZE:
            notes.append(
                f"The {size} of label {name} in the mesh is {100 * (ratio - 1):+.0f} % off that of "
                "its voxels: it is small or thin for this edge length."
            )
    return notes


def quality_notes(points: np.ndarray, cells: np.ndarray) -> list[str]:
    """Return a sentence when cells are poor, with where the worst one is."""
    dimension = cells.shape[1] - 1
    angles = triangle_angles if dimension == 2 else dihedral_angles
    smallest = angles(points, cells).min(axis=1)
    poor = int((smallest < POOR_ANGLE[dimension]).sum())
    if not poor:
        return []
    worst = points[cells[smallest.argmin()]].mean(axis=0)
    kind = "an angle" if dimension == 2 else "a dihedral angle"
    place = ", ".join(f"{value:.4g}" for value in worst)
    return [
        f"{poor} of {len(cells)} cells have {kind} below {POOR_ANGLE[dimension]:g}° (smallest "
        f"{smallest.min():.1f}° at {place}): labels are thin or meet at a sharp angle there; a "
        "smaller edge length helps."
    ]


def named(labels) -> str:
    """Return 'label 3' or 'labels 1, 2, 3'."""
    names = ", ".join(str(int(label)) for label in labels)
    return f"label{'s' if len(labels) > 1 else ''} {names}"
