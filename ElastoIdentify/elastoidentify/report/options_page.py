"""The page of options in the docs, made from the table.

``python -m elastoidentify.report.options_page > docs/options.md``
"""

from ..options import Choice, Flag, Number, Option, Picture, Rows
from ..study import STEPS, ReadOptions

TITLES = {
    "mesh": "Mesh",
    "register": "Registration",
    "identify": "Identification",
    "report": "Report",
    "read": "Files",
}
INTRODUCTION = """# All options

Made from the table of options (`elastoidentify/study.py`), which every host follows: the name is
that of Python (`Study(edge_length=5)`, `elastoidentify.identify(method="global")`), of the VTK
filters (`SetEdgeLength`), of ParaView (`EdgeLength`) and of Slicer's *Advanced*; beside it, what
the command line calls it. Lengths are in the images' unit (mm), moduli in the unit of the known
materials.
"""


def options_page() -> str:
    """Return the page in Markdown."""
    parts = [INTRODUCTION]
    for step, table in {**STEPS, "read": ReadOptions}.items():
        lines = [f"## {TITLES[step]}\n", "| option | command line | values | default | meaning |"]
        lines += ["|---|---|---|---|---|"]
        lines += [_line(option) for option in table.options().values()]
        parts.append("\n".join(lines) + "\n")
    return "\n".join(parts)


def _line(option: Option) -> str:
    flags = " ".join(f"`{flag}`" for flag in option.flags)
    meaning = option.__doc__ + (f" Unit: {option.unit}." if option.unit else "")
    return f"| `{option.name}` | {flags} | {_values(option)} | {_default(option)} | {meaning} |"


def _values(option: Option) -> str:
    if isinstance(option, Choice):
        return ", ".join(f"`{word}`" for word in option.choices)
    if isinstance(option, Flag):
        return "on, off"
    if isinstance(option, Picture):
        return "images" if option.repeatable else "an image"
    if isinstance(option, Rows):
        return "rows of " + ", ".join(option.columns)
    if isinstance(option, Number):
        return option.wanted().replace("a finite number", "number").strip()
    return "text"


def _default(option: Option) -> str:
    if isinstance(option, Flag):
        return "on" if option.default else "off"
    if option.default in (None, "", ()):
        return ""
    return f"`{option.default}`"


if __name__ == "__main__":
    print(options_page(), end="")
