"""The picture and the table of a map."""

import csv
import json

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("vtkmodules")
pytest.importorskip("SimpleITK")

from elastoidentify.fem.elastic_constants import young_from_lame
from elastoidentify.fem.forward import box_mesh, square_mesh
from elastoidentify.fem.mesh import make_mesh
from elastoidentify.imaging.image import Image
from elastoidentify.inverse.statistics import cell_errors, core_of, label_statistics
from elastoidentify.report.picture import section
from elastoidentify.report.table import table_text, with_truth, write_table
from elastoidentify.results import Status
from elastoidentify.vtk_io.convert import mesh_to_vtk, set_array
from elastoidentify.vtk_io.picture import draw
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
    all_found, half_found = hatched(tmp_path / "all.png"), hatched(tmp_path / "half.png")
    assert all_found.mean() < 0.03  # letters and lines
    assert half_found.mean() > all_found.mean() + 0.08


def test_where_mu_alone_is_determined_it_is_shown_and_lambda_is_hatched(tmp_path, square):
    points, cells = square
    status = np.full(len(cells), Status.SHEAR_ONLY, np.uint8)
    draw(tmp_path / "alone.png", map_of(points, cells, status))
    draw(tmp_path / "none.png", map_of(points, cells, 0 * status))
    alone, none = (
        [part.mean() for part in np.array_split(hatched(tmp_path / name), 3, axis=1)]
        for name in ("alone.png", "none.png")
    )  # fmt: skip
    for panel, shown in enumerate((True, False, True)):  # μ, λ and the uncertainty of μ
        assert none[panel] > 0.2
        assert alone[panel] < 0.05 if shown else alone[panel] > 0.2


def hatched(file):
    """Which pixels are of the grey behind hatches."""
    picture = pixels(file)
    return (np.ptp(picture, axis=-1) < 0.01) & (np.abs(picture[..., 0] - 0.85) < 0.03)


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


@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
def test_a_section_covers_the_cut_once_each_polygon_in_its_cell(kind):
    points, cells = box_mesh((3, 3, 3), (1.0, 1.0, 1.0), kind)
    normal = np.array([0.1, -0.2, 1.0])
    point = np.array([0.5, 0.5, 0.51])
    cut, corners, numbers = section(points, [(kind, cells)], point, normal)
    assert np.abs((cut - point) @ normal).max() < 1e-12
    area = 0.0
    for corner, number in zip(corners, numbers, strict=True):
        polygon = cut[corner]
        area += (
            np.linalg.norm(
                np.cross(polygon - polygon[0], np.roll(polygon, -1, 0) - polygon[0]).sum(0)
            )
            / 2
        )
        low, high = points[cells[number]].min(0), points[cells[number]].max(0)
        assert ((polygon > low - 1e-9) & (polygon < high + 1e-9)).all()
    assert np.isclose(area, np.linalg.norm(normal))  # over the unit square


# ---- the table


def rows(**changed):
    """Two labels: a pad that is given, tissue of four cells of which two were found."""
    arrays = {
        "labels": np.array([1, 2, 2, 2, 2]),
        "sizes": np.array([4.0, 1.0, 3.0, 2.0, 2.0]),
        "core": np.array([True, False, True, True, True]),
        "status": np.array([1, 2, 2, 0, 3]),
        "lam": np.array([20.0, 4.0, 12.0, np.nan, 1.0]),
        "mu": np.array([5.0, 1.0, 3.0, np.nan, -7.0]),
    } | changed
    errors = np.array([[0, 0], [0.2, -0.2], [0.4, 0.4], [np.nan, np.nan], [1, 1]])
    one = cell_errors(arrays["lam"], arrays["mu"], 10 * errors, errors * changed.get("scale", 1))
    arrays.pop("scale", None)
    return label_statistics(**arrays, errors=one)


def test_only_known_and_identified_cells_count_each_with_its_size():
    pad, tissue = with_truth(rows(), {2: {"Mu": 2.5}})
    assert (pad["cells"], pad["size"], pad["determined"], pad["given"]) == (1, 4.0, 1.0, True)
    assert (tissue["cells"], tissue["size"], tissue["determined"]) == (4, 8.0, 0.5)
    assert not tissue["given"]
    assert (tissue["Mu median"], tissue["Mu mean"]) == (2.0, 2.5)
    assert np.isclose(tissue["Mu spread"], np.sqrt(0.25 * 1.5**2 + 0.75 * 0.5**2))
    assert tissue["Mu true"] == 2.5
    assert np.isnan(pad["Mu true"])


def test_the_standard_error_is_that_of_the_mean_with_what_errors_have_in_common():
    """Samples of the mean: (0.2 + 3·0.4)/4 and (−0.2 + 3·0.4)/4."""
    _, tissue = rows()
    assert np.isclose(tissue["Mu standard error"], np.sqrt((0.35**2 + 0.25**2) / 2))


def test_the_core_is_of_the_cells_that_touch_no_other_label():
    mu = np.r_[9.0, np.arange(1.0, 9.0)]
    labels = np.r_[1, np.full(8, 2)]
    core = np.r_[True, False, False, np.full(6, True)]
    errors = cell_errors(4 * mu, mu, 0.4 * mu[:, None], 0.1 * mu[:, None])
    sizes, status = np.ones(9), np.full(9, Status.IDENTIFIED)
    pad, tissue = label_statistics(labels, sizes, core, status, 4 * mu, mu, errors)
    assert np.isnan(pad["Mu core"]) and np.isnan(pad["Mu core standard error"])
    assert np.isclose(tissue["Mu core"], 5.5)
    assert np.isclose(tissue["Mu core standard error"], 0.55)
    core[3] = False  # five are too few
    assert np.isnan(label_statistics(labels, sizes, core, status, 4 * mu, mu, errors)[1]["Mu core"])
    points, cells = box_mesh((3, 3), (3.0, 3.0), "quad")
    labels = np.where(np.arange(9) == 0, 1, 2)  # the cell at the corner
    core = core_of(make_mesh(points, [("quad", cells)]).node_cells, labels)
    centre = points[cells].mean(axis=1)
    assert np.array_equal(core, (centre > 2).any(axis=1))


def test_errors_that_two_labels_share_cancel_in_their_ratio():
    """Both labels are off by the same factor: the ratio is exact, the values are not."""
    mu = np.array([1.0, 2.0, 2.0])
    errors = cell_errors(4 * mu, mu, 0.4 * mu[:, None], 0.1 * mu[:, None])
    two = label_statistics(
        np.array([1, 2, 2]),
        np.ones(3),
        np.ones(3, bool),
        np.full(3, 2),
        4 * mu,
        mu,
        errors,
        reference=1,
    )
    assert two[1]["Mu ratio"] == 2.0
    assert np.isclose(two[1]["Mu standard error"], 0.2)
    assert two[1]["Mu ratio standard error"] < 1e-15


@pytest.mark.parametrize("shift", [1e-6, -1e-6])
def test_errors_of_young_and_poisson_follow_those_of_lambda_and_mu(shift):
    lam, mu = np.array([4.0]), np.array([1.5])
    young, poisson = young_from_lame(lam, mu)
    for step in ((shift, 0.0), (0.0, shift)):
        moved = young_from_lame(lam + step[0], mu + step[1])
        errors = cell_errors(lam, mu, *(np.array([[one]]) for one in step))
        assert np.isclose(errors.YoungModulus[0, 0], (moved[0] - young)[0], rtol=1e-4)
        assert np.isclose(errors.PoissonRatio[0, 0], (moved[1] - poisson)[0], rtol=1e-4)


def test_the_table_is_written_whole_with_a_row_per_label_and_where_it_comes_from(tmp_path):
    write_table(tmp_path / "map.csv", rows(), {"elastoidentify": "1"})
    read = list(csv.DictReader((tmp_path / "map.csv").open(encoding="utf-8")))
    assert [row["label"] for row in read] == ["1", "2"]
    assert float(read[1]["Lambda median"]) == 8.0
    assert json.loads(read[0]["provenance"]) == {"elastoidentify": "1"}
    assert [file.name for file in tmp_path.iterdir()] == ["map.csv"]


def test_the_table_for_people_says_what_was_given_and_what_was_found():
    named = [{**row, "name": name} for row, name in zip(rows(), ("pad", ""), strict=True)]
    lines = table_text(with_truth(named, {2: {"Mu": 2.5}}), "kPa").splitlines()
    assert "μ mean (kPa)" in lines[0]
    assert lines[1].startswith("1 pad")
    assert "given" in lines[1]
    assert "50 %" in lines[2]
    assert lines[2].split()[-1] == "2.50"


def test_round_off_is_no_error_worth_printing():
    mu = 1000 * (1 + 1e-15 * np.arange(5))
    exact = rows(mu=mu, lam=4 * mu, status=np.array([1, 2, 2, 2, 2]), scale=1e-11)
    exact = [{k: 0.0 if "error" in k else v for k, v in row.items()} for row in exact]
    row = table_text(exact).splitlines()[2].split()
    assert row[2:8] == ["100", "%", "1000", "0", "1000", "0"]
