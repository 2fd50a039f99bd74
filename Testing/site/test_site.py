"""The pages in docs/: a site without warnings, and plain Markdown whose links lead somewhere."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from hosts import host_missing

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md")])


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


# ---- the site


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built as docs/developing.md says; a warning is an error."""
    if importlib.util.find_spec("sphinx") is None:
        host_missing("Sphinx is not installed", 'pip install ".[docs]"')
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going"]
    done = subprocess.run(
        [*command, "-c", "docs/site", "-d", folder / "doctrees", "docs", folder / "html"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return folder / "html"


class Links(HTMLParser):
    """The links, pictures and anchors of a page."""

    def __init__(self, page: Path):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.anchors |= {attributes[name] for name in ("id", "name") if name in attributes}
        self.links += [attributes[name] for name in ("href", "src") if attributes.get(name)]


def test_every_link_and_picture_of_the_site_is_there(site):
    pages = {page: Links(page) for page in site.rglob("*.html")}
    broken = []
    for page, found in pages.items():
        for link in found.links:
            path, _, anchor = unquote(link).partition("#")
            if re.match(r"[a-z]+:|//", path):
                continue
            target = (page.parent / path.partition("?")[0]).resolve() if path else page
            if not target.exists() or (
                anchor and target in pages and anchor not in pages[target].anchors | {"", "#"}
            ):
                broken.append(f"{page.name}: {link}")
    svg = re.compile(r"#svg-|#$")
    assert not [one for one in broken if not svg.search(one)]


def test_every_page_is_on_the_site(site):
    for page in DOCS.rglob("*.md"):
        if page != DOCS / "README.md":
            assert (site / page.relative_to(DOCS)).with_suffix(".html").exists(), page


def test_the_site_has_a_description_of_every_public_name(site):
    shown = Links(site / "python.html").anchors
    for module in ("", ".imaging.meshing", ".imaging.phantom", ".filters"):
        for name in importlib.import_module(f"elastoidentify{module}").__all__:
            missing = {"Material", "Filter", "SegmentationToTriangleMesh"}  # parts and old names
            assert name in missing or any(a.endswith(f".{name}") for a in shown), name


FITS = """<script>onload = () => { document.title = "fits: " + (
    document.documentElement.scrollWidth <= innerWidth
    && [...document.images].every(image => image.naturalWidth)); }</script></body>"""


@pytest.mark.parametrize("page", ["index", "examples/slice"])
def test_a_browser_shows_the_page_with_its_pictures_in_the_window(site, tmp_path, page):
    """The picture of it is to be looked at: ELASTOIDENTIFY_PICTURES says where to put it."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no browser: sudo apt-get install chromium")
    folder = Path(os.environ.get("ELASTOIDENTIFY_PICTURES") or tmp_path)
    picture = folder / f"site-{page.replace('/', '-')}.png"
    asking = (site / page).with_suffix(".asking.html")
    asking.write_text(read((site / page).with_suffix(".html")).replace("</body>", FITS))
    words = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1280,1600"]
    done = subprocess.run(
        [*words, f"--screenshot={picture}", "--dump-dom", asking.as_uri()],
        capture_output=True,
        encoding="utf-8",
    )
    asking.unlink()
    assert "<title>fits: true</title>" in done.stdout, done.stderr
    assert picture.stat().st_size > 20_000


def test_the_list_of_pages_is_that_of_the_site():
    listed = set(re.findall(r"\]\(([\w-]+)\.md\)", read(DOCS / "README.md")))
    toctrees = re.findall(r"```\{toctree\}(.*?)```", read(DOCS / "index.md"), re.S)
    shown = {
        line for tree in toctrees for line in tree.split("\n") if re.fullmatch(r"[\w-]+", line)
    }
    assert shown == listed == {page.stem for page in DOCS.glob("*.md")} - {"README", "index"}


# ---- on a forge


@cache
def anchors(page: Path) -> set[str]:
    """The anchors that a forge gives the headings of a page."""
    text = re.sub(r"^```.*?^```", "", read(page), flags=re.M | re.S)
    headings = re.findall(r"^#+ (.+)$", text, re.M)
    plain = [re.sub(r"\[(.+?)\]\(.*?\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_the_plain_pages_lead_somewhere(page):
    text = re.sub(r"^```.*?^```", "", read(page), flags=re.M | re.S)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link):
            continue
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), link


def test_what_only_the_site_has_is_hidden_on_a_forge():
    for page in PAGES:
        outside = re.sub(r"<!--.*?-->", "", read(page), flags=re.S)
        assert "```{" not in outside, page


# ---- made pages


def test_the_page_of_commands_is_that_of_the_commands():
    from elastoidentify.cli.commands_page import commands_page

    assert read(DOCS / "commands.md") == commands_page()
