"""Rubber in commands that are far too much for one step: upright in every state, and told truly."""

import numpy as np
import pytest

from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.rotation import quaternion_from_rotation, rotation_from_vector
from softrobot_twin.simulation import CommandEfforts, Hold, Status
from test.builder import builder

SIDE = 0.04
TOP = np.array([SIDE / 2, SIDE / 2, SIDE + 0.005])
SHEAR = 1e5 / 2.98
LAWS = {
    "neo_hookean": {"young_modulus": 1e5},
    "ogden": {"constants": {"shear_moduli": [0.8 * SHEAR, 0.1 * SHEAR], "exponents": [1.75, 6.0]}},
}
HALF_TURN = quaternion_from_rotation(rotation_from_vector(np.array([0.0, 0.0, 0.9999 * np.pi])))
COMMANDS = {
    "crushed to 20 %": (TOP - [0.0, 0.0, 0.8 * SIDE], None),
    "stretched five times": (TOP + [0.0, 0.0, 4.0 * SIDE], None),
    "twisted by half a turn": (TOP, HALF_TURN),
    "moved aside": (TOP + [1.5 * SIDE, 0.0, -0.3 * SIDE], None),
}


@builder
def cube(simulate, body_of, block, /, law, element, integration="quasi_static", shake=0.0, **entries):
    """Makes a cube of rubber on the ground; a palm, that moves at any speed, holds its top."""
    body = body_of(
        block((SIDE, SIDE, SIDE), (2, 2, 2), shake), element=element,
        fixed=[{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}],
    )  # fmt: skip
    body["material"] = {"density": 1000.0, "law": law, "poisson_ratio": 0.49, **LAWS[law]}
    if integration == "dynamic":
        body["damping"] = {"mass": 5.0, "stiffness": 0.01}
    if "cables" not in entries:
        body["attached"] = [
            {"to": "palm", "box": {"minimum": [-1, -1, SIDE - 1e-6], "maximum": [1, 1, 1]}}
        ]
        entries["rigid_bodies"] = [
            {"name": "palm", "box": {"size": [SIDE, SIDE, 0.01]}, "motion": "guided",
             "speed": 1e3, "turn_rate": 1e3, "position": TOP.tolist()}
        ]  # fmt: skip
    return simulate(
        body=body, integration=integration, gravity=[0.0, 0.0, 0.0],
        solver={"newton_iterations": 30, "residual_tolerance": 1e-6}, **entries,
    )  # fmt: skip


def checked(simulation, command, steps):
    """Steps, and asserts of each state that it is upright and that its status is true."""
    (elements,) = [term for term in simulation.model.forces if type(term) is Elements]
    for _ in range(steps):
        result = simulation.step(command)
        positions = result.state.positions
        forces = np.zeros((simulation.model.nodes.free_node_count, 3))
        assert elements.add_forces(positions, forces) == 0
        assert np.isfinite(elements.energy(positions)) and np.isfinite(forces).all()
        assert result.status is not Status.INVERTED
        if result.status is Status.OK:
            assert result.report.residual < 1e-6
    return result


@pytest.mark.sampled
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("what", COMMANDS)
@pytest.mark.parametrize("law", LAWS)
def test_a_cube_stays_upright_in_one_command(what, law, element, integration, cube):
    simulation = cube(law, element, integration)
    simulation.model.guides.aim("palm", *COMMANDS[what])
    result = checked(simulation, Hold(0.05), 6)
    if integration == "quasi_static" and (element == "linear" or what == "moved aside"):
        assert result.status in (Status.OK, Status.SATURATED)
        place, _ = simulation.model.guides.pose("palm", result.state.positions)
        np.testing.assert_allclose(place, COMMANDS[what][0], atol=1e-9)


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_badly_shaped_mesh_is_crushed_without_folding(integration, cube):
    simulation = cube("neo_hookean", "linear", integration, shake=0.45)
    simulation.model.guides.aim("palm", TOP - [0.0, 0.0, 0.6 * SIDE])
    assert checked(simulation, Hold(0.05), 6).status in (Status.OK, Status.SATURATED)


@pytest.mark.sampled
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_cables_that_pull_ten_times_too_much_fold_nothing_and_can_be_let_go(element, integration, cube):
    cables = [
        {"name": f"cable_{k}", "pull_point": [x, y, -0.02], "points": [[x, y, SIDE]],
         "shortening": [0.0, 0.2], "tension": [0.0, 1e4]}
        for k, (x, y) in enumerate([(0.0, 0.0), (SIDE, 0.0), (0.0, SIDE), (SIDE, SIDE)])
    ]  # fmt: skip
    simulation = cube("neo_hookean", element, integration, cables=cables)
    checked(simulation, CommandEfforts(np.full(4, 400.0), 0.05), 6)
    result = checked(simulation, CommandEfforts(np.zeros(4), 0.05), 40)
    assert result.status is Status.OK
    moved = result.state.positions - simulation.model.nodes.rest_positions
    assert np.abs(moved).max() < 1e-3 * SIDE
