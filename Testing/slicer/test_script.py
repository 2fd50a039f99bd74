"""The script of the documentation, run as `Slicer --python-script` runs it."""

import runpy
import sys
from functools import partialmethod
from pathlib import Path

import pytest

slicer = pytest.importorskip("slicer")

from elastoidentify.imaging.phantom.planar import Inclusion, make_phantom  # noqa: E402
from ElastoIdentifyLib import sample  # noqa: E402
from ElastoIdentifyLib.request import Request  # noqa: E402
from stored_registration import only_read, stored_outcome  # noqa: E402

import ElastoIdentify  # noqa: E402

pytestmark = pytest.mark.usefixtures("warm")

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "scripts" / "slicer_phantom.py"


@pytest.fixture
def exits(monkeypatch, tmp_path):
    """The codes that the script exits with; the last one is the application's."""
    codes = []
    monkeypatch.setattr(slicer.util, "exit", codes.append)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(tmp_path)])
    return codes


def test_a_failure_is_told_and_is_the_exit_code(exits, monkeypatch, capsys):
    def fail():
        raise RuntimeError("the phantom could not be made")

    monkeypatch.setattr(ElastoIdentify, "loadSample", fail)
    runpy.run_path(str(SCRIPT), run_name="__main__")
    assert exits == [1]
    assert "the phantom could not be made" in capsys.readouterr().err


@pytest.mark.slow
def test_the_script_goes_from_the_phantom_to_the_files(exits, monkeypatch, tmp_path, capsys):
    """On a smaller phantom whose registrations are stored: the script's table is the pipeline's."""
    phantom = make_phantom(inclusions=[Inclusion(contrast=3.0)], pixels=96, width=56, elements=24)
    stored = tmp_path / "stored"
    study = Request(**sample.phantom_nodes(phantom) | {"edgeLength": 7.0, "options": {}}).study()
    outcome = stored_outcome(study, phantom, stored)
    slicer.mrmlScene.Clear(0)

    def small():
        inputs = sample.phantom_nodes(phantom)
        return [inputs["restVolume"], *inputs["pushedVolumes"], inputs["segmentation"]]

    asked = []
    logic = ElastoIdentify.ElastoIdentifyLogic
    process = partialmethod(logic.process, options={"cache": str(stored)})
    monkeypatch.setattr(ElastoIdentify, "loadSample", small)
    monkeypatch.setattr(logic, "process", process)
    monkeypatch.setattr(logic, "ensurePackages", staticmethod(lambda ask: asked.append(ask)))
    with only_read(stored):
        runpy.run_path(str(SCRIPT), run_name="__main__")
    assert exits == [0], capsys.readouterr().err
    assert asked == [False]
    assert "cells identified" in capsys.readouterr().out

    title, *lines = (tmp_path / "segments.tsv").read_text().splitlines()
    name, column = (title.split("\t").index(c) for c in ("name", "YoungModulus median"))
    median = {line.split("\t")[name]: float(line.split("\t")[column]) for line in lines}
    rows = outcome.result.statistics
    for found, row in zip(median.values(), rows, strict=True):
        assert found == pytest.approx(row["YoungModulus median"], rel=1e-5)  # digits of the file
    assert median["pad"] == pytest.approx(5.0)
    assert median["tissue"] == pytest.approx(3.0, rel=0.25)
    assert median["inclusion"] / median["tissue"] == pytest.approx(3.0, rel=0.25)
    slicer.mrmlScene.Clear(0)
    assert slicer.mrmlScene.ReadFromMRB(str(tmp_path / "map.mrb"))
    assert slicer.mrmlScene.GetFirstNode("Stiffness", "vtkMRMLModelNode", None, True) is not None
