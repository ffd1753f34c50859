"""Scenes of SOFA in a folder with their meshes, and what they become."""

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

from softrobot_twin.__main__ import main
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.simulation import Hold, Simulation
from test.conversion.scene_meshes import write_meshes

SCENES = Path(__file__).parent / "scenes"


class Converted(NamedTuple):
    """What a conversion gave.

    Attributes:
        code: Exit code.
        path: The scene.
        told: What was printed.
    """

    code: int
    path: Path
    told: str

    @property
    def scene(self) -> Scene:
        return load_scene(self.path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("sofa")
    for path in SCENES.glob("*.*"):
        shutil.copy(path, made)
    write_meshes(made / "mesh")
    return made


@pytest.fixture(scope="module")
def conversions() -> dict:
    """The last conversion of each name: what it was asked, and what it gave."""
    return {}


@pytest.fixture
def convert(folder, conversions, capsys):
    """Converts a scene of the folder, or a text that is written there; what is there already is not made again."""

    def run(name: str, text: str | None = None, *options: str) -> Converted:
        output = folder / f"{Path(name).stem}.yaml"
        asked, found = conversions.get(output, (None, None))
        if asked == (name, text, options):
            return found
        if text is not None:
            (folder / name).write_text(text)
        output.unlink(missing_ok=True)
        code = main(["convert", str(folder / name), "--output", str(output), "--force", *options])
        told = capsys.readouterr()
        found = Converted(code, output, told.out + told.err)
        conversions[output] = (name, text, options), found
        return found

    return run


@pytest.fixture
def run_alone():
    """Runs a scene without commands."""

    def run(scene: Scene, time_step: float, steps: int = 20) -> tuple[Simulation, list[str]]:
        simulation = Simulation(scene)
        return simulation, [simulation.step(Hold(time_step)).status.value for _ in range(steps)]

    return run
