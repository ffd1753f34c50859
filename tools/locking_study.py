"""Error against time of elements for nearly incompressible rubber: Cook's membrane and robots.

`python tools/locking_study.py` prints the tables of docs/measurements.md ("Elements").
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from time import thread_time
from typing import NamedTuple

import numpy as np
from specimens import Specimen, Times, mapped_mesh, traction_loads

from softrobot_twin.mechanics.laws.neo_hookean import NeoHookean
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.simulation import CommandEfforts, Simulation
from softrobot_twin.study.bench_measurement import default_scene_path

COOK_SHEAR = 80.194
"""µ of Cook's membrane [MPa]; its lengths are in mm."""
COOK_TRACTION = 6.25
"""Shear traction on its right edge [MPa]."""
COOK_CORNER = {0.3: 8.765, 0.4999: 6.92}
"""Displacement of its upper right corner by Poisson's ratio [mm]."""
COOK_STEPS = 4
RAMP = np.concatenate([np.linspace(0.05, 1.0, 20), np.ones(10)])


class Cook(NamedTuple):
    """Cook's membrane, solved.

    Attributes:
        corner: Displacement of the corner (48, 60) upwards [mm].
        middle: That of the middle of the right edge [mm].
        specimen: It.
        times: Median times of an iteration.
    """

    corner: float
    middle: float
    specimen: Specimen
    times: Times


def cook(kind: str, count: int, poisson: float, **settings) -> Cook:
    """Solve Cook's membrane, a tapered panel in plane strain that is clamped on the left.

    Args:
        kind: See `mapped_mesh`.
        count: Cells along each edge; one through the thickness.
        poisson: ν.
        **settings: Of the `Specimen`.
    """
    thick = 48.0 / count

    def place(points):
        u, v, w = points.T
        return np.column_stack([48.0 * u, 44.0 * u + v * (44.0 - 28.0 * u), thick * w])

    mesh = mapped_mesh(kind, (count, count, 1), place)
    x = mesh.node_positions
    held = np.zeros(x.shape, bool)
    held[:, 2] = True
    edge = x[:, 0] > 48.0 - 1e-9
    loads = traction_loads(mesh, edge, (0.0, COOK_TRACTION, 0.0))
    bulk = 2.0 * COOK_SHEAR * (1.0 + poisson) / (3.0 - 6.0 * poisson)
    fixed = x[:, 0] < 1e-9
    specimen = Specimen(mesh, NeoHookean(COOK_SHEAR, bulk), fixed, held, **settings)
    for step in range(1, COOK_STEPS + 1):
        times = specimen.solve(loads * step / COOK_STEPS)
    moved = (specimen.positions - x)[:, 1]
    corner, middle = (
        int(np.argmin(np.linalg.norm(x - [48.0, height, 0.0], axis=1))) for height in (60.0, 52.0)
    )
    return Cook(float(moved[corner]), float(moved[middle]), specimen, times)


class RobotRow(NamedTuple):
    """One setting of a robot, at given efforts.

    Attributes:
        mesh: Its mesh file.
        element: Kind of its elements.
        volume: Where changes of volume are resisted.
        unknowns: Scalar unknowns.
        moved: Displacement of its effector [m], shape (3,).
        assembly: Time of one assembly [s].
        factor: Time of one factorization [s].
        step: Median time of a step, per linearization [s].
    """

    mesh: str
    element: str
    volume: str
    unknowns: int
    moved: np.ndarray
    assembly: float
    factor: float
    step: float


def robot_row(
    robot: str, mesh: str, element: str, volume: str, poisson: float, efforts: np.ndarray
) -> RobotRow:
    """Load a robot of Neo-Hookean rubber, step by step.

    Args:
        robot: Name of a shipped scene.
        mesh: Mesh file.
        element: Kind of its elements.
        volume: Where changes of volume are resisted.
        poisson: ν.
        efforts: Of its actuators [N] or [Pa], shape (actuator_count,).
    """
    path = default_scene_path().with_name(f"{robot}.yaml")
    mapping = written_out(read_yaml(path.read_text()))
    body = mapping["body"]
    body["mesh"]["file"], body["element"], body["volume"] = f"../../meshes/{mesh}", element, volume
    body["material"].update(law="neo_hookean", poisson_ratio=poisson)
    mapping.setdefault("solver", {})["newton_iterations"] = 10
    simulation = Simulation(scene_from_mapping(mapping, Path(path)))
    rest, steps = simulation.effector_positions(), []
    for share in RAMP:
        begin = thread_time()
        result = simulation.step(CommandEfforts(share * efforts, 0.2))
        steps.append((thread_time() - begin) / max(1, result.report.iterations))
    model = simulation.model
    forces = np.zeros((model.nodes.free_node_count, 3))
    parts = []
    for repetition in range(1, 12):
        # At rest the tangent is definite; forces are not those of the last call.
        positions = model.nodes.rest_positions * (1.0 + 1e-9 * repetition)
        model.factorization.clear()
        begin = thread_time()
        for term in model.forces:
            term.add(positions, forces, model.factorization.storage, False)
        middle = thread_time()
        model.factorization.factor()
        parts.append((middle - begin, thread_time() - middle))
    assembly, factor = np.median(parts, axis=0)
    moved = result.effector_positions[0] - rest[0]
    unknowns = 3 * model.nodes.free_node_count
    step = float(np.median(steps))
    return RobotRow(mesh, element, volume, unknowns, moved, assembly, factor, step)


def cook_lines(poisson: float = 0.4999) -> Iterator[str]:
    """A table of Cook's membrane: error of the corner, and time of an iteration."""
    yield ("| element | cells | volume | unknowns | corner, mm | error, % | assembly, ms | "
           "factor, ms |")  # fmt: skip
    yield "|---|---|---|---|---|---|---|---|"
    settings = [("linear", 16, size) for size in (None, 4, 6, 8, 12, 24)] + [("linear", 32, 12)]
    settings += [("smoothed", n, size) for n in (4, 8, 16) for size in (None, 4, 6, 8, 12)]
    settings += [("quadratic", n, size) for n in (4, 8, 16) for size in (None, 1, 2)]
    settings += [("hexahedral", n, size) for n in (8, 16) for size in (None, 1)]
    for kind, count, size in settings:
        found = cook(kind, count, poisson, by_patches=size is not None, patch_size=size)
        error = 100.0 * (found.corner / COOK_CORNER[poisson] - 1.0)
        kept = "per element" if size is None else f"patches of {size}"
        yield (f"| {kind} | {count}×{count} | {kept} | {found.specimen.unknowns} | "
               f"{found.corner:.3f} | {error:+.1f} | {1e3 * found.times.assembly:.2f} | "
               f"{1e3 * found.times.factor:.2f} |")  # fmt: skip


def robot_lines(robot: str, meshes: list, poisson: float, efforts) -> Iterator[str]:
    """A table of a robot: error against its last row, of quadratic tetrahedra with patches."""
    rows = [robot_row(robot, mesh, element, volume, poisson, np.asarray(efforts, float))
            for mesh, element, volume in meshes]  # fmt: skip
    yield f"{robot}, ν {poisson:g}, efforts {list(efforts)}"
    yield ("| mesh | element | volume | unknowns | tip, mm | error, % | assembly, ms | "
           "factor, ms | linearization, ms |")  # fmt: skip
    yield "|---|---|---|---|---|---|---|---|---|"
    reference = rows[-1].moved
    for row in rows:
        error = 100.0 * np.linalg.norm(row.moved - reference) / np.linalg.norm(reference)
        tip = " ".join(f"{1e3 * value:.2f}" for value in row.moved)
        times = " | ".join(f"{1e3 * time:.2f}" for time in (row.assembly, row.factor, row.step))
        yield (f"| {row.mesh} | {row.element} | {row.volume} | {row.unknowns} | {tip} | "
               f"{error:.0f} | {times} |")  # fmt: skip


def main() -> None:
    """Print all tables; with the argument ``cook``, that of Cook's membrane only."""
    for poisson in COOK_CORNER:
        print(f"Cook's membrane, ν {poisson:g}")
        for line in cook_lines(poisson):
            print(line, flush=True)
    if "cook" in sys.argv[1:]:
        return
    kinds = [(element, volume) for element in ("linear", "smoothed", "quadratic")
             for volume in ("per_element", "patches")]  # fmt: skip
    for poisson in (0.49, 0.4999):
        files = ("diamond_400.vtk", "diamond_1600.vtk")
        meshes = [(mesh, *kind) for mesh in files for kind in kinds]
        for line in robot_lines("diamond", meshes, poisson, (2.0, 0.0, 0.7, 0.0)):
            print(line, flush=True)
    meshes = [("segment_1000.msh", *kind) for kind in kinds]
    for line in robot_lines("segment", meshes, 0.4999, (5e3, 0.0, 0.0, 0.0)):
        print(line, flush=True)


if __name__ == "__main__":
    main()
