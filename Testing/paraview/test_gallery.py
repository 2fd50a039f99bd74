"""The gallery's example for ParaView prints what its page says, and draws its picture."""

import re
from pathlib import Path

import pytest
from printed import check

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


@pytest.mark.parametrize("name", ["in_paraview"])
def test_the_example_prints_what_its_page_says(name, display, tmp_path, pvpython):
    done = pvpython(EXAMPLES / f"{name}.py", DISPLAY=display, cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    text = (EXAMPLES / f"{name}.md").read_text(encoding="utf-8")
    check(done.stdout, re.search(r"```text\n(.*?)```", text, re.S).group(1), rtol=0.15)
    assert (tmp_path / f"{name}.png").stat().st_size > 5000
