"""The picture and the table of a map."""

import csv

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("vtkmodules")
pytest.importorskip("SimpleITK")

from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.imaging.image import Image
from elastoidentify.report.picture import draw
from elastoidentify.report.table import label_rows, table_text, write_table
from elastoidentify.vtk_io.convert import mesh_to_vtk, set_array
from matplotlib.image import imread

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def map_of(points, cells, status=None, kind="triangle"):
    """A grid with made-up results: stiff to the right, three labels from top to bottom."""
    centre = points[cells].mean(1)
    status = np.full(len(cells), 2, np.uint8) if status is None else status
    mu = np.where(status > 0, 1000 + 20 * centre[:, 0], np.nan)
    grid = mesh_to_vtk(points, [(kind, cells)])
    for name, values in {
        "Label": (1 + centre[:, 1] // 20).astype(np.int32),
        "Status": status,
        "Mu": mu,
        "Lambda": 4 * mu,
        "MuStd": 0.1 * mu,
        "LambdaStd": 0.4 * mu,
        "YoungModulus": 2.8 * mu,
        "PoissonRatio": np.full(len(cells), 0.4),
    }.items():
        set_array(grid.GetCellData(), name, values)
    return grid


def moved(grid, axes, origin):
    """The same grid elsewhere in space."""
    from elastoidentify.vtk_io.convert import mesh_points

    other = grid.NewInstance()
    other.DeepCopy(grid)
    new = mesh_to_vtk(mesh_points(grid) @ axes.T + origin, np.array([[0, 1, 2]]))
    other.SetPoints(new.GetPoints())
    return other


@pytest.fixture
def square():
    return square_mesh(8, 8, 60.0, 60.0)


def pixels(path):
    return imread(path)[..., :3]


def test_a_map_is_the_same_picture_in_any_plane_of_space(tmp_path, square):
    grid = map_of(*square)
    values = np.random.default_rng(0).random((1, 70, 80)).astype(np.float32)
    rest = Image(values, [-5, -5, 0])
    origin = np.array([3.0, -40.0, 11.0])
    turned = Image(values, TURN @ [-5, -5, 0] + origin, np.ones(3), TURN)
    draw(tmp_path / "upright.png", grid, rest)
    draw(tmp_path / "oblique.png", moved(grid, TURN, origin), turned)
    upright, oblique = pixels(tmp_path / "upright.png"), pixels(tmp_path / "oblique.png")
    assert upright.shape == oblique.shape
    assert (np.abs(upright - oblique).max(-1) > 0.02).mean() < 1e-3


def test_rest_image_and_mesh_are_drawn_in_the_same_place(tmp_path, square):
    points, cells = square
    values = np.zeros((1, 80, 80), np.float32)
    j, i = np.mgrid[:80, :80]
    values[0][(i > 10) & (i < 70) & (j > 10) & (j < 70)] = 1
    rest = Image(values, [-10, -10, 0])
    draw(tmp_path / "map.png", map_of(points, cells), rest)
    picture = pixels(tmp_path / "map.png")
    panel = picture[:, : picture.shape[1] // 4]
    orange = (panel[..., 0] > 0.9) & (np.abs(panel[..., 1] - 0.69) < 0.1) & (panel[..., 2] < 0.2)
    bright = panel.min(-1) > 0.99
    rows, columns = np.nonzero(orange)
    inside = bright[rows.min() + 5 : rows.max() - 5, columns.min() + 5 : columns.max() - 5]
    assert inside.mean() > 0.9  # the rest is outlines between the labels, and the scale bar


def test_cells_without_a_value_are_hatched_and_explained(tmp_path, square):
    points, cells = square
    status = np.full(len(cells), 2, np.uint8)
    draw(tmp_path / "all.png", map_of(points, cells, status))
    status[points[cells].mean(1)[:, 1] < 30] = 0
    draw(tmp_path / "half.png", map_of(points, cells, status))
    grey = [
        (np.ptp(picture, axis=-1) < 0.01) & (np.abs(picture[..., 0] - 0.85) < 0.03)
        for picture in (pixels(tmp_path / "all.png"), pixels(tmp_path / "half.png"))
    ]
    assert grey[0].mean() < 0.03  # letters and lines
    assert grey[1].mean() > grey[0].mean() + 0.08


def test_of_a_volume_a_section_is_drawn(tmp_path):
    points, cells = box_mesh((4, 4, 4), (60.0, 60.0, 60.0), "tetra")
    rest = Image(np.random.default_rng(0).random((12, 12, 12)), [2.5] * 3, [5.0] * 3)
    draw(tmp_path / "section.png", map_of(points, cells, kind="tetra"), rest)
    draw(tmp_path / "alone.png", map_of(points, cells, kind="tetra"))
    for name in ("section.png", "alone.png"):
        assert np.ptp(pixels(tmp_path / name), axis=-1).max() > 0.3


@pytest.mark.parametrize("suffix", ["pdf", "svg"])
def test_pictures_for_print_are_written_too(tmp_path, square, suffix):
    draw(tmp_path / f"map.{suffix}", map_of(*square))
    assert [file.name for file in tmp_path.iterdir()] == [f"map.{suffix}"]


# ---- the table


def arrays():
    return {
        "Label": np.array([1, 2, 2, 2, 2]),
        "Status": np.array([1, 2, 2, 0, 3]),
        "Mu": np.array([5.0, 1.0, 3.0, np.nan, -7.0]),
        "MuStd": np.array([0.0, 0.2, 0.4, np.nan, 1.0]),
        "Lambda": np.array([20.0, 4.0, 12.0, np.nan, 1.0]),
        "LambdaStd": np.array([0.0, 2.0, 4.0, np.nan, 1.0]),
        "YoungModulus": np.array([14.0, 2.8, 8.4, np.nan, 1.0]),
        "PoissonRatio": np.array([0.4, 0.4, 0.4, np.nan, 0.1]),
    }


def test_only_known_and_identified_cells_count():
    pad, tissue = label_rows(arrays(), {2: {"Mu": 2.5}})
    assert (pad["cells"], pad["identified"], pad["known"]) == (1, 1.0, True)
    assert (tissue["cells"], tissue["identified"], tissue["known"]) == (4, 0.5, False)
    assert (tissue["Mu median"], tissue["Mu mean"], tissue["Mu spread"]) == (2.0, 2.0, 1.0)
    assert np.isclose(tissue["Mu std"], 0.3)
    assert tissue["Mu true"] == 2.5
    assert np.isnan(pad["Mu true"])


def test_the_table_is_written_whole_with_a_row_per_label(tmp_path):
    write_table(tmp_path / "map.csv", label_rows(arrays()))
    rows = list(csv.DictReader((tmp_path / "map.csv").open(encoding="utf-8")))
    assert [row["label"] for row in rows] == ["1", "2"]
    assert float(rows[1]["Lambda median"]) == 8.0
    assert [file.name for file in tmp_path.iterdir()] == ["map.csv"]


def test_the_table_for_people_says_what_was_given_and_what_was_found():
    lines = table_text(label_rows(arrays(), {2: {"Mu": 2.5}}), "kPa", {1: "pad"}).splitlines()
    assert "μ median (kPa)" in lines[0]
    assert lines[1].startswith("1 pad")
    assert "given" in lines[1]
    assert "50 %" in lines[2]
    assert lines[2].split()[-1] == "2.50"


def test_round_off_is_no_error_worth_printing():
    exact = arrays()
    exact["Mu"][1:] = 1000 * (1 + 1e-15 * np.arange(4))
    exact["MuStd"][1:] = 1e-11
    exact["Status"][1:] = 2
    row = table_text(label_rows(exact)).splitlines()[2].split()
    assert row[2:7] == ["100", "%", "1000", "0", "0"]
