"""Motors that turn hinges as actuators: by angle, or by torque."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.constraints.hinge_angle import HingeAngles, YieldingHingeAngles
from softrobot_twin.scene.actuator_entries import HingeMotor
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
    numbers_of,
)
from softrobot_twin.simulation.building.beam_bodies import BeamBody
from softrobot_twin.simulation.building.limits import unlikely
from softrobot_twin.simulation.building.scene_layout import Layout

# Limits outside these shares of their natural scales are reported: degrees are a factor of 57, and
# N mm one of 1000.
RATE_RANGE = (5.0e-3, 50.0)
"""Of one radian in a second."""
TORQUE_RANGE = (1.0e-3, 1.0e3)
"""Of the torque that bends the beam at the hinge to a radian over its length."""


class HingeMotorActuator(ActuatorKind):
    """The kind `hinge_motors`; see `ActuatorKind`."""

    section = "hinge_motors"
    entry = HingeMotor
    setpoint = Quantity("angle", "rad")
    displacement = Quantity("angle", "rad")
    effort = Quantity("torque", "Nm")
    stalls = True

    def build(self, layout: Layout, entries: tuple[HingeMotor, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`."""
        hinges = [hinge_of(layout, motor.beam, motor.at, motor.name, f"hinge_motors[{index}]")
                  for index, motor in enumerate(entries)]  # fmt: skip
        _check_driven_once(layout, entries, hinges)
        ranges = numbers_of(entries, "angle")
        bending = [_bending(layout.body_named(motor.beam)) for motor in entries]
        yielding = numbers_of(entries, "stiffness")
        term = (HingeAngles(layout.hinged, hinges, ranges, bending) if np.isinf(yielding).all()
                else YieldingHingeAngles(layout.hinged, hinges, ranges, bending, yielding))  # fmt: skip
        radii = layout.hinged.hinges.radii[term.hinges]
        return group_of(self, entries, term, term.scales, numbers_of(entries, "torque"), 1.0 / radii,
                        rest_setpoints=numbers_of(entries, "offset"), displacement_bounds=ranges)  # fmt: skip

    def doubts(self, model, group: ActuatorGroup) -> Iterator[str]:
        """Limits that are out of scale; see `ActuatorKind.doubts`."""
        beams = {beam.name: beam for beam in model.beams}
        for key, motor in model.scene.keyed("hinge_motors"):
            beam = beams[motor.beam]
            yield from unlikely(f"{key}.rate", motor.rate or 0.0, "rad/s", 1.0, RATE_RANGE,
                                "is the rate in radians per second?")  # fmt: skip
            bending = _bending(beam)
            yield from unlikely(
                f"{key}.torque", max(map(abs, motor.torque)), "N m", bending, TORQUE_RANGE,
                f"some {bending:.2g} N m would bend {beam.name} by a radian; is the limit in N m?",
            )  # fmt: skip

    def paths(self, group: ActuatorGroup, positions: np.ndarray) -> tuple[np.ndarray, ...]:
        """The axes of the hinges; see `ActuatorKind.paths`."""
        return tuple(group.term.axis_lines(positions))

    def details(self, entry: HingeMotor, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        zero = f", zero error {entry.offset:.6g} rad" if entry.offset else ""
        yields = f", yields, {entry.stiffness:.6g} N m/rad" if entry.stiffness else ""
        return f"turns {entry.beam} at its {entry.at}{zero}{yields}"


def _bending(beam: BeamBody) -> float:
    """Torque that bends a beam by a radian over its length, in its stiffer direction [N m]."""
    inertia = max(beam.section.inertia_y, beam.section.inertia_z)
    return float(beam.entry.material.young_modulus * inertia / beam.lengths.sum())


def hinge_of(layout: Layout, name: str, at: str | int, user: str, key: str) -> int:
    """Index of the hinge at a point of a beam.

    Args:
        layout: The bodies.
        name: Name of the beam.
        at: ``start``, ``end``, or the number of a point of the beam.
        user: Name of what turns or measures the beam there.
        key: Key of its entry.

    Raises:
        SceneError: The beam has no hinge there.
    """
    beam = layout.body_named(name)
    points = len(beam.entry.points)
    if isinstance(at, int) and at >= points:
        raise layout.scene.error(f"{key}.at", at, f"{name} has the points 0 to {points - 1}")
    hinge = int(beam.carriers.hinges[beam.node_at(at)])
    if hinge < 0 or layout.hinged.is_ball[hinge]:
        joint = "is not on a hinge" if hinge < 0 else "is on a ball joint, which has no axis"
        raise layout.scene.error(f"{key}.at", at,
                                 f"{name} {joint} there: {user} turns a beam that is "
                                 "joined by a hinge")
    return hinge


def _check_driven_once(layout: Layout, entries, hinges: list[int]) -> None:
    """Refuse two motors at one hinge."""
    for index, hinge in enumerate(hinges):
        first = hinges.index(hinge)
        if first != index:
            raise layout.scene.error(f"hinge_motors[{index}].at", entries[index].at,
                                     f"{entries[first].name} turns this hinge already")
