"""Memory that runs out: the old result is kept and no temporary file stays.

Where Python asks for the memory it is one line and exit code 1; where VTK or BLAS do, they end the
process themselves.
"""

import os
import shutil
import subprocess
import sys

import pytest

pytest.importorskip("vtkmodules")
pytest.importorskip("resource", reason="this system sets no limits")

PROGRAM = """
import resource, sys
from elastoidentify.cli import main
import elastoidentify.vtk_io.steps, elastoidentify.vtk_io.vtu, elastoidentify.inverse.regularized
import scipy.sparse.linalg, scipy.spatial, scipy.ndimage  # libraries load before memory is short
used = next(int(l.split()[1]) for l in open("/proc/self/status") if l.startswith("VmSize")) << 10
resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[1]) * 2**20,) * 2)
sys.exit(main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    from elastoidentify.filters import PushingPhantom
    from elastoidentify.vtk_io.vtu import write_mesh

    phantom = PushingPhantom(resolution=80, noise=1e-5)
    phantom.Update()
    file = tmp_path_factory.mktemp("mesh") / "in.vtu"
    write_mesh(file, phantom.GetOutput())
    return file


@pytest.fixture
def block(mesh, tmp_path):
    shutil.copy(mesh, tmp_path)
    (tmp_path / "out.vtu").write_text("an older result")
    return tmp_path


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="the memory in use is looked up in /proc")
@pytest.mark.parametrize("megabytes", [1, 10, 60])
def test_memory_that_runs_out_keeps_the_old_result(block, megabytes):
    words = ["identify", "in.vtu", "--known", "1:E=5000,nu=0.43", "--method", "regularized"]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(megabytes), *words, "-o", "out.vtu"],
        cwd=block, capture_output=True, text=True, timeout=120,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode != 0
    assert "Traceback" not in done.stderr
    assert (block / "out.vtu").read_text() == "an older result"
    assert sorted(os.listdir(block)) == ["in.vtu", "out.vtu"]
