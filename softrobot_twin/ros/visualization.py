"""Markers for RViz and Foxglove: deformed surfaces, cables, cavities, rigid bodies, obstacles,
effectors and targets.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

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
from softrobot_twin.view.drawing_thread import RateLimit
from softrobot_twin.view.frame import Drawn, Entity
from softrobot_twin.view.simulation_frames import SimulationFrames

CABLE_WIDTH = 0.006
"""Width of a cable, as a share of the robot's size."""
EFFECTOR_WIDTH = 0.03
"""Diameter of the sphere at an effector, as a share of the robot's size."""
TARGET_WIDTH, THREAD_WIDTH = 0.04, 0.002
OBSTACLES_EVERY = 1.0
"""Time from one message with obstacles, which do not move, to the next [s]."""
LEAST_LIFETIME = 3.0
"""Markers vanish after this time without a message [s], or after three messages, if that is
longer."""


_KINDS = {
    **dict.fromkeys(("body", "clear body", "beam"), ("surfaces", Marker.TRIANGLE_LIST, 0.0)),
    "cable": ("cables", Marker.LINE_LIST, CABLE_WIDTH),
    "axis": ("motor_axes", Marker.LINE_LIST, CABLE_WIDTH),
    "spring": ("springs", Marker.LINE_LIST, CABLE_WIDTH),
    "thread": ("threads", Marker.LINE_LIST, THREAD_WIDTH),
    "cavity": ("cavities", Marker.TRIANGLE_LIST, 0.0),
    **dict.fromkeys(("free body", "guided body"), ("rigid_bodies", Marker.TRIANGLE_LIST, 0.0)),
    **dict.fromkeys(("obstacle", "plane"), ("obstacles", Marker.TRIANGLE_LIST, 0.0)),
    "effector": ("effectors", Marker.SPHERE_LIST, EFFECTOR_WIDTH),
    "target": ("targets", Marker.SPHERE_LIST, TARGET_WIDTH),
    "touch": ("touches", Marker.SPHERE_LIST, EFFECTOR_WIDTH),
}
"""Namespace, form and width, as a share of the robot's size, of the markers of each kind of entity."""


class RobotMarkers:
    """Makes messages of markers of a simulation.

    The namespaces are the kinds: ``surfaces``, ``cables``, ``motor_axes``, ``springs``,
    ``threads``, ``cavities``, ``rigid_bodies``, ``obstacles``, ``effectors``, ``targets`` and
    ``touches``. The id is the place of the body in the scene; all cables are one marker, as are all
    effectors and all targets.

    Args:
        simulation: The simulation.
        frame_id: Frame of all positions.
        lifetime: Time after which a marker vanishes that is not sent again [s].
    """

    def __init__(self, simulation: Simulation, frame_id: str, lifetime: float):
        self._frames, self._frame = SimulationFrames(simulation), frame_id
        self._lifetime = Duration(sec=int(lifetime), nanosec=int(lifetime % 1.0 * NANOSECONDS))
        self._size = simulation.model.nodes.size
        self.entities = self._frames.stage.entities
        # By the markers in a message: which obstacles, targets and shapes there are.
        self._forms: dict[tuple, MarkerBytes] = {}

    def message(self, outcome: TickOutcome, stamp: tuple[int, int], with_obstacles: bool) -> bytes:
        """A serialized `visualization_msgs/MarkerArray` of the present state.

        Args:
            outcome: The newest tick.
            stamp: Its seconds and nanoseconds.
            with_obstacles: Whether obstacles are in it, which do not move.
        """
        frame = self._frames.frame(0, 0, outcome.result, **outcome.shown())
        contents: dict[tuple[str, int], Content] = {}
        entities: dict[tuple[str, int], Entity] = {}
        numbers: Counter[str] = Counter()
        for entity in self.entities:
            namespace = _KINDS.get(entity.kind, ("",))[0]
            if not namespace or (namespace == "obstacles" and not with_obstacles):
                continue
            key = namespace, numbers[namespace]
            numbers[namespace] += 1
            content = _content(entity, frame.drawn.get(entity.path))
            # A body may have nothing to show; a target that ended vanishes after its lifetime.
            if len(content.points):
                contents[key], entities[key] = content, entity
        form = tuple(contents)
        if form not in self._forms:
            self._forms[form] = MarkerBytes(
                [self._marker(entity, key[1]) for key, entity in entities.items()],
                [content.colours is not None for content in contents.values()],
            )  # fmt: skip
        return self._forms[form].message(stamp, list(contents.values()))

    def _marker(self, entity: Entity, number: int) -> Marker:
        """The message of a marker, without points."""
        namespace, kind, share = _KINDS[entity.kind]
        r, g, b, a = _shares(entity.colour or (255, 255, 255))
        width = float(share * self._size) or 1.0
        marker = Marker(
            header=Header(frame_id=self._frame), ns=namespace, id=number,
            type=kind, action=Marker.ADD, scale=Vector3(x=width, y=width, z=width),
            color=ColorRGBA(r=r, g=g, b=b, a=a), lifetime=self._lifetime,
        )  # fmt: skip
        marker.pose.orientation.w = 1.0
        return marker


def _content(entity: Entity, drawn: Drawn | None) -> Content:
    """What a frame has of an entity, as points of a marker."""
    corners = entity.triangles.ravel()
    if drawn is None or entity.shape == "solid":
        pose = () if drawn is None else (drawn.points, drawn.vectors)
        return Content(entity.points[corners], None, None, *pose)
    colours = entity.colours_of(drawn.values) / 255.0 if entity.colours_of else None
    if entity.shape == "surface":
        return Content(drawn.points[corners], colour=None if colours is None else colours[0])
    if entity.shape == "lines" and isinstance(drawn.points, np.ndarray):  # all of one segment
        return Content(drawn.points.reshape(-1, 3))
    if entity.shape == "lines":
        lines = [np.repeat(path, 2, axis=0)[1:-1] for path in drawn.points]
        counts = [len(line) for line in lines]
        each = None if colours is None else np.repeat(colours, counts, axis=0)
        return Content(np.concatenate(lines), each)
    return Content(drawn.points[np.isfinite(drawn.points).all(axis=1)])


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
        self._of_obstacles = RateLimit(1.0 / OBSTACLES_EVERY)
        self._count = 0
        self._markers: RobotMarkers | None = None

    def offer(self, outcome: TickOutcome, stamp: int, now: float) -> None:
        """Publishes a tick, if a message is due and somebody receives it.

        Args:
            outcome: The tick.
            stamp: Its time [ns].
            now: Its time on the clock of the ticks [s].
        """
        if self._limit is None or not self._limit.passes(now):
            return
        count = self._publisher.get_subscription_count()
        # Who comes late waits for obstacles no longer than for the rest.
        if count > self._count:
            self._of_obstacles = RateLimit(1.0 / OBSTACLES_EVERY)
        self._count = count
        if not count:
            return
        if self._markers is None:
            lifetime = max(LEAST_LIFETIME, 3.0 / self._rate)
            self._markers = RobotMarkers(self._simulation, self._frame, lifetime)
        self._publisher.publish(self._markers.message(
            outcome, divmod(stamp, NANOSECONDS), self._of_obstacles.passes(now)
        ))  # fmt: skip
