"""Which file lies where: a proposal, since BIDS has no convention for quasi-static elastography.

In, under the BIDS folder, for every subject::

    sub-01/elast/sub-01_acq-rest_elast.nii.gz     image at rest
    sub-01/elast/sub-01_acq-push1_elast.nii.gz    pushed images, 1, 2, …
    sub-01/elast/sub-01_dseg.nii.gz               labels on the rest image

Out, as derivatives::

    sub-01/elast/sub-01_desc-elastoidentify_map.vtu     the map on its mesh
    sub-01/elast/sub-01_desc-elastoidentify_map.png     its picture
    sub-01/elast/sub-01_desc-elastoidentify_stat.csv    the table of labels
    sub-01/elast/sub-01_desc-elastoidentify_map.json    all reports
    logs/sub-01.txt                                     what the run said
    group/labels.tsv, labels.json, index.html           all subjects

``.nii.gz`` may be ``.nii``, ``.nrrd`` or ``.mha``.
"""

from pathlib import Path

from ..errors import InputError

SUFFIXES = (".nii.gz", ".nii", ".nrrd", ".mha")


def subjects(bids: Path, wanted=None, left_out=None) -> list[str]:
    """Return the labels of the subjects that have a folder ``elast``, sorted.

    Parameters
    ----------
    bids : path
    wanted, left_out : sequence of str, optional
        With or without ``sub-``.

    Raises
    ------
    InputError
        None is there, or a wanted one is missing.
    """
    here = sorted(folder.parent.name[4:] for folder in Path(bids).glob("sub-*/elast"))
    chosen = [label.removeprefix("sub-") for label in wanted or here]
    missing = sorted(set(chosen) - set(here))
    if missing or not here:
        name = f"sub-{missing[0]}" if missing else "sub-LABEL"
        raise InputError(f"{bids}: has no folder {name}/elast with images of a push")
    out = {label.removeprefix("sub-") for label in left_out or ()}
    return [label for label in chosen if label not in out]


def inputs(bids: Path, subject: str) -> dict[str, list[str]]:
    """Return the files of a subject: ``rest``, ``segmentation`` (one each or none) and ``pushed``.

    Nothing is checked: what is missing is for the subject's run to say.
    """
    folder = Path(bids) / f"sub-{subject}" / "elast"

    def found(end):
        files = [
            file for suffix in SUFFIXES for file in folder.glob(f"sub-{subject}_{end}{suffix}")
        ]
        return sorted(map(str, files))

    return {
        "rest": found("acq-rest_elast"),
        "pushed": found("acq-push*_elast"),
        "segmentation": found("dseg"),
    }


def outputs(subject: str) -> dict[str, str]:
    """Return the files that are made of a subject, relative to the output folder."""
    stem = f"sub-{subject}/elast/sub-{subject}_desc-elastoidentify"
    return {
        "map": f"{stem}_map.vtu",
        "picture": f"{stem}_map.png",
        "table": f"{stem}_stat.csv",
        "report": f"{stem}_map.json",
    }


def log(subject: str) -> str:
    """Return where a subject's run says what it has to say."""
    return f"logs/sub-{subject}.txt"
