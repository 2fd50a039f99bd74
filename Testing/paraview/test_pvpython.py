"""Proxies in the real pvpython and pvbatch."""

import subprocess
import sys

import numpy as np
import pytest
from hosts import program
from paraview_host import (
    HERE,
    LAUNCHER,
    PACKAGES,
    environment,
    listening_server,
    python_with,
    run,
    within,
)

PLUGIN = PACKAGES / "elastoidentify" / "paraview" / "ElastoIdentifyPlugin.py"


def test_phantom_to_stiffness_by_proxies_gives_the_librarys_numbers(script, tmp_path):
    script("phantom_chain.py", tmp_path)


@pytest.mark.parametrize(
    ("what", "how"),
    [
        ("pvpython", "update function"),
        ("warm", "information"),
        ("warm", "fetch"),
        ("pvbatch", "update"),
        ("pvbatch", "save"),
    ],
)
def test_a_failing_filter_raises_and_the_exit_code_tells(what, how, tmp_path, pvpython):
    output = tmp_path / "never.vtu"
    words = (HERE / "scripts" / "failing.py", how, output)
    done = pvpython(*words) if what == "warm" else run(what, *words)
    assert done.returncode not in (0, 139), done.stdout
    line = "LameIdentification: known label 7 does not occur in the mesh"
    assert f"ERROR: {line}" in done.stdout and f"InputError: {line}" in done.stdout
    assert "done" not in done.stdout.splitlines()
    assert not output.exists()


@pytest.mark.parametrize(
    ("how", "line"),
    [
        ("choice", "LameIdentification.kinematics must be"),
        ("row", "known label 1: Young's modulus is -5000"),
        ("input", "vtkPointSet"),
    ],
)
def test_what_a_setter_or_a_port_refuses_fails_the_run(how, line, tmp_path, pvpython):
    output = tmp_path / "never.vtu"
    done = pvpython(HERE / "scripts" / "refused.py", how, output)
    assert done.returncode not in (0, 139) and line in done.stdout, done.stdout
    assert "done" not in done.stdout.splitlines()
    assert not output.exists()


@pytest.mark.parametrize("how", ["mended", "surface", "warning"])
def test_a_mended_choice_a_surface_and_a_warning_in_a_script(how, script):
    text = script("refused.py", how)
    assert how != "warning" or "WARNING: LameIdentification: " in text


@pytest.mark.parametrize("how", ["render", "screenshot"])
def test_a_failing_filter_raises_when_rendered(how, tmp_path, display, pvpython):
    output = tmp_path / "never.png"
    done = pvpython(HERE / "scripts" / "failing.py", how, output, DISPLAY=display)
    assert done.returncode == 1, done.stdout
    assert "InputError: LameIdentification: known label 7" in done.stdout


def test_a_failure_can_be_caught_and_the_next_update_works(script):
    text = script("failing.py", "catch")
    line = "LameIdentification: known label 7 does not occur in the mesh, its labels are 1, 2, 3"
    shown = [shown for shown in text.splitlines() if shown.startswith("ERROR")]
    assert shown == [f"ERROR: {line}"]  # raised twice, shown once


def test_colours_and_legend_of_a_map_are_right_without_the_users_help(script, display):
    script("legends.py", DISPLAY=display)


def test_maps_are_written_as_nifti_dicom_and_page_by_save_data(script, tmp_path):
    """E = 5 kPa, ν = 0.43 everywhere but in the inclusion, which is three times as stiff."""
    pydicom = pytest.importorskip("pydicom", reason="needs pydicom: pip install pydicom")
    sitk = pytest.importorskip("SimpleITK", reason="needs SimpleITK: pip install SimpleITK")
    lender = python_with("SimpleITK", "highdicom", "matplotlib")
    rest = sitk.Image(44, 44, 1, sitk.sitkInt16)
    rest.SetSpacing([0.5, 0.5, 2.0])
    rest.SetOrigin([-0.75, -0.75, 0.0])
    sitk.WriteImage(rest, str(tmp_path / "rest.nrrd"))
    places = dict(ELASTOIDENTIFY_PARAVIEW_SITE="", ELASTOIDENTIFY_PYTHON=lender)
    script("exporting.py", tmp_path, what="pvpython", **places)

    mu, labels = (sitk.ReadImage(str(tmp_path / f"case_{n}.nii.gz")) for n in ("mu", "label"))
    assert mu.GetSpacing() == rest.GetSpacing() and mu.GetOrigin() == rest.GetOrigin()
    mu, labels = map(sitk.GetArrayFromImage, (mu, labels))
    for label, young in ((1, 5000), (2, 5000), (3, 15000)):
        np.testing.assert_allclose(mu[labels == label], young / 2.86, rtol=1e-5)
    assert (labels == 0).sum() == 44**2 - 40**2
    data = pydicom.dcmread(tmp_path / "case" / "E.dcm")
    values = np.frombuffer(data.FloatPixelData, np.float32)
    assert data.PatientID == "P7" and np.isclose(np.nanmax(values), 15.0)  # kPa
    assert "<h1>case</h1>" in (tmp_path / "case.html").read_text()
    assert not list(tmp_path.glob("never*"))


def test_a_run_that_is_under_way_can_be_stopped(tmp_path):
    program("pvpython")
    run_until = {**environment(), "XDG_CACHE_HOME": str(tmp_path)}
    log = tmp_path / "log.txt"
    with log.open("w") as output:
        long = subprocess.Popen(
            [*LAUNCHER, "pvpython", HERE / "scripts" / "long_run.py"],
            env=run_until,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    try:
        assert within(60, lambda: "under way" in log.read_text(), long), log.read_text()
        subprocess.run([*LAUNCHER, "stop"], env=run_until, check=True)
        long.wait(30)
    finally:
        long.kill()
        long.wait()
    text = log.read_text()
    assert "ended: LameIdentification: LameIdentification was stopped" in text, text


@pytest.mark.parametrize("suffix", [".pvsm", ".py"])
def test_a_state_file_brings_back_every_property(script, tmp_path, suffix):
    state = tmp_path / f"state{suffix}"
    script("properties.py", "save", state)
    assert state.exists()
    script("properties.py", "load", state)


def test_the_plugin_file_can_be_loaded_by_its_path(tmp_path):
    """As with Tools ▸ Manage Plugins, without the launcher's plugin path."""
    script = tmp_path / "load.py"
    script.write_text(
        "from paraview.simple import *\n"
        "assert 'LameIdentification' not in globals()\n"
        f"LoadPlugin({str(PLUGIN)!r}, ns=globals())\n"
        "stiffness = LameIdentification(Input=PushingPhantom(Resolution=4), Method='global')\n"
        "stiffness.UpdatePipeline()\n"
        "assert stiffness.CellData['Mu'].GetRange()[1] > 1700\n"
        "print('done')\n"
    )
    shim = PACKAGES / "elastoidentify" / "paraview" / "shim"
    done = subprocess.run(
        ["pvpython", str(script)],
        env={**environment(), "PYTHONPATH": str(shim), "PV_PLUGIN_PATH": ""},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0 and done.stdout.split() == ["done"], done.stdout + done.stderr


def test_the_tests_of_the_filters_hold_with_paraviews_vtk():
    pytest.importorskip("paraview", reason="this Python does not have ParaView's VTK")
    folder = HERE.parent / "filters"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider", folder],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_a_failure_on_a_server_raises_on_the_client(script, tmp_path):
    with listening_server(tmp_path / "server.txt") as port:
        script("remote.py", port, what="pvpython")
