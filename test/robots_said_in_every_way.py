"""Random small robots, each said in every way in which a scene can say it, and what each way answers.

A robot is drawn: its kind, shape, size, stiffness, and how far it is strained. A `Way` is one scene of
this robot. All ways of a robot agree within the errors of their meshes, or a status or a warning says
why one does not. The errors are those of docs/measurements.md for meshes as coarse as
the ones here; linear tetrahedra lock, and are only held to be not too soft.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import meshio
import numpy as np

import softrobot_twin as st

DENSITY = 1000.0
"""Of all robots [kg/m³]."""
# Weight of a body by the load that it bears.
_OWN_WEIGHT = 0.05
# A residual force that counts, by the load.
_BALANCED = 1.0e-6
# How much less and how much more than the first way of a robot another way may answer.
_CLOSED_FORM, _BEAM = (0.01, 0.01), (0.06, 0.06)
# The bar of hexahedra between bonded faces in large compression; those that are too coarse say so.
_PRESSED = (0.25, 0.25)
_SOLID = {"quadratic": (0.15, 0.06), "hexahedral": (0.15, 0.15), "smoothed": (0.35, 0.15),
          "linear": (0.95, 0.06)}  # fmt: skip


class Way(NamedTuple):
    """One way to say a robot.

    Attributes:
        name: Of the way.
        error: How much less and how much more than the first way of the robot it may answer, as shares.
        answer: Settles the robot; what is compared, shape (count,) or (), and the status.
    """

    name: str
    error: tuple[float, float]
    answer: Callable[[], tuple[np.ndarray, str]]


class Answer(NamedTuple):
    """What a way answered.

    Attributes:
        value: What is compared, shape (count,).
        status: Of the last step.
        warned: Sentences that were warned of.
    """

    value: np.ndarray
    status: str
    warned: frozenset[str]


class DrawnRobot(NamedTuple):
    """A robot that was drawn.

    Attributes:
        name: What was drawn, in words.
        ways: Ways to say it; the first is the one that all others are compared with.
    """

    name: str
    ways: list[Way]


def answer_of(way: Way) -> Answer:
    """What a way answers, and what it warns of.

    Args:
        way: The way.
    """
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        value, status = way.answer()
    return Answer(np.atleast_1d(value), status, frozenset(str(one.message) for one in told))


def compare(first: Answer, other: Answer) -> tuple[float, float]:
    """An answer along the first one, by the first one, and what is beside it, by the first one.

    Args:
        first: The answer that is compared with.
        other: Another answer.
    """
    size = np.linalg.norm(first.value)
    along = other.value @ first.value / size**2
    return along, np.linalg.norm(other.value - along * first.value) / size


def disagreements(robot: DrawnRobot) -> list[str]:
    """The ways that answer something else without a word, in sentences.

    Such words are a status other than ok, and a warning that the first way does not give.

    Args:
        robot: The robot.
    """
    first = answer_of(robot.ways[0])
    if first.status != "ok":
        return []
    found = []
    for way in robot.ways[1:]:
        other = answer_of(way)
        (less, more), (along, beside) = way.error, compare(first, other)
        agrees = 1.0 - less <= along <= 1.0 + more and beside <= max(less, more)
        if not (agrees or other.status != "ok" or reasons(other, first)):
            found.append(f"{robot.name}: {way.name} answers {along:.3f} of {robot.ways[0].name},"
                         f" {beside:.3f} beside, {other.status}")  # fmt: skip
    return found


def reasons(answer: Answer, first: Answer) -> list[str]:
    """Warnings of an answer alone that may be a reason why it differs.

    Questions whether a unit is wrong are none, as robots of every size are drawn here; nor are counts of
    triangles that were split.

    Args:
        answer: The answer.
        first: The one that it differs from.
    """
    no_reasons = ("the units", "millimetres?", "split")
    return [one for one in sorted(answer.warned - first.warned) if not any(word in one for word in no_reasons)]


# Bars and tubes: one end is clamped, the other carries a plate that bears a load.


def bar(draw: Random, _: Path) -> DrawnRobot:
    """A square bar that is pulled, pressed, bent or twisted."""
    load, slenderness = draw.choice(("pulled", "pressed", "bent", "twisted")), draw.uniform(7.0, 12.0)
    length, strain, material = _length(draw), _strain(draw), _material(draw, "corotational", (0.0, 0.3))
    side = length / slenderness
    volume = side**2 * length
    force, lever, press = _end_load(load, material, side**2, side**4 / 12.0, length, side, strain, draw)

    def solid(element: str, across: int) -> Way:
        mesh = {"box": {"size": [length, side, side], "cells": [round(slenderness) * across, across, across]}}
        return _loaded(f"{element} {across} across", _amplified(_SOLID[element], press),
                       {"body": _clamped(mesh, element, material, length, strain)}, force, lever, volume,
                       [length, side / 2, side / 2])  # fmt: skip

    axis = [[0, side / 2, side / 2], [length, side / 2, side / 2]]
    section = {"rectangle": {"thickness": side, "width": side}}
    beams = [_beam(axis, count, section, material, force, lever, volume)
             for count in (draw.randint(4, 10), draw.randint(16, 40))]  # fmt: skip
    ways = [solid("quadratic", 2), *beams, solid("quadratic", 1), solid("hexahedral", 1),
            solid("hexahedral", 2), solid("smoothed", 2), solid("linear", 2)]  # fmt: skip
    return DrawnRobot(f"bar {load}, 1:{slenderness:.0f}, {_words(length, material)}, strain {strain:.2g}", ways)


def tube(draw: Random, _: Path) -> DrawnRobot:
    """A round tube that is pulled or bent."""
    load, slenderness = draw.choice(("pulled", "bent")), draw.uniform(6.0, 10.0)
    length, strain, material = _length(draw), 0.5 * _strain(draw), _material(draw, "corotational", (0.0, 0.3))
    radius = length / slenderness / 2.0
    wall = draw.uniform(0.3, 0.6) * radius
    area = math.pi * (radius**2 - (radius - wall) ** 2)
    inertia = math.pi / 4.0 * (radius**4 - (radius - wall) ** 4)
    force, lever, _ = _end_load(load, material, area, inertia, length, 2 * radius, strain, draw)

    def solid(element: str, around: int) -> Way:
        mesh = _mesh_of(*tube_mesh(radius, wall, length, around), element)
        return _loaded(f"{element} {around} around", _SOLID[element],
                       {"body": _clamped(mesh, element, material, length, strain)}, force, lever,
                       area * length, [length, 0.0, 0.0])  # fmt: skip

    section = {"tube": {"radius": radius, "wall": wall}}
    beams = [_beam([[0, 0, 0], [length, 0, 0]], count, section, material, force, lever, area * length)
             for count in (draw.randint(4, 10), draw.randint(16, 40))]  # fmt: skip
    ways = [solid("quadratic", 12), *beams, solid("hexahedral", draw.choice((12, 16))),
            solid("smoothed", 12), solid("linear", 12)]  # fmt: skip
    return DrawnRobot(f"tube {load}, {_words(length, material)}, strain {strain:.2g}", ways)


def _end_load(load, material, area, inertia, length, depth, strain, draw) -> tuple[np.ndarray, float, float]:
    """Force [N] on the plate, how far beside the axis it acts [m], and its share of the critical load."""
    aside = material["young_modulus"] * inertia / length**2
    # By this force the clamped end is strained as far as drawn, or the bar bends as far as it may.
    bent = min(2.0 * strain * length / depth, 1.5) * aside
    if load == "pulled":
        return np.array([strain * material["young_modulus"] * area, 0.1 * aside, 0.0]), 0.0, 0.0
    if load == "pressed":
        press = draw.uniform(0.1, 0.6)
        return aside * np.array([-0.25 * math.pi**2 * press, 0.05, 0.1]), 0.0, press
    if load == "twisted":
        return np.array([0.0, 0.0, 0.2 * bent]), length, 0.0
    turn = draw.uniform(0.0, 2.0 * math.pi)
    return bent * np.array([0.0, math.cos(turn), math.sin(turn)]), 0.0, 0.0


def _amplified(error, press) -> tuple[float, float]:
    """Errors of a pressed deflection, by those of the compliance c: c / (1 - c press) amplifies it."""
    return tuple(abs(1.0 - c * (1.0 - press) / (1.0 - c * press)) for c in (1.0 - error[0], 1.0 + error[1]))


def _clamped(mesh, element, material, length, strain=0.0) -> dict[str, Any]:
    """A body that is held at x = 0 and carries the plate at x = length.

    Patches resist changes of J. Elements by the corotational law resist those of tr S, which are others
    where strains are large: by 16 % of the length that a bar of ν 0.3 gains by 46 %.
    """
    near, far = 1.0e-6 * length, 10.0 * length
    return {
        "mesh": mesh, "element": element, "material": material,
        "volume": "patches" if element == "smoothed" and strain < 0.2 else "per_element",
        "fixed": {"box": {"minimum": [-far] * 3, "maximum": [near, far, far]}},
        "attached": [{"to": "plate", "box": {"minimum": [length - near, -far, -far], "maximum": [far] * 3}}],
    }  # fmt: skip


def _beam(axis, count, section, material, force, lever, volume) -> Way:
    """The bar as a beam."""
    beam = {
        "name": "body", "points": axis, "elements": count, "section": section, "thickness_direction": [0, 1, 0],
        "fixed": "start", "joined": {"at": "end", "to": "plate"},
        "material": {key: material[key] for key in ("young_modulus", "poisson_ratio", "density")},
    }  # fmt: skip
    return _loaded(f"beam of {count}", _BEAM, {"beams": [beam]}, force, lever, volume, axis[1])


def _loaded(name, error, scene, force, lever, volume, tip) -> Way:
    """A bar whose plate bears a force, by its weight; the displacement of the plate is compared."""
    size, place = np.linalg.norm(force), np.add(tip, [0.0, lever, 0.0])
    gravity = _OWN_WEIGHT * size / (DENSITY * volume)

    def answer():
        robot = st.build(
            name="bar", gravity=force / size * gravity, **scene,
            rigid_bodies=[{"name": "plate", "box": {"size": [0.1 * tip[0]] * 3}, "mass": size / gravity,
                           "position": place}],
            effectors=[{"name": "end", "body": "plate", "points": [place]}],
            solver={"newton_iterations": 50, "residual_tolerance": _BALANCED * size},
        )  # fmt: skip
        result = robot.settle(most_steps=40)
        return np.subtract(result.end, place), result.status.value

    return Way(name, error, answer)


def tie(draw: Random, _: Path) -> DrawnRobot:
    """A bar that is bent by a load, and held back by a thin line between its plate and the world."""
    length, slenderness = _length(draw), draw.uniform(7.0, 12.0)
    material = _material(draw, "corotational", (0.0, 0.3))
    side = length / slenderness
    aside = material["young_modulus"] * side**4 / 12.0 / length**2
    force = draw.uniform(0.5, 3.0) * aside * np.array([0.0, 0.0, -1.0])
    # The line is as stiff as the bar, or some times stiffer.
    line, stiffness = 0.5 * length, 10.0 ** draw.uniform(0.0, 1.5) * 3.0 * aside / length
    radius = draw.choice((0.003, 0.01)) * line
    tip = np.array([length, side / 2, side / 2])
    above = tip + [0.0, 0.0, line]
    mesh = {"box": {"size": [length, side, side], "cells": [round(slenderness), 1, 1]}}

    def way(name: str, **lines) -> Way:
        scene = {"body": _clamped(mesh, "quadratic", material, length), **lines}
        return _loaded(name, _CLOSED_FORM, scene, force, 0.0, side**2 * length, tip)

    spring = {"name": "line", "ends": [{"point": above}, {"on": "plate", "point": tip}], "stiffness": stiffness}
    cable = {"name": "line", "body": "plate", "pull_point": above, "points": [tip],
             "shortening": [0.0, 0.0], "axial_stiffness": stiffness * line}  # fmt: skip
    thread = {"name": "line", "points": [above, tip], "elements": draw.randint(2, 20), "fixed": "start",
              "section": {"circle": {"radius": radius}}, "joined": {"at": "end", "to": "plate", "by": "ball"},
              "material": {"young_modulus": stiffness * line / (math.pi * radius**2), "poisson_ratio": 0.3,
                           "density": DENSITY}}  # fmt: skip
    return DrawnRobot(
        f"tie, {_words(length, material)}, line of {stiffness:.1e} N/m",
        [way("spring", springs=[spring]), way("elastic cable", cables=[cable]),
         way(f"beam of {thread['elements']}", beams=[thread])])  # fmt: skip


# Threads: as slender as strings; they bear tension.


def thread(draw: Random, _: Path) -> DrawnRobot:
    """A thread that hangs from a clamp and bears a load, pulled a little aside; its length is compared."""
    length, modulus, strain = _length(draw), _modulus(draw), _strain(draw)
    radius = length / draw.choice((50.0, 100.0, 300.0, 1000.0))
    area = math.pi * radius**2
    load = strain * modulus * area
    # The load alone counts: a thread of 1/1000 of its weight.
    gravity = 0.001 * load / (DENSITY * area * length)
    weight = gravity * np.array([0.05, 0.0, -1.0]) / math.hypot(0.05, 1.0)
    solver = {"newton_iterations": 100, "residual_tolerance": _BALANCED * load}
    ends = [[0.0, 0.0, 0.0], [0.0, 0.0, -length]]

    def beam(count: int) -> Way:
        def answer():
            robot = st.build(
                name="thread", gravity=weight, solver=solver,
                beams=[{"name": "line", "points": ends, "elements": count, "fixed": "start",
                        "section": {"circle": {"radius": radius}},
                        "joined": {"at": "end", "to": "load", "by": "ball"},
                        "material": {"young_modulus": modulus, "poisson_ratio": 0.3, "density": DENSITY}}],
                rigid_bodies=[{"name": "load", "sphere": {"radius": 0.01 * length}, "mass": load / gravity,
                               "position": ends[1]}],
                effectors=[{"name": "end", "body": "load", "points": [ends[1]]}],
            )  # fmt: skip
            result = robot.settle(most_steps=100)
            return np.linalg.norm(result.end), result.status.value

        return Way(f"beam of {count}", _CLOSED_FORM, answer)

    def spring():
        robot = st.build(
            name="thread", gravity=weight, solver=solver,
            mass_springs=[{"name": "line", "points": ends, "springs": [[0, 1]], "fixed": [0],
                           "masses": [load / gravity] * 2, "stiffness": modulus * area / length}],
        )  # fmt: skip
        status = robot.settle(most_steps=100).status.value
        return np.linalg.norm(robot.positions[1]), status

    theory = Way("N/EA", _CLOSED_FORM, lambda: (np.array(length * (1.0 + strain)), "ok"))
    return DrawnRobot(
        f"thread, {length:.2g} m, 1:{length / radius:.0f}, E {modulus:.1e} Pa, strain {strain:.2g}",
        [theory, Way("spring", _CLOSED_FORM, spring), beam(draw.randint(1, 6)), beam(draw.randint(7, 40))])


# Blocks that are pressed, and chambers that are inflated.


def block(draw: Random, _: Path) -> DrawnRobot:
    """A block, bonded above and held by friction below, that is pressed; the force is compared."""
    compression = min(_strain(draw), 0.35)
    material = _material(draw, _law(compression, draw), (0.3, 0.48))
    size = _length(draw) * np.array([1.0, draw.uniform(0.6, 1.6), draw.uniform(0.4, 1.0)])
    top = size * [0.5, 0.5, 1.0]

    def way(element: str, cells: list[int]) -> Way:
        def answer():
            robot = _press(size, cells, element, material)
            for share in np.linspace(0.25, 1.0, 4):
                robot.step(poses={"top": top * [1.0, 1.0, 1.0 - share * compression]}, time_step=1.0)
                result = robot.settle(most_steps=10)
            return np.array(result["force_on_body_by_floor_z_N"]), result.status.value

        error = _PRESSED if element == "hexahedral" else _SOLID[element]
        return Way(f"{element} {cells}", error, answer)

    flat = [draw.randint(2, 4), draw.randint(2, 6), draw.randint(2, 8)]
    ways = [way("quadratic", [4, 4, 4]), way("hexahedral", flat), way("hexahedral", [4, 4, 4]),
            way("smoothed", [5, 5, 5])]  # fmt: skip
    return DrawnRobot(
        f"block {np.round(size / size[0], 2)}, {_words(size[0], material)}, pressed by {compression:.2g}", ways)


def _press(size, cells, element, material) -> st.Robot:
    """A block of a size [m] between a floor and a guided plate."""
    far, top = 10.0 * size.max(), size * [0.5, 0.5, 1.0]
    return st.build(
        name="block", gravity=[0, 0, 0],
        body={"mesh": {"box": {"size": size, "cells": cells}}, "element": element, "material": material,
              "attached": [{"to": "top", "box": {"minimum": [-far, -far, size[2] * (1 - 1e-6)],
                                                 "maximum": [far] * 3}}]},
        rigid_bodies=[{"name": "top", "motion": "guided", "position": top, "speed": 10.0 * size[2],
                       "box": {"size": size * [1.0, 1.0, 0.1], "centre": [0, 0, 0.1 * size[2]]}}],
        obstacles=[{"name": "floor", "plane": {"normal": [0, 0, 1]}}],
        contact={"between": [{"pair": ["body", "floor"], "friction": 1.0}]},
        effectors=[{"name": "e", "body": "top", "points": [top]}],
        solver={"newton_iterations": 30,
                "residual_tolerance": _BALANCED * material["young_modulus"] * size[0] * size[1]},
    )  # fmt: skip


def balloon(draw: Random, folder: Path) -> DrawnRobot:
    """A box with a chamber whose surface file has many triangles or twelve; the growth is compared."""
    strain, outer = _strain(draw), np.array([draw.randint(5, 7), 4, 4])
    side, material = _length(draw), _material(draw, _law(strain, draw), (0.3, 0.48))
    pressure, cell, far = 0.3 * strain * material["young_modulus"], side / outer[0], 10.0 * side

    def way(element: str, parts: int) -> Way:
        # One hexahedron through a wall does not bend well enough beside sharp corners.
        wall = 2 if element == "hexahedral" else 1
        points, cells = chambered_mesh(wall * outer, cell / wall, wall)

        def answer():
            path = folder / f"chamber_{parts}.stl"
            box_surface(cell, (outer - 1) * cell, (outer - 2) * parts).write(path, binary=True)
            robot = st.build(
                name="balloon", gravity=[0, 0, 0],
                body={"mesh": _mesh_of(points, cells, element), "element": element, "material": material,
                      "fixed": {"box": {"minimum": [-far] * 3, "maximum": [1e-6 * side, far, far]}}},
                cavities=[{"name": "chamber", "walls": [{"file": str(path)}], "pressure": [0, 10 * pressure]}],
                effectors=[{"name": "tip", "points": [[side, 2 * cell, 2 * cell]]}],
                solver={"newton_iterations": 30,
                        "residual_tolerance": _BALANCED * material["young_modulus"] * side**2},
            )  # fmt: skip
            result = robot.settle(st.setpoints(chamber_pressure_Pa=pressure), most_steps=20)
            return np.array(result["chamber_growth_m3"]), result.status.value

        return Way(f"{element}, {parts} parts a cell", _SOLID[element], answer)

    ways = [way("quadratic", 1), way("quadratic", 0), way("hexahedral", 0), way("smoothed", 0)]
    return DrawnRobot(f"balloon, {_words(side, material)}, {0.3 * strain:.2g} E", ways)


# Meshes.


def chambered_mesh(counts: np.ndarray, cell: float, wall: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and hexahedra of a box of cubes whose inner cubes are missing.

    Args:
        counts: Cubes along each axis.
        cell: Edge of a cube [m].
        wall: Cubes through the wall.
    """
    points, cells = _grid(counts)
    index = np.array(list(np.ndindex(*counts)))
    shell = ((index < wall) | (index >= counts - wall)).any(axis=1)
    used, cells = np.unique(cells[shell], return_inverse=True)
    return points[used] * cell, cells.reshape(-1, 8)


def tube_mesh(radius: float, wall: float, length: float, around: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and hexahedra of a tube about x; its prisms have the area of the circles.

    Args:
        radius: The outer one [m].
        wall: Thickness of the wall [m].
        length: Along x [m].
        around: Cells around and along; an eighth of it, rounded down, through the wall.
    """
    through = around // 8
    grid, cells = _grid(np.array([around, around, through]))
    part = 2.0 * math.pi / around
    radii = math.sqrt(part / math.sin(part)) * (radius - wall + wall * grid[:, 2] / through)
    angles = -part * grid[:, 1]
    points = np.stack([length * grid[:, 0] / around, radii * np.cos(angles), radii * np.sin(angles)], axis=1)
    # The last ring of points is the first one.
    index = np.arange(len(grid))
    index[grid[:, 1] == around] -= around * (through + 1)
    used, cells = np.unique(index[cells], return_inverse=True)
    return points[used], cells.reshape(-1, 8)


def _grid(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of a grid, in cells, and its hexahedra."""
    points = np.array(list(itertools.product(*(range(count + 1) for count in counts))), float)
    index = np.arange(len(points)).reshape(counts + 1)
    corners = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    cells = [[index[tuple(np.add(cell, corner))] for corner in corners] for cell in np.ndindex(*counts)]
    return points, np.array(cells)


# Tetrahedra around the diagonal of a hexahedron.
_SIX = np.array(((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)))


def _mesh_of(points, cells, element) -> meshio.Mesh:
    """A mesh of the cells that an element takes."""
    if element == "hexahedral":
        return meshio.Mesh(points, [("hexahedron", cells)])
    return meshio.Mesh(points, [("tetra", cells[:, _SIX].reshape(-1, 4))])


def box_surface(low: float, high: np.ndarray, parts: np.ndarray) -> meshio.Mesh:
    """The surface of a box as triangles.

    Args:
        low: Each coordinate of its lower corner [m].
        high: Its upper corner [m], shape (3,).
        parts: In how many parts each edge is split, shape (3,); one at least.
    """
    parts, points, triangles = np.maximum(parts, 1), [], []
    for axis, side in itertools.product(range(3), (0, 1)):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        first = len(points)
        for i, j in itertools.product(range(parts[u] + 1), range(parts[v] + 1)):
            place = np.zeros(3)
            place[axis], place[u], place[v] = side, i / parts[u], j / parts[v]
            points.append(low + place * (high - low))
        for i, j in itertools.product(range(parts[u]), range(parts[v])):
            a = first + i * (parts[v] + 1) + j
            a, b, c, d = (a, a + parts[v] + 1, a + parts[v] + 2, a + 1)[:: 1 if side else -1]
            triangles += [[a, b, c], [a, c, d]]
    return meshio.Mesh(np.array(points), [("triangle", np.array(triangles))])


# Numbers of a robot.


def _material(draw: Random, law: str, poisson_ratio: tuple[float, float]) -> dict[str, Any]:
    return {"law": law, "young_modulus": _modulus(draw), "poisson_ratio": draw.uniform(*poisson_ratio),
            "density": DENSITY}  # fmt: skip


def _law(strain: float, draw: Random) -> str:
    """A law; by the corotational one patches and elements differ in how they resist large changes of volume."""
    return draw.choice(("neo_hookean", "corotational")) if strain < 0.05 else "neo_hookean"


def _length(draw: Random) -> float:
    """1 mm to 10 m."""
    return 10.0 ** draw.uniform(-3.0, 1.0)


def _modulus(draw: Random) -> float:
    """1 kPa to 10 GPa."""
    return 10.0 ** draw.uniform(3.0, 10.0)


def _strain(draw: Random) -> float:
    """1 to 50 %."""
    return 10.0 ** draw.uniform(-2.0, math.log10(0.5))


def _words(length: float, material: dict[str, Any]) -> str:
    """Size and material of a robot in words."""
    return (f"{length:.2g} m, {material['law']}, E {material['young_modulus']:.1e} Pa,"
            f" ν {material['poisson_ratio']:.2f}")  # fmt: skip


KINDS: dict[str, Callable[[Random, Path], DrawnRobot]] = {
    kind.__name__: kind for kind in (bar, tube, tie, thread, block, balloon)
}
"""How to draw a robot of each kind; files go into a folder."""
