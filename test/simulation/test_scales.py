"""The same robot of another size, at another place, turned: the same answer, in its own units.

With Young's modulus as it is and gravity over the scale s, forces grow with s²: all statics are
similar. Whatever differs by more than round-off was decided by a constant in metres or newtons, by
the axes of the world, or by where its origin is.
"""

import copy

import meshio
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from test.places import SCENES
from test.shapes import Cylinder
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation

SKEW = Rotation.from_rotvec(np.radians(30.0) * np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0))
STEP = 0.02


class Similarity:
    """x ↦ s R x + t, and the scene transformed by it.

    Args:
        scale: s.
        is_moved: Whether it rotates by 30° about a skew axis and translates by ten sizes.
        size: Size of the robot [m].
    """

    def __init__(self, scale: float, is_moved: bool, size: float):
        self.scale = scale
        self.turn = SKEW if is_moved else Rotation.identity()
        self.shift = 10.0 * size * scale * np.array([0.6, -0.64, 0.48]) * is_moved

    def points(self, x):
        return self.scale * self.turn.apply(np.asarray(x, float)) + self.shift

    def back(self, x):
        return self.turn.inv().apply(np.asarray(x) - self.shift) / self.scale

    def _shape(self, entry: dict) -> None:
        for shape in ("cylinder", "capsule", "sphere"):
            if shape in entry:
                own = entry[shape]
                own["radius"] *= self.scale
                if "ends" in own:
                    own["ends"] = (self.scale * np.array(own["ends"])).tolist()
        if "surface" in entry:
            entry["surface"]["scale"] = self.scale
        entry["position"] = self.points(entry.get("position", [0.0, 0.0, 0.0])).tolist()
        entry["rotation"] = self.turn.as_euler("xyz").tolist()

    def scene(self, mapping: dict, bodies, folder) -> dict:
        """The scene of the similar robot.

        Args:
            mapping: The scene.
            bodies: Its built bodies; one of them.
            folder: For the mesh.
        """
        made, s = copy.deepcopy(mapping), self.scale
        (body,) = bodies
        path = folder / f"body_{s:g}_{self.turn.magnitude():.2f}.vtk"
        x = self.points(body.mesh.node_positions)
        meshio.write(path, meshio.Mesh(x, [("tetra", body.mesh.cells)]))
        made["body"]["mesh"] = {"file": str(path)}
        made["body"].pop("visual", None)
        made["body"].pop("fixed", None)
        riding = {name: np.asarray(nodes).tolist() for name, nodes in body.riding.items()}
        riding_nodes = [node for nodes in riding.values() for node in nodes]
        fixed = np.setdiff1d(np.flatnonzero(body.fixed), riding_nodes).tolist()
        if fixed:
            made["body"]["fixed"] = [{"nodes": fixed}]
        made["body"]["attached"] = [{"to": name, "nodes": n} for name, n in riding.items()]
        gravity = np.array(made.get("gravity", [0.0, 0.0, -9.81]))
        made["gravity"] = (self.turn.apply(gravity) / s).tolist()
        for cable in made["cables"]:
            cable["pull_point"] = self.points(cable["pull_point"]).tolist()
            cable["points"] = self.points(cable["points"]).tolist()
            cable["shortening"] = [s * end for end in cable["shortening"]]
            cable["rate"] *= s
            cable["tension"] = [s**2 * end for end in cable["tension"]]
        for tube in made.get("tubes", []):
            tube["points"] = self.points(tube["points"]).tolist()
            tube["axial_stiffness"] *= s**2
        for spring in made.get("springs", []):
            spring["stiffness"] *= s
            for end in spring["ends"]:
                end["point"] = self.points(end["point"]).tolist()
        for slide in made.get("slides", []):
            slide["axis"] = self.turn.apply(slide["axis"]).tolist()
            slide["travel"], slide["rate"] = [s * end for end in slide["travel"]], s * slide["rate"]
        for solid in (*made.get("rigid_bodies", []), *made.get("obstacles", [])):
            self._shape(solid)
        for effector in made["effectors"]:
            effector["points"] = self.points(effector["points"]).tolist()
            effector.pop("measured_by", None)
        made.pop("markers", None)
        contact = made.get("contact")
        if contact:
            for key, usual in (("alarm_distance", 0.003), ("push_out_speed", 0.05),
                               ("tolerance", 1e-8)):  # fmt: skip
                contact[key] = s * contact.get(key, usual)
        solver = made.setdefault("solver", {})
        solver["residual_tolerance"] = s**2 * solver.get("residual_tolerance", 1e-4)
        solver["reach_tolerance"] = s * solver.get("reach_tolerance", 1e-4)
        return made


@pytest.fixture
def robots(tmp_path, body_of, block):
    """Scenes by name: mapping and folder that its files are found from."""
    diamond_file, trunk_file = SCENES / "diamond.yaml", SCENES / "trunk_cylinders.yaml"
    diamond, trunk = (
        written_out(yaml.safe_load(file.read_text())) for file in (diamond_file, trunk_file)
    )
    diamond["body"]["mesh"]["file"] = "../../meshes/diamond_400.vtk"
    trunk["body"]["mesh"]["file"] = "../../meshes/trunk_700.vtk"
    mesh = block(size=(0.02, 0.02, 0.1), cells=(1, 1, 5))
    foot = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]

    def cable(name, x, y) -> dict:
        return {"name": name, "pull_point": [x, y, 0.0], "shortening": [0.0, 0.02], "rate": 0.05,
                "points": [[x, y, z] for z in (0.02, 0.04, 0.06, 0.08, 0.095)],
                "tension": [0.0, 40.0]}  # fmt: skip

    beam = {
        "name": "beam", "gravity": [0.0, 0.0, -9.81],
        "body": body_of(mesh, "beam", young_modulus=3e5, fixed=foot),
        "cables": [cable("east", 0.018, 0.01), cable("north", 0.01, 0.018),
                   cable("west", 0.002, 0.01), cable("south", 0.01, 0.002)],
        "effectors": [{"name": "tip", "points": [[0.01, 0.01, 0.1]]}],
        "obstacles": [{"name": "rod", "cylinder": {
            "ends": [[0.03, -0.05, 0.08], [0.03, 0.07, 0.08]], "radius": 0.005}}],
        "contact": {"between": [{"pair": ["beam", "rod"]}]},
        "solver": {"newton_iterations": 3, "residual_tolerance": 1e-6},
    }  # fmt: skip
    # The same rod as triangles, and a spring. Where facets touch, steps have to converge: else they
    # depend on which of two nearly equal facets round-off prefers.
    facets = copy.deepcopy(beam)
    ends = np.array([[0.0007, -0.061, 0.0011], [0.0, 0.058, -0.0005]])
    points, triangles = Cylinder(ends, 0.005).surface(3e-3)
    meshio.write(tmp_path / "rod.vtk", meshio.Mesh(points, [("triangle", triangles)]))
    facets["obstacles"] = [{"name": "rod", "position": [0.0275, 0.0113, 0.0713],
                            "surface": {"file": str(tmp_path / "rod.vtk")}}]  # fmt: skip
    facets["springs"] = [{"name": "spring", "stiffness": 5.0, "ends": [
        {"on": "beam", "point": [0.0, 0.01, 0.09]}, {"on": "world", "point": [-0.03, 0.01, 0.09]},
    ]}]  # fmt: skip
    facets["solver"] = {"newton_iterations": 40, "residual_tolerance": 1e-10}
    facets["contact"]["tolerance"] = 1e-11
    return {"diamond": (diamond, diamond_file), "trunk": (trunk, trunk_file),
            "beam": (beam, tmp_path / "scene.yaml"),
            "facets": (facets, tmp_path / "scene.yaml")}  # fmt: skip


TARGETS = {"diamond": [0.01, 0.004, 0.006], "beam": [0.02, 0.002, -0.004],
           "facets": None, "trunk": [0.012, 0.0, 0.03]}  # fmt: skip
"""Displacement of the tip to its target [m]; None for a run by setpoints alone."""


def _run(simulation: Simulation, similar: Similarity, displacement) -> list:
    """Holds, moves to setpoints, follows a target, holds: results in units of the original robot."""
    s = similar.scale
    start = simulation.actuators.setpoints(0.2 * simulation.limits.displacement_max)
    soft = sum(body.mesh.node_count for body in simulation.model.bodies)
    commands = [Hold(STEP)] * 2 + [CommandSetpoints(start, STEP)] * 4
    if displacement is None:
        pulled = np.where(np.arange(len(start)) == 0, 0.5, 0.1)
        setpoints = simulation.actuators.setpoints(pulled * simulation.limits.displacement_max)
        commands += [CommandSetpoints(setpoints, STEP)] * 25
    else:
        target = simulation.effector_positions() + s * similar.turn.apply(displacement)
        commands += [FollowTargets(target, STEP)] * 25
    commands += [Hold(STEP)] * 2
    seen = []
    for command in commands:
        result = simulation.step(command)
        contacts = 0 if result.contacts is None else len(result.contacts.positions)
        seen.append((
            similar.back(result.state.positions[:soft]), result.displacements / s,
            result.efforts / s**2, contacts, result.status, set(result.report.active_limits),
        ))  # fmt: skip
    return seen


@pytest.fixture(scope="module")
def originals():
    """Bodies of each robot as it is, and what its run gives, once computed."""
    return {}


@pytest.mark.sampled
@pytest.mark.parametrize("robot", ["diamond", "beam", "facets", "trunk"])
@pytest.mark.parametrize("scale, is_moved", [(0.01, False), (100.0, False), (1.0, True),
                                             (0.01, True), (100.0, True)])  # fmt: skip
def test_a_similar_robot_gives_a_similar_result(robots, originals, tmp_path, robot, scale, is_moved):
    mapping, file = robots[robot]

    def run(similar, bodies):
        scene = scene_from_mapping(similar.scene(mapping, bodies, tmp_path), file)
        return _run(Simulation(scene, with_warnings=False), similar, TARGETS[robot])

    if robot not in originals:
        model = Simulation(
            scene_from_mapping(copy.deepcopy(mapping), file), with_warnings=False
        ).model
        size = model.nodes.size
        original = run(Similarity(1.0, False, size), model.bodies)
        originals[robot] = model.bodies, size, original
    bodies, size, original = originals[robot]
    # A tenth of a metre: the similar robots are 1 mm and 10 m large.
    assert scale == 1.0 or 0.09 < size < 0.6
    found = run(Similarity(scale, is_moved, size), bodies)
    touched = 0
    for step, (one, other) in enumerate(zip(original, found, strict=True)):
        x, displacements, efforts, contacts, *outcome = one
        assert list(other[4:]) == outcome, step
        # A contact between two facets may be counted for either, or for both.
        assert other[3] == contacts or robot == "facets", step
        np.testing.assert_allclose(other[0], x, rtol=0.0, atol=1e-6 * size, err_msg=str(step))
        np.testing.assert_allclose(other[1], displacements, rtol=0.0, atol=1e-6 * size)
        largest = np.abs(efforts).max()
        np.testing.assert_allclose(other[2], efforts, rtol=0.0, atol=1e-6 * largest + 1e-12)
        touched += contacts
    if robot != "diamond":
        assert touched > 0
