"""Changes of scenes, their files and simulations, and many steps of one command, said in a line."""

import copy
from collections.abc import Callable

import numpy as np
import yaml

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import CommandSetpoints, Simulation, Status

LEFT_OUT = object()
"""In a change, in place of an entry: the scene is without it."""


def change_scene(mapping: dict, *changes) -> None:
    """Changes a scene.

    Args:
        mapping: The scene as a mapping; is changed.
        changes: Each a function of the mapping, or entries by their paths, such as
            `{"cables.0.tension": [0.0, 5.0]}`; a star stands for all entries of a list. None
            changes nothing.
    """
    for change in changes:
        if change is None:
            continue
        if callable(change):
            change(mapping)
            continue
        for path, entry in change.items():
            set_entry(mapping, path.split("."), entry)


def set_entry(place, path: list[str], entry) -> None:
    """Puts a copy of an entry at a path; rooms on the way that are not there are made."""
    key, *rest = path
    if key == "*":
        for each in place:
            set_entry(each, rest, entry)
        return
    if isinstance(place, list):
        key = int(key)
    if rest:
        inner = place.setdefault(key, {}) if isinstance(place, dict) else place[key]
        set_entry(inner, rest, entry)
    elif entry is LEFT_OUT:
        del place[key]
    else:
        place[key] = copy.deepcopy(entry)


def changed(*changes) -> Callable[[dict], None]:
    """The changes as one function of a scene; see `change_scene`."""
    return lambda mapping: change_scene(mapping, *changes)


def entries_of(file, *changes) -> dict:
    """The entries of a scene file, its copies written out, with changes; see `change_scene`."""
    entries = written_out(yaml.safe_load(file.read_text()))
    change_scene(entries, *changes)
    return entries


def built(mapping: dict, *changes, path=None) -> Simulation:
    """The simulation of a scene, perhaps beside a file, with changes; see `change_scene`."""
    change_scene(mapping, *changes)
    return Simulation(scene_from_mapping(mapping, path))


def hold(simulation, *setpoints):
    """The result of a step to setpoints in the unit of each actuator, without limits of time."""
    return solved(simulation, CommandSetpoints(np.array(setpoints, float), 1.0))


def yaml_file(path, entries: dict):
    """Writes entries to a file; returns its path."""
    path.write_text(yaml.safe_dump(entries, sort_keys=False))
    return path


def repeat_step(simulation, command, count: int, **options):
    """The result of the last of equal steps."""
    for _ in range(count):
        result = simulation.step(command, **options)
    return result


def solved(simulation, command, count: int = 1, **options):
    """The result of the last of equal steps, which is solved; see `repeat_step`."""
    result = repeat_step(simulation, command, count, **options)
    assert result.status is Status.OK
    return result


def in_balance(simulation, command, most: int, is_there=lambda result: result.status is Status.OK):
    """The result of the first of equal steps that is in balance, of so many at most."""
    for _ in range(most):
        result = simulation.step(command)
        if is_there(result):
            return result
    raise AssertionError(f"{result.status} after {most} steps")
