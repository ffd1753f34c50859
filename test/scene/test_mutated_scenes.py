"""Scenes changed at random: each is read, or refused by one line that names file and key."""

from __future__ import annotations

import copy
import math
import random
from pathlib import Path

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError, SceneError
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.loading import read_yaml
from softrobot_twin.simulation import Hold, Simulation
from test.places import CONFIG

pytestmark = pytest.mark.sampled

SCENES = sorted((CONFIG / "scenes").glob("*.yaml"))
# The same robots on meshes that build fast.
COARSE = {"diamond": "diamond_150", "trunk": "trunk_700", "grasper": "grasper_finger_158",
          "octoleg": "octoleg_120"}  # fmt: skip
VALUES = (
    None, True, False, 0, -1, 1, 3.7, 1e-300, -1e300, 1e300, math.nan, math.inf, -math.inf,
    10**400, "", "a", "world", "body", "0.5", "1e5", "180 kPa", "null", "{reason}", "é" * 200, [],
    {}, [[]], [0, 0, 0], [1, 2], [math.inf, math.nan, 1], [[1, 2, 3]] * 50, {"name": "x"},
    {1: 2}, {None: None}, ["x", "x"], "xz", b"\xff", "../../meshes", "/nowhere.vtk", "a\0b",
)  # fmt: skip

# One of every entry, for those that no scene of ours has.
EVERYTHING = """
name: all
integration: dynamic
bodies:
  - name: finger
    mesh: {file: MESH, translation: [0,0,0.1]}
    material: {young_modulus: 600e3, poisson_ratio: 0.45, density: 1070}
    materials:
      - {box: {minimum: [-1, -1, -1], maximum: [-0.05, 1, 1]}, young_modulus: 300e3, density: 900}
    attached: [{to: palm, frame: mesh, box: {minimum: [-0.015, 0, 0], maximum: [0.005, 0.01, 0.015]}}]
    damping: {mass: 0.0, stiffness: 0.005}
    mass: lumped
rigid_bodies:
  - {name: cube, box: {size: [0.04, 0.04, 0.04]}, mass: 0.03, position: [0.2, 0, 0.02], velocity: [0.1,0,0], damping: 0.1}
  - {name: stone, surface: {file: rock.stl}, density: 2000, position: [0.4, 0, 0.02]}
  - {name: ball, capsule: {ends: [[0,0,0],[0,0,0.01]], radius: 0.01}, density: 2000, position: [0.6, 0, 0.2]}
  - {name: palm, motion: guided, sphere: {radius: 0.01}, speed: 0.05}
beams:
  - name: strut
    points: [[0.8, 0, 0.1], [0.85, 0, 0.1], [0.9, 0.02, 0.1]]
    curve: smooth
    elements: 3
    section: {rectangle: {thickness: 0.001, width: 0.01}}
    thickness_direction: [0, 0, 1]
    material: {young_modulus: 35e6, poisson_ratio: 0.45, density: 1220}
    fixed: [start]
    joined: [{at: end, to: mast}]
    damping: {mass: 0.1, stiffness: 0.001}
  - name: mast
    points: [[0.9, 0.02, 0.1], [0.9, 0.02, 0.15]]
    elements: 1
    section: {tube: {radius: 0.002, wall: 0.0005}}
    material: {young_modulus: 35e6, poisson_ratio: 0.45, density: 1220}
  - name: leg_#
    repeat: [{names: [a, b], about: z, point: [0.2, 0, 0]}, {count: 2, step: [0, 0, 0.02]}]
    points: [[0.22, 0, 0.02], [0.26, 0, 0.02]]
    elements: 2
    section: {constants: {area: 1e-5, inertia_y: 1e-11, inertia_z: 1e-11, torsion: 2e-11}}
    thickness_direction: [0, 0, 1]
    material: {young_modulus: 35e6, poisson_ratio: 0.45, density: 1220}
    joined: {at: start, to: cube}
obstacles:
  - {name: floor, plane: {normal: [0, 0, 1], point: [0,0,-0.1]}}
  - {name: rock, surface: {file: rock.stl, scale: 1.0}, position: [1,1,0]}
contact:
  friction: 0.5
  alarm_distance: 0.004
  push_out_speed: 0.05
  between:
    - {pair: [finger, cube], friction: 0.8}
    - {pair: [cube, floor]}
    - {pair: [finger, finger]}
    - {pair: [ball, rock]}
    - {pair: [stone, floor]}
    - {pair: [finger, rock]}
springs:
  - {name: s, ends: [{on: cube, point: [0.2, 0, 0.04]}, {on: world, point: [0, 0, 0.2]}], stiffness: 100.0, damping: 0.1}
tubes:
  - {name: t, on: finger, points: [[-0.02, 0.0025, 0.105], [-0.03, 0.0025, 0.105]], axial_stiffness: 250.0}
fibres:
  - {name: thread, on: finger, points: [[-0.02, 0.0025, 0.105], [-0.03, 0.0025, 0.105]], stiffness: 20.0, tension_only: false}
  - {name: wrap, on: finger, stiffness: 20.0,
     helix: {point: [-0.02, 0.0025, 0.105], direction: [1, 0, 0], radius: 0.001, pitch: 0.01, reach: [-0.02, 0.0], count: 2}}
mass_springs:
  - {name: net, points: [[0, 0, 1], [0.1, 0, 1], [0.1,0.1,1]], masses: [0.01], springs: [[0, 1],[1,2]], stiffness: 50.0, fixed: [0]}
cables:
  - {name: left, body: finger, frame: mesh, pull_point_on: palm, pull_point: [0.0, 0.0125, 0.0025], points: [[-0.0175, 0.0125, 0.0025],[-0.0325, 0.0125, 0.0025]], shortening: [0, 0.01]}
motors: [{name: grip, cables: [left]}]
effectors: [{name: tip, body: finger, points: [[-0.09,0.005,0.105]]}]
markers:
  - {id: 1, body: cube, point: [0.2,0,0.04]}
  - {id: 2, body: strut, point: [0.85, 0, 0.1]}
  - {id: 3, body: leg_a_#, point: [0.26, 0, 0.02], repeat: {count: 2, step: [0, 0, 0.02]}}
"""
ROCK = [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 0.05]]


@pytest.fixture
def everything(tmp_path):
    """The scene of every entry, and the file it would stand in."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    meshio.Mesh(np.array(ROCK), [("triangle", faces)]).write(tmp_path / "rock.stl")
    mesh = CONFIG.parent / "meshes" / "grasper_finger_158.vtk"
    return read_yaml(EVERYTHING.replace("MESH", str(mesh))), tmp_path / "everything.yaml"


def places(node, above=()):
    """Every place below a section or a list, as the keys that lead there."""
    found = []
    children = node.items() if isinstance(node, dict) else enumerate(node)
    for key, child in children:
        found.append((*above, key))
        if isinstance(child, dict | list):
            found += places(child, (*above, key))
    return found


def mutate(mapping, chance: random.Random) -> None:
    """One change: delete, rename, double, move, or put something else in a place."""
    *above, key = chance.choice(places(mapping))
    holder = mapping
    for part in above:
        holder = holder[part]
    kind = chance.choice(("delete", "rename", "value", "value", "value", "scale", "swap"))
    if kind == "delete":
        del holder[key]
    elif kind == "rename" and isinstance(holder, dict):
        word = str(key)
        letter = chance.randrange(len(word) + 1)
        holder[word[:letter] + chance.choice("aex_7 ") + word[letter + 1 :]] = holder.pop(key)
    elif kind == "scale" and isinstance(holder[key], int | float):
        if abs(holder[key]) < 1e300:  # more, as a whole number, is no float any more
            holder[key] *= chance.choice((-1.0, 1e-9, 1e3, 1e9))
    elif kind == "swap":
        *_, other = chance.choice(places(mapping))
        holder[key] = copy.deepcopy(mapping.get(other, other) if isinstance(other, str) else other)
    else:
        holder[key] = copy.deepcopy(chance.choice(VALUES))


def check_refusal(error: SceneError, path: Path) -> None:
    words = str(error)
    lines = words.splitlines()
    assert error.path == path and all(line.startswith(f"{path}:") for line in lines[:10])
    assert error.key and error.reason and len(lines) <= 11 and len(max(lines, key=len)) < 900
    for foreign in ("valid dictionary", "valid tuple", "Input should", "validation error"):
        assert foreign not in words, words


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_a_mutated_scene_is_read_or_refused_by_file_and_key(scene):
    chance = random.Random(scene.stem)
    good = read_yaml(scene.read_text(encoding="utf-8"))
    refused = 0
    for _ in range(100):
        mapping = copy.deepcopy(good)
        for _ in range(chance.choice((1, 1, 1, 2, 4))):
            mutate(mapping, chance)
            if not mapping:
                break
        try:
            scene_from_mapping(mapping, scene)
        except SceneError as error:
            check_refusal(error, scene)
            refused += 1
    assert refused > 33


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_truncated_text_is_read_or_refused_by_file_and_key(scene, tmp_path):
    chance = random.Random(scene.stem)
    content = scene.read_bytes()[:3000]
    file = tmp_path / "torn.yaml"
    for _ in range(40):
        torn = bytearray(content)
        for _ in range(chance.choice((1, 3, 20))):
            place = chance.randrange(len(torn))
            torn[place : place + chance.choice((0, 1, 5))] = bytes(
                chance.choice(b"\t\n:-[]{}&*#'\"|>%@`!,x0\xff\x00") for _ in range(2)
            )
        file.write_bytes(bytes(torn))
        try:
            load_scene(file)
        except SceneError as error:
            check_refusal(error, file)


@pytest.mark.parametrize("stem", COARSE)
def test_a_mutated_scene_is_built_or_refused_by_name(stem):
    path = CONFIG / "scenes" / f"{stem}.yaml"
    good = read_yaml(path.read_text(encoding="utf-8"))
    for body in [good["body"]] if "body" in good else good["bodies"]:
        body["mesh"]["file"] = f"../../meshes/{COARSE[stem]}.vtk"
    build_mutations(good, path, random.Random(stem), 15)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.filterwarnings("ignore:overflow")
def test_any_entry_that_is_mutated_is_built_and_steps_or_is_refused_by_name(everything, seed):
    build_mutations(*everything, random.Random(seed), 23)


def build_mutations(good: dict, path: Path, chance: random.Random, count: int) -> None:
    for turn in range(count):
        mapping = copy.deepcopy(good)
        if turn > 0:
            mutate(mapping, chance)
        try:
            simulation = Simulation(scene_from_mapping(mapping, path))
        except SceneError as error:
            check_refusal(error, path)
        except MeshError as error:
            assert error.path is not None and "\n" not in str(error)
        else:
            assert all("\n" not in note for note in simulation.notes)
            assert np.isfinite(simulation.step(Hold(0.01)).state.positions).all()
            continue
        assert turn > 0, "what was not changed must be built"
