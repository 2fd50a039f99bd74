"""The extension: what CMake lists is enough to run, and Slicer's own macros build a package of it.

The build needs sources of Slicer, CTK and vtkAddon, see standins/sources.py. Nothing of Slicer is
compiled: the macros run against a stand-in for the SlicerConfig.cmake of a build.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

slicer = pytest.importorskip("slicer")

from hosts import host_missing  # noqa: E402
from standins import sources  # noqa: E402
from test_packaging import MODULE, ROOT, listed_files  # noqa: E402

HERE = Path(__file__).resolve().parent
SCRIPTED = Path("lib/Slicer-5.12/qt-scripted-modules")


def run(*command, folder=None):
    """Run a command without this process's Python paths; returns what it printed."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "ELASTO"))}
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    return done.stdout


def passes_its_tests(folder):
    printed = run(sys.executable, HERE / "installed.py", folder, folder=folder)
    assert "the installed module passed its tests" in printed


def test_the_listed_files_alone_make_a_module_that_works(tmp_path):
    for name in listed_files():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(MODULE / name, tmp_path / name)
    passes_its_tests(tmp_path)


@pytest.fixture(scope="module")
def cmake():
    """A CMake that Slicer's macros accept."""
    if sources.folder() is None:
        pytest.skip(f"no sources of Slicer are given. To enable: {sources.HINT}")
    first = (sources.folder() / "CMake" / "UseSlicerMacros.cmake").read_text().splitlines()[0]
    needed = tuple(int(part) for part in re.search(r"VERSION (\d+\.\d+\.\d+)", first)[1].split("."))
    for path in (Path(sys.executable).parent / "cmake", shutil.which("cmake")):
        if path and Path(path).is_file():
            version = re.search(r"version ([\d.]+)", run(path, "--version"))[1]
            if tuple(int(part) for part in version.split(".")[:3]) >= needed:
                return path
    pytest.skip(f"Slicer's macros want CMake {needed}. To enable: pip install cmake")


@pytest.fixture(scope="module")
def build(cmake, tmp_path_factory):
    """The build folder of the extension, configured and built."""
    folder = tmp_path_factory.mktemp("extension")
    run(
        cmake,
        *("-S", ROOT, "-B", folder, f"-DSlicer_DIR={HERE / 'standins'}"),
        *(f"-DSLICER_SOURCE={sources.folder()}", f"-DPYTHON_EXECUTABLE={sys.executable}"),
    )
    run(cmake, "--build", folder)
    return folder


def test_slicers_macros_install_every_file_and_the_module_works_from_there(cmake, build, tmp_path):
    run(cmake, "--install", build, "--prefix", tmp_path)
    installed = {
        str(path.relative_to(tmp_path / SCRIPTED))
        for path in (tmp_path / SCRIPTED).rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert installed == set(listed_files())
    passes_its_tests(tmp_path / SCRIPTED)


def test_ctest_gets_the_modules_tests(cmake, build):
    ctest = Path(cmake).with_name("ctest")
    known = json.loads(run(ctest, "--show-only=json-v1", folder=build))["tests"]
    commands = {test["name"]: " ".join(test["command"]) for test in known}
    assert set(commands) == {
        "py_ElastoIdentify",
        "py_nomainwindow_qSlicerElastoIdentifyModuleGenericTest",
    }
    assert "--additional-module-paths" in commands["py_ElastoIdentify"]
    assert str(build / SCRIPTED) in commands["py_ElastoIdentify"]


def test_a_package_and_its_description_are_made(cmake, build):
    run(Path(cmake).with_name("cpack"), folder=build)
    (package,) = build.glob("*-linux-amd64-ElastoIdentify-*.tar.gz")
    with tarfile.open(package) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {str(SCRIPTED / name) for name in listed_files()} <= names
    assert "share/Slicer-5.12/ElastoIdentify.s4ext" in names
    described = dict(
        line.partition(" ")[::2]
        for line in (build / "ElastoIdentify.s4ext").read_text().splitlines()
        if line and line[0] != "#"
    )
    assert described["category"] == "Quantification"
    assert described["depends"] == "NA"
    assert described["homepage"].endswith("/SlicerElastoIdentify")
    for picture in [described["iconurl"], *described["screenshoturls"].split()]:
        assert (ROOT / picture.partition("/main/")[2]).is_file()


def test_a_slicer_folder_that_is_none_is_an_error(tmp_path):
    program = shutil.which("cmake") or host_missing("cmake is not installed", "apt install cmake")
    done = subprocess.run(
        [program, "-S", str(ROOT), "-B", str(tmp_path), f"-DSlicer_DIR={tmp_path}"],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode != 0
    assert "SlicerConfig.cmake" in done.stderr
