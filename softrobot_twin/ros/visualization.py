"""Markers for RViz and Foxglove: deformed surfaces, cables, cavities, rigid bodies, obstacles,
effectors and targets.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Vector3
from rclpy.node import Node
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.ros.message_bytes import Content, MarkerBytes
from softrobot_twin.ros.topics import TWIN_TOPICS, open_publisher
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation import colours as palette
from softrobot_twin.view.drawing_thread import RateLimit
from softrobot_twin.view.frame import Frame
from softrobot_twin.view.simulation_frames import SimulationFrames

CABLE_WIDTH = 0.006
"""Width of a cable, as a share of the robot's size."""
EFFECTOR_WIDTH = 0.03
"""Diameter of the sphere at an effector, as a share of the robot's size."""
TARGET_WIDTH = 0.04
OBSTACLES_EVERY = 1.0
"""Time from one message with obstacles, which do not move, to the next [s]."""
LEAST_LIFETIME = 3.0
"""Markers vanish after this time without a message [s], or after three messages, if that is
longer."""


# Of markers whose points, or which themselves, have colours that change.
_WHITE = (255, 255, 255)


class _Drawn(NamedTuple):
    """What stays of a marker, and what changes of it."""

    namespace: str
    number: int
    kind: int
    colour: Sequence[int]
    content: Content
    width: float = 1.0
    """Of its lines or spheres [m]."""


class RobotMarkers:
    """Makes messages of markers of a simulation.

    The namespaces are the kinds: ``surfaces``, ``cables``, ``cavities``, ``rigid_bodies``,
    ``obstacles``, ``effectors`` and ``targets``. The id is the place of the body in the scene; all
    cables are one marker, as are all effectors and all targets.

    Args:
        simulation: The simulation.
        frame_id: Frame of all positions.
        lifetime: Time after which a marker vanishes that is not sent again [s].
    """

    def __init__(self, simulation: Simulation, frame_id: str, lifetime: float):
        self._frames, self._frame = SimulationFrames(simulation), frame_id
        self._lifetime = Duration(sec=int(lifetime), nanosec=int(lifetime % 1.0 * NANOSECONDS))
        self._size = simulation.model.nodes.size
        stage = self._frames.stage
        self._rigid = [body.points[body.triangles.ravel()] for body in stage.rigid_bodies]
        self.obstacles = [body.points[body.triangles.ravel()] for body in stage.obstacles]
        # By the markers in a message: which obstacles, targets and shapes there are.
        self._forms: dict[tuple, MarkerBytes] = {}

    def message(
        self, outcome: TickOutcome, stamp: tuple[int, int], with_obstacles: bool
    ) -> bytes:
        """A serialized `visualization_msgs/MarkerArray` of the present state.

        Args:
            outcome: The newest tick.
            stamp: Its seconds and nanoseconds.
            with_obstacles: Whether obstacles are in it, which do not move.
        """
        frame = self._frames.frame(0, 0, outcome.result, **outcome.shown())
        # A body may have nothing to show.
        drawn = [
            _Drawn(namespace, number, kind, colour, content, width)
            for namespace, kind, colour, width, contents in self._kinds(frame, with_obstacles)
            for number, content in enumerate(contents) if len(content.points)
        ]  # fmt: skip
        key = tuple((one.namespace, one.number) for one in drawn)
        if key not in self._forms:
            self._forms[key] = MarkerBytes(
                [self._marker(one) for one in drawn],
                [one.content.colours is not None for one in drawn],
            )  # fmt: skip
        return self._forms[key].message(stamp, [one.content for one in drawn])

    def _kinds(self, frame: Frame, with_obstacles: bool) -> Iterator[tuple]:
        """Namespace, kind, colour, width [m] and contents of the markers of each namespace."""
        stage, size, surface = self._frames.stage, self._size, Marker.TRIANGLE_LIST
        colour = palette.CLEAR_SURFACE_COLOUR if stage.cavities else palette.SURFACE_COLOUR
        yield "surfaces", surface, colour, 1.0, [
            Content(points[body.triangles.ravel()])
            for body, points in zip(stage.bodies, frame.surface_positions, strict=True)
        ]  # fmt: skip
        lines = [np.repeat(path, 2, axis=0)[1:-1] for path in frame.cable_paths]
        colours = palette.tension_colours(frame.cable_tensions, stage.tension_range) / 255.0
        yield "cables", Marker.LINE_LIST, _WHITE, CABLE_WIDTH * size, [Content(
            np.concatenate(lines), np.repeat(colours, [len(line) for line in lines], axis=0)
        )] if lines else []  # fmt: skip
        colours = palette.pressure_colours(frame.cavity_pressures, stage.pressure_range)
        yield "cavities", surface, _WHITE, 1.0, [
            Content(points[cavity.triangles.ravel()], colour=_shares(own))
            for cavity, points, own in zip(
                stage.cavities, frame.cavity_positions, colours, strict=True
            )
        ]  # fmt: skip
        yield "rigid_bodies", surface, palette.RIGID_COLOUR, 1.0, [
            Content(corners, position=position, quaternion=quaternion)
            for corners, position, quaternion in zip(
                self._rigid, frame.rigid_positions, frame.rigid_quaternions, strict=True
            )
        ]  # fmt: skip
        yield ("effectors", Marker.SPHERE_LIST, palette.EFFECTOR_COLOUR, EFFECTOR_WIDTH * size,
               [Content(frame.effector_positions)])  # fmt: skip
        if with_obstacles:
            yield ("obstacles", surface, palette.OBSTACLE_COLOUR, 1.0,
                   map(Content, self.obstacles))  # fmt: skip
        # One that ended vanishes after its lifetime.
        targets = frame.targets[np.isfinite(frame.targets).all(axis=1)]
        yield ("targets", Marker.SPHERE_LIST, palette.TARGET_COLOUR, TARGET_WIDTH * size,
               [Content(targets)])  # fmt: skip

    def _marker(self, drawn: _Drawn) -> Marker:
        """The message of a marker, without points."""
        r, g, b, a = _shares(drawn.colour)
        width = float(drawn.width)
        marker = Marker(
            header=Header(frame_id=self._frame), ns=drawn.namespace, id=drawn.number,
            type=drawn.kind, action=Marker.ADD, scale=Vector3(x=width, y=width, z=width),
            color=ColorRGBA(r=r, g=g, b=b, a=a), lifetime=self._lifetime,
        )  # fmt: skip
        marker.pose.orientation.w = 1.0
        return marker


def _shares(colour: Sequence[int]) -> tuple[float, float, float, float]:
    """A colour of 8 bits, with or without alpha, as numbers from 0 to 1."""
    shares = [float(part) / 255.0 for part in colour]
    return tuple(shares) if len(shares) == 4 else (*shares, 1.0)


class VisualizationOutput:
    """Publishes markers at a limited rate. Nothing is made, nor memory allocated for it, until
    somebody receives them.

    It is called after a tick, in the time that is left until the next.

    Args:
        node: The twin.
        simulation: Its model.
        frame_id: Frame of all positions.
        rate: Messages per second, on average at most [Hz]; 0 publishes none.
    """

    def __init__(self, node: Node, simulation: Simulation, frame_id: str, rate: float):
        self._simulation, self._frame = simulation, frame_id
        self._publisher = open_publisher(node, TWIN_TOPICS["~/visualization"])
        self._rate, self._limit = rate, RateLimit(rate) if rate else None
        self._obstacles_due = -math.inf
        self._count = 0
        self._markers: RobotMarkers | None = None

    def offer(self, outcome: TickOutcome, stamp: int, now: float) -> None:
        """Publishes a tick, if a message is due and somebody receives it.

        Args:
            outcome: The tick.
            stamp: Its time [ns].
            now: Its time on the clock of the ticks [s].
        """
        if self._limit is None or not self._limit.is_due(now):
            return
        self._limit.take(now)
        count = self._publisher.get_subscription_count()
        # Who comes late waits for obstacles no longer than for the rest.
        if count > self._count:
            self._obstacles_due = -math.inf
        self._count = count
        if not count:
            return
        if self._markers is None:
            lifetime = max(LEAST_LIFETIME, 3.0 / self._rate)
            self._markers = RobotMarkers(self._simulation, self._frame, lifetime)
        has_obstacles = now >= self._obstacles_due or self._obstacles_due - now > OBSTACLES_EVERY
        if has_obstacles:
            self._obstacles_due = now + OBSTACLES_EVERY
        self._publisher.publish(
            self._markers.message(outcome, divmod(stamp, NANOSECONDS), has_obstacles)
        )
