"""Pressures of cavities in messages of their own, which are absolute; elsewhere they are gauge."""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.control.arrival import Arrival, Input, Refusal, latched
from softrobot_twin.control.inputs import ActuatorInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.errors import ParameterError, SceneError
from softrobot_twin.simulation import Simulation

STANDARD_ATMOSPHERE = 101325.0
"""Mean pressure of the air at sea level [Pa]."""


class CavityPressures:
    """The cavities of a scene, and the conversion of their pressures.

    Args:
        simulation: The model.
        ambient_pressure: Absolute pressure around the robot [Pa].

    Attributes:
        ambient_pressure: The same.
        places: Index of each cavity among the actuators, by its name.
        by_volume: Names of the cavities whose volume is commanded.
        sealed_names: Names of the sealed cavities, which have no valve.
        notes: Warnings.

    Raises:
        ParameterError: The ambient pressure is not a pressure, or a limit of the scene allows less
            than a vacuum.
        SceneError: A cavity and a sealed cavity have the same name.
    """

    def __init__(self, simulation: Simulation, ambient_pressure: float = STANDARD_ATMOSPHERE):
        if not (math.isfinite(ambient_pressure) and ambient_pressure > 0.0):
            raise ParameterError("ambient_pressure", ambient_pressure, "Pa", "must be finite and above zero")
        self.ambient_pressure = ambient_pressure
        kinds = enumerate(simulation.actuators.kind_of.items())
        cavities = [(i, name, kind) for i, (name, kind) in kinds if kind.effort.word == "pressure"]
        self.places = {name: index for index, name, _ in cavities}
        self.by_volume = frozenset(name for _, name, kind in cavities if not kind.is_effort_driven)
        self._gas = next((f for f in simulation.model.forces if f.name == "sealed_gas"), None)
        self._find_sealed(simulation.scene)
        for name, index in self.places.items():
            least = float(simulation.limits.effort_min[index])
            if least < -ambient_pressure:
                raise ParameterError(
                    "ambient_pressure", ambient_pressure, "Pa",
                    f"cavity {name} may be evacuated to {least:g} Pa gauge, which is below vacuum; "
                    "set its limit `pressure` in the scene",
                )  # fmt: skip

    def _find_sealed(self, scene) -> None:
        entries, notes = scene.sealed_cavities, []
        self.sealed_names = tuple(entry.name for entry in entries)
        self._around_sealed = np.array([entry.ambient_pressure for entry in entries])
        for index, entry in enumerate(entries):
            key = f"sealed_cavities[{index}]"
            if entry.name in self.places:
                raise SceneError(
                    scene.path, f"{key}.name", entry.name, "",
                    "is a cavity's name too: their pressures have one topic",
                )  # fmt: skip
            if entry.ambient_pressure != self.ambient_pressure:
                notes.append(
                    f"{key}.ambient_pressure = {entry.ambient_pressure:g} Pa is not the "
                    f"ambient_pressure of the twin, {self.ambient_pressure:g} Pa"
                )
        self.notes = tuple(notes)

    def sealed(self, positions: np.ndarray) -> dict[str, float]:
        """Absolute pressure of the gas in each sealed cavity [Pa], by its name.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        if self._gas is None:
            return {}
        pressures = self._gas.pressures(positions) + self._around_sealed
        return dict(zip(self.sealed_names, pressures.tolist(), strict=True))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cavities."""
        return tuple(self.places)

    def absolute(self, efforts: np.ndarray) -> dict[str, float]:
        """Absolute pressure of each cavity in messages [Pa], by its name.

        Args:
            efforts: Efforts of all actuators as they are told, those of cavities gauge pressures
                [Pa], shape (actuator_count,).
        """
        return {
            name: self.ambient_pressure + float(efforts[index])
            for name, index in self.places.items()
        }


class PressureInput(Input):
    """Absolute pressures of single cavities, as commands or as measurements.

    A message concerns one cavity; everything else stays as it is. A command in another frame than
    that of the positions is refused; messages without a frame are accepted, because a pressure has
    none. The frame of a measurement names its sensor and is not checked.

    Args:
        cavities: The cavities.
        keeper: Keeps their pressures beside the values of the other actuators, and counts the
            refusals.
        frame_id: The only accepted frame, or None where it is not checked.
        settings: Timeouts.
        are_measured: Whether they are measurements, which are kept as efforts too, also of cavities
            whose volume is commanded.
    """

    def __init__(
        self, cavities: CavityPressures, keeper: ActuatorInput, frame_id: str | None,
        settings: LoopSettings, are_measured: bool,
    ):
        self._cavities, self._keeper, self._frame_id = cavities, keeper, frame_id
        self._are_measured = are_measured
        super().__init__(settings, frame_id, cavities.names, keeper.refusals)

    def accept(self, name: str, pressure: float, arrival: Arrival) -> Refusal | None:
        """Checks one message and keeps its pressure.

        Args:
            name: A cavity.
            pressure: Its absolute pressure [Pa].
            arrival: Header and time of arrival of the message.

        Returns:
            The reason to refuse it, or None.
        """
        if self._frame_id is not None and not arrival.frame_id:
            arrival = arrival._replace(frame_id=self._frame_id)
        return self._put(name, pressure, arrival)

    @latched
    def _put(self, name: str, pressure: float, arrival: Arrival) -> Refusal | None:
        """Passes a pressure on to the keeper; the reason to refuse it, or None."""
        is_effort = name in self._cavities.by_volume
        if is_effort and not self._are_measured:
            return Refusal.VOLUME_CONTROLLED
        if not math.isfinite(pressure):
            return Refusal.NOT_FINITE
        if pressure <= 0.0:
            return Refusal.BELOW_VACUUM
        place = np.array([self._cavities.places[name]])
        gauge = pressure - self._cavities.ambient_pressure
        refusal = None if is_effort else self._keeper.put(place, gauge, arrival.time)
        if refusal is None and self._are_measured:
            self._keeper.put_efforts(place, gauge)
        return refusal
