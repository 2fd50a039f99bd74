"""One subject.

``python -m elastoidentify.cohort.participant BIDS OUT SUBJECT PROGRAM [options of run]``
"""

import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from . import layout


def command(
    bids: Path, out: Path, subject: str, program: str = "", options: Sequence[str] = ()
) -> list[str]:
    """Return the call of ``elastoidentify run`` for a subject.

    Parameters
    ----------
    bids, out : Path
    subject : str
        Without ``sub-``.
    program : str
        What runs elastoidentify, such as ``apptainer exec image.sif elastoidentify``; by default
        this Python.
    options : sequence of str
        Of ``elastoidentify run``.
    """
    files, made = layout.inputs(bids, subject), layout.outputs(subject)
    words = [*(shlex.split(program) or [sys.executable, "-m", "elastoidentify"]), "run"]
    for option in ("rest", "pushed", "segmentation"):
        words += [word for file in files[option] for word in (f"--{option}", file)]
    words += ["-o", str(out / made["map"]), "--picture", str(out / made["picture"])]
    words += ["--table", str(out / made["table"]), "--report", str(out / made["report"])]
    return [*words, *options]


def main(arguments: list[str] | None = None) -> int:
    """Run a subject; its log is kept, also when it fails. Returns the exit code of the run."""
    bids, out, subject, program, *options = sys.argv[1:] if arguments is None else arguments
    log = Path(out) / layout.log(subject)
    for file in (log, Path(out) / layout.outputs(subject)["map"]):
        file.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "w", encoding="utf-8") as stream:
        words = command(Path(bids), Path(out), subject, program, options)
        done = subprocess.run(words, stdout=stream, stderr=subprocess.STDOUT, check=False)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
