"""Cohorts: twenty subjects, one of them broken, and a run that is killed half-way."""

import csv
import itertools
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from elastoidentify.cohort import app, layout
from elastoidentify.cohort.group import write_group
from elastoidentify.cohort.participant import command
from elastoidentify.errors import InputError

PACKAGES = str(Path(app.__file__).resolve().parents[2])
ROOT = Path(app.__file__).resolve().parents[3]

STAND_IN = '''
"""Writes what `elastoidentify run` writes, in half a second; broken images are refused."""
import json, pathlib, sys, time
said = dict(zip(sys.argv[2::2], sys.argv[3::2]))
calls = pathlib.Path(sys.argv[0]).with_name("calls")
with open(calls, "a") as stream:
    stream.write(pathlib.Path(said["--rest"]).name + "\\n")
if "broken" in open(said["--rest"]).read():
    sys.exit("error: rest: is no NIfTI file; copy it again")
time.sleep(0.5)
mu = float(open(said["--rest"]).read())
row = "label,name,given,unit,Mu mean,Mu standard error,determined\\n1,pad,True,Pa,9,0,1\\n"
row += f"2,,False,Pa,{mu},1.5,0.9\\n"
warnings = ["the misfit is large"] if mu > 1900 else []
pathlib.Path(said["--table"]).write_text(row)
pathlib.Path(said["--picture"]).write_bytes(b"png")
pathlib.Path(said["--report"]).write_text(json.dumps({"identification": {"warnings": warnings}}))
pathlib.Path(said["-o"]).write_text("map")
'''


@pytest.fixture
def study(tmp_path):
    """A BIDS folder of twenty subjects, the seventh of them broken."""
    for number in range(1, 21):
        subject = f"{number:02d}"
        folder = tmp_path / "bids" / f"sub-{subject}" / "elast"
        folder.mkdir(parents=True)
        for end in ("acq-rest_elast", "acq-push1_elast", "acq-push2_elast", "dseg"):
            text = "broken" if number == 7 else str(1000 + 47 * number)
            (folder / f"sub-{subject}_{end}.nii.gz").write_text(text)
    (tmp_path / "bids" / "dataset_description.json").write_text(
        json.dumps({"Name": "test", "BIDSVersion": "1.10.0"})
    )
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    return tmp_path


def call(study, level, *more):
    """Return the command of a cohort with the stand-in."""
    program = shlex.join([sys.executable, str(study / "stand_in.py")])
    return [
        sys.executable, "-m", "elastoidentify.cohort.app", str(study / "bids"), str(study / "out"),
        level, "--program", program, *more,
    ]  # fmt: skip


def run(study, level, *more):
    done = subprocess.run(
        call(study, level, *more), capture_output=True, text=True, timeout=240, env=environment()
    )
    return done.returncode, done.stdout + done.stderr


def environment():
    return {**os.environ, "PYTHONPATH": PACKAGES}


def calls(study):
    file = study / "calls"
    return sorted(file.read_text().split()) if file.exists() else []


def table(study):
    with open(study / "out" / "group" / "labels.tsv", encoding="utf-8") as stream:
        return list(csv.DictReader(stream, delimiter="\t"))


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_was_and_a_broken_subject_stops_no_other(study):
    pytest.importorskip("snakebids", reason="needs snakebids: pip install .[cohort]")
    first = subprocess.Popen(
        call(study, "participant", "--cores", "2"), stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, env=environment(), start_new_session=True,
    )  # fmt: skip
    try:
        end = time.monotonic() + 120
        while len(list((study / "out").rglob("*_map.vtu"))) < 8 and time.monotonic() < end:
            time.sleep(0.1)
    finally:
        os.killpg(first.pid, signal.SIGKILL)
        first.wait()
    done = {file.name[:6] for file in (study / "out").rglob("*_map.vtu")}
    assert 8 <= len(done) < 19
    (study / "calls").unlink()

    code, said = run(study, "participant", "--cores", "2")
    assert code == 1, said
    assert (study / "out/logs/sub-07.txt").read_text().startswith("error: rest: is no NIfTI file")
    computed = {name[:6] for name in calls(study)}
    assert len(computed & done) <= 2  # what was being written when the run was killed
    assert computed >= {f"sub-{k:02d}" for k in range(1, 21)} - done

    assert run(study, "group")[0] == 0
    rows = table(study)
    assert len(rows) == 20 and {row["label"] for row in rows} == {"2", "n/a"}
    (failed,) = [row for row in rows if row["quality"] == "failed"]
    assert failed["participant_id"] == "sub-07"
    assert failed["message"] == "error: rest: is no NIfTI file; copy it again"
    (study / "calls").unlink()
    run(study, "participant")
    assert calls(study) == ["sub-07_acq-rest_elast.nii.gz"]


@pytest.mark.slow
@pytest.mark.parametrize("where", ["here", "slurm"])
def test_a_dry_run_plans_every_subject_and_computes_none(study, where):
    pytest.importorskip("snakebids", reason="needs snakebids: pip install .[cohort]")
    more = []
    if where == "slurm":
        pytest.importorskip("snakemake_executor_plugin_slurm", reason="needs its Slurm plug-in")
        more = ["--profile", str(app.WORKFLOW / "slurm")]
    code, said = run(study, "participant", "-n", *more)
    assert code == 0, said
    planned = {tuple(line.split()) for line in said.splitlines() if line.startswith("participant ")}
    assert planned == {("participant", "20")}
    assert calls(study) == []


def made(study, subject, mu):
    """Write the outputs of a subject as a run does."""
    out = study / "out"
    for file in layout.outputs(subject).values():
        (out / file).parent.mkdir(parents=True, exist_ok=True)
    words = command(study / "bids", out, subject, f"{sys.executable} {study / 'stand_in.py'}")
    subprocess.run(words, check=True)
    return mu


def test_the_group_says_who_failed_and_why_and_whom_to_look_at(study):
    for subject in ("01", "20"):
        made(study, subject, 0)
    (study / "out" / "logs").mkdir()
    (study / "out" / "logs" / "sub-07.txt").write_text("working\rmesh\nerror: bad image\n\n")
    files = write_group(study / "out", ["01", "07", "09", "20"])
    assert [file.name for file in files] == ["labels.tsv", "labels.json", "index.html"]
    rows = {row["participant_id"]: row for row in table(study)}
    assert [row["quality"] for row in rows.values()] == ["good", "failed", "failed", "look"]
    assert rows["sub-01"]["Mu mean"] == "1047.0" and rows["sub-01"]["Mu spread"] == "n/a"
    assert rows["sub-07"]["message"] == "error: bad image"
    assert rows["sub-09"]["message"] == "was not run"
    assert rows["sub-20"]["message"] == "the misfit is large"
    dictionary = json.loads((study / "out" / "group" / "labels.json").read_text(encoding="utf-8"))
    assert list(dictionary) == list(rows["sub-01"])
    assert dictionary["Mu mean"]["Units"] == "Pa"
    page = (study / "out" / "group" / "index.html").read_text(encoding="utf-8")
    assert "4 subjects: 1 good, 1 look, 2 failed" in page
    assert 'src="../sub-01/elast/sub-01_desc-elastoidentify_map.png"' in page


def test_files_are_found_by_their_names_and_pushes_are_in_order(study):
    words = command(study / "bids", study / "out", "03", "", ["--rigid", "4"])
    assert words[:4] == [sys.executable, "-m", "elastoidentify", "run"]
    pushed = [Path(b).name for a, b in itertools.pairwise(words) if a == "--pushed"]
    assert pushed == ["sub-03_acq-push1_elast.nii.gz", "sub-03_acq-push2_elast.nii.gz"]
    assert words[-2:] == ["--rigid", "4"]


def test_subjects_can_be_chosen_and_missing_ones_are_refused(study):
    assert layout.subjects(study / "bids", ["sub-02", "03"], ["03"]) == ["02"]
    with pytest.raises(InputError, match="has no folder sub-99/elast"):
        layout.subjects(study / "bids", ["99"])


def test_options_of_snakemake_that_were_said_hold():
    words = app.arguments_of(["b", "o", "participant", "-j", "8", "--keep-going"])
    assert words.count("--keep-going") == 1 and "--cores" not in words
    assert "--cores" not in app.arguments_of(["b", "o", "participant", "--profile", "slurm"])
    assert app.arguments_of(["b", "o", "participant"])[3:5] == ["--cores", "1"]
