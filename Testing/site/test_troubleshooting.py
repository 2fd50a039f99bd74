"""Every heading of the page of messages is one of the source, and what goes wrong is there."""

import ast
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("SimpleITK")

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
HEADINGS = re.findall(r"^### (.+)$", PAGE, re.M)


@pytest.fixture(scope="module")
def sentences():
    """Every text of the package's source; what is filled in later stands as …"""
    found = []
    for path in (ROOT / "ElastoIdentify" / "elastoidentify").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [getattr(part, "value", None) for part in node.values]
                found.append("".join(p if isinstance(p, str) else "…" for p in parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return found


@pytest.mark.parametrize("heading", HEADINGS)
def test_the_heading_is_a_message_of_the_source(heading, sentences):
    parts = [re.escape(part.strip()) for part in heading.split("…") if part.strip(" ")]
    pattern = re.compile(".*".join(parts), re.S)
    assert any(pattern.search(sentence) for sentence in sentences), heading


# ---- what goes wrong most often, and what is printed then


def series(folder, **changes):
    """A DICOM series."""
    from dicom_files import volume, write_series

    write_series(folder, volume(), **changes)


def write(path, array, **more):
    """An image or a segmentation."""
    from elastoidentify.imaging.image import Image
    from elastoidentify.imaging.io import write_image

    write_image(path, Image(array, **more))


def cut(path):
    path.write_bytes(path.read_bytes()[:-200])


def together(folder, *parts):
    """Put the files of several folders into one, `rest.dcm`."""
    (folder / "rest.dcm").mkdir()
    for part in parts:
        for file in (folder / part).iterdir():
            shutil.copy(file, folder / "rest.dcm" / f"{part}_{file.name}")


def two_series(folder):
    series(folder / "a")
    series(folder / "b", number=2)
    together(folder, "a", "b")


def two_orientations(folder):
    from dicom_files import CORONAL

    series(folder / "a", edit=in_one_series)
    series(folder / "b", edit=in_one_series, orientation=CORONAL)
    together(folder, "a", "b")


def in_one_series(number, data):
    data.SeriesInstanceUID = "1.2.3.4"


def all_volumes_but_one(folder):
    for name, array in (("rest", GREY), ("seg", LABELS)):
        write(folder / f"{name}.nrrd", np.repeat(array, 9, 0))


def cut_from_one_volume(folder):
    write(folder / "push.nrrd", np.repeat(GREY, 9, 0))


def missing_slice(folder):
    series(folder / "rest.dcm")
    sorted((folder / "rest.dcm").iterdir())[2].unlink()


GREY = np.random.default_rng(0).integers(0, 255, (1, 40, 40)).astype(np.uint8)
LABELS = np.zeros((1, 40, 40), np.uint8)
LABELS[0, 4:12, 4:36], LABELS[0, 12:32, 4:36], LABELS[0, 32:36, 4:36] = 1, 2, 3
SINGLE = np.indices(LABELS.shape).sum(0).astype(np.uint8) % 5 == 0

RUN = "--known 1:E=5,nu=0.4 --rigid 3"
WRONG = {
    "no file": (lambda folder: (folder / "rest.nrrd").unlink(), RUN),
    "cut short": (lambda folder: cut(folder / "rest.nrrd"), RUN),
    "a text": (lambda folder: (folder / "rest.nrrd").write_text("my image"), RUN),
    "flat": (lambda folder: write(folder / "rest.nrrd", GREY * 0), RUN),
    "elsewhere": (lambda folder: write(folder / "seg.nrrd", LABELS, origin=(90, 90, 0)), RUN),
    "pushed elsewhere": (lambda folder: write(folder / "push.nrrd", GREY, origin=(9, 0, 0)), RUN),
    "the same": (lambda folder: shutil.copy(folder / "rest.nrrd", folder / "push.nrrd"), RUN),
    "an image": (lambda folder: write(folder / "seg.nrrd", GREY / 7.3), RUN),
    "empty": (lambda folder: write(folder / "seg.nrrd", LABELS * 0), RUN),
    "one slice": (all_volumes_but_one, RUN),
    "cut from one": (cut_from_one_volume, RUN),
    "single voxels": (lambda folder: write(folder / "seg.nrrd", SINGLE.astype(np.uint8)), RUN),
    "no pad": (lambda folder: None, "--rigid 3"),
    "another pad": (lambda folder: None, "--known 9:E=5,nu=0.4 --rigid 3"),
    "incompressible": (lambda folder: None, "--known 1:E=5,nu=0.5 --rigid 3"),
    "another floor": (lambda folder: None, "--known 1:E=5,nu=0.4 --rigid 8"),
    "all known": (lambda folder: None, "--known 1:E=5,nu=0.4 --known 2:E=5,nu=0.4 --rigid 3"),
    "metres": (lambda folder: None, f"{RUN} --edge-length 500"),
    "micrometres": (lambda folder: None, f"{RUN} --edge-length 0.005"),
    "no folder": (lambda folder: None, f"{RUN} --table maps/a.csv"),
    "two files": (lambda folder: None, f"--pushed push.nrrd again.nrrd {RUN}"),
    "two series": (two_series, RUN),
    "folders": (lambda folder: series(folder / "rest.dcm" / "a"), RUN),
    "a localizer": (two_orientations, RUN),
    "a slice less": (missing_slice, RUN),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_goes_wrong_most_often_is_on_the_page(what, tmp_path, monkeypatch, capsys):
    """The message that is printed is one of the headings, and only one line is printed."""
    from elastoidentify.cli import main

    for name, array in (("rest", GREY), ("push", GREY[:, ::-1].copy()), ("seg", LABELS)):
        write(tmp_path / f"{name}.nrrd", array)
    change, options = WRONG[what]
    change(tmp_path)
    monkeypatch.chdir(tmp_path)
    rest = "rest.dcm" if (tmp_path / "rest.dcm").exists() else "rest.nrrd"
    words = f"run --rest {rest} --pushed push.nrrd --segmentation seg.nrrd {options} -o map.vtu"
    try:
        code = main(words.split())
    except SystemExit as ended:
        code = ended.code
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert code == 2, said
    assert any(matches(heading, said) for heading in HEADINGS), said


def test_a_message_that_is_not_on_the_page_is_found():
    assert not any(matches(heading, "rest.nrrd: the moon is full") for heading in HEADINGS)


def matches(heading, said):
    """Tell whether a line is the message of a heading."""
    parts = [part.strip() for part in heading.split("…")]
    return re.search(".*".join(map(re.escape, parts)).removeprefix(".*"), said) is not None


def test_there_is_something_to_find():
    assert len(HEADINGS) > 25
