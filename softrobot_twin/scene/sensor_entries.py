"""Entries of sensors: what strings, bend sensors, encoders, and gauges of volume and pressure measure.

Each kind is a key of which an entry has exactly one; `simulation/building/sensor_kinds.py` builds it.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from softrobot_twin.scene.actuator_entries import CavityWall
from softrobot_twin.scene.entry import Direction, Name, NamedEntry, Vector, not_zero, refusal, unit


class Sensor(NamedEntry):
    """What is reported, measured, or wanted beside places."""

    told: ClassVar[tuple[str, ...]] = (
        "string of {string:#point}", "path of {cable}", "bend of {bend:#point}",
        "hinge of {hinge}", "volume of {volume}", "volume in {walls:#wall}",
        "pressure of {pressure}", "force of {spring}", "contact of {contact}", "weight {weight:=}", "noise {noise}",
    )  # fmt: skip
    placed: ClassVar[dict[str, str]] = {"string": "point", "pull_point": "point", "bend": "point", "axis": "direction"}
    one_of: ClassVar[tuple[str, ...]] = ("string", "cable", "bend", "hinge", "volume", "walls", "pressure", "spring", "contact")

    on: Name | None = None
    """Body of the points of a string or of a bend sensor."""
    string: Annotated[tuple[Vector, ...], Field(min_length=1)] | None = None
    """A thin string through these places: its length [m]."""
    pull_point: Vector | None = None
    """Where a string begins in the world."""
    cable: Name | None = None
    """A cable: the length of its path [m]."""
    bend: Annotated[tuple[Vector, ...], Field(min_length=3)] | None = None
    """Places along a line: the angle [rad] from its first to its last piece about `axis`."""
    axis: Annotated[Direction | None, not_zero("the axis of an angle must not be zero")] = None
    """Axis in the world that a bend sensor turns about."""
    hinge: Name | None = None
    """A beam with a hinge: its angle [rad], 0 at rest."""
    at: Literal["start", "end"] | Annotated[int, Field(ge=0)] | None = None
    """The point with the hinge."""
    volume: Name | None = None
    """A cavity, inflated or sealed: its volume [m³]."""
    walls: Annotated[tuple[CavityWall, ...], Field(min_length=1)] | None = None
    """Closed surfaces of another chamber: the volume inside [m³]."""
    pressure: Name | None = None
    """A sealed cavity: its gauge pressure [Pa]."""
    spring: Name | None = None
    """A spring: its force [N], positive where it pulls."""
    contact: tuple[Name, Name] | None = None
    """A pair of `contact`: its normal force [N]."""
    full_scale: Annotated[float | None, unit("N", gt=0.0)] = None
    """Force that counts as the robot's size."""
    weight: Annotated[float | None, unit("", gt=0.0)] = None
    """Weight as a target; by default none."""

    noise: Annotated[float | None, unit("m, rad, m³, Pa or N", gt=0.0)] = None
    """Standard deviation; by default 0.2 % of the robot's size, as targets count."""

    def check(self) -> None:
        """Refuse an axis or a point where none is needed, and none where one is."""
        for key, other in (("axis", "bend"), ("at", "hinge"), ("full_scale", "contact")):
            if (getattr(self, key) is None) != (getattr(self, other) is None):
                raise refusal(key, getattr(self, key), f"goes with {other}: give both or neither")
        if self.on is not None and self.string is None and self.bend is None:
            raise refusal("on", self.on, "is the body of a string or of a bend sensor")
        if self.pull_point is not None and self.string is None:
            raise refusal("pull_point", list(self.pull_point), "is where a string begins")
        if self.string is not None and len(self.string) < 2 and self.pull_point is None:
            raise refusal("string", self.string, "needs two places, or a pull_point before one")
