"""What a stranger types, and what the page says that it prints.

The commands of a page that somebody follows are typed in its order. Blocks marked ``console`` show
what is printed, too, which is compared; those marked ``text`` show what else is printed, by the
programs of the gallery and by the demo, and are compared where these are tested. Every command that
is shown anywhere, in the middle of a sentence too, has a name and options that there are.
"""

import argparse
import io
import os
import re
import shlex
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from elastoidentify.cli import main
from hosts import has_elastix, host_missing
from printed import check, is_same

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    str(page.relative_to(ROOT)): page.read_text(encoding="utf-8")
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
FENCE = re.compile(r"^```(\S*)\n(.*?)^```", re.M | re.S)
FIRST, COHORT = "docs/first-map.md", "docs/cohort.md"


def lines(page):
    """Every line that a page gives to a shell, and what is printed then (None: not said)."""
    for kind, body in FENCE.findall(PAGES[page]):
        body = body.replace("\\\n", " ")
        if kind == "console":
            for part in re.split(r"^\$ ", body, flags=re.M)[1:]:
                line, _, shown = part.partition("\n")
                yield line, shown
        elif kind in ("", "sh"):
            yield from ((line, None) for line in body.splitlines() if line.strip())


def commands(page):
    """The words of every command of a page that is one of ours, and what is printed then."""
    for line, shown in lines(page):
        if re.match(r"(mpirun -np \d+ )?elastoidentify ", line):
            yield shlex.split(line, comments=True), shown


# ---- what is printed


class Shell:
    """A folder in which commands are typed. What was typed before is not run again.

    The first command is a process of its own, as in a real shell; the others do without the second
    that an interpreter takes to start. What elastix answers is kept (``--cache``), for several
    pages register the same images.
    """

    kept = "registrations"

    def __init__(self, folder):
        self.folder, self.printed = folder, {}

    def type(self, words):
        """Return what a command prints; fail with what it says where it fails."""
        assert words[0] == "elastoidentify", words
        if (key := tuple(words)) not in self.printed:
            kept = ["--cache", self.kept] if words[1] in ("run", "register") else []
            run = self._here if self.printed else self._apart
            code, said, complaints = run([*words[1:], *kept])
            assert code == 0, f"{shlex.join(words)}\n{complaints}"
            self.printed[key] = said
        return self.printed[key]

    def _apart(self, words):
        done = subprocess.run(
            [sys.executable, "-m", "elastoidentify", *words], cwd=self.folder,
            env=os.environ | {"MPLBACKEND": "Agg"}, capture_output=True, encoding="utf-8",
        )  # fmt: skip
        return done.returncode, done.stdout, done.stderr

    def _here(self, words):
        before, said, complaints = os.getcwd(), io.StringIO(), io.StringIO()
        os.chdir(self.folder)
        try:
            with redirect_stdout(said), redirect_stderr(complaints):
                return main(words), said.getvalue(), complaints.getvalue()
        finally:
            os.chdir(before)


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    """A shell with the images of the first map, and displacements that were measured elsewhere."""
    shell = Shell(tmp_path_factory.mktemp("plane"))
    shell.type(next(commands(FIRST))[0])
    field_and_table(shell.folder)
    return shell


def field_and_table(folder):
    """Displacements on the grid of the image at rest, for the page of the command line."""
    import SimpleITK as sitk

    rest = sitk.ReadImage(str(folder / "phantom" / "rest.nrrd"))
    field = sitk.PhysicalPointSource(
        sitk.sitkVectorFloat64, rest.GetSize(), rest.GetOrigin(), rest.GetSpacing()
    )
    places = sitk.GetArrayFromImage(field)
    u = 0.03 * (places - places.max(axis=(0, 1, 2)))
    field = sitk.GetImageFromArray(u, isVector=True)
    field.CopyInformation(rest)
    sitk.WriteImage(field, str(folder / "trial1.nrrd"))
    table = np.concatenate([places, u[..., ::-1] * [1, 1, 0]], axis=-1).reshape(-1, 6)
    np.savetxt(folder / "trial2.csv", table, delimiter=",", header="x,y,z,u,v,w", comments="")


@pytest.fixture(scope="module")
def space(tmp_path_factory):
    """A shell with small volumes, whose registrations are stored: elastix takes long in space."""
    from elastoidentify.imaging.io import read_image
    from elastoidentify.imaging.phantom import make_phantom_volume, write_phantom
    from elastoidentify.study import Study
    from stored_registration import only_read, store

    shell = Shell(tmp_path_factory.mktemp("space"))
    body = make_phantom_volume(width=32, voxels=20, elements=8, noise=0.01)
    write_phantom(shell.folder, body)
    names = ("segmentation", "rest", "pushed_1", "pushed_2", "pushed_3")
    labels, rest, *pushed = (read_image(shell.folder / f"{name}.nrrd") for name in names)
    study = Study(segmentation=labels, rest=rest, pushed=pushed, edge_length=8.0,
                  rigid_labels=body.rigid_labels)  # fmt: skip
    store(study, body, shell.folder / shell.kept)
    with only_read(shell.folder / shell.kept):
        yield shell


FOLLOWED = {
    FIRST: "plane",
    "README.md": "plane",
    "docs/command-line.md": "plane",
    "docs/volumes.md": "space",
}
OUTPUTS = ("-o", "--picture", "--table", "--html", "--dicom", "--out")


@pytest.mark.slow
@pytest.mark.parametrize("page", FOLLOWED)
def test_the_commands_of_the_page_run_in_its_order_and_print_what_is_shown(page, request):
    if not has_elastix():
        host_missing("itk-elastix is not installed", 'pip install ".[all]"')
    shell = request.getfixturevalue(FOLLOWED[page])
    typed = [(words, shown) for words, shown in commands(page) if words[1] != "paraview"]
    assert len(typed) >= 3
    for words, shown in typed:
        printed = shell.type(words)
        if shown is not None:
            check(printed, shown, rtol=0.25)
        for option in {*OUTPUTS} & {*words}:
            assert (shell.folder / words[words.index(option) + 1]).exists(), words


def test_no_page_shows_what_is_printed_without_a_test():
    for page, text in PAGES.items():
        kinds = {kind for kind, _ in FENCE.findall(text)}
        assert "console" not in kinds or page in FOLLOWED, page
        compared = page.startswith("docs/examples/") or page in ("docs/demo.md", "docs/hosts.md")
        assert "text" not in kinds or compared, page
        for line, shown in lines(page):
            first = re.sub(r"^(\w+=\S+ )+", "", line).split()[0]
            assert shown is not None or first in PROGRAMS or "/" in first, f"{page}: {line}"


PROGRAMS = {
    *("elastoidentify", "elastoidentify-cohort", "mpirun", "pip", "python", "python3"),
    *("cmake", "ctest", "git", "rm", "source", "Slicer", "#"),
}
"""First words of lines that are typed; any other would be something that is printed."""


# ---- every command is one that is taken


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
    ("page", "words"), [(page, words) for page in PAGES for words, _ in commands(page)]
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
    assert len([shown for page in FOLLOWED for _, shown in commands(page) if shown]) >= 8
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
