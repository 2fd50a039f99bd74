"""The command line: exit codes, one line for bad input, outputs whole or not at all."""

import csv
import json
import os
import subprocess
import sys

import elastoidentify
import numpy as np
import pytest
from elastoidentify import cli
from elastoidentify.errors import Cancelled
from elastoidentify.fem.forward import solve_push, square_mesh
from option_samples import needing

ONLY = "says something only with --unknowns young: add it"
KNOWN = ["--known", "1:E=5000,nu=0.43"]
BY_LABEL = ["--group", "label"]
PAD, TISSUE, INCLUSION = 1, 2, 3


def run(*arguments, capsys=None):
    """Run a command line in this process; returns code, output, errors."""
    code = cli.main([str(argument) for argument in arguments])
    if capsys is None:
        return code, "", ""
    return code, *capsys.readouterr()


@pytest.fixture
def pushed_mesh(tmp_path):
    """A function that writes a square with exact displacements, changed as wanted."""
    pytest.importorskip("vtkmodules")
    pytest.importorskip("SimpleITK")
    from elastoidentify.vtk_io.convert import mesh_to_vtk, set_array
    from elastoidentify.vtk_io.vtu import write_mesh

    def make(change=lambda arrays: None, name="pushed.vtu"):
        points, cells = square_mesh(6, 6, 60.0, 60.0)
        centre = points[cells].mean(1)
        labels = np.where(centre[:, 1] > 30, PAD, TISSUE)
        labels[np.hypot(*(centre - [30, 15]).T) < 9] = INCLUSION
        young = np.choose(labels - 1, [5000.0, 3000.0, 9000.0])
        lam, mu = young * 0.43 / (1.43 * 0.14), young / 2.86
        held = np.isin(points[:, 1], [0.0, 60.0])
        moved = np.flatnonzero(held)
        top = points[moved, 1:] == 60
        trials = [
            solve_push(points, cells, lam, mu, moved, np.where(top, push, 0.0))
            for push in ((0.0, -0.6), (0.6, -0.6))
        ]
        arrays = {
            "points": points,
            "cells": cells,
            "Label": labels.astype(np.int32),
            "ReactionNodes": held.astype(np.uint8),
            "trials": trials,
            "mu": mu,
        }
        change(arrays)
        grid = mesh_to_vtk(arrays["points"], arrays["cells"])
        set_array(grid.GetCellData(), "Label", arrays["Label"])
        set_array(grid.GetPointData(), "ReactionNodes", arrays["ReactionNodes"])
        for number, trial in enumerate(arrays["trials"], 1):
            trial = np.column_stack([trial, np.zeros(len(trial))])
            set_array(grid.GetPointData(), f"Displacement_{number}", trial)
        write_mesh(tmp_path / name, grid)
        return tmp_path / name, arrays

    return make


# ---- what works


def test_identify_writes_map_table_and_picture_and_says_what_it_found(
    tmp_path, pushed_mesh, capsys
):
    pytest.importorskip("matplotlib")
    from elastoidentify.vtk_io.convert import get_array
    from elastoidentify.vtk_io.vtu import read_mesh

    mesh, arrays = pushed_mesh()
    out, table, picture = (tmp_path / f"map.{suffix}" for suffix in ("vtu", "csv", "png"))
    code, text, _ = run(
        *("identify", mesh, "-o", out, *KNOWN, "--method", "global"),
        *("--table", table, "--picture", picture),
        capsys=capsys,
    )
    assert code == 0
    found = get_array(read_mesh(out).GetCellData(), "Mu")
    assert np.allclose(found, arrays["mu"], rtol=1e-6)
    rows = list(csv.DictReader(table.open(encoding="utf-8")))
    assert [int(row["label"]) for row in rows] == [PAD, TISSUE, INCLUSION]
    assert np.isclose(float(rows[2]["Mu median"]), 9000 / 2.86, rtol=1e-6)
    assert float(rows[2]["determined"]) == 1.0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "method: global" in text
    assert "μ mean (Pa)" in text


def test_options_reach_the_identification(tmp_path, pushed_mesh):
    from elastoidentify.vtk_io.convert import get_text
    from elastoidentify.vtk_io.vtu import read_mesh

    mesh, _ = pushed_mesh()
    out = tmp_path / "map.vtu"
    options = ["--unknowns", "young", "--poisson", "0.43", *BY_LABEL]
    assert run("identify", mesh, "-o", out, *KNOWN, "--method", "global", *options)[0] == 0
    report = json.loads(get_text(read_mesh(out), "IdentificationReport"))
    assert (report["unknowns"], report["grouping"], report["trials"]) == ("young", "label", 2)


def test_phantom_mesh_and_displacement_work_from_file_to_file(tmp_path, capsys):
    pytest.importorskip("vtkmodules")
    pytest.importorskip("skfem")
    from elastoidentify.vtk_io.convert import get_array, mesh_points
    from elastoidentify.vtk_io.vtu import read_mesh

    made = tmp_path / "phantom"
    small = ["--image", "speckle", "--pixels", "64", "--push", "0,0.05"]
    code, text, _ = run("phantom", "--out", made, *small, capsys=capsys)
    assert code == 0
    assert "elastoidentify run --rest" in text
    assert not (made / "pushed_2.nrrd").exists()
    mesh = tmp_path / "mesh.vtu"
    rigid = ["--rigid", "4", "--rigid", "5"]
    edge = ["--edge-length", "15"]
    assert run("mesh", made / "segmentation.nrrd", "-o", mesh, *edge, *rigid)[0] == 0
    grid = read_mesh(mesh)
    assert set(get_array(grid.GetCellData(), "Label")) == {1, 2, 3}

    points = mesh_points(grid)
    table = tmp_path / "points.csv"
    rows = np.column_stack([points, 0.01 * points])
    np.savetxt(table, rows, delimiter=",", header="x,y,z,u,v,w", comments="")
    out = tmp_path / "displaced.vtu"
    arguments = ["--points", table, "--points", table, "--noise", "0.1"]
    assert run("displacement", "--mesh", mesh, *arguments, "-o", out)[0] == 0
    data = read_mesh(out).GetPointData()
    assert np.allclose(get_array(data, "Displacement_2"), 0.01 * points)
    assert np.allclose(get_array(data, "DisplacementInformation_2")[:, :3], 100.0)
    assert get_array(data, "Covered_2").all()

    half = rows[points[:, 0] < np.quantile(points[:, 0], 0.8)]
    np.savetxt(table, half, delimiter=",", header="x,y,z,u,v,w", comments="")
    code, text, _ = run("displacement", "--mesh", mesh, "--points", table, "-o", out, capsys=capsys)
    assert code == 0
    assert "give the noise to take that away" in text
    assert 0.5 < get_array(read_mesh(out).GetPointData(), "Covered_1").mean() < 0.95


def test_table2_prints_the_papers_figures(capsys):
    code, text, _ = run("table2", capsys=capsys)
    assert code == 0
    assert "2.07e+04" in text
    assert "1.07e+04" in text


def test_help_version_and_module(capsys):
    assert run("--version", capsys=capsys)[:2] == (
        0,
        f"elastoidentify {elastoidentify.__version__}\n",
    )
    code, text, _ = run("run", "--help", capsys=capsys)
    assert code == 0
    assert "--reaction-box" in text
    done = subprocess.run(
        [sys.executable, "-m", "elastoidentify", "--help"], capture_output=True, encoding="utf-8"
    )
    assert done.returncode == 0
    assert "identify" in done.stdout


def test_help_and_numerics_load_neither_vtk_nor_itk():
    code = (
        "import sys; from elastoidentify import cli; cli.main(['table2']); "
        "print([m for m in ('vtkmodules', 'itk', 'SimpleITK', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=True, encoding="utf-8"
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_help_does_not_wait_for_the_numerics():
    code = (
        "import sys; from elastoidentify import cli; cli.main(['--help']); "
        "print([m for m in ('numpy', 'scipy') if m in sys.modules]); "
        "import elastoidentify as ei; print(ei.identify.__module__, 'identify' in dir(ei))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=True, encoding="utf-8"
    )
    assert done.stdout.splitlines()[-2:] == ["[]", "elastoidentify.inverse.identify True"]


def test_a_terminal_without_greek_letters_gets_question_marks():
    done = subprocess.run(
        [sys.executable, "-m", "elastoidentify", "table2"],
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        encoding="ascii",
    )
    assert done.returncode == 0
    assert "2.07e+04" in done.stdout


# ---- what is refused


def refused(code, out, err, said, folder):
    """Check exit code 2, one line on standard error that says it, and no output file."""
    assert code == 2
    lines = err.strip().splitlines()
    assert len(lines) == 1
    assert said in lines[0]
    assert not list(folder.glob("out*"))
    assert not list(folder.glob(".out*"))


def nan_displacement(arrays):
    arrays["trials"][1][7] = np.nan


def inverted_cell(arrays):
    arrays["cells"][5] = arrays["cells"][5][::-1]


def folded_cell(arrays):
    arrays["points"] = arrays["points"].copy()
    arrays["points"][24] = arrays["points"][24] + [25.0, 0.0]


def no_trials(arrays):
    arrays["trials"] = []


def one_trial(arrays):
    arrays["trials"] = arrays["trials"][:1]


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (lambda arrays: None, [], "no cell is known"),
        (lambda arrays: None, ["--known", "9:E=5000,nu=0.43"], "label 9 does not occur"),
        (one_trial, [*KNOWN, "--method", "global"], "fewer equations"),
        (no_trials, KNOWN, "no displacements"),
        (nan_displacement, KNOWN, "displacement"),
        (inverted_cell, KNOWN, "nvert"),
        (folded_cell, KNOWN, "folded"),
        (lambda arrays: None, ["--known", "1:E=-3,nu=0.43"], "Young"),
        (lambda arrays: None, ["--known", "1:E=5000,nu=0.5"], "Poisson"),
        (lambda arrays: None, ["--known", "pad"], "LABEL:E=MODULUS,nu=RATIO"),
        (lambda arrays: None, [*KNOWN, "--unknowns", "young"], "Poisson"),
        *(
            (lambda arrays: None, [*KNOWN, option.flags[0], "0.1"], f"{option.flags[0]} {ONLY}")
            for option in needing()
        ),
        (lambda arrays: None, [*KNOWN, "--method", "magic"], "magic"),
        (lambda arrays: None, [*KNOWN, "--picture", "out.bmp"], ".png"),
    ],
)
def test_identify_refuses_bad_input_in_one_line(
    tmp_path, pushed_mesh, capsys, change, options, said
):
    mesh, _ = pushed_mesh(change)
    arguments = ["identify", mesh, "-o", tmp_path / "out.vtu", *options]
    refused(*run(*arguments, capsys=capsys), said, tmp_path)


@pytest.mark.parametrize(
    ("output", "said"),
    [("nowhere/out.vtu", "does not exist"), ("out.vtk", ".vtu"), ("folder.vtu", "is a folder")],
)
def test_outputs_that_cannot_be_written_are_refused_first(
    tmp_path, pushed_mesh, capsys, output, said
):
    (tmp_path / "folder.vtu").mkdir()
    refused(
        *run("identify", "missing.vtu", "-o", tmp_path / output, *KNOWN, capsys=capsys),
        said,
        tmp_path,
    )


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(tmp_path, capsys):
    pytest.importorskip("SimpleITK")
    (tmp_path / "file").write_text("")
    for command in ("phantom", "demo"):
        code, out, err = run(command, "--out", tmp_path / "file" / "folder", capsys=capsys)
        refused(code, out, err, "cannot be made", tmp_path)
        assert out == ""


def test_unreadable_files_are_refused(tmp_path, capsys):
    pytest.importorskip("vtkmodules")
    pytest.importorskip("SimpleITK")
    (tmp_path / "text.vtu").write_text("no mesh")
    (tmp_path / "text.nrrd").write_text("no image")
    output = ["-o", tmp_path / "out.vtu"]
    for arguments, said in (
        (["identify", tmp_path / "text.vtu", *KNOWN], "text.vtu"),
        (["identify", tmp_path / "missing.vtu", *KNOWN], "missing.vtu"),
        (["mesh", tmp_path / "text.nrrd", "--edge-length", "3"], "text.nrrd"),
        (["mesh", tmp_path / "missing.nrrd", "--edge-length", "3"], "missing.nrrd"),
    ):
        refused(*run(*arguments, *output, capsys=capsys), said, tmp_path)


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """A folder with a small phantom's images and some that do not fit."""
    pytest.importorskip("skfem")
    pytest.importorskip("SimpleITK")
    from elastoidentify.imaging.image import Image
    from elastoidentify.imaging.io import write_image
    from elastoidentify.imaging.phantom.planar import make_phantom, write_phantom

    folder = tmp_path_factory.mktemp("images")
    made = make_phantom(pixels=64, elements=16)
    write_phantom(folder, made)
    rest = made.rest
    write_image(folder / "constant.nrrd", rest.with_array(np.full_like(rest.array, 7)))
    write_image(folder / "smaller.nrrd", Image(rest.array[:, :50, :50], spacing=rest.spacing))
    holes = rest.array.astype(np.float32)
    holes[0, 3, 4:7] = np.nan
    write_image(folder / "nan.nrrd", rest.with_array(holes))
    for name, image, slices in (("block", made.segmentation, 12), ("thin", rest, 4)):
        stack = np.repeat(image.array, slices, axis=0)
        place = image.origin, image.spacing, image.direction
        write_image(folder / f"{name}.nrrd", Image(stack, *place))
    write_colours(folder / "colours.nrrd", rest.array)
    return folder


def write_colours(path, grey):
    import SimpleITK as sitk

    channels = np.stack([grey, 0.5 * grey, grey], axis=-1).astype(np.float32)
    sitk.WriteImage(sitk.GetImageFromArray(channels, isVector=True), str(path))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"--pushed": "smaller.nrrd"}, "another part of the world"),
        ({"--pushed": "constant.nrrd"}, "everywhere"),
        ({"--rest": "constant.nrrd"}, "everywhere"),
        ({"--rest": "missing.nrrd"}, "no such file"),
        ({"--pushed": "nan.nrrd"}, "3 voxels that are not numbers"),
        ({"--pushed": "colours.nrrd"}, "convert it to one grey value"),
        ({"--segmentation": "block.nrrd"}, "mesh the segmentation of that same slice"),
        ({"--segmentation": "block.nrrd", "--rest": "thin.nrrd"}, "lie in the rest image"),
        ({"--segmentation": "rest.nrrd"}, "whole numbers"),
        ({"--segmentation": "smaller.nrrd"}, "whole numbers"),
        ({"--edge-length": "-1"}, "--edge-length"),
        ({"--known": "8:E=5000,nu=0.45"}, "label 8"),
        ({"--rigid": "9"}, "9"),
        ({"--reaction-box": "1,2,3"}, "4 or 6 numbers"),
    ],
)
def test_run_refuses_bad_input_in_one_line(tmp_path, images, capsys, changed, said):
    pytest.importorskip("vtkmodules")
    options = {
        "--rest": "rest.nrrd",
        "--pushed": "pushed_1.nrrd",
        "--segmentation": "segmentation.nrrd",
        "--edge-length": "15",
        "--known": "1:E=5000,nu=0.45",
        "--rigid": "4",
        "--method": "regularized",
    } | changed
    words = []
    for name, value in options.items():
        words += [name, images / value if value.endswith("nrrd") else value]
    refused(*run("run", *words, "-o", tmp_path / "out.vtu", capsys=capsys), said, tmp_path)


@pytest.mark.parametrize(
    ("words", "said", "meshed"),
    [
        (["--pushed", "missing.nrrd"], "missing.nrrd: no such file", False),
        (["--mask", "missing.nrrd"], "missing.nrrd: no such file", False),
        (["--method", "global"], "fewer equations", True),
        (["--known", "8:E=5000,nu=0.45"], "label 8", True),
        (["--unknowns", "young"], "Poisson", True),
        (["--mask", "smaller.nrrd", *BY_LABEL], "mask image covers another part", True),
        (["--parameters", "missing.txt", *BY_LABEL], "missing.txt", True),
        (["--reference", "next"], "next", False),
    ],
)
def test_run_checks_everything_before_it_registers(
    tmp_path, images, capsys, monkeypatch, words, said, meshed
):
    pytest.importorskip("vtkmodules")
    monkeypatch.chdir(images)
    monkeypatch.setattr(
        "elastoidentify.imaging.registration.registration.ElastixProcess", pytest.fail
    )
    from elastoidentify.imaging.meshing import mesh_segmentation

    made = []
    monkeypatch.setattr(
        "elastoidentify.pipeline.mesh_segmentation",
        lambda *words, **more: made.append(1) or mesh_segmentation(*words, **more),
    )
    files = ["--rest", "rest.nrrd", "--pushed", "pushed_1.nrrd"]
    files += ["--segmentation", "segmentation.nrrd", "--edge-length", "15", "--rigid", "4"]
    given = ["run", *files, "--known", "1:E=5000,nu=0.45", "-o", tmp_path / "out.vtu"]
    code, out, err = run(*given, *words, capsys=capsys)
    refused(code, out, err, said, tmp_path)
    assert bool(made) == meshed


def test_one_image_alone_is_refused(tmp_path, images, capsys):
    pytest.importorskip("vtkmodules")
    words = ["register", "--mesh", "mesh.vtu", "--pushed", images / "pushed_1.nrrd"]
    refused(*run(*words, "-o", tmp_path / "out.vtu", capsys=capsys), "second pushed", tmp_path)


def test_a_refused_phantom_leaves_no_folder_and_keeps_one_that_was_there(tmp_path, capsys):
    pytest.importorskip("SimpleITK")
    wrong = ["--image", "speckle", "--pixels", "4"]
    for folder in (tmp_path / "new" / "deep", tmp_path / "old"):
        (tmp_path / "old").mkdir(exist_ok=True)
        code, _, err = run("phantom", "--out", folder, *wrong, capsys=capsys)
        assert (code, err.count("\n")) == (2, 1)
        assert "at least 16" in err
    assert not (tmp_path / "new").exists()
    assert (tmp_path / "old").is_dir()


# ---- what stops


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), Cancelled("by the user")])
def test_cancel_is_one_line_exit_1_and_no_output(tmp_path, pushed_mesh, capsys, monkeypatch, stop):
    def cancel(*arguments, **options):
        raise stop

    mesh, _ = pushed_mesh()
    monkeypatch.setattr("elastoidentify.pipeline.identify", cancel)
    code, _, err = run("identify", mesh, "-o", tmp_path / "out.vtu", *KNOWN, capsys=capsys)
    assert (code, err) == (1, "elastoidentify: cancelled, nothing was written\n")
    assert not (tmp_path / "out.vtu").exists()


def test_a_defect_is_one_line_and_exit_1(tmp_path, pushed_mesh, capsys, monkeypatch):
    def fail(*arguments, **options):
        raise ZeroDivisionError("somewhere")

    mesh, _ = pushed_mesh()
    monkeypatch.setattr("elastoidentify.pipeline.identify", fail)
    code, _, err = run("identify", mesh, "-o", tmp_path / "out.vtu", *KNOWN, capsys=capsys)
    assert code == 1
    assert len(err.splitlines()) == 1
    assert "ZeroDivisionError: somewhere" in err
