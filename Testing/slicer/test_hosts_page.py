"""What the page of all hosts shows for 3D Slicer; see Testing/hosts_page.py."""

import pytest

slicer = pytest.importorskip("slicer")

from ElastoIdentifyLib.request import Request  # noqa: E402
from hosts_page import block, demand, files  # noqa: E402
from stored_registration import only_read, stored_outcome  # noqa: E402

from ElastoIdentify import ElastoIdentifyLogic  # noqa: E402

pytestmark = pytest.mark.usefixtures("warm")


def test_the_script_prints_what_the_pipeline_finds(tmp_path, monkeypatch, capsys):
    phantom, study = files(tmp_path)
    stored, outcomes, process = tmp_path / "stored", [], ElastoIdentifyLogic.process

    def process_stored(logic, **request):
        outcomes.append(stored_outcome(Request(**request).study(), phantom, stored))
        with only_read(stored):
            return process(logic, options={"cache": str(stored)}, **request)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ElastoIdentifyLogic, "process", process_stored)
    monkeypatch.setattr(ElastoIdentifyLogic, "ensurePackages", staticmethod(lambda: None))
    exec(block("3D Slicer", "python"), {})
    demand(capsys.readouterr().out, *outcomes, "3D Slicer")
    in_lps = stored_outcome(study, phantom, tmp_path / "in_lps")
    for here, there in zip(outcomes[0].result.statistics, in_lps.result.statistics, strict=True):
        assert here["Mu mean"] == pytest.approx(there["Mu mean"], rel=0.05)
