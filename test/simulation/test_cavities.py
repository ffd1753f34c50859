"""Cavities as actuators: pressure and volume, limits, work, walls that cannot be used."""

import itertools

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Status,
)
from test.scene_changes import LEFT_OUT, changed, repeat_step, solved

STEP = 0.02
SMALL = {"size": (0.02, 0.02, 0.06), "cells": (4, 4, 6), "hole": ((1, 3), (1, 3), (1, 5))}


def settled(simulation, command, steps=30):
    for _ in range(steps):
        result = simulation.step(command)
        if result.status is Status.OK and result.report.residual < 1e-8:
            break
    return result


def volume_of(simulation):
    return simulation.actuators.terms[0].volumes(simulation.state.positions)


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_a_volume_and_its_pressure_lead_to_the_same_state(inflatable, element):
    by_volume = inflatable(control="volume", body={"element": element})
    assert by_volume.rest_setpoints == pytest.approx(0.01 * 0.01 * 0.04)
    result = settled(by_volume, CommandSetpoints(1.3 * by_volume.rest_setpoints, STEP))
    assert result.status is Status.OK
    assert volume_of(by_volume) == pytest.approx(1.3 * by_volume.rest_setpoints, rel=1e-9)
    by_pressure = inflatable(body={"element": element})
    assert by_pressure.rest_setpoints == pytest.approx(0.0)
    again = settled(by_pressure, CommandSetpoints(result.efforts, STEP))
    assert again.status is Status.OK and again.setpoints == again.efforts == result.efforts
    np.testing.assert_allclose(again.state.positions, result.state.positions, atol=1e-9)
    np.testing.assert_allclose(again.displacements, result.displacements, rtol=1e-6)
    # Held, it stays.
    held = by_pressure.step(Hold(STEP))
    np.testing.assert_allclose(held.state.positions, again.state.positions, atol=1e-12)


def test_newton_converges_quadratically_under_pressure(inflatable):
    few = changed({"solver": {"newton_iterations": 1, "residual_tolerance": 1e-12}})
    simulation, residuals = inflatable(few), []
    for _ in range(7):
        residuals.append(simulation.step(CommandSetpoints([8e3], STEP)).report.residual)
    orders = [np.log(c / b) / np.log(b / a)
              for a, b, c in zip(residuals, residuals[1:], residuals[2:]) if 1e-12 < c < 1e-3]
    assert residuals[-1] < 1e-12 and max(orders) > 1.7, residuals


def test_work_of_the_pressure_is_the_energy_that_is_stored(inflatable, energies):
    simulation, work, before = inflatable(), 0.0, (0.0, 0.0)
    for pressure in np.linspace(0.0, 6e3, 25)[1:]:
        result = settled(simulation, CommandSetpoints([pressure], STEP))
        growth = float(result.displacements[0])
        work += 0.5 * (pressure + before[0]) * (growth - before[1])
        before = pressure, growth
    stored, _ = energies(simulation)
    assert stored == pytest.approx(work, rel=2e-3) and work > 1e-3


def test_a_cavity_may_have_vertices_that_are_no_nodes(inflatable, hollow):
    simulation = inflatable(body=SMALL)
    expected = settled(simulation, CommandSetpoints([3e3], STEP))
    _, finer = hollow(size=SMALL["size"], cells=(8, 8, 12), hole=((2, 6), (2, 6), (2, 10)),
                      name="finer")  # fmt: skip
    mapped = inflatable({"cavities.0.walls": [{"file": finer}]}, body=SMALL)
    assert not mapped.notes
    result = settled(mapped, CommandSetpoints([3e3], STEP))
    assert len(mapped.actuators.terms[0].surfaces[0].triangles) == 4 * len(
        simulation.actuators.terms[0].surfaces[0].triangles
    )
    # The mesh is linear and the finer vertices lie on its faces: it is the same polyhedron.
    np.testing.assert_allclose(result.state.positions, expected.state.positions, atol=1e-9)


def test_the_same_pascals_at_any_rate(inflatable):
    pressures = []
    for step, integration in itertools.product((1e-3, 0.1), ("quasi_static", "dynamic")):

        def timed(mapping, integration=integration):
            mapping["integration"] = integration
            mapping["body"]["damping"] = {"stiffness": 0.02}

        simulation = inflatable(
            timed if integration == "dynamic" else None, control="volume", body=SMALL
        )
        volume = 1.2 * simulation.rest_setpoints
        for _ in range(int(1.0 / step) if integration == "dynamic" else 3):
            result = simulation.step(CommandSetpoints(volume, step))
        pressures.append(float(result.efforts[0]))
    np.testing.assert_allclose(pressures, pressures[0], rtol=1e-4)


@pytest.mark.parametrize("control", ["pressure", "volume"])
def test_a_rate_limits_what_is_commanded(inflatable, control):
    rate = {"pressure": 5e4, "volume": 2e-5}[control]
    simulation = inflatable(control=control, rate=rate)
    goal = simulation.rest_setpoints + 3.4 * rate * STEP
    made = [simulation.step(CommandSetpoints(goal, STEP)) for _ in range(5)]
    moved = np.diff([simulation.rest_setpoints, *(result.setpoints for result in made)], axis=0)
    np.testing.assert_allclose(moved[:, 0] / (rate * STEP), [1, 1, 1, 0.4, 0], atol=1e-6)
    assert [result.status for result in made[:3]] == 3 * [Status.RATE_LIMITED]
    assert made[0].report.active_limits == ("air.rate",)
    assert made[-1].status is Status.OK


def test_a_flow_limits_how_fast_a_volume_follows_its_pressure(inflatable):
    flow = 2e-6
    simulation, grown = inflatable(flow=flow), [0.0]
    for _ in range(30):
        result = simulation.step(CommandSetpoints([6e3], STEP))
        grown.append(float(result.displacements[0]))
        if result.status is Status.OK:
            break
        assert result.status is Status.RATE_LIMITED
        assert result.report.active_limits == ("air.rate",)
    moved = np.diff(grown)
    np.testing.assert_allclose(moved[:-1], flow * STEP, rtol=1e-4)
    assert 0.0 < moved[-1] <= 1.0001 * flow * STEP and len(moved) > 10
    assert result.setpoints[0] == pytest.approx(6e3)


def test_limits_of_pressure_are_kept_and_named(inflatable):
    simulation = inflatable(pressure=[0.0, 2e3])
    result = settled(simulation, CommandSetpoints([5e3], STEP), 3)
    assert result.status is Status.SATURATED and result.efforts == pytest.approx(2e3)
    assert result.report.active_limits == ("air.pressure_max",)
    by_volume = inflatable(pressure=[0.0, 2e3], control="volume")
    result = settled(by_volume, CommandSetpoints(2.0 * by_volume.rest_setpoints, STEP), 3)
    assert result.efforts == pytest.approx(2e3) and "air.pressure_max" in result.report.active_limits


@pytest.mark.parametrize("limit", ["growth", "volume"])
def test_limits_of_volume_hold_a_pressure_back_and_are_named(inflatable, limit):
    rest = 4e-6
    bounds = {"growth": [0.0, 0.2 * rest], "volume": [0.5 * rest, 1.2 * rest]}[limit]
    simulation = inflatable(**{limit: bounds})
    result = settled(simulation, CommandSetpoints([2e4], STEP))
    assert result.status is Status.SATURATED
    assert result.report.active_limits == ("air.growth_max",)
    assert volume_of(simulation) == pytest.approx(1.2 * rest, rel=1e-6)
    assert 0.0 < result.efforts[0] < 2e4 and result.setpoints == result.efforts


def test_a_vacuum_empties_a_cavity_and_never_more(inflatable):
    simulation = inflatable(pressure=[-1e6, 0.0])
    for pressure in (-2e3, -5e3, -2e4, -1e5, -1e6, -1e6):
        result = settled(simulation, CommandSetpoints([pressure], STEP), 8)
        assert volume_of(simulation)[0] >= 0.0099 * 4e-6
        assert np.isfinite(result.state.positions).all()
    assert "air.growth_min" in result.report.active_limits
    back = settled(simulation, CommandSetpoints([0.0], STEP))
    assert back.status is Status.OK
    np.testing.assert_allclose(
        back.state.positions, simulation.model.nodes.rest_positions, atol=1e-6
    )


def test_a_vacuum_is_a_limit_where_none_is_allowed(inflatable):
    result = settled(inflatable(), CommandSetpoints([-1e3], STEP), 2)
    assert result.efforts == pytest.approx(0.0) and result.status is Status.SATURATED
    assert result.report.active_limits == ("air.pressure_min",)


def test_targets_are_reached_by_pressure(inflatable):
    tipped = changed({
        "effectors": [{"name": "top", "points": [[0.01, 0.01, 0.06]], "directions": ["z"]}],
    })  # fmt: skip
    simulation = inflatable(tipped, rate=1e5)
    target = simulation.effector_positions() + [0.0, 0.0, 2e-3]
    for _ in range(20):
        result = simulation.step(FollowTargets(target, STEP))
        assert result.setpoints == result.efforts
    assert result.status is Status.OK and result.effector_errors[0] < 1e-4
    assert 1e2 < result.efforts[0] < 2e4
    # It cannot shrink without a vacuum.
    result = repeat_step(simulation, FollowTargets(target - [0.0, 0.0, 4e-3], STEP), 20)
    assert result.status is Status.SATURATED and "air.pressure_min" in result.report.active_limits
    solved(simulation, FollowTargets(target, STEP), 20)


def test_a_commanded_cavity_keeps_its_pressure_beside_one_that_follows_targets(two_cavities):
    simulation = two_cavities()
    target = simulation.effector_positions() + [2e-4, 0.0, 0.0]
    commanded = np.array([np.nan, 3e3])
    result = repeat_step(simulation, FollowTargets(target, STEP, commanded), 25)
    assert result.setpoints[1] == pytest.approx(3e3, rel=1e-9)
    assert result.status is Status.OK and result.effector_errors[0] < 1e-4
    assert abs(result.efforts[0] - 3e3) > 10.0


def test_walls_behind_one_valve_have_one_pressure(two_cavities):
    def one_valve(mapping):
        left, right = mapping["cavities"]
        mapping["cavities"] = [{**left, "name": "both", "walls": left["walls"] + right["walls"]}]

    apart, joined = two_cavities(), two_cavities(one_valve)
    a = settled(apart, CommandSetpoints([2e3, 2e3], STEP))
    b = settled(joined, CommandSetpoints([2e3], STEP))
    np.testing.assert_allclose(a.state.positions, b.state.positions, atol=1e-9)
    assert b.displacements[0] == pytest.approx(a.displacements.sum(), rel=1e-6)


def test_cables_and_cavities_act_together(inflatable, settle):
    def with_cable(mapping):
        mapping["cables"] = [{
            "name": "down", "pull_point": [0.002, 0.01, 0.0], "tension": [0.0, 20.0],
            "points": [[0.002, 0.01, z] for z in (0.02, 0.04, 0.058)], "shortening": [0.0, 0.02],
        }]  # fmt: skip

    simulation = inflatable(with_cable)
    setpoints = simulation.rest_setpoints + [-2e-3, 3e3]
    result = settled(simulation, CommandSetpoints(setpoints, STEP))
    assert result.status is Status.OK
    assert result.displacements[0] == pytest.approx(2e-3) and result.efforts[0] > 0.0
    assert result.efforts[1] == pytest.approx(3e3) and result.displacements[1] > 0.0
    by_effort = settled(simulation, CommandEfforts(result.efforts, STEP))
    np.testing.assert_allclose(by_effort.state.positions, result.state.positions, atol=1e-8)


def between_slabs(simulate, body_of, block, tmp_path, **entries):
    """Two slabs, one beside the other, and a cavity that fills the gap between them."""
    bodies = []
    for name, x in (("left", 0.0), ("right", 0.008)):
        mesh = block(size=(0.005, 0.02, 0.05), cells=(2, 4, 8), shake=0.0)
        foot = [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}]
        body = body_of(mesh, name, fixed=foot)
        body["mesh"] = {"file": body["mesh"]["file"], "translation": [x, 0.0, 0.0]}
        bodies.append(body)
    gap = block(size=(0.003, 0.02, 0.05), cells=(1, 4, 8), shake=0.0)
    file = tmp_path / "gap.vtk"
    meshio.write(file, meshio.Mesh(gap.node_positions + [0.005, 0.0, 0.0],
                                   [("triangle", gap.surface_triangles)]))  # fmt: skip
    wall = {"file": str(file), "body": "left", **entries}
    return simulate(
        gravity=[0.0, 0.0, 0.0], bodies=bodies, cavities=[{"name": "gap", "walls": [wall]}]
    )


def test_a_cavity_between_two_bodies_pushes_them_apart(simulate, body_of, block, tmp_path):
    simulation = between_slabs(simulate, body_of, block, tmp_path, also_on=["right"])
    assert not simulation.notes
    result = settled(simulation, CommandSetpoints([100.0], STEP))
    assert result.status is Status.OK and result.displacements[0] > 0.0
    moved = result.state.positions - simulation.model.nodes.rest_positions
    left, right = (moved[body.first_node :][: body.mesh.node_count]
                   for body in simulation.model.bodies)  # fmt: skip
    # The division into tetrahedra has no mirror symmetry.
    assert left[:, 0].min() == pytest.approx(-right[:, 0].max(), rel=0.1)
    assert right[:, 0].max() > 1e-4


def test_walls_on_several_bodies_are_checked(simulate, body_of, block, tmp_path):
    with pytest.raises(SceneError, match=r"walls\[0\].*outside the body"):
        between_slabs(simulate, body_of, block, tmp_path)
    with pytest.raises(SceneError, match=r"also_on\[0\].*is right meant"):
        between_slabs(simulate, body_of, block, tmp_path, also_on=["rigt"])


# --- what cannot be used -------------------------------------------------------------------------


def rewritten(simulation_of, change):
    """Makes the inflatable block with its surface changed: points, triangles → both."""

    def broken(mapping):
        file = mapping["cavities"][0]["walls"][0]["file"]
        surface = meshio.read(file)
        points, triangles = change(surface.points, surface.cells[0].data)
        meshio.write(file, meshio.Mesh(points, [("triangle", triangles)]))

    return simulation_of(broken)


def test_an_open_cavity_is_refused(inflatable):
    with pytest.raises(SceneError, match=r"cavities\[0\]\.walls\[0\]\.file.*is open: 3 of its edges"):
        rewritten(inflatable, lambda points, triangles: (points, triangles[1:]))


def test_a_flipped_triangle_is_mended_with_a_warning(inflatable):
    def flip(points, triangles):
        turned = triangles.copy()
        turned[3] = turned[3, ::-1]
        return points, turned

    simulation = rewritten(inflatable, flip)
    assert any("reversed 1 triangles" in note for note in simulation.notes)
    assert simulation.model.actuators.terms[0].rest_volumes == pytest.approx(4e-6)


def test_a_cavity_that_is_inside_out_is_mended_with_a_warning(inflatable):
    simulation = rewritten(inflatable, lambda points, triangles: (points, triangles[:, ::-1]))
    assert any("pointed inwards" in note for note in simulation.notes)
    assert simulation.model.actuators.terms[0].rest_volumes == pytest.approx(4e-6)


def test_a_cavity_that_is_not_on_its_body_is_refused(inflatable):
    with pytest.raises(SceneError, match=r"walls\[0\].*outside the body"):
        rewritten(inflatable, lambda points, triangles: (points + [0.1, 0.0, 0.0], triangles))
    with pytest.raises(SceneError, match=r"walls\[0\].*outside the body"):
        rewritten(inflatable, lambda points, triangles: (1e3 * points, triangles))


@pytest.mark.parametrize("entries, message", [
    ({"pressure": [0.0, 5.0]}, "is the limit in pascals"),
    ({"pressure": [0.0, 1e9]}, "is the limit in pascals"),
    ({"growth": [0.0, 4.0]}, "is the limit in cubic metres"),
])  # fmt: skip
def test_a_slip_of_a_unit_is_told(inflatable, entries, message):
    assert any(message in note for note in inflatable(**entries).notes)
    assert not any("is the limit" in note for note in inflatable().notes)


# --- sealed gas and liquids ----------------------------------------------------------------------


def test_a_sealed_gas_resists_as_by_boyle(inflatable):
    def sealed(mapping):
        (cavity,) = mapping.pop("cavities")
        mapping["sealed_cavities"] = [{"name": "air", "walls": cavity["walls"]}]
        mapping["cables"] = [{
            "name": "down", "pull_point": [0.01, 0.01, 0.0], "points": [[0.01, 0.01, 0.06]],
            "hold_radius": 0.004, "shortening": [0.0, 0.02],
        }]  # fmt: skip
    empty = changed(sealed, {"sealed_cavities": LEFT_OUT})
    results = {}
    for name, change in (("sealed", sealed), ("empty", empty)):
        simulation = inflatable(change, body={"young_modulus": 1e4})
        result = settled(simulation, CommandSetpoints(simulation.rest_setpoints - 4e-3, STEP))
        assert result.status is Status.OK and result.report.iterations < 12
        results[name] = float(result.efforts[0])
        if name == "sealed":
            (gas,) = [term for term in simulation.model.forces if term.name == "sealed_gas"]
            volumes = gas.walls.volumes(result.state.positions)
            assert volumes[0] < gas.walls.rest_volumes[0]
            assert gas.pressures(result.state.positions) == pytest.approx(
                101325.0 * (gas.walls.rest_volumes / volumes - 1.0)
            )
    # The walls bulge, so that most of the volume remains.
    assert results["sealed"] > 1.01 * results["empty"]


def test_a_sealed_gas_of_high_pressure_inflates_its_cavity(inflatable):
    def sealed(mapping):
        (cavity,) = mapping.pop("cavities")
        mapping["sealed_cavities"] = [{"name": "air", "walls": cavity["walls"], "pressure": 5e3}]

    simulation = inflatable(sealed)
    result = settled(simulation, Hold(STEP))
    assert result.status is Status.OK
    (gas,) = [term for term in simulation.model.forces if term.name == "sealed_gas"]
    pressure = float(gas.pressures(result.state.positions)[0])
    assert 0.0 < pressure < 5e3
    # A regulator that holds the same pressure leads to the same shape.
    regulated = inflatable()
    same = settled(regulated, CommandSetpoints([pressure], STEP))
    np.testing.assert_allclose(same.state.positions, result.state.positions, atol=1e-9)


def test_a_liquid_hangs_its_weight_on_a_body(inflatable):
    density, volume = 1000.0, 4e-6
    under_gravity = changed({"gravity": [0.0, 0.0, -9.81], "body.material.density": 1.0})
    forces = {}
    for filling in (density, None):
        simulation = inflatable(under_gravity, liquid_density=filling)
        names = [term.name for term in simulation.model.forces]
        assert ("liquid_filling" in names) == (filling is not None)
        settled(simulation, Hold(STEP))
        total = np.zeros((simulation.model.nodes.free_node_count, 3))
        for term in simulation.model.forces:
            if term.name in ("gravity", "liquid_filling"):
                term.add_forces(simulation.state.positions, total)
        forces[filling] = total.sum(axis=0)
    # No node of the walls is held.
    gained = forces[density] - forces[None]
    np.testing.assert_allclose(gained, [0.0, 0.0, -9.81 * density * volume], rtol=0.05, atol=1e-6)


# --- contact --------------------------------------------------------------------------------------


def under_a_ceiling(friction):
    return changed({
        "obstacles": [{"name": "ceiling", "plane": {"point": [0.0, 0.0, 0.0605], "normal": [0.0, 0.0, -1.0]}}],
        "contact": {"between": [{"pair": ["hollow", "ceiling"]}], "friction": friction, "alarm_distance": 0.002},
    })  # fmt: skip


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("control", ["pressure", "volume"])
def test_a_cavity_presses_its_body_against_an_obstacle(inflatable, friction, control):
    simulation = inflatable(under_a_ceiling(friction), control=control)
    rest = simulation.rest_setpoints
    goal = [9e3] if control == "pressure" else 1.35 * rest
    for share in np.linspace(0.1, 1.0, 10):
        result = simulation.step(CommandSetpoints(rest + share * (goal - rest), STEP))
    result = settled(simulation, CommandSetpoints(goal, STEP), 20)
    assert result.status is Status.OK
    assert result.setpoints == pytest.approx(goal, rel=1e-6)
    assert result.report.contact_count > 0
    assert result.state.positions[:, 2].max() <= 0.0605 + 1e-7
    free = settled(inflatable(control=control), CommandSetpoints(goal, STEP))
    # The ceiling takes room: less volume at a pressure, more pressure at a volume.
    if control == "pressure":
        assert result.displacements[0] < free.displacements[0]
    else:
        assert result.efforts[0] > free.efforts[0]


beside_a_motor = changed({
    "beams": [{
        "name": "arm", "points": [[0.1, 0.0, 0.0], [0.1, 0.0, 0.004]], "section": {"circle": {"radius": 1e-4}},
        "elements": 2, "material": {"young_modulus": 1e5, "poisson_ratio": 0.4, "density": 1e3},
        "joined": [{"at": "start", "to": "world", "by": "hinge", "axis": [0.0, 1.0, 0.0]}]}],
    "hinge_motors": [{"name": "motor", "beam": "arm", "at": "start", "angle": [-1.0, 1.0]}],
})  # fmt: skip


@pytest.mark.parametrize("beside", [beside_a_motor, under_a_ceiling(0.0)])
def test_a_small_volume_is_kept_beside_actuators_and_contacts_of_other_units(inflatable, beside):
    tiny = {"size": (0.004, 0.004, 0.012), "cells": SMALL["cells"], "hole": SMALL["hole"]}
    efforts = []
    for changes in ((), (beside,)):
        simulation = inflatable(*changes, control="volume", body=tiny)
        # A motor is at 0 rad at rest.
        result = settled(simulation, CommandSetpoints(1.1 * simulation.rest_setpoints, STEP))
        efforts.append(result.efforts[simulation.actuator_names.index("air")])
    assert result.status is Status.OK
    assert efforts[1] == pytest.approx(efforts[0], rel=1e-4) and efforts[0] > 100.0


@pytest.mark.parametrize("command", [CommandSetpoints, lambda wanted, step: FollowTargets([[0.0, 0.0, 0.0]], step, wanted)])
def test_cables_hold_a_small_body_beside_a_pressure_as_they_hold_a_large_one(inflatable, command):
    efforts = []
    for scale, across, along in ((1.0, 0.02, 0.06), (0.2, 0.004, 0.012)):
        cables = [{"name": name, "pull_point": [x, 0.0, -along], "points": [[x, 0.0, 0.0], [x, 0.0, along]]}
                  for name, x in (("left", 0.0), ("right", across))]  # fmt: skip
        change = changed({"cables": cables, "effectors": [{"name": "tip", "points": [[across, 0.0, along]]}]})
        simulation = inflatable(change, body=SMALL | {"size": (across, across, along)})
        asked = command(simulation.rest_setpoints + [0.0, 0.0, 5e3], STEP)
        efforts.append(settled(simulation, asked, 5).efforts / [scale**2, scale**2, 1.0])
    assert efforts[0].min() > 1e-2
    np.testing.assert_allclose(efforts[1], efforts[0], rtol=1e-6)


def test_targets_are_reached_by_pressure_in_contact(inflatable):
    change = changed(under_a_ceiling(0.0), {
        "effectors": [{"name": "side", "points": [[0.02, 0.01, 0.03]], "directions": ["x"]}],
    })  # fmt: skip
    simulation = inflatable(change, rate=1e5)
    target = simulation.effector_positions() + [1.5e-3, 0.0, 0.0]
    result = solved(simulation, FollowTargets(target, STEP), 40)
    assert result.effector_errors[0] < 1e-4
    assert result.report.contact_count > 0 and result.setpoints == result.efforts
    # It comes back, and the contacts open.
    result = repeat_step(simulation, FollowTargets(target - [1.5e-3, 0.0, 0.0], STEP), 40)
    assert result.effector_errors[0] < 1e-4 and result.efforts[0] == pytest.approx(0.0, abs=50.0)
