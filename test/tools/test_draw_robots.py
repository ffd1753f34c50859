"""``tools/draw_robots.py`` draws each picture of docs/ by one command of the package."""

import draw_robots
import pytest
from draw_robots import PICTURES, ROOT, arguments_of, draw

from softrobot_twin.command_line.commands import program


@pytest.mark.parametrize("name", PICTURES)
def test_each_picture_stands_in_the_docs_and_its_command_is_one_of_the_package(name, tmp_path):
    words = arguments_of(name, tmp_path, tmp_path)
    chosen = program("softrobot_twin").parse_args(words)
    assert chosen.picture == tmp_path / f"{name}.png"
    files = [word for word in words if word.startswith("config/")]
    assert files and all((ROOT / file).is_file() for file in files)
    assert (ROOT / "docs" / f"{name}.png").is_file()


def test_pictures_of_the_docs_are_small():
    for name in PICTURES:
        assert (ROOT / "docs" / f"{name}.png").stat().st_size < 200_000, name


@pytest.mark.parametrize("code", [0, 1, 2])
def test_a_command_that_fails_is_told_after_all_others_have_run(code, tmp_path, monkeypatch):
    ran = []
    monkeypatch.setattr(draw_robots, "main", lambda words: ran.append(words[0]) or code)
    assert draw(["diamond", "explained"], tmp_path) == int(code == 2)
    assert ran == ["simulate", "explain"]
