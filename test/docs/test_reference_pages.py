"""The generated parts of docs/ are what the sources say."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import pytest
import write_reference
from pydantic import Field

from softrobot_twin.scene.entry import Entry, unit
from softrobot_twin.scene.schema import Scene

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "write_reference.py"


def test_the_pages_are_what_the_sources_say():
    # In a process of its own: without laws and sections that other tests registered.
    done = subprocess.run([sys.executable, TOOL, "--check"], capture_output=True, text=True,
                          env=os.environ | {"COLUMNS": "30"}, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_width_of_the_terminal_changes_nothing(monkeypatch):
    texts = []
    for columns in ("30", "300"):
        monkeypatch.setenv("COLUMNS", columns)
        texts.append(write_reference.commands())
    assert texts[0] == texts[1]


def test_a_page_that_differs_is_named_with_the_command_that_writes_it(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(write_reference, "PAGES",
                        {"parameters.md": write_reference.PAGES["parameters.md"]})
    page = Path(shutil.copy(ROOT / "docs" / "parameters.md", tmp_path))
    page.write_text(page.read_text().replace("Ticks per second.", "Ticks in a second."))
    arguments = ["--docs", str(tmp_path)]
    assert write_reference.main([*arguments, "--check"]) == 1
    told = capsys.readouterr().out
    assert told.startswith("docs/parameters.md: ")
    assert "python tools/write_reference.py" in told
    assert "Ticks in a second." in page.read_text()
    assert write_reference.main(arguments) == 0
    assert "Ticks per second." in page.read_text()


class Undescribed(Entry):
    """An entry of this test."""

    reach: Annotated[float, unit("m")]


class WithoutUnit(Entry):
    """Another one."""

    reach: float = Field(default=1.0)
    """How far."""


@pytest.mark.parametrize("entry, missing", [(Undescribed, "meaning"), (WithoutUnit, "unit")])
def test_a_key_without_a_meaning_or_a_unit_is_refused(entry, missing):
    with pytest.raises(write_reference.UndescribedError, match=f"some.reach has no {missing}"):
        write_reference.table_of(entry, "some", {})


def test_every_section_of_a_scene_has_a_heading_to_which_its_links_lead():
    text = write_reference.scene_reference()
    headings = {line.lstrip("# ") for line in text.splitlines() if line.startswith("#")}
    sections = [name for name, field in Scene.model_fields.items()
                if write_reference.entries_in(field.annotation)]  # fmt: skip
    assert {f"`{name}`" for name in sections} - {"`body`", "`bodies`"} <= headings
    assert "`body`, `bodies`" in headings
