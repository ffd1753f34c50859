"""Beams, rigid bodies, tetrahedra, springs and cables in one scene, coupled by one kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.rigid_bodies import write_frame
from softrobot_twin.simulation import CommandSetpoints
from test.builder import builder
from test.scene_changes import solved

STRUT = {
    "name": "strut_#", "repeat": {"names": ["a", "b"], "step": [0.0, 0.02, 0.0]},
    "points": [[0.0, -0.01, 0.0], [0.1, -0.01, 0.0]], "elements": 3,
    "section": {"circle": {"radius": 0.002}},
    "joined": [{"at": "start", "to": "h*"}, {"at": "end", "to": "h*"}],
    "material": {"young_modulus": 50e6, "poisson_ratio": 0.3, "density": 1000.0},
}  # fmt: skip
CLAMPED = {**STRUT, "joined": STRUT["joined"][1:], "fixed": ["start"]}
HUB = {"name": "hub", "position": [0.105, 0.0, 0.0], "mass": 0.005,
       "box": {"size": [0.01, 0.03, 0.01]}}  # fmt: skip
HANDLE = {**HUB, "name": "handle", "position": [-0.005, 0.0, 0.0]}
SPRING = {"name": "stay", "stiffness": 3.0, "rest_length": 0.04,
          "ends": [{"on": "soft", "point": [0.17, 0.0, 0.0]},
                   {"on": "strut_a", "point": [0.05, -0.01, 0.0]}]}  # fmt: skip
THREAD = {
    "name": "thread", "body": "hub", "also_on": ["strut_*", "soft"], "pull_point_on": "strut_b",
    "pull_point": [0.02, 0.01, 0.01], "shortening": [0.0, 0.05],
    "points": [[0.05, -0.01, 0.008], [0.105, 0.0, 0.004], [0.13, 0.002, 0.004],
               [0.16, 0.001, 0.003]],
}  # fmt: skip


@builder
def hybrid(simulate, body_of, block, /, **entries):
    """Two struts between a handle and a hub with a soft block, a spring and a cable over all."""
    entry = body_of(block(size=(0.06, 0.02, 0.01), cells=(3, 2, 1), shake=0.0))
    box = {"minimum": [0.109, -1.0, -1.0], "maximum": [0.111, 1.0, 1.0]}
    entry["mesh"]["translation"] = [0.11, -0.01, -0.005]
    scene = {
        "bodies": [{**entry, "attached": [{"to": "hub", "box": box}]}], "beams": [STRUT],
        "rigid_bodies": [HUB, {**HANDLE, "name": "hold"}], "springs": [SPRING],
        "cables": [THREAD], "integration": "dynamic",
        "effectors": [{"name": "tip", "body": "soft", "points": [[0.17, 0.0, 0.0]]}],
    }  # fmt: skip
    return simulate(**{**scene, **entries})


def deformed(simulation, seed):
    """Node positions after a random move of all unknowns: millimetres and a tenth of a radian."""
    print(f"seed {seed}")
    nodes, draw = simulation.model.nodes, np.random.default_rng(seed)
    move = 2e-3 * draw.uniform(-1.0, 1.0, (nodes.free_node_count, 3))
    move[nodes.kinds[0].rotations] *= 50.0
    positions = nodes.rest_positions.copy()
    nodes.advance(positions, move, 1.0)
    return positions


def elastic(simulation):
    """The terms that do not depend on motion or gravity."""
    return [term for term in simulation.model.forces
            if not any(word in term.name for word in ("inertia", "gravity", "damping"))]


def forces_of(simulation, terms, positions):
    forces = np.zeros((simulation.model.nodes.free_node_count, 3))
    for term in terms:
        term.add_forces(positions, forces)
    return forces


def cable_forces(simulation, positions, tension=1.0):
    """Forces of the cable on the unknowns, h λ."""
    rows = simulation.model.rows
    rows.evaluate(positions)
    forces = np.zeros((simulation.model.nodes.free_node_count, 3))
    first = rows.row_index == 0
    np.add.at(forces, rows.node_index[first], tension * rows.blocks[first])
    return forces


def resultant(simulation, positions, forces):
    """Force [N] and moment about the origin [N m] of forces and torques on the unknowns."""
    nodes, frames = simulation.model.nodes, simulation.model.nodes.kinds[0]
    moment = np.cross(positions[nodes.free_nodes], forces[: len(nodes.free_nodes)]).sum(axis=0)
    moment += np.cross(positions[frames.origins], forces[frames.translations]).sum(axis=0)
    pushes = np.vstack([forces[: len(nodes.free_nodes)], forces[frames.translations]])
    return pushes.sum(axis=0), moment + forces[frames.rotations].sum(axis=0)


def moved(simulation, positions, rotation, shift):
    """Node positions after a rigid motion of everything."""
    nodes, frames = simulation.model.nodes, simulation.model.nodes.kinds[0]
    others = np.arange(frames.first_node)
    result = positions.copy()
    result[others] = positions[others] @ rotation.T + shift
    for body in range(frames.body_count):
        origin, turn = frames.pose(positions, body)
        write_frame(rotation @ origin + shift, rotation @ turn, result, frames.first_node + 4 * body)
    assert len(nodes.rest_positions) == frames.first_node + 4 * frames.body_count
    return result


def test_each_part_acts_on_the_others_as_they_act_on_it(hybrid):
    simulation = hybrid(gravity=[0.0, 0.0, 0.0])
    terms = elastic(simulation)
    assert len(terms) == 3
    positions = deformed(simulation, np.random.randint(2**31))
    for term in terms:
        forces = forces_of(simulation, [term], positions)
        assert np.abs(forces).max() > 1e-3
        for total in resultant(simulation, positions, forces):
            np.testing.assert_allclose(total, 0.0, atol=1e-10 * np.abs(forces).max())
    for total in resultant(simulation, positions, cable_forces(simulation, positions)):
        np.testing.assert_allclose(total, 0.0, atol=1e-12)


def test_the_weight_of_a_hybrid_is_that_of_all_its_parts(hybrid):
    simulation = hybrid(gravity=[0.0, 0.0, -9.81])
    terms = [
        term for term in simulation.model.forces if term.name in ("gravity", "weight of beams")
    ]
    assert len(terms) == 2
    positions = simulation.state.positions
    force, moment = resultant(simulation, positions, forces_of(simulation, terms, positions))
    model = simulation.model
    struts = sum(beam.mass for beam in model.beams)
    weight = 9.81 * (0.010 + struts + model.bodies[0].mass)
    np.testing.assert_allclose(force, [0.0, 0.0, -weight], atol=1e-12)
    about_y = 9.81 * (0.005 * (0.105 - 0.005) + struts * 0.05 + model.bodies[0].mass * 0.14)
    np.testing.assert_allclose(moment, [0.0, about_y, 0.0], atol=1e-8)


def test_a_rigid_motion_of_a_hybrid_stores_no_energy_and_moves_no_cable(hybrid):
    simulation = hybrid(gravity=[0.0, 0.0, 0.0], springs=[{**SPRING, "rest_length": None}])
    terms, rest = elastic(simulation), simulation.model.nodes.rest_positions
    draw = np.random.default_rng(seed := np.random.randint(2**31))
    print(f"seed {seed}")
    rotation = Rotation.from_rotvec(draw.uniform(-2.0, 2.0, 3)).as_matrix()
    placed = moved(simulation, rest, rotation, draw.uniform(-0.5, 0.5, 3))
    bent = deformed(simulation, seed)
    scale = sum(term.energy(bent) for term in terms)
    assert scale > 1e-6
    assert abs(sum(term.energy(placed) for term in terms)) < 1e-12 * scale
    turned = moved(simulation, bent, rotation, np.array([0.3, -0.2, 0.1]))
    for term in terms:
        assert term.energy(turned) == pytest.approx(term.energy(bent), rel=1e-9)
    cables = simulation.actuators.groups[0].term
    np.testing.assert_allclose(cables.lengths(placed), cables.rest_lengths, rtol=1e-12)


def test_a_cable_over_several_bodies_has_the_length_of_its_polyline(hybrid):
    simulation = hybrid()
    (path,), cables = (simulation.actuators.groups[0].term.paths,
                       simulation.actuators.groups[0].term)  # fmt: skip
    given = [THREAD["pull_point"], *THREAD["points"]]
    np.testing.assert_allclose(path.positions(simulation.state.positions), given, atol=1e-12)
    positions = deformed(simulation, np.random.randint(2**31))
    polyline = np.linalg.norm(np.diff(path.positions(positions), axis=0), axis=1).sum()
    assert cables.lengths(positions)[0] == pytest.approx(polyline, rel=1e-12)


def test_each_point_of_a_cable_moves_with_the_nearest_body(hybrid):
    simulation = hybrid()
    (path,) = simulation.actuators.groups[0].term.paths
    carriers = [set(nodes[weights != 0.0].tolist()) for nodes, weights in zip(
        path.points.nodes, path.points.barycentric_weights, strict=True)]  # fmt: skip
    model = simulation.model
    hub, strut = model.rigid[0], model.beams[0]
    soft = set(range(model.bodies[0].first_node, model.bodies[0].mesh.node_count))
    own = {int(node) + k for node in strut.carriers.frame_nodes for k in range(4)}
    assert carriers[1] <= own and carriers[2] <= {hub.first_node + k for k in range(4)}
    assert carriers[3] <= soft and carriers[4] <= soft


def test_rows_of_a_cable_over_several_bodies_are_derivatives_of_its_length(hybrid):
    simulation = hybrid()
    nodes, cables = simulation.model.nodes, simulation.actuators.groups[0].term
    positions = deformed(simulation, np.random.randint(2**31))
    rows = cable_forces(simulation, positions)
    step, found = 1e-6, np.empty_like(rows)
    for unknown, axis in np.ndindex(rows.shape):
        move, lengths = np.zeros_like(rows), []
        move[unknown, axis] = 1.0
        for sign in (1.0, -1.0):
            there = positions.copy()
            nodes.advance(there, move, sign * step)
            lengths.append(cables.lengths(there)[0])
        found[unknown, axis] = (lengths[1] - lengths[0]) / (2.0 * step)
    np.testing.assert_allclose(rows, found, atol=1e-8)


def test_a_held_hybrid_comes_to_rest_with_its_cable_tight(hybrid):
    simulation = hybrid(
        gravity=[0.0, 0.0, -9.81], beams=[CLAMPED], rigid_bodies=[HUB],
        integration="quasi_static",
    )  # fmt: skip
    lengths = simulation.rest_setpoints - 0.002
    result = solved(simulation, CommandSetpoints(lengths, 1.0), 3)
    assert result.efforts[0] > 0.01
    positions = simulation.state.positions
    forces = forces_of(simulation, simulation.model.forces, positions)
    forces += cable_forces(simulation, positions, result.efforts[0])
    np.testing.assert_allclose(forces, 0.0, atol=1e-8)
    length = simulation.actuators.groups[0].term.lengths(positions)[0]
    assert length == pytest.approx(lengths[0], abs=1e-9)


def test_a_body_may_hang_on_a_hub_that_beams_hold_but_not_on_one_that_floats(hybrid):
    still = {"integration": "quasi_static", "rigid_bodies": [HUB], "gravity": [0.0, 0.0, -9.81]}
    assert all(body.is_held for body in hybrid(beams=[CLAMPED], **still).model.bodies)
    with pytest.raises(SceneError, match="bodies.*is not held"):
        hybrid(beams=[{**CLAMPED, "fixed": []}], **still)


def test_names_and_patterns_of_other_bodies_are_checked(hybrid):
    with pytest.raises(SceneError, match=r"cables\[0\].also_on\[0\].*is strut_. meant"):
        hybrid(cables=[{**THREAD, "also_on": ["strut_e"]}])
    with pytest.raises(SceneError, match=r"also_on\[1\].*rib_\*.*no body.*strut_b"):
        hybrid(cables=[{**THREAD, "also_on": ["soft", "rib_*"]}])
    with pytest.raises(SceneError, match=r"joined\[1\].to.*x\*.*no body"):
        hybrid(beams=[{**STRUT, "joined": [STRUT["joined"][0], {"at": "end", "to": "x*"}]}])
    with pytest.raises(SceneError, match=r"points\[2\].*outside the body"):
        hybrid(cables=[{**THREAD, "points": [*THREAD["points"][:2], [0.15, 0.0, 0.08]]}])
