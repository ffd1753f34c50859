"""A body that touches with a surface that it carries, finer than its mesh or the same."""

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError, SceneError
from test.shapes import Box
from softrobot_twin.simulation import Hold, Simulation, Status
from test.builder import builder

SIDE, STEP, G, DENSITY = 0.04, 0.004, 9.81, 1000.0
WEIGHT = DENSITY * SIDE**3 * G
# Few points of a fine surface are watched.
NEAR = {"friction": 0.5, "alarm_distance": 3e-4, "between": [{"pair": ["cube", "floor"]}]}
MATERIAL = {"young_modulus": 5e4, "poisson_ratio": 0.3, "density": DENSITY}


def written(path, points, triangles):
    meshio.write(path, meshio.Mesh(points, [("triangle", np.asarray(triangles))]), binary=True)
    return str(path)


def cap(radius, cells=40):
    """A block whose sole bulges out as a ball: points, triangles, and how far it bulges [m]."""
    points, triangles = Box([0.0, 0.0, 0.0], [SIDE] * 3).surface(SIDE / cells)
    sole = points[:, 2] < -SIDE / 2 + 1e-9
    square = (points[:, :2] ** 2).sum(axis=1)
    bulge = np.sqrt(radius**2 - square) - np.sqrt(radius**2 - 0.5 * SIDE**2)
    points[sole, 2] -= bulge[sole]
    return points, triangles, bulge.max()


@builder
def cube(scene_of, write_block, /, contact_surface=None, cells=(2, 2, 2), element="linear",
         lift=0.0, **scene):  # fmt: skip
    """Makes a soft cube with its sole at z = 0, and what the scene says besides."""
    body = {
        "name": "cube", "element": element, "material": MATERIAL,
        "mesh": {"file": write_block((SIDE,) * 3, cells), "translation": [0, 0, lift]},
    }  # fmt: skip
    if contact_surface is not None:
        body["contact_surface"] = {"file": contact_surface}
    body |= scene.pop("body", {})
    scene = {"obstacles": [{"name": "floor", "plane": {"point": [0, 0, -SIDE / 2]}}]} | scene
    contact = {"friction": 0.5, "between": [{"pair": ["cube", "floor"]}]}
    return scene_of(**{
        "integration": "dynamic", "gravity": [0, 0, -G], "bodies": [body], "contact": contact,
        "solver": {"newton_iterations": 4, "residual_tolerance": 1e-6},
    } | scene)  # fmt: skip


def run(simulation: Simulation, steps: int):
    return [simulation.step(Hold(STEP)) for _ in range(steps)]


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("obstacle", ["plane", "box", "stl"])
def test_the_mesh_boundary_as_contact_surface_changes_nothing(tmp_path, cube, element, obstacle):
    own = cube(element=element).model.bodies[0].mesh
    skin = written(tmp_path / "skin.stl", own.node_positions, own.surface_triangles)
    floor = {"name": "floor", "position": [0, 0, -SIDE / 2]}
    block = Box([0.01, 0.0, -0.05], [0.3, 0.2, 0.1])
    floor |= {
        "plane": {"plane": {}},
        "box": {"box": {"centre": list(block.centre), "size": list(block.size)}},
        "stl": {"surface": {"file": written(tmp_path / "floor.stl", *block.surface(0.03))}},
    }[obstacle]
    mine, carried = (
        cube(surface, element=element, lift=1e-3, obstacles=[floor]) for surface in (None, skin)
    )
    for one, other in zip(run(mine, 15), run(carried, 15), strict=True):
        np.testing.assert_allclose(other.state.positions, one.state.positions, rtol=0, atol=2e-6 * SIDE)
    assert mine.state.positions[:, 2].min() < -SIDE / 2 + 1e-6


def test_a_cap_finer_than_the_mesh_carries_the_weight_on_the_floor(tmp_path, cube):
    points, triangles, bulge = cap(0.1, 24)
    simulation = cube(
        written(tmp_path / "cap.stl", points, triangles), lift=bulge,
        body={"damping": {"mass": 40.0}}, contact=NEAR,
    )  # fmt: skip
    results = run(simulation, 80)
    last = results[-1]
    assert last.status is Status.OK
    of_pairs = last.contacts.of_pairs()
    np.testing.assert_allclose(of_pairs.resultants, [[0, 0, WEIGHT]], atol=2e-3 * WEIGHT)
    # It rests on the middle of the cap, where the mesh has no nodes.
    places = last.contacts.positions
    assert len(places) >= 3
    assert np.hypot(places[:, 0], places[:, 1]).max() < 0.3 * SIDE
    np.testing.assert_allclose(places[:, 2], -SIDE / 2, atol=1e-6)


@pytest.mark.exhaustive
def test_a_fine_cap_on_a_coarse_block_indents_as_hertz_predicts(tmp_path, cube):
    """The mesh's own sole is flat: that the force grows as δ^1.5 comes from the cap."""
    radius = 0.5
    points, triangles, bulge = cap(radius, 24)
    simulation = cube(
        written(tmp_path / "cap.stl", points, triangles), cells=(6, 6, 6), element="quadratic",
        lift=bulge, integration="quasi_static", gravity=[0, 0, 0],
        rigid_bodies=[{"name": "plate", "motion": "guided", "position": [0, 0, -SIDE / 2 - 0.005],
                       "box": {"size": [0.1, 0.1, 0.01]}}],
        obstacles=[], contact=NEAR | {"between": [{"pair": ["cube", "plate"]}]},
        body={"fixed": [{"box": {"minimum": [-1, -1, SIDE / 2 + bulge - 1e-6],
                                 "maximum": [1, 1, 1]}}]},
    )  # fmt: skip
    loads = []
    for depth in (0.05e-3, 0.1e-3):
        simulation.model.guides.aim("plate", [0, 0, -SIDE / 2 - 0.005 + depth])
        result = run(simulation, 8)[-1]
        loads.append(float(result.contacts.of_pairs().resultants[0, 2]))
    power = np.log(loads[1] / loads[0]) / np.log(2.0)
    hertz = 4 / 3 * 5e4 / (1 - 0.3**2) * np.sqrt(radius) * (0.1e-3) ** 1.5
    print(f"power {power:.3f}, force {loads[1]:.4f} N, Hertz {hertz:.4f} N")
    assert power == pytest.approx(1.5, abs=0.15)
    assert loads[1] == pytest.approx(hertz, rel=0.1)


def test_a_contact_surface_slides_with_friction_as_the_mesh_boundary(tmp_path, cube):
    slope = np.arctan(0.7)
    gravity = [G * np.sin(slope), 0.0, -G * np.cos(slope)]
    skin = written(tmp_path / "skin.stl", *Box([0, 0, 0], [SIDE] * 3).surface(SIDE / 7))
    ways = []
    for surface in (None, skin):
        simulation = cube(surface, gravity=gravity)
        before = simulation.state.positions.mean(axis=0)
        run(simulation, 50)
        ways.append((simulation.state.positions.mean(axis=0) - before)[0])
    assert ways[1] == pytest.approx(ways[0], rel=0.01)
    assert ways[0] > 0.01


def test_two_bodies_touch_with_their_contact_surfaces(tmp_path, cube, write_block):
    """A cap below the body touches a block, which its own flat sole would not reach."""
    points, triangles, bulge = cap(0.1, 24)
    ground = {
        "name": "ground", "material": MATERIAL | {"young_modulus": 5e5},
        "mesh": {"file": write_block((0.08, 0.08, 0.02), (2, 2, 1), name="ground"),
                 "translation": [0, 0, -SIDE / 2 - 0.01]},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, -SIDE / 2 - 0.0199]}}],
        "contact_surface": {"file": written(
            tmp_path / "top.stl", *Box([0, 0, 0], [0.08, 0.08, 0.02]).surface(0.02))},
    }  # fmt: skip
    upper = {
        "name": "cube", "material": MATERIAL, "damping": {"mass": 20.0},
        "mesh": {"file": write_block((SIDE,) * 3, (2, 2, 2)), "translation": [0, 0, bulge]},
        "contact_surface": {"file": written(tmp_path / "cap.stl", points, triangles)},
    }  # fmt: skip
    simulation = cube(
        bodies=[upper, ground], obstacles=[],
        contact=NEAR | {"between": [{"pair": ["cube", "ground"]}]},
    )  # fmt: skip
    last = run(simulation, 80)[-1]
    of_pairs = last.contacts.of_pairs()
    assert abs(of_pairs.resultants[0, 2]) == pytest.approx(WEIGHT, rel=0.02)


def test_a_body_meets_itself_with_its_contact_surface(tmp_path, cube):
    """The detector of self-contact takes it; at rest nothing of it touches."""
    skin = written(tmp_path / "skin.stl", *Box([0, 0, 0], [SIDE] * 3).surface(SIDE / 5))
    contact = {"between": [{"pair": ["cube", "floor"]}, {"pair": ["cube", "cube"]}]}
    simulation = cube(skin, contact=contact)
    last = run(simulation, 10)[-1]
    assert set(last.contacts.pairs) == {0}
    surface = simulation.model.contacts.pairs[1].first
    assert surface.point_count == len(Box([0, 0, 0], [SIDE] * 3).surface(SIDE / 5)[0])


def test_a_flipped_contact_surface_is_reversed_and_reported_with_its_file_name(tmp_path, cube):
    points, triangles = Box([0, 0, 0], [SIDE] * 3).surface(SIDE / 5)
    simulation = cube(written(tmp_path / "skin.stl", points, triangles[:, ::-1]))
    assert any("skin.stl: reversed" in note for note in simulation.model.notes)
    assert run(simulation, 10)[-1].status is Status.OK


def test_an_open_contact_surface_is_refused_by_file_name(tmp_path, cube):
    points, triangles = Box([0, 0, 0], [SIDE] * 3).surface(SIDE / 5)
    with pytest.raises(MeshError, match=r"skin\.stl: its surface is open"):
        cube(written(tmp_path / "skin.stl", points, triangles[1:]))


@pytest.mark.parametrize(("scale", "shift", "words"), [
    (1.0, 0.03, "stands off its body"), (1000.0, 0.0, "stands off its body"),
    (0.001, 0.0, "less than half"),
])  # fmt: skip
def test_a_contact_surface_that_is_not_on_the_body_is_refused(tmp_path, cube, scale, shift, words):
    points, triangles = Box([0, 0, 0], [SIDE] * 3).surface(SIDE / 5)
    skin = written(tmp_path / "skin.stl", scale * points + shift, triangles)
    with pytest.raises(SceneError, match=rf"bodies\[0\]\.contact_surface\.file.*{words}"):
        cube(skin)
