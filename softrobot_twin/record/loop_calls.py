"""All calls by which anything reaches a loop from outside, and their arguments as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.loop_settings import settings_of
from softrobot_twin.control.twin_loop import TwinLoop, all_calls, owner_of
from softrobot_twin.record.run_values import number, numbers, plain


def _arrival(value: list) -> Arrival:
    frame_id, stamp, ros_time, time = value
    return Arrival(frame_id, stamp, ros_time, number(time))


READERS: dict[str, Callable] = {
    "key": lambda value: value, "number": number, "numbers": numbers, "arrival": _arrival,
    "settings": settings_of, "ids": lambda value: np.array(value, dtype=np.uint32),
    # An empty list has no second dimension.
    "points": lambda value: numbers(value) if value else np.empty((0, 3)),
}  # fmt: skip
"""How each kind of argument of a call is read from JSON."""


def call_to_json(name: str, arguments: tuple, answer: object) -> dict[str, object]:
    """A call as JSON.

    Args:
        name: One of `all_calls`.
        arguments: What was given.
        answer: What the loop returned: the reason of a refusal, or what a service answers.
    """
    return {"to": name, "arguments": plain(arguments), "answer": plain(answer)}


def repeat(loop: TwinLoop, name: str, arguments: Iterable) -> object:
    """Makes a recorded call.

    Args:
        loop: The loop.
        name: One of `all_calls`.
        arguments: Its arguments as JSON.

    Returns:
        Its answer as JSON.

    Raises:
        KeyError: There is no such call.
        ValueError: The arguments do not fit.
    """
    owner, method = owner_of(loop, name)
    if owner is None:  # The scene is another one, which does not have what the call is about.
        return plain(Refusal.WRONG_NAMES)
    kinds = all_calls()[name].split()
    read = [READERS[kind](one) for kind, one in zip(kinds, arguments, strict=True)]
    return plain(getattr(owner, method)(*read))
