"""The site of docs/ builds, and all its links, anchors and pictures lead somewhere."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import docs_hooks
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(path.name for path in (ROOT / "docs").glob("*.md"))
VOID_OR_KNOWN = set(
    "a article aside b body br button circle code dd div dl dt em figcaption figure footer form g "
    "h1 h2 h3 h4 head header hr html i img input kbd label li link main meta nav noscript ol p "
    "path pre rect script section small span strong style sub sup svg table tbody td th thead "
    "title tr ul use "
    "defs marker text math mfrac mi mn mo mover mrow msub msubsup msup mspace mtext".split()
)  # fmt: skip


class Page(HTMLParser):
    """What a built page links to.

    Attributes:
        links: Targets of its links.
        pictures: Files of its pictures.
        sheets: Files of its style sheets.
        scripts: Files of its scripts.
        anchors: Ids of its elements.
        tags: Names of its elements.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links, self.pictures, self.anchors, self.tags = [], [], set(), set()
        self.sheets, self.scripts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.add(tag)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag == "link" and given.get("rel") == "stylesheet":
            self.sheets.append(given["href"])
        if tag == "script" and given.get("src"):
            self.scripts.append(given["src"])
        if tag == "img" and given.get("src"):
            self.pictures.append(given["src"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The pages of the site, by file."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return {path: Page(path.read_text()) for path in folder.rglob("*.html")}


@pytest.mark.exhaustive
def test_every_page_of_docs_is_in_the_site(site):
    names = {path.name for path in site}
    assert {page.replace(".md", ".html") for page in PAGES} <= names


def test_every_link_and_anchor_of_the_site_leads_somewhere(site):
    wrong, count = [], 0
    for path, page in site.items():
        if path.name == "404.html":
            continue
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            count += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            exists = target.is_file() if target not in site else True
            if not exists or (parts.fragment and target in site
                              and unquote(parts.fragment) not in site[target].anchors):
                wrong.append(f"{path.name}: {link}")
    assert wrong == []
    assert count > 500


def test_every_picture_of_the_site_exists(site):
    pictures = [(path, name) for path, page in site.items() for name in page.pictures
                if not urlsplit(name).scheme]  # fmt: skip
    missing = [f"{path.name}: {name}" for path, name in pictures
               if path.name != "404.html" and not (path.parent / unquote(name)).is_file()]  # fmt: skip
    assert missing == []
    assert len(pictures) > 10


def test_a_numbered_list_goes_on_behind_its_pictures(site):
    number = re.compile(r"(?:<p>|<img [^>]*>)\s*\d+\. ")
    broken = [path.name for path in site if number.search(path.read_text())]
    assert broken == []


def test_every_style_sheet_of_the_site_exists(site):
    for path, page in site.items():
        assert "site.css" in {Path(sheet).name for sheet in page.sheets}
        for sheet in page.sheets if path.name != "404.html" else ():
            assert (path.parent / sheet.partition("?")[0]).is_file(), f"{path.name}: {sheet}"


def test_the_site_needs_no_network_and_no_server(site):
    """Search, diagrams and equations work where the pages are opened as files."""
    for path, page in site.items():
        outside = [name for name in page.scripts + page.sheets + page.pictures
                   if urlsplit(name).netloc]  # fmt: skip
        assert outside == [], path.name
        assert "mermaid" not in path.read_text(), path.name
    folder = min(site, key=lambda path: len(path.parts)).parent
    assert (folder / "search/search_index.js").read_text().startswith("var __index = {")
    start = site[folder / "index.html"]
    assert "iframe-worker.js" in start.scripts
    assert "IFrameWorker" in (folder / "iframe-worker.js").read_text()


def test_diagrams_are_pictures_and_equations_mathml(site):
    pages = {path.name: (page, path.read_text()) for path, page in site.items()}
    assert {"math", "mfrac", "msub"} <= pages["equations.html"][0].tags
    assert "$" not in re.sub(r"<(script|code).*?</\1>", "", pages["equations.html"][1], flags=re.S)
    text = pages["architecture.html"][1]
    for room in ("geometry", "mechanics", "scripting", "command_line"):
        assert f'font-weight="bold">{room}</text>' in text
    assert text.count('marker-end="url(#arrow)"') == 19


def test_every_picture_in_docs_is_on_a_page(site):
    shown = {Path(unquote(name)).name for page in site.values() for name in page.pictures}
    readme = (ROOT / "README.md").read_text()
    unused = {path.name for path in (ROOT / "docs").glob("*.png")} - shown
    assert {name for name in unused if f"docs/{name}" not in readme} == set()


def test_words_in_angle_brackets_are_not_taken_for_html(site):
    unknown = {path.name: page.tags - VOID_OR_KNOWN for path, page in site.items()
               if page.tags - VOID_OR_KNOWN}  # fmt: skip
    assert unknown == {}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_begins_with_its_title_and_what_it_is_for(page):
    lines = [line for line in (ROOT / "docs" / page).read_text().splitlines() if line.strip()]
    assert lines[0].startswith("# ")
    assert re.match(r"[\w*`!\[]", lines[1]), "a sentence or a picture follows the title"


class File:
    """A page as mkdocs gives it to its hooks."""

    src_uri = "some.md"


class SomePage:
    """See `File`."""

    file = File


class Config:
    """A configuration with a repository, or none."""

    def __init__(self, repo_url):
        self.repo_url = repo_url


LINKED = "See [`errors`](../softrobot_twin/errors.py), [here](index.md).\n\n```\n[a](../b)\n```\n"


@pytest.mark.parametrize(
    "repository, shown",
    [
        (None, "`errors`, "),
        ("https://some.where/x", "[`errors`](https://some.where/x/blob/main/softrobot_twin/errors.py), "),
    ],
)
def test_links_to_sources_lead_to_the_repository_where_there_is_one(repository, shown):
    text = docs_hooks.on_page_markdown(LINKED, SomePage, Config(repository), None)
    assert text == f"See {shown}[here](index.md).\n\n```\n[a](../b)\n```\n"


def test_a_link_to_a_source_that_does_not_exist_stops_the_build():
    with pytest.raises(docs_hooks.BrokenLinkError, match=r"some\.md links to \.\./no/such"):
        docs_hooks.on_page_markdown("[x](../no/such.py)", SomePage, Config(None), None)


def test_the_navigation_names_each_page_once():
    class Loader(yaml.SafeLoader):
        """Reads over the names of Python functions."""

    Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)
    given = yaml.load((ROOT / "mkdocs.yml").read_text(), Loader)["nav"]
    named = [page for section in given for pages in section.values() for page in pages]
    assert sorted(named) == PAGES
