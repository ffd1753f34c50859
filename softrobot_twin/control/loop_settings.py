"""What drives the loop, its limits, gains and timeouts, and whether a scene allows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.command import DEFAULT_TIME_STEP
from softrobot_twin.simulation.step.inverse_choice import why_not_followed


class Mode(Enum):
    """What drives the twin."""

    INVERSE = "inverse"
    """Targets of the effectors; selected actuators may be commanded at the same time."""
    DIRECT = "direct"
    """Setpoints or efforts of the actuators."""


class WhenLost(Enum):
    """What to do without a measurement that the loop needs."""

    OPEN_LOOP = "open_loop"
    """Continue with the model alone."""
    HOLD = "hold"
    """Keep every actuator where it is."""


def setting(meaning: str, default: Any = MISSING, unit: str = "", least: float | None = None,
            most: float | None = None) -> Any:
    """A field of settings, of which a node makes a parameter.

    Args:
        meaning: What it is, in one sentence.
        default: Its default; none by default.
        unit: Its unit.
        least: Least value of the parameter. Settings themselves may have any finite value that is not
            negative, or above zero where this is; None for what is no number.
        most: Greatest value of the parameter.
    """
    return field(default=default, metadata={"meaning": meaning, "unit": unit, "least": least, "most": most})


def check_numbers(settings: Any, prefix: str = "") -> None:
    """Checks the numbers among the fields that `setting` made.

    Args:
        settings: A dataclass.
        prefix: Begin of the names of their parameters.

    Raises:
        ParameterError: One of them is out of its range.
    """
    for one in fields(settings):
        if one.metadata.get("least") is not None:
            value, above_zero = getattr(settings, one.name), one.metadata["least"] > 0.0
            if not math.isfinite(value) or value < 0.0 or (above_zero and value == 0.0):
                reason = f"must be finite and {'above zero' if above_zero else 'not negative'}"
                raise ParameterError(prefix + one.name, value, one.metadata["unit"], reason)


@dataclass(frozen=True)
class LoopSettings:
    """Limits, gains and timeouts of the loop. They may change while it runs.

    Attributes:
        rate: Ticks per second [Hz].
        deadline: Time that a step may take [s]. Remaining time is used for more linearizations;
            where a new factorization would be late, the step uses the previous one. At most the
            period: a longer one would use the time of later ticks. With 0 there is no deadline, and
            the scene sets the number of linearizations.
        message_timeout: Oldest accepted stamp [s]; 0 accepts any age.
        future_tolerance: How far in the future a stamp may be [s].
        target_timeout: Without a target for this time the loop holds [s]; 0 waits without limit.
        velocity_timeout: How long a velocity is valid after its arrival [s].
        speed_limit: Greatest speed of a target that a velocity moves [m/s].
        approach_speed: A far target is approached on a straight line at this speed [m/s]; with 0
            the actuators' rates alone limit the speed, and the path may be curved.
        workspace_min: Lower corner of the box to which targets and poses of guided bodies are
            limited [m].
        workspace_max: Its upper corner [m].
        closed_loop: Correct the targets by the measured markers.
        prediction: Command by prediction where the scene's control law is dynamic; else as if the
            robot stood.
        misfit_rate: Rate at which that correction follows the misfit of the markers [1/s].
        correction_gain: Gain k_i of the integrator that stands in for it where setpoints are not
            measured [1/s].
        correction_limit: Greatest length of the correction, together with what forces of an observer that
            are not certain move an effector [m].
        lead_limit: In closed loop a moving target is aimed at where it will be when the command is
            executed, at most this time ahead [s]; 0 aims at where it is.
        marker_timeout: Markers count as lost after this time without any [s].
        on_lost_markers: What to do then, in closed loop.
        device_timeout: The device counts as lost after this time without its setpoints [s].
        on_lost_device: What to do then.
        touch_timeout: A touch ends after this time without its force or place [s].

    Raises:
        ParameterError: A value is not finite or too small, the deadline is longer than the period,
            or the workspace is empty.
    """

    rate: float = setting("Ticks per second.", 1.0 / DEFAULT_TIME_STEP, "Hz", 0.1, 2000.0)
    deadline: float = setting("Time of a step for further linearizations, at most 1/rate; 0 for the scene's number.",
                              0.0, "s", 0.0, 10.0)
    message_timeout: float = setting(
        "Messages with an older stamp are refused; 0 accepts any age.", 0.5, "s", 0.0, 60.0)
    future_tolerance: float = setting(
        "Messages with a stamp further in the future are refused.", 0.1, "s", 0.0, 60.0)
    target_timeout: float = setting(
        "Time without a target or command until the twin holds; 0 for never.", 0.0, "s", 0.0, 3600.0)
    velocity_timeout: float = setting("A received velocity is used for this time.", 0.6, "s", 0.01, 10.0)
    speed_limit: float = setting("Greatest speed of a target moved by a velocity.", 0.02, "m/s", 1e-6, 10.0)
    approach_speed: float = setting("Speed on a straight line to a far target; 0 for as fast as possible.",
                                    0.0, "m/s", 0.0, 10.0)
    workspace_min: tuple[float, float, float] = setting(
        "Lower corner of the box of targets and poses.", (-1.0, -1.0, -1.0), "m")
    workspace_max: tuple[float, float, float] = setting("Upper corner of that box.", (1.0, 1.0, 1.0), "m")
    closed_loop: bool = setting("Correct the targets by the measured markers.", False)
    prediction: bool = setting("With control law dynamic: command by prediction.", True)
    misfit_rate: float = setting("Rate at which the correction follows the misfit.", 20.0, "1/s", 0.0, 1000.0)
    correction_gain: float = setting("Gain of the integrator, where setpoints are not measured.",
                                     2.0, "1/s", 0.0, 1000.0)
    correction_limit: float = setting("Greatest length of the correction.", 0.01, "m", 0.0, 1.0)
    lead_limit: float = setting(
        "Greatest time by which a moving target is led in closed loop.", 0.15, "s", 0.0, 1.0)
    marker_timeout: float = setting("Time without a message until markers are lost.", 0.5, "s", 0.001, 60.0)
    on_lost_markers: WhenLost = setting(
        "In closed loop: keep the last correction, or hold.", WhenLost.OPEN_LOOP)
    device_timeout: float = setting(
        "Time without measured setpoints until the device is lost.", 0.5, "s", 0.001, 60.0)
    on_lost_device: WhenLost = setting("Continue with the model alone, or hold.", WhenLost.HOLD)
    touch_timeout: float = setting("Time without a message until a touch ends.", 0.2, "s", 0.001, 60.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.deadline > self.period:
            raise ParameterError(
                "deadline", self.deadline, "s",
                f"must not be longer than the period of {self.period:g} s at rate = {self.rate:g} "
                "Hz: steps would take the time of later ticks",
            )  # fmt: skip
        for name in ("workspace_min", "workspace_max"):
            corner = getattr(self, name)
            if len(corner) != 3 or not all(map(math.isfinite, corner)):
                raise ParameterError(name, corner, "m", "must be three finite numbers, x y z")
        for low, high in zip(self.workspace_min, self.workspace_max, strict=True):
            if low > high:
                raise ParameterError(
                    "workspace_min", self.workspace_min, "m",
                    f"must not be above workspace_max = {self.workspace_max}",
                )

    def in_workspace(self, position: np.ndarray) -> np.ndarray:
        """The nearest position inside the workspace [m], shape (3,).

        Args:
            position: The position [m], shape (3,).
        """
        return np.minimum(np.maximum(position, self.workspace_min), self.workspace_max)

    @property
    def budget(self) -> float | None:
        """Time that a step may take [s], or None without a deadline."""
        return self.deadline or None

    @cached_property
    def period(self) -> float:
        """Time from tick to tick [s]."""
        return 1.0 / self.rate

    @cached_property
    def reach(self) -> float:
        """Greatest distance that an effector may be sent in a tick [m].

        It is that of a tick on time, so that a robot may rest where some ticks come late.
        """
        return self.approach_speed * self.period if self.approach_speed > 0.0 else math.inf


SETTING_NAMES = tuple(field.name for field in fields(LoopSettings))


def settings_of(values: Mapping[str, Any]) -> LoopSettings:
    """Settings of plain values, as parameters and files give them.

    Args:
        values: Values by name: words for enumerations, lists for tuples.

    Raises:
        ParameterError: A value cannot be used.
        TypeError: A setting is unknown.
    """
    lost = ("on_lost_markers", "on_lost_device")
    return LoopSettings(**{
        name: WhenLost(value) if name in lost else tuple(value) if isinstance(value, list) else value
        for name, value in values.items()})  # fmt: skip


def check_mode(mode: Mode, simulation: Simulation) -> None:
    """Checks that a scene can be driven in a mode.

    Args:
        mode: The mode.
        simulation: The simulation of the scene.

    Raises:
        ParameterError: The mode is inverse, and the inverse problem cannot include the scene's
            contacts.
    """
    reason = why_not_followed(simulation.model)
    if mode is Mode.INVERSE and simulation.scene.contact is not None and reason:
        raise ParameterError(
            "mode", mode.value, "",
            f"scene {simulation.scene.name}: {reason}; or set mode to {Mode.DIRECT.value}",
        )  # fmt: skip


def check_settings(settings: LoopSettings, simulation: Simulation, mode: Mode) -> None:
    """Checks that a scene allows the settings.

    Args:
        settings: The settings.
        simulation: The model.
        mode: What drives the twin.

    Raises:
        ParameterError: `closed_loop` is true and nothing measures what has targets, or an effector or
            a guided body is outside the workspace at rest: the first command would move it into the
            workspace.
    """
    is_measured = any(len(markers) for markers in simulation.effector_markers)
    is_measured |= any(simulation.wanted_sensors.values())
    if settings.closed_loop and not is_measured:
        raise ParameterError(
            "closed_loop", True, "",
            "no effector of the scene is measured_by a marker, and no sensor has a weight",
        )
    for name, position in _positions_at_rest(simulation, mode).items():
        for corner, outside in (
            ("workspace_min", position < settings.workspace_min),
            ("workspace_max", position > settings.workspace_max),
        ):
            if outside.any():
                coordinates = ", ".join(f"{value:.4g}" for value in position)
                raise ParameterError(
                    corner, getattr(settings, corner), "m",
                    f"{name} is outside the workspace at rest, at ({coordinates}) m",
                )  # fmt: skip


def _positions_at_rest(simulation: Simulation, mode: Mode) -> dict[str, np.ndarray]:
    """Positions at rest of the effectors that follow targets, and of guided bodies [m], by name."""
    model, positions = simulation.model, {}
    if mode is Mode.INVERSE:
        effectors = model.effectors.positions(model.nodes.rest_positions)
        positions = dict(zip(simulation.effector_names, effectors, strict=True))
    guided = simulation.guided_names
    return positions | {part.name: part.origin for part in model.rigid if part.name in guided}
