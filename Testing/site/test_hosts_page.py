"""What the page of all hosts shows for the command line and for Python; see Testing/hosts_page.py.

What it shows for ParaView and for 3D Slicer is run in the suites of these.
"""

import shlex

import numpy as np
import pytest
from elastoidentify.cli import main
from elastoidentify.imaging.io import read_image
from elastoidentify.results import QUANTITIES
from elastoidentify.vtk_io import convert
from elastoidentify.vtk_io.vtu import read_mesh
from hosts import has_elastix, host_missing
from hosts_page import block, demand, files
from printed import check
from stored_registration import only_read, stored_outcome


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """The folder of the page, with the registrations in `stored`, and what the pipeline finds."""
    folder = tmp_path_factory.mktemp("hosts")
    phantom, study = files(folder)
    return folder, stored_outcome(study, phantom, folder / "stored")


def words(heading):
    """The words of the command of a heading."""
    return shlex.split(block(heading, "sh").replace("\\\n", " "))[1:]


def test_the_first_command_makes_the_files_of_the_study(stored, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words("The files")) == 0
    for name in ("rest", "pushed_1", "pushed_2", "segmentation"):
        one, other = (read_image(f / "phantom" / f"{name}.nrrd") for f in (tmp_path, stored[0]))
        np.testing.assert_array_equal(one.array, other.array)


def test_the_command_line_prints_and_writes_what_the_pipeline_finds(stored, monkeypatch, capsys):
    if not has_elastix():
        host_missing("itk-elastix is not installed", 'pip install ".[all]"')
    folder, outcome = stored
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    with only_read(folder / "stored"):
        assert main([*words("Command line"), "--cache", str(folder / "stored")]) == 0
    check(capsys.readouterr().out, block("Command line", "text"), rtol=0.5)
    cells = read_mesh(folder / "map.vtu").GetCellData()
    for name, quantity in QUANTITIES.items():
        expected = getattr(outcome.result, quantity.field)
        np.testing.assert_array_equal(convert.get_array(cells, name), expected, err_msg=name)


def test_the_program_in_python_prints_what_the_pipeline_finds(stored, monkeypatch, capsys):
    folder, outcome = stored
    monkeypatch.chdir(folder)
    with only_read(folder / "stored"):
        exec(block("Python", "python", Study="cache='stored'"), {})
    demand(capsys.readouterr().out, outcome, "Python")
    assert (folder / "map.png").stat().st_size > 5000
