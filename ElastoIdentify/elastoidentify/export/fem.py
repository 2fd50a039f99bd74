"""The map on its elements, as finite element programs read it.

=========  ======================================================================================
.vtu       E, ν, K, μ and the label per cell, displacements per node; likewise .vtk and .msh
.inp       Abaqus and CalculiX: a material per pair of E and ν, displacements of the held nodes
.feb       FEBio 4: a material per label with E and ν per element, displacements likewise
=========  ======================================================================================

Only the held nodes' displacements are given, so that a run returns the others: a test of the map.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from ..errors import InputError
from ..fem.elastic_constants import lame_from_young
from ..fem.mesh import make_mesh, plane_frame
from ..imaging.io import check_outputs, write_whole
from ..installation import needs
from ..results import is_found
from .cell_map import CellMap

MESHIO_SUFFIXES = (".vtu", ".vtk", ".msh")
SUFFIXES = (*MESHIO_SUFFIXES, ".inp", ".feb")
ABAQUS = {
    ("triangle", "strain"): "CPE3",
    ("triangle", "stress"): "CPS3",
    ("quad", "strain"): "CPE4",
    ("quad", "stress"): "CPS4",
    ("tetra", "strain"): "C3D4",
    ("hexahedron", "strain"): "C3D8",
}
FEBIO = {"tetra": "tet4", "hexahedron": "hex8", "triangle": "penta6", "quad": "hex8"}
PER_LINE = 8  # numbers on a line of an Abaqus set


@dataclass
class _Model:
    """What is written: mesh in its own dimension, constants per cell, held displacements.

    Attributes
    ----------
    points : (n, d)
    blocks : list of (kind, (m, k))
    young, poisson, labels : (n_cells,)
    held : (h,) int
        Nodes whose displacement is given.
    displacement : (h, d)
    title : str
    """

    points: np.ndarray
    blocks: list
    young: np.ndarray
    poisson: np.ndarray
    labels: np.ndarray
    held: np.ndarray
    displacement: np.ndarray
    title: str

    def numbered(self):
        """Yield (kind, nodes, numbers of the cells) per kind."""
        first = 0
        for kind, nodes in self.blocks:
            yield kind, nodes, np.arange(first, first + len(nodes))
            first += len(nodes)


def write_fem(
    path: str | os.PathLike,
    result: CellMap,
    *,
    trial: int = 1,
    held: str = "reaction",
    fill: str | float | None = None,
) -> list[str]:
    """Write a map for a finite element program.

    Parameters
    ----------
    path : path
        Its suffix says for which, see above.
    result : CellMap
    trial : int
        The trial, from 1, whose displacements the held nodes get.
    held : "reaction" or "boundary"
        Which nodes are held: those where an outside body may push (where it is known), or all of
        the mesh's boundary.
    fill : None, "label" or float
        What cells get that have no value: nothing (they are refused), the mean of their label
        weighted with the cells' sizes, or this Young's modulus; Poisson's ratio is then the mean of
        all others.

    Returns
    -------
    list of str
        Sentences: what was filled, and what the file cannot say.

    Raises
    ------
    InputError
        Another suffix, no such trial, cells without a value, meshio is missing.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: name a file that ends in {', '.join(SUFFIXES)}")
    check_outputs([path])
    young, poisson, notes = filled_constants(result, fill)
    model = _model(result, young, poisson, _trial(result, trial), held)
    if path.suffix.lower() == ".inp":
        text, more = _abaqus(model, result)
    elif path.suffix.lower() == ".feb":
        text, more = _febio(model, result)
    else:
        _meshio(path, model, result)
        return notes
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))
    return notes + more


def filled_constants(result: CellMap, fill: str | float | None = None):
    """Return E and ν of every cell (n_cells,) and sentences on what was filled.

    Raises
    ------
    InputError
        Cells have no value and `fill` is None; a label has none at all; `fill` is neither.
    """
    young = np.array(result.values["YoungModulus"], float)
    poisson = np.array(result.values["PoissonRatio"], float)
    lacking = ~(np.isfinite(young) & np.isfinite(poisson)) | result.lacks("YoungModulus")
    if not lacking.any():
        return young, poisson, []
    if fill is None:
        raise InputError(
            f"{lacking.sum()} of {len(lacking)} cells have no value, which no finite element "
            "program takes: say --fill label for the mean of their label, or a Young's modulus"
        )
    if lacking.all():
        raise InputError("no cell has a value: there is nothing to export")
    sizes = _sizes(result)
    poisson[lacking] = np.average(poisson[~lacking], weights=sizes[~lacking])
    if fill != "label":
        young[lacking] = _positive(fill)
        return young, poisson, [f"{lacking.sum()} cells without a value got E = {float(fill):g}"]
    shear = lacking & is_found(result.status)  # these have μ, and want ν alone
    for label in np.unique(result.labels[lacking]):
        here = np.asarray(result.labels) == label
        if (here & ~lacking).any():
            weights = sizes[here & ~lacking]
            young[here & lacking] = np.average(young[here & ~lacking], weights=weights)
            poisson[here & lacking] = np.average(poisson[here & ~lacking], weights=weights)
        elif (here & ~shear).any():
            raise InputError(
                f"no cell of {result.name_of(label)} has a value, so there is no mean: give a "
                "Young's modulus, --fill 5000"
            )
    notes = []
    if shear.any():
        young[shear] = 2 * (1 + poisson[shear]) * np.asarray(result.values["Mu"])[shear]
        notes.append(f"{shear.sum()} cells of which μ alone is known got a mean ν")
    if (lacking & ~shear).any():
        notes.append(
            f"{(lacking & ~shear).sum()} cells without a value got the mean of their label"
        )
    return young, poisson, notes


def _positive(fill) -> float:
    try:
        value = float(fill)
    except (TypeError, ValueError):
        value = -1.0
    if not 0 < value < np.inf:
        raise InputError(f"fill {fill!r}: say label, or a positive Young's modulus")
    return value


def _sizes(result: CellMap) -> np.ndarray:
    return make_mesh(_own(result), result.blocks).volumes


def _own(result: CellMap) -> np.ndarray:
    """Return the nodes in the mesh's own dimension."""
    if result.dimension == 3:
        return result.points
    return (result.points - result.points[0]) @ _axes(result)


def _axes(result: CellMap) -> np.ndarray:
    """Return the plane's axes (3, 2), such that the cells turn counter-clockwise in them."""
    axes = plane_frame(result.points)[1]
    first, second, last = (result.points @ axes)[result.blocks[0][1][0][:3]]
    area = np.linalg.det([second - first, last - first])
    return axes * [1.0, np.sign(area) or 1.0]


def _trial(result: CellMap, trial: int) -> np.ndarray:
    """Return a trial's displacements in the mesh's own dimension; (0, d) where there are none."""
    count = len(result.displacements)
    if count == 0:
        return np.empty((0, result.dimension))
    if not 1 <= trial <= count:
        raise InputError(f"trial {trial}: the map has trials 1 to {count}")
    u = np.asarray(result.displacements[trial - 1], float)
    return u if result.dimension == 3 else u @ _axes(result)


def _model(result: CellMap, young, poisson, u, held: str) -> _Model:
    if held not in ("reaction", "boundary"):
        raise InputError(f"held {held!r}: say reaction or boundary")
    points = _own(result)
    mesh = make_mesh(points, result.blocks)
    chosen = np.asarray(result.reaction_nodes, bool)
    if held == "boundary" or not chosen.any():
        chosen = mesh.boundary_nodes
    nodes = np.flatnonzero(chosen) if len(u) else np.empty(0, int)
    version = result.provenance.get("elastoidentify", "")
    title = f"ElastoIdentify {version}, moduli in {result.unit}, lengths in {result.length_unit}"
    return _Model(
        points, result.blocks, young, poisson, np.asarray(result.labels), nodes, u[nodes], title
    )


# ---- meshio


def _meshio(path: Path, model: _Model, result: CellMap) -> None:
    """Write mesh, constants and displacements by meshio; planar meshes in their place in space."""
    try:
        import meshio
    except ImportError:
        raise InputError(f"{path}: writing it {needs('meshio', 'fem')}") from None
    lam, mu = lame_from_young(model.young, model.poisson)
    per_cell = {
        "YoungModulus": model.young,
        "PoissonRatio": model.poisson,
        "BulkModulus": lam + 2 / 3 * mu,
        "ShearModulus": mu,
        "attribute": model.labels.astype(np.int32),  # GEOS' name for regions
    }
    split = np.cumsum([len(nodes) for _, nodes in model.blocks])[:-1]
    per_node = {
        f"Displacement_{k}": np.asarray(u, float) for k, u in enumerate(result.displacements, 1)
    }
    fixed = np.zeros(len(model.points), np.uint8)
    fixed[model.held] = 1
    mesh = meshio.Mesh(
        result.points,
        [(kind, np.asarray(nodes)) for kind, nodes in model.blocks],
        point_data={**per_node, "Held": fixed},
        cell_data={name: np.split(values, split) for name, values in per_cell.items()},
    )
    write_whole(path, lambda part: mesh.write(part))


# ---- Abaqus


def _abaqus(model: _Model, result: CellMap) -> tuple[str, list[str]]:
    plane = result.report.get("plane") or "strain"
    plane = plane if result.dimension == 2 else "strain"
    lines = ["*HEADING", model.title, "*NODE, NSET=ALL"]
    lines += [f"{k}, {_row(x)}" for k, x in enumerate(model.points, 1)]
    for kind, nodes, numbers in model.numbered():
        lines.append(f"*ELEMENT, TYPE={ABAQUS[kind, plane]}")
        lines += [
            f"{k}, {', '.join(map(str, row))}"
            for k, row in zip(numbers + 1, np.asarray(nodes) + 1, strict=True)
        ]
    for label in np.unique(model.labels):
        lines.append(f"*ELSET, ELSET=LABEL_{label}")
        lines += _listed(np.flatnonzero(model.labels == label) + 1)
    pairs, which = np.unique(
        np.column_stack([model.young, model.poisson]), axis=0, return_inverse=True
    )
    order = np.argsort(which.ravel(), kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(which.ravel()))[:-1])
    for k, ((young, poisson), cells) in enumerate(zip(pairs, groups, strict=True), 1):
        lines += [f"*ELSET, ELSET=E{k}", *_listed(np.sort(cells) + 1)]
        lines += [f"*MATERIAL, NAME=M{k}", "*ELASTIC", _row([young, poisson])]
        lines.append(f"*SOLID SECTION, ELSET=E{k}, MATERIAL=M{k}")
        lines += ["1."] if result.dimension == 2 else []  # thickness
    if len(model.held):
        lines += ["*NSET, NSET=HELD", *_listed(model.held + 1), "*STEP", "*STATIC", "*BOUNDARY"]
        lines += [
            f"{node + 1}, {axis + 1}, {axis + 1}, {float(value)!r}"
            for node, row in zip(model.held, model.displacement, strict=True)
            for axis, value in enumerate(row)
        ]
        lines += ["*NODE PRINT, NSET=ALL", "U", "*END STEP"]
    notes = []
    if result.report.get("kinematics") not in (None, "small-strain"):
        notes.append(
            f"the map was found with {result.report['kinematics']} kinematics; *ELASTIC is for "
            "small strain, where both agree"
        )
    return "\n".join(lines) + "\n", notes


def _listed(numbers) -> list[str]:
    """Return lines of a set."""
    numbers = [str(number) for number in numbers]
    return [", ".join(numbers[k : k + PER_LINE]) for k in range(0, len(numbers), PER_LINE)]


def _row(values, separator: str = ", ") -> str:
    return separator.join(repr(float(value)) for value in values)


# ---- FEBio


def _febio(model: _Model, result: CellMap) -> tuple[str, list[str]]:
    """Return an FEBio 4 model: a domain and a material with mapped constants per label and kind."""
    points, blocks, held, u = _solid(model)
    kinematics = result.report.get("kinematics") or "small-strain"
    material = "neo-Hookean" if kinematics == "neo-hookean" else "isotropic elastic"
    materials, elements, domains, data = [], [], [], []
    for kind, nodes, numbers in blocks:
        for label in np.unique(model.labels[numbers]):
            here = model.labels[numbers] == label
            name = f"label{label}_{FEBIO[kind]}" if len(blocks) > 1 else f"label{label}"
            materials.append(_febio_material(len(materials) + 1, name, material))
            elements.append(_febio_elements(name, FEBIO[kind], nodes[here], numbers[here]))
            domains.append(f'<SolidDomain name="{name}" mat="{name}"/>')
            data.append(_febio_data(f"E_{name}", name, model.young[numbers[here]]))
            data.append(_febio_data(f"v_{name}", name, model.poisson[numbers[here]]))
    data += [_febio_displacement(axis, u[:, axis]) for axis in range(u.shape[1]) if len(held)]
    rows = "\n".join(f'<node id="{k}">{_row(x, ",")}</node>' for k, x in enumerate(points, 1))
    sections = [
        '<Module type="solid"/>',
        _FEBIO_CONTROL,
        _section("Material", materials),
        _section(
            "Mesh",
            [
                f'<Nodes name="nodes">\n{rows}\n</Nodes>',
                *elements,
                *_febio_sets(held, points, result),
            ],
        ),
        _section("MeshDomains", domains),
        _section("MeshData", data),
        _section("Boundary", _febio_boundary(u.shape[1] if len(held) else 0, result)),
        _FEBIO_LOAD,
    ]
    text = "\n".join(
        ['<?xml version="1.0" encoding="UTF-8"?>', f"<!-- {escape(model.title)} -->",
         '<febio_spec version="4.0">', *sections, "</febio_spec>", ""]
    )  # fmt: skip
    notes = []
    if result.dimension == 2:
        notes.append("FEBio has no plane strain: the mesh became a layer of solids held across it")
    if kinematics == "small-strain":
        notes.append(
            "FEBio's isotropic elastic material is St. Venant-Kirchhoff: it agrees with small "
            "strain for small pushes only"
        )
    return text, notes


_FEBIO_CONTROL = """<Control>
<analysis>STATIC</analysis>
<time_steps>10</time_steps>
<step_size>0.1</step_size>
<solver type="solid"><symmetric_stiffness>symmetric</symmetric_stiffness></solver>
</Control>"""

_FEBIO_LOAD = """<LoadData>
<load_controller id="1" name="push" type="loadcurve">
<interpolate>LINEAR</interpolate>
<points><pt>0,0</pt><pt>1,1</pt></points>
</load_controller>
</LoadData>"""


def _section(name: str, parts: list[str]) -> str:
    return "\n".join([f"<{name}>", *parts, f"</{name}>"])


def _febio_material(number: int, name: str, kind: str) -> str:
    return (
        f'<material id="{number}" name="{name}" type="{kind}">\n<density>1</density>\n'
        f'<E type="map">E_{name}</E>\n<v type="map">v_{name}</v>\n</material>'
    )


def _febio_elements(name: str, kind: str, nodes, numbers) -> str:
    rows = [
        f'<elem id="{k + 1}">{",".join(map(str, row + 1))}</elem>'
        for k, row in zip(numbers, nodes, strict=True)
    ]
    return "\n".join([f'<Elements type="{kind}" name="{name}">', *rows, "</Elements>"])


def _febio_data(name: str, domain: str, values) -> str:
    rows = [f'<elem lid="{k}">{float(value)!r}</elem>' for k, value in enumerate(values, 1)]
    return "\n".join(
        [
            f'<ElementData name="{name}" elem_set="{domain}" data_type="scalar">',
            *rows,
            "</ElementData>",
        ]
    )


def _febio_displacement(axis: int, values) -> str:
    rows = [f'<node lid="{k}">{float(value)!r}</node>' for k, value in enumerate(values, 1)]
    head = f'<NodeData name="u{"xyz"[axis]}" node_set="held" data_type="scalar">'
    return "\n".join([head, *rows, "</NodeData>"])


def _febio_sets(held, points, result: CellMap) -> list[str]:
    sets = {"held": held} if len(held) else {}
    if result.dimension == 2:
        sets["all"] = np.arange(len(points))
    return [
        f'<NodeSet name="{name}">{",".join(map(str, np.asarray(nodes) + 1))}</NodeSet>'
        for name, nodes in sets.items()
    ]


def _febio_boundary(dimension: int, result: CellMap) -> list[str]:
    parts = [
        f'<bc name="push {axis}" type="prescribed displacement" node_set="held">\n'
        f'<dof>{axis}</dof>\n<value lc="1" type="map">u{axis}</value>\n'
        "<relative>0</relative>\n</bc>"
        for axis in "xyz"[:dimension]
    ]
    if result.dimension == 2:
        parts.append(
            '<bc name="plane strain" type="zero displacement" node_set="all">\n'
            "<x_dof>0</x_dof><y_dof>0</y_dof><z_dof>1</z_dof>\n</bc>"
        )
    return parts


def _solid(model: _Model):
    """Return a planar model as one layer of solids (prisms, hexahedra); a solid one as it is.

    Returns
    -------
    points : (n, 3)
    blocks : list of (kind, nodes, numbers)
    held : (h,) int
    displacement : (h, d)
    """
    blocks = [(kind, np.asarray(nodes), numbers) for kind, nodes, numbers in model.numbered()]
    if model.points.shape[1] == 3:
        return model.points, blocks, model.held, model.displacement
    n = len(model.points)
    span = model.points.max(axis=0) - model.points.min(axis=0)
    thickness = float(np.sqrt(span.prod() / n))  # about the length of an edge
    layers = [np.column_stack([model.points, np.full(n, z)]) for z in (0.0, thickness)]
    blocks = [(kind, np.hstack([nodes, nodes + n]), numbers) for kind, nodes, numbers in blocks]
    held = np.concatenate([model.held, model.held + n])
    return np.vstack(layers), blocks, held, np.vstack([model.displacement] * 2)
