"""What is measured: the Diamond at its refinements, a column below and above them, two robots that
touch."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import softrobot_twin
from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.deformable import Body, BoxRegion, Mesh, Region
from softrobot_twin.scene.actuator_entries import Cable
from softrobot_twin.scene.schema import Effector
from softrobot_twin.study.bench.structured_column import column_mesh, write_mesh
from softrobot_twin.study.bench.target_stretch import Stretch

_DIAMOND = Path("scenes") / "diamond.yaml"
_REFINEMENTS = (400, 1600, 4500, 15000)
# The Diamond's struts are too thin for good elements at 500 dof, and its finest mesh ends below
# 50 000: a column of the same material, 30 × 30 × 200 mm, stands in at both ends.
_COLUMN_SIZE = (0.030, 0.030, 0.200)
_COLUMN_CELLS = ((2, 2, 18), (12, 12, 98))
# Where the column's cables run through it, as shares of its length.
_CABLE_HOLDS = (0.25, 0.5, 0.75, 0.9)


class NoDefaultSceneError(SoftRobotTwinError):
    """The Diamond's scene file is not where the package keeps it."""

    def __init__(self, looked: list[Path]):
        self.looked = looked
        super().__init__("the Diamond's scene was not found; give a scene. Looked for "
                         + ", ".join(map(str, looked)))


class Paper(NamedTuple):
    """What Coevoet 2017, table 1, says of a robot.

    Attributes:
        dof: Unknowns of its mesh.
        step: Time of a step, contact included [s].
        source: Whose time it is.
    """

    dof: int
    step: float
    source: str = "the paper's"


# Scene and commands file of each robot that touches, in `config`.
_TOUCHING = {
    "grasper": ("grasper_lift.csv", Paper(1422, 5.0e-3)),
    "octoleg": ("octoleg_curl.csv", Paper(360, 1.7e-3)),
}


# The Trunk leans on a cylinder all along this part of its path [s].
_LEANING = ("trunk_path.csv", 5.6, 8.3)
# What the paper's own code takes at best on its small mesh with one obstacle.
_TRUNKS = {"trunk_1600": Paper(4995, 29.0e-3), "trunk_700": Paper(2100, 4.5e-3, "its C++ code's best")}


class BenchCase(NamedTuple):
    """One size.

    Attributes:
        name: What tables call it.
        scene: The scene.
        family: Sizes of one family differ in the mesh only; growth is fitted over a family.
        has_bar: The bar on the step's time is set for this case.
        commands: Commands file whose longest hold is timed; None for a circle of the effectors.
        stretch: Part of a targets file that is gone to and fro instead, or None.
        paper: What the paper measured on this robot, or None.
    """

    name: str
    scene: Scene
    family: str
    has_bar: bool = False
    commands: Path | None = None
    paper: Paper | None = None
    stretch: Stretch | None = None


def default_scene_path() -> Path:
    """The Diamond's scene file.

    Raises:
        NoDefaultSceneError: It is not there.
    """
    package = Path(softrobot_twin.__file__).resolve().parent
    shares = [parent / "share" / "softrobot_twin" for parent in package.parents[3:4]]
    folders = [package.parent, *shares, Path(sys.prefix) / "share" / "softrobot_twin"]
    candidates = [folder / "config" / _DIAMOND for folder in folders]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise NoDefaultSceneError(candidates)


def given_cases(paths: list[Path], commands: Path | None = None) -> list[BenchCase]:
    """Scenes that a user names; their sizes are taken as one family.

    Args:
        paths: Scene files; the package's own robots that touch are timed as in its benchmark.
        commands: Commands file whose longest hold is timed, or None.
    """
    cases = []
    for path in paths:
        ours = [*touching_cases(), *leaning_cases()] if path.is_file() else []
        known = [case for case in ours if case.scene.path.samefile(path)]
        if known and commands is None:
            cases += known
            continue
        cases.append(BenchCase(path.stem, load_scene(path), "the given scenes",
                               _is_default(path), commands))
    return cases


def touching_cases() -> list[BenchCase]:
    """The robots that hold something or touch themselves."""
    folder = default_scene_path().parent
    return [
        BenchCase(name, load_scene(folder / f"{name}.yaml"), f"the {name.capitalize()}",
                  commands=folder.parent / "commands" / commands, paper=paper)
        for name, (commands, paper) in _TOUCHING.items()
    ]


def leaning_cases() -> list[BenchCase]:
    """The Trunk led by targets while it leans: between two cylinders, and coarse on one."""
    folder = default_scene_path().parent
    scene = load_scene(folder / "trunk_cylinders.yaml")
    file, begin, end = _LEANING
    stretch = Stretch(folder.parent / "targets" / file, begin, end)
    coarse = _with_mesh(scene, scene.mesh_path.with_name("trunk_700.vtk"))
    coarse = coarse.model_copy(update={
        "obstacles": scene.obstacles[:1],
        "contact": scene.contact.model_copy(update={"between": scene.contact.between[:1]}),
    })
    return [
        BenchCase(name, case, "the Trunk", paper=_TRUNKS[name], stretch=stretch)
        for name, case in (("trunk_700", coarse), ("trunk_1600", scene))
    ]


def standard_cases(folder: Path) -> list[BenchCase]:
    """Sizes from 500 to 50 000 dof, the smallest first.

    Args:
        folder: Where the columns' meshes are written.
    """
    path = default_scene_path()
    diamond = load_scene(path)
    meshes = diamond.mesh_path.parent
    diamonds = [
        BenchCase(f"diamond_{nodes}", _with_mesh(diamond, meshes / f"diamond_{nodes}.vtk"),
                  "the Diamond", diamond.mesh_path.name == f"diamond_{nodes}.vtk")
        for nodes in _REFINEMENTS
    ]
    small, large = (_column_case(diamond, cells, folder) for cells in _COLUMN_CELLS)
    return [small, *diamonds, large, *touching_cases(), *leaning_cases()]


def _is_default(path: Path) -> bool:
    try:
        return path.resolve() == default_scene_path().resolve()
    except NoDefaultSceneError:
        return False


def _with_mesh(scene: Scene, file: Path) -> Scene:
    mesh = scene.body.mesh.model_copy(update={"file": file})
    return scene.model_copy(update={"body": scene.body.model_copy(update={"mesh": mesh})})


def _column_case(diamond: Scene, cells: tuple[int, int, int], folder: Path) -> BenchCase:
    """A hanging column with four cables inside it, halfway between its axis and its sides."""
    name = "column_" + "x".join(map(str, cells))
    file = folder / f"{name}.vtk"
    write_mesh(file, column_mesh(_COLUMN_SIZE, cells))
    half, length = 0.5 * _COLUMN_SIZE[0], _COLUMN_SIZE[2]
    top = Region(box=BoxRegion(minimum=(-1.1 * half, -1.1 * half, -1e-6),
                               maximum=(1.1 * half, 1.1 * half, 1e-6)))
    out = 0.5 * half
    places = {"north": (0.0, out), "west": (-out, 0.0), "south": (0.0, -out), "east": (out, 0.0)}
    pulled = diamond.cables[0]
    cables = tuple(
        Cable(name=side, pull_point=(x, y, 0.02),
              points=tuple((x, y, -share * length) for share in _CABLE_HOLDS),
              shortening=(0.0, 0.012), rate=pulled.rate, tension=pulled.tension)
        for side, (x, y) in places.items()
    )
    scene = diamond.model_copy(update={
        "name": "column", "markers": (), "cables": cables,
        "body": Body(mesh=Mesh(file=file), element="linear", material=diamond.body.material,
                     fixed=(top,)),
        "effectors": (Effector(name="tip", points=((0.0, 0.0, -length),)),),
    })
    return BenchCase(name, scene, "the columns")
