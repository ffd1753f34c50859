"""How much friction a pair has left, and that a step says so before it slips."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.loading import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Hold, Simulation

SCENE_FILE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "grasper.yaml"
G, FRICTION, EDGE, LEAST = 9.81, 0.5, 0.04, 0.2
STEP, PULL, SPEED = 0.01, 20.0, 0.05


def block(scene_of, pull, least=LEAST, friction=FRICTION, above=0.0):
    """A rigid block on a floor, pulled by a share of its greatest friction."""
    pair = {"pair": ["box", "floor"], "friction": friction}
    return scene_of(
        gravity=[pull * FRICTION * G, 0.0, -G], integration="dynamic",
        obstacles=[{"name": "floor", "plane": {}}],
        contact={"between": [{**pair, "least_grip_margin": least} if least else pair]},
        rigid_bodies=[{"name": "box", "mass": 0.03, "position": [0, 0, EDGE / 2 + above],
                       "box": {"size": [EDGE] * 3}}],
    )  # fmt: skip


@pytest.mark.parametrize("pull", [0.1, 0.5, 0.79, 0.81, 0.99])
def test_the_margin_of_a_block_is_what_its_pull_leaves_of_its_friction(scene_of, pull):
    simulation = block(scene_of, pull)
    for _ in range(5):
        result = simulation.step(Hold(STEP))
    assert result.report.figures == {"grip_margin.box.floor": pytest.approx(1.0 - pull, abs=1e-6)}
    assert ("box.floor.grip_margin" in result.report.active_limits) is (1.0 - pull < LEAST)


def test_a_block_that_slides_has_none_and_one_that_is_lifted_has_nothing_to_tell(scene_of):
    simulation = block(scene_of, 1.2)
    result = [simulation.step(Hold(STEP)) for _ in range(5)][-1]
    assert result.report.figures["grip_margin.box.floor"] == pytest.approx(0.0, abs=1e-6)
    result = block(scene_of, 0.0, above=0.002).step(Hold(STEP))
    assert np.isnan(result.report.figures["grip_margin.box.floor"])
    assert result.report.active_limits == ()


def test_a_scene_without_a_least_margin_has_nothing_of_it_and_one_without_friction_is_refused(scene_of):
    simulation = block(scene_of, 0.5, least=None)
    assert simulation.figure_names == () and "grip_margin" not in {one.name for one in simulation.parts}
    assert simulation.step(Hold(STEP)).report.figures == {}
    with pytest.raises(SceneError, match=r"between\[0\].least_grip_margin = 0.2.*no friction"):
        block(scene_of, 0.5, friction=0.0)


def grasper():
    """The Grasper, and a hand that pulls at its cube by a spring."""
    entries = yaml.safe_load(SCENE_FILE.read_text())
    entries["bodies"][0]["mesh"]["file"] = str(SCENE_FILE.parents[2] / "meshes/grasper_finger_158.vtk")
    entries["contact"]["between"][0]["least_grip_margin"] = LEAST
    entries["rigid_bodies"].append({"name": "hand", "motion": "guided", "speed": 1.0,
                                    "position": [0, 0, -0.3], "sphere": {"radius": 0.005}})
    entries["springs"] = [{"name": "pull", "stiffness": PULL, "ends": [
        {"on": "cube", "point": [0, 0, -0.104]}, {"on": "hand", "point": [0, 0, -0.3]}]}]
    return Simulation(scene_from_mapping(entries, SCENE_FILE))


def fingertips(simulation):
    """Nodes of each finger that press on the cube, by the names of the pair."""
    contacts, nodes = simulation.model.contacts, {}
    cube = next(part for part in simulation.model.rigid if part.name == "cube").first_node
    for place in np.flatnonzero(contacts.memory.forces[:, 0] > 1e-3):
        pair = contacts.pair_names[contacts.pair[place]]
        found = contacts.nodes[place][contacts.coefficients[place] != 0.0]
        nodes.setdefault(".".join(pair), set()).update(found[(found >= 0) & (found < cube)])
    return {name: sorted(found) for name, found in nodes.items()}


@pytest.mark.exhaustive
def test_the_margin_of_each_finger_is_told_before_its_tip_slips_by_a_tenth_of_a_millimetre():
    simulation = grasper()
    closed = simulation.rest_setpoints - 0.022
    for _ in range(200):
        simulation.step(CommandSetpoints(closed, STEP))
    lift = [0.0, 0.0, 0.02]
    simulation.model.guides.aim("palm", lift)
    simulation.model.guides.aim("hand", np.add(lift, [0.0, 0.0, -0.3]))
    for _ in range(120):
        result = simulation.step(CommandSetpoints(closed, STEP))
    cube = simulation.rigid_names.index("cube")

    def of_cube(nodes):
        places, turns = simulation.rigid_poses()
        turn = Rotation.from_quat(turns[cube])
        return turn.inv().apply(simulation.state.positions[nodes] - places[cube])

    assert min(result.report.figures.values()) > 1.2 * LEAST
    assert result.report.active_limits == ()
    tips = fingertips(simulation)
    assert sorted(tips) == ["finger_0.cube", "finger_1.cube", "finger_2.cube"]
    held, told, slipped = {name: of_cube(nodes) for name, nodes in tips.items()}, set(), {}
    for k in range(120):
        simulation.model.guides.aim("hand", [0.0, 0.0, -0.28 - SPEED * STEP * k])
        result = simulation.step(CommandSetpoints(closed, STEP))
        told |= {limit.removesuffix(".grip_margin") for limit in result.report.active_limits}
        for name, nodes in tips.items():
            slip = np.linalg.norm(of_cube(nodes) - held[name], axis=1).min()
            if slip > 1e-4 and name not in slipped:
                slipped[name] = k
                assert name in told
    assert len(slipped) == 3 and max(slipped.values()) > 10
