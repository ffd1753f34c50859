"""The site of docs/ builds; mkdocs itself refuses links and pages that lead nowhere."""

import os
import subprocess
import sys

import pytest

from test.places import ROOT


@pytest.mark.exhaustive
def test_every_page_of_docs_is_in_the_site_and_nothing_is_warned_of(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    assert pages <= {path.stem for path in tmp_path.rglob("*.html")}
