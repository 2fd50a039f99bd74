"""Maps on elements: other programs that run on the exported numbers return the displacements."""

import subprocess
import xml.etree.ElementTree as ET

import dicom_maps
import meshio
import numpy as np
import pytest
import skfem
from elastoidentify.errors import InputError
from elastoidentify.export.cell_map import CellMap
from elastoidentify.export.fem import write_fem
from elastoidentify.fem.elastic_constants import lame_from_young
from elastoidentify.fem.forward import box_mesh, solve_push, square_mesh
from scipy.spatial.transform import Rotation
from skfem.helpers import ddot, eye, sym_grad, trace

TURN = Rotation.from_euler("zyx", (25, -35, 50), degrees=True).as_matrix()


def pushed(kind):
    """A map whose displacements are the forward solution of its own moduli."""
    rng = np.random.default_rng(5)
    if kind == "triangle":
        points, cells = square_mesh(5, 6, 0.03, 0.04)
        top = points[:, 1] > 0.0399
    else:
        points, cells = box_mesh((3, 3, 4), (0.03, 0.03, 0.04), kind)
        top = points[:, 2] > 0.0399
    young, nu = rng.uniform(1000, 9000, len(cells)), rng.uniform(0.2, 0.4, len(cells))
    held = top | (points[:, -1] < 1e-9)
    push = np.where(top[:, None], np.linspace(0.0005, -0.001, points.shape[1]), 0.0)
    u = solve_push(points, cells, *lame_from_young(young, nu), np.flatnonzero(held), push[held])
    if kind == "triangle":  # anywhere in space
        points, u = points @ TURN[:, :2].T + (1, 2, 3), u @ TURN[:, :2].T
    return CellMap(
        points, [(kind, cells)], {"YoungModulus": young, "PoissonRatio": nu},
        np.full(len(cells), 2), 1 + np.arange(len(cells)) % 2, u[None], held, length_unit="m",
    )  # fmt: skip


def solved(points, cells, young, nu, held, values):
    """Solve small-strain elasticity by scikit-fem, on numbers read from a file."""
    kinds = {
        (2, 3): (skfem.MeshTri, skfem.ElementTriP1, skfem.ElementTriP0),
        (3, 4): (skfem.MeshTet, skfem.ElementTetP1, skfem.ElementTetP0),
        (3, 8): (skfem.MeshHex, skfem.ElementHex1, skfem.ElementHex0),
    }
    mesh_kind, element, per_cell = kinds[points.shape[1], cells.shape[1]]
    if cells.shape[1] == 8:  # scikit-fem numbers the corners of a hexahedron its own way
        cells = cells[:, [0, 1, 3, 4, 2, 5, 7, 6]]
    mesh = mesh_kind(points.T, cells.T, sort_t=False)
    basis = skfem.Basis(mesh, skfem.ElementVector(element()))
    lam, mu = lame_from_young(young, nu)

    @skfem.BilinearForm
    def energy(u, v, w):
        strain, test = sym_grad(u), sym_grad(v)
        stress = 2 * w.mu * strain + eye(w.lam * trace(strain), len(strain))
        return ddot(stress, test)

    constant = skfem.Basis(mesh, per_cell(), quadrature=basis.quadrature)
    K = energy.assemble(basis, lam=constant.interpolate(lam), mu=constant.interpolate(mu))
    x = np.zeros(basis.N)
    dofs = basis.nodal_dofs[:, held]
    x[dofs] = values.T
    x = skfem.solve(*skfem.condense(K, x=x, D=dofs.ravel()))
    return x[basis.nodal_dofs].T


def check(made, u):
    wanted = made.displacements[0]
    if made.dimension == 2:  # lengths do not depend on the frame in which the file has them
        u, wanted = np.linalg.norm(u, axis=1), np.linalg.norm(wanted, axis=1)
    np.testing.assert_allclose(u, wanted, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
def test_a_run_on_the_mesh_file_returns_the_displacements(tmp_path, kind, suffix):
    made = pushed(kind)
    write_fem(tmp_path / f"map{suffix}", made)
    mesh = meshio.read(tmp_path / f"map{suffix}")
    (block,) = mesh.cells
    data = {name: values[0] for name, values in mesh.cell_data.items()}
    held = mesh.point_data["Held"] == 1
    assert np.array_equal(held, made.reaction_nodes)
    values = mesh.point_data["Displacement_1"][held]
    check(
        made,
        solved(mesh.points, block.data, data["YoungModulus"], data["PoissonRatio"], held, values),
    )
    np.testing.assert_allclose(
        data["ShearModulus"], data["YoungModulus"] / 2 / (1 + data["PoissonRatio"])
    )
    np.testing.assert_allclose(
        data["BulkModulus"], data["YoungModulus"] / 3 / (1 - 2 * data["PoissonRatio"])
    )
    assert np.array_equal(data["attribute"], made.labels)


def read_abaqus(path):
    """Return nodes, cells, E and ν per cell, held nodes and their displacement."""
    nodes, cells, sets, materials, sections, held = {}, {}, {}, {}, {}, {}
    keyword, options = "", {}
    for line in path.read_text().splitlines():
        if line.startswith("*"):
            keyword, *rest = line[1:].split(", ")
            options = dict(word.split("=") for word in rest)
            if keyword == "MATERIAL":
                name = options["NAME"]
            if keyword == "SOLID SECTION":
                sections[options["ELSET"]] = options["MATERIAL"]
            continue
        numbers = line.split(", ")
        if keyword == "NODE":
            nodes[int(numbers[0])] = [float(x) for x in numbers[1:]]
        elif keyword == "ELEMENT":
            cells[int(numbers[0])] = [int(x) - 1 for x in numbers[1:]]
        elif keyword == "ELSET":
            sets.setdefault(options["ELSET"], []).extend(int(x) for x in numbers)
        elif keyword == "ELASTIC":
            materials[name] = [float(x) for x in numbers]
        elif keyword == "BOUNDARY":
            node, axis, _, value = numbers
            held.setdefault(int(node) - 1, {})[int(axis) - 1] = float(value)
    constants = np.full((len(cells), 2), np.nan)
    for name, material in sections.items():
        constants[np.array(sets[name]) - 1] = materials[material]
    values = [[row[axis] for axis in sorted(row)] for row in held.values()]
    return (
        np.array(list(nodes.values())), np.array(list(cells.values())), *constants.T,
        np.array(list(held)), np.array(values),
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["triangle", "tetra", "hexahedron"])
def test_a_run_on_the_abaqus_file_returns_the_displacements(tmp_path, kind):
    made = pushed(kind)
    assert write_fem(tmp_path / "map.inp", made) == []
    check(made, solved(*read_abaqus(tmp_path / "map.inp")))
    if kind != "triangle":  # meshio knows CPS3, not CPE3
        assert len(meshio.read(tmp_path / "map.inp").points) == len(made.points)


def test_calculix_returns_the_displacements(tmp_path):
    made = pushed("tetra")
    write_fem(tmp_path / "map.inp", made)
    done = subprocess.run(
        [dicom_maps.tool("ccx"), "map"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stdout
    rows = [line.split() for line in (tmp_path / "map.dat").read_text().splitlines()]
    u = np.array([row[1:] for row in rows if len(row) == 4 and row[0].isdigit()], float)
    wanted = made.displacements[0]
    np.testing.assert_allclose(u, wanted, atol=1e-5 * np.abs(wanted).max())  # seven digits printed


def read_febio(path):
    """Return nodes, cells, E and ν per cell, held nodes and their displacement."""
    root = ET.parse(path).getroot()
    assert root.get("version") == "4.0"
    numbers = {"elem": int, "node": float}
    nodes = [[float(x) for x in one.text.split(",")] for one in root.findall("Mesh/Nodes/node")]
    cells, constants = {}, {}
    mapped = {one.get("name"): [float(e.text) for e in one] for one in root.findall("MeshData/*")}
    materials = {one.get("name"): one for one in root.findall("Material/material")}
    for domain in root.findall("MeshDomains/SolidDomain"):
        material = materials[domain.get("mat")]
        part = root.find(f"Mesh/Elements[@name='{domain.get('name')}']")
        pairs = zip(mapped[material.find("E").text], mapped[material.find("v").text], strict=True)
        for one, pair in zip(part, pairs, strict=True):
            cells[int(one.get("id"))] = [numbers["elem"](x) - 1 for x in one.text.split(",")]
            constants[int(one.get("id"))] = pair
    held = np.array([int(x) - 1 for x in root.find("Mesh/NodeSet[@name='held']").text.split(",")])
    values = [
        mapped[bc.find("value").text]
        for bc in root.findall("Boundary/bc")
        if bc.get("type") == "prescribed displacement"
    ]
    order = sorted(cells)
    return (
        np.array(nodes), np.array([cells[k] for k in order]),
        *np.array([constants[k] for k in order]).T, held, np.array(values).T,
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
def test_a_run_on_the_febio_file_returns_the_displacements(tmp_path, kind):
    made = pushed(kind)
    (note,) = write_fem(tmp_path / "map.feb", made)
    assert "St. Venant-Kirchhoff" in note
    check(made, solved(*read_febio(tmp_path / "map.feb")))


def test_a_planar_map_becomes_a_layer_of_prisms_for_febio(tmp_path):
    made = pushed("triangle")
    notes = write_fem(tmp_path / "map.feb", made)
    assert "layer of solids" in notes[0]
    points, cells, young, nu, held, values = read_febio(tmp_path / "map.feb")
    n = len(made.points)
    assert points.shape == (2 * n, 3) and cells.shape[1] == 6 and values.shape[1] == 2
    assert np.array_equal(cells[:, 3:], cells[:, :3] + n)
    half = held < n
    check(made, solved(points[:n, :2], cells[:, :3], young, nu, held[half], values[half]))


def lacking(made):
    """The same map with two cells not determined."""
    made.status[:2] = 0
    for values in made.values.values():
        values[:2] = np.nan
    return made


def test_cells_without_a_value_are_refused_unless_a_filling_is_said(tmp_path):
    made = lacking(pushed("tetra"))
    with pytest.raises(InputError, match=r"2 of 216 cells have no value.*--fill label"):
        write_fem(tmp_path / "map.inp", made)
    assert not list(tmp_path.iterdir())
    (note,) = write_fem(tmp_path / "map.inp", made, fill="label")
    assert note == "2 cells without a value got the mean of their label"
    young = read_abaqus(tmp_path / "map.inp")[2]
    same = made.labels == made.labels[0]  # of equal size
    assert young[0] == pytest.approx(np.nanmean(made.values["YoungModulus"][same]))
    write_fem(tmp_path / "map.inp", made, fill=1234.0)
    assert (read_abaqus(tmp_path / "map.inp")[2][:2] == 1234.0).all()


def test_another_suffix_and_another_trial_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"name a file that ends in \.vtu"):
        write_fem(tmp_path / "map.txt", pushed("tetra"))
    with pytest.raises(InputError, match="trial 2: the map has trials 1 to 1"):
        write_fem(tmp_path / "map.inp", pushed("tetra"), trial=2)
