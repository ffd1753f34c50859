"""Input of viewers: a stage, which never changes, and one frame per tick, both lists of what to draw.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError


class ViewError(SoftRobotTwinError):
    """A view cannot be opened.

    Attributes:
        key: Name of the argument, such as ``port``.
        value: Its value.
        reason: What is wrong, in one sentence.
    """

    def __init__(self, key: str, value: object, reason: str):
        self.key, self.value, self.reason = key, value, reason
        super().__init__(f"view: {key} = {value!r}: {reason}")


@dataclass(frozen=True)
class Entity:
    """One thing in space: what never changes of it.

    Attributes:
        path: Its path, such as ``/robot/surface/body``.
        shape: ``surface`` of triangles whose points move, ``solid`` of triangles that moves as a
            whole or stands still, ``points``, ``lines``, ``arrows``, or ``trail``: points whose
            recent path is drawn.
        colour: sRGB, 8 bits each, with or without alpha; None where values give it.
        size: Radius of points, lines and arrows [points of the screen].
        labels: Name of each point or line, or those of a surface or solid.
        may_miss: Whether points of a frame may be NaN, and are not drawn then.
        triangles: Of a surface or solid: indices of points, shape (triangle_count, 3).
        points: Points that do not change [m], shape (point_count, 3): of a solid in its own
            coordinates.
        colours_of: Colours of the values in a frame, shape (value_count, 3 or 4).
        kind: What it shows, such as ``cable``; pictures and markers choose their look by it.
        noun: What each of its labels names, such as ``rigid body``; empty where none is told.
        anchors: Of a surface: the point at which each label stands, shape (label_count,).
    """

    path: str
    shape: Literal["surface", "solid", "points", "lines", "arrows", "trail"]
    colour: Sequence[int] | None = None
    size: float = 1.0
    labels: Sequence[str] = ()
    may_miss: bool = False
    triangles: np.ndarray = field(default_factory=lambda: np.empty((0, 3), int))
    points: np.ndarray | None = None
    colours_of: Callable[[np.ndarray], np.ndarray] | None = None
    kind: str = ""
    noun: str = ""
    anchors: Sequence[int] = ()


class Drawn(NamedTuple):
    """What a frame has of an entity.

    Attributes:
        points: Positions [m], shape (point_count, 3); of lines an array for each line; of a solid
            the place of its origin, shape (3,).
        vectors: Of arrows [m], shape (point_count, 3); of a solid its rotation (x, y, z, w).
        values: Numbers that give colours, one for each line or arrow, or one for a surface.
    """

    points: np.ndarray | Sequence[np.ndarray]
    vectors: np.ndarray | None = None
    values: np.ndarray | None = None


class Plot(NamedTuple):
    """Curves that share a plot: its title with the unit, its path, and the names of its curves."""

    title: str
    path: str
    names: Sequence[str]


@dataclass(frozen=True)
class Stage:
    """The constant part of a view.

    Attributes:
        name: Robot name.
        title: Title of the view of space.
        entities: What is drawn in space.
        plots: What is drawn as curves.
    """

    name: str
    title: str
    entities: tuple[Entity, ...]
    plots: tuple[Plot, ...]


@dataclass(frozen=True)
class Frame:
    """One tick to show. The frame keeps its arrays, so the caller must pass copies.

    Attributes:
        step: Count of steps since the start.
        time_ns: Time of the tick [ns].
        drawn: What it has of entities, by their paths; others stand as they were.
        curves: Values of the curves of each plot, by its path.
        times: Time of the whole step and of each stage [s].
        status: The step's status as text.
    """

    step: int
    time_ns: int
    drawn: Mapping[str, Drawn]
    curves: Mapping[str, Sequence[float] | np.ndarray]
    times: Mapping[str, float]
    status: str
