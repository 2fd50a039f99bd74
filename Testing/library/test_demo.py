"""The main job, end to end, on a real MR slice: what the README promises."""

import csv
import functools
import json
import re
from pathlib import Path

import pytest
from printed import check

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

for name in ("skfem", "SimpleITK", "itk", "vtkmodules", "matplotlib"):
    pytest.importorskip(name)


def mr_texture():
    from elastoidentify.errors import InputError
    from elastoidentify.imaging.phantom.texture import mni152_path

    try:
        return mni152_path()
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    from elastoidentify.examples.demo import run_demo

    mr_texture()
    folder, lines = tmp_path_factory.mktemp("demo"), []
    return folder, run_demo(folder, say=lines.append), "\n".join(lines)


def test_the_inclusion_is_found_cell_by_cell_and_label_by_label(demo):
    _, found, _ = demo
    assert found["true_contrast"] == 3.0
    assert abs(found["contrast"] / 3 - 1) < 0.25
    assert abs(found["contrast_by_label"] / 3 - 1) < 0.10


def test_every_label_is_nearer_to_the_truth_than_the_flat_guess(demo):
    _, found, _ = demo
    pad, *others = found["rows"]
    for row in others:
        assert row["determined"] > 0.9
        assert abs(row["Mu median"] - row["Mu true"]) < 0.25 * abs(pad["Mu true"] - row["Mu true"])


def test_truth_time_and_memory_are_printed(demo):
    _, found, text = demo
    for word in ("true", "flat guess", "per label", "contrast of the inclusion", "total:", "GiB"):
        assert word in text
    assert found["seconds"] > 0


def test_what_is_printed_is_what_the_page_shows(demo):
    page = Path(__file__).resolve().parents[2] / "docs" / "demo.md"
    (shown,) = re.findall(r"```text\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    check(demo[2], shown, rtol=0.15)


def test_picture_tables_meshes_and_phantom_are_in_the_folder(demo):
    from elastoidentify.vtk_io.convert import get_text
    from elastoidentify.vtk_io.vtu import read_mesh

    folder, found, _ = demo
    names = {file.name for file in folder.iterdir()}
    assert names == {"phantom"} | {
        f"{name}.{suffix}" for name in ("map", "map_by_label") for suffix in ("vtu", "csv", "png")
    }
    report = json.loads(get_text(read_mesh(folder / "map.vtu"), "IdentificationReport"))
    assert (report["method"], report["trials"]) == ("regularized", 2)
    rows = list(csv.DictReader((folder / "map.csv").open(encoding="utf-8")))
    assert float(rows[1]["Mu median"]) == found["rows"][1]["Mu median"]
    assert (folder / "map.png").read_bytes().startswith(b"\x89PNG")


def test_a_demo_that_is_stopped_leaves_nothing(tmp_path, monkeypatch):
    from elastoidentify.errors import Cancelled
    from elastoidentify.examples import demo
    from elastoidentify.imaging import phantom

    def stop(*_, **__):
        raise Cancelled

    mr_texture()
    small = functools.partial(phantom.make_phantom, pixels=48, elements=12)
    monkeypatch.setattr(phantom, "make_phantom", small)
    monkeypatch.setattr(demo.pipeline, "run", stop)
    with pytest.raises(Cancelled):
        demo.run_demo(tmp_path / "new" / "demo", say=lambda _: None)
    assert not list(tmp_path.iterdir())


def test_run_goes_from_files_to_the_map_in_one_command(demo, tmp_path, capsys):
    from elastoidentify import cli

    folder = demo[0]
    phantom, out = folder / "phantom", tmp_path / "map.vtu"
    code = cli.main(
        [
            *("run", "--rest", str(phantom / "rest.nrrd"), "--edge-length", "7", "--rigid", "4"),
            *("--pushed", str(phantom / "pushed_1.nrrd"), "--rigid", "5"),
            *("--pushed", str(phantom / "pushed_2.nrrd"), "--known", "1:E=5000,nu=0.45"),
            *("--segmentation", str(phantom / "segmentation.nrrd"), "--kinematics", "neo-hookean"),
            *("--unknowns", "young", "--poisson", "0.45", "--group", "label"),
            *("--table", str(tmp_path / "map.csv"), "-o", str(out)),
        ]
    )
    text = capsys.readouterr().out
    assert code == 0
    assert "chosen because" in text  # the method was left to itself
    rows = list(csv.DictReader((tmp_path / "map.csv").open(encoding="utf-8")))
    assert abs(float(rows[2]["Mu median"]) / float(rows[1]["Mu median"]) / 3 - 1) < 0.10
