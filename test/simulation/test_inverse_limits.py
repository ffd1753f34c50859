"""Limits in the inverse problem beside an obstacle: kept, reported, and without drift."""

import copy
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.simulation import CommandEfforts, FollowTargets, Hold, Simulation, Status
from softrobot_twin.simulation.result import RATE
from test.builder import builder
from test.scene_changes import built, entries_of, repeat_step

TRUNK_FILE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "trunk.yaml"
TRUNK = entries_of(TRUNK_FILE, {"body.element": "linear"})


@builder
def trunk(with_rod=False, change=None) -> Simulation:
    """Makes the coarse Trunk without its slide, optionally with a rod beside it."""
    mapping = copy.deepcopy(TRUNK)
    mapping["body"]["mesh"]["file"] = "../../meshes/trunk_700.vtk"
    mapping.pop("slides", None)
    if with_rod:
        ends = [[-0.1, 0.03, 0.15], [0.1, 0.03, 0.15]]
        mapping["obstacles"] = [{"name": "rod", "cylinder": {"ends": ends, "radius": 0.008}}]
        mapping["contact"] = {"between": [{"pair": ["trunk", "rod"]}]}
    return built(mapping, change, path=TRUNK_FILE)


def follow(simulation, target, steps, time_step=0.02):
    return repeat_step(simulation, FollowTargets(np.atleast_2d(target), time_step), steps)


@pytest.mark.exhaustive
@pytest.mark.parametrize("way", [[0.9, 0.0, -0.4], [0.0, 0.5, 0.8], [-0.6, 0.6, 0.0]])
def test_a_target_ten_times_out_of_reach_is_held_without_drift_beside_a_rod(beam, rod, way):
    """Row 16."""
    simulation = beam(lambda m: rod(m))
    target = simulation.effector_positions()[0] + way
    result = follow(simulation, target, 300)
    there, lengths = result.effector_positions, result.setpoints
    assert result.status in (Status.SATURATED, Status.UNREACHABLE)
    result = follow(simulation, target, 1000)
    assert np.abs(result.effector_positions - there).max() < 1e-6
    assert np.abs(result.setpoints - lengths).max() < 1e-6


def test_a_jump_of_the_target_obeys_the_rates_beside_a_rod_and_keeps_its_direction(beam, rod):
    """Row 17: 100 mm in one message."""
    simulation = beam(lambda m: rod(m))
    start = follow(simulation, simulation.effector_positions()[0] + [0.0, 0.0, -0.004], 40)
    jump = np.array([0.06, 0.08, 0.0])
    target, before = start.effector_positions[0] + jump, start.setpoints
    for _ in range(4):
        result = follow(simulation, target, 1, 0.01)
        assert np.all(np.abs(result.setpoints - before) <= 0.05 * 0.01 + 1e-12)
        assert any(name.endswith(RATE) for name in result.report.active_limits)
        assert not result.status.is_failure
        before = result.setpoints
    moved = (result.effector_positions - start.effector_positions)[0]
    assert moved @ jump / np.linalg.norm(moved) / np.linalg.norm(jump) > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_limits_hold_for_any_targets_beside_a_rod(beam, rod, seed):
    rng = np.random.default_rng(seed)
    simulation = beam(lambda m: rod(m))
    limits, before = simulation.limits, simulation.state.setpoints
    for _ in range(80):
        reach = rng.choice([0.005, 0.05, 5.0])
        target = simulation.effector_positions() + reach * rng.standard_normal((1, 3))
        time_step = rng.choice([0.005, 0.02])
        result = simulation.step(FollowTargets(target, time_step))
        assert np.all(np.abs(result.setpoints - before) <= limits.rate * time_step + 1e-9)
        assert np.all(result.displacements >= limits.displacement_min - 1e-9)
        assert np.all(result.displacements <= limits.displacement_max + 1e-9)
        assert np.all((result.efforts >= 0.0) & (result.efforts <= limits.effort_max + 1e-9))
        assert not result.status.is_failure
        before = result.setpoints


def long_cables(simulation, tension):
    tensions = np.zeros(len(simulation.actuator_names))
    tensions[:4] = tension
    return CommandEfforts(tensions, 10.0)


def free_of_gravity(mapping):
    mapping["gravity"] = [0.0, 0.0, 0.0]
    mapping["solver"] = {"newton_iterations": 30, "residual_tolerance": 1e-7}


def axial_compliance(mesh, young_modulus, first, last) -> float:
    """∫ dz / (E A(z)) [m/N]; the section's area A by points spread evenly over all tetrahedra."""
    corners = mesh.node_positions[mesh.cells]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    weights = np.random.default_rng(0).dirichlet(np.ones(4), 200)
    heights = np.einsum("gk,tk->gt", weights, corners[:, :, 2])
    slices, edges = np.histogram(
        heights, bins=160, range=(first, last), weights=np.tile(volumes / 200, (200, 1))
    )
    thickness = np.diff(edges)
    return float(np.sum(thickness * thickness / (young_modulus * slices)))


def test_equal_tension_of_all_long_cables_shortens_the_trunk_as_in_theory(trunk):
    """Row 25: four forces along the axis, F L / (E A) from the platform to the last disk.

    The stiffness of the tubes is neglected; sections that bulge about the disks yield a little
    more.
    """
    simulation = trunk(change=lambda m: (free_of_gravity(m), m.pop("tubes")))
    body = simulation.model.bodies[0]
    compliance = axial_compliance(body.mesh, 450e3, 0.0201, 0.184)
    home = simulation.effector_positions()[0]
    for _ in range(5):
        result = simulation.step(long_cables(simulation, 0.05))
    moved = result.effector_positions[0] - home
    print(f"shortening by force {-moved[2] / 0.2:.3e} m/N, theory {compliance:.3e} m/N")
    assert np.linalg.norm(moved[:2]) < 0.05 * abs(moved[2])
    assert -moved[2] / 0.2 == pytest.approx(compliance, rel=0.06)


def test_large_equal_tension_of_all_long_cables_gives_finite_answers(trunk):
    simulation = trunk(change=free_of_gravity)
    for tension in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0):
        for _ in range(4):
            result = simulation.step(long_cables(simulation, tension))
            assert np.all(np.isfinite(result.state.positions))
            assert np.all(np.isfinite(result.setpoints)) and np.all(np.isfinite(result.efforts))
    for _ in range(60):
        result = simulation.step(long_cables(simulation, 0.0))
    assert result.status is Status.OK
    np.testing.assert_allclose(
        result.state.positions, simulation.model.nodes.rest_positions, atol=1e-6
    )


@pytest.mark.exhaustive
@pytest.mark.parametrize("with_rod", [False, True])
def test_the_trunk_held_at_its_reach_for_a_thousand_steps_does_not_drift(trunk, with_rod):
    """Row 16, up and outwards; with the rod the trunk comes to rest on it."""
    simulation = trunk(with_rod)
    repeat_step(simulation, Hold(), 20)
    target = simulation.effector_positions()[0] + [0.0, 1.3, 0.6]
    result = follow(simulation, target, 400)
    there, lengths = result.effector_positions, result.setpoints
    result = follow(simulation, target, 1000)
    print(np.abs(result.effector_positions - there).max(), result.report.contact_count)
    assert (result.report.contact_count > 0) == with_rod
    assert result.status in (Status.SATURATED, Status.UNREACHABLE)
    assert np.abs(result.effector_positions - there).max() < 1e-4
    assert np.abs(result.setpoints - lengths).max() < 1e-4
