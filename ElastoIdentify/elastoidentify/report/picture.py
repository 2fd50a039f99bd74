"""The picture of a map: rest image, shear modulus, λ and uncertainty side by side."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..imaging.image import Image
from ..imaging.io import write_whole
from ..imaging.registration.waves import as_seen
from ..results import QUANTITIES, Status, is_found

MODULI = "viridis"  # perceptually even colours, readable without colour vision
UNCERTAINTY = "magma_r"
EDGES = {
    "tetra": np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]),
    "hexahedron": np.array(
        [
            (0, 1),
            (1, 2),
            (2, 3),
            (3, 0),
            (4, 5),
            (5, 6),
            (6, 7),
            (7, 4),
            (0, 4),
            (1, 5),
            (2, 6),
            (3, 7),
        ]
    ),
}
"""The edges of the solid cells, in VTK's node order."""

NEAREST_PREFIX = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"))


@dataclass(frozen=True)
class Drawing:
    """A mesh, or a section through it, as polygons in a plane.

    Parameters
    ----------
    polygons : list of (k, 2) arrays
        x to the right, y down.
    cells : (n_polygons,) int
        The mesh cell that each polygon shows.
    outlines : (n, 2, 2) array
        Edges between polygons of different labels.
    """

    polygons: list[np.ndarray]
    cells: np.ndarray
    outlines: np.ndarray

    @property
    def extent(self) -> np.ndarray:
        """[[x_min, y_min], [x_max, y_max]]."""
        corners = np.concatenate(self.polygons)
        return np.array([corners.min(0), corners.max(0)])


def draw(
    path: str | Path,
    points: np.ndarray,
    blocks: list[tuple[str, np.ndarray]],
    arrays: Mapping[str, np.ndarray],
    rest: Image | None = None,
    *,
    unit: str = "Pa",
    length: str = "mm",
    title: str = "",
    about: str = "",
) -> None:
    """Draw a mesh with results to a PNG, PDF or SVG file, whole or not at all.

    Panels: the rest image with the labels' outlines (when given), μ, λ, and the standard deviation
    of μ in percent of its value. Cells that were not determined are hatched, cells whose value no
    stable material has are crossed, and given cells carry no uncertainty. Of a volume, a section
    through the middle is drawn.

    Parameters
    ----------
    path : path
    points : (n, 3)
    blocks : list of (kind, (m, k) int)
    arrays : mapping of (n_cells,)
        ``Mu``, ``MuStd``, ``Lambda``, ``Status``, and ``Label`` where there are any.
    rest : Image, optional
    unit, length : str
        Of the moduli and of the world, for the scales.
    title : str
    about : str
        Where the result comes from; goes into the file's description.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    frame = _frame(points, rest)
    labels = arrays.get("Label", np.zeros(len(arrays["Mu"])))
    drawing = _drawing(points, blocks, labels, frame)
    window = _window(drawing, rest, frame)
    size = window[1] - window[0]

    columns = 4 if rest is not None else 3
    height = float(np.clip(3.3 * size[1] / size[0], 1.2, 7.0))
    figure = Figure(figsize=(3.9 * columns, height + 1.25), layout="constrained", dpi=160)
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(1, columns))
    for one in axes:
        one.set(xlim=window[:, 0], ylim=window[::-1, 1], aspect="equal", xticks=[], yticks=[])
        one.spines[:].set_visible(False)
    if title:
        figure.suptitle(title)
    if rest is not None:
        _draw_rest(axes[0], rest, frame, drawing)
        _scale_bar(axes[0], window, length)
        rest_free = axes[1:]
    else:
        rest_free = axes
        _scale_bar(axes[0], window, length, "black")
    for one, quantity in zip(rest_free, ("Mu", "Lambda"), strict=False):
        _draw_modulus(figure, one, drawing, arrays, quantity, unit)
    _draw_uncertainty(figure, rest_free[2], drawing, arrays)
    _legend(figure, arrays, drawing)

    suffix = Path(path).suffix.lower().lstrip(".")
    tight = {"bbox_inches": "tight", "pad_inches": 0.08}
    key = {"png": "Description", "svg": "Description", "pdf": "Subject"}.get(suffix)
    metadata = {key: about} if about and key else None
    write_whole(
        Path(path),
        lambda part: figure.savefig(part, format=suffix, metadata=metadata, **tight),
    )


# ---- geometry


def _frame(points: np.ndarray, rest: Image | None) -> Image:
    """Return the planar image whose i and j axes are the picture's: right and down."""
    if rest is not None:
        thin = rest.planar_axis
        if thin is None:
            spread = np.ptp(rest.world_to_index(points), axis=0)
            thin = int(spread.argmin())
        order = [axis for axis in range(3) if axis != thin] + [thin]
        return Image(np.zeros((1, 1, 1)), rest.origin, np.ones(3), rest.direction[:, order])
    centre = points.mean(0)
    normal = np.linalg.svd(points - centre, full_matrices=True)[2][2]
    order = np.argsort(np.abs(normal), kind="stable")  # axes of the world nearest to the plane
    right = np.eye(3)[min(order[:2])] - normal[min(order[:2])] * normal
    right /= np.linalg.norm(right)
    down = np.cross(normal, right)
    down *= -1 if down[np.abs(down).argmax()] > 0 else 1  # y up, as in a diagram
    return Image(np.zeros((1, 1, 1)), centre, np.ones(3), np.column_stack([right, down, normal]))


def _drawing(points, blocks, labels, frame: Image) -> Drawing:
    """Return the cells of a planar mesh, or the section of a volume through its middle."""
    if blocks[0][0] in EDGES:
        points, corners, numbers = section(points, blocks, points.mean(0), frame.direction[:, 2])
    else:
        corners = [cell for _, cells in blocks for cell in cells]
        numbers = np.arange(len(corners))
    plane = frame.world_to_index(points)[:, :2]
    edges = _label_edges(corners, labels[numbers])
    return Drawing([plane[c] for c in corners], numbers, plane[edges])


def section(points, blocks, point, normal):
    """Cut a volume mesh with a plane.

    Parameters
    ----------
    points : (n, 3)
    blocks : list of (kind, (m, k) int)
        Tetrahedra and hexahedra; cells are numbered through.
    point, normal : (3,)
        Of the plane.

    Returns
    -------
    points : (p, 3)
        Where the plane cuts the cells' edges.
    corners : list of int arrays
        A polygon per cut cell, in order around it.
    numbers : (n_polygons,) int
        Which cell each one cuts.
    """
    away = (points - point) @ normal
    ends, owners, first = [], [], 0
    for kind, cells in blocks:
        pairs = cells[:, EDGES[kind]]  # (m, edges, 2)
        cell, edge = np.nonzero((away[pairs] >= 0).any(-1) & (away[pairs] < 0).any(-1))
        ends.append(np.sort(pairs[cell, edge], axis=1))
        owners.append(first + cell)
        first += len(cells)
    if not sum(map(len, ends)):
        return np.zeros((0, 3)), [], np.zeros(0, int)
    owner = np.concatenate(owners)
    edges, place = np.unique(np.concatenate(ends), axis=0, return_inverse=True)
    share = (away[edges[:, 0]] / (away[edges[:, 0]] - away[edges[:, 1]]))[:, None]
    cut = (1 - share) * points[edges[:, 0]] + share * points[edges[:, 1]]
    numbers, inverse, count = np.unique(owner, return_inverse=True, return_counts=True)
    place, inverse = place.ravel(), inverse.ravel()
    centre = np.zeros((len(numbers), 3))
    np.add.at(centre, inverse, cut[place])
    first_axis = np.linalg.svd(np.asarray(normal, float)[None])[2][1]
    axes = np.stack([first_axis, np.cross(normal, first_axis)])
    x, y = axes @ (cut[place] - (centre / count[:, None])[inverse]).T
    around = np.lexsort([np.arctan2(y, x), inverse])
    return cut, np.split(place[around], np.cumsum(count)[:-1]), numbers


def _label_edges(corners: list[np.ndarray], labels: np.ndarray) -> np.ndarray:
    """Return the node pairs (n, 2) of edges between different labels, and of the outer border."""
    start = np.concatenate(corners)
    stop = np.concatenate([np.roll(c, -1) for c in corners])
    label = np.repeat(labels, [len(c) for c in corners])
    edges, place = np.unique(
        np.sort(np.column_stack([start, stop]), axis=1), axis=0, return_inverse=True
    )
    place = place.ravel()
    low, high = np.full(len(edges), np.inf), np.full(len(edges), -np.inf)
    np.minimum.at(low, place, label)
    np.maximum.at(high, place, label)
    return edges[(low != high) | (np.bincount(place) == 1)]


def _window(drawing: Drawing, rest: Image | None, frame: Image) -> np.ndarray:
    """Return the part of the plane to show: the mesh with a margin, within the rest image."""
    window = drawing.extent
    window = window + 0.06 * np.ptp(window, axis=0).max() * np.array([[-1], [1]])
    if rest is not None:
        size = np.array(rest.size)
        low = frame.world_to_index(rest.index_to_world(np.array([[-0.5] * 3, size - 0.5])))[:, :2]
        window = np.clip(window, low.min(0), low.max(0))
    return window


# ---- panels


def _draw_rest(axes, rest: Image, frame: Image, drawing: Drawing) -> None:
    """Draw the rest image (the slice of the mesh) and the labels' outlines."""
    from matplotlib.collections import LineCollection

    order = [int(np.abs(frame.direction[:, k] @ rest.direction).argmax()) for k in range(3)]
    index = 0
    if rest.size[order[2]] > 1:
        where = frame.index_to_world(np.r_[drawing.extent.mean(0), 0.0][None])
        index = round(float(rest.world_to_index(where)[0, order[2]]))
        index = int(np.clip(index, 0, rest.size[order[2]] - 1))
    array = as_seen(rest.array.transpose(2, 1, 0).transpose(order)[:, :, index].T)
    step = rest.spacing[order[:2]]
    count = np.array(array.shape[::-1])
    left, top = -0.5 * step
    right, bottom = (count - 0.5) * step
    low, high = np.percentile(array, (0.5, 99.5))
    axes.imshow(
        array, cmap="gray", vmin=low, vmax=high, extent=(left, right, bottom, top),
        interpolation="nearest",
    )  # fmt: skip
    axes.add_collection(LineCollection(drawing.outlines, colors="#ffb000", linewidths=1.0))
    axes.set_title("image at rest")


def _draw_modulus(figure, axes, drawing: Drawing, arrays, quantity: str, unit: str) -> None:
    """Draw μ or λ with its colour bar."""
    values = np.where(is_found(arrays["Status"], quantity), arrays[quantity], np.nan)[drawing.cells]
    factor, name = _unit(values, unit)
    finite = values[np.isfinite(values)] * factor
    low, high = 0.0, _highest(finite)
    title = {"Mu": "shear modulus μ", "Lambda": "Lamé constant λ"}[quantity]
    patches = _polygons(axes, drawing, values * factor, MODULI, low, high)
    _hatch(axes, drawing, arrays["Status"], quantity)
    _outline(axes, drawing)
    axes.set_title(title)
    label = f"{QUANTITIES[quantity].symbol} ({name})" if name else QUANTITIES[quantity].symbol
    beyond = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}
    extend = beyond[int((finite < low).any()), int((finite > high).any())]
    _colour_bar(figure, axes, patches, label, extend)


def _draw_uncertainty(figure, axes, drawing: Drawing, arrays) -> None:
    """Draw the standard deviation of μ in percent of μ; given cells stay white."""
    status = arrays["Status"]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = 100 * arrays["MuStd"] / np.abs(arrays["Mu"])
    values = np.where(is_found(status) & (status != Status.KNOWN), share, np.nan)[drawing.cells]
    finite = values[np.isfinite(values)]
    high = _highest(finite)
    patches = _polygons(axes, drawing, values, UNCERTAINTY, 0.0, high)
    given = np.isin(drawing.cells, np.flatnonzero(status == Status.KNOWN))
    if given.any():
        corners = np.concatenate([p for p, g in zip(drawing.polygons, given, strict=True) if g])
        _polygons(axes, drawing, np.where(given, 0.0, np.nan), "Greys", 0.0, 1.0)
        centre = (corners.min(0) + corners.max(0)) / 2
        axes.text(*centre, "given", ha="center", va="center", color="0.35")
    _hatch(axes, drawing, status, "Mu")
    _outline(axes, drawing)
    axes.set_title("uncertainty of μ")
    extend = "max" if (finite > high).any() else "neither"
    _colour_bar(figure, axes, patches, "standard deviation (% of μ)", extend)


def _highest(values: np.ndarray) -> float:
    """Return the upper end of a colour scale: the largest value, or less if few are far larger."""
    if not values.size or values.max() <= 0:
        return 1.0
    usual = float(np.percentile(values, 98))
    return float(values.max()) if values.max() < 1.5 * usual else usual


def _polygons(axes, drawing: Drawing, values, colours: str, low: float, high: float):
    """Fill the polygons that have a value."""
    from matplotlib.collections import PolyCollection

    shown = np.flatnonzero(np.isfinite(values))
    patches = PolyCollection([drawing.polygons[i] for i in shown], cmap=colours, edgecolors="face")
    patches.set(array=values[shown], clim=(low, high), linewidths=0.4)  # edges: no seams
    axes.add_collection(patches)
    return patches


def _hatch(axes, drawing: Drawing, status, quantity: str) -> None:
    """Mark the cells without a value of the quantity that can be trusted."""
    from matplotlib.collections import PolyCollection

    lacking = ~is_found(status, quantity) & (status != Status.OUT_OF_RANGE)
    status = np.where(lacking, Status.NOT_DETERMINED, status)
    for value, style in _marks().items():
        cells = np.flatnonzero(status[drawing.cells] == value)
        axes.add_collection(PolyCollection([drawing.polygons[i] for i in cells], **style))


def _marks() -> dict[int, dict]:
    """Return how cells are drawn that have no value to show, by Status."""
    common = {"linewidths": 0.0, "edgecolors": "0.45"}
    return {
        Status.NOT_DETERMINED: {"facecolors": "0.85", "hatch": "////", **common},
        Status.OUT_OF_RANGE: {"facecolors": "0.85", "hatch": "xxxx", **common},
    }


def _outline(axes, drawing: Drawing) -> None:
    """Draw the labels' borders, visible on dark and bright cells."""
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import withStroke

    lines = LineCollection(drawing.outlines, colors="white", linewidths=0.7)
    lines.set_path_effects([withStroke(linewidth=1.7, foreground="0.25")])
    axes.add_collection(lines)


def _colour_bar(figure, axes, patches, label: str, extend: str) -> None:
    """Draw a colour bar beside a panel, as high as the panel."""
    beside = axes.inset_axes([1.02, 0.05, 0.05, 0.9])
    figure.colorbar(patches, cax=beside, label=label, extend=extend, extendfrac=0.03)


def _legend(figure, arrays, drawing: Drawing) -> None:
    """Explain the hatches that occur."""
    from matplotlib.patches import Patch

    texts = {
        Status.NOT_DETERMINED: "not determined",
        Status.OUT_OF_RANGE: "outside the admissible range",
    }
    # where μ alone is determined the panel of λ is hatched
    occurs = {one: [one] for one in texts}
    occurs[Status.NOT_DETERMINED].append(Status.SHEAR_ONLY)
    handles = []
    for value, style in _marks().items():
        if np.isin(arrays["Status"][drawing.cells], occurs[value]).any():
            handles.append(
                Patch(
                    facecolor=style["facecolors"], edgecolor=style["edgecolors"],
                    hatch=style["hatch"], label=texts[value], linewidth=0.0,
                )
            )  # fmt: skip
    if handles:
        style = {"handles": handles, "ncols": 2, "frameon": False}
        try:
            figure.legend(loc="outside lower right", **style)
        except ValueError:  # before matplotlib 3.7
            figure.legend(loc="lower right", **style)


def _unit(values: np.ndarray, unit: str) -> tuple[float, str]:
    """Return the factor and the name of the unit in which pascals read well."""
    finite = np.abs(values[np.isfinite(values)])
    if unit != "Pa" or not finite.size or np.median(finite) == 0:
        return 1.0, unit
    size = np.median(finite)
    scale, prefix = next((s for s in NEAREST_PREFIX if size >= s[0]), NEAREST_PREFIX[-1])
    return 1 / scale, prefix + unit


def _scale_bar(axes, window: np.ndarray, length: str, colour: str = "white") -> None:
    """Draw a bar of a round length into the lower left corner."""
    from matplotlib.patheffects import withStroke

    size = window[1] - window[0]
    wanted = 0.25 * size[0]
    power = 10.0 ** np.floor(np.log10(wanted))
    bar = max(step * power for step in (1, 2, 5) if step * power <= wanted)
    x, y = window[0, 0] + 0.08 * size[0], window[1, 1] - 0.09 * size[1]
    (line,) = axes.plot([x, x + bar], [y, y], color=colour, linewidth=3, solid_capstyle="butt")
    text = axes.text(
        x + bar / 2, y - 0.015 * size[1], f"{bar:g} {length}", color=colour, ha="center",
        va="bottom", fontsize=9,
    )  # fmt: skip
    if colour == "white":
        line.set_path_effects([withStroke(linewidth=5, foreground="black")])
        text.set_path_effects([withStroke(linewidth=2, foreground="black")])
