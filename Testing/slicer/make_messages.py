"""Make ElastoIdentifyLib/messages.py: the sentences of the library, for Slicer's translators.

    python Testing/slicer/make_messages.py > ElastoIdentify/ElastoIdentifyLib/messages.py

The library knows nothing of languages: it raises and returns English sentences with numbers in
them. They are collected from its source, with {0}, {1}, … where something is filled in.
"""

import ast
import re
import warnings
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "ElastoIdentify" / "elastoidentify"
ROOMS = ("errors.py", "options.py", "study.py", "pipeline.py", "installation.py", "fem", "linalg")
ROOMS += ("inverse", "imaging", "workers", "export")
LEFT_OUT = ("imaging/io", "imaging/phantom", "export/fem.py", "export/html.py")
LEFT_OUT += ("export/repeatability.py",)
"""What Slicer does otherwise, or not: reading files, making phantoms, pages and models."""

SHORTEST = 3  # words of a sentence; less is a name
CODE = re.compile(r"[<>\n]|import |%[sd]")

HEAD = '''"""The library's sentences, for translators; made by Testing/slicer/make_messages.py."""

from slicer.i18n import tr


def _(text):
    """Mark a text for Slicer's tools, which collect what is to be translated."""
    return text


def in_users_language(template):
    """Return a template in the user's language; here, since Slicer goes by the file."""
    return tr(template)


# fmt: off
TEMPLATES = (
'''


def template(node) -> str | None:
    """Return the text of a literal, with {0}, {1}, … for what is filled in; None of other nodes."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return _braces(node.value)
    if not isinstance(node, ast.JoinedStr):
        return None
    parts, number = [], 0
    for part in node.values:
        if isinstance(part, ast.Constant):
            parts.append(_braces(part.value))
        else:
            parts.append(f"{{{number}}}")
            number += 1
    return "".join(parts)


def _braces(text: str) -> str:
    return text.replace("{", "{{").replace("}", "}}")


def is_sentence(text: str) -> bool:
    """Tell whether people are to read it."""
    words = re.findall(r"[^\W\d_]{2,}", re.sub(r"\{\d+\}", " ", text))
    return len(words) >= SHORTEST and " " in text and not CODE.search(text)


def sentences(source: str):
    """Yield the templates of a module, without its docstrings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tree = ast.parse(source)
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):  # docstrings
            skipped.add(node.value)
        if isinstance(node, ast.JoinedStr):
            skipped.update(node.values)
        if node not in skipped:
            text = template(node)
            if text and is_sentence(text):
                yield text


def every_sentence() -> list[str]:
    """Return the templates of the library, in its order."""
    found = {}
    for room in ROOMS:
        for path in sorted((PACKAGE / room).rglob("*.py")) or [PACKAGE / room]:
            name = path.relative_to(PACKAGE).as_posix()
            if not name.startswith(LEFT_OUT):
                found.update(dict.fromkeys(sentences(path.read_text(encoding="utf-8"))))
    return list(found)


def module() -> str:
    """Return the text of the module."""
    lines = [f"    _({_quoted(text)}),\n" for text in every_sentence()]
    return HEAD + "".join(lines) + ")\n"


def _quoted(text: str) -> str:
    """Return a text as a literal as ruff writes it."""
    quote = "'" if '"' in text and "'" not in text else '"'
    escaped = text.replace("\\", "\\\\").replace(quote, f"\\{quote}")
    return f"{quote}{escaped}{quote}"


if __name__ == "__main__":
    print(module(), end="")
