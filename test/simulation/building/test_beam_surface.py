"""The surface by which beams are drawn: it encloses them, and moves with their nodes."""

import numpy as np
import pytest

from softrobot_twin.scene.schema import Scene
from softrobot_twin.simulation import Simulation

MATERIAL = {"young_modulus": 5.0e6, "poisson_ratio": 0.45, "density": 1100.0}
BLADE = {"rectangle": {"thickness": 0.002, "width": 0.01}}


def beam(**changes):
    return {
        "name": "rod", "points": [[0.0, 0.0, 0.1], [0.2, 0.0, 0.1]], "elements": 4,
        "section": {"circle": {"radius": 0.002}}, "material": MATERIAL, "fixed": ["start"],
    } | changes  # fmt: skip


def simulation(*beams, **sections):
    return Simulation(Scene.model_validate({"name": "beams", "beams": list(beams), **sections}))


def volume(points, triangles):
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0)


def edges_are_paired(triangles):
    """Whether each edge of a triangle is that of one other triangle, in the other direction."""
    edges = {tuple(edge) for edge in triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)}
    return len(edges) == 3 * len(triangles) and all((b, a) in edges for a, b in edges)


@pytest.mark.parametrize("section, across", [
    (BLADE, 2.0e-5), ({"circle": {"radius": 0.002}}, 12.0 * 2.0e-6 * np.sin(np.pi / 6.0)),
])  # fmt: skip
def test_surface_of_a_straight_beam_encloses_its_outline_times_its_length(section, across):
    sim = simulation(beam(section=section, thickness_direction=[0.0, 0.0, 1.0]))
    (skin,), (points,) = sim.skins, sim.skin_positions()
    assert edges_are_paired(skin.triangles)
    assert volume(points, skin.triangles) == pytest.approx(0.2 * across, rel=1e-9)


def test_outline_at_a_corner_lies_between_both_sides():
    points = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0]]
    sim = simulation(beam(points=points, section=BLADE, thickness_direction=[0.0, 0.0, 1.0]))
    (skin,), (found,) = sim.skins, sim.skin_positions()
    assert edges_are_paired(skin.triangles)
    # Both sides are as long as their axis: what the mitre takes inside it adds outside.
    assert volume(found, skin.triangles) == pytest.approx(2.0e-5 * 0.2, rel=1e-9)
    assert found[:, 0].max() == pytest.approx(0.105)
    assert found[:, 1].min() == pytest.approx(-0.005)


def test_surface_turns_as_a_whole_with_its_frames():
    sim = simulation(beam(points=[[0.0, 0.0, 0.0], [0.1, 0.05, 0.0], [0.2, 0.0, 0.03]],
                          curve="smooth", elements=5))  # fmt: skip
    rest = sim.model.nodes.rest_positions
    angle, axis = 0.7, np.array([0.6, 0.0, 0.8])
    K = np.cross(np.eye(3), -axis)
    turn = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    skin = sim.skins[0]
    before, after = skin.positions(rest), skin.positions(rest @ turn.T + [0.1, 0.2, 0.3])
    np.testing.assert_allclose(after, before @ turn.T + [0.1, 0.2, 0.3], atol=1e-12)


def test_points_between_nodes_follow_an_arc_with_the_fourth_power_of_its_angle():
    """Hermite's cubic through ends that are bent by an angle: a chord would err by its square."""
    sim = simulation(beam(elements=1, points=[[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]))
    body, x = sim.model.beams[0], sim.model.nodes.rest_positions.copy()
    middle = body.carried([[0.1, 0.0, 0.0]])
    errors = []
    for angle in (0.2, 0.1):
        radius = 0.2 / angle
        ends = [np.array([radius * np.sin(a), 0.0, radius * (1.0 - np.cos(a))])
                for a in (0.0, angle)]  # fmt: skip
        for origin, place, a in zip(body.carriers.frame_nodes, ends, (0.0, angle), strict=True):
            x[origin] = place
            bent = np.array([[np.cos(a), 0.0, np.sin(a)], [0.0, 1.0, 0.0],
                             [-np.sin(a), 0.0, np.cos(a)]])  # fmt: skip
            own = sim.model.nodes.rest_positions[origin + 1 : origin + 4]
            own = own - sim.model.nodes.rest_positions[origin]
            x[origin + 1 : origin + 4] = place + own @ bent
        half = 0.5 * angle
        wanted = radius * np.array([np.sin(half), 0.0, 1.0 - np.cos(half)])
        errors.append(np.linalg.norm(middle.positions(x)[0] - wanted))
    assert errors[0] < 1e-4 * 0.2
    assert errors[0] / errors[1] > 7.0


def test_a_point_at_a_node_is_carried_by_its_frame_alone():
    body = simulation(beam(elements=4)).model.beams[0]
    node, middle = body.places[2], 0.5 * (body.places[2] + body.places[3])
    across = 0.003 * body.axes[2][:, 1]
    at_node, beside = body.carried([node]), body.carried([node + across])
    assert at_node.nodes.tolist() == [[body.carriers.frame_nodes[2]]]
    assert set(beside.nodes[0]) <= set(body.carriers.frame_nodes[2] + np.arange(4))
    x = simulation(beam(elements=4)).model.nodes.rest_positions
    for points in ([node], [node + across], [middle], [node, middle + across]):
        np.testing.assert_allclose(body.carried(points).positions(x), points, atol=1e-15)


def test_a_beam_of_millimetres_and_one_of_water_are_doubted():
    notes = " ".join(simulation(beam(points=[[0, 0, 0], [200.0, 0, 0]]), gravity=[0, 0, 0]).notes)
    assert "beams[0] length = 200 m" in notes
    light = simulation(beam(material=MATERIAL | {"density": 1.0}), gravity=[0, 0, 0])
    assert "beams[0].material.density = 1 kg/m³" in " ".join(light.notes)
    thick = simulation(beam(section={"circle": {"radius": 2.0}}), gravity=[0, 0, 0])
    assert "beams[0].section is 4 m across" in " ".join(thick.notes)


def test_a_beam_that_hangs_down_under_its_weight_is_doubted():
    soft = simulation(beam(material=MATERIAL | {"young_modulus": 1.0e5}))
    assert any("under gravity alone" in note for note in soft.notes)
    stiff = simulation(beam(material=MATERIAL | {"young_modulus": 1.0e9}))
    assert not stiff.notes


def test_a_beam_that_falls_is_not_said_to_sag():
    assert not simulation(beam(fixed=[]), integration="dynamic").notes
