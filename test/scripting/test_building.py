"""Scenes in Python without a file: entries, arrays, meshes in memory, and their errors."""

from pathlib import Path

import meshio
import numpy as np
import pytest

import softrobot_twin as st
from test.scene_changes import yaml_file


def test_a_scene_in_python_is_the_same_as_its_file_to_the_bit(entries, tmp_path):
    path = yaml_file(tmp_path / "finger.yaml", entries)
    command = st.targets(tip=[0.1, 0.01, 0.012])
    first, second = st.build(**entries).step(command), st.load(str(path)).step(command)
    assert np.array_equal(first.positions, second.positions)


def test_arrays_may_stand_for_lists(entries):
    entries["cables"][0]["points"] = np.array(entries["cables"][0]["points"])
    entries["gravity"] = np.array([0.0, 0.0, -9.81])
    entries["cables"][0]["rate"] = np.float64(0.05)
    assert st.build(**entries).actuator_names == ("upper", "lower")


def test_patterns_work_in_python_too(entries):
    entries["cables"] = [{
        "repeat": {"count": 2, "names": ["upper", "lower"], "step": [0, 0, -0.016]},
        **{key: value for key, value in entries["cables"][0].items() if key != "name"}}]
    assert st.build(**entries).actuator_names == ("upper", "lower")


@pytest.mark.parametrize(("change", "said"), [
    ({"cabels": []}, "<python>: cabels = []: is not a key here; is cables meant?"),
    ({"gravity": "down"}, "<python>: gravity = 'down'"),
    ({"body": {"mesh": {"file": "nothing.vtk"}}}, "<python>: body."),
])
def test_an_error_names_the_key_as_that_of_a_file(entries, change, said):
    entries.update(change)
    with pytest.raises(st.SoftRobotTwinError) as caught:
        st.build(**entries)
    assert str(caught.value).startswith(said)


def block() -> meshio.Mesh:
    """Five tetrahedra in a cube with edges of 10 mm."""
    points = 0.01 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    tets = [[0, 2, 1, 4], [3, 1, 2, 7], [5, 4, 1, 7], [6, 2, 4, 7], [1, 2, 7, 4]]
    return meshio.Mesh(points, [("tetra", np.array(tets))])


def scene_of(mesh) -> dict:
    return {"name": "block", "body": {
        "mesh": mesh, "element": "linear",
        "material": {"young_modulus": 1.0e5, "poisson_ratio": 0.3, "density": 1000.0},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [0.001, 1, 1]}}]}}


def test_a_mesh_in_memory_is_that_of_its_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = block()
    mesh.write("block.vtu")
    shapes = [st.build(**scene_of(given)).settle().positions
              for given in ("block.vtu", mesh, (mesh.points, mesh.cells[0].data),
                            {"file": mesh}, Path("block.vtu"))]
    assert all(np.array_equal(shapes[0], other) for other in shapes[1:])


@pytest.mark.parametrize("with_sets", ["cell_sets", "gmsh:physical"])
def test_named_parts_of_a_mesh_in_memory_are_kept(with_sets):
    mesh = block()
    if with_sets == "cell_sets":
        mesh.cell_sets = {"hard": [np.array([0, 1])]}
    else:
        mesh.cell_data = {"gmsh:physical": [np.array([1, 1, 2, 2, 2])],
                          "gmsh:geometrical": [np.array([1, 1, 2, 2, 2])]}
        mesh.field_data = {"hard": np.array([1, 3])}
    scene = scene_of(mesh)
    scene["body"]["materials"] = [
        {"region": "hard", "young_modulus": 1.0e6, "poisson_ratio": 0.3, "density": 2000.0}]
    (body,) = st.build(**scene).simulation.model.bodies
    assert sorted(part.density for part in body.materials) == [1000.0, 2000.0]
    assert body.mass == pytest.approx(2 * 1e-6 / 6 * 2000 + (1e-6 - 2 * 1e-6 / 6) * 1000)


@pytest.mark.parametrize("pair", [
    (np.zeros((4, 2)), [[0, 1, 2, 3]]),
    (np.zeros((4, 3)), [[0.0, 1.0, 2.0, 3.0]]),
    (np.zeros((4, 3)), [[0, 1, 2]]),
    ("points", "cells"),
])
def test_arrays_that_are_no_mesh_are_refused(pair):
    with pytest.raises(st.SoftRobotTwinError, match="<python>: body.mesh = .*a mesh is a file"):
        st.build(**scene_of(pair))


def test_notes_about_a_scene_are_warnings(entries):
    entries["body"]["material"]["young_modulus"] = 2.0e-1
    with pytest.warns(st.SceneWarning):
        st.build(**entries)


def test_a_passive_scene_in_motion_falls():
    robot = st.build(
        name="ball", integration="dynamic",
        rigid_bodies=[{"name": "ball", "sphere": {"radius": 0.01}, "mass": 0.1}])
    table = robot.run(seconds=0.1, rate=100)
    # Backward Euler: z = -g h² n (n + 1) / 2.
    assert table["ball_z_m"].tolist()[-1] == pytest.approx(-9.81 * 0.01**2 * 55, rel=1e-9)
    assert robot.setpoint_names == () and repr(robot).startswith("<Robot ball: rigid bodies ball")
    with pytest.raises(st.SoftRobotTwinError, match="no effectors or no actuators|is unknown here"):
        robot.step(st.targets(tip=[0, 0, 0]))
