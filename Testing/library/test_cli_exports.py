"""Results leave the box from the command line: files written, or one line why not."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest
from elastoidentify import cli
from elastoidentify.fem.forward import solve_push, square_mesh

pytest.importorskip("vtkmodules")
sitk = pytest.importorskip("SimpleITK")

KNOWN = ["--known", "1:E=5000,nu=0.43"]


def run(*arguments, capsys):
    code = cli.main([str(argument) for argument in arguments])
    return code, *capsys.readouterr()


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A folder with rest.nrrd and pushed.vtu: a square of 60 mm, the pad above, exact pushes."""
    from elastoidentify.imaging.image import Image
    from elastoidentify.imaging.io import write_image
    from elastoidentify.vtk_io.convert import mesh_to_vtk, set_array
    from elastoidentify.vtk_io.vtu import write_mesh

    folder = tmp_path_factory.mktemp("case")
    points, cells = square_mesh(6, 6, 60.0, 60.0)
    labels = np.where(points[cells].mean(1)[:, 1] > 30, 1, 2)
    young = np.where(labels == 1, 5000.0, 9000.0)
    lam, mu = young * 0.43 / 1.43 / 0.14, young / 2.86
    moved = np.flatnonzero((points[:, 1] < 0.1) | (points[:, 1] > 59.9))
    grid = mesh_to_vtk(points, cells)
    set_array(grid.GetCellData(), "Label", labels.astype(np.int32))
    held = np.isin(np.arange(len(points)), moved)
    set_array(grid.GetPointData(), "ReactionNodes", held.astype(np.uint8))
    for k, push in enumerate([(0.0, -0.6), (0.6, -0.3)], 1):
        values = np.where(points[moved, 1:] > 1, push, 0.0)
        u = solve_push(points, cells, lam, mu, moved, values)
        set_array(grid.GetPointData(), f"Displacement_{k}", np.insert(u, 2, 0.0, axis=1))
    write_mesh(folder / "pushed.vtu", grid)
    grey = np.random.default_rng(0).integers(1, 99, (1, 31, 31)).astype(np.int16)
    write_image(folder / "rest.nrrd", Image(grey, (0, 0, 0), (2, 2, 2)))
    return folder


@pytest.fixture(scope="module")
def result(case):
    """The case identified."""
    words = [case / "pushed.vtu", "-o", case / "map.vtu", *KNOWN, "--group", "label"]
    assert cli.main(["identify", *map(str, words)]) == 0
    return case / "map.vtu"


def test_identify_writes_nifti_and_a_page(case, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install .[all]")
    code, text, errors = run(
        "identify", case / "pushed.vtu", "-o", tmp_path / "map.vtu", *KNOWN, "--group", "label",
        "--rest", case / "rest.nrrd", "--nifti", tmp_path / "out", "--html", tmp_path / "a.html",
        capsys=capsys,
    )  # fmt: skip
    assert code == 0, errors
    mu = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "out_mu.nii.gz")))
    label = sitk.GetArrayFromImage(sitk.ReadImage(str(tmp_path / "out_label.nii.gz")))
    np.testing.assert_allclose(mu[label == 2], 9000 / 2.86, rtol=1e-4)
    assert json.loads((tmp_path / "out_mu.json").read_text())["Units"] == "Pa"
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "3.15" in page and "data:image/png" in page
    assert "out_mu.nii.gz" in text and "wrote" in text


def test_export_writes_dicom_of_a_result_in_kilopascal(case, result, tmp_path, capsys):
    pytest.importorskip("highdicom", reason="needs highdicom: pip install .[dicom]")
    import pydicom

    code, text, errors = run(
        "export", result, "--rest", case / "rest.nrrd", "--dicom", tmp_path / "maps",
        "--quantity", "YoungModulus", "--patient-id", "P7", capsys=capsys,
    )  # fmt: skip
    assert code == 0, errors
    data = pydicom.dcmread(tmp_path / "maps" / "E.dcm")
    assert data.PatientID == "P7"
    values = data.pixel_array
    np.testing.assert_allclose(np.nanmax(values), 9.0, rtol=1e-4)
    assert "labels.dcm" in text


def test_a_map_of_dicom_images_refers_to_them(case, result, tmp_path, capsys):
    pytest.importorskip("highdicom", reason="needs highdicom: pip install .[dicom]")
    import pydicom

    first, second = tmp_path / "first", tmp_path / "second"
    words = ["export", result, "--rest", case / "rest.nrrd", "--dicom", first]
    assert run(*words, capsys=capsys)[0] == 0
    series = tmp_path / "series"
    series.mkdir()
    (first / "rest_0001.dcm").rename(series / "rest.dcm")
    words = ["export", result, "--rest", series, "--dicom", second]
    code, _, errors = run(*words, capsys=capsys)
    assert code == 0, errors
    assert not list(second.glob("rest_*"))
    rest, made = (pydicom.dcmread(f) for f in (series / "rest.dcm", second / "mu.dcm"))
    assert made.StudyInstanceUID == rest.StudyInstanceUID


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ([], "nothing to write"),
        (["--nifti", "out"], "add --rest"),
        (["--rest", "REST", "--nifti", "nowhere/out"], "nowhere"),
        (["--html", "page.txt"], ".html"),
        (["--rest", "REST", "--dicom", "REST"], "is a file"),
    ],
)
def test_exports_that_cannot_be_written_are_refused(case, result, words, reason, capsys):
    words = [str(case / "rest.nrrd") if word == "REST" else word for word in words]
    code, _, errors = run("export", result, *words, capsys=capsys)
    assert code == 2 and reason in errors and errors.count("\n") == 1


def test_a_unit_without_kilopascal_is_refused_before_the_work(case, tmp_path, capsys):
    pytest.importorskip("highdicom", reason="needs highdicom: pip install .[dicom]")
    code, _, errors = run(
        "identify", case / "pushed.vtu", "-o", tmp_path / "map.vtu", *KNOWN, "--unit", "stone",
        "--rest", case / "rest.nrrd", "--dicom", tmp_path / "maps", capsys=capsys,
    )  # fmt: skip
    assert code == 2 and "unit 'stone'" in errors
    assert list(tmp_path.iterdir()) == []


def test_convert_keeps_values_and_places(case, tmp_path, capsys):
    code, text, _ = run("convert", case / "rest.nrrd", tmp_path / "rest.nii.gz", capsys=capsys)
    assert code == 0 and "rest.nii.gz" in text
    one, two = (sitk.ReadImage(str(f)) for f in (case / "rest.nrrd", tmp_path / "rest.nii.gz"))
    assert np.array_equal(sitk.GetArrayFromImage(one), sitk.GetArrayFromImage(two))
    np.testing.assert_allclose(one.GetSpacing(), two.GetSpacing(), atol=1e-6)
    code, _, errors = run("convert", case / "rest.nrrd", tmp_path / "rest.xyz", capsys=capsys)
    assert code == 2 and ".nrrd" in errors


def test_to_fem_writes_the_materials(result, tmp_path, capsys):
    code, _, errors = run("to-fem", result, tmp_path / "map.inp", capsys=capsys)
    assert code == 0, errors
    lines = (tmp_path / "map.inp").read_text().splitlines()
    materials = [line for k, line in enumerate(lines) if lines[k - 1] == "*ELASTIC"]
    young = sorted({round(float(line.split(",")[0])) for line in materials})
    assert young == [5000, 9000]
    code, _, errors = run("to-fem", result, result, capsys=capsys)
    assert code == 2 and "map.vtu" in errors


def test_repeatability_of_subjects_measured_twice(result, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs matplotlib: pip install .[all]")
    from elastoidentify.export.repeatability import read_rows

    rows = read_rows(result)
    files = []
    for number, factor in enumerate((0.98, 1.02, 0.96, 1.04)):
        files.append(tmp_path / f"{number}.csv")
        with open(files[-1], "w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(rows[0]))
            writer.writeheader()
            writer.writerows({**row, "Mu core": float(row["Mu core"]) * factor} for row in rows)
    code, text, errors = run(
        "repeatability", "--subject", *files[:2], "--subject", *files[2:],
        "--table", tmp_path / "r.csv", "--picture", tmp_path / "r.png", capsys=capsys,
    )  # fmt: skip
    assert code == 0, errors
    # wCV² = ((0.02 √2)² + (0.04 √2)²) / 2
    assert f"{100 * np.sqrt((2 * 0.02**2 + 2 * 0.04**2) / 2):.2f}" in text
    with open(tmp_path / "r.csv", encoding="utf-8") as stream:
        (line,) = csv.DictReader(stream)
    assert line["label"] == "2" and line["subjects"] == "2" and line["quantity"] == "Mu core"
    assert (tmp_path / "r.png").read_bytes()[:4] == b"\x89PNG"
    code, text, errors = run("repeatability", *files, "--column", "Mu mean", capsys=capsys)
    assert code == 0 and "Mu mean" in text, errors
    code, _, errors = run("repeatability", files[0], capsys=capsys)
    assert code == 2 and "two" in errors
    code, _, errors = run("repeatability", capsys=capsys)
    assert code == 2 and "no results given" in errors


def test_the_new_commands_and_help_load_no_numerics():
    code = (
        "import sys; from elastoidentify.cli import main; main(['export', '--help']);"
        "assert not {'numpy', 'vtkmodules', 'highdicom', 'matplotlib'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "--dicom FOLDER" in done.stdout
