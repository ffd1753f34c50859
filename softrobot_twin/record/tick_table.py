"""Ticks of a run as rows of a CSV file, whose columns are named like those of all files."""

from __future__ import annotations

import math

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.table_columns import (
    STATUS,
    STEP,
    TIME,
    column,
    position_columns,
    quaternion_columns,
    target_name,
)


def header_of(simulation: Simulation) -> list[str]:
    """The names of the columns.

    Args:
        simulation: The model.
    """
    columns = [STEP, TIME, STATUS, "activity"]
    for name, is_oriented in _effectors(simulation):
        columns += position_columns(name)
        columns += quaternion_columns(name) if is_oriented else ()
    for name, is_oriented in _effectors(simulation):
        columns += position_columns(target_name(name))
        columns += quaternion_columns(target_name(name)) if is_oriented else ()
    for name, kind in simulation.actuators.kind_of.items():
        columns += [column(name, quantity) for quantity in _quantities(kind)]
    for name in simulation.guided_names:
        columns += [*position_columns(name), *quaternion_columns(name)]
    columns += [f"{name}_error_m" for name, _ in _effectors(simulation)]
    return [*columns, "residual_N", "linearizations", "compute_time_s"]


def row_of(
    simulation: Simulation, outcome: TickOutcome, step: int, seconds: float
) -> list[object]:
    """The cells of a tick; empty where there is no number.

    Args:
        simulation: The model.
        outcome: What the tick gave.
        step: Ticks before it.
        seconds: Time since the first tick [s].
    """
    result, reading = outcome.result, outcome.reading
    cells: list[object] = []
    for positions, turns in (
        (result.effector_positions, result.effector_orientations),
        (reading.targets, reading.orientations),
    ):
        for index, (_, is_oriented) in enumerate(_effectors(simulation)):
            cells += positions[index].tolist()
            cells += turns[index].tolist() if is_oriented else []
    for index, kind in enumerate(simulation.actuators.kinds):
        values = {kind.displacement: result.displacements[index],
                  kind.effort: result.efforts[index],
                  kind.setpoint: result.setpoints[index]}  # fmt: skip
        cells += [float(values[quantity]) for quantity in _quantities(kind)]
    for name in simulation.guided_names:
        position, quaternion = outcome.guided_poses[name]
        cells += [*position.tolist(), *quaternion.tolist()]
    cells += outcome.tracking_errors.tolist()
    report = result.report
    cells += [report.residual, report.iterations, report.compute_time]
    numbers = ["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in cells]
    return [step, seconds, result.status.value, outcome.activity.value, *numbers]


def _effectors(simulation: Simulation) -> list[tuple[str, bool]]:
    """Name of each effector, and whether it asks for an orientation."""
    return list(zip(simulation.effector_names, simulation.oriented_effectors, strict=True))


def _quantities(kind) -> tuple:
    """What is written of an actuator, each quantity once."""
    return tuple(dict.fromkeys((kind.setpoint, kind.effort, kind.displacement)))
