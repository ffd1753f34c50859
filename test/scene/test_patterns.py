"""Patterns of scenes: copies equal entries written by hand; what cannot be repeated is refused."""

from __future__ import annotations

import copy
import math
import random
from pathlib import Path

import meshio
import numpy as np
import pytest
from pydantic import BaseModel

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import Scene, scene_from_mapping
from softrobot_twin.scene.entry import Entry, is_entry, item_of_list, plain
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.scene.patterns import MOST_COPIES, Pattern
from softrobot_twin.simulation import Simulation
from test.places import ROOT

ROBOT = read_yaml(f"""
name: robot
body:
  name: diamond
  mesh: {ROOT}/meshes/diamond_150.vtk
  material: {{young_modulus: 180.0e3, poisson_ratio: 0.45, density: 1070.0}}
  element: linear
  fixed: {{box: {{minimum: [-0.015, -0.015, -0.040], maximum: [0.015, 0.015, 0.010]}}}}
""")
CABLE = {"name": "L#", "pull_point": [0.0, 0.01, 0.03], "points": [[0.0, 0.097, 0.045]],
         "shortening": [0.0, 0.04]}  # fmt: skip


def robot(**sections) -> dict:
    return copy.deepcopy(ROBOT) | copy.deepcopy(sections)


def repeated(section: str, entry: dict, repeat, **others) -> tuple:
    """The entries of a section that one repeated entry makes."""
    return getattr(scene_from_mapping(robot(**{section: [{**entry, "repeat": repeat}]}, **others)), section)


def refused(mapping: dict) -> SceneError:
    with pytest.raises(SceneError) as error:
        scene_from_mapping(mapping, Path("robot.yaml"))
    assert all(line.startswith("robot.yaml: ") for line in str(error.value).splitlines())
    return error.value


BY_HAND = """
cables:
  - {name: north, pull_point: [0.0, 0.01, 0.03], points: [[0.0, 0.097, 0.045]], tension: [0, 20]}
  - {name: west, pull_point: [-0.01, 0.0, 0.03], points: [[-0.097, 0.0, 0.045]], tension: [0, 20]}
  - {name: south, pull_point: [0.0, -0.01, 0.03], points: [[0.0, -0.097, 0.045]], tension: [0, 20]}
  - {name: east, pull_point: [0.01, 0.0, 0.03], points: [[0.097, 0.0, 0.045]], tension: [0, 20]}
springs:
  - {name: s_0, ends:
      [{on: diamond, point: [0.0, 0.09, 0.045]}, {point: [0.0, 0.2, 0.1]}], stiffness: 5}
  - {name: s_1, ends:
      [{on: diamond, point: [-0.09, 0.0, 0.045]}, {point: [-0.2, 0.0, 0.1]}], stiffness: 5}
markers:
  - {id: 3, point: [0.0, 0.097, 0.045]}
  - {id: 4, point: [-0.097, 0.0, 0.045]}
  - {id: 5, point: [0.0, -0.097, 0.045]}
"""
AS_PATTERN = """
cables:
  - repeat: {about: z, names: [north, west, south, east]}
    pull_point: [0.0, 0.01, 0.03]
    points: [0.0, 0.097, 0.045]
    tension: [0, 20]
springs:
  - {name: s, ends:
      [{on: diamond, point: [0.0, 0.09, 0.045]}, {point: [0.0, 0.2, 0.1]}], stiffness: 5,
     repeat: {count: 2, about: [0, 0, 3], angle: 1.5707963267948966}}
markers:
  - {id: 3, point: [0.0, 0.097, 0.045], repeat: {count: 3, about: z, angle: 1.5707963267948966}}
"""


def test_a_pattern_equals_its_entries_written_by_hand_to_the_bit():
    by_hand = scene_from_mapping(robot(**read_yaml(BY_HAND)))
    scene = scene_from_mapping(robot(**read_yaml(AS_PATTERN)))
    assert repr(scene) == repr(by_hand) and scene == by_hand  # repr tells 0.0 from -0.0


def test_written_out_a_scene_has_no_pattern_and_is_the_same_scene():
    mapping = robot(**read_yaml(AS_PATTERN))
    plain_mapping = written_out(mapping)
    assert "repeat" not in repr(plain_mapping) and "repeat" in repr(mapping)
    assert scene_from_mapping(plain_mapping) == scene_from_mapping(mapping)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6, 7, 12])
def test_a_pattern_closes_around_its_axis(count):
    """Copies rotate right-handed by a full turn over their number; their mean is on the axis."""
    seed = random.randrange(10**6)
    print("seed", seed)
    chance = np.random.default_rng(seed)
    axis, point, place = chance.normal(size=(3, 3))
    pattern = Pattern(count=count, about=tuple(axis), point=tuple(point))
    placed = np.array([pattern.motion(number).point(tuple(place)) for number in range(count)])
    along = axis / np.linalg.norm(axis)
    arms = placed - point - np.outer((placed - point) @ along, along)
    np.testing.assert_allclose(placed[0], place, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), np.linalg.norm(arms[0]), rtol=1e-12)
    np.testing.assert_allclose((placed - point) @ along, (place - point) @ along, atol=1e-12)
    for first, second in zip(arms, arms[1:], strict=False):
        turned = math.atan2(along @ np.cross(first, second), first @ second)
        assert turned == pytest.approx(2.0 * math.pi / count) or count == 2


def test_multiples_of_thirty_degrees_give_clean_numbers():
    cables = repeated("cables", CABLE | {"pull_point": [2.0, 0.0, 0.5]}, {"count": 6, "about": "z"})
    assert [cable.pull_point[0] for cable in cables] == [2.0, 1.0, -1.0, -2.0, -1.0, 1.0]
    assert {cable.pull_point[2] for cable in cables} == {0.5}


def test_steps_and_turns_nest_and_name_their_copies():
    tube = {"name": "t#2_#1", "points": [[0.01, 0, 0], [0.01, 0, 0.005]], "axial_stiffness": 1.0}
    patterns = [{"count": 3, "step": [0, 0, 0.02]}, {"count": 2, "about": "z"}]
    tubes = repeated("tubes", tube, patterns)
    assert [t.name for t in tubes] == ["t0_0", "t0_1", "t0_2", "t1_0", "t1_1", "t1_2"]
    assert tubes[2].points == ((0.01, 0.0, 0.04), (0.01, 0.0, 0.045))
    assert tubes[4].points == ((-0.01, 0.0, 0.02), (-0.01, 0.0, 0.025))
    tubes = repeated("tubes", tube | {"name": "t"}, {"count": 2, "about": "y", "first": 1, "step": [0, 1, 0]})
    assert [t.name for t in tubes] == ["t_1", "t_2"]
    assert tubes[1].points[1] == (-0.01, 1.0, -0.005)


def test_a_mark_names_the_copy_of_another_entry():
    finger = {**ROBOT["body"], "name": "finger_#", "repeat": {"count": 3, "about": "z"},
              "mesh": {"file": ROBOT["body"]["mesh"], "translation": [0.2, 0, 0]},
              "fixed": [{"sphere": {"centre": [0.2, 0, 0], "radius": 0.02}}]}  # fmt: skip
    scene = scene_from_mapping({
        "name": "hand", "bodies": [finger],
        "cables": [{**CABLE, "body": "finger_#", "frame": "mesh", "repeat": 3}],
        "motors": [{"name": "m", "cables": "L#", "repeat": 3}],
        "contact": {"between": [{"pair": ["finger_#", "finger_#"], "repeat": 3}]},
        "cavities": [{"name": "grip", "walls": [{"body": "finger_#", "part": "c", "repeat": 3}]}],
        "effectors": [{"name": "tip", "body": "finger_#", "points": [0.2, 0, 0.1],
                       "directions": "xyz", "measured_by": [0],
                       "repeat": {"count": 3, "about": "z"}}],
        "markers": [{"id": 0, "body": "finger_#", "point": [0.2, 0, 0.1],
                     "repeat": {"count": 3, "about": "z"}}],
    })  # fmt: skip
    assert [body.name for body in scene.bodies] == ["finger_0", "finger_1", "finger_2"]
    assert [cable.body for cable in scene.cables] == ["finger_0", "finger_1", "finger_2"]
    assert {cable.points for cable in scene.cables} == {((0.0, 0.097, 0.045),)}
    assert [motor.cables for motor in scene.motors] == [("L0",), ("L1",), ("L2",)]
    assert [wall.body for wall in scene.cavities[0].walls] == ["finger_0", "finger_1", "finger_2"]
    assert [touching.pair for touching in scene.contact.between][2] == ("finger_2", "finger_2")
    for effector, marker, body in zip(scene.effectors, scene.markers, scene.bodies, strict=True):
        assert effector.measured_by == (marker.id,) and effector.points == (marker.point,)
        assert body.fixed[0].sphere.centre == body.mesh.translation
    assert scene.bodies[1].mesh.rotation == (0.0, 0.0, 2.0 * math.pi / 3.0)


def test_a_box_turns_by_quarters_only():
    corner = {"box": {"minimum": [0.01, -0.002, 0], "maximum": [0.02, 0.001, 1]}}
    around = {"repeat": {"count": 4, "about": "z"}}
    scene = scene_from_mapping(robot(body={**ROBOT["body"], "fixed": [corner | around]}))
    box = scene.body.fixed[1].box
    assert (box.minimum, box.maximum) == ((-0.001, 0.01, 0.0), (0.002, 0.02, 1.0))
    around["repeat"]["count"] = 3
    error = refused(robot(body={**ROBOT["body"], "fixed": [corner | around]}))
    assert error.key == "body.fixed[0].box" and "120°" in error.reason and "copy 2" in error.reason


@pytest.mark.parametrize("angles", [(0.3, -0.2, 0.9), (1.0, 0.5 * math.pi, 0.4), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("about", ["x", "y", "z", [1.0, 2.0, -1.0]])
def test_a_repeated_body_is_turned_as_a_whole(about, angles):
    """Its own rotation, then the pattern's: rotation matrices multiply."""
    from scipy.spatial.transform import Rotation
    made = repeated("rigid_bodies", {"name": "b", "mass": 1.0, "sphere": {"radius": 1.0},
                                     "position": [1.0, 2.0, 3.0], "velocity": [0.1, 0.2, 0.3],
                                     "rotation": list(angles)}, {"count": 5, "about": about})
    axis = np.array({"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}.get(
        about if isinstance(about, str) else "", about), float)  # fmt: skip
    own = Rotation.from_euler("xyz", angles)
    for number, body in enumerate(made):
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * 2.0 * math.pi * number / 5)
        expected = (turn * own).as_matrix()
        np.testing.assert_allclose(Rotation.from_euler("xyz", body.rotation).as_matrix(), expected,
                                   atol=1e-12)  # fmt: skip
        np.testing.assert_allclose(body.position, turn.apply([1, 2, 3]), atol=1e-12)
        np.testing.assert_allclose(body.velocity, turn.apply([0.1, 0.2, 0.3]), atol=1e-12)


@pytest.mark.parametrize("about", ["x", [1.0, 1.0, 0.5]])
def test_the_threads_of_a_repeated_helix_turn_with_it(about):
    from softrobot_twin.geometry.helix import helix_points
    entry = {"name": "h", "stiffness": 1.0, "helix": {
        "point": [0.1, 0, 0], "direction": [0.2, 0.1, 1.0], "radius": 0.01, "pitch": 0.02,
        "reach": [0.0, 0.1], "phase": 0.3}}  # fmt: skip
    pattern = Pattern(count=3, about=about)

    def points(helix):
        return helix_points(np.array(helix.point), np.array(helix.direction), helix.radius,
                            helix.pitch, helix.reach, helix.phase, 1, 24)  # fmt: skip

    made = repeated("fibres", entry, {"count": 3, "about": about})
    for number, fibre in enumerate(made):
        turned = [pattern.motion(number).point(tuple(p)) for p in points(made[0].helix).tolist()]
        np.testing.assert_allclose(points(fibre.helix), turned, atol=1e-12)


def test_directions_turn_into_those_of_the_world_or_are_refused():
    tip = {"name": "tip", "points": [0.05, 0, 0], "directions": "xz"}
    made = repeated("effectors", tip, {"count": 4, "about": "z"})
    assert [e.directions for e in made] == [("x", "z"), ("y", "z"), ("x", "z"), ("y", "z")]
    error = refused(robot(effectors=[tip | {"repeat": {"count": 3, "about": "z"}}]))
    assert error.key == "effectors[0].directions" and "120°" in error.reason


def entry_types(model: type[BaseModel] = Scene, found: dict | None = None) -> dict:
    found = {} if found is None else found
    for field in model.model_fields.values():
        item = item_of_list(field.annotation)
        inner = plain(field.annotation) if item is None else item
        inner = inner if is_entry(inner) else next(
            (one for one in getattr(inner, "__args__", ()) if is_entry(one)), inner)  # fmt: skip
        if is_entry(inner) and inner not in found:
            found[inner] = None
            entry_types(inner, found)
    return found


@pytest.mark.parametrize("model", entry_types(), ids=lambda model: model.__name__)
def test_every_vector_of_an_entry_that_can_be_repeated_has_a_place(model: type[Entry]):
    """Whoever adds a vector to such an entry says in `placed` how it turns."""
    if model.placed is None:
        return
    assert set(model.placed) <= set(model.model_fields)
    for name, field in model.model_fields.items():
        annotation = plain(field.annotation)
        vector = item_of_list(annotation) or annotation
        arguments = [plain(one) for one in getattr(plain(vector), "__args__", ())]
        if arguments == [float, float, float]:
            assert name in model.placed, f"{model.__name__}.{name}"


@pytest.mark.parametrize("repeat, key, words", [
    ({"count": 0, "about": "z"}, "repeat.count", "at least 1"),
    ({"count": -3, "about": "z"}, "repeat.count", "at least 1"),
    ({"count": 10**6, "about": "z"}, "repeat.count", f"at most {MOST_COPIES}"),
    ({"count": 2.5, "about": "z"}, "repeat.count", "whole number"),
    ({"count": math.nan, "about": "z"}, "repeat.count", "finite"),
    ([{"count": 1000, "about": "z"}, {"count": 1000, "step": [0, 0, 1]}], "repeat",
     "at most 10000"),
    ({"count": 4, "about": [0, 0, 0]}, "repeat.about", "must not be zero"),
    ({"count": 4, "about": [math.nan, 0, 1]}, "repeat.about[0]", "finite"),
    ({"count": 4, "about": "w"}, "repeat.about", "x, y, z"),
    ({"count": 4, "about": "z", "angle": math.nan}, "repeat.angle", "finite"),
    ({"count": 4, "about": "z", "angle": 0.0}, "repeat.angle", "same place"),
    ({"count": 4, "angle": 1.0}, "repeat.angle", "about is required"),
    ({"count": 4, "step": [0, 0, 1], "point": [1, 0, 0]}, "repeat.point", "about is required"),
    ({"count": 4, "about": "z", "abuot": 1}, "repeat.abuot", "is about meant?"),
    ({"about": "z"}, "repeat.count", "is required"),
    ({"about": "z", "count": 3, "names": ["a", "b"]}, "repeat.names", "2 names for 3 copies"),
    ({"about": "z", "names": ["a", "a"]}, "repeat.names[1]", "more than once"),
    ({"about": "z", "names": ["a b"]}, "repeat.names[0]", "letters"),
    ({"about": "z", "names": []}, "repeat.names", "0 names"),
    ({"count": 4}, "repeat", "alike"),
    (4, "repeat", "alike"),
    ([], "repeat", "at least one"),
    (None, "repeat", "keys: count"),
    (True, "repeat", "keys: count"),
    ("four", "repeat", "keys: count"),
])  # fmt: skip
def test_a_pattern_that_makes_no_sense_is_refused_by_its_key(repeat, key, words):
    error = refused(robot(cables=[{**CABLE, "repeat": repeat}]))
    assert error.key == f"cables[0].{key}" and words in error.reason, str(error)


def test_the_unit_of_a_value_in_a_pattern_is_named():
    error = refused(robot(cables=[{**CABLE, "repeat": {"count": 3, "about": "z", "angle": "a"}}]))
    assert (error.key, error.unit) == ("cables[0].repeat.angle", "rad")


def test_one_copy_is_the_entry_itself():
    [cable] = repeated("cables", CABLE, {"count": 1, "about": "z"})
    assert cable.name == "L0" and cable.pull_point == (0.0, 0.01, 0.03)


def test_copies_of_copies_are_limited_before_they_are_made():
    wall = {"part": "c#", "repeat": 9000}
    air = {"name": "air#", "walls": [wall], "repeat": {"count": 9000, "names": None}}
    assert "more than" in refused(robot(cavities=[air])).reason


@pytest.mark.parametrize("mapping, key, words", [
    (robot(solver={"repeat": {"count": 2}}), "solver.repeat", "cannot be repeated"),
    (robot(repeat={"count": 2}), "repeat", "an entry of a list"),
    (robot(body={**ROBOT["body"], "repeat": {"count": 2, "about": "z"}}), "body.repeat", "bodies"),
    (robot(cables=[{**CABLE, "repaet": {}}]), "cables[0].repaet", "is repeat meant?"),
])  # fmt: skip
def test_what_cannot_be_repeated_is_refused_by_name(mapping, key, words):
    error = refused(mapping)
    assert error.key == key and words in error.reason


def test_an_error_of_the_entry_is_one_error_at_its_own_key():
    around = {"count": 4, "about": "z"}
    error = refused(robot(cables=[{**CABLE, "rate": -1.0, "repeat": around}]))
    assert (error.key, error.value, error.unit) == ("cables[0].rate", -1.0, "m/s")
    assert "copy" not in error.reason and "more error" not in error.reason
    after = refused(robot(cables=[{**CABLE, "repeat": around}, {**CABLE, "name": "b", "rate": 0}]))
    assert after.key == "cables[1].rate" and "copy" not in after.reason


def test_an_error_of_one_copy_names_entry_and_copy():
    around = {"count": 4, "about": "z"}
    given = {**CABLE, "name": "L2"}
    error = refused(robot(cables=[{**CABLE, "repeat": around}, given]))
    assert error.key == "cables[1].name"
    assert "also in cables[0].name (copy 3)" in error.reason
    error = refused(robot(cables=[given, {**CABLE, "repeat": around}]))
    assert error.key == "cables[1].name" and "(copy 3 of 4)" in error.reason
    error = refused(robot(cables=[{**CABLE, "body": "#2", "repeat": around}]))
    assert error.key == "cables[0].body" and error.value == "#2" and "pattern 2" in error.reason


def test_an_error_of_one_copy_against_the_mesh_names_entry_and_copy():
    """The chamber that does not exist is one of the copies, counted after another entry."""
    walls = [{"part": "c#", "repeat": {"names": ["1", "2"]}}]
    scene = scene_from_mapping(robot(cavities=[{"name": "air", "walls": walls}]), Path("r.yaml"))
    with pytest.raises(SceneError) as error:
        Simulation(scene)
    assert error.value.key == "cavities[0].walls[0].part" and "(copy 1 of 2)" in str(error.value)


def test_a_note_on_all_copies_is_given_once_and_that_on_one_names_it():
    spring = {"name": "s", "ends": [{"on": "diamond", "point": [0, 0.09, 0.045]},
                                    {"point": [0, 0.2, 0.1]}], "stiffness": 5.0}  # fmt: skip
    around = {"repeat": {"count": 4, "about": "z"}}
    notes = Simulation(scene_from_mapping(robot(springs=[
        {**spring, "name": "first"}, {**spring, **around, "damping": 0.1}]))).notes  # fmt: skip
    assert [note for note in notes if "damping" in note and "copy" not in note] == [
        note for note in notes if note.startswith("springs[1].damping ")]


def test_a_copy_of_a_stone_lies_where_its_entry_is_turned_to(tmp_path):
    """Files are named by the mark too."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    corners = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.05]])
    for number in range(2):
        meshio.Mesh(corners, [("triangle", faces)]).write(tmp_path / f"rock_{number}.stl")
    made = repeated("obstacles", {"name": "rock", "surface": str(tmp_path / "rock_#.stl"),
                                  "position": [1, 0, 0]}, {"count": 2, "about": "z"})  # fmt: skip
    assert [rock.surface.file.name for rock in made] == ["rock_0.stl", "rock_1.stl"]
    assert made[1].position == (-1.0, 0.0, 0.0) and made[1].rotation == (0.0, 0.0, math.pi)
