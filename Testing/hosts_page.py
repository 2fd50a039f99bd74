"""The page of all hosts, docs/hosts.md: its blocks, its study, and what its hosts must print.

elastix is slow, so the hosts take the registrations from a folder, see `stored_registration`.
"""

import re
from pathlib import Path

from elastoidentify.imaging.phantom import make_phantom, write_phantom
from elastoidentify.study import Study
from printed import check

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "hosts.md").read_text(encoding="utf-8")


def block(heading: str, kind: str, page: str = PAGE, **changes: str) -> str:
    """Return the first block of a kind under a heading of a page, else of that of all hosts.

    `changes`: name of a function that the block calls → argument to add to the call.
    """
    section = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", page, re.M | re.S).group(1)
    text = re.search(rf"^```{kind}\n(.*?)^```", section, re.M | re.S).group(1)
    for name, argument in changes.items():
        assert text.count(f"{name}(") == 1
        text = text.replace(f"{name}(", f"{name}({argument}, ")
    return text


def files(folder: Path):
    """Write what the page's first command writes; return its phantom and the page's study."""
    phantom = make_phantom(pixels=96)
    write_phantom(folder / "phantom", phantom)
    pad = phantom.label("pad")
    study = Study(
        segmentation=phantom.segmentation,
        rest=phantom.rest,
        pushed=phantom.pushed,
        known_materials={pad: (phantom.materials[pad].young, phantom.materials[pad].poisson)},
        rigid_labels=phantom.rigid_labels,
    )
    return phantom, study


def demand(printed: str, outcome, heading: str) -> None:
    """Fail where a host did not print what the pipeline finds, and what the page shows."""
    lines = [
        f"label {row['label']}: μ {row['Mu mean']:.0f} ± {row['Mu standard error']:.0f} Pa"
        for row in outcome.result.statistics
    ]
    assert printed.strip().splitlines() == lines
    shown = block(heading, "text")
    check(printed, shown, rtol=0.5)  # the ± are from few samples
    values = [re.sub(r" ± \d+", "", text) for text in (printed, shown)]
    check(*values, rtol=0.05)
