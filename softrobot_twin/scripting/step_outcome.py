"""What a step of a robot led to, by the names of the scene."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.scripting.named_commands import unknown
from softrobot_twin.simulation import Command, Simulation, Status, StepReport, StepResult
from softrobot_twin.simulation.appearance import Pose, named_poses
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.tables.column_names import STEP
from softrobot_twin.tables.run_columns import TEXT_COLUMNS, RunColumns

if TYPE_CHECKING:
    from softrobot_twin.simulation.result import ContactForces

# Actuators that a short text names, at most.
_MOST_SHOWN = 4


class Result:
    """The outcome of a step.

    ``result.tip`` is the position of the effector ``tip`` [m], and ``result["north_tension_N"]`` the
    value of any column of a run's table; see `values`.

    Attributes:
        outcome: The same in arrays, as `Simulation.step` returns it.
        is_at_rest: Whether the step moved nothing any more, and its forces are in balance.
    """

    outcome: StepResult
    is_at_rest: bool

    def __init__(
        self, outcome: StepResult, simulation: Simulation, columns: RunColumns,
        command: Command, is_at_rest: bool,
    ):  # fmt: skip
        """Take a step's outcome; what it is asked for later follows from it.

        Args:
            outcome: The outcome in arrays.
            simulation: What stepped.
            columns: Columns of a run of this step.
            command: What was asked.
            is_at_rest: See the attribute.
        """
        self.outcome, self.is_at_rest = outcome, is_at_rest
        self._columns, self._command, self._model = columns, command, simulation.model
        self._effectors, self._touches = simulation.effector_names, simulation.touch_names
        self._efforts = [column(name, kind.effort) for name, kind in simulation.actuators.kind_of.items()]

    def __getstate__(self) -> dict[str, Any]:
        """All numbers, without the simulation that they come from."""
        kept = {**self.__dict__, "values": self.values, "poses": self.poses}
        return {name: value for name, value in kept.items()
                if name not in ("_columns", "_command", "_model")}

    @cached_property
    def poses(self) -> dict[str, Pose]:
        """Pose of each rigid body, by name."""
        return named_poses(self._model, self.outcome.state.positions)

    @property
    def status(self) -> Status:
        """How the step ended."""
        return self.outcome.status

    @property
    def is_success(self) -> bool:
        """Whether the command was carried out; see `Status.is_success`."""
        return self.outcome.status.is_success

    @property
    def report(self) -> StepReport:
        """Times, residuals and active limits of the step."""
        return self.outcome.report

    @property
    def active_limits(self) -> tuple[str, ...]:
        """Names of active limits, such as ``north.shortening_max``."""
        return self.outcome.report.active_limits

    @property
    def time(self) -> float:
        """Time since the robot was at rest [s]."""
        return self.outcome.state.time

    @property
    def positions(self) -> np.ndarray:
        """Node positions [m], shape (node_count, 3); see `Robot.positions`."""
        return self.outcome.state.positions

    @property
    def contacts(self) -> ContactForces | None:
        """Contacts with their points and forces; None if the scene has no contact."""
        return self.outcome.contacts

    @cached_property
    def effectors(self) -> dict[str, np.ndarray]:
        """Position of each effector [m], by name, each of shape (3,)."""
        return dict(zip(self._effectors, self.outcome.effector_positions, strict=True))

    @cached_property
    def errors(self) -> dict[str, float]:
        """Distance of each effector from its target [m], by name; NaN without a target."""
        errors = map(float, self.outcome.effector_errors)
        return dict(zip(self._effectors, errors, strict=True))

    @cached_property
    def orientations(self) -> dict[str, np.ndarray]:
        """Turn from rest (x, y, z, w) of each effector that asks for its orientation, by name."""
        turns = self.outcome.effector_orientations
        if turns is None:
            return {}
        named = zip(self._effectors, turns, strict=True)
        return {name: turn for name, turn in named if np.isfinite(turn).all()}

    @cached_property
    def touches(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Force on the robot [N] and displacement [m] of each touch, by name."""
        touched = self.outcome.touches
        if touched is None:
            return {}
        return {name: (touched.forces[index], touched.displacements[index])
                for index, name in enumerate(self._touches)}

    @cached_property
    def values(self) -> dict[str, float]:
        """All numbers of the step by the columns of a run's table, in their order."""
        row = self._columns.row(0, self.time, self.outcome, self._command)
        cells = zip(self._columns.names, self._columns.cells(row), strict=True)
        return {name: float(cell) for name, cell in cells if name not in (STEP, *TEXT_COLUMNS)}

    def __getitem__(self, column: str) -> float:
        if column not in self.values:
            raise UnknownNameError(column, tuple(self.values))
        return self.values[column]

    def __getattr__(self, name: str) -> np.ndarray:
        # Only names that are no attributes arrive here. Copying asks an object without any.
        if name.startswith("_") or "_effectors" not in self.__dict__:
            raise AttributeError(name)
        if name in self._effectors:
            return self.effectors[name]
        known = ", ".join(self._effectors) or "none"
        raise AttributeError(f"a result has no {name!r}; effectors: {known}; other quantities by "
                             "name, such as result['time_s']")

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._effectors})

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.values)

    def __repr__(self) -> str:
        parts = [self.status.value]
        for name, position in self.effectors.items():
            place = ", ".join(f"{1e3 * x:.4g}" for x in position)
            error = self.errors[name]
            missed = f" ({1e3 * error:.2g} mm from its target)" if np.isfinite(error) else ""
            parts.append(f"{name} at [{place}] mm{missed}")
        shown = [f"{name} {self.values[name]:.4g}" for name in self._efforts]
        if len(shown) > _MOST_SHOWN:
            shown = [*shown[:_MOST_SHOWN], f"and {len(shown) - _MOST_SHOWN} more"]
        parts += shown
        if self.active_limits:
            parts.append(f"at {', '.join(self.active_limits[:_MOST_SHOWN])}")
        return f"<Result {'; '.join(parts)}>"


class UnknownNameError(CommandError, KeyError):
    """A result has no such quantity.

    Attributes:
        name: What was asked for.
        reason: What there is.
    """

    def __init__(self, name: str, known: tuple[str, ...]):
        CommandError.__init__(self, name, unknown(name, "columns:", known).reason)

    __str__ = Exception.__str__


