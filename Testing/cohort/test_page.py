"""What the page of cohorts says: its commands, as they are typed."""

import csv
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hosts import has_elastix, host_missing

sys.path.insert(0, str(Path(__file__).parents[1] / "site"))
from test_commands import COHORT, PAGES, lines


def cohort_commands():
    """The words of every command of the page of cohorts: participant, group, on a cluster."""
    found = [shlex.split(line, comments=True) for line, _ in lines(COHORT)]
    return [words for words in found if words[0] == "elastoidentify-cohort"]


def cohort(folder, words):
    """Call the program as it stands; return its exit code and what it prints."""
    program = Path(sys.executable).with_name(words[0])
    done = subprocess.run(
        [str(program), *words[1:]], cwd=folder, capture_output=True, encoding="utf-8"
    )
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def study(tmp_path):
    """A folder with BIDS in it: a subject that is a phantom, and two without anything in them."""
    pytest.importorskip("snakebids", reason="needs snakebids: pip install .[cohort]")
    from elastoidentify.imaging.io import write_image
    from elastoidentify.imaging.phantom import make_phantom

    body = make_phantom(pixels=64, elements=24, noise=0.01)
    images = {"acq-rest_elast": body.rest, "dseg": body.segmentation}
    images |= {f"acq-push{k}_elast": image for k, image in enumerate(body.pushed, 1)}
    for subject in ("01", "02", "03"):
        folder = tmp_path / "BIDS" / f"sub-{subject}" / "elast"
        folder.mkdir(parents=True)
        for name, image in images.items():
            file = folder / f"sub-{subject}_{name}.nii.gz"
            write_image(file, image) if subject == "01" else file.touch()
    (tmp_path / "BIDS" / "dataset_description.json").write_text(
        '{"Name": "t", "BIDSVersion": "1.10.0"}'
    )
    return tmp_path


@pytest.mark.slow
def test_the_commands_of_the_page_of_cohorts_make_the_map_and_say_who_failed(study):
    if not has_elastix():
        host_missing("itk-elastix is not installed", 'pip install ".[all]"')
    one, group, _ = cohort_commands()
    assert (one[3], group[3]) == ("participant", "group")
    code, said = cohort(study, one)
    assert code == 1, said  # the page: while a subject fails
    code, said = cohort(study, group)
    assert code == 0, said
    with open(study / "OUT" / "group" / "labels.tsv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream, delimiter="\t"))
    found = {row["label"]: float(row["YoungModulus mean"]) for row in rows if row["label"] != "n/a"}
    assert found["2"] == pytest.approx(3000, rel=0.25)
    failed = [row["participant_id"] for row in rows if row["quality"] == "failed"]
    assert failed == ["sub-02", "sub-03"]
    for name in re.findall(r"^\| `([^`]*)`.*\|$", PAGES[COHORT], re.M)[4:]:
        assert (study / "OUT" / name).exists(), name


@pytest.mark.slow
def test_the_options_of_the_page_of_cohorts_choose_subjects(study):
    one, *_ = cohort_commands()
    for option, count in (([], 3), (["--participant-label", "01", "02"], 2),
                          (["--exclude-participant-label", "01"], 2)):  # fmt: skip
        assert not option or f"`{option[0]}" in PAGES[COHORT]
        code, said = cohort(study, [*one, *option, "-n"])
        assert code == 0, said
        assert re.search(rf"^participant +{count}$", said, re.M), said
    assert not (study / "OUT" / "logs").exists()


@pytest.mark.slow
def test_the_command_for_a_cluster_plans_every_subject(study):
    pytest.importorskip("snakemake_executor_plugin_slurm", reason="needs its Slurm plug-in")
    *_, words = cohort_commands()
    assert words[-2:] == ["--profile", "path/to/slurm"]
    from elastoidentify.cohort.app import WORKFLOW

    shutil.copytree(WORKFLOW / "slurm", study / "path" / "to" / "slurm")
    words[words.index("…")] = "--rigid 4"
    code, said = cohort(study, [*words, "-n"])
    assert code == 0, said
    assert re.search(r"^participant +3$", said, re.M), said
