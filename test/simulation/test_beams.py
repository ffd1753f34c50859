"""Beams in scenes: references of large displacements, joints, and what is refused."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.rotation import (
    quaternion_from_rotation,
    rotation_from_vector,
    vector_from_rotation,
)
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Status

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
def test_a_cantilever_under_a_tip_load_is_the_elastica_with_four_elements(
    simulate, load, down, back
):
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
def test_under_its_own_weight_the_error_falls_with_the_square_of_the_elements(
    simulate, load, down, back
):
    errors = errors_under_own_weight(simulate, load, down, back)
    assert errors[0] < 0.012
    assert errors[2] < 1e-3
    assert errors[0] / errors[2] > 10.0


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
            solver={"newton_iterations": 60, "residual_tolerance": 1e-7},
        )  # fmt: skip
        assert simulation.step(Hold()).status is Status.OK
        # Published values differ from each other by 0.3 of a length of 100.
        assert np.allclose(tip_of(simulation), expected, atol=0.35)


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
    for _ in range(4):
        result = simulation.step(CommandEfforts(np.zeros(1), 1.0))
    assert result.status is Status.OK
    return tip_of(simulation)


def test_a_column_below_eulers_load_stands_straight(simulate):
    assert abs(column(simulate, 0.9, 0.02)[0]) < 1e-6


def test_a_column_above_eulers_load_settles_on_the_bent_branch(simulate):
    # The elastica with P/P_E = (2 K(m)/π)², and the tip 2 √m/k aside, k² = P/EI.
    m = brentq(lambda m: (2.0 * ellipk(m) / np.pi) ** 2 - 1.1, 1e-6, 0.9)
    aside = 2.0 * np.sqrt(m) / np.sqrt(1.1 * np.pi**2 / 4.0)
    assert column(simulate, 1.1, 0.02)[0] == pytest.approx(aside, rel=0.02)


def toggle(simulate, rise=0.02, **entries):
    """Two clamped rods that meet at a shallow angle, with a cable that pulls their middle down."""
    points = ((-0.5, 0, 0), (0, 0, rise), (0.5, 0, 0))
    return simulate(
        gravity=[0, 0, 0], beams=[rod(points=points, fixed=["start", "end"], elements=16,
                                      **entries.pop("beam", {}))],
        cables=[{"name": "pull", "body": "rod", "pull_point": [0, 0, -1.0],
                 "points": [[0, 0, rise]]}], **entries,
    )  # fmt: skip


def test_at_prescribed_lengths_a_toggle_is_followed_through_its_limit_point(simulate):
    simulation = toggle(simulate)
    rest, tensions, heights = simulation.state.setpoints[0], [], []
    for travel in np.linspace(0.0, 0.024, 25):
        result = simulation.step(CommandSetpoints(np.array([rest - travel]), 1.0))
        assert result.status is Status.OK
        tensions.append(result.efforts[0])
        heights.append(nodes_of(simulation)[8, 2])
    assert np.allclose(heights, 0.02 - np.linspace(0.0, 0.024, 25), atol=1e-6)
    peak = int(np.argmax(tensions))
    assert 3 < peak < 18
    assert min(tensions[peak:]) < 0.9 * tensions[peak]


def test_at_a_tension_above_the_limit_a_dynamic_toggle_passes_through(simulate):
    still = toggle(simulate)
    rest = still.state.setpoints[0]
    limit = max(
        still.step(CommandSetpoints(np.array([rest - travel]), 1.0)).efforts[0]
        for travel in np.linspace(0.0, 0.02, 21)
    )
    moving = toggle(
        simulate, integration="dynamic",
        beam={"density": 1000.0, "damping": {"mass": 2.0, "stiffness": 0.001}},
    )  # fmt: skip
    for share, below in ((0.8, False), (1.15, True)):
        for _ in range(300):
            result = moving.step(CommandEfforts(np.array([share * limit]), 0.02))
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
        assert (nodes_of(moving)[8, 2] < 0.0) == below


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
    inertia = next(term for term in model.forces if term.name == "rigid inertia")
    blocks = np.zeros((3 * unknowns, 3 * unknowns))
    for k, (m, J) in enumerate(zip(inertia.masses, inertia.inertias, strict=True)):
        blocks[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = m * np.eye(3)
        R = simulation.model.nodes.kinds[0].pose(x, int(model.nodes.kinds[0].free_bodies[k]))[1]
        blocks[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = R @ J @ R.T
    values = np.linalg.eigvals(np.linalg.solve(blocks, stiffness)).real
    return np.sqrt(np.sort(values)[:count])


def test_natural_frequencies_of_a_cantilever_are_those_of_euler_and_bernoulli(simulate):
    simulation = simulate(
        gravity=[0, 0, 0], integration="dynamic", beams=[rod(elements=24, density=1000.0)]
    )
    found = frequencies(simulation, 6)
    scale = np.sqrt(RIGIDITY / (1000.0 * AREA))
    expected = scale * np.repeat([1.87510, 4.69409, 7.85476], 2) ** 2
    assert np.allclose(found, expected, rtol=[0.002, 0.002, 0.005, 0.005, 0.012, 0.012])


def test_the_sway_of_a_portal_has_the_frequency_of_its_dynamic_stiffness(simulate):
    # Two columns and a beam of one length and section, the feet clamped.
    legs = ((0, 0, 0), (0, 0, 1.0), (1.0, 0, 1.0), (1.0, 0, 0))
    portal = rod(points=legs, elements=48, density=1000.0, fixed=["start", "end"])
    simulation = simulate(gravity=[0, 0, 0], integration="dynamic", beams=[portal])

    def determinant(b):
        """Of sway and equal turns of the corners; Kolousek's functions at βL = b."""
        c, s, ch, sh = np.cos(b), np.sin(b), np.cosh(b), np.sinh(b)
        d = 1.0 - c * ch
        near, far = b * (ch * s - sh * c) / d, b * (sh - s) / d
        mixed, shear = b**2 * sh * s / d, b**3 * (ch * s + sh * c) / d
        # The beam between the columns is displaced along itself: its mass moves with the sway.
        return (2 * near + far) * (2 * shear - b**4) - 2 * mixed**2

    root = brentq(determinant, 1.2, 2.4)
    expected = root**2 * np.sqrt(RIGIDITY / (1000.0 * AREA))
    # Sways out of the plane are other modes: the nearest frequency must be this one.
    found = frequencies(simulation, 8)
    assert np.min(np.abs(found / expected - 1.0)) < 0.004


# --- rotation and joints --------------------------------------------------------------------------


def turned_rod(simulate, **entries):
    """A short rod whose end a guided body turns about its axis."""
    return simulate(
        gravity=[0, 0, 0],
        rigid_bodies=[{"name": "grip", "motion": "guided", "position": [0.2, 0, 0],
                       "sphere": {"radius": 0.01}, "turn_rate": 1000.0, "speed": 1000.0}],
        beams=[rod(points=((0, 0, 0), (0.2, 0, 0)), elements=12,
                   joined=[{"at": "end", "to": "grip"}], **entries)],
        solver={"newton_iterations": 40, "residual_tolerance": 1e-11},
    )  # fmt: skip


def test_a_rod_twisted_by_two_turns_holds_a_torque_in_proportion(simulate):
    section = {"constants": {"area": 1e-5, "inertia_y": 8e-12, "inertia_z": 8e-12,
                             "torsion": 3e-12}}  # fmt: skip
    simulation = turned_rod(simulate, section=section)
    shear = YOUNG / 2.6
    for angle in np.arange(0.25, 4.0 * np.pi + 0.1, 0.25):
        quaternion = quaternion_from_rotation(rotation_from_vector([angle, 0, 0]))
        simulation.model.guides.aim("grip", [0.2, 0, 0], quaternion)
        result = simulation.step(Hold(1.0))
        assert result.status is Status.OK
    twists = simulation.model.forces[0].deformations(simulation.state.positions)[:, 3]
    assert twists.sum() == pytest.approx(angle, rel=1e-9)
    energy = simulation.model.forces[0].energy(simulation.state.positions)
    assert energy == pytest.approx(0.5 * shear * 3e-12 / 0.2 * angle**2, rel=1e-6)
