"""Nothing is compiled in a step, however late bodies meet: that would stall a robot."""

import subprocess
import sys

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation
from test.late_kernels import noted
from test.places import ROOT

LEG = str(ROOT / "meshes" / "octoleg_120.vtk")
MIDDLE = np.array([0.1034, 0.0, -0.0325])


def leg(name, y):
    return {
        "name": name, "mesh": {"file": LEG, "translation": [0.0, y, 0.0]},
        "element": "linear",
        "material": {"young_modulus": 2e5, "poisson_ratio": 0.3, "density": 1000.0},
        "fixed": [{"box": {"minimum": [0.05, y - 0.02, 0.03], "maximum": [0.075, y + 0.02, 0.05]}}],
    }  # fmt: skip


def thrown(name, shape, place, velocity):
    return {"name": name, "mass": 0.05, "position": list(place), "velocity": velocity, **shape}


@pytest.fixture(scope="module")
def stones(tmp_path_factory):
    """A scene in which every kind of pair is far apart at rest, and meets within 0.3 s."""
    import meshio

    from softrobot_twin.geometry.surface import boundary_triangles

    mesh = meshio.read(LEG)
    file = tmp_path_factory.mktemp("stone") / "stone.stl"
    points = mesh.points - MIDDLE
    triangles = boundary_triangles(mesh.cells_dict["tetra"])
    meshio.write(file, meshio.Mesh(points, [("triangle", triangles)]))
    ball, box = {"sphere": {"radius": 0.02}}, {"box": {"size": [0.03] * 3}}
    stone = {"surface": {"file": str(file)}}
    left, right = [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]
    pairs = [["a", "ball"], ["b", "box"], ["b", "stone"], ["ball_2", "floor"], ["box_2", "floor"]]
    return scene_from_mapping({
        "name": "stones", "gravity": [0.0, 0.0, 0.0], "integration": "dynamic",
        "bodies": [leg("a", 0.0), leg("b", 0.5)],
        "rigid_bodies": [
            thrown("ball", ball, MIDDLE - [0.0, 0.1, 0.0], left),
            thrown("box", box, MIDDLE + [0.0, 0.62, 0.0], right),
            thrown("stone", stone, MIDDLE + [0.0, 0.4, 0.0], left),
            thrown("ball_2", ball, [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
            thrown("box_2", box, [1.2, 0.0, 0.0], [0.0, 0.0, -1.0]),
        ],
        "obstacles": [{"name": "floor", "position": [0.0, 0.0, -0.15], "plane": {}}],
        "cables": [{"name": "cable", "body": "a", "pull_point": [0.04, 0.0, 0.002],
                    "points": [[0.067, 0.0, 0.0135], [0.116, 0.0, -0.024]],
                    "shortening": [0.0, 0.02], "tension": [0.0, 5.0]}],
        "contact": {"friction": 0.3, "between": [{"pair": pair} for pair in pairs]},
    })  # fmt: skip


@pytest.fixture
def late(monkeypatch):
    """Names of the kernels that are compiled, or loaded, from now on."""
    return noted(monkeypatch.setattr)


def test_the_first_contact_of_every_pair_compiles_nothing(stones, late):
    simulation = Simulation(stones)
    simulation.warm_up()
    late.clear()
    met = set()
    for _ in range(60):
        touching = simulation.step(Hold(0.005)).contacts
        met |= {touching.names[pair] for pair in touching.pairs}
    assert {frozenset(pair) for pair in met} == {
        frozenset(touching.pair) for touching in stones.contact.between
    }
    assert late == []


def test_the_first_grip_and_the_first_lift_compile_nothing(late):
    simulation = Simulation.from_scene_file(ROOT / "config" / "scenes" / "grasper.yaml")
    simulation.warm_up()
    late.clear()
    for step in range(200):
        if step == 150:
            simulation.model.guides.aim("palm", [0.0, 0.0, 0.05], [0.0, 0.0, 0.1, 1.0])
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.015, 0.01))
    assert result.report.contact_count >= 3
    assert late == []


@pytest.mark.sampled
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_the_first_contact_in_the_inverse_compiles_nothing(late, friction):
    file = ROOT / "config" / "scenes" / "trunk_cylinders.yaml"
    mapping = written_out(read_yaml(file.read_text()))
    mapping["body"]["mesh"]["file"] = "../../meshes/trunk_700.vtk"
    mapping["contact"]["friction"] = friction
    path = np.genfromtxt(
        ROOT / "config" / "targets" / "trunk_path.csv", delimiter=",", skip_header=1
    )
    simulation = Simulation(scene_from_mapping(mapping, file))
    simulation.warm_up()
    late.clear()
    leaning = 0
    for row in path:
        leaning += simulation.step(FollowTargets(row[None, 1:4], 0.02)).report.contact_count > 0
        if leaning == 30:
            break
    assert leaning == 30
    assert late == []


@pytest.mark.exhaustive
def test_fallback_solvers_are_compiled_before_the_first_step():
    """Compiled in a step, one took nine seconds: the twin took the device for lost."""
    scene = ROOT / "config" / "scenes" / "grasper.yaml"
    run = subprocess.run([sys.executable, ROOT / "test/last_resorts.py", scene], cwd=ROOT,
                         capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "[]"
