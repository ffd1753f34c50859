"""Bodies on floors from STL files glide, slide and roll as on the analytic plane."""

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from test.shapes import Box
from softrobot_twin.simulation import Hold
from test.builder import builder
from test.scene_changes import repeat_step

pytestmark = pytest.mark.sampled

G, STEP, SIZE, SLOPE = 9.81, 0.004, 0.04, np.arctan(0.55)
KINDS = ["coarse", "fine", "irregular", "sliver"]
# Each kind of body at one scale at least, each scale with more than one.
GLIDERS = [
    ("cube", 1.0), ("cube", 1e-3), ("stl cube", 10.0), ("stl cube", 1.0), ("sphere", 1.0),
    ("sphere", 10.0), ("capsule", 1e-3), ("standing cylinder", 1.0), ("lying cylinder", 10.0),
]  # fmt: skip


THICKNESS = 0.1


def cut(kind: str, seed: int = 0) -> np.ndarray:
    """Points of a floor's top, x in [0, 2] and y in [0, 1]; see `KINDS`."""
    random = np.random.default_rng(seed)
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    if kind == "coarse":
        return corners
    if kind == "fine":
        x, y = np.meshgrid(np.linspace(0, 2, 41), np.linspace(0, 1, 21), indexing="ij")
        return np.column_stack([x.ravel(), y.ravel()])
    if kind == "irregular":
        inner = random.uniform([0.02, 0.02], [1.98, 0.98], (300, 2))
        return np.vstack([corners, inner])
    # Points nearly on lines, 1e-5 of the length apart across them.
    along = random.uniform(0.05, 1.95, 120)
    lines = random.choice([0.4, 0.497, 0.503, 0.6], 120)
    across = lines + random.uniform(-2e-5, 2e-5, 120)
    return np.vstack([corners, np.column_stack([along, across])])


def write_slab(path: Path, kind: str, seed: int = 0, scale: float = 1.0) -> str:
    """Write a slab of 2 x 1 x 0.1 times a scale [m], its top through the origin, as binary STL."""
    plane = cut(kind, seed)
    cells = Delaunay(plane, qhull_options="QJ Pp" if kind == "fine" else "Qbb Qc Qz Pp").simplices
    a, b, c = (plane[cells[:, i]] for i in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    cells = np.where(area[:, None] > 0.0, cells, cells[:, ::-1])[np.abs(area) > 1e-14]
    halves = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
    known = {tuple(edge) for edge in halves}
    border = np.array([edge for edge in halves if (edge[1], edge[0]) not in known])
    count = len(plane)
    top = np.column_stack([plane - [0.2, 0.5], np.zeros(count)])
    points = np.vstack([top, top - [0.0, 0.0, THICKNESS]]) * scale
    i, j = border.T
    triangles = np.vstack([
        cells, cells[:, ::-1] + count,
        np.column_stack([j, i, i + count]), np.column_stack([j, i + count, j + count]),
    ])  # fmt: skip
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), binary=True)
    return str(path)


def shape_of(name, scale, folder):
    """A shape 40 mm high times the scale, as a scene says it."""
    half = 0.5 * SIZE * scale
    if name == "cube":
        return {"box": {"size": [SIZE * scale] * 3}}
    if name == "stl cube":
        points, triangles = Box([0, 0, 0], [SIZE * scale] * 3).surface(0.3 * SIZE * scale)
        path = folder / "cube.stl"
        meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), binary=True)
        return {"surface": {"file": str(path)}}
    if name == "sphere":
        return {"sphere": {"radius": half}}
    axis = np.array([0, 0, half] if name == "standing cylinder" else [0, 1.5 * half, 0])
    kind = "capsule" if name == "capsule" else "cylinder"
    return {kind: {"ends": [(-axis).tolist(), axis.tolist()], "radius": half}}


@builder
def laid(scene_of, tmp_path, /, name, floor, scale, friction, tilt=0.0, yaw=0.0, speed=0.0):
    """Makes a body on a floor, its step [s] grown so that it moves alike at every scale."""
    turn = Rotation.from_euler("y", tilt)
    rotation = (turn * Rotation.from_euler("z", yaw)).as_euler("xyz").tolist()
    body = {
        "name": "body", "mass": 0.03 * scale**3, **shape_of(name, scale, tmp_path),
        "position": (scale * turn.apply([0.0, 0.003, 0.5 * SIZE])).tolist(),
        "rotation": rotation, "velocity": [speed * scale**0.5, 0.0, 0.0],
    }  # fmt: skip
    return scene_of(
        integration="dynamic", gravity=[0, 0, -G], rigid_bodies=[body],
        obstacles=[{"name": "floor", "rotation": [0.0, tilt, 0.0], **floor}],
        contact={"friction": friction, "alarm_distance": 0.003 * scale,
                 "tolerance": 1e-6 * scale, "between": [{"pair": ["body", "floor"]}]},
        solver={"newton_iterations": 3, "residual_tolerance": 1e-6 * scale**3},
    ), STEP * scale**0.5  # fmt: skip


# Each glider on each floor, each of both straight ahead and turned.
@pytest.mark.parametrize(("name", "scale", "kind", "yaw"), [
    (*glider, kind, (0.0, 0.3)[(i + j) % 2])
    for i, glider in enumerate(GLIDERS) for j, kind in enumerate(KINDS)
])  # fmt: skip
def test_without_friction_a_body_keeps_its_speed(laid, tmp_path, name, scale, kind, yaw):
    seed = 7
    floor = {"surface": {"file": write_slab(tmp_path / "floor.stl", kind, seed, scale)}}
    simulation, step = laid(name, floor, scale, 0.0, yaw=yaw, speed=1.0)
    for _ in range(100):
        simulation.step(Hold(step))
        velocity = simulation.state.velocities[0] / scale**0.5
        np.testing.assert_allclose(velocity, [1.0, 0.0, 0.0], atol=1e-3)
    height = simulation.state.positions[0, 2] / scale
    assert height == pytest.approx(0.5 * SIZE, abs=1e-5)


@pytest.fixture(scope="module")
def ways_on_the_plane():
    """How far each body slides down the analytic plane [m], once computed."""
    return {}


@pytest.mark.parametrize("name", ["cube", "stl cube", "sphere", "capsule", "lying cylinder"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_body_slides_down_a_slope_as_on_the_analytic_plane(laid, ways_on_the_plane, tmp_path, name, kind):
    """A cube slides against friction, what is round rolls."""

    def way_on(shape):
        simulation, step = laid(name, shape, 1.0, 0.4, tilt=SLOPE)
        before = simulation.state.positions[0].copy()
        repeat_step(simulation, Hold(step), 60)
        way = simulation.state.positions[0] - before
        assert abs(way @ [np.sin(SLOPE), 0.0, np.cos(SLOPE)]) < 1e-5
        return way @ [np.cos(SLOPE), 0.0, -np.sin(SLOPE)]

    if name not in ways_on_the_plane:
        ways_on_the_plane[name] = way_on({"plane": {}})
    expected = ways_on_the_plane[name]
    found = way_on({"surface": {"file": write_slab(tmp_path / "floor.stl", kind, 3)}})
    assert found == pytest.approx(expected, rel=1e-3)
    assert expected > 0.01


@pytest.mark.parametrize("seed", [3, 7, 1003])
def test_a_cube_that_begins_on_a_slope_touches_it_in_the_first_step(laid, tmp_path, seed):
    """Round-off decides on which side of the triangles its corners are."""
    floor = {"surface": {"file": write_slab(tmp_path / "floor.stl", "irregular", seed)}}
    simulation, step = laid("cube", floor, 1.0, 0.8, tilt=SLOPE)
    result = simulation.step(Hold(step))
    assert np.count_nonzero(result.contacts.forces.any(axis=1)) >= 3
    np.testing.assert_allclose(simulation.state.velocities[0], 0.0, atol=1e-9)


@pytest.mark.parametrize("name, share", [("sphere", 2 / 5), ("lying cylinder", 1 / 2)])
@pytest.mark.parametrize("kind", ["plane", "irregular"])
def test_round_bodies_roll_down_with_the_acceleration_of_their_inertia(laid, tmp_path, name, share, kind):
    floor = {"plane": {}}
    if kind != "plane":
        floor = {"surface": {"file": write_slab(tmp_path / "floor.stl", kind, 5)}}
    simulation, step = laid(name, floor, 1.0, 0.5, tilt=SLOPE)
    repeat_step(simulation, Hold(step), 100)
    speed = np.linalg.norm(simulation.state.velocities[0])
    assert speed == pytest.approx(G * np.sin(SLOPE) / (1 + share) * 100 * step, rel=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_a_soft_block_slides_as_on_the_analytic_plane(scene_of, write_block, tmp_path, kind):
    body = {
        "name": "block",
        "mesh": {"file": write_block((SIZE,) * 3, (2, 2, 2)), "translation": [0, 0, SIZE / 2]},
        "material": {"young_modulus": 2e5, "poisson_ratio": 0.3, "density": 1000.0},
    }  # fmt: skip
    file = write_slab(tmp_path / "floor.stl", kind, 3)
    ends = []
    for floor in ({"plane": {}}, {"surface": {"file": file}}):
        simulation = scene_of(
            integration="dynamic", gravity=[G * np.sin(SLOPE), 0.0, -G * np.cos(SLOPE)],
            bodies=[body], obstacles=[{"name": "floor", **floor}],
            contact={"friction": 0.3, "between": [{"pair": ["block", "floor"]}]},
            solver={"newton_iterations": 3, "residual_tolerance": 1e-6},
        )  # fmt: skip
        repeat_step(simulation, Hold(STEP), 50)
        ends.append(simulation.state.positions.mean(axis=0))
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-5)
    assert ends[0][0] > 0.02


@pytest.mark.parametrize("yaw", [0.0, 0.3])
@pytest.mark.parametrize("name", ["cube", "stl cube"])
def test_a_cube_glides_over_a_soft_slab(scene_of, write_block, tmp_path, name, yaw):
    """The slab's own surface, dented hardly at all, holds it back nowhere."""
    slab = {
        "name": "slab",
        "mesh": {"file": write_block((0.4, 0.1, 0.02), (20, 5, 2), shake=0.0),
                 "translation": [0.15, 0.003, -0.01]},
        "material": {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0},
        "damping": {"mass": 20.0},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, -0.0199]}}],
    }  # fmt: skip
    cube = {
        "name": "cube", "mass": 0.03, **shape_of(name, 1.0, tmp_path), "velocity": [1.0, 0, 0],
        "position": [0.0, 0.0, 0.5 * SIZE], "rotation": [0.0, 0.0, yaw],
    }  # fmt: skip
    simulation = scene_of(
        integration="dynamic", gravity=[0, 0, -G], bodies=[slab], rigid_bodies=[cube],
        contact={"friction": 0.0, "between": [{"pair": ["cube", "slab"]}]},
        solver={"newton_iterations": 3, "residual_tolerance": 1e-5},
    )  # fmt: skip
    repeat_step(simulation, Hold(STEP), 60)
    np.testing.assert_allclose(simulation.state.velocities[-2], [1.0, 0, 0], atol=2e-3)


@pytest.mark.parametrize("table", ["box", "stl"])
def test_a_soft_block_glides_over_the_end_of_a_table(scene_of, write_block, tmp_path, table):
    """Its sole passes the table's edge: what is beside the edge is not pushed along."""
    slab = Box([0.0, 0.0, -0.05], [0.06, 0.2, 0.1])
    path = tmp_path / "table.stl"
    points, triangles = slab.surface(0.03)
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), binary=True)
    shape = {"box": {"centre": [0, 0, -0.05], "size": [0.06, 0.2, 0.1]}}
    if table == "stl":
        shape = {"surface": {"file": str(path)}}
    body = {
        "name": "block",
        "mesh": {"file": write_block((SIZE,) * 3, (3, 3, 3)), "translation": [0, 0, SIZE / 2]},
        "material": {"young_modulus": 2e5, "poisson_ratio": 0.3, "density": 1000.0},
    }  # fmt: skip
    simulation = scene_of(
        integration="dynamic", gravity=[0, 0, -G], bodies=[body],
        obstacles=[{"name": "table", **shape}],
        contact={"friction": 0.0, "between": [{"pair": ["block", "table"]}]},
        solver={"newton_iterations": 3, "residual_tolerance": 1e-5},
    )  # fmt: skip
    velocities = np.zeros_like(simulation.state.velocities)
    velocities[:, 0] = 0.5
    simulation.restore(replace(simulation.state, velocities=velocities))
    repeat_step(simulation, Hold(0.002), 20)
    assert simulation.state.velocities[:, 0].mean() == pytest.approx(0.5, rel=0.01)
