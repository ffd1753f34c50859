"""Surfaces from files of any coarseness: what they press on, follow and show is the same."""

import itertools

import meshio
import numpy as np
import pytest

from softrobot_twin.geometry.self_proximity import FixedPairs
from softrobot_twin.simulation import CommandSetpoints, Hold, State, Status
from softrobot_twin.simulation.building import contact_building
from test.scene_changes import solved

STEP = 0.02
LENGTH = 0.06


def box_file(path, low, high, parts=(1, 1, 1)):
    """A box whose faces have so many parts along each axis, two triangles for each."""
    lines = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, parts, strict=True)]
    points, triangles = [], []
    for axis, end in itertools.product(range(3), (0, -1)):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        first, count = len(points), len(lines[v])
        for a, b in itertools.product(lines[u], lines[v]):
            place = np.empty(3)
            place[axis], place[u], place[v] = lines[axis][end], a, b
            points.append(place)
        for i, j in itertools.product(range(parts[u]), range(parts[v])):
            corner = first + i * count + j
            pair = [[corner, corner + count, corner + count + 1],
                    [corner, corner + count + 1, corner + 1]]  # fmt: skip
            triangles += pair if end else [own[::-1] for own in pair]
    meshio.write(path, meshio.Mesh(np.array(points), [("triangle", np.array(triangles))]))
    return str(path)


def settled(simulation, pressure, steps=20):
    for _ in range(steps):
        result = simulation.step(CommandSetpoints([pressure], STEP))
        if result.status is Status.OK and result.report.residual < 1e-8:
            break
    return result


def splits(simulation):
    return [note for note in simulation.notes if "are split into" in note]


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_a_chamber_of_twelve_triangles_grows_as_that_of_the_meshs_own_faces(tmp_path, inflatable, element):
    def with_element(mapping):
        mapping["body"]["element"] = element

    own = inflatable(with_element)
    term = own.actuators.terms[0]
    points = term.surfaces[0].vertices.positions(own.model.nodes.rest_positions)
    coarse = box_file(tmp_path / "coarse.stl", points.min(axis=0), points.max(axis=0))
    mapped = inflatable(with_element, {"cavities.0.walls": [{"file": coarse}]})
    assert len(splits(mapped)) == 1 and "its 12 triangles" in splits(mapped)[0]
    assert mapped.actuators.terms[0].rest_volumes == pytest.approx(term.rest_volumes, rel=1e-9)
    # No finer than needed: a step costs about as much as with the mesh's own faces.
    count = len(mapped.actuators.terms[0].surfaces[0].triangles)
    assert count <= 2 * len(term.surfaces[0].triangles)
    results = [settled(simulation, 3e3) for simulation in (own, mapped)]
    assert all(result.status is Status.OK for result in results)
    grown = [float(result.displacements[0]) for result in results]
    assert grown[1] == pytest.approx(grown[0], rel=0.05)


def test_a_chamber_of_twelve_triangles_in_hexahedra_grows_as_a_fine_one(tmp_path, simulate):
    grown, counts = [], []
    for parts in ((1, 1, 1), (20, 4, 4)):
        file = box_file(tmp_path / f"{parts[0]}.stl", [0.01, 0.005, 0.005], [0.05, 0.015, 0.015], parts)
        simulation = simulate(
            gravity=[0.0, 0.0, 0.0],
            body={
                "mesh": {"box": {"size": [LENGTH, 0.02, 0.02], "cells": [12, 4, 4]}},
                "element": "hexahedral",
                "material": {"young_modulus": 1e5, "poisson_ratio": 0.4, "density": 1000.0},
                "fixed": {"box": {"minimum": [-1.0] * 3, "maximum": [1e-6, 1.0, 1.0]}},
            },
            cavities=[{"name": "air", "walls": [{"file": file}], "pressure": [0.0, 1e5]}],
        )
        result = settled(simulation, 1e4)
        assert result.status is Status.OK
        grown.append(float(result.displacements[0]))
        counts.append(len(splits(simulation)))
    assert counts == [1, 0]
    assert grown[0] == pytest.approx(grown[1], rel=0.03)


def test_rows_of_a_split_chamber_are_the_slopes_of_its_volume(tmp_path, inflatable, drawn_rng):
    own = inflatable()
    points = own.actuators.terms[0].surfaces[0].vertices.positions(own.model.nodes.rest_positions)
    coarse = box_file(tmp_path / "coarse.stl", points.min(axis=0), points.max(axis=0))
    simulation = inflatable({"cavities.0.walls": [{"file": coarse}]})
    term, rest = simulation.actuators.terms[0], simulation.model.nodes.rest_positions
    positions = rest + 1e-4 * drawn_rng.normal(size=rest.shape)
    blocks, values = term.rows_at(positions)
    move = np.zeros_like(rest)
    free = simulation.model.nodes.free_nodes
    move[free] = drawn_rng.normal(size=(len(free), 3))
    slope = float(np.sum(blocks * move[free][term.entry_nodes]))
    ends = [term.volumes(positions + sign * 1e-6 * move)[0] for sign in (-1, 1)]
    assert slope == pytest.approx((ends[1] - ends[0]) / 2e-6, rel=1e-6)


def test_a_surface_as_fine_as_the_mesh_is_not_split(inflatable):
    assert not inflatable().notes


def test_a_wall_that_stands_off_its_body_is_split_and_snapped(tmp_path, inflatable):
    """A chamber drawn a little too small: pressure acts on the whole wall all the same."""
    own = inflatable()
    points = own.actuators.terms[0].surfaces[0].vertices.positions(own.model.nodes.rest_positions)
    inwards = 3e-4 * np.ones(3)
    small = box_file(tmp_path / "small.stl", points.min(axis=0) + inwards, points.max(axis=0) - inwards)
    mapped = inflatable({"cavities.0.walls": [{"file": small}]})
    assert splits(mapped) and any("snapped" in note for note in mapped.notes)
    grown = [float(settled(simulation, 3e3).displacements[0]) for simulation in (own, mapped)]
    assert grown[1] == pytest.approx(grown[0], rel=0.1)


def test_a_lid_over_an_open_cup_is_held_by_its_rim_and_told(tmp_path, simulate, block):
    """No element is near the middle of the lid: it is not carried by whatever is nearest."""
    mesh = block((0.06, 0.06, 0.03), (6, 6, 3), 0.0)
    centres = mesh.node_positions[mesh.cells].mean(axis=1)
    is_wall = (abs(centres[:, :2] - 0.03) > 0.02).any(axis=1) | (centres[:, 2] < 0.01)
    used, cells = np.unique(mesh.cells[is_wall], return_inverse=True)
    meshio.write(tmp_path / "cup.vtk", meshio.Mesh(
        mesh.node_positions[used], [("tetra", cells.reshape(-1, 4))]))  # fmt: skip
    gas = box_file(tmp_path / "gas.stl", [0.01, 0.01, 0.01], [0.05, 0.05, 0.03])
    simulation = simulate(
        gravity=[0.0, 0.0, 0.0],
        body={
            "mesh": {"file": str(tmp_path / "cup.vtk")},
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.4, "density": 1000.0},
            "fixed": {"box": {"minimum": [-1.0] * 3, "maximum": [1.0, 1.0, 1e-6]}},
        },
        cavities=[{"name": "gas", "walls": [{"file": gas}], "pressure": [0.0, 1e3]}],
    )
    assert sum("run off the body" in note for note in simulation.notes) == 1
    assert simulation.actuators.terms[0].rest_volumes == pytest.approx(0.04 * 0.04 * 0.02, rel=1e-6)
    result = settled(simulation, 100.0, 3)
    assert result.status is Status.OK and result.displacements[0] > 0.0


def bar_with(simulate, block_file, element, **surface):
    return simulate(
        body={
            "mesh": {"file": block_file}, "element": element,
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "fixed": {"box": {"minimum": [-1.0] * 3, "maximum": [1.0, 1.0, -0.0299]}}, **surface,
        },
    )  # fmt: skip


@pytest.mark.parametrize("element", ["linear", "quadratic"])
@pytest.mark.parametrize("key", ["visual", "contact_surface"])
def test_a_coarse_skin_bends_with_its_body(tmp_path, simulate, write_block, element, key):
    """Twelve triangles around a bar: bent, every point is where the bar's own points are."""
    size = np.array([0.02, 0.02, LENGTH])
    file = write_block(tuple(size), (3, 3, 9), shake=0.0)
    skin = box_file(tmp_path / "skin.stl", -size / 2, size / 2)
    simulation = bar_with(simulate, file, element, **{key: {"file": skin}})
    assert len(splits(simulation)) == 1

    def bent(points):
        height = points[:, 2] + LENGTH / 2
        return points + np.column_stack([5.0 * height**2, 0.0 * height, 0.0 * height])

    (skin,), state = simulation.skins, simulation.state
    rest = skin.positions(simulation.model.nodes.rest_positions)
    simulation.restore(State(bent(state.positions), state.setpoints.copy(), state.efforts.copy()))
    shown = skin.positions(simulation.state.positions)
    middles = shown[skin.triangles].mean(axis=1)
    flat = rest[skin.triangles].mean(axis=1)
    # A straight line over the whole bar would be off by 4.5 mm in its middle.
    assert np.linalg.norm(middles - bent(flat), axis=1).max() < 1.5e-4
    assert np.linalg.norm(shown - bent(rest), axis=1).max() < 1.5e-4


def test_a_bent_finger_rests_on_its_coarse_contact_surface(tmp_path, write_block, scene_of):
    """A beam sags onto a ball in its middle, which twelve flat triangles would not see."""
    size = np.array([0.1, 0.02, 0.01])
    file = write_block(tuple(size), (15, 3, 2), shake=0.0)
    surface = box_file(tmp_path / "skin.stl", -size / 2, size / 2)
    rests = []
    for entries in ({}, {"contact_surface": {"file": surface}}):
        simulation = scene_of(
            gravity=[0.0, 0.0, -9.81],
            bodies=[{
                "name": "beam", "mesh": {"file": file},
                "material": {"young_modulus": 5e4, "poisson_ratio": 0.3, "density": 1000.0},
                "fixed": [{"box": {"minimum": [s * 0.05 - 1e-6, -1, -1],
                                   "maximum": [s * 0.05 + 1e-6, 1, 1]}} for s in (-1, 1)],
                **entries,
            }],
            obstacles=[{"name": "ball", "sphere": {"centre": [0, 0, -0.0151], "radius": 0.01}}],
            contact={"friction": 0.0, "between": [{"pair": ["beam", "ball"]}]},
            solver={"newton_iterations": 4},
        )  # fmt: skip
        result = solved(simulation, Hold(STEP), 10)
        rests.append(result.state.positions.copy())
    # Unsplit, its flat sole between the held ends would pass the ball by, and the beam hang lower.
    np.testing.assert_allclose(rests[1], rests[0], atol=1e-4)


@pytest.mark.parametrize("section", ["tubes", "fibres"])
def test_a_thread_of_two_points_bends_with_its_body(simulate, write_block, section):
    """It holds a bent bar as one of many points does: one spring from end to end would not."""
    file = write_block((0.02, 0.02, LENGTH), (4, 4, 12), shake=0.0)
    ends, tips, told = (-0.0299, 0.0299), [], []
    for count in (2, 9):
        points = [[0.008, 0.0, z] for z in np.linspace(*ends, count)]
        stiff = {"stiffness": 50.0, "tension_only": False}
        thread = {"name": "thread", "points": points,
                  **(stiff if section == "fibres" else {"axial_stiffness": 50.0})}  # fmt: skip
        simulation = simulate(
            gravity=[0.0, 0.0, 0.0],
            body={
                "mesh": {"file": file}, "element": "linear",
                "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
                "fixed": {"box": {"minimum": [-1.0] * 3, "maximum": [1.0, 1.0, -0.02999]}},
            },
            cables=[{"name": "c", "pull_point": [-0.008, 0.0, -0.03],
                     "points": [[-0.008, 0.0, 0.03]], "tension": [0.0, 10.0]}],
            effectors=[{"name": "tip", "points": [[0.0, 0.0, 0.03]]}], **{section: [thread]},
        )  # fmt: skip
        result = settled(simulation, simulation.rest_setpoints[0] - 0.01)
        assert result.status is Status.OK
        told.append(sum("the line is split at" in note for note in simulation.notes))
        tips.append(simulation.effector_positions().ravel())
    assert told == [1, 0]
    assert tips[0] == pytest.approx(tips[1], abs=2e-4)
    assert abs(tips[0][0]) > 0.01


def test_a_named_contact_is_with_the_triangle_that_holds_its_place_however_large(
    tmp_path, scene_of, monkeypatch
):
    """A large triangle, whose centre is far away, beside small ones; a far point is told."""
    points = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10], [-1, -1, 0], [0, -1, 0], [-1, 0, 0.5]],
                      float) / 100.0  # fmt: skip
    tets = np.array([[0, 1, 2, 3], [0, 4, 5, 6]])
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    tets[np.linalg.det(edges) < 0.0] = tets[np.linalg.det(edges) < 0.0][:, [0, 2, 1, 3]]
    file = tmp_path / "two.vtk"
    meshio.write(file, meshio.Mesh(points, [("tetra", tets)]))
    fixed_pairs = []

    def noted(*given):
        fixed_pairs.append(given)
        return FixedPairs(*given)

    monkeypatch.setattr(contact_building, "FixedPairs", noted)
    simulation = scene_of(
        body={
            "mesh": {"file": str(file)}, "element": "linear",
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "fixed": {"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.001]}},
        },
        contact={"points": [{"point": [-0.01, 0.0, 0.02], "against": [0.005, 0.005, 0.0]}]},
    )  # fmt: skip
    ((_, (touched,)),) = fixed_pairs
    assert sorted(touched.tolist()) == [0, 1, 2]
    assert sum("contact.points[0].point lies 15 mm" in note for note in simulation.notes) == 1
