"""Files that come with the package are found from any folder."""

from pathlib import Path

import pytest

from softrobot_twin.scene import load_scene
from softrobot_twin.shared_files import given_file, shared_folders
from test.places import ROOT

SCENE = "config/scenes/finger.yaml"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_scene_of_the_package_is_loaded_with_its_meshes():
    scene = load_scene(SCENE)
    assert scene.path == ROOT / SCENE
    assert all(scene.file_path(body.mesh.file).is_file() for body in scene.deformables)


def test_a_file_below_the_working_directory_comes_first(folder):
    (folder / SCENE).parent.mkdir(parents=True)
    (folder / SCENE).touch()
    assert given_file(SCENE) == Path(SCENE)


@pytest.mark.parametrize("path", ["setup.py", "scenes/finger.yaml", "../config/scenes/finger.yaml",
                                  "config/scenes/nowhere.yaml", "/config/scenes/finger.yaml", ""])
def test_all_other_paths_stay_as_they_were_given(path):
    assert given_file(path) == Path(path)


def test_installations_have_the_files_below_share():
    assert all(place.parts[-2:] == ("share", "softrobot_twin") for place in shared_folders()[1:])
