"""Motion of second order in time: order, damping, momenta, contact, and states."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Status
from test.builder import builder
from test.scene_changes import repeat_step

EXACT = {"newton_iterations": 40, "residual_tolerance": 1e-11}
G = 9.81


def by_alpha(radius=0.8) -> dict:
    """The entries of a scene that ask for the scheme."""
    return {"integration": "dynamic", "time_scheme": "generalized_alpha", "spectral_radius": radius}


EULER = {"integration": "dynamic"}
SCHEMES = [(EULER, 1.0), *((by_alpha(radius), 2.0) for radius in (0.0, 0.8, 1.0))]


def orders(values) -> np.ndarray:
    """Order of convergence, from results with steps that are halved each time."""
    differences = [np.linalg.norm(a - b) for a, b in zip(values, values[1:], strict=False)]
    return np.log2(np.array(differences[:-1]) / differences[1:])


# --- one degree of freedom ------------------------------------------------------------------------

MASS, STIFFNESS = 0.1, 40.0
OMEGA = np.sqrt(STIFFNESS / MASS)


@builder
def hanging(scene_of, /, scheme, damping=0.0, stiffness=STIFFNESS, gravity=G):
    """A mass on a spring that its weight pulls from the spring's rest length."""
    return scene_of(
        gravity=[0, 0, -gravity], **scheme, solver=EXACT,
        mass_springs=[{"name": "point", "points": [[0, 0, -1.0]], "masses": [MASS]}],
        springs=[{
            "name": "spring", "stiffness": stiffness, "damping": damping, "rest_length": 1.0,
            "ends": [{"on": "point", "point": [0, 0, -1.0]},
                     {"on": "world", "point": [0, 0, 0]}],
        }],
    )  # fmt: skip


def heights(simulation, time_step, count) -> np.ndarray:
    """Height of the point above where it began after each step [m]."""
    return np.array([
        simulation.step(Hold(time_step)).state.positions[0, 2] + 1.0 for _ in range(count)
    ])  # fmt: skip


def swing(times, damping=0.0) -> np.ndarray:
    """The height by theory [m]."""
    ratio = damping / (2.0 * MASS * OMEGA)
    damped = OMEGA * np.sqrt(1.0 - ratio**2)
    wave = np.cos(damped * times) + ratio * OMEGA / damped * np.sin(damped * times)
    return -MASS * G / STIFFNESS * (1.0 - np.exp(-ratio * OMEGA * times) * wave)


@pytest.mark.exhaustive
@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("scheme, order", SCHEMES)
def test_a_mass_on_a_spring_converges_at_the_order_of_its_scheme(hanging, scheme, order, damping):
    errors = []
    for count in (75, 150, 300):
        found = heights(hanging(scheme, damping), 0.2 / count, count)
        errors.append(np.abs(found - swing(0.2 / count * np.arange(1, count + 1), damping)).max())
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), order, atol=0.2)


@pytest.mark.parametrize("radius", [0.8, 0.9, 1.0])
def test_a_slow_swing_keeps_its_amplitude_and_its_frequency(hanging, radius):
    step, count = 0.005, 600
    found = heights(hanging(by_alpha(radius)), step, count)
    middle, lowest = -MASS * G / STIFFNESS, found[count - 100 :].min()
    # ω h is 0.1: ten periods.
    assert lowest / middle == pytest.approx(2.0, abs=0.01 if radius < 1.0 else 1e-3)
    falls = np.flatnonzero((found[:-1] > middle) & (found[1:] <= middle))
    times = falls + (found[falls] - middle) / (found[falls] - found[falls + 1])
    period = step * np.diff(times).mean()
    # The phase error of the trapezoidal rule is (ω h)²/12.
    assert period == pytest.approx(2.0 * np.pi / OMEGA, rel=1.5e-3)


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.8, 0.95])
def test_a_step_multiplies_fast_vibrations_by_the_spectral_radius(hanging, radius):
    fast = hanging(by_alpha(radius), stiffness=1e9, gravity=0.0)
    fast.restore(replace(fast.state, velocities=np.array([[0.0, 0.0, 1.0]])))
    speeds = [abs(fast.step(Hold(0.01)).state.velocities[0, 2]) for _ in range(60)]
    if radius == 0.0:
        assert speeds[5] < 1e-6
        return
    rate = (speeds[55] / speeds[25]) ** (1.0 / 30.0)
    # The limit is a multiple root: speeds are a power times a polynomial of the step.
    assert rate == pytest.approx(radius, rel=0.06)


def test_steps_of_different_lengths_keep_the_second_order(hanging):
    errors = []
    for count in (100, 200, 400):
        simulation, time, worst = hanging(by_alpha(0.5)), 0.0, 0.0
        for index in range(count):
            step = (0.5 if index % 2 else 1.5) * 0.5 / count
            time += step
            found = simulation.step(Hold(step)).state.positions[0, 2] + 1.0
            worst = max(worst, abs(found - swing(np.array(time))))
        errors.append(worst)
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.2)


@pytest.mark.sampled
@pytest.mark.parametrize("radius", [0.0, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("lengths", ["one short", "one long", "random", "taking turns"])
def test_stiff_vibrations_never_grow_however_lengths_of_steps_change(hanging, radius, lengths, drawn_rng):
    """Stiff against the steps, by up to 60 in a step, without any damping but that of the scheme."""
    simulation = hanging(by_alpha(radius), stiffness=1e3 * STIFFNESS, gravity=0.0)
    simulation.restore(replace(simulation.state, positions=simulation.state.positions - [0.0, 0.0, 0.01]))
    far = []
    for index in range(600):
        step = {
            "one short": 0.01 if index % 4 == 3 else 0.1, "one long": 0.1 if index % 4 == 3 else 0.01,
            "random": 10.0 ** drawn_rng.uniform(-3.0, -1.0), "taking turns": 0.1 if index % 2 else 0.005,
        }[lengths]  # fmt: skip
        far.append(abs(simulation.step(Hold(step)).state.positions[0, 2] - simulation.model.nodes.rest_positions[0, 2]))
    assert max(far) < 1.5 * far[0] + 0.015 and max(far[-50:]) <= 0.011


# --- deformable bodies ----------------------------------------------------------------------------

HELD = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]


@builder
def soft(simulate, body_of, block, /, scheme, size=(0.03, 0.03, 0.06), cells=(1, 1, 2),
         gravity=(5.0, 0, 0), **entries):  # fmt: skip
    """A soft column, held or free."""
    mesh = block(size=size, cells=cells)
    return simulate(body=body_of(mesh, **entries), gravity=list(gravity), **scheme, solver=EXACT)


@pytest.mark.parametrize(
    "entries",
    [{}, {"mass": "consistent", "element": "quadratic"},
     {"damping": {"mass": 5.0}}, {"damping": {"stiffness": 0.004}}],
    ids=["lumped", "consistent", "mass damping", "strain-rate damping"],
)  # fmt: skip
@pytest.mark.parametrize("scheme, order", [SCHEMES[0], SCHEMES[2]], ids=["euler", "alpha"])
def test_a_soft_body_converges_at_the_order_of_its_scheme(soft, scheme, order, entries):
    simulation, found = soft(scheme, fixed=HELD, **entries), []
    for count in (32, 64, 128, 256):
        simulation.reset()
        repeat_step(simulation, Hold(0.04 / count), count)
        found.append(simulation.state.positions)
    assert orders(found)[-1] == pytest.approx(order, abs=0.35 if order == 1.0 else 0.25)


def let_go(simulation, stretch=1.1, turning=(2.0, -1.0, 3.0)):
    """Stretch a free body, and let it go while it turns."""
    rest = simulation.model.nodes.rest_positions
    positions = (rest - rest.mean(axis=0)) * [1.0, 1.0, stretch]
    state = replace(
        simulation.state, positions=positions, velocities=np.cross(turning, positions) + 0.1,
        past=None,
    )  # fmt: skip
    simulation.restore(state)


def momenta(simulation):
    """Momentum, and angular momentum about the origin, of a free body with lumped mass."""
    term = next(term for term in simulation.model.forces if term.name == "lumped inertia")
    state = simulation.state
    return (
        term.masses @ state.velocities,
        term.masses @ np.cross(state.positions, state.velocities),
    )


def test_a_free_soft_body_keeps_its_momentum_and_nearly_its_angular_momentum(soft):
    simulation, errors = soft(by_alpha(0.8), gravity=(0, 0, 0)), []
    for count in (20, 40, 80):
        simulation.reset()
        let_go(simulation)
        before = momenta(simulation)
        repeat_step(simulation, Hold(0.04 / count), count)
        after = momenta(simulation)
        np.testing.assert_allclose(after[0], before[0], rtol=1e-9)
        errors.append(np.linalg.norm(after[1] - before[1]) / np.linalg.norm(before[1]))
    assert errors[-1] < 2e-3
    assert np.log2(errors[0] / errors[-1]) / 2.0 > 1.7


def test_without_numerical_damping_the_energy_is_bounded(soft, energies):
    simulation = soft(by_alpha(1.0), fixed=HELD)
    start, found, fastest = sum(energies(simulation)), [], 0.0
    for _ in range(400):
        assert simulation.step(Hold(0.002)).status is Status.OK
        stored, moving = energies(simulation)
        found.append(stored + moving - start)
        fastest = max(fastest, moving)
    strays = np.abs(found) / fastest
    print("energy strays by", strays[:200].max(), strays[200:].max())
    assert strays.max() < 0.05
    assert strays[200:].max() < 2.0 * strays[:200].max()


def test_numerical_damping_takes_the_energy_of_fast_vibrations_and_leaves_slow_ones(soft, energies):
    """A blow shakes a held column, whose first period is some 0.1 s."""
    left = {}
    for name, scheme in (("euler", EULER), ("alpha", by_alpha(0.5)), ("none", by_alpha(1.0))):
        simulation = soft(scheme, fixed=HELD, gravity=(0, 0, 0))
        nodes = simulation.model.nodes
        height = nodes.rest_positions[nodes.free_nodes, 2] / 0.06
        shake = np.random.default_rng(5).standard_normal((nodes.free_node_count, 3))
        for motion, velocities in (
            ("slow", np.outer(height**2, [0.05, 0.0, 0.0])), ("fast", 0.05 * shake)
        ):  # fmt: skip
            simulation.reset()
            simulation.restore(replace(simulation.state, velocities=velocities))
            before = sum(energies(simulation))
            repeat_step(simulation, Hold(0.003), 60)
            left[name, motion] = sum(energies(simulation)) / before
    assert left["alpha", "slow"] > 2.0 * left["euler", "slow"]
    assert left["alpha", "fast"] < 0.6 * left["none", "fast"]
    assert 0.7 < left["none", "slow"] < 1.1


BAR = {"size": (0.1, 0.02, 0.02), "cells": (5, 1, 1)}
CLAMP = [{"box": {"minimum": [-1e-6, -1, -1], "maximum": [1e-6, 1, 1]}}]


def lowest(simulation, step) -> float:
    """Lowest height of a bar's tip in its first swing under its weight [mm]."""
    rest = simulation.model.nodes.rest_positions
    tip = np.argmin(np.linalg.norm(rest - [0.1, 0.02, 0.02], axis=1))
    swung = [simulation.step(Hold(step)).state.positions[tip, 2] for _ in range(int(0.16 / step))]
    return 1e3 * (min(swung) - rest[tip, 2])


def test_a_bar_released_under_its_weight_swings_as_far_with_long_steps_as_with_short_ones(soft):
    """An undamped bar; backward Euler loses a seventh of its swing with steps of 10 ms."""
    found = {}
    for name, scheme in (("euler", EULER), ("alpha", by_alpha(0.8))):
        bar = soft(
            scheme, **BAR, gravity=(0, 0, -G), element="quadratic", fixed=CLAMP,
            young_modulus=1.665e5,
        )  # fmt: skip
        for step in (0.01,) if name == "euler" else (0.002, 0.01):
            bar.reset()
            found[name, step] = lowest(bar, step)
    print(found)
    exact = found["alpha", 0.002]
    assert exact == pytest.approx(-42.1, abs=0.3)
    assert found["alpha", 0.01] == pytest.approx(exact, abs=0.15)
    assert found["euler", 0.01] > exact + 5.0


@pytest.mark.sampled
@pytest.mark.parametrize("damping", [{}, {"stiffness": 0.002}, {"mass": 4.0}])
def test_a_beam_converges_at_the_second_order(simulate, damping):
    """An elastic beam released sideways under its weight, with rotary inertia."""
    simulation = simulate(
        gravity=[0.0, 3.0, -G], **by_alpha(0.8),
        solver={"newton_iterations": 40, "residual_tolerance": 1e-10},
        beams=[{
            "name": "rod", "points": [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]], "elements": 4,
            "section": {"rectangle": {"thickness": 0.006, "width": 0.01}}, "thickness_direction": [0, 0, 1],
            "fixed": ["start"], "damping": damping,
            "material": {"young_modulus": 5e6, "poisson_ratio": 0.3, "density": 1100.0},
        }],
    )  # fmt: skip
    found, ways = [], []
    # Undamped, the second order shows where steps resolve the modes of up to 370 Hz.
    for count in (16, 64, 256, 512, 1024):
        simulation.reset()
        way = [simulation.step(Hold(0.06 / count)).state.positions for _ in range(count)]
        found.append(way[-1])
        ways.append(1e3 * np.array(way)[count // 16 - 1 :: count // 16, -4])
    errors = [np.linalg.norm(way - ways[-1], axis=1).max() for way in ways[:-1]]
    reach = np.linalg.norm(ways[-1][-1] - [200.0, 0.0, 0.0])
    print(f"damping {damping}: the tip goes {reach:.1f} mm and misses by {np.round(errors, 4)} mm")
    assert reach > 20.0
    assert errors[0] < 5e-3 * reach and errors[1] < 6e-4 * reach
    assert orders(found)[-1] == pytest.approx(2.0, abs=0.3)


# --- rigid bodies ---------------------------------------------------------------------------------


@builder
def tumbling(scene_of, /, scheme, turning=(0.05, 8.0, 0.02), gravity=0.0):
    """A free box that turns about its middle axis, nearly."""
    return scene_of(gravity=[0, 0, -gravity], **scheme, solver=EXACT, rigid_bodies=[{
        "name": "box", "box": {"size": [0.02, 0.05, 0.09]}, "density": 1000.0,
        "velocity": [0.3, -0.2, 0.1], "angular_velocity": list(turning),
    }])  # fmt: skip


def test_a_tumbling_body_keeps_its_momenta_and_its_energy(tumbling):
    """Dzhanibekov's nut: the middle axis turns over again and again."""
    simulation = tumbling(by_alpha(0.8))
    inertia = next(term for term in simulation.model.forces if term.is_inertia)
    state = simulation.state
    before = inertia.angular_momenta(state.positions, state.velocities)
    energy, axes, energies = inertia.kinetic_energy(state.positions, state.velocities), [], []
    for _ in range(800):
        state = simulation.step(Hold(0.01)).state
        axes.append(state.positions[2, 1] - state.positions[0, 1])
        energies.append(inertia.kinetic_energy(state.positions, state.velocities) / energy - 1.0)
    after = inertia.angular_momenta(state.positions, state.velocities)
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-9 * np.linalg.norm(before))
    np.testing.assert_allclose(state.velocities[0], [0.3, -0.2, 0.1], rtol=1e-8)
    turns = np.count_nonzero(np.diff(np.sign(axes)))
    assert turns >= 3
    # No drift: the second half strays no further than the first.
    print("energy strays by", np.abs(energies).max(), "turns", turns)
    assert np.abs(energies).max() < 5e-3
    assert np.abs(energies[400:]).max() < 1.2 * np.abs(energies[:400]).max()


@pytest.mark.exhaustive
@pytest.mark.parametrize("scheme, order", SCHEMES)
def test_rotations_converge_at_the_order_of_the_scheme(scene_of, scheme, order):
    """A box on a spring that is attached at its corner: torque, and coupled axes."""
    found = []
    for count in (40, 80, 160, 320):
        simulation = scene_of(
            gravity=[0, 0, -G], **scheme, solver=EXACT,
            rigid_bodies=[{
                "name": "box", "box": {"size": [0.02, 0.05, 0.09]}, "mass": 0.1,
                "angular_velocity": [3.0, 8.0, 2.0],
            }],
            springs=[{"name": "band", "stiffness": 20.0, "rest_length": 0.1, "damping": 0.05,
                      "ends": [{"on": "box", "point": [0.01, 0.025, 0.045]},
                               {"on": "world", "point": [0.05, 0.0, 0.15]}]}],
        )  # fmt: skip
        repeat_step(simulation, Hold(0.2 / count), count)
        found.append(simulation.state.positions)
    assert orders(found)[-1] == pytest.approx(order, abs=0.3)


def test_a_free_body_falls_as_in_theory_to_the_last_digit(tumbling):
    simulation = tumbling(by_alpha(0.7), gravity=G)
    start = simulation.state.positions[0].copy()
    repeat_step(simulation, Hold(0.01), 50)
    expected = start + 0.5 * np.array([0.3, -0.2, 0.1]) - [0.0, 0.0, 0.5 * G * 0.25]
    np.testing.assert_allclose(simulation.state.positions[0], expected, atol=1e-11)


# --- contact --------------------------------------------------------------------------------------

EDGE, FRICTION, STEP = 0.04, 0.5, 0.002


@builder
def box(scene_of, /, angle=0.0, height=0.0, scheme=None, **entries):
    """A rigid box over a level plane, gravity tilted by an angle."""
    return scene_of(
        gravity=[G * np.sin(angle), 0.0, -G * np.cos(angle)],
        **(by_alpha() if scheme is None else scheme),
        obstacles=[{"name": "slope", "plane": {}}],
        contact={"friction": FRICTION, "between": [{"pair": ["box", "slope"]}]},
        rigid_bodies=[{"name": "box", "mass": 0.03, "position": [0, 0, EDGE / 2 + height],
                       "box": {"size": [EDGE] * 3}, **entries}],
    )  # fmt: skip


def test_a_block_at_rest_on_a_plane_stays_at_rest(box):
    simulation = box()
    start = simulation.state.positions
    for _ in range(100):
        result = simulation.step(Hold(STEP))
        np.testing.assert_allclose(result.state.positions, start, atol=1e-12)
        assert np.abs(result.state.velocities).max() < 1e-9
        np.testing.assert_allclose(result.contacts.forces.sum(axis=0), [0, 0, 0.03 * G], atol=1e-9)


@pytest.mark.parametrize("radius", [0.5, 0.8, 1.0])
@pytest.mark.parametrize("step", [0.0005, 0.005])
def test_a_block_that_falls_on_a_plane_comes_to_rest_at_once(box, radius, step):
    simulation = box(height=0.05, scheme=by_alpha(radius))
    energies, forces = [], []
    inertia = next(term for term in simulation.model.forces if term.is_inertia)
    for _ in range(int(0.2 / step)):
        result = simulation.step(Hold(step))
        state = result.state
        moving = inertia.kinetic_energy(state.positions, state.velocities)
        energies.append(moving + 0.03 * G * state.positions[0, 2])
        forces.append(0.0 if result.contacts is None else result.contacts.forces[:, 2].sum())
        assert state.positions[0, 2] > EDGE / 2 - 1e-9
    scale = 0.03 * G * 0.05
    assert np.diff(energies).max() < 1e-7 * scale
    # It touches once and for all, and six steps after that its force is the weight.
    forces = np.array(forces)
    first = np.flatnonzero(forces > 0.0)[0]
    assert (forces[first:] > 0.0).all()
    np.testing.assert_allclose(forces[first + 8 :], 0.03 * G, rtol=0.01)
    np.testing.assert_allclose(forces[-5:], 0.03 * G, rtol=1e-3)
    assert abs(state.velocities[0, 2]) < 1e-5


def test_a_block_sticks_two_percent_below_the_limit(box):
    simulation = box(np.arctan(0.98 * FRICTION))
    way = [simulation.step(Hold(STEP)).state.positions[0, 0] for _ in range(500)]
    assert np.abs(way).max() < 1e-8
    assert abs(way[-1] - way[249]) < 1e-9


def test_a_block_slides_two_percent_above_the_limit_without_an_error_of_time(box):
    angle = np.arctan(1.02 * FRICTION)
    simulation = box(angle)
    way = []
    for _ in range(500):
        result = simulation.step(Hold(STEP))
        way.append(result.state.positions[0, 0])
        force = result.contacts.forces.sum(axis=0)
        assert np.hypot(*force[:2]) <= FRICTION * force[2] * (1.0 + 1e-9)
    time = STEP * np.arange(1, 501)
    pull = G * (np.sin(angle) - FRICTION * np.cos(angle))
    # Backward Euler goes ½ a t (t + h).
    np.testing.assert_allclose(way, 0.5 * pull * time**2, atol=1e-7)


def test_a_thrown_block_is_decelerated_and_stops(box):
    simulation = box(velocity=[0.2, 0.0, 0.0])
    way = [simulation.step(Hold(STEP)).state.positions[0, 0] for _ in range(200)]
    assert way[-1] == pytest.approx(0.2**2 / (2.0 * FRICTION * G), rel=0.05)
    assert abs(way[-1] - way[100]) < 1e-7


@pytest.mark.parametrize("tilt", [[0.3, 0.2, 0.0], [0.0, 0.7, 0.0]])
def test_a_block_that_lands_on_a_corner_gains_no_energy(box, tilt):
    simulation = box(height=0.05, rotation=tilt)
    inertia = next(term for term in simulation.model.forces if term.is_inertia)
    energies = []
    for _ in range(400):
        result = simulation.step(Hold(STEP))
        state = result.state
        moving = inertia.kinetic_energy(state.positions, state.velocities)
        energies.append(moving + 0.03 * G * state.positions[0, 2])
        if result.contacts is not None and len(result.contacts.forces):
            force = result.contacts.forces
            assert np.all(np.hypot(force[:, 0], force[:, 1]) <= FRICTION * force[:, 2] + 1e-9)
    scale = energies[0] - 0.03 * G * EDGE / 2
    assert (energies - np.minimum.accumulate(energies)).max() < 5e-3 * scale
    assert np.abs(state.velocities).max() < 1e-3


@pytest.mark.parametrize("step", [0.001, 0.004])
def test_a_soft_block_that_falls_gains_no_energy_and_comes_to_rest(scene_of, write_block, energies, step):
    simulation = scene_of(
        gravity=[0, 0, -G], **by_alpha(), solver={"newton_iterations": 10},
        obstacles=[{"name": "floor", "plane": {}}],
        contact={"friction": 0.3, "between": [{"pair": ["box", "floor"]}]},
        body={"name": "box", "element": "linear", "damping": {"stiffness": 0.002},
              "mesh": {"file": write_block((0.04, 0.04, 0.02), (2, 2, 1)),
                       "translation": [0, 0, 0.03]},
              "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0}},
    )  # fmt: skip
    weight = 0.04 * 0.04 * 0.02 * 1000.0 * G
    found, forces = [sum(energies(simulation))], []
    for _ in range(int(0.6 / step)):
        result = simulation.step(Hold(step))
        found.append(sum(energies(simulation)))
        total = 0.0 if result.contacts is None else result.contacts.forces[:, 2].sum()
        forces.append(total)
    assert (found - np.minimum.accumulate(found)).max() < 0.02 * weight * 0.02
    assert max(found) <= found[0] + 1e-6 * weight * 0.02
    np.testing.assert_allclose(forces[-20:], weight, rtol=0.02)
    assert np.abs(result.state.velocities).max() < 0.01


# --- actuators ------------------------------------------------------------------------------------


def test_the_tension_of_a_cable_that_is_wound_does_not_ring(beam):
    """It is wound by a ramp, then held."""

    def in_motion(mapping):
        mapping.update(by_alpha(0.8))
        mapping["body"]["damping"] = {"mass": 20.0, "stiffness": 0.01}
        mapping["solver"] = {"newton_iterations": 10, "residual_tolerance": 1e-8}

    simulation, tensions = beam(in_motion), []
    for index in range(120):
        wanted = simulation.rest_setpoints.copy()
        wanted[0] -= 1e-3 * min(index, 20) / 20.0
        tensions.append(simulation.step(CommandSetpoints(wanted, 0.004)).efforts[0])
    tensions = np.array(tensions)
    assert tensions[-1] > 0.05
    np.testing.assert_allclose(tensions[-30:], tensions[-1], rtol=0.02)
    # After the ramp no tension is further from the last one than when it ended, half and half.
    strays = np.abs(tensions[24:] - tensions[-1])
    assert strays[10:].max() < 0.6 * max(strays[:3].max(), 0.1 * tensions[-1])


def test_a_robot_in_motion_follows_its_target_and_comes_to_rest(beam):
    """Steps towards targets do not swing between the limits of the cables."""

    def in_motion(mapping):
        mapping.update(by_alpha(0.8))
        mapping["body"]["damping"] = {"mass": 5.0, "stiffness": 0.005}

    simulation = beam(in_motion)
    start = simulation.effector_positions()
    for index in range(120):
        target = start + np.array([[0.01, 0.004, 0.0]]) * min(index, 40) / 40.0
        result = simulation.step(FollowTargets(target, 0.01))
    assert np.abs(result.effector_errors[0]) < 1e-2
    assert np.abs(result.state.velocities).max() < 1e-2


# --- states and scenes ----------------------------------------------------------------------------


def test_a_state_put_back_goes_on_as_if_nothing_had_been_to_the_bit(tumbling, soft):
    for make in (lambda: tumbling(by_alpha(), gravity=G), lambda: soft(by_alpha(), fixed=HELD)):
        one, other = make(), make()
        repeat_step(one, Hold(0.003), 7)
        other.restore(one.state)
        for step in (0.003, 0.002, 0.004):
            one.step(Hold(step))
            other.step(Hold(step))
            for name in ("positions", "velocities"):
                first, second = (getattr(s.state, name) for s in (one, other))
                np.testing.assert_array_equal(first, second)
            np.testing.assert_array_equal(one.state.past.accelerations,
                                          other.state.past.accelerations)  # fmt: skip


def test_a_reset_run_is_the_same_to_the_bit(box):
    simulation, found = box(height=0.003), []
    for _ in range(2):
        simulation.reset()
        assert simulation.state.past is None
        repeat_step(simulation, Hold(STEP), 30)
        found.append(simulation.state)
    np.testing.assert_array_equal(found[0].positions, found[1].positions)
    np.testing.assert_array_equal(found[0].past.contact_forces, found[1].past.contact_forces)


def test_backward_euler_keeps_no_past(tumbling):
    simulation = tumbling(EULER)
    simulation.step(Hold(0.001))
    assert simulation.state.past is None


def test_a_past_of_another_scheme_or_scene_is_refused(tumbling, box):
    simulation = tumbling(by_alpha())
    simulation.step(Hold(0.001))
    past = simulation.state.past
    for other in (tumbling(EULER), box()):
        with pytest.raises(CommandError, match="not of this scene"):
            other.restore(replace(other.state, past=past))


def test_a_body_in_contact_stays_for_a_thousand_steps(box):
    simulation = box(np.arctan(0.5 * FRICTION))
    repeat_step(simulation, Hold(STEP), 1000)
    assert abs(simulation.state.positions[0, 0]) < 1e-9
    assert np.abs(simulation.state.velocities).max() < 1e-9
