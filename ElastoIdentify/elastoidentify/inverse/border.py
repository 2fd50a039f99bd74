"""What users give to the identification, checked and brought into the form of the numerics.

Every function returns arrays that can be used or raises InputError with one line: what, where, how
to mend it. What can be mended without a guess is mended and said.
"""

from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from ..fem import soundness
from ..fem.contact import Pairs, on_two_sides, touching
from ..fem.elements import CELL_TYPES
from ..fem.mesh import Mesh, plane_frame
from ..study import check_material
from .inverted import MOST
from .out_of_plane import Stretch

NEAR_WHOLE = 1e-3  # what a label stored as a float may be off
SAME = 1e-4  # of the largest displacement: what two copies of a node may differ by
SKEW = 1e-6  # of a tensor's size: what rounding leaves of asymmetry, or below zero
SLIDES = 2  # mark of a reaction node on which an outside body slides
FARTHEST = 1e15  # sizes of the mesh that displacements may reach; beyond, digits are lost
MOST_STRETCH, WIDEST_STRETCH = 0.5, 0.1  # out of the plane, and its standard deviation


def numbers(values, what: str) -> np.ndarray:
    """Return values as a float array; refuse what would lose its meaning on the way."""
    masked = int(np.ma.count_masked(values)) if np.ma.isMaskedArray(values) else 0
    if masked:
        raise InputError(
            f"{what}: {masked} values are masked, and every value is needed: fill them, or leave "
            "out what they belong to"
        )
    try:
        array = np.asarray(values)
        if array.dtype.kind == "c" and (array.imag == 0).all():
            array = array.real
        if array.dtype.kind == "O":
            array = array.astype(float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: this is no array of numbers ({error})") from error
    if array.dtype.kind not in "fiub":
        kind = "complex numbers" if array.dtype.kind == "c" else f"of type {array.dtype}"
        raise InputError(f"{what}: real numbers are needed, these are {kind}")
    return array.astype(float)


def whole_numbers(values, what: str, near: float = 0.0) -> np.ndarray:
    """Return values as int; refuse those that are further than `near` from a whole number."""
    array = numbers(values, what)
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(array - np.rint(array)) <= near) | ~(np.abs(array) < 2**53)
    if bad.any():
        first = np.argwhere(bad)[0]
        raise InputError(
            f"{what}: whole numbers are needed, {np.count_nonzero(bad)} of {array.size} are none, "
            f"the first is {array[tuple(first)]:g} at {', '.join(map(str, first))}"
        )
    return np.rint(array).astype(int)


# ---- the mesh


class Frame:
    """The mesh in its own dimension, and the way of nodal values into it and back.

    The mesh has the nodes that belong to cells, each place once; what is given and what is returned
    has all nodes in the order given.

    Attributes
    ----------
    mesh : Mesh
    n_given : int
        Number of the nodes given.
    nodes : (n_nodes,) int
        The mesh's nodes among those given.
    ends : (e, 2) int
        Nodes given that are neighbours in a cell.
    notes : list of str
    """

    def __init__(self, points, cells):
        points = numbers(points, "points")
        if points.ndim != 2 or points.shape[1] not in (2, 3):
            raise InputError(f"points must have shape (n, 2) or (n, 3), these have {points.shape}")
        self._blocks, dim = _blocks(points, cells)
        self.n_given, self.world_dim = points.shape
        self.axes, self.origin, self.notes = None, np.zeros(self.world_dim), []
        used = _used(self._blocks)
        bad = used[~np.isfinite(points[used]).all(axis=1)]
        if len(bad):
            raise InputError(
                f"the position of node {bad[0]} is not a finite number: repair the mesh"
            )
        if self.world_dim == 3 and dim == 2:
            self.origin, self.axes = plane_frame(points[used])
            points = (points - self.origin) @ self.axes
            if _turn_clockwise(points, self._blocks):
                self.axes = self.axes * [-1, 1]
                points = points * [-1, 1]
        self._points, self._first = points, np.arange(self.n_given)
        self.ends = soundness.edges(self.blocks)
        self._make_mesh()

    def _make_mesh(self):
        self.nodes = _used(self._blocks)
        self.mesh = Mesh(
            self._points[self.nodes],
            [(kind, np.searchsorted(self.nodes, nodes), ids) for kind, nodes, ids in self._blocks],
        )

    @property
    def blocks(self) -> list[tuple[str, np.ndarray]]:
        """The cells by kind, with the numbers of the nodes given."""
        return [(kind, nodes) for kind, nodes, _ in self._blocks]

    @property
    def size(self) -> float:
        """Diagonal of the box around the mesh."""
        return float(np.linalg.norm(np.ptp(self.mesh.points, axis=0)))

    def centres(self, points) -> np.ndarray:
        """Return the mean of each cell's nodes in the coordinates of the points given."""
        points = numbers(points, "points")
        found = np.empty((self.mesh.n_cells, points.shape[1]))
        for _, nodes, ids in self._blocks:
            found[ids] = points[nodes].mean(axis=1)
        return found

    def close_seams(self, vectors: np.ndarray, labels=None, slip: Pairs = ()) -> None:
        """Let nodes at one place be one where they move as one; vectors (t, n_given, c).

        Nodes on the two sides of `slip`, pairs of labels, stay two.
        """
        joined = None
        if len(slip):
            in_order = labels[np.concatenate([ids for _, _, ids in self._blocks])]
            slides = on_two_sides(self.n_given, self.blocks, in_order, slip)
            joined = lambda pairs: ~slides(pairs)  # noqa: E731
        first = soundness.coincident(self._points, self.blocks, joined=joined)
        n_doubled = np.count_nonzero(first != np.arange(len(first)))
        if not n_doubled:
            return
        used = vectors[:, self.nodes]
        apart = np.abs(used - vectors[:, first[self.nodes]]).max(axis=(1, 2), initial=0.0)
        if (apart > SAME * np.abs(used).max(axis=(1, 2), initial=0.0)).any():
            self.notes.append(
                f"{n_doubled} nodes lie at the place of another and move differently: the cells on "
                "the two sides are not connected there (if they slide on each other, name their "
                "labels in slip)"
            )
            return
        self.notes.append(
            f"{n_doubled} nodes were stored twice at one place (a seam) and count as one"
        )
        self._first = first
        self._blocks = [(kind, first[nodes], ids) for kind, nodes, ids in self._blocks]
        self._make_mesh()

    def anywhere(self, marked: np.ndarray) -> np.ndarray:
        """Tell for the mesh's nodes whether one of the nodes given there is marked. (n_nodes,)"""
        found = np.zeros(self.n_given, bool)
        np.logical_or.at(found, self._first, marked)
        return found[self.nodes]

    def place(self, point) -> np.ndarray:
        """Return a point of the world (2,) or (3,) in the mesh's coordinates, (d,)."""
        at = numbers(point, "look_at")
        if at.shape != (self.world_dim,) or not np.isfinite(at).all():
            raise InputError(
                f"look_at is {point!r}: give the {self.world_dim} coordinates of a place"
            )
        return at if self.axes is None else (at - self.origin) @ self.axes

    def to_plane(self, vectors):
        """Displacements (t, n, 2 or 3) in the mesh's dimension; out of plane is dropped, noted."""
        if vectors.shape[-1] == self.mesh.dim:
            return vectors
        if self.axes is None:
            if vectors.shape[-1] != 3 or self.mesh.dim != 2:
                raise InputError(
                    f"displacements have {vectors.shape[-1]} components, the mesh has "
                    f"{self.mesh.dim} dimensions"
                )
            axes = np.eye(3)[:, :2]
        else:
            axes = self.axes
        inside = vectors @ axes
        out = vectors - inside @ axes.T
        size = np.abs(out).max(initial=0.0)
        if size > 1e-9 * np.abs(vectors).max(initial=0.0):
            self.notes.append(
                f"displacements out of the mesh's plane (up to {size:.3g}) were dropped: "
                "a planar mesh knows in-plane motion only"
            )
        return inside

    def tensors_to_plane(self, tensors):
        """Information matrices (t, n, 3, 3) → (t, n, d, d), out-of-plane motion left free."""
        if tensors.shape[-1] == self.mesh.dim:
            return tensors
        axes = np.eye(3)[:, :2] if self.axes is None else self.axes
        return np.einsum("ia,tnij,jb->tnab", axes, tensors, axes)

    def to_world(self, vectors):
        """Vectors (t, n_nodes, d) at all nodes given, in the dimension of the points given.

        Nodes that belong to no cell get zero.
        """
        everywhere = np.zeros((len(vectors), self.n_given, vectors.shape[-1]))
        everywhere[:, self.nodes] = vectors
        everywhere = everywhere[:, self._first]
        return everywhere if self.axes is None else everywhere @ self.axes.T


def _used(blocks):
    return np.unique(np.concatenate([nodes.ravel() for _, nodes, _ in blocks]))


def _blocks(points, cells):
    """Blocks (kind, nodes, ids) and their dimension, from either form of `cells`."""
    if not (isinstance(cells, (list, tuple)) and len(cells) and isinstance(cells[0][0], str)):
        cells = whole_numbers(cells, "cells")
        kinds = {3: "triangle", 8: "hexahedron", 4: "quad" if points.shape[1] == 2 else "tetra"}
        if cells.ndim != 2 or cells.shape[1] not in kinds:
            raise InputError(
                f"cells of shape {cells.shape}: give (n, 3), (n, 4) or (n, 8), or a list of "
                "(kind, array)"
            )
        cells = [(kinds[cells.shape[1]], cells)]
    blocks, start, dims = [], 0, set()
    for kind, nodes in cells:
        choice("cell kind", kind, CELL_TYPES)
        nodes = whole_numbers(nodes, f"{kind} cells")
        if nodes.size == 0:
            continue
        if nodes.ndim != 2 or nodes.shape[1] != CELL_TYPES[kind].n_nodes:
            raise InputError(
                f"{kind} cells of shape {nodes.shape}: expected (n, {CELL_TYPES[kind].n_nodes})"
            )
        if nodes.min() < 0 or nodes.max() >= len(points):
            raise InputError(
                f"{kind} cells refer to nodes {nodes.min()}…{nodes.max()}, but the mesh has "
                f"{len(points)} nodes (counted from 0)"
            )
        blocks.append((kind, nodes, start + np.arange(len(nodes))))
        start += len(nodes)
        dims.add(CELL_TYPES[kind].dim)
    if not start:
        raise InputError(
            "the mesh has no cells: give triangles, quadrilaterals, tetrahedra or hexahedra"
        )
    if len(dims) > 1:
        raise InputError("the mesh mixes planar and solid cells: keep cells of one dimension")
    if dims == {3} and points.shape[1] == 2:
        raise InputError("solid cells need points of three coordinates, these have two")
    return blocks, dims.pop()


def _turn_clockwise(points, blocks):
    """Tell whether most planar cells turn clockwise in the frame chosen."""
    area = 0.0
    for _, nodes, _ in blocks:
        x = points[nodes]
        y = np.roll(x, -1, axis=1)
        area += np.sign((x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]).sum(axis=1)).sum()
    return area < 0


# ---- choices, materials, reaction nodes


def choice(what: str, value, options) -> None:
    """Refuse a value that is none of the options."""
    if value not in options:
        raise InputError(f"{what} {value!r} is unknown: choose one of {', '.join(options)}")


def cell_labels(labels, n_cells: int) -> np.ndarray | None:
    """Return the label of each cell, (n_cells,) int."""
    if labels is None:
        return None
    labels = whole_numbers(labels, "labels", NEAR_WHOLE)
    if labels.shape != (n_cells,):
        raise InputError(f"labels: {labels.shape} values for {n_cells} cells")
    return labels


def known_materials(known, labels, n_cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Return E and ν of each cell, (n_cells,), NaN where they are not known."""
    if isinstance(known, Mapping):
        return _known_by_label(known, labels, n_cells)
    shape = np.shape(known)
    if shape != (n_cells, 2):
        raise InputError(
            f"known materials: shape {shape}, expected ({n_cells}, 2) for E, ν of each cell, or a "
            "mapping {label: (E, ν)}"
        )
    if np.ma.isMaskedArray(known):
        known = known.filled(np.nan)  # masked: not known
    known = numbers(known, "known materials")
    young, poisson = known.T
    half = np.flatnonzero(np.isnan(young) != np.isnan(poisson))
    if len(half):
        missing = "Young's modulus" if np.isnan(young[half[0]]) else "Poisson's ratio"
        raise InputError(
            f"{len(half)} known cell(s), the first is cell {half[0]}, have no {missing}: give both "
            "constants of a known cell, and NaN for both where it is not known"
        )
    good = np.isfinite(young) & (young > 0) & (poisson > -1) & (poisson < 0.5)
    bad = np.flatnonzero(~np.isnan(young) & ~good)
    if len(bad):
        check_material(*known[bad[0]], f"known cell {bad[0]}")
    return young, poisson


def _known_by_label(known, labels, n_cells):
    young, poisson = np.full(n_cells, np.nan), np.full(n_cells, np.nan)
    if known and labels is None:
        raise InputError("known materials are given by label, but the cells have no labels")
    for label, material in known.items():
        try:
            E, nu = (float(value) for value in material)
        except (TypeError, ValueError):
            raise InputError(
                f"known label {label} is given as {material!r}: give the two numbers (Young's "
                "modulus, Poisson's ratio)"
            ) from None
        E, nu = check_material(E, nu, f"known label {label}")
        here = labels == label
        if not here.any():
            raise InputError(
                f"known label {label} does not occur in the mesh, its labels are "
                f"{', '.join(str(v) for v in np.unique(labels)[:20])}"
            )
        young[here], poisson[here] = E, nu
    return young, poisson


def slip_pairs(given, labels: np.ndarray | None) -> list[tuple[int, int]]:
    """Return the pairs of labels that slide on each other."""
    pairs = whole_numbers(given if given is not None and len(given) else np.empty((0, 2)), "slip")
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise InputError(f"slip has shape {pairs.shape}: give pairs of labels, as in ((1, 2),)")
    if len(pairs) and labels is None:
        raise InputError("slip is between labels, but the cells have none")
    for first, second in pairs.tolist():
        if first == second:
            raise InputError(f"slip {first}:{second}: name two labels, which slide on each other")
        for label in (first, second):
            if label not in labels:
                raise InputError(
                    f"slip {first}:{second}: label {label} does not occur in the mesh, its labels "
                    f"are {', '.join(str(v) for v in np.unique(labels)[:20])}"
                )
    return [tuple(pair) for pair in pairs.tolist()]


def check_slip(mesh: Mesh, labels, slip: Pairs) -> None:
    """Refuse pairs of labels that do not touch with nodes of their own."""
    for pair in slip:
        if len(touching(mesh, labels, [pair])[0]):
            continue
        first, second = (mesh.node_cells @ (labels == label) > 0 for label in pair)
        name = "slip {}:{}".format(*pair)
        if (first & second).any():
            raise InputError(
                f"{name}: cells of both labels share {np.count_nonzero(first & second)} nodes, "
                "which cannot slide: mesh the segmentation with the same slip, which gives each "
                "side nodes of its own"
            )
        raise InputError(
            f"{name}: no side of a cell of one label lies on one of the other: the nodes of both "
            "must be at the same places along their interface"
        )


def reaction_nodes(given, n_nodes: int) -> np.ndarray:
    """Return 1 where an outside body may push, 2 where it slides, else 0. (n_nodes,) int"""
    if given is None:
        return np.zeros(n_nodes, int)
    values = numbers(given, "reaction nodes")
    if values.shape != (n_nodes,):
        raise InputError(
            f"reaction nodes: {values.shape} values for {n_nodes} nodes: give one number per node, "
            "1 where an outside body may push and 0 elsewhere"
        )
    missing = np.flatnonzero(np.isnan(values))
    if len(missing):
        raise InputError(
            f"reaction nodes: {len(missing)} of {n_nodes} values are NaN, the first is that of "
            f"node {missing[0]}: give 1 where an outside body may push and 0 elsewhere"
        )
    return np.where(values == SLIDES, SLIDES, values != 0).astype(int)


def stretches(given, std, n_trials: int, dim: int, plane: str, method: str) -> Stretch | None:
    """Return what is known of the stretch out of the plane; None where there is none."""
    values, std = np.atleast_1d(numbers(given, "the stretch out of the plane")).ravel(), std or 0.0
    if not (values.any() or std):
        return None
    if dim != 2 or plane != "strain":
        raise InputError(
            "a stretch out of the plane was given, and this is no planar mesh in plane strain: "
            "leave it out"
        )
    if not (np.isfinite(values) & (np.abs(values) < MOST_STRETCH)).all():
        raise InputError(
            f"the stretch out of the plane is a length ratio less 1, like 0.005 for 0.5 %, smaller "
            f"than {MOST_STRETCH:g}"
        )
    if len(values) not in (0, 1, n_trials):
        raise InputError(
            f"{len(values)} stretches out of the plane for {n_trials} trials: give one per trial, "
            "in their order, or one for all"
        )
    if not 0 <= std <= WIDEST_STRETCH:
        raise InputError(
            f"the standard deviation of the stretch out of the plane is {std:g}, it must lie "
            f"between 0 (exactly as given) and {WIDEST_STRETCH:g}"
        )
    if std and method in ("sequential", "global"):
        raise InputError(
            f"method '{method}' cannot estimate the stretch out of the plane together with the "
            "map: choose method 'regularized', or a standard deviation of 0 (exactly as given)"
        )
    centre = np.resize(values if len(values) else [0.0], n_trials)
    return Stretch(centre, float(std), 1 + np.arange(n_trials))


# ---- what was measured


def information(frame: Frame, given, n_trials: int) -> np.ndarray | None:
    """Return inverse covariances (n_trials, n_nodes, d, d) in the mesh's dimension.

    A few that are none become zero, which says that nothing is known, and are noted.
    """
    if given is None:
        return None
    metric = numbers(given, "the displacement information")
    if metric.ndim != 4 or metric.shape[:2] != (n_trials, frame.n_given):
        raise InputError(
            f"information must have shape (trials, nodes, d, d), this has {metric.shape}"
        )
    if metric.shape[2:] not in {(frame.mesh.dim,) * 2, (frame.world_dim,) * 2, (3, 3)}:
        raise InputError(
            f"information of {metric.shape[2]}×{metric.shape[3]} components per node for a mesh of "
            f"{frame.mesh.dim} dimensions"
        )
    metric = metric[:, frame.nodes]
    fault = _faults(metric)
    for trial, one in enumerate(fault, 1):
        frame.notes += _weightless(frame, one, trial)
    return frame.tensors_to_plane(np.where((fault != "")[..., None, None], 0.0, metric))


def _faults(metric):
    """Say of matrices (t, n, d, d) why they are no inverse covariances, "" if they are. (t, n)"""
    infinite = ~np.isfinite(metric).all(axis=(2, 3))
    metric = np.where(infinite[..., None, None], 0.0, metric)
    size = np.abs(metric).max(axis=(2, 3))
    skew = np.abs(metric - np.swapaxes(metric, 2, 3)).max(axis=(2, 3))
    lowest = np.linalg.eigvalsh(metric)[..., 0]
    return np.select(
        [infinite, skew > SKEW * size, lowest < -SKEW * size],
        ["not finite", "not symmetric", "negative in some direction"],
        "",
    )


def _weightless(frame, fault, trial):
    """Say which nodes of a trial lose their weight by a fault (n,); refuse many."""
    wrong = fault != ""
    if not wrong.any():
        return []
    first = wrong.argmax()
    sentence = (
        f"the displacement information of trial {trial} is no inverse covariance at "
        f"{np.count_nonzero(wrong)} of {len(wrong)} nodes, the first is node {frame.nodes[first]}: "
        f"it is {fault[first]} there"
    )
    if wrong.mean() > MOST:
        raise InputError(f"{sentence}; give the inverse, and zero where nothing is known")
    return [f"{sentence}. What was measured at them counts as unknown"]


def lost_trials(frame: Frame, metric: np.ndarray | None, n_trials: int) -> np.ndarray:
    """Tell which trials say nothing: not one displacement is known to the size of the mesh. (t,)"""
    if metric is None:
        return np.zeros(n_trials, bool)
    largest = np.linalg.eigvalsh(metric)[..., -1].max(axis=1, initial=0.0)
    lost = ~(largest * frame.size**2 > 1)
    if lost.all() and not (largest > 0).any():
        raise InputError(
            "the displacement information is zero everywhere: the rest image has no texture, or "
            "every registration failed"
        )
    if lost.all():
        raise InputError(
            f"the displacement information knows no displacement better than to "
            f"±{largest.max() ** -0.5:.3g}, and the mesh measures {frame.size:.3g}: give inverse "
            "covariances, 1/length², in the unit of the points"
        )
    if lost.any():
        names = ", ".join(str(t + 1) for t in np.flatnonzero(lost))
        rest = ", ".join(str(t + 1) for t in np.flatnonzero(~lost))
        one = lost.sum() == 1
        frame.notes.append(
            f"trial{'' if one else 's'} {names} {'has' if one else 'have'} no information (a lost "
            f"registration?) and {'was' if one else 'were'} left out: the map rests on trial"
            f"{'' if (~lost).sum() == 1 else 's'} {rest}"
        )
    return lost


def displacements(frame: Frame, given) -> np.ndarray:
    """Return the displacements as given, (n_trials, n_nodes, 2 or 3)."""
    u = numbers(given, "displacements")
    if u.ndim == 2:
        u = u[None]
    if u.ndim != 3 or u.shape[1] != frame.n_given or len(u) == 0:
        raise InputError(
            f"displacements must have shape (trials, {frame.n_given} nodes, components), "
            f"these have {u.shape}"
        )
    return u


def check_displacements(frame: Frame, u: np.ndarray, trials: np.ndarray) -> None:
    """Refuse trials of displacements (t, n_given, c) that cannot be; `trials` are their numbers."""
    u = u[:, frame.nodes]
    bad = np.argwhere(~np.isfinite(u).all(axis=2))
    if len(bad):
        raise InputError(
            f"the displacement of trial {trials[bad[0, 0]]} is not a finite number at {len(bad)} "
            f"node(s), the first is node {frame.nodes[bad[0, 1]]}: register again, or cut those "
            "cells off"
        )
    largest = np.abs(u).max(axis=(1, 2))
    still = np.flatnonzero(largest * FARTHEST < frame.size)  # round-off, where images are equal
    if len(still):
        raise InputError(
            f"trial {trials[still[0]]} has no displacement at all: is the rest image its pushed "
            "image?"
        )
    absurd = np.flatnonzero(largest > FARTHEST * frame.size)
    if len(absurd):
        raise InputError(
            f"the displacements of trial {trials[absurd[0]]} reach {largest[absurd[0]]:.3g} on a "
            f"mesh of size {frame.size:.3g}: no body moves so; are the numbers displacements?"
        )


def pieces_of(mesh: Mesh, touch: np.ndarray | None = None) -> tuple[int, np.ndarray]:
    """Return how many parts of the mesh share no node, and each cell's part, (n_cells,).

    Pairs of nodes that `touch` (p, 2) make one part, too.
    """
    blocks = [(b.cell.name, b.nodes) for b in mesh.blocks]
    if touch is not None:
        blocks.append(("pair", touch))
    count, part = soundness.pieces(mesh.n_nodes, blocks)
    by_cell = np.empty(mesh.n_cells, int)
    by_cell[np.concatenate([b.ids for b in mesh.blocks])] = part[: mesh.n_cells]
    return count, by_cell
