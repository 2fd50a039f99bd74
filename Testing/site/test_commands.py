"""What a stranger types, and what the page says that it prints.

Blocks marked ``console`` show a command and what it prints: it is run, and the print compared.
Other commands of the README and the tutorials are run on small images with the names that the page
uses. Every command that is shown anywhere, in the middle of a sentence too, has a name and options
that there are.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hosts import has_elastix, host_missing
from printed import check, is_same

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    str(page.relative_to(ROOT)): page.read_text(encoding="utf-8")
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)
CONSOLE = {
    name: [body for kind, body in FENCE.findall(text) if kind == "console"]
    for name, text in PAGES.items()
}
FIRST = "docs/first-map.md"


def call(words, folder):
    """Run a command as the shell would; return what it prints, or fail with what it says."""
    assert words[0] == "elastoidentify", words
    done = subprocess.run(
        [sys.executable, "-m", *words],
        cwd=folder,
        env=os.environ | {"MPLBACKEND": "Agg"},
        capture_output=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, f"{shlex.join(words)}\n{done.stderr}"
    return done.stdout


# ---- what is printed


@pytest.fixture(scope="module")
def first_map(tmp_path_factory):
    """A folder in which the commands of the first map were typed, and what they printed."""
    if not has_elastix():
        host_missing("itk-elastix is not installed", 'pip install ".[all]"')
    folder = tmp_path_factory.mktemp("first_map")
    return folder, [call(typed(block), folder) for block in CONSOLE[FIRST]]


def typed(block):
    """The words of a block's first line."""
    return shlex.split(block.partition("\n")[0].removeprefix("$ "))


@pytest.mark.slow
def test_the_first_map_prints_what_is_shown(first_map):
    for block, printed in zip(CONSOLE[FIRST], first_map[1], strict=True):
        check(printed, block.partition("\n")[2], rtol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("page", [name for name in CONSOLE if CONSOLE[name] and name != FIRST])
def test_console_blocks_print_what_is_shown_in_the_folder_of_the_first_map(page, first_map):
    for block in CONSOLE[page]:
        check(call(typed(block), first_map[0]), block.partition("\n")[2], rtol=0.25)


# ---- what else is shown on the pages that somebody follows


def commands(page):
    """The lines of a page's blocks that call ``elastoidentify``."""
    for kind, body in FENCE.findall(PAGES[page]):
        if kind not in ("python", "text"):
            for line in body.replace("\\\n", " ").splitlines():
                if re.match(r"(\$ )?(mpirun -np \d+ )?elastoidentify ", line):
                    yield shlex.split(line.removeprefix("$ "), comments=True)


def plane(folder):
    """Small images of a slice, by the names of the README and of the page of commands."""
    import SimpleITK as sitk
    from elastoidentify.imaging.io import write_image
    from elastoidentify.imaging.phantom import make_phantom

    body = make_phantom(width=60, pixels=72, elements=24, noise=0.01)
    (folder / "phantom").mkdir()
    names = {"rest": body.rest, "segmentation": body.segmentation, "labels": body.segmentation}
    names |= {f"pushed_{k}": image for k, image in enumerate(body.pushed, 1)}
    names |= {f"push{k}": image for k, image in enumerate(body.pushed, 1)}
    for name, image in names.items():
        write_image(folder / f"{name}.nrrd", image)
        write_image(folder / "phantom" / f"{name}.nrrd", image)
    rows, columns = body.rest.array.shape[1:]
    places = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    places = body.rest.index_to_world(np.column_stack([places, np.zeros(len(places))]))
    fields = body.displacements(places)
    field = sitk.GetImageFromArray(fields[0].reshape(1, rows, columns, 3), isVector=True)
    field.SetSpacing(body.rest.spacing.tolist())
    field.SetOrigin(body.rest.origin.tolist())
    sitk.WriteImage(field, str(folder / "trial1.nrrd"))
    table = np.column_stack([places, fields[1]])
    np.savetxt(folder / "trial2.csv", table, delimiter=",", header="x,y,z,u,v,w", comments="")


def volume(folder):
    """A small volume, by the names of the page of volumes."""
    from elastoidentify.imaging.io import write_image
    from elastoidentify.imaging.phantom import make_phantom_volume

    body = make_phantom_volume(width=32, voxels=20, elements=8, noise=0.01)
    write_image(folder / "rest.nrrd", body.rest)
    write_image(folder / "segmentation.nrrd", body.segmentation)
    for k, image in enumerate(body.pushed, 1):
        write_image(folder / f"push_{k}.nrrd", image)


FOLLOWED = {"README.md": plane, "docs/command-line.md": plane, "docs/volumes.md": volume}


@pytest.mark.slow
@pytest.mark.parametrize("page", FOLLOWED)
def test_the_commands_of_the_page_run_in_its_order(page, tmp_path):
    if not has_elastix():
        host_missing("itk-elastix is not installed", 'pip install ".[all]"')
    shown = [typed(block) for block in CONSOLE[page]]
    wanted = [words for words in commands(page) if words[1] != "paraview" and words not in shown]
    assert len(wanted) >= 3
    FOLLOWED[page](tmp_path)
    for words in wanted:
        call(words, tmp_path)
        for option in ("-o", "--picture", "--table", "--html", "--dicom"):
            if option in words:
                assert (tmp_path / words[words.index(option) + 1]).exists(), words


@pytest.mark.slow
def test_the_commands_of_the_page_of_cohorts_plan_every_subject(tmp_path):
    pytest.importorskip("snakebids", reason="needs snakebids: pip install .[cohort]")
    body = re.search(
        r"^elastoidentify-cohort BIDS OUT participant .*?\n(?!\s)", PAGES[COHORT], re.M | re.S
    )
    words = shlex.split(body.group().replace("\\\n", " "))[1:]
    for subject in ("01", "02"):
        folder = tmp_path / "BIDS" / f"sub-{subject}" / "elast"
        folder.mkdir(parents=True)
        for end in ("acq-rest_elast", "acq-push1_elast", "acq-push2_elast", "dseg"):
            (folder / f"sub-{subject}_{end}.nii.gz").write_text("")
    (tmp_path / "BIDS" / "dataset_description.json").write_text(
        '{"Name": "t", "BIDSVersion": "1.10.0"}'
    )
    done = subprocess.run(
        [sys.executable, "-m", "elastoidentify.cohort.app", *words, "-n"],
        cwd=tmp_path, capture_output=True, encoding="utf-8",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^participant +2$", done.stdout + done.stderr, re.M)


# ---- every command is one that is taken

COHORT = "docs/cohort.md"


def parser_of(words):
    """The parser of a command's own options; fails where there is no such command."""
    from elastoidentify.cli.parser import make_parser

    (group,) = [
        one for one in make_parser()._actions if isinstance(one, argparse._SubParsersAction)
    ]
    assert words[1] in group.choices, f"no command {words[1]}: {shlex.join(words)}"
    return group.choices[words[1]]


def check_options(words):
    """Fail where the command or one of its options does not exist."""
    if words[1:] == ["--version"] or words[1:] == ["COMMAND", "--help"]:
        return
    there = parser_of(words)._option_string_actions
    for word in words[2:]:
        if re.match(r"--?[a-zA-Z]", word):
            assert word.partition("=")[0] in there, f"no option {word}: {shlex.join(words)}"


@pytest.mark.parametrize(
    ("page", "words"), [(page, words) for page in PAGES for words in commands(page)]
)
def test_every_command_of_a_block_is_taken(page, words):
    from elastoidentify.cli.parser import make_parser
    from elastoidentify.paraview.launch import PROGRAMS

    words = words[words.index("elastoidentify") :]
    if words[1] == "paraview":
        assert not words[2:] or words[2] in {*PROGRAMS, "sample", "stop", "env"}, words
        return
    check_options(words)
    make_parser().parse_args(words[1:])


def named():
    """Every call in the middle of a sentence, as words."""
    for page, text in PAGES.items():
        for code in re.findall(r"`(elastoidentify\s[^`]+)`", FENCE.sub("", text)):
            yield page, code.split()


@pytest.mark.parametrize(("page", "words"), list(named()))
def test_every_command_in_a_sentence_has_a_name_and_options_that_there_are(page, words):
    check_options(words)


def test_the_options_of_a_cohort_are_those_of_run():
    for said in re.findall(r'--options "(-.*?)"', PAGES[COHORT]):
        check_options(["elastoidentify", "run", *shlex.split(said)])


def test_every_command_is_on_the_page_of_the_command_line():
    from elastoidentify.cli.parser import make_parser

    (group,) = [
        one for one in make_parser()._actions if isinstance(one, argparse._SubParsersAction)
    ]
    table = re.findall(r"^\| `([\w-]+)` \|", PAGES["docs/command-line.md"], re.M)
    assert set(table) == set(group.choices)


def test_there_is_something_to_run():
    assert CONSOLE[FIRST] and CONSOLE["docs/command-line.md"]
    assert len({page for page in PAGES for _ in commands(page)}) >= 7


def test_an_option_that_does_not_exist_is_found():
    with pytest.raises(AssertionError, match="no option --edge"):
        check_options(["elastoidentify", "run", "--edge", "7"])
    with pytest.raises(AssertionError, match="no command stiffness"):
        check_options(["elastoidentify", "stiffness"])


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
