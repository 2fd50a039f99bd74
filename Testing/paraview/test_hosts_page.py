"""What the page of all hosts shows for ParaView; see Testing/hosts_page.py."""

import pytest
from paraview_host import run


def test_the_script_prints_what_the_pipeline_finds(tmp_path):
    pytest.importorskip("vtkmodules")
    pytest.importorskip("skfem", reason="scikit-fem is not installed: pip install scikit-fem")
    from hosts_page import block, demand, files
    from stored_registration import only_read, stored_outcome

    phantom, study = files(tmp_path)
    outcome = stored_outcome(study, phantom, tmp_path / "stored")
    (tmp_path / "study.py").write_text(
        block("ParaView", "python", ElastixNodalDisplacement="Cache='stored'"), encoding="utf-8"
    )
    with only_read(tmp_path / "stored"):
        done = run("pvpython", "-W", "ignore", "study.py", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    lines = [line for line in done.stdout.splitlines() if line.startswith("label")]
    demand("\n".join(lines), outcome, "ParaView")
    assert (tmp_path / "map.vtu").exists()
