"""The command ``elastoidentify-cohort``."""

import sys
from pathlib import Path

from ..installation import needs

WORKFLOW = Path(__file__).resolve().parent / "workflow"
SENSIBLE = {
    "--cores": ["--cores", "1"],
    "--keep-going": ["--keep-going"],  # one broken subject stops no other
    "--rerun-incomplete": ["--rerun-incomplete"],  # what a killed run left behind
    "--nolock": ["--nolock"],  # outputs are written whole, so a dead run's lock guards nothing
    "--rerun-triggers": ["--rerun-triggers", "mtime", "input", "params"],
    "--quiet": ["--quiet", "rules"],
}
"""Options of Snakemake that hold unless said otherwise."""


def arguments_of(words: list[str]) -> list[str]:
    """Return the command's words with Snakemake's options completed."""
    said = {word.split("=")[0] for word in words}
    short = {"-c": "--cores", "-j": "--cores", "--jobs": "--cores", "-k": "--keep-going"}
    said |= {short[word] for word in said if word in short}
    said |= {"--cores"} if said & {"--profile", "--executor"} else set()
    return [*words, *(word for name, more in SENSIBLE.items() if name not in said for word in more)]


def main(words: list[str] | None = None) -> None:
    """Run the BIDS App; exits as Snakemake does."""
    try:
        from snakebids import bidsapp, plugins
    except ImportError:
        sys.exit(f"error: elastoidentify-cohort {needs('snakebids', 'cohort')}")
    words = sys.argv[1:] if words is None else words
    helping = not words or {"-h", "--help"} & set(words)
    app = bidsapp.app(
        [plugins.SnakemakeBidsApp(WORKFLOW, snakefile_path=WORKFLOW / "Snakefile")],
        description="Stiffness maps of all subjects of a study; options of Snakemake follow.",
    )
    app.run(words if helping else arguments_of(words))


if __name__ == "__main__":
    main()
