"""Thin walls of solid elements: published shells, and a wall of a tenth of its radius.

`python tools/wall_study.py` prints these tables, one of them in docs/pneumatics.md, in minutes; names of problems
as arguments print theirs alone. All are those of small displacements: one linearization.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from time import thread_time
from typing import NamedTuple

import numpy as np
from specimens import Specimen, mapped_mesh, traction_loads

from softrobot_twin.geometry.smoothed_mesh import SmoothedMesh
from softrobot_twin.mechanics.laws.neo_hookean import NeoHookean
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.bench_measurement import default_scene_path

KINDS = ("linear", "smoothed", "quadratic", "hexahedral")
"""Kinds of elements that are compared."""


class Wall(NamedTuple):
    """A wall, solved.

    Attributes:
        found: The displacement that is asked for, by the reference.
        nodes: Nodes.
        time: Of one linearization [s].
    """

    found: float
    nodes: int
    time: float


class WallProblem(NamedTuple):
    """A wall that is loaded.

    Attributes:
        words: What it is.
        solve: From a kind of element, cells along each side and cells over the wall, to a `Wall`.
        counts: Cells along each side that are compared.
    """

    words: str
    solve: Callable[[str, int, int], Wall]
    counts: tuple[int, ...]


def elastic_law(young_modulus: float, poisson_ratio: float) -> NeoHookean:
    """A law with these moduli at rest.

    Args:
        young_modulus: E [Pa].
        poisson_ratio: ν.
    """
    return NeoHookean(0.5 * young_modulus / (1.0 + poisson_ratio),
                      young_modulus / (3.0 - 6.0 * poisson_ratio))  # fmt: skip


def _solved(mesh, law: NeoHookean, held, loads, moved, reference: float) -> Wall:
    """A wall under its loads; volumes are kept by patches where scenes do so by default."""
    fixed = np.zeros(mesh.node_count, bool)
    specimen = Specimen(mesh, law, fixed, held, by_patches=isinstance(mesh, SmoothedMesh))
    moves, _, _ = specimen.iterate(loads)
    times = [sum(specimen.iterate(loads)[2]) for _ in range(3)]
    return Wall(float(moved(moves) / reference), mesh.node_count, float(np.median(times)))


def _nearest(mesh, place) -> int:
    """The node nearest to a place."""
    distances = np.linalg.norm(mesh.node_positions - place, axis=1)
    return int(np.argmin(distances))


def _across(mesh, place, normal, wall: float, axis: int, moves) -> float:
    """Mean motion along an axis of the two faces of a wall at a place of its middle."""
    half = 0.5 * wall * np.asarray(normal)
    return float(np.mean([moves[_nearest(mesh, place + side * half), axis] for side in (-1.0, 1.0)]))


def cylinder(kind: str, count: int, layers: int, wall: float = 0.1, poisson: float = 0.45) -> Wall:
    """Lamé's cylinder in plane strain under pressure: how far its inner wall, of radius one, moves.

    Args:
        kind: See `mapped_mesh`.
        count: Cells along a quarter.
        layers: Cells over the wall.
        wall: Thickness by the inner radius.
        poisson: ν.
    """
    width = 0.5 * np.pi / count

    def place(points):
        angle, radius = 0.5 * np.pi * points[:, 0], 1.0 + wall * points[:, 1]
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), width * points[:, 2]])

    mesh = mapped_mesh(kind, (count, layers, 1), place)
    x, held = mesh.node_positions, np.zeros(mesh.node_positions.shape, bool)
    held[:] = np.abs(x) < 1e-9
    held[:, 2] = True
    radii = np.linalg.norm(x[:, :2], axis=1)
    inner = radii < 1.0 + 1e-9
    # Radial forces of the pressure, shared as by a flat face, and scaled to their sum.
    loads = traction_loads(mesh, inner, (1.0, 0.0, 0.0))[:, :1] * np.column_stack(
        [x[:, :2] / radii[:, None], np.zeros(len(x))])  # fmt: skip
    loads *= 0.5 * np.pi * width / np.sum(loads * x / radii[:, None])
    a, b = 1.0, (1.0 + wall) ** 2
    expected = (1.0 + poisson) * ((1.0 - 2.0 * poisson) * a + b) / (b - a)

    def moved(moves):
        return np.mean(np.einsum("ki,ki->k", moves[inner], x[inner]))

    return _solved(mesh, elastic_law(1.0, poisson), held, loads, moved, expected)


def _hemisphere(kind: str, count: int, layers: int, wall: float):
    """A quarter of a hemisphere of radius 10 with a hole of 18° around its pole, and what holds it."""
    top = np.radians(90.0 - 18.0)

    def place(points):
        around, up = 0.5 * np.pi * points[:, 0], top * points[:, 1]
        radius = 10.0 + wall * (points[:, 2] - 0.5)
        return radius[:, None] * np.column_stack(
            [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])  # fmt: skip

    mesh = mapped_mesh(kind, (count, count, layers), place)
    x = mesh.node_positions
    held = np.zeros(x.shape, bool)
    held[:, :2] = np.abs(x[:, :2]) < 1e-9
    held[_nearest(mesh, 7.0710678 * np.array([1.0, 1.0, 0.0])), 2] = True
    return mesh, held, np.abs(x[:, 2]) < 1e-9


def pinched_hemisphere(kind: str, count: int, layers: int) -> Wall:
    """MacNeal and Harder's hemisphere, wall 0.04 of radius 10: F = 2, by its displacement 0.094.

    Args:
        kind: See `mapped_mesh`.
        count: Cells along a quarter and up to the hole of 18°; even.
        layers: Cells over the wall.
    """
    mesh, held, edge = _hemisphere(kind, count, layers, 0.04)
    x, loads = mesh.node_positions, np.zeros(mesh.node_positions.shape)
    for axis, sign in ((0, 1.0), (1, -1.0)):
        line = np.flatnonzero(edge & (np.abs(x[:, 1 - axis]) < 1e-9))
        # Of the force on a plane of symmetry a quarter bears half.
        loads[line, axis] = sign * 1.0 / len(line)
    law, place, out = elastic_law(6.825e7, 0.3), np.array([10.0, 0.0, 0.0]), [1.0, 0.0, 0.0]
    return _solved(mesh, law, held, loads, lambda moves: _across(mesh, place, out, 0.04, 0, moves), 0.094)


THICK = 1.0
"""Wall of the thick hemisphere; its radius is 10."""
THICK_REFERENCE = 1757.0
"""How far its edge moves, by hexahedra and quadratic elements of 24 to 48 cells a side: to 0.4 %."""


def thick_hemisphere(kind: str, count: int, layers: int) -> Wall:
    """The hemisphere with a wall of a tenth of its radius, pinched by forces f cos 2φ at its edge.

    At single points a solid has no displacement that converges, so the forces are spread.

    Args:
        kind: See `mapped_mesh`.
        count: Cells along a quarter and up to the hole of 18°; even.
        layers: Cells over the wall.
    """
    mesh, held, edge = _hemisphere(kind, count, layers, THICK)
    x = mesh.node_positions
    angle = np.arctan2(x[:, 1], x[:, 0])
    radial = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(x))])
    loads = traction_loads(mesh, edge, (1.0, 0.0, 0.0))[:, :1] * np.cos(2.0 * angle)[:, None] * radial
    law, place, out = elastic_law(1.0, 0.3), np.array([10.0, 0.0, 0.0]), [1.0, 0.0, 0.0]
    return _solved(mesh, law, held, loads, lambda moves: _across(mesh, place, out, THICK, 0, moves), THICK_REFERENCE)


def _roof(kind: str, count: int, layers: int, wall: float, reference: float) -> Wall:
    """A quarter of a roof of radius 25, length 50 and 40° to each side, under a weight of 90 by area."""

    def place(points):
        angle, radius = np.radians(40.0) * points[:, 0], 25.0 + wall * (points[:, 2] - 0.5)
        return np.column_stack([radius * np.sin(angle), 25.0 * points[:, 1], radius * np.cos(angle)])

    mesh = mapped_mesh(kind, (count, count, layers), place)
    x = mesh.node_positions
    held = np.zeros(x.shape, bool)
    held[:, 0] = np.abs(x[:, 0]) < 1e-9
    held[:, 1] = np.abs(x[:, 1]) < 1e-9
    diaphragm = np.abs(x[:, 1] - 25.0) < 1e-9
    held[np.ix_(diaphragm, [0, 2])] = True
    loads = np.zeros(x.shape)
    for block in mesh.blocks():
        shared = block.volumes[:, None] * block.load_shares
        np.add.at(loads[:, 2], block.mesh.cells, -90.0 / wall * shared)
    out = np.array([np.sin(np.radians(40.0)), 0.0, np.cos(np.radians(40.0))])
    return _solved(mesh, elastic_law(4.32e8, 0.0), held, loads,
                   lambda moves: -_across(mesh, 25.0 * out, out, wall, 2, moves), reference)


def scordelis_lo(kind: str, count: int, layers: int) -> Wall:
    """The Scordelis-Lo roof, wall 0.25 of radius 25, between diaphragms: its mid edge sinks 0.3024.

    Args:
        kind: See `mapped_mesh`.
        count: Cells along a quarter's sides.
        layers: Cells over the wall.
    """
    return _roof(kind, count, layers, 0.25, 0.3024)


THICK_ROOF_REFERENCE = 2.650e-3
"""How far the mid edge of the thick roof sinks, by quadratic elements of 24 and 32 cells: to 0.1 %."""


def thick_roof(kind: str, count: int, layers: int) -> Wall:
    """The roof with a wall of a tenth of its radius.

    Args:
        kind: See `mapped_mesh`.
        count: Cells along a quarter's sides.
        layers: Cells over the wall.
    """
    return _roof(kind, count, layers, 2.5, THICK_ROOF_REFERENCE)


PROBLEMS = {
    "cylinder": WallProblem("Lamé's cylinder, wall R/10, ν 0.45", cylinder, (4, 8, 16)),
    "hemisphere": WallProblem("Pinched hemisphere, wall R/250", pinched_hemisphere, (8, 16, 32)),
    "thick_hemisphere": WallProblem("Pinched hemisphere, wall R/10", thick_hemisphere, (4, 8, 16)),
    "roof": WallProblem("Scordelis-Lo roof, wall R/100", scordelis_lo, (8, 16, 32)),
    "thick_roof": WallProblem("Scordelis-Lo roof, wall R/10", thick_roof, (4, 8, 16)),
}
"""The walls, by name."""


def diamond_step(steps: int = 50) -> float:
    """Median time of a step of the default Diamond [s].

    Args:
        steps: How many are timed.
    """
    simulation = Simulation(load_scene(default_scene_path()))
    simulation.warm_up()
    spent = []
    for _ in range(steps):
        begin = thread_time()
        simulation.step(Hold(0.01))
        spent.append(thread_time() - begin)
    return float(np.median(spent))


def wall_lines(names: list[str], layers: tuple[int, ...] = (1, 2, 3)) -> Iterator[str]:
    """A table of errors and times for each problem.

    Args:
        names: The problems.
        layers: Cells over the wall.
    """
    unit = diamond_step()
    for name in names:
        problem = PROBLEMS[name]
        yield f"\n{problem.words}: error, nodes, time of a linearization by a Diamond's step\n"
        yield f"| element | cells a side | {' | '.join(f'{n} over the wall' for n in layers)} |"
        yield "|---" * (2 + len(layers)) + "|"
        for kind in KINDS:
            for count in problem.counts:
                cells = []
                for number in layers:
                    wall = problem.solve(kind, count, number)
                    error = 100.0 * (wall.found - 1.0)
                    shown = f"{error:+.0f}" if abs(error) >= 10.0 else f"{error:+.2g}"
                    cells.append(f"{shown} %, {wall.nodes}, {wall.time / unit:.2g}")
                yield f"| {kind} | {count} | {' | '.join(cells)} |"


def main() -> None:
    """Print the tables."""
    for line in wall_lines([name for name in sys.argv[1:] if name in PROBLEMS] or list(PROBLEMS)):
        print(line, flush=True)


if __name__ == "__main__":
    main()
