"""All calls by which anything reaches a loop from outside, and their arguments as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from inspect import signature

import numpy as np

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.loop_settings import settings_of
from softrobot_twin.control.twin_loop import TwinLoop, owner_of
from softrobot_twin.record.run_values import number, numbers, plain


def _arrival(value: list) -> Arrival:
    frame_id, stamp, ros_time, time = value
    return Arrival(frame_id, stamp, ros_time, number(time))


READERS: dict[str, Callable] = {
    "arrival": _arrival, "settings": settings_of,
    "ids": lambda value: np.array(value, dtype=np.uint32),
    # An empty list has no second dimension.
    "positions": lambda value: numbers(value) if value else np.empty((0, 3)),
}  # fmt: skip
"""How arguments of calls are read from JSON, by their names; inputs take other numbers as they are."""


def call_to_json(name: str, arguments: tuple, answer: object) -> dict[str, object]:
    """A call as JSON.

    Args:
        name: One of `TwinLoop.calls`.
        arguments: What was given.
        answer: What the loop returned: the reason of a refusal, or what a service answers.
    """
    return {"to": name, "arguments": plain(arguments), "answer": plain(answer)}


def repeat(loop: TwinLoop, name: str, arguments: Iterable) -> object:
    """Makes a recorded call.

    Args:
        loop: The loop.
        name: One of `TwinLoop.calls`.
        arguments: Its arguments as JSON.

    Returns:
        Its answer as JSON.

    Raises:
        ValueError: The arguments do not fit.
    """
    owner, method = owner_of(loop, name)
    if owner is None:  # The scene is another one, which does not have what the call is about.
        return plain(Refusal.WRONG_NAMES)
    call = getattr(owner, method)
    named = zip(signature(call).parameters, arguments, strict=True)
    return plain(call(*(READERS[name](one) if name in READERS else one for name, one in named)))
