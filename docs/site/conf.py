"""The site of the pages in docs/: ``python -m sphinx -W -c docs/site docs build/site``.

The pages are plain Markdown that a forge shows as it is. What only the site has stands in comments,
which a forge leaves out; links that leave docs/ lead to the forge.
"""

import re
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
FORGE = "https://github.com/elastoidentify/SlicerElastoIdentify"
sys.path.insert(0, str(ROOT / "ElastoIdentify"))

import elastoidentify  # noqa: E402

project = "ElastoIdentify"
author = "The ElastoIdentify contributors"
release = version = elastoidentify.__version__
copyright = f"2026, {author}. Apache License 2.0"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
exclude_patterns = ["README.md", "site", "scripts"]
highlight_language = "none"

myst_heading_anchors = 4
myst_links_external_new_tab = False

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say kinds, shapes and units
autodoc_mock_imports = ["itk"]  # takes long to load, and nothing of it is shown
napoleon_google_docstring = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"ElastoIdentify {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_logo = str(ROOT / "Resources" / "ElastoIdentify.png")
html_copy_source = False
html_theme_options = {
    "source_repository": FORGE,
    "source_branch": "main",
    "source_directory": "docs/",
}
linkcheck_ignore = [FORGE + ".*"]

SHOWN_ELSEWHERE = {"index": "README.md", "changes": "CHANGELOG.md"}
"""Pages whose text is a file beside docs/; the page itself keeps what stands in its comments."""

COMMENT = re.compile(r"<!--\s*\n(```\{.*?\n```)\s*\n-->", re.S)
LINK = re.compile(r"(\]\(|src=\")(?![a-z]+:|#)([^)\s\"]+)")


def site_text(name: str, text: str) -> str:
    """Return what the site shows for the page `name` of docs/."""
    folder = (DOCS / name).parent
    if name in SHOWN_ELSEWHERE:
        own = "\n\n".join(COMMENT.findall(text))
        folder = ROOT
        text = (ROOT / SHOWN_ELSEWHERE[name]).read_text(encoding="utf-8") + "\n\n" + own
    text = COMMENT.sub(r"\1", text)
    return LINK.sub(lambda link: link[1] + site_link(link[2], folder, (DOCS / name).parent), text)


def site_link(link: str, folder: Path, page: Path) -> str:
    """Return a link of a text in `folder` as the site wants it in a page that lies in `page`."""
    path, mark, anchor = link.partition("#")
    target = (folder / path).resolve()
    for name, text in SHOWN_ELSEWHERE.items():
        if target == ROOT / text:
            target = DOCS / f"{name}.md"
    if target == DOCS / "README.md":
        target = DOCS / "index.md"
    if not target.exists():
        return link  # Sphinx will say so
    if target == DOCS or not target.is_relative_to(DOCS):
        kind = "tree" if target.is_dir() else "blob"
        return f"{FORGE}/{kind}/main/{target.relative_to(ROOT).as_posix()}{mark}{anchor}"
    up = "../" * len(page.relative_to(DOCS).parts)
    return up + target.relative_to(DOCS).as_posix() + mark + anchor


def setup(app):
    """Show the pages as :func:`site_text` says."""

    def read(_, name, source):
        source[0] = site_text(name, source[0])

    app.connect("source-read", read)
