"""Consistent mass of beams: closed forms, derivatives, conservation."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Status
from test.scene_changes import repeat_step

YOUNG, RADIUS, DENSITY = 1.0e7, 0.002, 1000.0
INERTIA, AREA = np.pi * RADIUS**4 / 4.0, np.pi * RADIUS**2


def rod(name="rod", points=((0, 0, 0), (0.3, 0, 0)), elements=4, **entries) -> dict:
    return {
        "name": name, "points": [list(map(float, p)) for p in points], "elements": elements,
        "section": {"circle": {"radius": RADIUS}},
        "material": {"young_modulus": YOUNG, "poisson_ratio": 0.3, "density": DENSITY}, **entries,
    }  # fmt: skip


def joined_scene() -> dict:
    """A floating block; on it a bent strip with an offset end, a hinged rod and one on a ball joint."""
    block = {"name": "block", "position": [0.0, 0.01, 0.0], "mass": 0.02, "rotation": [0.3, 0.2, 0.9],
             "box": {"size": [0.03, 0.02, 0.01]}}  # fmt: skip
    strip = rod(
        "strip", ((0.02, 0, 0), (0.1, 0.03, 0), (0.2, 0, 0.05)), 4, curve="smooth",
        section={"rectangle": {"thickness": 0.002, "width": 0.012}}, thickness_direction=[0, 0, 1],
        joined=[{"at": "start", "to": "block"}], damping={"mass": 0.7},
    )  # fmt: skip
    bar = rod("bar", ((-0.01, 0, 0), (-0.1, 0, 0.02)), 2,
              joined=[{"at": "start", "to": "block", "by": "hinge", "axis": [0, 1, 0.2]}])  # fmt: skip
    arm = rod("arm", ((0.2, 0, 0.05), (0.2, 0.1, 0.05)), 2,
              joined=[{"at": "start", "to": "strip", "by": "ball"}])  # fmt: skip
    return {"gravity": [0.0, 0.0, -9.81], "integration": "dynamic",
            "rigid_bodies": [block], "beams": [strip, bar, arm]}  # fmt: skip


def terms_of(simulation) -> dict:
    return {term.name: term for term in simulation.model.forces}


def bent(simulation, drawn_rng, size=0.3):
    """Positions after a random move of all unknowns."""
    x = np.array(simulation.model.nodes.rest_positions)
    move = size * drawn_rng.normal(size=(simulation.model.nodes.free_node_count, 3))
    simulation.model.nodes.advance(x, move, 1.0)
    return x


def tangent(term, simulation, x, projected=False) -> np.ndarray:
    """The stiffness of a term as a dense symmetric matrix."""
    count = simulation.model.nodes.free_node_count
    storage = np.zeros(9 * count * count)
    term.bind(np.arange(count), lambda a, b: (9 * (np.asarray(b) * count + a), np.full(len(a), 3)))
    term.add(x, np.zeros((count, 3)), storage, projected)
    blocks = storage.reshape(count, count, 3, 3).transpose(1, 3, 0, 2)
    lower = np.tril(np.ones((count, count)))[:, None, :, None]
    K = (blocks * lower).reshape(3 * count, 3 * count)
    diagonal = (blocks * np.eye(count)[:, None, :, None]).reshape(3 * count, 3 * count)
    return K + K.T - diagonal


def potential(term, x) -> float:
    """½ c (z - a)ᵀ M (z - a) - F₀·z, whose slope are the forces of a term."""
    term = term.on_points
    z, m = term.ends(x), term.masses.matrices
    away = z - term.aims
    bent = np.einsum("e,eki,ekl,eli->", term.factors, away, m, away)
    return 0.5 * bent - np.sum(term.constants * z)


@pytest.mark.parametrize("name", ["inertia of beams", "weight of beams", "mass damping of beams"])
def test_forces_and_stiffness_are_the_slopes_of_a_potential(simulate, drawn_rng, name):
    simulation = simulate(**joined_scene())
    term, nodes = terms_of(simulation)[name], simulation.model.nodes
    start = bent(simulation, drawn_rng, 0.2)
    velocities = drawn_rng.normal(size=(nodes.free_node_count, 3))
    term.begin_step(start, velocities, 0.1)
    x, forces = start.copy(), np.zeros_like(velocities)
    nodes.advance(x, 0.1 * drawn_rng.normal(size=velocities.shape), 1.0)
    term.add_forces(x, forces)
    K, step = tangent(term, simulation, x), 1e-2
    scale = np.abs(K).max()
    for _ in range(20):
        move = drawn_rng.normal(size=velocities.shape)
        at = {}
        for place in (-2, -1, 0, 1, 2):
            moved = x.copy()
            nodes.advance(moved, place * step * move, 1.0)
            at[place] = potential(term, moved)
        slope = (at[-2] - 8.0 * at[-1] + 8.0 * at[1] - at[2]) / (12.0 * step)
        bend = (16.0 * (at[1] + at[-1]) - at[2] - at[-2] - 30.0 * at[0]) / (12.0 * step**2)
        size = scale * np.sum(move * move)
        assert -slope == pytest.approx(np.sum(forces * move), abs=1e-6 * size)
        assert bend == pytest.approx(move.ravel() @ K @ move.ravel(), abs=1e-6 * size)
    if name != "weight of beams":
        assert np.linalg.eigvalsh(tangent(term, simulation, x, projected=True))[0] > -1e-12 * scale


def test_a_move_is_undone_to_round_off(simulate, drawn_rng):
    simulation = simulate(**joined_scene())
    x, frames = bent(simulation, drawn_rng), simulation.model.nodes.kinds[0]
    move = drawn_rng.normal(size=(simulation.model.nodes.free_node_count, 3))
    moved = x.copy()
    frames.advance(moved, move, 1.0)
    frames.recede(moved, move)
    assert np.allclose(moved, x, atol=1e-12)


def test_kinetic_energy_is_that_of_all_points(simulate, drawn_rng):
    """A rigid motion of a bar has ½ m v² + ½ ω·J ω, at any number of elements."""
    for elements in (1, 3):
        bar = rod(elements=elements, section={"rectangle": {"thickness": 0.02, "width": 0.03}},
                  thickness_direction=[0, 1, 0])  # fmt: skip
        simulation = simulate(integration="dynamic", gravity=[0, 0, 0], beams=[bar])
        x, (v, w) = simulation.model.nodes.rest_positions, drawn_rng.normal(size=(2, 3))
        nodes = simulation.model.beams[0].places
        velocities = np.empty((2 * len(nodes), 3))
        velocities[0::2], velocities[1::2] = v + np.cross(w, nodes), w
        m = DENSITY * 0.02 * 0.03 * 0.3
        J = m / 12.0 * np.diag([0.02**2 + 0.03**2, 0.3**2 + 0.03**2, 0.3**2 + 0.02**2])
        centre = v + np.cross(w, [0.15, 0, 0])
        expected = 0.5 * m * centre @ centre + 0.5 * w @ J @ w
        found = terms_of(simulation)["inertia of beams"].kinetic_energy(x, velocities)
        assert found == pytest.approx(expected, rel=1e-12)


def test_accelerations_solve_the_whole_mass_matrix(simulate, drawn_rng):
    """Free bodies, beams, hinges and ball joints together: M a = f by the slope of the inertia."""
    simulation = simulate(**joined_scene())
    names = terms_of(simulation)
    x, count = bent(simulation, drawn_rng), simulation.model.nodes.free_node_count
    forces, accelerations = drawn_rng.normal(size=(count, 3)), np.zeros((count, 3))
    M = np.zeros((3 * count, 3 * count))
    for name in ("rigid inertia", "inertia of beams"):
        names[name].weight = 1.0
        names[name].begin_step(x, np.zeros((count, 3)), 1.0)
        M += tangent(names[name], simulation, x)
        names[name].add_accelerations(x, forces, accelerations)
    used = np.diagonal(M) > 0.0
    assert np.allclose((M @ accelerations.ravel())[used], forces.ravel()[used], atol=1e-8)


def momentum(simulation, before, after, step) -> np.ndarray:
    """∫ρ (x - x₀)/h dV of beams and rigid bodies."""
    inertia = terms_of(simulation)["inertia of beams"].on_points
    moved = inertia.ends(after) - inertia.ends(before)
    total = np.einsum("ek,eki->i", inertia.masses.borne, moved)
    for part in simulation.model.rigid:
        total += part.mass * (after - before)[part.first_node]
    return total / step


@pytest.mark.parametrize("order", [1, 2])
def test_what_floats_falls_freely(simulate, order):
    scene = joined_scene()
    del scene["beams"][0]["damping"]
    if order == 2:
        scene["time_scheme"] = "generalized_alpha"
    simulation = simulate(solver={"newton_iterations": 30, "residual_tolerance": 1e-12}, **scene)
    start, step, count = simulation.state.positions.copy(), 0.01, 20
    for _ in range(count):
        assert simulation.step(Hold(step)).status is Status.OK
    moved = simulation.state.positions - start
    steps = count * (count + 1) / 2 if order == 1 else count**2 / 2
    expected = -9.81 * step**2 * steps
    assert np.allclose(moved[:, 2], expected, atol=1e-8)
    assert np.abs(moved[:, :2]).max() < 1e-8


def test_a_floating_robot_keeps_its_momentum(simulate, drawn_rng):
    scene = joined_scene() | {"gravity": [0.0, 0.0, 0.0]}
    del scene["beams"][0]["damping"]
    scene["rigid_bodies"][0] |= {"velocity": list(drawn_rng.normal(size=3)),
                                 "angular_velocity": list(5.0 * drawn_rng.normal(size=3))}  # fmt: skip
    simulation = simulate(solver={"newton_iterations": 60, "residual_tolerance": 1e-12}, **scene)
    step, found = 0.002, []
    for _ in range(30):
        before = simulation.state.positions.copy()
        simulation.step(Hold(step))
        found.append(momentum(simulation, before, simulation.state.positions, step))
    assert np.ptp(found, axis=0).max() < 1e-6 * np.abs(found).max()


@pytest.mark.sampled
@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_a_steady_spin_stretches_a_rod_by_its_centrifugal_force(simulate, scheme):
    """EA u' = ρA ω² (L² - s²)/2, so u = ρ ω² L³/(3 E)."""
    length, rate, step = 0.15, 20.0, 2.0e-4
    hub = {"name": "hub", "mass": 1e3, "position": [0, 0, 0], "box": {"size": [0.1, 0.1, 0.1]},
           "angular_velocity": [0, 0, rate]}  # fmt: skip
    simulation = simulate(
        integration="dynamic", gravity=[0, 0, 0], rigid_bodies=[hub], time_scheme=scheme,
        beams=[rod(points=((0, 0, 0), (length, 0, 0)), elements=2, damping={"stiffness": 5e-5},
                   joined=[{"at": "start", "to": "hub"}])],
        solver={"newton_iterations": 40, "residual_tolerance": 1e-6},
    )  # fmt: skip
    beam, velocities = simulation.model.beams[0], simulation.state.velocities.copy()
    velocities[2::2] = np.cross([0, 0, rate], beam.places[1:])
    velocities[3::2] = [0, 0, rate]
    simulation.restore(replace(simulation.state, velocities=velocities))
    repeat_step(simulation, Hold(step), 1500)
    deformations = simulation.model.forces[0].deformations(simulation.state.positions)
    expected = DENSITY * rate**2 * length**3 / 3.0 / YOUNG
    assert deformations[:, 0].sum() - length == pytest.approx(expected, rel=0.02)


@pytest.mark.exhaustive
def test_the_scheme_of_second_order_is_one_for_a_tumbling_beam(simulate):
    spin = np.array([3.0, -2.0, 4.0])
    bar = rod(points=((0, 0, 0), (0.2, 0, 0)), section={"rectangle": {"thickness": 0.01, "width": 0.02}},
              material={"young_modulus": 1e5, "poisson_ratio": 0.3, "density": DENSITY},
              thickness_direction=[0, 1, 0])  # fmt: skip
    ends = []
    for count in (50, 100, 200, 800):
        simulation = simulate(
            integration="dynamic", gravity=[0, 0, 0], time_scheme="generalized_alpha", beams=[bar],
            solver={"newton_iterations": 40, "residual_tolerance": 1e-10},
        )  # fmt: skip
        velocities = simulation.state.velocities.copy()
        velocities[0::2] = np.cross(spin, simulation.model.beams[0].places)
        velocities[1::2] = spin
        simulation.restore(replace(simulation.state, velocities=velocities))
        repeat_step(simulation, Hold(0.05 / count), count)
        ends.append(simulation.state.positions)
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    print(errors)
    assert errors[0] / errors[1] > 3.5 and errors[1] / errors[2] > 3.5
