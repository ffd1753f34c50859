"""Warnings and refusals when a scene is built: cuts, entries without effect, limits out of scale.
"""


import meshio
import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandEfforts, FollowTargets, Simulation
from test.scene_changes import repeat_step

SIZE = (0.02, 0.02, 0.1)


@pytest.fixture
def column(tmp_path, block):
    """Makes a column with one cable; takes points, cells and their kind, and changes by key."""
    mesh = block(size=SIZE, cells=(2, 2, 5), shake=0.0)

    def make(points=mesh.node_positions, cells=mesh.cells, kind="tetra", suffix=".vtk", **entries):
        file = tmp_path / f"column{suffix}"
        formats = {".vtk": "vtk42", ".msh": "gmsh22", ".vtu": "vtu", ".inp": "abaqus"}
        meshio.Mesh(points, [(kind, cells)]).write(file, file_format=formats[suffix])
        body = {
            "mesh": str(file),
            "material": {"young_modulus": 2e5, "poisson_ratio": 0.4, "density": 1070.0},
            "fixed": {"box": {"minimum": [-1, -1, -0.001], "maximum": [1, 1, 0.001]}},
        }
        cable = {"name": "a", "pull_point": [0, 0, -0.02], "points": [[0, 0, 0.05], [0, 0, 0.1]],
                 "shortening": [0.0, 0.02], "tension": [0.0, 10.0]}  # fmt: skip
        mapping = {"name": "column", "cables": [cable],
                   "effectors": {"name": "tip", "points": [0.01, 0.01, 0.1]}}  # fmt: skip
        mapping["body"] = body | entries.pop("body", {})
        cable |= entries.pop("cable", {})
        return Simulation(scene_from_mapping(mapping | entries, tmp_path / "column.yaml"))

    make.mesh = mesh
    return make


def cut_at_half_height(mesh):
    upper = mesh.node_positions[mesh.cells].mean(axis=1)[:, 2] > 0.05
    cells = mesh.cells + np.where(upper, mesh.node_count, 0)[:, None]
    return np.vstack([mesh.node_positions, mesh.node_positions]), cells


def test_a_mesh_with_duplicate_nodes_is_joined_reported_and_bends_as_one_body(column):
    joined, whole = column(*cut_at_half_height(column.mesh)), column()
    assert any("Merged 12 nodes" in note and "column.vtk" in note for note in joined.notes)
    for simulation in (joined, whole):
        result = repeat_step(simulation, CommandEfforts(np.array([1.0]), 0.02), 10)
        assert result.report.residual < 1e-4
    np.testing.assert_allclose(joined.effector_positions(), whole.effector_positions(), atol=1e-9)


def test_a_cut_that_is_kept_is_named_with_its_floating_part(column):
    points, cells = cut_at_half_height(column.mesh)
    with pytest.raises(SceneError, match="part 1 of 2 is not held.*the body is cut there"):
        column(points, cells, body={"mesh": {"file": "column.vtk", "merge_distance": 0.0}})


def test_duplicate_tetrahedra_do_not_change_the_weight(column):
    mesh = column.mesh
    twice = column(mesh.node_positions, np.vstack([mesh.cells, mesh.cells[10:20]]))
    assert any("more than once" in note for note in twice.notes)
    assert twice.model.bodies[0].mesh.volume == pytest.approx(np.prod(SIZE))


@pytest.mark.parametrize("entries, key, words", [
    ({"body": {"fixed": {"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1]}}}}, "body.fixed",
     "nothing in the scene can move"),
    ({"cable": {"points": [[0, 0, 0], [0.01, 0.01, 0]]}}, "cables[0]", "moves nothing"),
    ({"body": {"mesh": "none.vtk"}}, "body.mesh.file", "there is no such file"),
    ({"body": {"mesh": "."}}, "body.mesh.file", "is a folder"),
    ({"body": {"visual": "none.stl"}}, "body.visual.file", "there is no such file"),
    ({"obstacles": {"name": "rock", "surface": "rock.stl"}}, "obstacles[0].surface.file",
     "there is no such file"),
])  # fmt: skip
def test_entries_that_can_have_no_effect_are_refused_by_key(column, entries, key, words):
    with pytest.raises(SceneError) as error:
        column(**entries)
    assert error.value.key == key and words in error.value.reason
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("entries, words", [
    ({"cable": {"shortening": [0.0, 20.0]}}, "cables[0].shortening = 20 m is very large"),
    ({"cable": {"shortening": [0.0, 2e-5]}}, "cables[0].shortening = 2e-05 m is very small"),
    ({"cable": {"rate": 50.0}}, "cables[0].rate = 50 m/s is very large"),
    ({"cable": {"rate": 1e-6}}, "cables[0].rate = 1e-06 m/s is very small"),
    ({"cable": {"tension": [0.0, 1e4]}}, "cables[0].tension = 10000 N is very large"),
    ({"cable": {"tension": [0.0, 0.01]}}, "cables[0].tension = 0.01 N is very small"),
    ({"cable": {"hold_radius": 4.0}}, "cables[0].hold_radius = 4 m is very large"),
    ({"body": {"damping": {"mass": 1.0}}}, "body.damping has no effect"),
    ({"obstacles": {"name": "rock", "sphere": {"radius": 0.01}}}, "(rock) has no effect"),
    ({"obstacles": {"name": "rock", "box": {"size": [0.1, 0.1, 0.1], "rotation": [0, 90, 0]}}},
     "obstacles[0].box.rotation holds 90 rad"),
    ({"effectors": {"name": "tip", "points": [0.01, 0.01, 0.0]}}, "effectors[0] (tip) lies"),
    ({"body": {"element": "linear",
               "fixed": {"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.02 - 5e-7]}}}},
     "9 nodes lie outside the box"),
])  # fmt: skip
def test_entries_without_effect_or_of_an_unlikely_unit_are_reported(column, entries, words):
    assert any(words in note for note in column(**entries).notes)


def test_a_contact_distance_larger_than_the_body_is_reported(column):
    floor = {"name": "floor", "plane": {"point": [0, 0, -10.0]}}
    contact = {"alarm_distance": 4.0, "between": {"pair": ["body", "floor"]}}
    (note,) = column(obstacles=floor, contact=contact).notes
    assert "contact.alarm_distance = 4 m is very large: the largest body is 0.1039 m" in note


def test_damping_that_has_an_effect_is_not_warned_of(column):
    moving = column(body={"damping": {"mass": 1.0}}, integration="dynamic")
    assert moving.notes == ()


def test_points_of_one_cable_off_the_body_are_reported_in_one_line(column):
    points = [[-0.0005, 0.0, 0.02 + 0.001 * step] for step in range(65)]
    (note,) = column(cable={"points": points}).notes
    assert "cables[0].points: 65 of 65 points" in note and "0.500 mm outside" in note


def test_a_mesh_in_millimetres_that_does_not_fit_its_scene_gets_a_hint_about_scale(column):
    points = 1e3 * column.mesh.node_positions
    with pytest.raises(SceneError, match="is its mesh in millimetres"):
        column(points)
    elsewhere = {"fixed": {"sphere": {"centre": [0, 0, -1], "radius": 0.5}}}
    with pytest.raises(SceneError, match="is its mesh in millimetres"):
        column(points, body=elsewhere)


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh", ".inp"])
def test_a_file_of_ten_node_tetrahedra_is_quadratic(column, suffix):
    mesh = add_mid_edge_nodes(column.mesh)
    file = f"column{suffix}"
    of_file = column(mesh.node_positions, mesh.cells, "tetra10", suffix, body={"mesh": file})
    asked = column(body={"element": "quadratic"})
    assert of_file.notes == () and of_file.model.bodies[0].entry.element == "quadratic"
    for simulation in (of_file, asked):
        repeat_step(simulation, CommandEfforts(np.array([0.5]), 0.02), 10)
    np.testing.assert_allclose(of_file.effector_positions(), asked.effector_positions(), atol=1e-9)


def test_ten_node_tetrahedra_are_linear_elements_of_their_corners_on_request(column):
    mesh = add_mid_edge_nodes(column.mesh)
    linear = column(mesh.node_positions, mesh.cells, "tetra10", body={"element": "linear"})
    assert linear.node_count == column.mesh.node_count
    assert any("only the corners" in note for note in linear.notes)


def test_mid_edge_nodes_are_fixed_by_their_number_in_the_file(column):
    mesh = add_mid_edge_nodes(column.mesh)
    order = np.random.default_rng(5).permutation(mesh.node_count)
    points, cells = mesh.node_positions[order], np.argsort(order)[mesh.cells]
    foot = np.flatnonzero(points[:, 2] == 0.0)
    held = column(points, cells, "tetra10", body={"fixed": {"nodes": foot.tolist()}})
    fixed = held.model.nodes.rest_positions[held.model.nodes.free_index < 0]
    assert len(fixed) == len(foot) > 9
    assert (fixed[:, 2] == 0.0).all()


@pytest.mark.parametrize("rate", [0.05, None])
def test_without_limits_the_tip_goes_where_it_goes_with_wide_limits(beam, rate):
    reached = []
    for shortening, tension in (([-1.0, 0.09], [0.0, 1e4]), (None, None), ([None, 0.09], None)):

        def change(mapping, limits={"shortening": shortening, "tension": tension, "rate": rate}):
            for cable in mapping["cables"]:
                cable.update(limits)

        simulation = beam(change)
        simulation.warm_up()
        assert np.isinf(simulation.limits.effort_max).all() == (tension is None)
        target = simulation.effector_positions() + [[0.006, 0.003, -0.004]]
        result = repeat_step(simulation, FollowTargets(target, 0.02), 12)
        assert np.isfinite(result.setpoints).all() and (result.setpoints > 0.0).all()
        reached.append(result.effector_positions[0])
    np.testing.assert_allclose(reached[1:], [reached[0]] * 2, atol=1e-6)


def test_no_cable_is_shortened_by_more_than_its_length(beam):
    simulation = beam(lambda mapping: [cable.pop("shortening") for cable in mapping["cables"]])
    np.testing.assert_array_equal(simulation.limits.displacement_max, simulation.rest_setpoints)
    assert np.isinf(simulation.limits.displacement_min).all()


@pytest.mark.parametrize("seed", range(2))
def test_without_limits_a_robot_returns_from_targets_far_outside_its_reach(beam, seed):
    def change(mapping):
        for cable in mapping["cables"]:
            for key in ("shortening", "tension", "rate"):
                cable.pop(key)

    simulation = beam(change)
    home = simulation.effector_positions()
    way = np.random.default_rng(seed).normal(size=3)
    away = home + 0.3 * way / np.linalg.norm(way)
    for target in (away, home):
        for _ in range(80):
            result = simulation.step(FollowTargets(target, 0.02))
            assert np.isfinite(result.setpoints).all() and (result.setpoints > 0.0).all()
    np.testing.assert_allclose(result.effector_positions, home, atol=1e-4)
