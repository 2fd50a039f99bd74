"""The launcher and the plugin's forms; needs no ParaView."""

import os
import subprocess
import xml.etree.ElementTree as ET

import pytest
from hosts import program
from paraview_host import PACKAGES

pytest.importorskip("vtkmodules", reason='VTK is not installed. To enable: pip install "vtk>=9.2"')

from elastoidentify import filters
from elastoidentify.errors import InputError
from elastoidentify.paraview import display, launch, panel

FOLDER = PACKAGES / "elastoidentify" / "paraview"


@pytest.fixture
def started(monkeypatch):
    """What the launcher would have become: a list of (program, arguments, environment)."""
    seen = []
    monkeypatch.setattr(launch.os, "execve", lambda *call: seen.append(call))
    return seen


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A folder with programs of ParaView's names, in PARAVIEW_HOME."""
    for name in ("paraview", "pvpython"):
        program = tmp_path / "bin" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    monkeypatch.setenv("PARAVIEW_HOME", str(tmp_path))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.delenv(launch.SITE_VARIABLE, raising=False)
    return tmp_path


def test_the_application_is_the_default_and_gets_all_arguments(started, home):
    launch.main(["mesh.vtu"])
    program, arguments, environment = started[0]
    assert program == str(home / "bin" / "paraview") and arguments[1:] == ["mesh.vtu"]
    assert environment["PV_PLUGIN_PATH"] == str(FOLDER / "autoload")
    assert environment["PYTHONPATH"] == str(FOLDER / "shim")


def test_programs_are_named_first(started, home):
    launch.main(["pvpython", "script.py", "gui"])
    launch.main(["sample"])
    assert [call[1][1:] for call in started] == [
        ["script.py", "gui"],
        [f"--script={FOLDER / 'sample.py'}"],
    ]


def test_paths_of_the_user_stay_behind_ours(started, home, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/mine")
    monkeypatch.setenv(launch.SITE_VARIABLE, "/site")
    monkeypatch.setenv("PV_PLUGIN_PATH", "/plugins")
    launch.main(["gui"])
    environment = started[0][2]
    assert environment["PYTHONPATH"].split(":") == [str(FOLDER / "shim"), "/site", "/mine"]
    assert environment["PV_PLUGIN_PATH"].split(":") == [str(FOLDER / "autoload"), "/plugins"]


@pytest.mark.parametrize("variable", ["PYTHONPATH", launch.SITE_VARIABLE])
def test_a_vtk_wheel_in_the_way_is_refused(started, home, monkeypatch, capsys, variable):
    (home / "site" / "vtkmodules").mkdir(parents=True)
    monkeypatch.setenv(variable, str(home / "site"))
    assert launch.main(["pvpython"]) == 2 and not started
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "vtk wheel" in message and variable in message
    (home / "site" / "paraview").mkdir()  # ParaView's own packages are no wheel
    launch.main(["pvpython"])
    assert len(started) == 1


def test_a_missing_paraview_is_one_line_that_says_what_to_do(started, home, capsys):
    assert launch.main(["pvbatch"]) in (None, 2)
    if not started:  # no pvbatch on PATH either
        message = capsys.readouterr().err
        assert message.count("\n") == 1 and "apt-get install paraview" in message
    with pytest.raises(InputError, match="PARAVIEW_HOME"):
        launch.find_program("pvbatch", {"PATH": str(home)})


def test_the_environment_can_be_printed_for_good(home, capsys):
    assert launch.main(["env"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"export PV_PLUGIN_PATH={FOLDER / 'autoload'}" in lines
    assert launch.main(["--help"]) == 0


def test_only_the_entry_file_is_in_the_folder_that_paraview_loads():
    assert [path.name for path in (FOLDER / "autoload").glob("*.py")] == ["ElastoIdentify.py"]


def test_the_package_is_found_without_its_folder_on_the_path(tmp_path):
    """Only the package is made importable, so that a vtk wheel beside it stays out."""
    script = tmp_path / "where.py"
    script.write_text(
        "import sys, elastoidentify\n"
        f"assert {str(PACKAGES)!r} not in sys.path\n"
        "print(elastoidentify.__file__)\n"
    )
    done = subprocess.run(
        [program("pvpython"), str(script)],
        env={**os.environ, "PYTHONPATH": str(FOLDER / "shim")},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stdout.strip() == str(PACKAGES / "elastoidentify" / "__init__.py"), done.stderr


# ---- forms


@pytest.mark.parametrize(
    "filter_class",
    [
        filters.PushingPhantom,
        filters.SegmentationToTriangleMesh,
        filters.ElastixNodalDisplacement,
        filters.LameIdentification,
    ],
)
def test_every_option_and_port_is_in_the_form_with_its_documentation(filter_class):
    body = panel.documentation(filter_class) + panel.inputs(filter_class)
    tree = ET.fromstring(f"<proxy>{body}{panel.settings(filter_class)}{panel.last_error()}</proxy>")
    properties = {element.get("name"): element for element in tree if element.get("name")}
    for name, option in filter_class.options().items():
        element = properties[option.title]
        assert element.find("Documentation").text == " ".join(option.__doc__.split()), name
        command = element.get("command")
        assert hasattr(filter_class, command), command
        if element.get("clean_command"):
            assert hasattr(filter_class, element.get("clean_command"))
    ports = [element for element in tree if element.tag == "InputProperty"]
    assert [element.get("port_index") for element in ports] == [
        str(number) for number in range(len(filter_class.ports))
    ]
    for element in ports:
        assert hasattr(filter_class, element.get("clean_command") or "SetInputConnection")


def test_cells_without_a_value_have_a_colour_of_their_own():
    tables = display.default_settings()["array_lookup_tables"]
    for array in ("Lambda", "Mu", "YoungModulus", "PoissonRatio", "LambdaStd", "MuStd"):
        assert tables[array]["PVLookupTable"]["NanColor"] == display.NOT_DETERMINED
    status = tables["Status"]["PVLookupTable"]
    assert status["Annotations"][::2] == ["0", "1", "2", "3", "4"]


@pytest.mark.parametrize("array", ["Label", "ReactionNodes", "Status"])
def test_what_counts_kinds_is_shown_as_categories_with_a_colour_each(array):
    table = display.default_settings()["array_lookup_tables"][array]["PVLookupTable"]
    assert table["IndexedLookup"] == 1
    values = table["Annotations"][::2]
    assert values == [str(n) for n in range(len(values))]
    assert len(table["IndexedColors"]) == 3 * len(values)
