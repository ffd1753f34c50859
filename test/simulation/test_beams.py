"""Beams in scenes: references of large displacements, joints, and what is refused."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipk

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.rotation import (
    quaternion_from_rotation,
    rotation_from_vector,
    vector_from_rotation,
)
from softrobot_twin.scene.body_entries import CrossSection
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Status,
)
from softrobot_twin.simulation.building.beam_bodies import build_section, swept_surface
from test.scene_changes import repeat_step, solved

YOUNG, RADIUS = 1.0e6, 0.002
INERTIA, AREA = np.pi * RADIUS**4 / 4.0, np.pi * RADIUS**2
RIGIDITY = YOUNG * INERTIA


def rod(name="rod", elements=16, points=((0, 0, 0), (1, 0, 0)), density=1e-6, **entries) -> dict:
    """A slender rod along x, clamped at its start."""
    return {
        "name": name, "points": [list(map(float, p)) for p in points], "elements": elements,
        "section": {"circle": {"radius": RADIUS}}, "fixed": ["start"],
        "material": {"young_modulus": YOUNG, "poisson_ratio": 0.3, "density": density}, **entries,
    }  # fmt: skip


def weight(force, place, name="weight") -> dict:
    """A small ball that pulls by a force [N] under a gravity of 10 m/s²."""
    return {"name": name, "position": list(place), "mass": force / 10.0,
            "sphere": {"radius": 0.001}}  # fmt: skip


def loaded(simulate, force, **entries):
    """A rod with a force at its end."""
    simulation = simulate(
        gravity=[0, 0, -10.0], rigid_bodies=[weight(force, (1, 0, 0))],
        beams=[rod(joined=[{"at": "end", "to": "weight"}], **entries)],
        solver={"newton_iterations": 60, "residual_tolerance": 1e-12},
    )  # fmt: skip
    assert simulation.step(Hold()).status is Status.OK
    return simulation


def test_a_fibre_far_lighter_than_the_tolerance_is_in_balance_only_where_it_hangs(simulate, drawn_rng):
    for _ in range(4):
        length, modulus = 10 ** drawn_rng.uniform(-2, -0.5), 10 ** drawn_rng.uniform(7, 10)
        fibre = rod(points=((0, 0, 0), (length, 0, 0)), density=1100.0)
        fibre["section"] = {"circle": {"radius": 10 ** drawn_rng.uniform(-5, -4)}}
        fibre["material"]["young_modulus"] = modulus
        simulation = simulate(beams=[fibre], solver={"newton_iterations": 3})
        steps = [simulation.step(Hold()) for _ in range(60)]
        tips = [step.state.positions[-1] for step in steps if step.status is Status.OK]
        assert steps[-1].status is Status.OK
        assert np.linalg.norm(np.array(tips) - tips[-1], axis=1).max() < 1e-3 * length


def test_what_counts_as_reached_shrinks_with_a_small_robot(simulate):
    for length, share in ((1.0, 0.0), (0.003, 1e-3)):
        simulation = simulate(beams=[rod(points=((0, 0, 0), (length, 0, 0)))])
        tolerance = share * simulation.model.nodes.size or 1e-4
        assert simulation.model.reach_tolerance == pytest.approx(tolerance)


def nodes_of(simulation, beam=0):
    return simulation.model.beams[beam].nodes_mapping().positions(simulation.state.positions)


def tip_of(simulation, beam=0):
    return nodes_of(simulation, beam)[-1]


# --- references -----------------------------------------------------------------------------------

TIP_LOAD = [(1, 0.30172, 0.05643), (2, 0.49346, 0.16064), (3, 0.60325, 0.25442),
            (5, 0.71379, 0.38763), (10, 0.81061, 0.55500)]  # fmt: skip
OWN_WEIGHT = [(1, 0.12347, 0.00875), (5, 0.49591, 0.15334), (10, 0.70020, 0.34365),
              (20, 0.82988, 0.55477)]  # fmt: skip


@pytest.mark.parametrize(("load", "down", "back"), TIP_LOAD)
def test_a_cantilever_under_a_tip_load_is_the_elastica_with_four_elements(simulate, load, down, back):
    tip = tip_of(loaded(simulate, load * RIGIDITY, elements=4))
    assert -tip[2] == pytest.approx(down, rel=1e-3)
    assert 1.0 - tip[0] == pytest.approx(back, rel=1e-3)


def errors_under_own_weight(simulate, load, down, back):
    found = []
    for elements in (4, 8, 16, 32):
        heavy = rod(elements=elements, density=load * RIGIDITY / (10.0 * AREA))
        simulation = simulate(
            gravity=[0, 0, -10.0], beams=[heavy],
            solver={"newton_iterations": 60, "residual_tolerance": 1e-12},
        )  # fmt: skip
        assert simulation.step(Hold()).status is Status.OK
        tip = tip_of(simulation)
        found.append(np.hypot(-tip[2] - down, 1.0 - tip[0] - back))
    return np.array(found)


@pytest.mark.parametrize(("load", "down", "back"), OWN_WEIGHT)
def test_under_its_own_weight_the_error_falls_with_the_fourth_power_of_the_elements(
    simulate, load, down, back
):
    errors = errors_under_own_weight(simulate, load, down, back)
    print(errors)
    # The reference has five digits.
    assert np.all(errors < [1.2e-3, 1e-4, 2e-5, 2e-5])


def test_the_bend_of_45_degrees_is_that_of_the_literature(simulate):
    angles = np.linspace(0.0, np.pi / 4, 17)
    places = 100.0 * np.column_stack([1.0 - np.cos(angles), np.sin(angles), 0.0 * angles])
    reached = {300: (22.33, 58.84, 40.08), 450: (18.62, 52.32, 48.39), 600: (15.79, 47.23, 53.37)}
    for load, expected in reached.items():
        bend = {
            "name": "bend", "points": places.tolist(), "curve": "smooth", "elements": 16,
            "section": {"rectangle": {"thickness": 1.0, "width": 1.0}}, "fixed": ["start"],
            "thickness_direction": [0, 0, 1], "joined": [{"at": "end", "to": "weight"}],
            "material": {"young_modulus": 1e7, "poisson_ratio": 0.0, "density": 1e-6},
        }  # fmt: skip
        simulation = simulate(
            gravity=[0, 0, 10.0], rigid_bodies=[weight(load, places[-1])], beams=[bend],
            solver={"newton_iterations": 60, "residual_tolerance": 1e-3},
        )  # fmt: skip
        assert simulation.step(Hold()).status is Status.OK
        # Published values differ from each other by 0.5 at a length of 100.
        print(load, tip_of(simulation), expected)
        assert np.allclose(tip_of(simulation), expected, atol=0.5)


def test_a_rest_shape_with_corners_and_curves_is_in_equilibrium(simulate):
    points = [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0.1, 0.1, 0.1]]
    for curve in ("straight", "smooth"):
        simulation = simulate(gravity=[0, 0, 0], beams=[rod(points=points, curve=curve)])
        result = simulation.step(Hold())
        assert result.report.residual < 1e-12
        assert simulation.model.forces[0].energy(simulation.state.positions) < 1e-20


def test_a_loop_of_a_smooth_curve_has_its_arc_length(simulate):
    angles = np.linspace(0.0, np.pi, 13)
    points = np.column_stack([np.sin(angles), 1 - np.cos(angles), 0 * angles])
    simulation = simulate(beams=[rod(points=points, curve="smooth", elements=24)])
    assert simulation.model.beams[0].lengths.sum() == pytest.approx(np.pi, rel=1e-4)


def column(simulate, share, push):
    """A column of height 1 under a share of Euler's load, after a push aside that is removed."""
    euler = np.pi**2 * RIGIDITY / 4.0
    simulation = simulate(
        gravity=[0, 0, -10.0], rigid_bodies=[weight(share * euler, (0, 0, 1))],
        beams=[rod(points=((0, 0, 0), (0, 0, 1)), joined=[{"at": "end", "to": "weight"}])],
        cables=[{"name": "push", "body": "weight", "pull_point": [5, 0, 1],
                 "points": [[0.0, 0, 1]]}],
        solver={"newton_iterations": 100, "residual_tolerance": 1e-12},
    )  # fmt: skip
    simulation.step(CommandEfforts(np.array([push * euler]), 1.0))
    solved(simulation, CommandEfforts(np.zeros(1), 1.0), 4)
    return tip_of(simulation)


def test_a_column_below_eulers_load_stands_straight(simulate):
    assert abs(column(simulate, 0.9, 0.02)[0]) < 1e-6


def test_a_column_above_eulers_load_settles_on_the_bent_branch(simulate):
    # The elastica with P/P_E = (2 K(m)/π)², and the tip 2 √m/k aside, k² = P/EI.
    m = brentq(lambda m: (2.0 * ellipk(m) / np.pi) ** 2 - 1.1, 1e-6, 0.9)
    aside = 2.0 * np.sqrt(m) / np.sqrt(1.1 * np.pi**2 / 4.0)
    assert column(simulate, 1.1, 0.02)[0] == pytest.approx(aside, rel=0.02)


# A strip as stiff as the rod along and in bending down, four times as stiff in bending to the side.
STRIP = {"rectangle": {"thickness": np.sqrt(3.0) * RADIUS, "width": np.sqrt(12.0) * RADIUS}}


def toggle(simulate, rise=0.006, aside=0.0, **entries):
    """Two clamped rods that meet at a shallow angle, with a cable that pulls their middle down."""
    points = ((-0.5, 0, 0), (0, aside, rise), (0.5, 0, 0))
    return simulate(
        gravity=[0, 0, 0], beams=[rod(points=points, fixed=["start", "end"], elements=16,
                                      **entries.pop("beam", {}))],
        cables=[{"name": "pull", "body": "rod", "pull_point": [0, 0, -1.0],
                 "points": [[0, aside, rise]]}], **entries,
    )  # fmt: skip


def test_at_prescribed_lengths_a_toggle_is_followed_through_its_limit_point(simulate):
    # A round rod of this rise would buckle to the side.
    simulation = toggle(simulate, beam={"section": STRIP, "thickness_direction": [0, 0, 1]})
    rest, tensions, heights = simulation.state.setpoints[0], [], []
    for travel in np.linspace(0.0, 0.0072, 13):
        result = solved(simulation, CommandSetpoints(np.array([rest - travel]), 1.0))
        tensions.append(result.efforts[0])
        heights.append(nodes_of(simulation)[8, 2])
    assert np.allclose(heights, 0.006 - np.linspace(0.0, 0.0072, 13), atol=1e-6)
    peak = int(np.argmax(tensions))
    assert 3 < peak < 8
    assert min(tensions[peak:]) < 0.9 * tensions[peak]


def test_a_toggle_of_round_rods_buckles_to_the_side_in_a_few_steps(simulate):
    # Flat, its middle is pressed by 1.8 times Euler's load of a clamped rod.
    simulation = toggle(simulate, aside=1e-6)
    rest = simulation.state.setpoints[0]
    solved(simulation, CommandSetpoints(np.array([rest - 0.006]), 1.0), 20)
    assert abs(nodes_of(simulation)[8, 1]) > 1e-3


def pulled_along(rng, simulate):
    """A beam that is straight but for a bend of 1e-6 to 1e-4 of its length, with some cables along it."""
    length, radius, young = rng.uniform(0.08, 0.2), rng.uniform(0.002, 0.004), 10 ** rng.uniform(6, 7)
    count, bend = int(rng.integers(2, 5)), 10 ** rng.uniform(-6, -4)
    shares = np.linspace(0.0, 1.0, 9)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    aside = np.array([np.cos(angle), np.sin(angle)]) * bend * length
    beam = rod(
        elements=8, points=np.column_stack([length * shares, np.outer(shares**2, aside)]),
        section={"circle": {"radius": radius}},
        material={"young_modulus": young, "poisson_ratio": 0.4, "density": 1100.0},
    )  # fmt: skip
    around = 2.0 * np.pi * np.arange(count) / count
    circle = 2.0 * radius * np.column_stack([np.cos(around), np.sin(around)])
    cables = [
        {"name": f"c{i}", "body": "rod", "pull_point": [0.0, *place],
         "points": [[share * length, *place] for share in (1 / 3, 2 / 3, 1.0)]}
        for i, place in enumerate(circle)
    ]  # fmt: skip
    tension = young * np.pi * radius**3 / 8.0 / length
    return length, simulate(
        gravity=[0, 0, 0], beams=[beam], cables=cables,
        solver={"newton_iterations": 5, "residual_tolerance": 1e-5 * tension},
    )  # fmt: skip


def test_a_nearly_straight_beam_pulled_along_its_axis_past_buckling_does_not_creep(simulate, drawn_rng):
    for _ in range(4):
        length, simulation = pulled_along(drawn_rng, simulate)
        share = drawn_rng.uniform(0.02, 0.3)
        asked = CommandSetpoints(simulation.state.setpoints - share * length, 1.0)
        for step in range(1, 101):
            if simulation.step(asked).status is Status.OK:
                break
        print(share, step)
        assert step < 100


def test_at_a_tension_above_the_limit_a_dynamic_toggle_passes_through(simulate):
    still = toggle(simulate)
    rest = still.state.setpoints[0]
    limit = max(
        still.step(CommandSetpoints(np.array([rest - travel]), 1.0)).efforts[0]
        for travel in np.linspace(0.0, 0.006, 13)
    )
    moving = toggle(
        simulate, integration="dynamic",
        beam={"density": 1000.0, "damping": {"mass": 0.5, "stiffness": 0.01}},
    )  # fmt: skip
    for share, below in ((0.8, False), (1.15, True)):
        result = repeat_step(moving, CommandEfforts(np.array([share * limit]), 0.2), 300)
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
        assert (nodes_of(moving)[8, 2] < 0.0) == below


# --- tension --------------------------------------------------------------------------------------


def line(points, elements, radius=5e-4, young=2.0e9, **entries) -> dict:
    """A line of nylon, or of something softer."""
    return rod("line", elements, points, density=1100.0, **entries) | {
        "section": {"circle": {"radius": radius}},
        "material": {"young_modulus": young, "poisson_ratio": 0.4, "density": 1100.0},
    }  # fmt: skip


@pytest.mark.parametrize(("size", "elements"), [(0.01, 3), (1.0, 1), (1.0, 10), (50.0, 20)])
def test_a_line_stretches_by_its_load_over_its_axial_stiffness(simulate, size, elements):
    """Nylon of 1 mm by 200 mm under 5 N; and likewise of 2 mm, of 10 m. Pushed aside before."""
    force, end = 5.0 * size**2, (0.0, 0.0, -0.2 * size)
    simulation = simulate(
        gravity=[0, 0, -10.0], rigid_bodies=[weight(force, end)],
        beams=[line(((0, 0, 0), end), elements, 5e-4 * size,
                    joined=[{"at": "end", "to": "weight", "by": "ball"}])],
        cables=[{"name": "push", "body": "weight", "pull_point": [5.0 * size, 0, 0],
                 "points": [list(end)]}],
        solver={"newton_iterations": 40},
    )  # fmt: skip
    for tension in (0.3 * force, 0.0):
        solved(simulation, CommandEfforts(np.array([tension]), 1.0), 2)
    strain = (5.0 / (np.pi * 5e-4**2) + 0.5 * 10.0 * 1100.0 * 0.2 * size) / 2.0e9
    stretch = np.linalg.norm(tip_of(simulation)) / (0.2 * size) - 1.0
    assert stretch == pytest.approx(strain, rel=1e-2)


def test_a_line_that_is_clamped_across_its_pull_is_as_long_as_one_that_hangs(simulate):
    simulation = simulate(
        gravity=[0, 0, -10.0], integration="dynamic", rigid_bodies=[weight(5.0, (0.2, 0, 0))],
        beams=[line(((0, 0, 0), (0.2, 0, 0)), 10, joined=[{"at": "end", "to": "weight"}],
                    damping={"mass": 10.0, "stiffness": 0.0})],
        solver={"newton_iterations": 40},
    )  # fmt: skip
    solved(simulation, Hold(0.05), 60)
    # The elastica leads √(2EI/N) aside and is (2 - √2) √(EI/N) shorter: a third of an element.
    layer = np.sqrt(2.0e9 * np.pi * 5e-4**4 / 4.0 / 5.0)
    expected = [np.sqrt(2.0) * layer, 0.0, -0.2 * (1.0 + 5.0 / (2.0e9 * np.pi * 5e-4**2))
                + (2.0 - np.sqrt(2.0)) * layer]  # fmt: skip
    np.testing.assert_allclose(tip_of(simulation), expected, atol=2e-3)


@pytest.mark.parametrize("elements", [10, 20])
def test_a_rope_between_two_walls_hangs_in_a_catenary(simulate, elements):
    across = np.linspace(-0.2, 0.2, elements + 1)
    points = np.column_stack([across, 0.0 * across, 4.0 * across**2])
    rope = line(points.tolist(), elements, 1e-4, 1e8, fixed=[], curve="smooth", joined=[
        {"at": at, "to": "world", "by": "ball"} for at in ("start", "end")
    ])  # fmt: skip
    simulation = simulate(gravity=[0, 0, -10.0], beams=[rope], solver={"newton_iterations": 40})
    solved(simulation, Hold(1.0), 10)
    length = simulation.model.beams[0].lengths.sum()
    a = brentq(lambda a: 2.0 * a * np.sinh(0.2 / a) - length, 0.02, 10.0)
    places = nodes_of(simulation)
    curve = a * (np.cosh(places[:, 0] / a) - np.cosh(0.2 / a)) + places[0, 2]
    # What is left is its stretch.
    assert np.abs(places[:, 2] - curve).max() < 5e-4 * length


# --- vibration ------------------------------------------------------------------------------------


def frequencies(simulation, count=4):
    """Lowest angular frequencies at rest, by the tangent and the masses of the frames [rad/s]."""
    model, x = simulation.model, simulation.state.positions
    unknowns = model.nodes.free_node_count
    stiffness = np.zeros((3 * unknowns, 3 * unknowns))
    for i in range(3 * unknowns):
        move = np.zeros((unknowns, 3))
        move.flat[i] = 1e-6
        sides = []
        for share in (1.0, -1.0):
            moved, forces = x.copy(), np.zeros((unknowns, 3))
            model.nodes.advance(moved, move, share)
            model.forces[0].add_forces(moved, forces)
            sides.append(forces)
        stiffness[:, i] = -(sides[0] - sides[1]).ravel() / 2e-6
    inertia = next(term for term in model.forces if term.name == "inertia of beams")
    accelerations = np.zeros((3 * unknowns, 3 * unknowns))
    for column, forces in zip(accelerations.T, stiffness.T, strict=True):
        inertia.add_accelerations(x, forces.reshape(-1, 3), column.reshape(-1, 3))
    values = np.linalg.eigvals(accelerations).real
    return np.sqrt(np.sort(values)[:count])


def test_natural_frequencies_of_a_cantilever_are_those_of_euler_and_bernoulli(simulate):
    scale = np.sqrt(RIGIDITY / (1000.0 * AREA))
    expected = scale * np.repeat([1.8751041, 4.6940911, 7.8547574], 2) ** 2
    for elements, errors in ((1, [0.006]), (2, [0.001, 0.01]), (4, [1e-4, 1.2e-3, 8e-3])):
        simulation = simulate(
            gravity=[0, 0, 0], integration="dynamic",
            beams=[rod(elements=elements, density=1000.0)],
        )  # fmt: skip
        count = 2 * len(errors)
        found = frequencies(simulation, count)
        print(elements, found / expected[:count] - 1.0)
        assert np.allclose(found, expected[:count], rtol=np.repeat(errors, 2))


# --- rotation and joints --------------------------------------------------------------------------


def turned_rod(simulate, **entries):
    """A short rod whose end a guided body turns about its axis."""
    return simulate(
        gravity=[0, 0, 0],
        rigid_bodies=[{"name": "grip", "motion": "guided", "position": [0.2, 0, 0],
                       "sphere": {"radius": 0.01}, "turn_rate": 1000.0, "speed": 1000.0}],
        beams=[rod(points=((0, 0, 0), (0.2, 0, 0)), elements=12,
                   joined=[{"at": "end", "to": "grip"}], **entries)],
        solver={"newton_iterations": 40, "residual_tolerance": 1e-9},
    )  # fmt: skip


def test_a_rod_twisted_by_two_turns_holds_a_torque_in_proportion(simulate):
    section = {"constants": {"area": 1e-5, "inertia_y": 8e-12, "inertia_z": 8e-12,
                             "torsion": 3e-12}}  # fmt: skip
    simulation = turned_rod(simulate, section=section, thickness_direction=[0, 0, 1])
    shear = YOUNG / 2.6
    for angle in np.arange(0.25, 4.0 * np.pi + 0.1, 0.25):
        quaternion = quaternion_from_rotation(rotation_from_vector([angle, 0, 0]))
        simulation.model.guides.aim("grip", [0.2, 0, 0], quaternion)
        solved(simulation, Hold(1.0))
    twists = simulation.model.forces[0].deformations(simulation.state.positions)[:, 3]
    assert twists.sum() == pytest.approx(angle, rel=1e-9)
    energy = simulation.model.forces[0].energy(simulation.state.positions)
    assert energy == pytest.approx(0.5 * shear * 3e-12 / 0.2 * angle**2, rel=1e-6)


def test_beams_joined_in_one_place_share_a_frame(simulate):
    whole = simulate(beams=[rod(elements=8, density=0.5)])
    parts = simulate(beams=[
        rod("foot", 4, ((0, 0, 0), (0.5, 0, 0)), density=0.5),
        rod("top", 4, ((1.0, 0, 0), (0.5, 0, 0)), density=0.5, fixed=[],
            joined=[{"at": "end", "to": "foot"}]),
    ])  # fmt: skip
    assert parts.model.nodes.free_node_count == whole.model.nodes.free_node_count
    for simulation in (whole, parts):
        assert simulation.step(Hold()).status is Status.OK
    assert np.allclose(nodes_of(parts, 1)[0], tip_of(whole), atol=1e-9)


def test_a_hub_between_two_rods_moves_as_their_common_end(simulate):
    hub = {"name": "hub", "position": [0.5, 0, 0], "mass": 1e-9, "sphere": {"radius": 0.02}}
    ends = {"joined": [{"at": "end", "to": "hub"}]}
    simulation = simulate(rigid_bodies=[hub], beams=[
        rod("foot", 4, ((0, 0, 0), (0.48, 0, 0)), density=0.5, **ends),
        rod("top", 4, ((1.0, 0, 0), (0.52, 0, 0)), density=0.5, fixed=[], **ends),
    ])  # fmt: skip
    assert simulation.step(Hold()).status is Status.OK
    foot, top = nodes_of(simulation), nodes_of(simulation, 1)
    turn = simulation.model.rigid[0].entry_pose(simulation.state.positions)[1]
    assert np.allclose(top[-1] - foot[-1], turn @ [0.04, 0, 0], atol=1e-12)
    assert np.linalg.norm(vector_from_rotation(turn)) > 0.1
    # The load of the free rod is carried by the clamped one.
    names = [term.name for term in simulation.model.forces]
    forces = np.zeros((simulation.model.nodes.free_node_count, 3))
    for term in simulation.model.forces:
        term.add_forces(simulation.state.positions, forces)
    assert np.abs(forces).max() < 1e-8
    assert names.count("beams") == 1


def test_beams_joined_at_a_distance_move_as_if_a_light_rigid_body_were_between(simulate):
    hub = {"name": "hub", "position": [0.4, 0, 0.05], "mass": 1e-13, "sphere": {"radius": 0.02}}
    foot, top = ((0, 0, 0), (0.4, 0, 0)), ((0.4, 0.02, 0.1), (0.9, 0.1, 0.1))
    to_hub = {"joined": [{"at": "end", "to": "hub"}]}
    apart = simulate(beams=[
        rod("foot", 4, foot, density=0.5),
        rod("top", 4, top, density=0.5, fixed=[],
            joined=[{"at": "start", "to": "foot", "to_at": "end"}]),
    ])  # fmt: skip
    between = simulate(rigid_bodies=[hub], beams=[
        rod("foot", 4, foot, density=0.5, **to_hub),
        rod("top", 4, top[::-1], density=0.5, fixed=[], **to_hub),
    ])  # fmt: skip
    for simulation in (apart, between):
        assert simulation.step(Hold()).status is Status.OK
    assert np.allclose(tip_of(apart, 1), nodes_of(between, 1)[0], atol=1e-7)
    assert np.abs(tip_of(apart, 1) - (0.9, 0.1, 0.1)).max() > 0.01


@pytest.mark.parametrize("joint, message", [
    ({"to": "foot", "to_at": 2}, "has the points 0 to 1"), ({"to": "hub", "to_at": "end"}, "hub is none"),
])
def test_a_point_that_another_beam_does_not_have_is_refused(simulate, joint, message):
    hub = {"name": "hub", "position": [1.0, 0, 0], "mass": 0.5, "sphere": {"radius": 0.02}}
    top = rod("top", 4, ((1.0, 0, 0), (2.0, 0, 0)), fixed=[], joined=[{"at": "start"} | joint])
    with pytest.raises(SceneError, match=message):
        simulate(rigid_bodies=[hub], beams=[rod("foot", 4), top])


def test_a_rectangle_takes_the_constants_that_were_measured():
    plain, measured = (
        build_section(CrossSection(rectangle={"thickness": 0.005, "width": 0.01} | given), 0.45)
        for given in ({}, {"torsion": 2.0e-10, "shear_factor": 0.7})
    )  # fmt: skip
    assert (measured.torsion, measured.shear_area_y, measured.shear_area_z) == (2.0e-10, 3.5e-5, 3.5e-5)
    assert (measured.area, measured.inertia_y) == (plain.area, plain.inertia_y)
    assert plain.torsion == pytest.approx(0.2287 * 0.01 * 0.005**3, rel=1e-3)


def test_points_on_a_beam_move_with_it(simulate):
    simulation = simulate(
        gravity=[0, 0, -10.0], beams=[rod(elements=10, density=0.2)],
        effectors=[{"name": "tip", "body": "rod", "points": [[1, 0, 0.01]]}],
        markers=[{"id": 1, "body": "rod", "point": [0.55, 0, 0]}],
        cables=[{"name": "tendon", "body": "rod", "pull_point": [0, 0, 0.01],
                 "points": [[0.3, 0, 0.01], [0.6, 0, 0.01], [1, 0, 0.01]]}],
    )  # fmt: skip
    rest = simulation.state.setpoints[0]
    result = solved(simulation, CommandSetpoints(np.array([rest - 0.004]), 1.0))
    x, nodes = simulation.state.positions, nodes_of(simulation)
    offset = np.linalg.norm(result.effector_positions[0] - nodes[-1])
    assert offset == pytest.approx(0.01, rel=1e-9)
    middle = simulation.model.markers.positions(x)[0]
    assert np.allclose(middle, 0.5 * (nodes[5] + nodes[6]), atol=1e-3)
    path = simulation.model.actuators.terms[0].paths[0].positions(x)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(rest - 0.004)


def test_the_end_of_a_beam_points_where_its_effector_asks(simulate):
    # Four tendons beside the axis bend a beam; its effector is the frame of its last node.
    tendons = [
        {"name": f"tendon_{k}", "body": "rod", "pull_point": [0.0, y, z],
         "points": [[x, y, z] for x in (0.25, 0.5, 0.75, 1.0)], "tension": [0.0, 10.0]}
        for k, (y, z) in enumerate([(0.02, 0), (0, 0.02), (-0.02, 0), (0, -0.02)])
    ]  # fmt: skip
    simulation = simulate(
        gravity=[0, 0, 0], beams=[rod(elements=16)], cables=tendons,
        effectors=[{"name": "tip", "body": "rod", "points": [[1, 0, 0]], "directions": [],
                    "orientation": {"pointing": [1, 0, 0]}}],
    )  # fmt: skip
    wanted = np.array([np.cos(0.6), np.sin(0.6) * 0.8, np.sin(0.6) * 0.6])
    turn = rotation_from_vector(0.6 * np.array([0.0, -0.6, 0.8]))
    assert np.allclose(turn @ [1, 0, 0], wanted)
    quaternion = quaternion_from_rotation(turn)
    for _ in range(40):
        result = simulation.step(FollowTargets(
            simulation.effector_positions(), 1.0, orientations=quaternion[None, :]
        ))  # fmt: skip
    assert result.orientation_errors[0] < np.radians(0.05)
    x, carriers = simulation.state.positions, simulation.model.beams[0].carriers
    tangent = x[carriers.frame_nodes[-1] + 1] - x[carriers.frame_nodes[-1]]
    assert np.degrees(np.arccos(tangent @ wanted)) < 0.1


# --- tapered beams --------------------------------------------------------------------------------


@pytest.mark.parametrize(("end_scale", "elements"), [(0.4, 32), (2.0, 32)])
def test_a_cone_bends_stretches_and_weighs_as_in_theory(simulate, end_scale, elements):
    def made(direction, count):
        push = {"name": "push", "body": "rod", "points": [[1, 0, 0]], "direction": direction}
        section = {"circle": {"radius": RADIUS}, "end_scale": end_scale}
        return simulate(gravity=[0, 0, 0], beams=[rod(section=section, elements=count)], forces=[push],
                        solver={"newton_iterations": 60, "residual_tolerance": 1e-12})  # fmt: skip

    bent = made([0, 0, 1], elements)
    force = 1e-4 * RIGIDITY
    result = bent.step(CommandEfforts(np.array([force]), 1.0))
    # F L³ / 3 E I at its thick end, by b/a; and the even stretch F L / E π a b.
    assert result.displacements[0] == pytest.approx(force / (3.0 * RIGIDITY * end_scale), rel=2e-3)
    stretched = made([1, 0, 0], 1).step(CommandEfforts(np.array([force]), 1.0))
    assert stretched.displacements[0] == pytest.approx(force / (YOUNG * AREA * end_scale), rel=1e-6)
    mass = 1e-6 * AREA * (1.0 + end_scale + end_scale**2) / 3.0
    assert bent.model.beams[0].mass == pytest.approx(mass)


def test_a_cone_vibrates_with_the_frequency_of_its_ritz_quotient(simulate):
    nodes, weights = np.polynomial.legendre.leggauss(20)
    x, weights, powers = 0.5 * (nodes + 1.0), 0.5 * weights, np.arange(2, 9)[:, None]
    sizes = (1.0 - 0.5 * x) ** 2
    bends, moves = powers * (powers - 1) * x ** (powers - 2), x**powers
    K, M = (bends * weights * sizes**2) @ bends.T, (moves * weights * sizes) @ moves.T
    frequency = np.sqrt(eigh(K, M, eigvals_only=True)[0] * RIGIDITY / (1000.0 * AREA))
    cone = rod(section={"circle": {"radius": RADIUS}, "end_scale": 0.5}, density=1000.0, elements=16)
    simulation = simulate(
        gravity=[0, 0, -1e-4], beams=[cone], integration="dynamic",
        time_scheme="generalized_alpha", spectral_radius=1.0,
        solver={"newton_iterations": 30, "residual_tolerance": 1e-10},
    )  # fmt: skip
    step = 2.0 * np.pi / frequency / 100.0
    heights = [repeat_step(simulation, Hold(step), 1).state.positions[-4, 2] for _ in range(101)]
    # It swings about its balance: after a period it is where it was.
    assert np.argmin(heights) == pytest.approx(50, abs=2)
    assert heights[-1] == pytest.approx(0.0, abs=0.05 * np.ptp(heights))


def test_the_surface_of_a_cone_narrows_to_its_end(simulate):
    cone = rod(section={"circle": {"radius": RADIUS}, "end_scale": 0.25}, elements=4)
    simulation = simulate(gravity=[0, 0, 0], beams=[cone])
    points, _ = swept_surface(simulation.model.beams[0])
    places = points.positions(simulation.state.positions)
    radii = np.linalg.norm(places[:, 1:], axis=1)
    np.testing.assert_allclose(radii[:-2], RADIUS * (1.0 - 0.75 * places[:-2, 0]), atol=1e-9)


# --- arcs -----------------------------------------------------------------------------------------


def curled(at, angle=1.2, radius=0.3, elements=8, **entries):
    """A rod along x that goes on as an arc upwards at one end, where it is clamped."""
    arc = {"at": at, "radius": radius, "angle": angle, "towards": [0, 0, 1], "elements": elements}
    return rod(arcs=[arc], fixed=[at], **entries)


@pytest.mark.parametrize("at", ["start", "end"])
def test_an_arc_goes_on_without_a_corner_and_rests_as_it_is_drawn(simulate, at):
    simulation = simulate(gravity=[0.0, 0.0, 0.0], beams=[curled(at)])
    before = nodes_of(simulation)
    assert simulation.step(Hold()).status is Status.OK
    np.testing.assert_allclose(nodes_of(simulation), before, atol=1e-9)
    beam, inner = simulation.model.beams[0], {"start": 0, "end": -1}[at]
    assert beam.lengths.sum() == pytest.approx(1.0 + 0.3 * 1.2)
    x = {"start": -0.3 * np.sin(1.2), "end": 1.0 + 0.3 * np.sin(1.2)}[at]
    np.testing.assert_allclose(before[inner], [x, 0.0, 0.3 * (1.0 - np.cos(1.2))], atol=1e-12)
    np.testing.assert_allclose(beam.places[beam.point_nodes], [[0, 0, 0], [1, 0, 0]], atol=1e-12)
    turned = {"start": [np.cos(1.2), 0, -np.sin(1.2)], "end": [np.cos(1.2), 0, np.sin(1.2)]}[at]
    np.testing.assert_allclose(beam.axes[inner][:, 0], turned, atol=1e-12)


@pytest.mark.parametrize("at", ["start", "end"])
def test_a_force_at_the_tip_bends_an_arc_as_castigliano_says(simulate, at):
    """δ = F/EI (L³/3 + ∫ (L + R sin θ)² R dθ) of the moments on the straight rod and on the arc."""
    force, L, R, angle = 1e-3 * RIGIDITY, 1.0, 0.3, 1.2
    simulation = simulate(
        gravity=[0, 0, -10.0], rigid_bodies=[weight(force, (float(at == "start"), 0, 0))],
        beams=[curled(at, density=1e-9, joined=[{"at": {"start": "end", "end": "start"}[at], "to": "weight"}])],
        solver={"newton_iterations": 60, "residual_tolerance": 1e-11},
    )  # fmt: skip
    tip = -1 if at == "start" else 0
    before = nodes_of(simulation)[tip]
    assert simulation.step(Hold()).status is Status.OK
    theta = np.linspace(0.0, angle, 2001)
    moments = np.trapezoid((L + R * np.sin(theta)) ** 2 * R, theta)
    sag = force / RIGIDITY * (L**3 / 3.0 + moments)
    assert before[2] - nodes_of(simulation)[tip][2] == pytest.approx(sag, rel=2e-3)


@pytest.mark.parametrize("arcs, message", [
    ([{"towards": [1, 0, 0]}], r"arcs\[0\].towards.*lies along the axis of rod"),
    ([{}, {}], "two arcs at one end"), ([{"radius": 0.0}], "radius.*above"), ([{"angle": 7.0}], "angle.*below"),
])  # fmt: skip
def test_arcs_that_are_none_are_refused(simulate, arcs, message):
    usual = {"at": "end", "radius": 0.1, "angle": 0.5, "towards": [0, 0, 1]}
    with pytest.raises(SceneError, match=message):
        simulate(beams=[rod(arcs=[usual | one for one in arcs])])
