"""Beams in contact: with floors, rods, soft bodies, each other and themselves."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.schema import Scene
from softrobot_twin.simulation import CommandEfforts, Hold, Simulation
from test.scene_changes import repeat_step, solved

YOUNG, DENSITY, RADIUS, LENGTH = 1.0e8, 1100.0, 0.004, 0.2
INERTIA = 0.25 * np.pi * RADIUS**4
MATERIAL = {"young_modulus": YOUNG, "poisson_ratio": 0.4, "density": DENSITY}
FLOOR = {"name": "floor", "plane": {}}
WEIGHT = 9.81 * DENSITY * np.pi * RADIUS**2 * LENGTH


def beam(**changes):
    return {
        "name": "rod", "points": [[0.0, 0.0, 0.0], [LENGTH, 0.0, 0.0]], "elements": 16,
        "section": {"circle": {"radius": RADIUS}}, "material": MATERIAL, "fixed": ["start"],
    } | changes  # fmt: skip


def touching(*beams, pair=("rod", "floor"), friction=0.3, iterations=20, **sections):
    contact = {"friction": friction, "between": [{"pair": list(pair)}]}
    return Simulation(Scene.model_validate({
        "name": "beams", "beams": list(beams), "contact": contact,
        "solver": {"newton_iterations": iterations}, **sections,
    }))  # fmt: skip


def nodes(simulation, index=0):
    mapping = simulation.model.beams[index].nodes_mapping()
    return mapping.positions(simulation.state.positions)


def overlap(simulation):
    return simulation.model.contacts.deepest_overlaps(simulation.state.positions).max()


@pytest.mark.parametrize("section, half", [
    ({"circle": {"radius": RADIUS}}, RADIUS),
    ({"rectangle": {"thickness": 0.004, "width": 0.02}}, 0.002),
])  # fmt: skip
def test_a_beam_that_is_dropped_rests_on_a_floor_that_bears_its_weight(section, half):
    height = half + 0.001
    sim = touching(
        beam(points=[[0.0, 0.0, height], [LENGTH, 0.0, height]], fixed=[], elements=8,
             section=section, thickness_direction=[0.0, 0.0, 1.0]),
        integration="dynamic", obstacles=[FLOOR],
    )  # fmt: skip
    result = solved(sim, Hold(0.005), 40)
    weight = 9.81 * sim.model.beams[0].mass
    np.testing.assert_allclose(result.contacts.forces.sum(axis=0), [0.0, 0.0, weight], atol=1e-3 * weight)
    np.testing.assert_allclose(nodes(sim)[:, 2], half, atol=1e-6)


def test_a_prop_at_the_tip_of_a_cantilever_bears_three_eighths_of_its_weight():
    prop = {"name": "prop", "sphere": {"centre": [LENGTH, 0.0, -0.014], "radius": 0.01}}
    sim = touching(beam(), obstacles=[prop], pair=("rod", "prop"), friction=0.0)
    result = repeat_step(sim, Hold(0.01), 3)
    assert result.contacts.forces.sum(axis=0)[2] == pytest.approx(0.375 * WEIGHT, rel=0.003)


def test_beams_that_cross_bear_each_other_as_their_stiffnesses_demand():
    """A cantilever under its weight on the middle of a beam without weight, both ends clamped."""
    at, light = 0.15, MATERIAL | {"density": 1.0e-3}
    under = beam(name="under", points=[[at, -0.1, -2 * RADIUS], [at, 0.1, -2 * RADIUS]],
                 fixed=["start", "end"], material=light)  # fmt: skip
    sim = touching(beam(), under, pair=("under", "rod"), friction=0.0)
    result = repeat_step(sim, Hold(0.01), 3)
    bending = YOUNG * INERTIA
    sag = WEIGHT / LENGTH * at**2 * (6 * LENGTH**2 - 4 * LENGTH * at + at**2) / (24 * bending)
    force = sag / (at**3 / (3 * bending) + LENGTH**3 / (192 * bending))
    (found,) = result.contacts.forces
    np.testing.assert_allclose(found, [0.0, 0.0, -force], atol=0.02 * force)
    assert nodes(sim, 1)[8, 2] + 2 * RADIUS == pytest.approx(-force * LENGTH**3 / (192 * bending), rel=0.02)
    # What one is pushed by, the other one is pushed back by, also about any axis.
    term, x = sim.model.contacts, sim.state.positions
    own = term.coefficients[0, :8] @ x[term.nodes[0, :8]]
    other = -term.coefficients[0, 8:] @ x[term.nodes[0, 8:]]
    np.testing.assert_allclose(term.coefficients[0].reshape(2, 8).sum(axis=1), [1.0, -1.0])
    assert np.linalg.norm(np.cross(own - other, term.directions[0, 0])) < 1e-9


def test_a_coil_that_falls_together_does_not_pass_through_itself():
    angles, radius = np.linspace(0.0, 3.5 * np.pi, 15), 0.003
    points = np.column_stack([0.03 * np.cos(angles), 0.03 * np.sin(angles), 0.0019 * angles])
    coil = beam(points=points.tolist(), curve="smooth", elements=42,
                section={"circle": {"radius": radius}},
                material=MATERIAL | {"young_modulus": 1.0e6})  # fmt: skip
    sim = touching(coil, pair=("rod", "rod"), integration="dynamic", iterations=5)
    touched = 0
    for _ in range(40):
        touched += len(sim.step(Hold(0.004)).contacts.gaps) > 0
        assert overlap(sim) < 0.05 * radius
    assert touched > 3


def test_neighbours_of_a_bent_beam_and_a_joint_are_no_contact():
    sim = touching(
        beam(points=[[0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0]], elements=20),
        beam(name="arm", points=[[0.02, 0.02, 0], [0.0, 0.04, 0]], elements=10, fixed=[],
             joined=[{"at": "start", "to": "rod"}]),
        pair=("rod", "arm"), gravity=[0, 0, 0],
    )  # fmt: skip
    assert overlap(sim) == 0.0
    sim = touching(beam(elements=100), pair=("rod", "rod"), gravity=[0, 0, 0])
    sim.step(Hold(0.01))
    assert sim.model.contacts.count == 0


def test_what_is_joined_to_a_body_does_not_touch_it_at_the_joint():
    hub = {"name": "hub", "motion": "guided", "sphere": {"radius": 0.02}}
    sim = touching(
        beam(points=[[0, 0, 0], [0.2, 0, 0]], fixed=[], joined=[{"at": "start", "to": "hub"}]),
        pair=("rod", "hub"), rigid_bodies=[hub], gravity=[0, 0, 0],
    )  # fmt: skip
    assert overlap(sim) == 0.0
    with pytest.raises(SceneError, match="round section"):
        touching(
            beam(fixed=[], joined=[{"at": "start", "to": "hub"}], thickness_direction=[0, 0, 1],
                 section={"rectangle": {"thickness": 0.002, "width": 0.01}}),
            pair=("rod", "hub"), rigid_bodies=[hub],
        )  # fmt: skip


def write_block(path, size, cells):
    grids = [np.linspace(0.0, s, n + 1) for s, n in zip(size, cells, strict=True)]
    points = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(points)).reshape([n + 1 for n in cells])
    corners = np.stack([index[a : a + cells[0], b : b + cells[1], c : c + cells[2]].ravel()
                        for a in (0, 1) for b in (0, 1) for c in (0, 1)], axis=1)  # fmt: skip
    paths = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]]
    meshio.Mesh(points, [("tetra", corners[:, paths].reshape(-1, 4))]).write(path)


def test_a_beam_that_lies_on_a_soft_block_is_borne_by_it(tmp_path):
    write_block(tmp_path / "block.vtk", (0.06, 0.06, 0.02), (6, 6, 2))
    block = {
        "name": "block", "mesh": {"file": str(tmp_path / "block.vtk")}, "element": "linear",
        "material": {"young_modulus": 1.0e5, "poisson_ratio": 0.3, "density": 1000.0},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-4]}}],
    }  # fmt: skip
    rod = beam(points=[[-0.05, 0.03, 0.0245], [0.11, 0.03, 0.0245]], elements=8,
               material=MATERIAL | {"young_modulus": 2.0e6, "density": 3000.0})  # fmt: skip
    sim = touching(rod, pair=("rod", "block"), body=block)
    result = solved(sim, Hold(0.01), 3)
    assert result.contacts.forces.sum(axis=0)[2] > 0.05
    assert overlap(sim) < 1e-6
    top = sim.surface_positions()[:, 2]
    assert sim.model.bodies[0].mesh.node_positions[:, 2].max() == pytest.approx(0.02)
    assert nodes(sim)[4, 2] < 0.0245 < top.max() + 0.01


def over_a_drum(ratio, friction=0.3):
    """A beam over half of a drum, its ends pulled down by 1 N and by `ratio` newtons."""
    radius, across = 0.05, 0.051
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
    arc = np.column_stack([across * np.sin(angles), 0.0 * angles, across * np.cos(angles)])
    points = np.vstack([[-across, 0, -0.1], [-across, 0, -0.05], arc, [across, 0, -0.05], [across, 0, -0.1]])
    pulled = [
        {"name": name, "body": "rod", "points": [[x, 0, -0.1]], "pull_point": [x, 0, -0.5],
         "tension": [0, 100]} for name, x in (("left", -across), ("right", across))
    ]  # fmt: skip
    drum = {"ends": [[0, -0.05, 0], [0, 0.05, 0]], "radius": radius}
    sim = touching(
        beam(points=points.tolist(), curve="smooth", elements=30, fixed=[],
             section={"circle": {"radius": 0.001}}, material=MATERIAL | {"young_modulus": 1.0e9}),
        pair=("rod", "drum"), friction=friction, iterations=10, integration="dynamic",
        gravity=[0, 0, 0], obstacles=[{"name": "drum", "cylinder": drum}], cables=pulled,
    )  # fmt: skip
    for step in range(40):
        if step == 20:
            before = nodes(sim)[0]
        sim.step(CommandEfforts(np.array([1.0, ratio]), 0.004))
    return np.linalg.norm(nodes(sim)[0] - before)


def test_a_beam_over_a_drum_sticks_within_the_cone_and_slides_beyond_it():
    """exp(µπ) = 2.57; the bending stiffness of the beam adds little."""
    assert over_a_drum(2.3) < 2e-6
    assert over_a_drum(3.2) > 1e-3


@pytest.mark.parametrize("elements, is_told", [(20, True), (60, False)])
def test_a_rope_whose_elements_are_longer_than_the_radius_of_its_peg_is_warned_of(elements, is_told):
    """With 20 elements of 20 mm around 10 mm, friction held 2.1 to 4.2 N, by their places, for 5.1 N."""
    peg = {"name": "peg", "cylinder": {"ends": [[0, -0.05, 0], [0, 0.05, 0]], "radius": 0.01}}
    sim = touching(
        beam(points=[[-0.2, 0, 0.011], [0.2, 0, 0.011]], elements=elements,
             section={"circle": {"radius": 0.0005}}),
        pair=("rod", "peg"), obstacles=[peg],
    )  # fmt: skip
    told = [note for note in sim.model.notes if "follows it coarsely" in note]
    assert len(told) == is_told
    if is_told:
        assert "at least 120 elements" in told[0] and "0.02 m long" in told[0]


@pytest.mark.parametrize("speed, step", [(1.0, 0.001), (3.0, 0.005), (10.0, 0.02)])
@pytest.mark.parametrize("across", ["wire", "beam"])
def test_no_beam_passes_through_what_is_a_millimetre_thin(across, speed, step):
    wire = {"name": "wire", "capsule": {"ends": [[0.1013, -0.1, 0], [0.1013, 0.1, 0]], "radius": 0.0005}}
    height, stiff = 0.02 + 0.37 * speed * step, MATERIAL | {"young_modulus": 1.0e9}
    flying = beam(points=[[0, 0, height], [LENGTH, 0, height]], fixed=[], material=stiff,
                  section={"circle": {"radius": 0.0005}}, elements=8)  # fmt: skip
    still = beam(name="wire", points=[[0.1013, -0.1, 0], [0.1013, 0.1, 0]], elements=8,
                 fixed=["start", "end"], section={"circle": {"radius": 0.0005}},
                 material=stiff | {"young_modulus": 1.0e11, "density": 8000.0})  # fmt: skip
    sections = {"obstacles": [wire]} if across == "wire" else {}
    beams = [flying] if across == "wire" else [flying, still]
    sim = touching(*beams, pair=("rod", "wire"), integration="dynamic", gravity=[0, 0, 0],
                   iterations=5, **sections)  # fmt: skip
    velocities = np.zeros_like(sim.state.velocities)
    frames = sim.model.beams[0].carriers.frame_nodes
    velocities[sim.model.nodes.kinds[0].unknowns_of(frames), 2] = -speed
    sim.restore(replace(sim.state, velocities=velocities))
    touched = False
    for _ in range(int(0.03 / speed / step) + 6):
        touched |= sim.step(Hold(step)).report.contact_count > 0
        # It tilts about the wire, so that its own middle may be lower.
        above = np.interp(0.1013, *nodes(sim)[:, [0, 2]].T)
        assert above > (nodes(sim, 1)[4, 2] if across == "beam" else 0.0)
    assert touched


def test_a_deep_overlap_is_pushed_out_no_faster_than_asked():
    sim = touching(
        beam(points=[[0, 0, 0.001], [LENGTH, 0, 0.001]], fixed=[], elements=8),
        integration="dynamic", obstacles=[FLOOR],
    )  # fmt: skip
    heights = [0.001]
    for _ in range(30):
        sim.step(Hold(0.004))
        heights.append(nodes(sim)[:, 2].mean())
    assert np.diff(heights).max() <= 0.05 * 0.004 * 1.001
    assert heights[-1] == pytest.approx(RADIUS, abs=1e-5)


@pytest.mark.parametrize("other", ["sphere", "beam", "itself"])
def test_rows_are_the_finite_differences_of_gaps(other, drawn_rng):
    ball = {"name": "thing", "sphere": {"centre": [0.103, 0.003, -0.0142], "radius": 0.01}}
    crossing = beam(name="thing", points=[[0.103, -0.1, -0.0085], [0.103, 0.1, -0.0085]], elements=7)
    angles = np.linspace(0.0, 1.9 * np.pi, 9)
    ring = np.column_stack([0.03 * np.cos(angles), 0.03 * np.sin(angles), 0.0 * angles])
    beams = {"sphere": [beam(elements=5)], "beam": [beam(elements=5), crossing],
             "itself": [beam(points=ring.tolist(), curve="smooth", elements=12)]}  # fmt: skip
    sim = touching(*beams[other], pair=("rod", "rod" if other == "itself" else "thing"),
                   obstacles=[ball] if other == "sphere" else [], gravity=[0, 0, 0])  # fmt: skip
    model = sim.model
    contacts, nodes_of, x = model.contacts, model.nodes, model.nodes.rest_positions.copy()
    # Three directions: no gap may happen to change in none of them.
    directions = 1e-3 * drawn_rng.uniform(-1.0, 1.0, (3, nodes_of.free_node_count, 3))
    nodes_of.advance(x, directions[0], 0.05)
    contacts.begin_step(x, np.zeros((0, 3)), 0.0)
    contacts.detect(x)
    assert contacts.count > 0
    pair, keys = contacts.pairs[0], contacts.found.keys[: contacts.count].copy()
    # Change of each gap by the rows at constant normals, and by what is found anew.
    by_rows, anew = ([], []), ([], [])
    for moves in directions:
        for side, sign in enumerate((1.0, -1.0)):
            moved = x.copy()
            nodes_of.advance(moved, moves, sign * 1e-4)
            by_rows[side].append(contacts.gaps(moved))
            near = pair.near(moved, contacts.margin + 1e-4)
            anew[side].append([near.gaps[list(near.keys).index(key)] for key in keys])
    slopes = np.array(by_rows[0]) - by_rows[1]
    assert np.abs(slopes).max() > 1e-9
    np.testing.assert_allclose(np.array(anew[0]) - anew[1], slopes, atol=2e-3 * np.abs(slopes).max())
