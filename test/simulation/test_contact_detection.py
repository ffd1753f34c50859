"""Detection by the driver finds, to the bit, what detection in Python finds from nothing."""

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.simulation import Hold
from test.builder import builder
from test.scene_changes import repeat_step

MATERIAL = {"young_modulus": 1.0e5, "poisson_ratio": 0.3, "density": 1000.0}
STEP, REACH = 0.002, 0.004
FOUND = ("nodes", "coefficients", "directions", "positions", "pair", "_gaps", "_anchors", "_begins")


@builder
def scene(scene_of, write_block, /):
    """Makes a block above a floor, a thin plate, a guided paddle, a free cube and a ball."""
    file = write_block((0.04, 0.04, 0.02), (4, 4, 2))
    others = ("floor", "plate", "paddle", "cube", "ball")
    return scene_of(
        integration="dynamic", gravity=[0, 0, 0],
        body={"name": "soft", "mesh": {"file": file}, "element": "linear",
              "material": MATERIAL},
        rigid_bodies=[
            {"name": "paddle", "motion": "guided", "box": {"size": [0.03, 0.03, 0.004]},
             "position": [0.0, 0.0, 0.03]},
            {"name": "cube", "mass": 0.02, "box": {"size": [0.01, 0.01, 0.01]},
             "position": [0.03, 0.0, 0.0]},
        ],
        obstacles=[
            {"name": "floor", "plane": {}, "position": [0, 0, -0.016]},
            {"name": "plate", "box": {"size": [0.0002, 0.1, 0.1]}, "position": [-0.03, 0, 0]},
            {"name": "ball", "sphere": {"radius": 0.01}, "position": [0, 0.035, 0]},
        ],
        contact={"alarm_distance": REACH, "friction": 0.5, "between": [
            *({"pair": ["soft", other], "friction": 0.5 * (other != "plate")}
              for other in others), {"pair": ["cube", "floor"]},
        ]},
    )  # fmt: skip


def found_at(simulation, x):
    """All that detection writes at node positions."""
    contacts = simulation.model.contacts
    contacts.detect(x)
    found = {name: getattr(contacts, name)[: contacts.count].copy() for name in FOUND}
    return found | {
        "known": contacts.memory.known, "starts": contacts.row_starts.copy(),
        "rows": contacts.entry_rows.copy(), "unknowns": contacts.entry_nodes.copy(),
        "overlaps": contacts.deepest_overlaps(x),
    }  # fmt: skip


class Twins:
    """A scene whose detection is driven, and one whose detection runs in Python."""

    def __init__(self, make):
        self.driven, self.plain = make(), make()
        contacts = self.plain.model.contacts
        contacts.stages.is_traceable = False
        contacts.stages.begin_anew()
        self.x = self.driven.model.nodes.rest_positions.copy()
        self.most = self.ran = 0

    def begin(self, velocities):
        for simulation in (self.driven, self.plain):
            simulation.model.contacts.begin_step(self.x, velocities, STEP)

    def compare(self, x=None):
        """Detect twice where the bodies are, by the same array each time or by another one."""
        x = self.x if x is None else x
        for _ in range(3):
            self.ran += self.driven.model.contacts.stages.are_known
            driven, plain = found_at(self.driven, x), found_at(self.plain, x.copy())
            for name, values in driven.items():
                np.testing.assert_array_equal(values, plain[name], err_msg=name)
        self.most = max(self.most, len(driven["pair"]))
        return driven["pair"]


def test_random_motion_finds_the_same_to_the_bit(scene, drawn_rng):
    twins = Twins(scene)
    nodes = twins.driven.model.nodes
    soft = np.arange(len(twins.driven.model.bodies[0].mesh.node_positions))
    rest, guides = nodes.rest_positions, twins.driven.model.guides
    touched = set()
    for trial in range(120):
        velocities = 0.2 * drawn_rng.normal(size=(nodes.free_node_count, 3))
        twins.begin(velocities * (trial % 3 > 0))
        if trial % 10 == 0:
            # After arrays from outside the driver would wait for long.
            twins.driven.model.contacts.stages.begin_anew()
            twins.compare()
            # The body jumps, turned anyhow: near the obstacles, inside of them, or far away.
            turn = Rotation.from_rotvec(drawn_rng.normal(size=3)).as_matrix()
            twins.x[soft] = rest[soft] @ turn.T + drawn_rng.uniform(-0.03, 0.03, 3)
        elif trial % 10 == 5:
            # It goes away, and comes back to the bit.
            before, kept = twins.compare(), twins.x.copy()
            twins.x[soft] += 10.0
            assert 0 not in twins.compare()
            twins.x[:] = kept
            np.testing.assert_array_equal(twins.compare(), before)
        elif trial % 10 == 7:
            # The paddle is elsewhere.
            origin, turn = drawn_rng.uniform(-0.04, 0.04, 3), Rotation.random(rng=drawn_rng).as_matrix()
            guides.frames.place(twins.x, 0, origin, turn)
            # The cube stands on the floor.
            guides.frames.place(twins.x, 1, [0.03, *drawn_rng.uniform(-0.01, 0.01, 2)], np.eye(3))
        else:
            nodes.advance(twins.x, velocities, STEP)
        touched |= set(twins.compare().tolist())
        if trial % 10 == 3:
            # A state from outside comes in an array of its own.
            twins.compare(twins.x + 1e-4)
    assert touched == set(range(6)), touched
    assert twins.ran > 100


def test_more_contacts_than_there_is_room_for_are_found(scene):
    twins = Twins(scene)
    soft = slice(len(twins.driven.model.bodies[0].mesh.node_positions))
    twins.begin(np.zeros((0, 3)))
    for height in (0.0, -0.008, -0.03, 0.0, -0.03, -0.06, 0.0):
        twins.x[soft, 2] = twins.driven.model.nodes.rest_positions[soft, 2] + height
        twins.compare()
    assert twins.most > 64


def test_a_thin_plate_is_not_passed_in_one_step(scene):
    twins = Twins(scene)
    soft = slice(len(twins.driven.model.bodies[0].mesh.node_positions))
    for _ in range(6):
        twins.begin(np.zeros((0, 3)))
        twins.compare()
    fast = np.zeros((twins.driven.model.nodes.free_node_count, 3))
    fast[:, 0] = -20.0
    twins.begin(fast)
    twins.x[soft, 0] += STEP * -20.0 / 8.0
    assert 1 in twins.compare()


def test_a_restored_state_and_a_reset_begin_anew(scene):
    simulation, other = scene(), scene()
    result = repeat_step(simulation, Hold(STEP), 8)
    contacts = simulation.model.contacts
    assert contacts.stages.are_known
    kept = result.state
    simulation.reset()
    for changed, state in ((simulation, kept), (other, kept)):
        changed.restore(state)
    for _ in range(4):
        one, another = simulation.step(Hold(STEP)), other.step(Hold(STEP))
        np.testing.assert_array_equal(one.state.positions, another.state.positions)
