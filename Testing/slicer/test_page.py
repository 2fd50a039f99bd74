"""The programs in docs/slicer.md run as they stand, but that registrations are stored."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

slicer = pytest.importorskip("slicer")

from elastoidentify.imaging.phantom import make_phantom  # noqa: E402
from ElastoIdentifyLib import sample  # noqa: E402
from ElastoIdentifyLib.request import Request  # noqa: E402
from stored_registration import only_read, stored_outcome  # noqa: E402

from ElastoIdentify import ElastoIdentifyLogic  # noqa: E402

pytestmark = pytest.mark.usefixtures("warm")

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "slicer.md").read_text(encoding="utf-8")
PAD, TISSUE, INCLUSION, TABLE = 1, 2, 3, 4


def own_nodes():
    """Add nodes with the page's names, of a pad and tissue between the plates of a table."""
    phantom = make_phantom(pixels=96, width=48, elements=24)
    rest, *pushed = (
        sample.volume_from_image(image, name)
        for name, image in zip(
            ("rest", "push 1", "push 2"), (phantom.rest, *phantom.pushed), strict=True
        )
    )
    assert phantom.rigid_labels == [TABLE, TABLE + 1] and len(pushed) == 2
    array = np.minimum(phantom.segmentation.array, TABLE)  # indenter and floor
    labels = dataclasses.replace(phantom.segmentation, array=array)
    names = {PAD: "pad", TISSUE: "tissue", INCLUSION: "inclusion", TABLE: "table"}
    sample.segmentation_from_image(labels, names, "Segmentation", rest)
    return phantom


@pytest.mark.slow
def test_the_program_for_own_nodes_gives_the_pipelines_map(tmp_path, monkeypatch):
    phantom, outcomes, process = own_nodes(), [], ElastoIdentifyLogic.process

    def process_stored(logic, *, options, **request):
        study = Request(**request, options=options).study()
        outcomes.append(stored_outcome(study, phantom, tmp_path / "stored"))
        with only_read(tmp_path / "stored"):
            kept = options | {"cache": str(tmp_path / "stored")}
            return process(logic, options=kept, **request)

    monkeypatch.setattr(ElastoIdentifyLogic, "process", process_stored)
    (program,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    names = {}
    exec(program, names)
    (outcome,) = outcomes
    np.testing.assert_allclose(names["mu"], outcome.result.mu, rtol=1e-6, equal_nan=True)
    found = {row["label"]: row["YoungModulus mean"] for row in outcome.result.statistics}
    assert found[PAD] == pytest.approx(5.0)
    assert found[TISSUE] == pytest.approx(3.0, rel=0.25)

    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (call,) = re.findall(r"`(ElastoIdentifyLogic\.export\(.*?\))`", PAGE)
    eval(call, names)
    assert (tmp_path / "folder" / "case1_mu.nii.gz").exists()
