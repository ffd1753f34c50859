"""``python -m softrobot_twin mesh``: fills the part of a CAD file with tetrahedra.

The size of the tetrahedra is given, or searched for a wanted time of a step: a part is meshed,
simulated and measured on this machine, up to `TRIALS` times. The time of a step grows as a power of
the size, whose exponent two measurements tell.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import shlex
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from softrobot_twin.errors import MeshError, SoftRobotTwinError
from softrobot_twin.geometry.cad_meshing import (
    TRIANGLE_SUFFIXES,
    CadMesh,
    mesh_cad,
    part_size,
    write_msh,
)
from softrobot_twin.geometry.mesh_reading import SLIVER_RATIO, read_solid_mesh
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.solid_repair import repair_solids
from softrobot_twin.geometry.surface_reading import read_surface
from softrobot_twin.geometry.wall_thickness import thinnest_part
from softrobot_twin.harness.length_units import UNITS
from softrobot_twin.harness.output_file import OutputError, output_file
from softrobot_twin.harness.terminal import console, table, terminal_status, warn
from softrobot_twin.kernels.compilation import compilation_time
from softrobot_twin.scene import Scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.command import FollowTargets, Hold
from softrobot_twin.study.accuracy_study import with_element, with_law
from softrobot_twin.study.choice import MARGIN
from softrobot_twin.study.explain import FOUR_NODES, LEAST_ACROSS, print_mesh_error
from softrobot_twin.study.first_scene import LARGEST_IN_METRES, MeshSource, first_scene

BUSY = 1.3
"""A machine on which steps take this many times as long as they compute is called busy."""
MOST_SECONDS = 20.0
"""A mesh is built and its steps are measured for at most this time [s]."""
# The error of a mesh is estimated where a step takes less [s]: the estimate takes as long as many.
_QUICK = 0.5
TRIALS = 5
"""Most meshes that are tried for a wanted time of a step."""
# A mesh is fine enough if its step takes this share of the wanted time.
_NEAR = 0.6
# The time of a step grows with the number of nodes to the power 4/3, before it is measured; what
# two disturbed measurements tell is kept within bounds.
_EXPONENT, _EXPONENTS = -4.0, (-5.0, -2.0)
# Largest size that is tried after one that cannot be meshed, by that.
_BELOW_FAILED = 0.95
# Tetrahedra of the first mesh of a search, about.
_FIRST_TETS = 1000.0
# Steps that are not measured; rounds of measured steps, and steps of a round. The round with the
# least median is that which other programs disturbed least.
_WARM_STEPS, _ROUNDS, _STEPS = 3, 4, 7
# Share of the body by which a measured step moves the effector.
_MOVE = 0.005


class MeshingError(SoftRobotTwinError):
    """A part cannot be meshed as it is asked for."""


class StepTime(NamedTuple):
    """Time of a step on this machine.

    Attributes:
        median: In the round of steps that other programs disturbed least [s]; infinite where no step
            ended in time.
        slowdown: Elapsed time of all rounds by that in which this program computed: 1 on a machine
            that nothing else uses.
        left_out: What of the measurement was left out because it takes too long.
    """

    median: float
    slowdown: float
    left_out: str = ""


class Trial(NamedTuple):
    """A mesh of the part and the time of a step with it.

    Attributes:
        size: Wanted edge of its tetrahedra [m].
        made: The mesh.
        scene: A first scene of it.
        step: Time of a step on this machine.
    """

    size: float
    made: CadMesh
    scene: Scene
    step: StepTime


def measured_step(scene: Scene) -> StepTime:
    """Measures the time of a step on this machine, for at most `MOST_SECONDS` besides compilation.

    A process of its own does, because a step of a large mesh cannot be ended otherwise. Effectors
    follow targets where the scene has actuators; otherwise it settles under gravity.

    Args:
        scene: The scene.

    Raises:
        MeshingError: The scene cannot be built.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_measure, args=(scene, sender, MOST_SECONDS), daemon=True)
    process.start()
    sender.close()
    steps: list[tuple[float, float]] = []
    try:
        with suppress(EOFError):
            while True:
                told = receiver.recv()
                if isinstance(told, str):
                    raise MeshingError(f"its steps cannot be measured: {told}")
                steps.append(told)
    finally:
        process.kill()
        process.join()
    if not steps:
        return StepTime(math.inf, 1.0, "not measured: building it and a step take more than "
                        f"{MOST_SECONDS:.0f} s")  # fmt: skip
    measured = np.array(steps[_WARM_STEPS:] or steps[-1:])
    rounds = [np.median(measured[first : first + _STEPS, 0])
              for first in range(0, max(len(measured) - _STEPS, 0) + 1, _STEPS)]  # fmt: skip
    total = _WARM_STEPS + _ROUNDS * _STEPS
    left_out = "" if len(steps) == total else (
        f"measured in {len(steps)} of {total} steps: all take more than {MOST_SECONDS:.0f} s")
    slowdown = measured[:, 0].sum() / max(float(measured[:, 1].sum()), 1e-9)
    return StepTime(float(min(rounds)), max(1.0, float(slowdown)), left_out)


def _measure(scene: Scene, sender: Connection, most_seconds: float) -> None:
    """Sends the time of each step, elapsed and computed [s]; ends the process when time is over."""
    began, compiled = time.monotonic(), compilation_time()

    def watch() -> None:
        while time.monotonic() - began - (compilation_time() - compiled) < most_seconds:
            time.sleep(0.05)
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()
    try:
        simulation = Simulation(scene, with_warnings=False)
        simulation.warm_up()
        command = Hold(0.02)
        if simulation.actuators.count:
            near = simulation.effector_positions() + _MOVE * simulation.model.nodes.size
            command = FollowTargets(near, 0.02)
        for _ in range(_WARM_STEPS + _ROUNDS * _STEPS):
            computed = time.process_time()
            elapsed = simulation.step(command).report.compute_time
            sender.send((elapsed, time.process_time() - computed))
    except Exception as error:  # whatever it is, the parent tells it
        sender.send(f"{type(error).__name__}: {error}")


def size_for(wanted: float, first: float, largest: float, measure: Callable[[float], float]) -> float:
    """The least size whose step takes at most a wanted time.

    A size that cannot be meshed is too large for the part: smaller ones are tried.

    Args:
        wanted: Time of a step [s].
        first: Size that is tried first [m].
        largest: Largest size that is tried [m].
        measure: Time of a step with a size [s].

    Returns:
        A size that was measured [m].

    Raises:
        MeshingError: Even the largest size is too slow.
        MeshError: No size that was tried can be meshed.
    """
    found: dict[float, float] = {}
    fast: dict[float, float] = {}
    size, exponent = min(first, largest), _EXPONENT
    failure: MeshError | None = None
    for _ in range(TRIALS):
        try:
            found[size] = measure(size)
        except MeshError as error:
            failure, largest = error, _BELOW_FAILED * size
            size = math.sqrt(size * max(found)) if found else 0.7 * size
            continue
        fast = {one: taken for one, taken in found.items() if taken <= wanted}
        if fast and max(fast.values()) >= _NEAR * wanted:
            break
        if len(found) > 1:
            (one, taken), (other, others) = sorted(found.items())[0], sorted(found.items())[-1]
            slope = math.log(others / taken) / math.log(other / one)
            exponent = min(max(slope, _EXPONENTS[0]), _EXPONENTS[1])
        # A little faster than wanted, because the next measurement differs too.
        size = min(largest, size * (0.8 * wanted / found[size]) ** (1.0 / exponent))
        if any(abs(size / one - 1.0) < 0.02 for one in found):
            break
    if failure is not None and not found:
        raise failure
    if not fast:
        coarsest = max(found)
        raise MeshingError(f"no size was found whose step takes at most {_time(wanted)}: one of "
                           f"{1e3 * coarsest:.3g} mm takes {_time(found[coarsest])} on this "
                           "machine; linear elements (--element linear) are faster, and less accurate")
    return min(fast)


def mesh_part(
    path: Path, output: Path, *, size: float | None = None, step: float | None = None,
    unit: str | None = None, element: str = "quadratic", repair: bool = False,
    turn: int | None = None,
) -> int:  # fmt: skip
    """Meshes a part, writes the mesh in metres and tells its quality.

    Args:
        path: CAD file.
        output: Mesh file, .msh; with `repair` also .stl, to which the repaired surface is written
            in the unit of the part.
        size: Wanted edge of the tetrahedra [m].
        step: Wanted time of a step, in place of a size [s].
        unit: Unit of a surface file, of `UNITS`; None for millimetres.
        element: Kind of elements whose step is measured.
        repair: Whether holes are closed and solids that overlap united.
        turn: Elements in a full turn of all curved faces; None refines walls of cavities alone.

    Returns:
        Exit code.

    Raises:
        SoftRobotTwinError: The part cannot be meshed, or the file not be written.
    """
    if not path.is_file():
        reason = "is a folder" if path.is_dir() else "there is no such file"
        raise MeshingError(f"{path}: {reason}")
    if repair and output.suffix.lower() == ".stl":
        return _write_repaired(path, output)
    if size is None and step is None:
        raise MeshingError("one of --size, --rate and --step-time is required for a .msh file")
    if output.suffix.lower() != ".msh":
        raise OutputError(output, "a mesh is a .msh file (Gmsh)")
    scale = 1.0
    if path.suffix.lower() in TRIANGLE_SUFFIXES:
        scale = UNITS[unit or "mm"]
        if unit is None:
            kind = path.suffix[1:].upper()
            warn(f"{path.name}: {kind} files have no unit; millimetres are assumed (--unit)")
    elif repair:
        raise MeshingError(f"--repair: {path.name} has no triangles; it is for "
                           f"{', '.join(TRIANGLE_SUFFIXES)}")
    elif unit is not None:
        raise MeshingError(f"--unit {unit}: {path.name} states its unit")
    with tempfile.TemporaryDirectory(prefix="softrobot_twin_mesh_") as folder:
        def tried(size: float) -> Trial:
            with terminal_status(f"meshing with {1e3 * size:.3g} mm"):
                made = mesh_cad(path, size, scale, repair, turn)
            return _tried(made, size, Path(folder) / f"{path.stem}.msh", element)

        trial = tried(size) if step is None else _searched(path, step, tried, scale, repair)
        _print(path, trial, element)
        if trial.step.median < _QUICK:
            # The law is a simple one of the same moduli.
            corotational = with_law(trial.scene, "corotational")
            print_mesh_error(corotational, begin="With a tip at the far end: ")
        else:
            console().print("The error of the mesh is not estimated: that takes as long as many steps; "
                            "`explain` does it", soft_wrap=True)  # fmt: skip
    with output_file(output) as partial:
        write_msh(partial, trial.made)
    largest = float(np.ptp(trial.made.mesh.node_positions, axis=0).max())
    console().print(f"\n{output} is in metres. A scene for it: {scene_command(output, largest)}",
                    soft_wrap=True)  # fmt: skip
    return 0


def _write_repaired(path: Path, output: Path) -> int:
    """Writes the repaired surface of a part, and returns the exit code."""
    notes: list[str] = []
    points, triangles = repair_solids(path, *read_surface(path, notes=notes), notes)
    with output_file(output) as partial:
        meshio.Mesh(points, [("triangle", triangles)]).write(partial, "stl", binary=True)
    for note in notes or ["nothing to repair was found"]:
        warn(note)
    console().print(f"{output} has the repaired surface, {len(triangles)} triangles", soft_wrap=True)
    return 0


def scene_command(mesh: Path, largest: float) -> str:
    """The command that makes a scene for a mesh in metres, as a shell takes it.

    Args:
        mesh: Its file.
        largest: Its largest extent [m].
    """
    # Of a larger one `init` would guess that it is in millimetres.
    unit = " --unit m" if largest > LARGEST_IN_METRES else ""
    return f"softrobot_twin init {shlex.quote(str(mesh))}{unit}"


def _tried(made: CadMesh, size: float, file: Path, element: str) -> Trial:
    """Measures a step of a first scene with a mesh."""
    write_msh(file, made)
    source = MeshSource(file, 1.0, None, "")
    _, scene, _ = first_scene(file.with_suffix(".yaml"), source, read_solid_mesh(file), file.parent)
    scene = with_element(scene, element)
    with terminal_status(f"measuring steps with {made.mesh.node_count} nodes"):
        return Trial(size, made, scene, measured_step(scene))


def _searched(
    path: Path, wanted: float, tried: Callable[[float], Trial], scale: float, repair: bool
) -> Trial:
    """The finest mesh whose step takes a wanted time."""
    part, trials = part_size(path, scale, repair), {}
    console().print(f"searching the size for a step of {_time(wanted)}: at most {TRIALS} meshes "
                    "are made and measured")  # fmt: skip

    def measure(size: float) -> float:
        trials[size] = tried(size)
        mesh, step = trials[size].made.mesh, trials[size].step
        console().print(f"{1e3 * size:8.3g} mm {mesh.node_count:8d} nodes   step "
                        f"{step.left_out if math.isinf(step.median) else _time(step.median)}")  # fmt: skip
        # One that was not measured takes longer than the measurement.
        return min(step.median, MOST_SECONDS)

    try:
        largest = 0.5 * float(part.extents.max())
        return trials[size_for(wanted, part.size_for(_FIRST_TETS), largest, measure)]
    finally:
        slowdown = float(np.median([trial.step.slowdown for trial in trials.values()] or [1.0]))
        if slowdown > BUSY:
            warn(f"other programs slowed the measurements down {slowdown:.1f} times: search again "
                 "when they are done, for a finer mesh")  # fmt: skip


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms"


def _print(path: Path, trial: Trial, element: str) -> None:
    """Prints the quality of a mesh."""
    mesh, made = trial.made.mesh, trial.made
    ratios = radius_ratios(mesh)
    thin = thinnest_part(mesh)
    extents = 1e3 * np.ptp(mesh.node_positions, axis=0)
    shown = table(f"{path.name} with tetrahedra of {1e3 * trial.size:.4g} mm", "what", "value")
    shown.add_row("extents", " × ".join(f"{extent:.4g}" for extent in extents) + " mm")
    shown.add_row("volume", f"{1e9 * mesh.volume:.6g} mm³")
    shown.add_row("nodes, tetrahedra", f"{mesh.node_count}, {mesh.cell_count}")
    shown.add_row("radius ratio", f"worst {ratios.min():.2f}, mean {ratios.mean():.2f} (1: "
                  "regular, 0: flat)")  # fmt: skip
    shown.add_row("thinnest part", f"{1e3 * thin.thickness:.3g} mm, {thin.elements:.1f} elements "
                  f"across, at {_place(thin.place)}")  # fmt: skip
    for name in made.cavities:
        lost = f", {100.0 * made.lost[name]:.1f} % less than in the part" if name in made.lost else ""
        shown.add_row(name, f"{1e9 * made.cavity_volume(name):.6g} mm³{lost}, a named surface of "
                      f"{len(made.cavities[name])} triangles")  # fmt: skip
    if not made.cavities:
        shown.add_row("cavities", "none: no closed surface lies inside the part")
    for name, tets in made.regions.items():
        shown.add_row(f"region {name}", f"{len(tets)} tetrahedra")
    step = trial.step
    if math.isfinite(step.median):
        shown.add_row("expected step", f"{_time(step.median)} with {element} elements on this "
                      f"machine, {float(f"{MARGIN / step.median:.3g}"):g} Hz")  # fmt: skip
    if step.left_out:
        shown.add_row("" if math.isfinite(step.median) else "expected step", step.left_out)
    if step.slowdown > BUSY:
        shown.add_row("", f"measured while other programs slowed this one down {step.slowdown:.1f} "
                      "times")  # fmt: skip
    console().print(shown)
    for note in made.notes:
        warn(note)
    slivers = int(np.count_nonzero(ratios < SLIVER_RATIO))
    if slivers:
        warn(f"{slivers} tetrahedra have a radius ratio below {SLIVER_RATIO:g}")
    if element in FOUR_NODES and thin.elements < LEAST_ACROSS:
        warn(f"only {thin.elements:.1f} {element} elements lie across {1e3 * thin.thickness:.3g} mm "
             f"at {_place(thin.place)}: it bends far too stiffly; give a smaller size")


def _place(place: np.ndarray) -> str:
    return "(" + ", ".join(f"{1e3 * value + 0.0:.3g}" for value in place) + ") mm"
