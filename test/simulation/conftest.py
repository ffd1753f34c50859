"""Scenes that the tests of this room share: the Diamond on its coarsest mesh, and variations."""

from __future__ import annotations

import copy
import itertools
from pathlib import Path

import meshio
import numpy as np
import pytest

from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.reduced_points import ReducedPoints
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Hold, Simulation, State, Status
from test.builder import builder
from test.scene_changes import change_scene, entries_of, repeat_step
from test.spheres import cut_on_sphere

SCENE_FILE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "diamond.yaml"
MAPPING = entries_of(SCENE_FILE, {"body.mesh.file": "../../meshes/diamond_400.vtk", "body.element": "linear"})
TRUNK_FILE = SCENE_FILE.with_name("trunk_cylinders.yaml")
TRUNK = entries_of(TRUNK_FILE, {"body.mesh.file": "../../meshes/trunk_1600.vtk", "body.element": "linear"})


@builder
def diamond(*changes) -> Simulation:
    """Makes a simulation of the coarse Diamond, its scene changed by `change_scene`."""
    mapping = copy.deepcopy(MAPPING)
    change_scene(mapping, *changes)
    return Simulation(scene_from_mapping(mapping, SCENE_FILE))


@builder
def settle(simulation, command=None, steps=40):
    """Steps until the body is at rest, and returns the last result."""
    for _ in range(steps):
        result = simulation.step(Hold() if command is None else command)
        if result.report.residual < 1e-9:
            break
    return result


@builder
def circle(count=40, radius=0.015, height=0.135):
    """Targets on a circle inside the Diamond's workspace [m], shape (count, 1, 3)."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)], axis=1
    )[:, None, :]


@builder
def beam(simulate, body_of, block, /, *changes) -> Simulation:
    """Makes a slim upright beam with four cables along it, its scene changed by `change_scene`.

    It is 100 mm high, 20 mm thick, held at its foot and weightless; its tip is the effector.
    """

    def cable(name, x, y) -> dict:
        return {
            "name": name, "pull_point": [x, y, 0.0],
            "points": [[x, y, z] for z in (0.02, 0.04, 0.06, 0.08, 0.095)],
            "shortening": [0.0, 0.02], "rate": 0.05, "tension": [0.0, 40.0],
        }  # fmt: skip

    foot = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]
    mesh = block(size=(0.02, 0.02, 0.1), cells=(1, 1, 5))
    mapping = {
        "gravity": [0.0, 0.0, 0.0],
        "body": body_of(mesh, "beam", young_modulus=3e5, fixed=foot),
        "cables": [cable("east", 0.018, 0.01), cable("north", 0.01, 0.018),
                   cable("west", 0.002, 0.01), cable("south", 0.01, 0.002)],
        "effectors": [{"name": "tip", "points": [[0.01, 0.01, 0.1]]}],
        "solver": {"newton_iterations": 3, "residual_tolerance": 1e-6},
    }  # fmt: skip
    change_scene(mapping, *changes)
    return simulate(**mapping)


@builder
def rod(mapping, x=0.03, z=0.08, radius=0.005, name="rod", **contact) -> None:
    """Adds a fixed rod to a scene, in the path of the beam.

    The rod lies along y; its side is `x - radius - 0.02` from the beam at rest [m].
    """
    rods = mapping.setdefault("obstacles", [])
    ends = [[x, -0.05, z], [x, 0.07, z]]
    rods.append({"name": name, "cylinder": {"ends": ends, "radius": radius}})
    touching = mapping.setdefault("contact", {"between": [], **contact})
    touching["between"].append({"pair": ["beam", name]})


@builder
def coarse_trunk(*changes) -> Simulation:
    """Makes the Trunk between its cylinders, coarse, changed by `change_scene`, and settled."""
    mapping = copy.deepcopy(TRUNK)
    change_scene(mapping, {"body.mesh.file": "../../meshes/trunk_700.vtk"}, *changes)
    simulation = Simulation(scene_from_mapping(mapping, TRUNK_FILE))
    repeat_step(simulation, Hold(0.02), 20)
    return simulation


@pytest.fixture
def eight(beam, rod):
    """A beam with four long and four short cables; a function may change its scene further."""

    def make(directions=("x", "y", "z"), change=rod):
        def add(mapping):
            for cable in list(mapping["cables"]):
                short = {**cable, "name": f"{cable['name']}_short", "points": cable["points"][:3]}
                mapping["cables"].append(short)
            mapping["effectors"][0]["directions"] = list(directions)
            change(mapping)

        return beam(add)

    return make


@builder
def recovers(settle, /, simulation: Simulation, collapse: str, steps: int) -> None:
    """Asserts that a collapsed body comes back, or says that it is inside out.

    One that was mirrored or lay in a point may come to rest in another stable shape; which it is hangs
    on round-off.
    """
    expected = settle(simulation).state.positions
    x = simulation.model.nodes.rest_positions.copy()
    free = simulation.model.nodes.free_nodes
    if collapse == "plane":
        x[free, 2] = 0.0
    elif collapse == "point":
        x[free] = [0.0, 0.0, 0.02]
    elif collapse == "random":
        x[free] = np.random.default_rng(0).uniform(-0.1, 0.1, (len(free), 3))
    else:
        x[free, 2] = -x[free, 2]
    simulation.restore(State(x, simulation.state.setpoints, simulation.state.efforts))
    for _ in range(steps):
        result = simulation.step(Hold())
        assert np.all(np.isfinite(result.state.positions))
        if result.report.residual < 1e-9:
            break
    if collapse != "plane" and result.status is Status.INVERTED:
        assert result.report.inverted_count > 0
        return
    if collapse == "random" and "elements.inversion" in result.report.active_limits:
        # Unfolded, but tangled: what resists folding keeps it there, and is named.
        return
    assert result.report.residual < 1e-6
    reached = result.state
    if collapse in ("mirrored", "point") and np.abs(reached.positions - expected).max() > 1e-6:
        # All its elements upright, it found another balance: it is stable if it is found again.
        expected, stirred = reached.positions, reached.positions.copy()
        stirred[free] += np.random.default_rng(0).normal(0.0, 1e-5, (len(free), 3))
        simulation.restore(State(stirred, reached.setpoints, reached.efforts))
        reached = settle(simulation).state
    np.testing.assert_allclose(reached.positions, expected, atol=1e-6)


@builder
def simulate(tmp_path, /, **mapping) -> Simulation:
    """Makes a simulation of a scene that is written here as a mapping; exact unless it says."""
    mapping.setdefault("name", "scene")
    mapping.setdefault("solver", {"newton_iterations": 30, "residual_tolerance": 1e-9})
    return Simulation(scene_from_mapping(mapping, tmp_path / "scene.yaml"))


@builder
def body_of(tmp_path, /, mesh, name="soft", young_modulus=1e5, poisson_ratio=0.3, **entries) -> dict:
    """Makes the entry of a soft body of silicone from a mesh; more entries may be given."""
    path = tmp_path / f"{name}.vtk"
    meshio.write(path, meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)]))
    material = {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio, "density": 1000.0}
    return {
        "name": name, "mesh": {"file": str(path)}, "element": "linear", "material": material,
        **entries,
    }  # fmt: skip


@builder
def energies(simulation: Simulation) -> tuple[float, float]:
    """Energy stored in stretch and height, and of motion [J], of a simulation's present state."""
    x, v = simulation.state.positions, simulation.state.velocities
    nodes = simulation.model.nodes
    unknowns = np.zeros((nodes.free_node_count, 3))
    unknowns[: len(nodes.free_nodes)] = x[nodes.free_nodes]
    for frames in nodes.kinds:
        if isinstance(frames, ReducedPoints):
            continue
        unknowns[frames.translations] = x[frames.origins]
    stored = moving = 0.0
    for term in simulation.model.forces:
        if term.name == "gravity":
            stored -= float(np.sum(term.weights * unknowns))
        moving += term.kinetic_energy(x, v)
        stored += term.energy(x)
    return stored, moving


@builder
def write_block(tmp_path, block, /, size, cells, move=None, name="block", shake=0.2) -> str:
    """Writes a box of tetrahedra about the origin; gives the file. A function may move nodes."""
    import meshio
    mesh = block(size, cells, shake)
    x = mesh.node_positions - 0.5 * np.array(size)
    file = tmp_path / f"{name}.vtk"
    meshio.write(file, meshio.Mesh(x if move is None else move(x), [("tetra", mesh.cells)]))
    return str(file)


@builder
def scene_of(**entries) -> Simulation:
    """Makes a simulation of a scene given entry by entry."""
    return Simulation(scene_from_mapping({"name": "scene", **entries}))


@builder
def soft_block(write_block, /, name, size, cells, centre=(0.0, 0.0, 0.0), **entries) -> dict:
    """Makes the entry of a soft box of linear tetrahedra [m]; more entries may be given."""
    mesh = {"file": write_block(size, cells), "translation": list(centre)}
    return {"name": name, "mesh": mesh, "element": "linear",
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0}, **entries}


@builder
def pad(scene_of, soft_block, /, friction, cells=(4, 4, 2), speed=0.05, solver=(), **body) -> Simulation:
    """Makes a pad of 40 x 40 x 20 mm on a floor, its top on a guided plate of a speed [m/s]."""
    return scene_of(
        gravity=[0, 0, 0], integration="dynamic", solver=dict(solver),
        body=soft_block("pad", (0.04, 0.04, 0.02), cells, [0, 0, 0.01], **body,
                        attached=[{"to": "plate", "box": {"minimum": [-1, -1, 0.0199], "maximum": [1, 1, 1]}}]),
        rigid_bodies=[{"name": "plate", "motion": "guided", "speed": speed, "position": [0, 0, 0.03],
                       "box": {"size": [0.05, 0.05, 0.02]}}],
        obstacles=[{"name": "floor", "plane": {}}],
        contact={"friction": friction, "between": [{"pair": ["pad", "floor"]}]},
    )  # fmt: skip


@builder
def hollow(tmp_path, block, body_of, /, size=(0.02, 0.02, 0.06), cells=(4, 4, 6),
           hole=((1, 3), (1, 3), (1, 5)), shake=0.0, name="hollow", **entries):  # fmt: skip
    """Makes the entry of a block with a cavity inside, and the file of the cavity's surface.

    The cavity fills the inner cells of the block's grid. Its lower end is held.
    """
    from softrobot_twin.geometry.surface import boundary_triangles
    mesh = block(size, cells, shake)
    grid = block(size, cells, 0.0)
    middle = grid.node_positions[grid.cells].mean(axis=1) * cells / size
    low, high = np.array(hole).T
    inside = ((middle > low) & (middle < high)).all(axis=1)
    triangles = boundary_triangles(mesh.cells[inside])
    used, index = np.unique(mesh.cells[~inside], return_inverse=True)
    points = mesh.node_positions
    surface = tmp_path / f"{name}_cavity.vtk"
    meshio.write(surface, meshio.Mesh(points, [("triangle", triangles)]))
    body = type(mesh)(points[used], index.reshape(-1, 4))
    foot = [{"box": {"minimum": [-9, -9, -9], "maximum": [9, 9, 1e-4 * size[2]]}}]
    return body_of(body, name, **{"fixed": foot, **entries}), str(surface)


@builder
def inflatable(simulate, hollow, /, *changes, body=None, **entries) -> Simulation:
    """Makes a weightless hollow block with one cavity, its scene changed by `change_scene`."""
    soft, surface = hollow(**(body or {}))
    cavity = {"name": "air", "walls": [{"file": surface}], "pressure": [0.0, 2.0e4], **entries}
    mapping = {"gravity": [0.0, 0.0, 0.0], "body": soft, "cavities": [cavity]}
    change_scene(mapping, *changes)
    return simulate(**mapping)


@builder
def icosphere(level):
    """Makes a sphere of triangles, by the number of its refinements.

    Points on the unit sphere and outward triangles.
    """
    golden = 0.5 * (1.0 + 5.0**0.5)
    corners = [(0, a, b * golden) for a, b in itertools.product((-1, 1), repeat=2)]
    points = np.array([np.roll(c, shift) for shift in range(3) for c in corners], float)
    points /= np.linalg.norm(points[0])
    near = np.linalg.norm(points[:, None] - points, axis=2) < 1.2
    triangles = [t for t in itertools.combinations(range(12), 3)
                 if all(near[i, j] for i, j in itertools.combinations(t, 2))]  # fmt: skip
    triangles = np.array(
        [t if np.linalg.det(points[list(t)]) > 0.0 else t[::-1] for t in triangles]
    )
    return cut_on_sphere(points, triangles, level)


@builder
def layered(layers, triangles):
    """Fills the space between layers of the same triangles.

    Tetrahedra between layers of the same triangles, each layer given by its points.
    """
    count, tets = len(layers[0]), []
    sorted_triangles = np.sort(triangles, axis=1)
    for k in range(len(layers) - 1):
        (a, b, c), up = sorted_triangles.T + k * count, count
        prism = ((a, b, c, c + up), (a, b, b + up, c + up), (a, a + up, b + up, c + up))
        tets += [np.stack(tet, axis=1) for tet in prism]
    points, tets = np.concatenate(layers), np.concatenate(tets)
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    wrong = np.linalg.det(edges) < 0.0
    tets[wrong] = tets[wrong][:, [0, 2, 1, 3]]
    return TetMesh(points, tets)


@builder
def two_cavities(simulate, body_of, block, tmp_path, /, *changes):
    """Makes a solid block with two cavities inside, side by side; `change_scene` changes it.

    They are thin boxes between its elements: their gas pushes the material apart.
    """
    foot = [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}]
    mesh = block(size=(0.02, 0.02, 0.06), cells=(4, 4, 6), shake=0.0)
    mapping = {
        "gravity": [0.0, 0.0, 0.0], "body": body_of(mesh, "block", fixed=foot), "cavities": [],
        "effectors": [{"name": "top", "points": [[0.01, 0.01, 0.06]], "directions": ["x"]}],
    }  # fmt: skip
    box = block(size=(0.003, 0.016, 0.05), cells=(1, 4, 8), shake=0.0)
    for name, x in (("left", 0.003), ("right", 0.014)):
        points = box.node_positions + [x, 0.002, 0.005]
        meshio.write(tmp_path / f"{name}.stl",
                     meshio.Mesh(points, [("triangle", box.surface_triangles)]))  # fmt: skip
        wall = {"file": str(tmp_path / f"{name}.stl")}
        mapping["cavities"].append({"name": name, "walls": [wall], "pressure": [0.0, 5e4]})
    change_scene(mapping, *changes)
    return simulate(**mapping)
