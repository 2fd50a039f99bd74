"""Meshes from other programs: mended with a sentence, or refused in one line."""

import struct

import numpy as np
import pytest
from elastoidentify.errors import InputError
from elastoidentify.fem.contact import split_nodes
from elastoidentify.vtk_io import checks, convert
from elastoidentify.vtk_io.vtu import read_mesh, write_mesh
from vtkmodules.vtkCommonCore import vtkFloatArray, vtkPoints, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid
from vtkmodules.vtkIOXML import (
    vtkXMLPolyDataWriter,
    vtkXMLUnstructuredGridReader,
    vtkXMLUnstructuredGridWriter,
)


def block(n=6, size=60.0, kind="triangle"):
    """Return a square mesh with labels 1 (upper half) and 2, pushed by a few percent."""
    y, x = np.mgrid[: n + 1, : n + 1] * (size / n)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = np.column_stack([a, a + 1, a + n + 2, a + n + 1])
    if kind == "triangle":
        cells = np.stack([cells[:, [0, 1, 3]], cells[:, [1, 2, 3]]], 1).reshape(-1, 3)
    grid = convert.mesh_to_vtk(points, [(kind, cells)])
    upper = points[cells].mean(axis=1)[:, 1] > size / 2
    convert.set_array(grid.GetCellData(), "Label", np.where(upper, 1, 2).astype(np.int32))
    push = np.column_stack([0.01 * points[:, 1], -0.05 * points[:, 1], 0 * points[:, 0]])
    push[:, 0] += 0.01 * points[:, 0] * points[:, 1] / size
    convert.set_array(grid.GetPointData(), "Displacement_1", push)
    return grid


def in_two_pieces(grid, slip=0.0):
    """Return the mesh cut at mid-width, the nodes of the seam stored for each piece."""
    points, [(kind, cells)] = convert.mesh_points(grid), convert.mesh_blocks(grid)[0]
    right = points[cells].mean(axis=1)[:, 0] > np.ptp(points[:, 0]) / 2
    u = convert.get_array(grid.GetPointData(), "Displacement_1")
    cells = cells + right[:, None] * len(points)
    made = convert.mesh_to_vtk(np.vstack([points, points]), [(kind, cells)])
    labels = convert.get_array(grid.GetCellData(), "Label")
    convert.set_array(made.GetCellData(), "Label", labels)
    convert.set_array(made.GetPointData(), "Displacement_1", np.vstack([u, u + slip]))
    reaction = np.zeros(2 * len(points), np.uint8)
    reaction[3] = 1  # on the seam, in one of the pieces only
    convert.set_array(made.GetPointData(), "ReactionNodes", reaction)
    return made


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_a_seam_becomes_one_node_each_and_keeps_every_array(kind):
    whole = block(kind=kind)
    mended, notes = checks.sound_mesh(in_two_pieces(whole))
    assert "stored twice" in notes[0] and len(notes) == 1
    assert mended.GetNumberOfCells() == whole.GetNumberOfCells()
    reaction = checks.reaction_nodes(mended) != 0
    assert reaction.sum() == 1
    assert np.allclose(convert.mesh_points(mended)[reaction], [[30, 0, 0]])
    points = convert.mesh_points(mended)
    u = convert.get_array(mended.GetPointData(), "Displacement_1")
    assert np.allclose(u[:, 1], -0.05 * points[:, 1])


def test_a_seam_that_slips_is_said_and_left():
    mended, notes = checks.sound_mesh(in_two_pieces(block(), slip=1.0))
    assert "move differently" in notes[0] and "2 pieces" in notes[1]
    assert mended.GetNumberOfPoints() == 98


def test_pieces_that_share_no_node_are_said():
    grid = in_two_pieces(block())
    points = convert.mesh_points(grid)
    points[49:] += [200.0, 0, 0]
    far = vtkPoints()
    far.SetData(convert.numpy_to_vtk(points, deep=True))
    grid.SetPoints(far)
    _, notes = checks.sound_mesh(grid)
    assert "2 pieces that share no node" in notes[0]


def test_ghost_cells_are_taken_out():
    grid = block()
    ghost = np.zeros(grid.GetNumberOfCells(), np.uint8)
    ghost[:5] = checks.DUPLICATE
    ghost[5] = checks.HIDDEN
    convert.set_array(grid.GetCellData(), checks.GHOSTS, ghost)
    mended, notes = checks.sound_mesh(grid)
    assert mended.GetNumberOfCells() == grid.GetNumberOfCells() - 6
    assert "6 ghost cells" in notes[0]
    labels = convert.get_array(grid.GetCellData(), "Label")[6:]
    assert np.array_equal(checks.cell_labels(mended), labels)


@pytest.mark.parametrize("off", [-9e-4, -1e-7, 1e-7, 9e-4])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_labels_near_whole_numbers_are_rounded(off, dtype):
    grid = block()
    labels = convert.get_array(grid.GetCellData(), "Label").copy()
    convert.set_array(grid.GetCellData(), "Label", (labels + off).astype(dtype))
    mended, _ = checks.sound_mesh(grid)
    assert np.array_equal(convert.get_array(mended.GetCellData(), "Label"), labels)


@pytest.mark.parametrize("value", [0.5, 1.002, np.nan, np.inf, -np.inf, 1e12])
def test_other_labels_are_refused_with_the_cell(value):
    grid = block()
    labels = convert.get_array(grid.GetCellData(), "Label").astype(float)
    labels[7] = value
    convert.set_array(grid.GetCellData(), "Label", labels)
    with pytest.raises(InputError, match="cell 7"):
        checks.cell_labels(grid)


def test_information_of_another_number_of_components_is_refused():
    grid = block()
    convert.set_array(
        grid.GetPointData(), "DisplacementInformation_1", np.ones((grid.GetNumberOfPoints(), 3))
    )
    with pytest.raises(InputError, match=r"DisplacementInformation_1.*six components"):
        checks.information(grid, ["Displacement_1"])


def test_displacements_in_another_unit_are_refused():
    grid = block(12)
    u = convert.get_array(grid.GetPointData(), "Displacement_1").astype(float)
    checks.check_unit(grid, u[None], ["Displacement_1"])
    checks.check_unit(grid, np.full_like(u[None], np.nan), ["Displacement_1"])  # a lost trial
    with pytest.raises(InputError, match=r"Displacement_1.*unit of length"):
        checks.check_unit(grid, 1000 * u[None], ["Displacement_1"])
    no_weight = np.zeros((1, len(u), 3, 3))
    checks.check_unit(grid, 1000 * u[None], ["Displacement_1"], no_weight)


def test_triangles_called_tetrahedra_are_refused_not_read_beyond_the_end(tmp_path):
    grid = block()
    wrong = vtkUnstructuredGrid()
    wrong.SetPoints(grid.GetPoints())
    types = np.full(grid.GetNumberOfCells(), 10, np.uint8)
    wrong.SetCells(convert.numpy_to_vtk(types, deep=True), grid.GetCells())
    with pytest.raises(InputError, match="called tetra"):
        convert.mesh_blocks(wrong)


def test_a_node_that_is_not_there_is_refused():
    points = np.zeros((3, 3))
    with pytest.raises(InputError, match="node 7"):
        convert.mesh_blocks(convert.mesh_to_vtk(points, [("triangle", np.array([[0, 1, 7]]))]))


# ---- files


def surface(lines=False):
    """Return two triangles and a quad, maybe with a line, as vtkPolyData with cell data."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0.0]])
    nodes, polygons = vtkPoints(), vtkCellArray()
    nodes.SetData(convert.numpy_to_vtk(points, deep=True))
    for cell in ([0, 1, 2], [0, 2, 3], [1, 4, 5, 2]):
        polygons.InsertNextCell(len(cell), cell)
    data = vtkPolyData()
    data.SetPoints(nodes)
    data.SetPolys(polygons)
    labels = [1, 2, 3]
    if lines:
        line = vtkCellArray()
        line.InsertNextCell(2, [0, 4])
        data.SetLines(line)
        labels = [9, *labels]
    convert.set_array(data.GetCellData(), "Label", np.array(labels, np.int32))
    return data


@pytest.mark.parametrize("lines", [False, True])
def test_the_polygons_of_a_surface_file_are_a_mesh(tmp_path, lines):
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(str(tmp_path / "surface.vtp"))
    writer.SetInputData(surface(lines))
    writer.Write()
    grid = read_mesh(tmp_path / "surface.vtp")
    assert [kind for kind, _ in convert.mesh_blocks(grid)[0]] == ["triangle", "quad"]
    assert checks.cell_labels(grid).tolist() == [1, 2, 3]


def write(path, grid, mode):
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    getattr(writer, f"SetDataModeTo{mode[0]}")()
    if mode[0] == "Appended" and mode[1] == "raw":
        writer.EncodeAppendedDataOff()
    packers = {"none": "None", "lz4": "LZ4", "lzma": "LZMA", "zlib": "ZLib"}
    getattr(writer, f"SetCompressorTypeTo{packers[mode[2]]}")()
    writer.Write()


MODES = [
    ("Ascii", "", "none"),
    *(("Binary", "", packed) for packed in ("none", "zlib", "lz4", "lzma")),
    *(("Appended", form, packed) for form in ("raw", "base64") for packed in ("none", "zlib")),
]  # fmt: skip


@pytest.mark.parametrize("mode", MODES)
def test_every_form_of_vtu_is_read_and_its_cut_off_is_not(tmp_path, mode):
    grid = block()
    write(tmp_path / "mesh.vtu", grid, mode)
    back = read_mesh(tmp_path / "mesh.vtu")
    assert np.allclose(convert.mesh_points(back), convert.mesh_points(grid))
    whole = (tmp_path / "mesh.vtu").read_bytes()
    for share in (0.2, 0.5, 0.8, 0.97):
        (tmp_path / "cut.vtu").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"cut\.vtu"):
            read_mesh(tmp_path / "cut.vtu")


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("what", ["NumberOfPoints", "NumberOfCells"])
@pytest.mark.parametrize("claim", [2_000_000_000, 2**62, -1, 100])
def test_a_file_that_claims_more_than_it_holds_is_refused(tmp_path, mode, what, claim):
    grid = block()
    write(tmp_path / "mesh.vtu", grid, mode)
    number = {"NumberOfPoints": grid.GetNumberOfPoints(), "NumberOfCells": grid.GetNumberOfCells()}
    old, new = (f'{what}="{n}"'.encode() for n in (number[what], claim))
    whole = (tmp_path / "mesh.vtu").read_bytes()
    assert old in whole
    (tmp_path / "lie.vtu").write_bytes(whole.replace(old, new))
    with pytest.raises(InputError, match=r"lie\.vtu"):
        read_mesh(tmp_path / "lie.vtu")


def test_a_block_that_claims_more_than_it_holds_is_refused(tmp_path):
    write(tmp_path / "mesh.vtu", block(), ("Appended", "raw", "none"))
    whole = (tmp_path / "mesh.vtu").read_bytes()
    start = whole.index(b"_", whole.index(b"<AppendedData")) + 1
    for size in (2**31, 2**32 - 8):
        (tmp_path / "lie.vtu").write_bytes(
            whole[:start] + struct.pack("<I", size) + whole[start + 4 :]
        )
        with pytest.raises(InputError, match=r"lie\.vtu"):
            read_mesh(tmp_path / "lie.vtu")


def test_entities_are_refused(tmp_path):
    bomb = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "bbbb">]><VTKFile type="&b;"></VTKFile>'
    (tmp_path / "bomb.vtu").write_text(bomb)
    with pytest.raises(InputError, match="entities"):
        read_mesh(tmp_path / "bomb.vtu")


REPORT = '{"method": "regularized", "μ": [1, 2]}'


def test_what_we_write_opens_in_meshio_and_pyvista_with_its_texts(tmp_path):
    meshio, pyvista = pytest.importorskip("meshio"), pytest.importorskip("pyvista")
    grid = block()
    convert.set_text(grid, "IdentificationReport", REPORT)
    convert.set_text(grid, "MeshNotes", "")
    write_mesh(tmp_path / "map.vtu", grid)
    for found in (meshio.read(tmp_path / "map.vtu"), pyvista.read(tmp_path / "map.vtu")):
        assert np.allclose(found.points, convert.mesh_points(grid))
        assert bytes(found.field_data["IdentificationReport"]).decode() == REPORT
    assert convert.get_text(read_mesh(tmp_path / "map.vtu"), "IdentificationReport") == REPORT
    assert convert.get_text(read_mesh(tmp_path / "map.vtu"), "MeshNotes") == ""


def test_texts_of_files_written_as_vtk_does_are_read_too(tmp_path):
    grid = block()
    convert.set_text(grid, "IdentificationReport", REPORT)
    for mode in MODES:
        write(tmp_path / "old.vtu", grid, mode)
        assert convert.get_text(read_mesh(tmp_path / "old.vtu"), "IdentificationReport") == REPORT


def test_a_host_that_reads_the_file_itself_gets_the_report(tmp_path):
    grid = block()
    convert.set_text(grid, "IdentificationReport", REPORT)
    write_mesh(tmp_path / "map.vtu", grid)
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(tmp_path / "map.vtu"))
    reader.Update()
    assert convert.get_text(reader.GetOutput(), "IdentificationReport") == REPORT


def test_foreign_bytes_stay_bytes_and_lists_of_texts_stay_lists(tmp_path):
    grid = block()
    numbers, words = vtkFloatArray(), vtkStringArray()
    numbers.SetName("TimeValue")
    numbers.InsertNextValue(2.5)
    words.SetName("Names")
    for word in ("pad", "", "Gewebe ä"):
        words.InsertNextValue(word)
    for array in (numbers, words):
        grid.GetFieldData().AddArray(array)
    convert.set_array(grid.GetFieldData(), "Bytes", np.arange(5, dtype=np.uint8))
    write_mesh(tmp_path / "map.vtu", grid)
    fields = read_mesh(tmp_path / "map.vtu").GetFieldData()
    assert fields.GetArray("TimeValue").GetValue(0) == 2.5
    assert fields.GetArray("Bytes").GetNumberOfTuples() == 5
    back = fields.GetAbstractArray("Names")
    assert [back.GetValue(n) for n in range(3)] == ["pad", "", "Gewebe ä"]


def test_the_table_that_we_write_opens_in_pandas(tmp_path):
    pandas = pytest.importorskip("pandas")
    from elastoidentify.report.table import write_table

    rows = [
        {"label": 1, "name": 'pad, "upper"', "YoungModulus median": 5000.0, "unit": "Pa"},
        {"label": 2, "name": "Gewebe ä", "YoungModulus median": float("nan"), "unit": "Pa"},
    ]
    write_table(tmp_path / "map.csv", rows, {"files": ["a,b.nrrd", 'c"d\n']})
    found = pandas.read_csv(tmp_path / "map.csv")
    assert found["label"].tolist() == [1, 2]
    assert found["name"].tolist() == ['pad, "upper"', "Gewebe ä"]
    assert found["YoungModulus median"][0] == 5000.0
    assert np.isnan(found["YoungModulus median"][1])
    assert "a,b.nrrd" in found["provenance"][0]


def test_two_labels_that_are_said_to_slide_keep_their_own_nodes():
    whole = block()
    points, [(kind, cells)] = convert.mesh_points(whole), convert.mesh_blocks(whole)[0]
    labels = convert.get_array(whole.GetCellData(), "Label")
    split, origin = split_nodes(cells, labels, [(1, 2)])
    grid = convert.mesh_to_vtk(points[origin], [(kind, split)])
    convert.set_array(grid.GetCellData(), "Label", labels)
    u = convert.get_array(whole.GetPointData(), "Displacement_1")[origin]
    convert.set_array(grid.GetPointData(), "Displacement_1", u)
    kept, notes = checks.sound_mesh(grid, [(1, 2)])
    assert kept.GetNumberOfPoints() == len(points) + 7 and not notes
    mended, notes = checks.sound_mesh(grid)
    assert "stored twice" in notes[0]
    assert mended.GetNumberOfPoints() == len(points)
