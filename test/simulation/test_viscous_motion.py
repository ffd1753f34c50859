"""Damping by the rate of strain in motion: rotation is not damped, and energy never grows."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.simulation import CommandEfforts, Hold, Simulation, Status
from test.builder import builder

TRUNK_FILE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "trunk.yaml"
TRUNK = written_out(read_yaml(TRUNK_FILE.read_text()))
TRUNK["body"]["element"] = "linear"
TENSION, END = 1.2, 0.1


@builder
def trunk(integration, beta=0.1, iterations=30) -> Simulation:
    """Makes the coarse Trunk, its base fixed, with one long cable and nothing else."""
    mapping = {"name": "trunk"}
    body = {key: TRUNK["body"][key] for key in ("name", "mesh", "element", "material")}
    body["mesh"] = {"file": "../../meshes/trunk_700.vtk"}
    base = {"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.0201]}}
    cable = copy.deepcopy(next(entry for entry in TRUNK["cables"] if entry["name"] == "L3"))
    del cable["pull_point_on"]
    mapping |= {
        "gravity": [0, 0, 0], "integration": integration, "cables": [cable],
        "effectors": [{"name": "tip", "points": TRUNK["effectors"][0]["points"]}],
        "body": {**body, "fixed": [base], "damping": {"stiffness": beta}},
        "solver": {"newton_iterations": iterations, "residual_tolerance": 1e-7},
    }  # fmt: skip
    return Simulation(scene_from_mapping(mapping, TRUNK_FILE))


def tip_after(simulation, step):
    """x of the tip after 100 ms of pulling [m]."""
    simulation.reset()
    for _ in range(round(END / step)):
        result = simulation.step(CommandEfforts(np.array([TENSION]), step))
        assert result.report.residual < 1e-7
    return result.effector_positions[0, 0]


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("integration", "error_at_10_ms"), [("dynamic", 0.035), ("first_order", 0.018)]
)
def test_the_error_of_a_damped_trunk_is_of_the_order_of_its_time_step(trunk, integration, error_at_10_ms):
    """Errors of the tip's displacement, against the extrapolation of the two finest runs:

        step [ms]                     10      5    2.5   1.25
        dynamic, β 0.1 s          -3.5 % -1.8 % -0.9 % -0.5 %
        first order, β 0.1 s      -1.8 % -0.9 % -0.5 % -0.2 %
        dynamic, undamped         +6.6 % +4.2 % +2.4 % +1.3 %

    Backward Euler alone is worse; a viscosity that resists rotation would err by 28 % at 10 ms.
    """
    simulation = trunk(integration)
    tips = np.array([tip_after(simulation, step) for step in (0.01, 0.005, 0.0025, 0.00125)])
    limit = 2.0 * tips[3] - tips[2]
    errors = 1.0 - tips / limit
    assert errors[0] == pytest.approx(error_at_10_ms, abs=0.002)
    # First order: half the step, half the error.
    np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, atol=0.1)


@pytest.mark.sampled
@pytest.mark.parametrize("step", [0.02, 0.05, 0.1, 0.3])
@pytest.mark.parametrize(
    ("integration", "beta"), [("dynamic", 0.1), ("dynamic", 0.0), ("first_order", 0.1)]
)
def test_one_linearization_of_a_large_step_does_not_stall_on_the_stretch_of_its_first_move(
    trunk, integration, beta, step
):
    """With one move in each, steps of 50 ms bring the tip 14.6 mm far where 24.8 are converged."""
    ways = []
    for iterations in (1, 30):
        simulation = trunk(integration, beta, iterations)
        start = simulation.effector_positions()[0, 0]
        for _ in range(max(1, round(END / step))):
            result = simulation.step(CommandEfforts(np.array([TENSION]), step))
        ways.append(result.effector_positions[0, 0] - start)
    assert ways[0] == pytest.approx(ways[1], rel=0.01)


def spinning(simulation, degrees, step, rng):
    """Strain a free body at random and let it spin by so much in a step."""
    rest = simulation.model.nodes.rest_positions
    x = (rest - rest.mean(axis=0)) * (1.0 + rng.uniform(-0.15, 0.15, 3))
    axis = rng.standard_normal(3)
    velocities = np.cross(np.radians(degrees) / step * axis / np.linalg.norm(axis), x)
    velocities += rng.uniform(0.0, 0.3) * rng.standard_normal(x.shape)
    simulation.restore(replace(simulation.state, positions=x, velocities=velocities))


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("degrees", [0.0, 10.0, 30.0, 60.0, 90.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_free_damped_body_never_gains_energy(simulate, body_of, block, energies, element, degrees, seed):
    """Neither does any step: in what is stored and what moves together, whatever it turns by."""
    rng = np.random.default_rng([seed, int(degrees)])
    step, beta = 10.0 ** rng.uniform(-3.0, -1.5), 10.0 ** rng.uniform(-3.0, 0.5)
    body = body_of(
        block(size=(0.04, 0.05, 0.08), cells=(1, 1, 2)), element=element, young_modulus=2e5,
        damping={"stiffness": beta},
    )  # fmt: skip
    scene = simulate(body=body, integration="dynamic", gravity=[0, 0, 0],
                     solver={"newton_iterations": 60, "residual_tolerance": 1e-8})  # fmt: skip
    viscous = next(term for term in scene.model.forces if term.name == "strain-rate damping")
    spinning(scene, degrees, step, rng)
    before = sum(energies(scene))
    for _ in range(10):
        result = scene.step(Hold(step))
        assert result.status in (Status.OK, Status.INVERTED), (result.status, step, beta)
        assert viscous.heat(result.state.positions) >= 0.0
        after = sum(energies(scene))
        assert after < before * (1.0 + 1e-9), (step, beta)
        before = after
