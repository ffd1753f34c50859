"""Names of the columns of all CSV files: of targets and commands, and of what runs write.

One name for one quantity, wherever it stands: ``<name>_<quantity>_<unit>`` in SI units, such as
``tip_x_m``, ``north_length_m`` and ``air_pressure_Pa``; m3 stands for cubic metres, Nm for newton
metres, and a part of a quaternion has no unit. So what a run writes can be given back as input.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

TIME = "time_s"
STEP = "step"
STATUS = "status"
DRIVEN_BY = "driven_by"
"""Column that tells what drove a step: ``targets``, ``setpoints``, ``efforts`` or ``hold``."""

AXES = ("x", "y", "z")
_TURN = ("qx", "qy", "qz", "qw")

UNITS = ("m_per_s2", "N_per_m", "m_per_N", "m3", "Nm", "Pa", "rad", "m", "N", "J", "s")
"""Ends of columns that are units; an end that holds another one comes before it."""


def _columns(form: str, parts: Sequence[str] = AXES) -> Callable[[str], tuple[str, ...]]:
    """The function from the name of something to the columns of its parts."""
    return lambda name: tuple(form.format(name, part) for part in parts)


position_columns = _columns("{}_{}_m")
"""Columns of the place of an effector or a body [m], such as ``tip_x_m``."""
quaternion_columns = _columns("{}_{}", _TURN)
"""Columns of the turn of an effector or a body (x, y, z, w), such as ``tip_qx``."""
stiffness_columns = _columns("{}_k{}_N_per_m")
"""Columns of the stiffness of an effector [N/m], such as ``tip_kx_N_per_m``."""
force_columns = _columns("{}_force_{}_N")
"""Columns of the force of a touch [N], such as ``finger_force_x_N``."""
force_deviation_columns = _columns("{}_force_deviation_{}_N")
"""Columns of the standard deviation of an observed force [N], such as ``tip_force_deviation_x_N``."""
torque_columns = _columns("{}_torque_{}_N_m")
"""Columns of an observed torque [N m], such as ``cube_torque_x_N_m``."""
base_load_columns = _columns("{}_load_{}_m_per_s2")
"""Columns of what a mass at the origin of a moving base feels [m/s²], such as ``base_load_x_m_per_s2``."""
reaction_columns = _columns("{}_reaction_{}_N")
"""Columns of a reaction force [N], such as ``base_reaction_x_N``."""
reaction_torque_columns = _columns("{}_reaction_torque_{}_Nm")
"""Columns of a reaction torque [N m], such as ``base_reaction_torque_x_Nm``."""
place_columns = _columns("{}_place_{}_m")
"""Columns of where an observed force acts [m], such as ``tip_place_x_m``."""
displacement_columns = _columns("{}_displacement_{}_m")
"""Columns of the displacement of a touch [m], such as ``finger_displacement_x_m``."""


def target_name(name: str) -> str:
    """Name under which the targets of an effector stand beside its place in what a run writes.

    Args:
        name: Name of the effector.
    """
    return f"{name}_target"


def target_column(name: str, own: str) -> str:
    """Column of the target of a sensor beside what it shows, such as ``spine_target_length_m``.

    Args:
        name: Name of the sensor.
        own: Column of what it shows.
    """
    return target_name(name) + own.removeprefix(name)


def holds_column(name: str) -> str:
    """Column of what a grip is told, and does: 1 to hold and 0 to let go, such as ``cup_holds``.

    Args:
        name: Name of the grip.
    """
    return f"{name}_holds"


def body_name(name: str, effectors: Iterable[str]) -> str:
    """Name of a rigid body in what a run writes; an effector of the same name has its own columns.

    Args:
        name: Name of the body.
        effectors: Names of the effectors.
    """
    return f"{name}_body" if name in effectors else name


def unit_of(column_name: str) -> str:
    """Unit of a column; empty without one.

    Args:
        column_name: Name of the column.
    """
    return next((unit for unit in UNITS if column_name.endswith(f"_{unit}")), "")


def is_output(header: Iterable[str]) -> bool:
    """Whether a file with these columns was written by a run.

    Args:
        header: Names of the columns.
    """
    names = set(header)
    return {STEP, TIME} <= names and bool(names & {STATUS, DRIVEN_BY})
