"""What a stranger types, and what the page says that it prints."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from hosts import has_elastix, host_missing
from printed import check, is_same

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    page: re.findall(r"^```console\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
RUN = [page for page, blocks in PAGES.items() if blocks]
EXAMPLE = "elastoidentify (phantom|run|mesh|register|identify|displacement|export|convert|to-fem)"


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN, ids=lambda page: page.stem)
def test_console_blocks_run_and_print_what_is_shown(page, tmp_path):
    if not has_elastix():
        host_missing("itk-elastix is not installed", 'pip install ".[all]"')
    for block in PAGES[page]:
        command, _, shown = block.partition("\n")
        words = shlex.split(command.removeprefix("$ "))
        assert words[0] == "elastoidentify", command
        done = subprocess.run(
            [sys.executable, "-m", *words],
            cwd=tmp_path,
            env=os.environ | {"MPLBACKEND": "Agg"},
            capture_output=True,
            encoding="utf-8",
        )
        assert done.returncode == 0, done.stderr
        check(done.stdout, shown, rtol=0.25)


def commands():
    """Every call of ``elastoidentify`` that the pages show, as words."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for block in re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S):
            for line in block.splitlines():
                if re.match(rf"(\$ )?{EXAMPLE} ", line):
                    yield page.name, line.removeprefix("$ ").split("  #")[0]


@pytest.mark.parametrize(("page", "line"), list(commands()))
def test_every_command_that_is_shown_is_one_that_is_taken(page, line):
    from elastoidentify.cli.parser import make_parser

    make_parser().parse_args(shlex.split(line)[1:])


def test_the_first_map_has_console_blocks():
    assert ROOT / "docs" / "first-map.md" in RUN


@pytest.mark.parametrize(
    ("found", "shown", "same"),
    [
        ("E 3010 ± 30 Pa", "E 3000 ± 32 Pa", True),
        ("E 4010 ± 30 Pa", "E 3000 ± 32 Pa", False),
        ("trial 1: 0.98", "trial 1: 0.99", True),
        ("other words", "these words", False),
        ("warning: Trial 1: 9 % of the mesh", "warning: Trial 1: 9 % …", True),
        ("note: one", "warning: …", False),
    ],
)
def test_lines_are_compared_by_their_words_and_numbers(found, shown, same):
    assert is_same(found, shown, 0.1) is same
