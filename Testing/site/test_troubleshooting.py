"""Every heading of the page of messages is a message of the source."""

import ast
import re
from pathlib import Path

import pytest

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


def test_there_is_something_to_find():
    assert len(HEADINGS) > 25
