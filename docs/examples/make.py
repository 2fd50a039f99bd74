"""Make the gallery: run every example, and write its page, its picture and the list.

    python docs/examples/make.py [NAME …]

The page of an example has the docstring of its script, its picture, what it printed, and its code.
``cohort`` needs an environment with ``pip install ".[cohort]"``, ``in_paraview`` ParaView and,
where there is no display, Xvfb.
"""

import ast
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parent
DOCS = EXAMPLES.parent
PICTURES = DOCS / "pictures" / "gallery"

ORDER = {
    "slice": "a minute",
    "hidden_lesion": "a minute",
    "region": "a minute",
    "volume": "seconds",
    "transforms": "seconds",
    "own_mesh": "seconds",
    "repeatability": "seconds",
    "dicom": "seconds",
    "planning": "seconds",
    "in_paraview": "seconds",
    "cohort": "a minute",
}
"""The examples in the order of the gallery, and how long each takes."""
HOSTS = {"in_paraview": ["-m", "elastoidentify.paraview.launch", "pvpython"]}
"""Words before the script of an example that a host runs."""

INTRODUCTION = """# Gallery

Programs that run as they stand, with `pip install ".[all]"`; the last two say what else they need.
Tests run them and compare what they print with their pages. *Seconds* and *a minute* are meant on a
machine that has nothing else to do. More scripts for [ParaView](paraview.md#in-scripts), and those
for [3D Slicer](slicer.md#from-a-script), are on their pages.

| | what | time |
|---|---|---|
"""
TOCTREE = """
<!--
```{{toctree}}
:hidden:

{}
```
-->
"""


def run(name: str, folder: Path) -> str:
    """Run an example in a folder, and return what it printed."""
    before = [] if name not in HOSTS or os.environ.get("DISPLAY") else ["xvfb-run", "-a"]
    done = subprocess.run(
        [*before, sys.executable, *HOSTS.get(name, []), str(EXAMPLES / f"{name}.py")],
        cwd=folder,
        env=os.environ | {"MPLBACKEND": "Agg"},
        capture_output=True,
        encoding="utf-8",
    )
    if done.returncode:
        raise RuntimeError(f"{name}: {done.stdout}{done.stderr}")
    return done.stdout.strip()


def parts(name: str) -> tuple[str, str, str]:
    """Return title, text and code of an example's script."""
    source = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    title, _, text = ast.get_docstring(ast.parse(source)).partition("\n")
    return title, text.strip(), source.split('"""', 2)[2].strip()


def page(name: str, printed: str) -> str:
    """Return the page of an example in Markdown."""
    title, text, code = parts(name)
    picture = f"../pictures/gallery/{name}.png"
    shown = f"![{title}]({picture})\n\n" if (PICTURES / f"{name}.png").exists() else ""
    return (
        f"# {title}\n\n{text}\n\nTime: {ORDER[name]}. Program: [{name}.py]({name}.py).\n\n{shown}"
        f"It prints\n\n```text\n{printed}\n```\n\n```python\n{code}\n```\n"
    )


def gallery() -> str:
    """Return the list of examples in Markdown."""
    lines = []
    for name, time in ORDER.items():
        title = parts(name)[0]
        link = f"examples/{name}.md"
        there = (PICTURES / f"{name}.png").exists()
        picture = f"[![{title}](pictures/gallery/{name}.png)]({link})" if there else ""
        lines.append(f"| {picture} | [{title}]({link}) | {time} |")
    tree = TOCTREE.format("\n".join(f"examples/{name}" for name in ORDER))
    return INTRODUCTION + "\n".join(lines) + "\n" + tree


def main(names: list[str]) -> None:
    """Run the examples and write what the docs show of them."""
    PICTURES.mkdir(exist_ok=True)
    for name in names or ORDER:
        with tempfile.TemporaryDirectory() as folder:
            printed = run(name, Path(folder))
            drawn = Path(folder) / f"{name}.png"
            if drawn.exists():
                shutil.copy(drawn, PICTURES / drawn.name)
        (EXAMPLES / f"{name}.md").write_text(page(name, printed), encoding="utf-8")
        print(f"{name}:\n{printed}\n", flush=True)
    (DOCS / "gallery.md").write_text(gallery(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
