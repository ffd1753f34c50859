"""A design by names and units: what changes, what is wanted, and what was found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from softrobot_twin.calibration.design import (
    DesignError,
    DesignModel,
    DesignSearch,
    Found,
    Objective,
    Pose,
)
from softrobot_twin.errors import CommandError
from softrobot_twin.harness.output_file import output_file
from softrobot_twin.harness.terminal import by_key
from softrobot_twin.scene import Scene
from softrobot_twin.scene.loading import text_of
from softrobot_twin.scene.scene_parameters import JointParameter, Parameter, parameters
from softrobot_twin.scripting.named_commands import (
    CommandReader,
    Efforts,
    HoldAll,
    NamedCommand,
    Setpoints,
    check_given,
    finite_numbers,
    one_number,
    place_of,
    positive_number,
)
from softrobot_twin.simulation import CommandEfforts, Simulation
from softrobot_twin.simulation.command import DEFAULT_TIME_STEP

Variables: TypeAlias = Sequence[str] | Mapping[str, str | Mapping[str, float]]
"""Keys of numbers; or names, each with a key, or with keys and shares by which these change together."""
Wanted: TypeAlias = Sequence[tuple[NamedCommand, Mapping[str, Any]]]
"""Commands, each with wanted positions of effectors by name [m], None along a free axis."""
Bounds: TypeAlias = Mapping[str, tuple[float, float]]
SAME_PLACE = 1.0e-4
"""Distance below which places of effectors count as the same, by default [m]."""
# A promise of derivatives beyond this share of the tolerance, which no trial kept, is that of a kink.
_BROKEN = 0.1
# Directions that are told, at most, and parts of each.
_MOST_DIRECTIONS, _MOST_PARTS = 3, 4


def variables_of(scene: Scene, asked: Variables) -> tuple[Parameter | JointParameter, ...]:
    """The design variables of a scene.

    Args:
        scene: The scene.
        asked: See `Variables`.

    Raises:
        SceneError: No number has such a key.
        DesignError: A variable changes nothing, or one number is in two variables.
    """
    check_given("parameters", asked, Iterable, "keys of numbers")
    found: list[Parameter | JointParameter] = []
    if not isinstance(asked, Mapping):
        found += parameters(scene, *asked)
    else:
        for name, given in asked.items():
            shares = {given: 1.0} if isinstance(given, str) else given
            check_given(str(name), shares, Mapping, "a key, or keys each with a share")
            each = [(one, one_number(key, share)) for key, share in shares.items() for one in parameters(scene, key)]
            if not each or not all(share for _, share in each):
                raise DesignError(name, "needs keys of numbers, each with a share that is not 0")
            numbers, parts = zip(*each, strict=True)
            is_one = isinstance(given, str) and len(numbers) == 1
            first = (0.0,) if is_one else tuple(one.read(scene) for one in numbers)
            found.append(JointParameter(name, numbers[0].unit, numbers, first, parts))
    keys = [key for one in found for key in one.changes(0.0)]
    for twice in (key for key in keys if keys.count(key) > 1):
        raise DesignError(twice, "is changed by two variables")
    return tuple(found)


def poses_of(scene: Scene, commands: Iterable[NamedCommand]) -> list[Pose]:
    """Poses by commands, each from rest: actuators that are not named stay as at rest.

    Args:
        scene: The scene.
        commands: Made by `setpoints`, `efforts` or `hold`.

    Raises:
        CommandError: A name is unknown, or a command asks for something else.
    """
    check_given("commands", commands, Iterable, "commands, one for each pose")
    simulation = Simulation(scene, with_warnings=False)
    reader, poses = CommandReader(simulation), []
    for command in commands:
        if not isinstance(command, Setpoints | Efforts | HoldAll):
            raise CommandError("commands", f"{command!r:.60} has no setpoints: a pose of a design is "
                               "setpoints(...), efforts(...) or hold()")
        read, rest = reader.read(command, DEFAULT_TIME_STEP), simulation.rest_setpoints
        holds = np.zeros(len(rest), bool)
        for name in command.values:
            drive = reader.drives[name]
            holds[list(drive.places)] = not drive.lines
        efforts = read.efforts if isinstance(read, CommandEfforts) else None
        setpoints = getattr(read, "setpoints", rest)
        poses.append(Pose(setpoints, simulation.actuators.drives(setpoints), holds, efforts))
    return poses


def bounds_of(
    scene: Scene, variables: Sequence[Parameter | JointParameter], asked: Bounds | tuple[float, float]
) -> np.ndarray:
    """Least and greatest values, shape (variable_count, 2).

    Args:
        scene: The scene.
        variables: The variables.
        asked: By names of variables or keys, perhaps with ``*``; or one pair for all.

    Raises:
        DesignError: A variable has no bounds.
        SceneError: No number has such a key.
    """
    if not isinstance(asked, Mapping):
        asked = {one.key: asked for one in variables}
    names, found = {one.key for one in variables}, dict[str, tuple[float, ...]]()
    for key, pair in asked.items():
        keys = [key] if key in names else [one.key for one in parameters(scene, key)]
        ends = finite_numbers(key, pair)
        if len(ends) != 2 or not names.intersection(keys):
            raise DesignError(key, "the bounds must be a pair of a least and a greatest value of a variable, "
                              f"not {pair!r:.40}")
        found |= dict.fromkeys(keys, ends)
    for lacking in (one for one in variables if one.key not in found):
        raise DesignError(lacking.key, f"has no bounds: give a least and a greatest value [{lacking.unit}]")
    return np.array([found[one.key] for one in variables])


def wanted_places(simulation: Simulation, wanted: Iterable[Mapping[str, Any]]) -> np.ndarray:
    """Wanted places as an array, NaN where an effector is free, shape (pose_count, effector_count, 3).

    Args:
        simulation: The simulation.
        wanted: See `Wanted`.

    Raises:
        CommandError: There is no such effector, or a place is not three numbers.
    """
    names, rows = simulation.effector_names, []
    for places in wanted:
        check_given("objective", places, Mapping, "wanted places by effectors, such as {'tip': [0, 0, 0.1]}")
        row = np.full((len(names), 3), np.nan)
        for name, place in places.items():
            numbers = finite_numbers(name, place, may_be_free=True)
            if len(numbers) != 3:
                raise CommandError(name, f"must be 3 numbers [m], not {len(numbers)}")
            row[place_of(name, "effectors:", names)] = numbers
        rows.append(row)
    found = np.array(rows)
    if not np.isfinite(found).any():
        raise CommandError("objective", "wants no place of any effector")
    return found


@dataclass(frozen=True, repr=False, eq=False)
class Design:
    """What `Robot.optimise` found.

    Attributes:
        values: Values of the variables, by name.
        flatness: How far each can move, while the others make up for it as well as they can, until
            the objective changes by `tolerance`; in its unit, by name. Where this is the whole
            width of its bounds, the objective does not tell it.
        units: By name.
        before: The objective before: the distance of effectors from their places, RMS [m], or the
            value of the function.
        after: The same of the design.
        tolerance: Change of the objective for `flatness`.
        changes: The numbers of the scene, by key, for `Robot.change`.
        scene: The scene with them.
        notes: What else matters, a sentence each.
        found: All that was found, as arrays.
    """

    values: dict[str, float]
    flatness: dict[str, float]
    units: dict[str, str]
    before: float
    after: float
    tolerance: float
    changes: dict[str, float]
    scene: Scene
    notes: tuple[str, ...]
    found: Found
    unit: str

    @classmethod
    def of(cls, model: DesignModel, found: Found, bounds: np.ndarray, unit: str) -> Design:
        """Name what was found.

        Args:
            model: The poses.
            found: The design.
            bounds: See `bounds_of`.
            unit: Unit of the objective; empty without one.
        """
        names, changes = [one.key for one in model.variables], dict[str, float]()
        for one, value in zip(model.variables, found.values, strict=True):
            changes |= one.changes(float(value))
        width = bounds[:, 1] - bounds[:, 0]
        notes = [f"{name} is at its bound of {value:.6g} {one.unit}" for name, one, value, ends, own in
                 zip(names, model.variables, found.values, bounds, width, strict=True)
                 if np.abs(ends - value).min() < 1e-6 * own]  # fmt: skip
        if found.promise > _BROKEN * found.tolerance:
            notes.append(f"a kink is near: derivatives promise {found.promise:.2g} {unit} less, which no trial "
                         "kept; for points of cables, hold_radius makes slopes smooth")
        notes += _untold(names, found)
        slack = by_key((name, index) for index, own in enumerate(found.solved.slack) for name in own)
        if slack:
            poses = (f"{name} (pose {', '.join(map(str, own))})" for name, own in slack.items())
            notes.append(f"slack, so that slopes jump where they begin to pull: {', '.join(poses)}")
        notes += [f"a trial was refused: {reason}" for reason in found.refusals]
        return cls(dict(zip(names, map(float, found.values), strict=True)),
                   dict(zip(names, map(float, found.flatness), strict=True)),
                   {one.key: one.unit for one in model.variables}, found.before, found.after,
                   found.tolerance, changes, model.scene_at(found.values), tuple(notes), found, unit)

    def write(self, path: Path | str) -> None:
        """Writes the scene with these numbers, which may stand in any folder.

        Args:
            path: YAML file to write.

        Raises:
            OutputError: It cannot be written.
        """
        with output_file(path) as file:
            file.write_text(text_of(self.scene), encoding="utf-8")

    def __repr__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        words = (f"objective {self.before:.4g}{unit} -> {self.after:.4g}{unit} in "
                 f"{self.found.trials} trials; flatness for a change of {self.tolerance:.3g}{unit}")
        width = max(map(len, self.values))
        lines = [f"  {name:<{width}}  {value:.6g} ± {self.flatness[name]:.2g} {self.units[name]}"
                 for name, value in self.values.items()]
        return "\n".join([words, *lines, *(f"  {note}" for note in self.notes)])


def _untold(names: list[str], found: Found) -> list[str]:
    """The moves over the whole bounds that change the objective by less than its tolerance."""
    notes, untold = [], np.flatnonzero(found.told < 1.0)[::-1]
    for index in untold[:_MOST_DIRECTIONS]:
        shares = found.directions[index]
        largest = np.argsort(-np.abs(shares))[:_MOST_PARTS]
        shares = shares * np.sign(shares[largest[0]])
        parts = " ".join(f"{shares[place]:+.2f} {names[place]}" for place in largest
                         if abs(shares[place]) > 0.05)
        notes.append(f"the poses do not tell a move by {parts} of the bounds: it changes the objective "
                     f"by {found.told[index]:.2g} tolerances")
    if len(untold) > _MOST_DIRECTIONS:
        notes.append(f"{len(untold)} of {len(names)} directions are not told")
    return notes


def optimised(
    scene: Scene, objective: Wanted | Objective, asked: Variables,
    bounds: Bounds | tuple[float, float], commands: Sequence[NamedCommand], tolerance: float | None,
) -> Design:  # fmt: skip
    """Looks for a design; see `Robot.optimise`."""
    tolerance = None if tolerance is None else positive_number("tolerance", tolerance)
    variables = variables_of(scene, asked)
    ends = bounds_of(scene, variables, bounds)
    if callable(objective):
        model = DesignModel(scene, variables, poses_of(scene, commands))
        found = DesignSearch(model, ends).minimise(objective, tolerance)
        return Design.of(model, found, ends, "")
    if commands:
        raise CommandError("commands", "belong to a function: wanted places have their own")
    try:
        pairs = [(command, places) for command, places in objective]
    except (TypeError, ValueError):
        raise CommandError("objective", "takes pairs of a command and wanted places, or a function") from None
    model = DesignModel(scene, variables, poses_of(scene, [command for command, _ in pairs]))
    wanted = wanted_places(model.solve(model.start).simulation, [places for _, places in pairs])
    found = DesignSearch(model, ends).meet(wanted, SAME_PLACE if tolerance is None else tolerance)
    return Design.of(model, found, ends, "m")
