"""Facts of cables that stretch."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, FollowTargets, Hold, Status

from .test_cable_friction import pull
from test.scene_changes import solved


def stretching(stiffness=2000.0, iterations=40, **more):
    def change(mapping):
        for cable in mapping["cables"]:
            cable.update(axial_stiffness=stiffness, shortening=[0.0, 0.05], rate=None, **more)
        mapping["solver"] = {"newton_iterations": iterations, "residual_tolerance": 1e-9}

    return change


def path_lengths(simulation):
    return np.array([
        np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        for path in simulation.actuator_paths().values()
    ])  # fmt: skip


def unstretched(simulation, stiffness):
    """Lengths that the tensions leave of the paths, by Hooke's law [m]."""
    return path_lengths(simulation) / (1.0 + simulation.state.efforts / stiffness)


def test_a_cable_and_springs_share_the_shortening_as_springs_in_series(simulate):
    """A box on four springs k, pulled by a cable: δ = λ / 4k + λ L / (EA + λ)."""
    k, stiffness, delta = 100.0, 60.0, 0.02
    corners = [[x, y] for x in (-0.02, 0.02) for y in (-0.01, 0.01)]
    scene = simulate(
        gravity=[0.0, 0.0, 0.0],
        rigid_bodies=[{"name": "box", "box": {"size": [0.04, 0.02, 0.01]}, "mass": 0.1}],
        springs=[{
            "name": f"s{i}", "stiffness": k, "damping": 3.0,
            "ends": [{"on": "box", "point": [x, y, 0.005]}, {"point": [x, y, 0.105]}],
        } for i, (x, y) in enumerate(corners)],
        cables=[{"name": "c", "body": "box", "pull_point": [0, 0, -0.105],
                 "points": [[0, 0, -0.005]], "axial_stiffness": stiffness}],
        integration="dynamic", solver={"newton_iterations": 20, "residual_tolerance": 1e-10},
    )  # fmt: skip
    for _ in range(100):
        result = pull(scene, delta)
    assert result.status is Status.OK
    (tension,) = result.efforts
    moved = tension / (4.0 * k)
    assert -scene.state.positions[0, 2] == pytest.approx(moved, rel=1e-6)
    assert delta == pytest.approx(moved + tension * (0.1 - moved) / (stiffness + tension), rel=1e-6)
    # As springs in series, up to the change of the path's length.
    assert tension == pytest.approx(delta / (1.0 / (4.0 * k) + 0.1 / stiffness), rel=0.15)


def test_an_elastic_cable_bends_the_body_as_a_stiff_one_at_the_length_of_its_path(beam):
    stiffness = 500.0
    elastic, stiff = beam(stretching(stiffness)), beam(stretching(None))
    result = pull(elastic, 0.012, 0.01, 0.0, 0.0)
    assert result.status is Status.OK
    taut = result.efforts > 0.0
    assert taut.sum() == 2 and result.efforts.max() > 0.01 * stiffness
    np.testing.assert_allclose(
        unstretched(elastic, stiffness)[taut], result.setpoints[taut], rtol=0, atol=1e-9
    )
    same = stiff.step(CommandSetpoints(path_lengths(elastic), 0.1))
    np.testing.assert_allclose(same.efforts, result.efforts, atol=1e-5 * result.efforts.max())
    np.testing.assert_allclose(stiff.state.positions, elastic.state.positions, atol=1e-8)


def test_the_inverse_reaches_its_target_and_says_the_unstretched_lengths(beam):
    stiffness = 300.0
    simulation = beam(stretching(stiffness, 5))
    goal = beam(stretching(None))
    pull(goal, 0.008, 0.004, 0.0, 0.0)
    target = goal.effector_positions()
    result = solved(simulation, FollowTargets(target, 0.1), 40)
    reachable = simulation.effector_positions()
    taut = result.efforts > 1e-3
    assert taut.any() and np.linalg.norm(reachable - target) < 1e-4
    np.testing.assert_allclose(
        result.setpoints[taut], unstretched(simulation, stiffness)[taut], atol=1e-8
    )
    other = beam(stretching(stiffness))
    other.step(CommandSetpoints(result.setpoints, 0.1))
    np.testing.assert_allclose(other.effector_positions(), reachable, atol=1e-6)


def test_commanded_tensions_say_the_unstretched_lengths(beam):
    stiffness, tensions = 200.0, np.array([3.0, 1.0, 0.0, 0.0])
    simulation = beam(stretching(stiffness))
    result = solved(simulation, CommandEfforts(tensions, 0.1), 3)
    np.testing.assert_allclose(result.efforts, tensions, atol=1e-8)
    np.testing.assert_allclose(
        result.setpoints[:2], unstretched(simulation, stiffness)[:2], atol=1e-8
    )


def test_an_elastic_cable_goes_slack_and_taut_without_chatter(beam):
    """Ramps through zero tension: never below zero, the same tensions up and down."""
    simulation = beam(stretching(400.0))
    ramp = np.concatenate([np.linspace(-0.002, 0.006, 17), np.linspace(0.006, -0.002, 17)])
    tensions = []
    for shortening in ramp:
        tensions.append(pull(simulation, max(shortening, 0.0), 0.0, 0.004, 0.0).efforts)
        assert simulation.state.efforts.min() >= 0.0
    tensions = np.array(tensions)
    np.testing.assert_allclose(tensions[:17], tensions[17:][::-1], atol=1e-6)
    assert (np.diff(tensions[:17, 0]) >= -1e-9).all()
    assert tensions[0, 0] == 0.0 < tensions[16, 0]


@pytest.mark.parametrize("wound", [[16.3, 18.3, 12.1, 14.6], [17.1, 0.7, 14.6, 3.5]])
def test_where_held_elastic_cables_stabilise_the_body_newton_converges(diamond, wound):
    """The plain tangent is indefinite there; see the same test of cables that do not stretch."""
    stiffness = 2000.0

    def finer(mapping):
        mapping["body"]["mesh"]["file"] = "../../meshes/diamond_1600.vtk"
        mapping.setdefault("solver", {})["newton_iterations"] = 1
        for cable in mapping["cables"]:
            cable["axial_stiffness"] = stiffness

    simulation = diamond(finer)
    for share in (*np.arange(1, 13) / 12, *[1.0] * 14):
        shortening = share * 1e-3 * np.array(wound)
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - shortening, 0.5))
    assert simulation.newton.tangent.is_augmented and not result.report.projected_tangent
    assert result.report.residual < 1e-8
    taut = result.efforts > 0.0
    np.testing.assert_allclose(
        unstretched(simulation, stiffness)[taut], result.setpoints[taut], rtol=0, atol=1e-9
    )


def test_restored_states_go_on_as_they_did(beam):
    simulation = beam(stretching(300.0, 3))
    pull(simulation, 0.006, 0.0, 0.0, 0.0)
    state = simulation.state
    first = pull(simulation, 0.01, 0.002, 0.0, 0.0)
    simulation.restore(state)
    second = pull(simulation, 0.01, 0.002, 0.0, 0.0)
    np.testing.assert_array_equal(first.state.positions, second.state.positions)
    np.testing.assert_array_equal(first.efforts, second.efforts)


def test_cables_with_and_without_stretch_are_mixed(beam):
    simulation = beam(stretching(None), {"cables.1.axial_stiffness": 400.0})
    result = pull(simulation, 0.004, 0.006, 0.0, 0.0)
    paths = path_lengths(simulation)
    assert result.setpoints[0] == pytest.approx(paths[0], abs=1e-9)
    assert result.setpoints[1] == pytest.approx(paths[1] / (1 + result.efforts[1] / 400.0), abs=1e-9)
    assert result.efforts.min() >= 0.0 < result.efforts[1]


def test_holding_an_elastic_cable_keeps_its_tension(beam):
    simulation = beam(stretching(300.0))
    before = pull(simulation, 0.008, 0.0, 0.0, 0.0)
    after = simulation.step(Hold(0.1))
    np.testing.assert_allclose(after.efforts, before.efforts, atol=1e-7)
    np.testing.assert_array_equal(after.setpoints, before.setpoints)
