"""What mkdocs does to the pages of docs/ beside its own work.

Pages link to sources by paths that lead out of docs/, such as ``../softrobot_twin/errors.py``: they
work on GitHub. In the site they lead to the repository, or, where ``mkdocs.yml`` names none, only
their text remains. Diagrams become pictures and equations MathML here, so that a browser needs no
scripts from elsewhere; GitHub draws both by itself.
"""

from __future__ import annotations

import html
import re
import textwrap
from itertools import pairwise
from pathlib import Path

from latex2mathml.converter import convert

ROOT = Path(__file__).resolve().parents[1]
TO_SOURCES = re.compile(r"\[([^\]]*)\]\(((?:\.\./)+[^)\s]+)\)")
EQUATION = re.compile(r"(?<![\\$`\w])\$([^\s$`](?:[^$`\n]*[^\s$`])?)\$(?![\w$])")
DIAGRAM = re.compile(r" *```mermaid\ngraph BT\n(.*?)```", re.DOTALL)
# Size of a box of a diagram, and the gaps between boxes, in pixels.
WIDTH, HEIGHT, GAP, RISE = 150, 64, 14, 46
# Code in a line of text, and words in it that stay on one line: short names, options, statuses.
INLINE = re.compile(r"<code>([^<]+)</code>")
WORD = re.compile(r"(?<!\S)(?:&#?\w+;|[^&\s]){1,40}(?!\S)")
FENCE = re.compile(r"^( *```.*?^ *```)", re.MULTILINE | re.DOTALL)


class BrokenLinkError(Exception):
    """A page links to a source that does not exist."""


def on_page_markdown(markdown: str, page, config, files) -> str:
    """Leads links to sources to the repository; called by mkdocs for each page.

    Args:
        markdown: Text of the page.
        page: The page.
        config: Configuration of the site.
        files: All files of the site; not used.

    Raises:
        BrokenLinkError: A linked source does not exist.
    """
    def lead(match: re.Match) -> str:
        text, path = match.groups()
        source = (ROOT / "docs" / page.file.src_uri).parent / path.partition("#")[0]
        if not source.exists():
            raise BrokenLinkError(f"docs/{page.file.src_uri} links to {path}, which does not exist")
        if not config.repo_url:
            return text
        below = source.resolve().relative_to(ROOT).as_posix()
        return f"[{text}]({config.repo_url.rstrip('/')}/blob/main/{below})"

    # Code blocks are every second part.
    parts = FENCE.split(markdown)
    parts[::2] = [EQUATION.sub(lambda found: convert(found[1]), TO_SOURCES.sub(lead, part))
                  for part in parts[::2]]
    parts[1::2] = [DIAGRAM.sub(lambda found: diagram(found[1]), part) for part in parts[1::2]]
    return "".join(parts)


def on_page_content(page_html: str, page, config, files) -> str:
    """Keeps words of code on one line, which browsers break at hyphens; called by mkdocs.

    Args:
        page_html: The page.
        page: The page; not used.
        config: Configuration of the site; not used.
        files: All files of the site; not used.
    """
    def keep(match: re.Match) -> str:
        return f"<code>{WORD.sub(lambda word: f'<span class=word>{word[0]}</span>', match[1])}</code>"

    # Code blocks are every second part.
    parts = re.split(r"(<pre.*?</pre>)", page_html, flags=re.DOTALL)
    parts[::2] = [INLINE.sub(keep, part) for part in parts[::2]]
    return "".join(parts)


def diagram(text: str) -> str:
    """A picture of boxes and arrows, each arrow upwards.

    Args:
        text: Lines of mermaid: ``name["name: what it is"]`` and ``from --> to``.

    Returns:
        SVG.
    """
    labels = dict(re.findall(r'(\w+)\["(.*?)"\]', text))
    arrows = re.findall(r"(\w+) --> (\w+)", text)

    def level(name: str) -> int:
        return max((1 + level(above) for below, above in arrows if below == name), default=0)

    rows: dict[int, list[str]] = {}
    for name in labels:
        rows.setdefault(level(name), []).append(name)
    middles: dict[str, float] = {}
    for above in sorted(rows):
        # Each box below the middle of those that its arrows lead to, as far as there is room.
        for index, name in enumerate(rows[above]):
            ends = [middles[end] for start, end in arrows if start == name]
            middles[name] = sum(ends) / len(ends) if ends else 2.0 * index
        row = sorted(rows[above], key=middles.__getitem__)
        for left, right in pairwise(row):
            middles[right] = max(middles[right], middles[left] + 1.0)
    first = min(middles.values())
    whole = round((max(middles.values()) - first + 1.0) * (WIDTH + GAP) + GAP)
    places = {name: (GAP + (middle - first) * (WIDTH + GAP), level(name) * (HEIGHT + RISE) + 6)
              for name, middle in middles.items()}  # fmt: skip
    parts = []
    for below, above in arrows:
        (x, y), (u, v) = places[below], places[above]
        x, u, v = x + WIDTH / 2, u + WIDTH / 2, v + HEIGHT + 5
        parts.append(f'<path d="M{x:.0f} {y} C{x:.0f} {y - RISE / 2} {u:.0f} {v + RISE / 2} '
                     f'{u:.0f} {v}" fill="none" stroke="currentColor" opacity="0.6" '
                     'marker-end="url(#arrow)"/>')  # fmt: skip
    for name, (x, y) in places.items():
        parts.append(f'<rect x="{x:.0f}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="6" '
                     'stroke="currentColor" style="fill: var(--md-default-bg-color, white)"/>')  # fmt: skip
        lines = [name, *textwrap.wrap(labels[name].partition(": ")[2], 24)]
        for index, line in enumerate(lines):
            weight = ' font-weight="bold"' if index == 0 else ""
            parts.append(f'<text x="{x + WIDTH / 2:.0f}" y="{y + 17 + 14 * index}" fill="currentColor" '
                         f'text-anchor="middle" font-size="11"{weight}>{html.escape(line)}</text>')  # fmt: skip
    height = (1 + max(rows)) * (HEIGHT + RISE) - RISE + 12
    return (f'<svg viewBox="0 0 {whole} {height}" role="img" xmlns="http://www.w3.org/2000/svg" '
            f'style="max-width: {whole}px; width: 100%"><defs><marker id="arrow" viewBox="0 0 8 8" '
            'refX="6" refY="4" markerWidth="7" markerHeight="7" orient="auto"><path d="M0 0 L8 4 L0 8 z" '
            f'fill="currentColor"/></marker></defs>{"".join(parts)}</svg>\n')  # fmt: skip
