"""Runs a recorded run again, tick by tick, and compares all that it gives with the recording."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.control.loop_settings import Mode, settings_of
from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop, is_call
from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.record.loop_calls import repeat
from softrobot_twin.record.run_clock import PlayedClock
from softrobot_twin.record.run_description import (
    RunDescription,
    digest_of,
    files_named,
    names_of,
)
from softrobot_twin.record.run_file import CALL, TICK, RunFile, RunFileError
from softrobot_twin.record.run_values import (
    ACTUATORS,
    COMPUTE_TIME,
    EFFECTORS,
    ONE,
    STATE_DIGEST,
    TOUCHES,
    Quantity,
    numbers,
    quantities,
    tick_values,
)
from softrobot_twin.scene import Scene
from softrobot_twin.scene.loading import (
    load_scene,
    read_changes,
    read_yaml,
    scene_from_mapping,
)
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.simulation import Simulation

ANSWER = "answer"
"""Name under which answers of inputs and services are compared."""


# --- differences ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """Where a quantity of one tick differs.

    Attributes:
        tick: Number of the tick.
        time: Time since the first tick [s].
        quantity: Its name; of a call its name.
        place: What differs, such as ``north [N]``; empty where all of it does.
        recorded: Recorded value.
        replayed: Value of the replay.
        size: Largest difference of its numbers, in its unit; infinite where they cannot be
            subtracted, such as words.
    """

    tick: int
    time: float
    quantity: str
    place: str
    recorded: object
    replayed: object
    size: float

    def in_words(self) -> str:
        """The difference as a sentence."""
        of = "" if self.place.startswith("[") else "of "
        where = f"{self.quantity} {of}{self.place}" if self.place else self.quantity
        return (f"tick {self.tick} at {self.time:.3f} s: {where}: recorded "
                f"{_short(self.recorded)}, replayed {_short(self.replayed)}")  # fmt: skip


@dataclass
class QuantityDifferences:
    """All differences of one quantity.

    Attributes:
        first: The first.
        largest: That of the largest size.
        ticks: Ticks in which it differs.
    """

    first: Difference
    largest: Difference
    ticks: int = 0


@dataclass
class Comparison:
    """What a replay found.

    Attributes:
        ticks: Ticks that were replayed.
        calls: Messages that reached the loop, service calls and changes of parameters.
        seconds: Time from the first tick to the last [s].
        first: The first difference; None where all is equal to the bit.
        by_quantity: Differences by the name of their quantity.
        refused: Why a call could not be repeated, one sentence each.
    """

    ticks: int = 0
    calls: int = 0
    seconds: float = 0.0
    first: Difference | None = None
    by_quantity: dict[str, QuantityDifferences] = field(default_factory=dict)
    refused: list[str] = field(default_factory=list)

    @property
    def is_equal(self) -> bool:
        """Whether all that was replayed is equal to the bit."""
        return self.first is None and not self.refused

    def add(self, difference: Difference) -> None:
        """Takes a difference.

        Args:
            difference: The difference.
        """
        if self.first is None:
            self.first = difference
        known = self.by_quantity.get(difference.quantity)
        if known is None:
            known = QuantityDifferences(difference, difference)
            self.by_quantity[difference.quantity] = known
        known.ticks += 1
        if difference.size > known.largest.size:
            known.largest = difference


def _short(value: object) -> str:
    text = repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _text(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))


class TickComparison:
    """Compares the values of ticks.

    Args:
        description: What the run began with, for names and units.
        left_out: Quantities that are not compared.
    """

    def __init__(self, description: RunDescription, left_out: tuple[str, ...] = ()):
        self._description, self._left_out = description, left_out

    def differences(
        self, tick: int, time: float, recorded: dict[str, Any], replayed: dict[str, Any]
    ) -> list[Difference]:
        """The differences of one tick, in the order of `QUANTITIES`.

        Args:
            tick: Its number.
            time: Its time [s].
            recorded: Recorded values, as `tick_values` gives them.
            replayed: Those of the replay.
        """
        found = []
        known = quantities()
        for name in (*known, *(recorded.keys() | replayed.keys()) - known.keys()):
            if name in self._left_out:
                continue
            before, after = recorded.get(name), replayed.get(name)
            # Shortest decimals are equal where all bits are.
            if _text(before) != _text(after):
                found.append(self._difference(tick, time, name, before, after))
        return found

    def _difference(self, tick: int, time: float, name: str, before: object, after: object) -> Difference:
        quantity = quantities().get(name, Quantity())
        if not quantity.unit:  # No two of them can be subtracted.
            return Difference(tick, time, name, "", before, after, np.inf)
        try:
            first, second = numbers(before), numbers(after)
        except (TypeError, ValueError):
            return Difference(tick, time, name, "", before, after, np.inf)
        if first.shape != second.shape or before is None or after is None:
            return Difference(tick, time, name, "", before, after, np.inf)
        apart = _apart(first, second)
        place = np.unravel_index(int(apart.argmax()), apart.shape) if apart.shape else ()
        unit = self._unit(quantity, place)
        shown = "" if unit == ONE else f"[{unit}]"
        words = " ".join(filter(None, (self._name(quantity, place), shown)))
        return Difference(
            tick, time, name, words, _item(before, place), _item(after, place),
            float(apart[place]),
        )  # fmt: skip

    def _unit(self, quantity: Quantity, place: tuple) -> str:
        units = self._description.units.get(quantity.unit)
        return units[place[0]] if units is not None and place else quantity.unit

    def _name(self, quantity: Quantity, place: tuple) -> str:
        if not place:
            return ""
        names = self._description.names.get(quantity.rows)
        row = names[place[0]] if names is not None else str(place[0])
        has_column = len(place) > 1 and quantity.columns
        return f"{row} {quantity.columns[place[1]]}" if has_column else row


def _apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Differences of two arrays; infinite where only one is a number."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(first - second)
    is_same = (first == second) | (np.isnan(first) & np.isnan(second))
    return np.where(is_same, 0.0, np.where(np.isnan(apart), np.inf, apart))


def _item(value: Any, place: tuple) -> object:
    for index in place:
        value = value[index]
    return value


# --- scenes --------------------------------------------------------------------------------------


def recorded_scene(run: RunFile, changes: Mapping[str, Any]) -> Scene:
    """The scene of a run, whose files must not have changed.

    Files are looked for where they were, then beside the file of the run.

    Args:
        run: The run.
        changes: Other values of its entries, beside those of the run; see `changed_scene`.

    Raises:
        RunFileError: A file is missing or has changed.
        SceneError: A change cannot be used.
    """
    mapping, path = read_yaml(run.description.scene_text), Path(run.description.scene_path)
    recorded = run.description.parameters.get("scene_changes", ())  # earlier releases had none
    changes = {**read_changes(filter(None, recorded)), **changes}
    scene = changed_scene(scene_from_mapping(mapping, path), changes)
    moved = _moved_files(run, scene)
    if not moved:
        return scene
    return changed_scene(scene_from_mapping(_with_files(mapping, moved), path), _with_files(changes, moved))


def _moved_files(run: RunFile, scene: Scene) -> dict[str, str]:
    """Where the files are that are not where they were, by their name in the scene."""
    named = {str(name) for name in files_named(scene)}
    moved = {}
    for file in run.description.files:
        if file.name not in named:
            continue  # A change names another one.
        beside = run.path.resolve().parent
        places = (Path(file.path), beside / file.name, beside / Path(file.name).name)
        found = next((place for place in places if place.is_file()), None)
        if found is None:
            looked = ", ".join(str(place) for place in dict.fromkeys(places))
            raise RunFileError(run.path, f"needs {file.name}: no such file; looked for {looked}")
        if digest_of(found) != file.sha256:
            raise RunFileError(run.path, f"{found} has changed since the run: its SHA-256 was {file.sha256}")
        if found != Path(file.path):
            moved[file.name] = str(found)
    return moved


def _with_files(entry: Any, moved: dict[str, str]) -> Any:
    """A scene with other paths of its files."""
    if isinstance(entry, dict):
        return {key: _with_files(value, moved) for key, value in entry.items()}
    if isinstance(entry, list):
        return [_with_files(value, moved) for value in entry]
    return moved.get(entry, entry) if isinstance(entry, str) else entry


# --- replay --------------------------------------------------------------------------------------


class Replay:
    """Runs a recorded run again.

    Attributes:
        run: The run.
        loop: The loop, built anew.
        comparison: What was found until now.
        is_of_its_scene: Whether the scene is the recorded one.
    """

    def __init__(self, run: RunFile, scene: Path | None = None, changes: Sequence[str] = ()):
        """Builds and warms up the loop.

        Args:
            run: The run.
            scene: Another scene in place of the recorded one.
            changes: Other values of entries of the recorded scene; see `read_changes`.

        Raises:
            RunFileError: A file of the scene is missing or has changed, or the other scene has
                other actuators, effectors or touches.
            SoftRobotTwinError: The scene or the recorded parameters cannot be used.
        """
        self.run, self.comparison = run, Comparison()
        self.is_of_its_scene = scene is None and not changes
        self._clock = PlayedClock()
        built = recorded_scene(run, read_changes(changes)) if scene is None else load_scene(scene)
        simulation = Simulation(built, self._clock)
        parameters = run.description.parameters
        velocity_effector = parameters["velocity_effector"]
        _check_names(run, simulation)
        self.loop = TwinLoop(
            simulation, settings_of(run.description.settings), Mode(parameters["mode"]),
            bool(parameters["use_device"]),
            list(simulation.effector_names).index(velocity_effector)
            if velocity_effector else 0,
            str(parameters["frame_id"]), float(parameters["ambient_pressure"]),
        )  # fmt: skip
        simulation.warm_up()
        # The time of a step of another scene is not its own, and all its nodes differ.
        left_out = () if self.is_of_its_scene else (COMPUTE_TIME, STATE_DIGEST)
        self._compare = TickComparison(run.description, left_out)

    def all_ticks(self, take: Callable[[TickOutcome, int, float], None] = lambda *tick: None) -> Comparison:
        """Replays the run to its end, or up to where something of it is missing.

        Args:
            take: Called after each tick with what it gave, its time on the clock of the stamps
                [ns], and since the first tick [s].
        """
        found, began = self.comparison, None
        for entry in self.run.entries():
            content = entry.content
            if entry.kind == CALL:
                self._call(content, found.ticks, found.seconds)
                continue
            if entry.kind != TICK:
                raise RunFileError(self.run.path, f"holds an entry {entry.kind}, which is unknown")
            began = content["now"] if began is None else began
            found.seconds = content["now"] - began
            self._clock.play(content["clock"])
            outcome = self.loop.tick(content["now"], content["ros_time"])
            for difference in self._compare.differences(
                content["tick"], found.seconds, content["values"], tick_values(outcome)
            ):
                found.add(difference)
            found.ticks += 1
            self.loop.simulation.plan()
            take(outcome, content["ros_time"], found.seconds)
        return found

    def _call(self, content: dict[str, Any], tick: int, seconds: float) -> None:
        """Repeats a call and compares its answer."""
        found, name = self.comparison, content["to"]
        found.calls += 1
        if not is_call(self.loop, name):
            raise RunFileError(self.run.path, f"holds the call {name}, which is unknown")
        try:
            answer = repeat(self.loop, name, content["arguments"])
        except SoftRobotTwinError as error:
            # Another scene may not allow a change of a parameter.
            found.refused.append(f"tick {tick} at {seconds:.3f} s: {name}: {error}")
            return
        if _text(answer) != _text(content[ANSWER]):
            found.add(Difference(tick, seconds, f"{ANSWER} of {name}", "", content[ANSWER], answer, np.inf))


def _check_names(run: RunFile, simulation: Simulation) -> None:
    """Refuses a scene with other actuators, effectors or touches: calls name them or count them."""
    has = names_of(simulation)
    for rows in (ACTUATORS, EFFECTORS, TOUCHES):
        recorded, own = run.description.names[rows], has[rows]
        if recorded != own:
            raise RunFileError(
                run.path, f"was recorded with the {rows} {', '.join(recorded) or 'none'}; "
                f"{simulation.scene.path} has {', '.join(own) or 'none'}",
            )  # fmt: skip
