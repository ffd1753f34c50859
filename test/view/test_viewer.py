import sys

import pytest

from softrobot_twin.view.mirror import open_viewer

pytestmark = pytest.mark.libraries

ADDRESS = "rerun+http://127.0.0.1:1/proxy"


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_display_no_viewer_is_opened(no_display):
    assert open_viewer(ADDRESS) is None


@pytest.mark.parametrize("name", ["DISPLAY", "WAYLAND_DISPLAY"])
def test_with_a_display_the_viewer_of_this_environment_is_opened(no_display, name, monkeypatch, tmp_path):
    told = tmp_path / "arguments"
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\necho "$@" > {told}\n')
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setenv(name, ":0")
    viewer = open_viewer(ADDRESS)
    assert viewer.wait(10.0) == 0
    arguments = told.read_text().split()
    assert arguments[:4] == ["-m", "rerun_cli", "--connect", ADDRESS]
    assert arguments[arguments.index("--bind") + 1] == "127.0.0.1"
