"""Input of viewers: a stage, which never changes, and one frame per tick, both lists of what to draw.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError


class ViewError(SoftRobotTwinError):
    """A view cannot be opened, or a frame does not fit its stage.

    Attributes:
        key: Name of the argument or field, such as ``port``, or path of the entity.
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

    Raises:
        ViewError: The triangles are not triples of valid indices.
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

    def __post_init__(self) -> None:
        triangles = np.asarray(self.triangles)
        key = f"triangles of {self.path}"
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise ViewError(key, f"{triangles.dtype} array of {triangles.shape}",
                            "must be integers of shape (triangle_count, 3)")
        if triangles.size and triangles.min() < 0:
            raise ViewError(key, int(triangles.min()), "an index is negative")
        if self.points is not None:
            self.check_points(self.points)

    def check_points(self, points: np.ndarray) -> None:
        """Checks that the points include all corners of the triangles.

        Args:
            points: Places [m], shape (n, 3).

        Raises:
            ViewError: There are too few points, or the array is not of shape (n, 3).
        """
        shape, needed = np.shape(points), int(np.max(self.triangles, initial=-1)) + 1
        if len(shape) != 2 or shape[1] != 3 or shape[0] < needed:
            raise ViewError(f"positions of {self.path}", shape, f"its triangles need at least ({needed}, 3)")

    def check(self, drawn: Drawn) -> None:
        """Checks that what a frame has of it can be drawn.

        Args:
            drawn: What the frame has of it.

        Raises:
            ViewError: An array does not have the shape that is required.
        """
        count, vectors = len(self.labels), np.shape(np.asarray(drawn.vectors))
        found: tuple
        wanted: tuple
        if self.shape == "surface":
            self.check_points(np.asarray(drawn.points))
            return
        if self.shape == "lines":
            values = () if drawn.values is None else drawn.values
            count = count or len(drawn.points)
            found = len(drawn.points), count if self.colours_of is None else len(values)
            wanted = count, count
        elif self.shape == "solid":
            found, wanted = (*np.shape(drawn.points), *vectors), (3, 4)
        elif self.shape == "arrows":
            found, wanted = vectors, (len(drawn.points), 3)
        else:
            found, wanted = np.shape(drawn.points), (count or len(drawn.points), 3)
        if found != wanted:
            raise ViewError(self.path, found, f"the stage requires {wanted}")


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
    """The constant part of a view, checked when it is made.

    Attributes:
        name: Robot name.
        title: Title of the view of space.
        entities: What is drawn in space.
        plots: What is drawn as curves.

    Raises:
        ViewError: Two entities or plots have the same path.
    """

    name: str
    title: str
    entities: tuple[Entity, ...]
    plots: tuple[Plot, ...]

    def __post_init__(self) -> None:
        paths = [entity.path for entity in self.entities] + [plot.path for plot in self.plots]
        for path in paths:
            if paths.count(path) > 1:
                raise ViewError(path, paths.count(path), "two things have the same path")


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

    def check_against(self, stage: Stage) -> None:
        """Checks that all arrays agree with the stage.

        Args:
            stage: The stage.

        Raises:
            ViewError: An array does not have the shape that the stage requires.
        """
        entities = {entity.path: entity for entity in stage.entities}
        for path, drawn in self.drawn.items():
            if path not in entities:
                raise ViewError(path, len(drawn.points), "the stage has no such entity")
            entities[path].check(drawn)
        for plot in stage.plots:
            found, wanted = len(self.curves[plot.path]), len(plot.names)
            if found != wanted:
                raise ViewError(plot.path, found, f"the stage requires {wanted}")
