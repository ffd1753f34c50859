"""``python -m softrobot_twin reduce-vertebrae``: makes the superelements of a scene's bodies.

1. The full model, all nodes free, is brought to random setpoints within the limits of the
   actuators. That shows which deformations of the soft parts occur.
2. Each soft part is solved by itself at many poses around these, and its enthalpy is fitted
   (`study/superelement_fit.py`).
3. Full and reduced model are compared at fresh setpoints, which were used for neither, and the
   error of the reduced one is printed: of all effectors and free vertebrae, against their
   displacement from where they are at the setpoints of rest. It is saved with the superelements.

Superelements that are of the present mesh, material, vertebrae and walls are left as they are.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.analysis.reduction_error import ReductionStates
from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.equilibrium import bring_to_rest
from softrobot_twin.harness.sampled_axes import shifted_sobol
from softrobot_twin.harness.terminal import console, table, tracked, warn
from softrobot_twin.reduction.superelement_fit import (
    FittedPart,
    SoftPartModel,
    deformations_between,
    fit_enthalpy,
    range_of,
    sample,
    sample_count,
)
from softrobot_twin.reduction.training_options import TEST_STATES
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.scene_changes import full_scene, without_vertebrae
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.reduced_body import ModelFileError
from softrobot_twin.simulation.building.scene_layout import lay_out, walls_on, whole_layout
from softrobot_twin.simulation.building.vertebrae import (
    Division,
    Reduction,
    divide,
    fingerprints,
    read_reduction,
    reduction_path,
    write_reduction,
)

# States of the full model that show which deformations occur.
RANGE_STATES = 32
# Steps from rest to a state.
WAY = 3


class ReductionError(SoftRobotTwinError):
    """A scene cannot be reduced."""


class Accuracy(NamedTuple):
    """The reduced model against the full one.

    Attributes:
        names: Effectors and free vertebrae.
        errors: Distance at each state [m], shape (state_count, name_count).
        displacements: Displacement of the full model from the setpoints of rest [m], same shape.
        ranges: Largest |z| at each state, shape (state_count,).
        seed: Of the states.
        lost: States of the full model at which the reduced one found no equilibrium.
    """

    names: tuple[str, ...]
    errors: np.ndarray
    displacements: np.ndarray
    ranges: np.ndarray
    seed: int
    lost: int = 0

    @property
    def shares(self) -> np.ndarray:
        """Error of each by its displacement, shape (state_count, name_count)."""
        return self.errors / self.displacements


def setpoints_within(simulation: Simulation, count: int, seed: int) -> np.ndarray:
    """Random setpoints within the limits of all actuators.

    Args:
        simulation: The scene.
        count: How many.
        seed: Of the shift of Sobol's sequence.

    Returns:
        Setpoints, shape (count, actuator_count).

    Raises:
        ReductionError: An actuator has no limits.
    """
    low, high = simulation.limits.setpoint_range(simulation.rest_setpoints)
    for name, least, most in zip(simulation.actuator_names, low, high, strict=True):
        if not (np.isfinite(least) and np.isfinite(most)):
            raise ReductionError(f"{name} has no limits: the range in which superelements are "
                                 "sampled is that of the actuators")
    return low + (high - low) * shifted_sobol(len(low), count, seed)


def brought_to(simulation: Simulation, setpoints: np.ndarray) -> bool:
    """Bring a simulation from its rest shape to rest at setpoints; False where it gets to none.

    Args:
        simulation: The simulation; is moved.
        setpoints: Setpoints of the actuators, in their units, shape (actuator_count,).
    """
    simulation.reset()
    return bring_to_rest(simulation, setpoints, WAY).is_reached


def _rigid_pose(points: np.ndarray, at_rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation from rest and middle of points that move nearly as a rigid body."""
    middle = points.mean(axis=0)
    turn, _ = Rotation.align_vectors(points - middle, at_rest - at_rest.mean(axis=0))
    return turn.as_matrix(), middle


def occurring_deformations(division: Division, positions: np.ndarray) -> np.ndarray:
    """e of every soft part at a state of the full model, shape (part_count, 6).

    Args:
        division: The body, divided.
        positions: Its node positions [m], shape (node_count, 3).
    """
    poses = [_rigid_pose(positions[own], division.positions[own]) for own in division.nodes]
    found = []
    for part in division.parts:
        a, b = part.ends
        ends = [
            poses[v][1] + poses[v][0] @ (end - division.positions[division.nodes[v]].mean(axis=0))
            for v, end in zip(part.ends, part.end_points, strict=True)
        ]
        chord = poses[a][0].T @ (ends[1] - ends[0])
        rest = part.end_points[1] - part.end_points[0]
        found.append(deformations_between(poses[a][0].T @ poses[b][0], chord, rest))
    return np.array(found)


def divisions(scene: Scene) -> list[Division]:
    """The bodies of a scene that have vertebrae, divided.

    Args:
        scene: The scene.
    """
    layout = lay_out(without_vertebrae(scene), [])
    whole = [
        replace(body, entry=entry, first_node=0)
        for body, entry in zip(layout.bodies, scene.deformables, strict=True)
    ]
    found = whole_layout(scene, whole)
    return [divide(body, walls_on(body, found, []), scene)
            for body in whole if body.entry.vertebrae]


def reduce_body(
    division: Division, deformations: np.ndarray, pressures: np.ndarray, seed: int
) -> tuple[Reduction, list[FittedPart]]:
    """Make the superelements of a body.

    Args:
        division: The body, divided.
        deformations: e that occur, shape (state_count, part_count, 6).
        pressures: Least and greatest pressure of each of its cavities [Pa], shape (count, 2).
        seed: Of the samples.

    Returns:
        They, and how each was made.
    """
    degree = division.body.entry.vertebrae.degree
    volumes, areas = np.zeros((2, len(division.cavities)))
    made = []
    for index, part in enumerate(division.parts):
        model = SoftPartModel(division, part)
        own = list(part.cavities)
        volumes[own] += model.rest_volumes
        areas[own] += model.rest_areas
        within = range_of(deformations[:, index], pressures[own], float(np.linalg.norm(model.rest)))
        count = sample_count(model.variable_count, degree)
        samples, lost = sample(model, within, count, seed + index)
        made.append(fit_enthalpy(model, part, within, samples, degree, lost))
    reduction = Reduction(tuple(fitted.fit for fitted in made), degree, volumes, areas)
    return reduction, made


def accuracy_of(scene: Scene, count: int, seed: int) -> Accuracy:
    """Compare the reduced model with the full one at fresh setpoints.

    Args:
        scene: A scene whose superelements are made.
        count: Number of states.
        seed: Of the setpoints.
    """
    exact = full_scene(scene)
    full, reduced = (Simulation(chosen, with_warnings=False)
                     for chosen in (without_vertebrae(exact), exact))
    names, own, others = zip(*_free_vertebrae(full, reduced), strict=True)
    rest_full, rest_reduced = full.rest_setpoints, reduced.rest_setpoints
    brought_to(full, rest_full)
    start, rows, lost = _places(full, own), [], 0
    for setpoints in tracked(setpoints_within(full, count, seed), "full and reduced model", count):
        if not brought_to(full, setpoints):
            warn("the full model found no equilibrium at a state; it is left out")
            continue
        if not brought_to(reduced, setpoints - rest_full + rest_reduced):
            lost += 1
            continue
        at, states = _places(full, own), ReductionStates(reduced).read().values()
        rows.append((np.linalg.norm(_places(reduced, others) - at, axis=1),
                     np.linalg.norm(at - start, axis=1), max(state.range for state in states)))
    if not rows:
        raise ReductionError(
            f"full and reduced model have an equilibrium in common at no setpoints of seed {seed}"
        )
    columns = map(np.array, zip(*rows, strict=True))
    return Accuracy((*full.effector_names, *names), *columns, seed, lost)


def _free_vertebrae(full: Simulation, reduced: Simulation) -> list[tuple]:
    """Name of each free vertebra, and mappings of its nodes in the full and the reduced model."""
    found = []
    for own, other in zip(full.model.bodies, reduced.model.bodies, strict=True):
        if other.vertebrae:
            division = other.division
            found += [(name, own.node_mapping(at), other.node_mapping(at)) for name, at, is_fixed
                      in zip(division.names, division.nodes, division.is_fixed) if not is_fixed]
    return found


def _places(simulation: Simulation, mappings: Sequence) -> np.ndarray:
    """Points that are compared: effectors, and middles of nodes [m], shape (count, 3)."""
    x = simulation.state.positions
    middles = [mapping.positions(x).mean(axis=0) for mapping in mappings]
    return np.vstack([simulation.effector_positions(), *middles])


def reduce_vertebrae(scene_path, seed: int = 1, states: int = TEST_STATES, again: bool = False):
    """Make the superelements of a scene where they are missing or out of date, and state their
    error.

    Args:
        scene_path: The scene file.
        seed: Of setpoints and samples; fresh states have the next one.
        states: Fresh states that the reduced model is compared at; none for 0.
        again: Make them even where they are current.

    Returns:
        Exit code: 0; 1 where the reduced model lost a state that the full one has.

    Raises:
        SoftRobotTwinError: The scene cannot be reduced.
    """
    scene, out = load_scene(scene_path), console()
    found = divisions(scene)
    if not found:
        raise ReductionError(f"{scene_path}: no body has vertebrae")
    outdated = []
    for division in found:
        path = reduction_path(division.body, scene)
        why = _outdated(path, division)
        if again or why:
            outdated.append(division.body.name)
            out.print(f"{division.body.name}: superelements are {why or 'made again'}")
        else:
            out.print(f"{division.body.name}: superelements in {path} are current")
    if outdated:
        _make(scene, found, outdated, seed, out)
    if states:
        accuracy = accuracy_of(scene, states, seed + 1000)
        _print_accuracy(accuracy, out)
        measured = np.array([np.median(accuracy.shares), accuracy.shares.max()])
        for division in found:
            path = reduction_path(division.body, scene)
            saved = read_reduction(path, division)._replace(measured=measured)
            write_reduction(path, saved, fingerprints(division))
        return 1 if accuracy.lost else 0
    return 0


def _outdated(path: Path, division: Division) -> str:
    """Why the superelements of a file have to be made; empty where they are current."""
    try:
        read_reduction(path, division)
    except ModelFileError as error:
        if error.changed == ("file",):
            return "made for the first time"
        changed = f"changed since are {', '.join(error.changed)}"
        return f"made again: {changed if error.changed else f'the file {error.reason}'}"
    return ""


def _make(scene: Scene, found: list[Division], outdated: list[str], seed: int, out) -> None:
    begin = time.perf_counter()
    full = Simulation(without_vertebrae(full_scene(scene)), with_warnings=False)
    first_nodes = [body.first_node for body, entry in
                   zip(full.model.bodies, scene.deformables, strict=True) if entry.vertebrae]
    occurring, efforts = [[] for _ in found], []
    for setpoints in tracked(setpoints_within(full, RANGE_STATES, seed), "full model", RANGE_STATES):
        if not brought_to(full, setpoints):
            warn(f"the full model found no equilibrium at setpoints {setpoints}; left out")
            continue
        efforts.append(full.state.efforts)
        for own, division, first in zip(occurring, found, first_nodes, strict=True):
            nodes = full.state.positions[first : first + len(division.positions)]
            own.append(occurring_deformations(division, nodes))
    if not efforts:
        raise ReductionError("the full model found an equilibrium at none of its setpoints")
    out.print(f"full model: {len(efforts)} states in {time.perf_counter() - begin:.1f} s, "
              f"setpoints from seed {seed}")
    for division, states in zip(found, occurring, strict=True):
        if division.body.name not in outdated:
            continue
        pressures = _pressure_ranges(division, full, np.array(efforts))
        reduction, made = reduce_body(division, np.array(states), pressures, seed)
        rows = table(
            f"Superelements of {division.body.name}", "between", "inner nodes", "cavities", "samples",
            "not reached", "residual of the fit, median", "95 %", "worst", rows=(
                [" - ".join(division.names[end] for end in part.ends), str(len(part.inner)),
                 ", ".join(division.cavities[c] for c in part.cavities) or "-",
                 str(len(fitted.shares)), str(fitted.lost),
                 *(f"{100.0 * np.percentile(fitted.shares, q):.2f} %" for q in (50, 95, 100))]
                for part, fitted in zip(division.parts, made, strict=True)))
        path = reduction_path(division.body, scene)
        write_reduction(path, reduction, fingerprints(division))
        out.print(rows)
        out.print(f"saved in {path}, {1e-3 * path.stat().st_size:.0f} kB, "
                  f"{time.perf_counter() - begin:.1f} s in all")


def _pressure_ranges(division: Division, full: Simulation, efforts: np.ndarray) -> np.ndarray:
    """Least and greatest pressure of each cavity on a body [Pa], shape (count, 2)."""
    ranges = np.empty((len(division.cavities), 2))
    for own, name in zip(ranges, division.cavities, strict=True):
        index = full.actuator_names.index(name)
        own[:] = min(0.0, efforts[:, index].min()), max(0.0, efforts[:, index].max())
        limits = full.limits.effort_min[index], full.limits.effort_max[index]
        if full.model.actuators.is_effort_driven[index]:
            own[:] = limits
    return ranges


def _print_accuracy(found: Accuracy, out) -> None:
    """Print the error of the reduced model."""
    title = (f"Reduced against full model at {len(found.errors)} fresh states of the whole range, "
             f"seed {found.seed}")
    rows = table(title, "point", "displacement, median", "error, median", "error, worst",
                 "of displacement, median", "of displacement, worst")
    for index, name in enumerate(found.names):
        errors, shares = found.errors[:, index], 100.0 * found.shares[:, index]
        rows.add_row(
            name, f"{1e3 * np.median(found.displacements[:, index]):.2f} mm",
            f"{1e3 * np.median(errors):.4f} mm", f"{1e3 * errors.max():.4f} mm",
            f"{np.median(shares):.3f} %", f"{shares.max():.3f} %",
        )  # fmt: skip
    out.print(rows)
    if found.lost:
        out.print(f"the reduced model found no equilibrium at {found.lost} states more")
    out.print(f"largest share of the sampled range: {found.ranges.max():.2f} (out of it above 1)")
