"""The worker process: found, warm, cancelled, and gone without a trace."""

import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from elastoidentify.errors import Cancelled, InputError
from elastoidentify.imaging.image import Image
from elastoidentify.imaging.registration import registration
from elastoidentify.imaging.registration.parameter_files import (
    FOLDER,
    check_names,
    load_parameters,
    read_parameter_map,
    shipped_maps,
)
from elastoidentify.workers import elastix_client, elastix_engine
from elastoidentify.workers.elastix_client import ElastixProcess, LogProgress, find_interpreter
from hosts import has_elastix

needs_elastix = pytest.mark.skipif(
    not has_elastix(), reason='needs itk-elastix: pip install ".[registration]"'
)


@pytest.fixture(autouse=True)
def own_folder(monkeypatch, tmp_path):
    """Keep the workers of a test apart from all others that run on this machine."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))


def leftovers():
    """Temporary directories of this test's workers, and its worker processes, that exist now."""
    own = os.environ["TMPDIR"]
    folders = set(Path(own).glob("elastoidentify-elastix-*"))
    workers = set()
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes(), (process / "environ").read_bytes()
        except OSError:
            continue
        if b"elastix_engine" in words[0] and own.encode() in words[1]:
            workers.add(process.name)
    return folders, workers


def gone(before, seconds=15.0):
    """Wait until nothing new is left over. Returns what still is."""
    end = time.monotonic() + seconds
    while True:
        new = [now - then for now, then in zip(leftovers(), before, strict=True)]
        if not any(new) or time.monotonic() > end:
            return [item for group in new for item in group]
        time.sleep(0.1)


def images():
    random = np.random.default_rng(0)
    return random.standard_normal((2, 64, 64)).astype(np.float32)


def quick_map(iterations=50):
    maps, _ = load_parameters(None, 2)
    maps[0].update(NumberOfResolutions=["2"], MaximumNumberOfIterations=[str(iterations)])
    return maps


def test_without_itk_elastix_the_error_says_how_to_install_it(monkeypatch):
    monkeypatch.delenv(elastix_client.PYTHON_VARIABLE, raising=False)
    monkeypatch.setattr(elastix_client, "_can_run", lambda python: False)
    with pytest.raises(InputError, match=r'pip install "\.\[registration\]"'):
        ElastixProcess()


def test_the_environment_variable_chooses_the_interpreter(monkeypatch):
    monkeypatch.setenv(elastix_client.PYTHON_VARIABLE, sys.executable)
    assert find_interpreter() == sys.executable
    monkeypatch.setenv(elastix_client.PYTHON_VARIABLE, "/no/such/python")
    with pytest.raises(InputError, match="ELASTOIDENTIFY_PYTHON"):
        find_interpreter()


def test_a_python_of_its_own_gets_nothing_of_the_hosts_packages(monkeypatch, tmp_path):
    """The interpreter that ELASTOIDENTIFY_PYTHON names may be of another version."""
    seen = tmp_path / "environment"
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\nenv > {seen}\necho no elastix here >&2\nexit 1\n")
    python.chmod(0o755)
    monkeypatch.setenv("PYTHONPATH", "/of/the/host")
    monkeypatch.setenv("PYTHONHOME", "/of/the/host")
    monkeypatch.setenv(elastix_client.PYTHON_VARIABLE, str(python))
    with pytest.raises(InputError, match="no elastix here"):
        ElastixProcess()
    names = [line.partition("=")[0] for line in seen.read_text().splitlines()]
    assert "PATH" in names
    assert not {"PYTHONPATH", "PYTHONHOME"} & set(names)


def test_a_python_like_the_host_finds_the_hosts_packages():
    paths = elastix_client.worker_environment()["PYTHONPATH"].split(os.pathsep)
    assert str(Path(np.__file__).parents[1]) in paths


def test_an_application_is_not_taken_for_an_interpreter(monkeypatch, tmp_path):
    """In pvpython, ParaView and Slicer sys.executable is the host itself."""
    host = tmp_path / "SlicerApp-real"
    host.write_text("#!/bin/sh\nexit 0\n")
    host.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(host))
    candidates = elastix_client.candidate_interpreters()
    assert candidates and str(host) not in candidates
    monkeypatch.setattr(sys, "executable", "")
    assert elastix_client.candidate_interpreters()


def test_a_python_where_elastix_does_not_load_is_one_line(monkeypatch, tmp_path):
    (tmp_path / "itk.py").write_text("raise ImportError('itk is broken here')\n")
    broken = tmp_path / "python"
    broken.write_text(f'#!/bin/sh\nPYTHONPATH={tmp_path} exec {sys.executable} "$@"\n')
    broken.chmod(0o755)
    monkeypatch.setenv(elastix_client.PYTHON_VARIABLE, str(broken))
    before = leftovers()
    with pytest.raises(InputError, match="itk is broken here") as error:
        ElastixProcess()
    assert "\n" not in str(error.value) and "pip install" in str(error.value)
    assert not gone(before)


def test_progress_follows_the_log_through_maps_and_resolutions():
    log = LogProgress([[100], [100, 200]])
    lines = ["Resolution: 0", "1:ItNr\t2:Metric", "49\t-0.5\t", "Resolution: 0", "99\t-0.9"]
    seen = []
    for line in lines:
        log.read(line)
        seen.append(log.fraction)
    np.testing.assert_allclose(seen, [0, 0, 0.125, 0.25, 0.5])
    assert log.text == "resolution 2 of 3, iteration 100"


def test_every_shipped_parameter_file_is_read_and_has_known_names():
    assert shipped_maps() == ["affine", "bspline"]
    for name in shipped_maps():
        parameter_map = read_parameter_map(FOLDER / f"{name}.txt")
        assert check_names(parameter_map, name) == []
        assert parameter_map["WriteResultImage"] == ["true"]


def test_misspelt_parameters_are_reported(tmp_path):
    path = tmp_path / "mine.txt"
    good = '(Transform "BSplineTransform")\n'
    path.write_text(good + "(MaximumNumberOfIteration 10)\n")
    with pytest.raises(InputError, match="did you mean 'MaximumNumberOfIterations'"):
        load_parameters(path, 2)
    path.write_text(good + '(Flavour "sweet")\n(Metric0Weight 1.0)\n')
    maps, notes = load_parameters([path, "bspline"], 2)
    assert len(maps) == 2 and len(notes) == 1 and "'Flavour'" in notes[0]
    path.write_text(good + "(MaximumNumberOfIterations 10\n")
    with pytest.raises(InputError, match="line 2"):
        load_parameters(path, 2)
    with pytest.raises(InputError, match="cannot read"):
        load_parameters(tmp_path / "absent.txt", 2)


@needs_elastix
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc (Linux)")
def test_killed_in_the_middle_nothing_stays_and_the_next_one_works():
    before = leftovers()
    fixed, moving = images()
    points = np.array([[20.0, 30.0]])
    steps = []

    def cancel_late(fraction, text):
        steps.append((fraction, text))
        if text.startswith("resolution"):
            raise Cancelled

    worker = ElastixProcess(lambda fraction, text: steps.append((fraction, text)))
    assert len(leftovers()[0] - before[0]) == 1
    with pytest.raises(Cancelled):
        worker.register(fixed, moving, [1, 1], quick_map(100000), points, progress=cancel_late)
    assert not gone(before)
    assert any(text == "starting elastix" for _, text in steps)

    with ElastixProcess() as worker:  # the next one works, and stays warm for several
        for _ in range(2):
            mapped, warped = worker.register(fixed, fixed, [1, 1], quick_map(), points)
            np.testing.assert_allclose(mapped, points, atol=0.05)
            assert warped.shape == fixed.shape
        bad = quick_map()
        bad[0]["Metric"] = ["NoSuchMetric"]
        with pytest.raises(InputError, match="elastix could not") as error:
            worker.register(fixed, moving, [1, 1], bad, points)
        assert "\n" not in str(error.value)
    assert not gone(before)


@needs_elastix
@pytest.mark.slow
def test_where_itk_has_no_modules_of_single_classes_the_public_ones_are_taken(monkeypatch):
    """Another version of ITK may name its modules otherwise; the classes are the same."""
    pytest.importorskip("itk")
    short, taken = elastix_engine.Elastix(), []
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "itk.itkPyBufferPython", None)
        without.setattr(elastix_engine.Elastix, "_publicly", lambda self: taken.append(self))
        elastix_engine.Elastix()
    (long,) = taken
    long._publicly()
    for name in ("parameter_object", "methods", "buffers"):
        assert getattr(long, name) == getattr(short, name), name


@needs_elastix
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc (Linux)")
@pytest.mark.parametrize("death", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_host_that_dies_takes_the_worker_and_its_files_with_it(death):
    before = leftovers()
    program = textwrap.dedent(
        """
        import numpy as np
        from elastoidentify.workers.elastix_client import ElastixProcess
        from elastoidentify.imaging.parameter_files import load_parameters
        maps, _ = load_parameters(None, 2)
        maps[0]["MaximumNumberOfIterations"] = ["1000000"]
        fixed, moving = np.random.default_rng(0).standard_normal((2, 64, 64))
        worker = ElastixProcess()
        tell = lambda fraction, text: print(text, flush=True)
        worker.register(fixed, moving, [1, 1], maps, np.zeros((1, 2)), progress=tell)
        """
    )
    host = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, env=dict(os.environ)
    )
    for line in host.stdout:
        if line.startswith("resolution"):
            break
    assert leftovers()[1] - before[1]
    host.send_signal(death)
    host.wait()
    host.stdout.close()
    assert not gone(before)


@needs_elastix
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc (Linux)")
@pytest.mark.parametrize("stop", [Cancelled, KeyboardInterrupt])
def test_stopped_in_the_second_step_nothing_stays(monkeypatch, tmp_path, stop):
    """Between two trials the worker waits, warm, while the host works on the first."""
    before = leftovers()
    monkeypatch.chdir(tmp_path)
    waiting = []

    def interrupted(*arguments, **options):
        waiting.append(leftovers()[1] - before[1])
        raise stop

    monkeypatch.setattr(registration, "refine_displacement", interrupted)
    rest, pushed = (Image(one) for one in images())
    points = np.array([[10.0, 10, 0], [50, 10, 0], [50, 50, 0], [10, 50, 0]])
    parameters = tmp_path / "quick.txt"
    text = (FOLDER / "bspline.txt").read_text()
    parameters.write_text(re.sub(r"(MaximumNumberOfIterations) \d+", r"\1 20", text))
    with pytest.raises(stop):
        registration.register(
            rest, [pushed, pushed], points, [[0, 1, 2, 3]], parameters=parameters, backward=False
        )
    assert len(waiting) == 1 and waiting[0]
    assert not gone(before)
    assert sorted(os.listdir(tmp_path)) == ["quick.txt", "temporary"]
