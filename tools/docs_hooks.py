"""What mkdocs does to the pages of docs/ beside its own work.

Pages link to sources by paths that lead out of docs/, such as ``../softrobot_twin/errors.py``: they
work on GitHub. In the site they lead to the repository, or, where ``mkdocs.yml`` names none, only
their text remains.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TO_SOURCES = re.compile(r"\[([^\]]*)\]\(((?:\.\./)+[^)\s]+)\)")
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
    parts[::2] = [TO_SOURCES.sub(lead, part) for part in parts[::2]]
    return "".join(parts)
