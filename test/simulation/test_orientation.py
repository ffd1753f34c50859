"""Facts of effectors with orientation in whole scenes: a beam on cables, the Fetch, the Trunk."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import CommandError
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.schema import EffectorOrientation
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from softrobot_twin.simulation.result import RATE
from test.builder import builder
from test.scene_changes import change_scene, repeat_step

FETCH = Path(__file__).resolve().parents[2] / "config/scenes/fetch_reduced.yaml"
TIP_PATCH = [[0.004, 0, 0.195], [0, 0.004, 0.195], [-0.004, 0, 0.195], [0, -0.004, 0.195]]
CORNERS = [[0.002, 0.002, 0.1], [0.018, 0.002, 0.1], [0.018, 0.018, 0.1], [0.002, 0.018, 0.1]]
PLATE = {"name": "plate", "mass": 0.01, "box": {"size": [0.03, 0.03, 0.004]},
         "position": [0.01, 0.01, 0.102], "rotation": [0.3, 0.2, -0.5]}  # fmt: skip
TOP = {"minimum": [-1, -1, 0.0999], "maximum": [1, 1, 1]}
STEP = 0.1


@builder
def posed(beam, /, directions=None, on_plate=False, change=None, **orientation):
    """Makes the beam whose tip has an orientation: of a patch of it, or of a plate on top of it."""

    def asks(mapping):
        effector = mapping["effectors"][0]
        if directions is not None:
            effector["directions"] = directions
        if on_plate:
            mapping["rigid_bodies"] = [PLATE]
            mapping["body"]["attached"] = [{"to": "plate", "box": TOP}]
            effector["body"] = "plate"
            for cable in mapping["cables"]:
                cable["body"] = "beam"
        else:
            orientation.setdefault("points", CORNERS)
        effector["orientation"] = orientation
        change_scene(mapping, change)

    return beam(asks)


def quaternion(*degrees):
    return Rotation.from_rotvec(np.radians(degrees)).as_quat()[None]


def led(simulation, turn, shift=(0.0, 0.0, 0.0), steps=30):
    """The last step towards a turn from rest and a place beside that at rest."""
    targets = simulation.model.effectors.positions(simulation.model.nodes.rest_positions) + shift
    return repeat_step(simulation, FollowTargets(targets, STEP, None, turn), steps)


def angle_between(result, turn):
    made = Rotation.from_quat(result.effector_orientations[0])
    return np.degrees((made.inv() * Rotation.from_quat(turn[0])).magnitude())


@pytest.mark.parametrize("on_plate", [False, True], ids=["patch", "frame"])
def test_a_tip_is_tilted_to_an_orientation(posed, on_plate):
    simulation = posed((), on_plate)
    turn = quaternion(20.0, -15.0, 0.0)
    result = led(simulation, turn)
    reference = led(simulation, turn, steps=10)
    assert result.status.is_success or result.orientation_errors[0] < 0.06
    assert np.isnan(result.effector_errors).all()
    # Torsion, which the cables do not make, is all that is left.
    assert angle_between(result, turn) == pytest.approx(
        np.degrees(result.orientation_errors[0]), abs=1e-6
    )
    made = Rotation.from_quat(result.effector_orientations[0]).apply([0, 0, 1.0])
    wanted = Rotation.from_quat(turn[0]).apply([0, 0, 1.0])
    assert np.degrees(np.arccos(made @ wanted)) < 0.5
    assert reference.orientation_errors[0] == pytest.approx(result.orientation_errors[0], abs=1e-4)


def test_the_orientation_on_a_rigid_body_is_its_turn_from_rest(posed):
    simulation = posed((), on_plate=True)
    rest = Rotation.from_quat(simulation.rigid_poses()[1][0])
    assert angle_between(simulation.step(Hold()), quaternion(0.0, 0.0, 0.0)) < 1e-9
    result = led(simulation, quaternion(15.0, 0.0, 0.0), steps=10)
    body = Rotation.from_quat(simulation.rigid_poses()[1][0])
    made = Rotation.from_quat(result.effector_orientations[0])
    assert (made.inv() * body * rest.inv()).magnitude() < 1e-9


def test_an_axis_points_along_a_direction_whatever_the_turn_about_it(posed):
    simulation = posed((), pointing=[0.0, 0.0, 2.0])
    spin = Rotation.from_rotvec([0.0, 0.0, 2.0])
    turn = (Rotation.from_quat(quaternion(25.0, 10.0, 0.0)) * spin).as_quat()
    result = led(simulation, turn)
    assert result.status is Status.OK
    wanted = Rotation.from_quat(turn[0]).apply([0.0, 0.0, 1.0])
    made = Rotation.from_quat(result.effector_orientations[0]).apply([0.0, 0.0, 1.0])
    assert np.degrees(np.arccos(min(1.0, wanted @ made))) < 0.06


def test_an_unreachable_orientation_ends_at_the_nearest_with_a_status(posed):
    simulation = posed(())
    result = led(simulation, quaternion(0.0, 0.0, 30.0), steps=40)
    assert result.status in (Status.SATURATED, Status.UNREACHABLE)
    left = result.orientation_errors[0]
    assert np.radians(20.0) < left <= np.radians(30.0) + 1e-6
    wanted, state = quaternion(0.0, 0.0, 30.0), result.state
    assert led(simulation, wanted, steps=10).orientation_errors[0] == pytest.approx(left, abs=1e-4)
    # No cable that is pulled further or let go brings it nearer.
    for cable in range(4):
        for change in (-5e-4, 5e-4):
            simulation.restore(state)
            lengths = state.setpoints.copy()
            lengths[cable] = min(lengths[cable] + change, simulation.rest_setpoints[cable])
            moved = repeat_step(simulation, CommandSetpoints(lengths, STEP), 8)
            assert np.radians(angle_between(moved, wanted)) > left - 2e-4


def test_weights_trade_position_against_orientation(posed):
    angles, distances = [], []
    for weight in (0.01, 1.0, 100.0):
        result = led(posed(pointing=[0, 0, 1], weight=weight), quaternion(25.0, 0.0, 0.0))
        angles.append(result.orientation_errors[0])
        distances.append(result.effector_errors[0])
    assert angles[0] > 1.05 * angles[1] and angles[1] > 1.05 * angles[2]
    assert distances[0] < distances[1] < distances[2]


def test_a_longer_length_per_radian_weighs_the_orientation_more(posed):
    near, far = (
        led(posed(pointing=[0, 0, 1], length_per_radian=length), quaternion(25.0, 0.0, 0.0))
        for length in (0.01, 1.0)
    )
    assert far.orientation_errors[0] < near.orientation_errors[0]
    assert far.effector_errors[0] > near.effector_errors[0]


def test_a_jump_of_the_wanted_orientation_is_limited_by_the_rates(posed):
    simulation = posed((), pointing=[0, 0, 1])
    led(simulation, quaternion(0.0, 0.0, 0.0), steps=3)
    before, targets = simulation.state.setpoints, simulation.effector_positions()
    turn, short = quaternion(25.0, 0.0, 0.0), 1.0e-3
    result = simulation.step(FollowTargets(targets, short, None, turn))
    assert result.status is Status.RATE_LIMITED
    assert any(limit.endswith(RATE) for limit in result.report.active_limits)
    assert (np.abs(result.setpoints - before) <= short * 0.05 * (1.0 + 1e-9)).all()
    assert led(simulation, turn).status is Status.OK


def test_a_target_that_turns_is_followed_without_a_growing_error(posed):
    simulation = posed((), pointing=[0, 0, 1])
    targets, errors = simulation.effector_positions(), []
    for step in range(120):
        about = np.array([np.cos(0.2 * step), np.sin(0.2 * step), 0.0])
        turn = Rotation.from_rotvec(np.radians(15.0) * about).as_quat()[None]
        errors.append(simulation.step(FollowTargets(targets, STEP, None, turn)).orientation_errors)
    first, last = np.max(errors[30:60]), np.max(errors[90:])
    assert last < 1.1 * first + 1e-6
    assert np.degrees(last) < 1.0


def test_without_a_wanted_orientation_the_position_alone_is_followed(posed, beam):
    shift = (0.004, 0.002, -0.002)
    made, reference = led(posed(), None, shift), led(beam(), None, shift)
    assert made.status is reference.status
    assert np.isnan(made.orientation_errors).all()
    np.testing.assert_allclose(made.effector_positions, reference.effector_positions, atol=1e-6)


@pytest.mark.parametrize("wrong", [np.zeros((1, 4)), np.array([[0, 0, np.inf, 1.0]]), np.ones(4)])
def test_a_quaternion_that_is_no_rotation_is_refused_and_moves_nothing(posed, wrong):
    simulation = posed()
    with pytest.raises(CommandError, match="orientations"):
        led(simulation, wrong, steps=1)
    assert simulation.state.step_count == 0


@pytest.mark.exhaustive
def test_a_vertebra_of_the_fetch_is_tilted_and_held_in_place():
    scene = load_scene(FETCH)
    cavities = tuple(
        cavity.model_copy(update={"pressure": (-5.0e3, 20.0e3)}) for cavity in scene.cavities
    )
    tip = scene.effectors[0].model_copy(update={"orientation": EffectorOrientation()})
    simulation = Simulation(scene.model_copy(update={"cavities": cavities, "effectors": (tip,)}))
    result = led(simulation, quaternion(8.0, -5.0, 0.0), steps=80)
    assert result.status is Status.OK
    assert np.degrees(result.orientation_errors[0]) < 0.09
    assert result.effector_errors[0] < 2e-4


@pytest.mark.exhaustive
def test_the_tip_of_a_trunk_points_aside_within_a_hundredth_of_a_degree(coarse_trunk):
    entry = {"pointing": [0.0, 0.0, 1.0], "points": TIP_PATCH}
    simulation = coarse_trunk(lambda mapping: mapping["effectors"][0].update(orientation=entry))
    result = led(simulation, quaternion(0.0, 40.0, 0.0), (0.03, 0.0, -0.01), steps=60)
    assert result.status.is_success
    assert np.degrees(result.orientation_errors[0]) < 0.01
    assert result.effector_errors[0] < 1e-4
