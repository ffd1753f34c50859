"""Where scene files are found."""

from pathlib import Path

import pytest

from softrobot_twin.errors import ParameterError
from softrobot_twin.ros import scene_file
from softrobot_twin.ros.scene_file import find_scene_file

NAME = "scenes/some.yaml"


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A working directory and a package's share folder."""
    here, share = tmp_path / "here", tmp_path / "share"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setattr(scene_file, "get_package_share_directory", lambda name: str(share))
    return here, share / "config"


def put(folder):
    file = folder / NAME
    file.parent.mkdir(parents=True)
    file.touch()
    return file


def test_the_working_directory_is_searched_before_the_package(places):
    here, share = places
    installed = put(share)
    assert find_scene_file(NAME, "scene_file") == installed
    assert find_scene_file(str(installed), "scene_file") == installed
    assert find_scene_file(NAME, "scene_file") != put(here)
    assert find_scene_file(NAME, "scene_file") == here / NAME


def test_the_folder_of_the_parameter_file_is_searched_before_the_package(places, monkeypatch):
    here, share = places
    put(share)
    beside = put(here.parent / "robots")
    command = ["twin", "--ros-args", "--params-file", "../robots/my.yaml", "-p", "view:=false"]
    monkeypatch.setattr(scene_file.sys, "argv", command)
    assert find_scene_file(NAME, "scene_file") == beside
    assert find_scene_file(NAME, "scene_file") != put(here)


def test_the_source_tree_is_searched_when_the_package_is_not_installed(monkeypatch, tmp_path):
    def not_installed(name):
        raise LookupError(name)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scene_file, "get_package_share_directory", not_installed)
    found = find_scene_file("scenes/diamond.yaml", "scene_file")
    assert found == Path(__file__).resolve().parents[2] / "config/scenes/diamond.yaml"


def test_a_missing_scene_file_is_refused_with_all_searched_places(places):
    here, share = places
    with pytest.raises(ParameterError) as raised:
        find_scene_file(NAME, "device_scene_file")
    assert raised.value.name == "device_scene_file" and raised.value.value == NAME
    assert str(here / NAME) in str(raised.value) and str(share / NAME) in str(raised.value)


def test_an_empty_name_is_refused():
    with pytest.raises(ParameterError, match="must name a file"):
        find_scene_file("", "scene_file")
