"""``python -m softrobot_twin explain --stiffness``: how effectors yield to forces and actuators."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from softrobot_twin.analysis.apparent_compliance import ApparentCompliance, apparent_compliance
from softrobot_twin.harness.equilibrium import bring_to_rest
from softrobot_twin.harness.sampled_axes import column_drives
from softrobot_twin.harness.terminal import console, print_apart, table, terminal_status, warn
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.actuators import Actuators

# Factor and unit in which a motion [m] by one unit of an actuator is shown.
_SHOWN = {
    "m": (1.0, "m/m"), "m3": (1.0e-3, "mm/cm³"), "Pa": (1.0e6, "mm/kPa"),
    "rad": (1.0e3, "mm/rad"), "N": (1.0e3, "mm/N"), "Nm": (1.0e3, "mm/(N m)"),
}  # fmt: skip


# A number that is less than this share of the greatest beside it is shown as zero.
ROUND_OFF = 1.0e-9


def print_stiffness(scene: Path, given: Sequence[str] = ()) -> int:
    """Prints how the effectors of a scene yield to forces, and how its actuators move them.

    Args:
        scene: Scene file.
        given: Actuation in the form ``<column>=<value>``, with the columns of a commands file, such
            as ``north_shortening_m=0.01``; what is not named stays at rest.

    Returns:
        Exit code: 1 where the robot does not come to rest.

    Raises:
        SoftRobotTwinError: The scene cannot be used, or the actuation does not fit it.
    """
    with terminal_status("building the scene"):
        simulation = Simulation.from_scene_file(scene)
    drives = actuation(simulation, given)
    output = console()
    if not simulation.effector_names:
        warn(f"{scene}: there are no effectors, whose stiffness could be told")
        return 1
    with terminal_status("bringing it to rest"):
        rest = bring_to_rest(simulation, simulation.actuators.setpoints(drives))
    found = apparent_compliance(simulation)
    place = "at " + ", ".join(given) if given else "at rest"
    output.print(f"{simulation.scene.name}: {scene}, {place}: {rest.status}"
                 f"{_touching(simulation, found)}\n")
    print_apart(*tables(simulation, found))
    output.print("Where actuators hold their displacement and contacts their gap. A column of "
                 "the Jacobian is the motion by one actuator, the others held.")
    _warn_of(simulation, found, rest.is_reached)
    return 0 if rest.is_reached else 1


def _touching(simulation: Simulation, found: ApparentCompliance) -> str:
    """How many contacts press, in scenes with contact."""
    if simulation.scene.contact is None:
        return ""
    count = found.contact_count
    return f", {count} contact{'' if count == 1 else 's'} pressing"


def _warn_of(simulation: Simulation, found: ApparentCompliance, is_reached: bool) -> None:
    if not is_reached:
        warn("the robot did not come to rest: these are values on its way")
    for index, name in enumerate(simulation.effector_names):
        least = found.principal_stiffness(index)[0][0]
        if np.isnan(least):
            warn(f"{name}: the stiffness is not defined here, nothing holds the body")
        elif least < 0.0:
            warn(f"{name}: a negative stiffness: the robot is not stable here")


def actuation(simulation: Simulation, given: Sequence[str]) -> np.ndarray:
    """Displacements, or efforts of what is driven by efforts, of an actuation given as text.

    Args:
        simulation: The scene.
        given: See `print_stiffness`.

    Returns:
        See `Actuators.drives`, shape (actuator_count,); zero at rest.

    Raises:
        ActuationError: A column is unknown or twice there, or a value is no finite number.
    """
    drives = simulation.actuators.drives(simulation.rest_setpoints)
    for places, (drive,) in column_drives(simulation, "--at", given):
        drives[places] = drive
    return drives


def tables(simulation: Simulation, found: ApparentCompliance) -> list[Table]:
    """Tables of principal stiffnesses, of compliances, and of the Jacobian of each effector.

    Args:
        simulation: The simulation, at the state that was asked about.
        found: Its compliances there.
    """
    names = simulation.effector_names
    principal = table(
        "Stiffness of the effectors, the softest direction first", "effector", "stiffness [N/m]",
        "direction x", "y", "z",
        rows=([name, f"{stiffness:.4g}", *(f"{round(part, 3) + 0.0:.3f}" for part in direction)]
              for index, name in enumerate(names)
              for stiffness, direction in zip(*found.principal_stiffness(index), strict=True)))
    cells = [_numbers(compliance.ravel()) for compliance in found.compliance]
    made = [principal, *(
        table(f"Compliance of {name}", "motion [m/N]", "by a force along x", "y", "z",
              rows=([axis, *own[3 * row : 3 * row + 3]] for row, axis in enumerate("xyz")))
        for name, own in zip(names, cells, strict=True))]
    if simulation.actuators.count:
        made += [_jacobian(simulation.actuators, found, index, name)
                 for index, name in enumerate(names)]  # fmt: skip
    return made


def _jacobian(actuators: Actuators, found: ApparentCompliance, index: int, name: str) -> Table:
    rows = []
    quantities = actuators.driven_quantities(found.is_by_effort)
    for place, (actuator, quantity) in enumerate(zip(actuators.names, quantities, strict=True)):
        factor, unit = _SHOWN.get(quantity.unit, (1.0, f"m/{quantity.unit}".rstrip("/")))
        motion = factor * found.jacobian[index, :, place]
        rows.append([actuator, quantity.word, *_numbers(motion), unit,
                     _what_it_holds(actuators, found, place)])
    return table(f"Jacobian of {name}: its motion by each actuator", "actuator", "by", "x", "y",
                 "z", "unit", "holds", rows=rows)


def _what_it_holds(actuators: Actuators, found: ApparentCompliance, place: int) -> str:
    kind = actuators.kinds[place]
    if found.is_held[place]:
        return kind.displacement.word
    if found.is_by_effort[place]:
        return kind.effort.word
    return "nothing: no tension" if actuators.one_sided[place] else "nothing"


def _numbers(values: np.ndarray) -> list[str]:
    """Numbers as text; what is round-off beside the greatest of them is zero."""
    greatest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    return [f"{value + 0.0:.4g}" for value in np.where(
        np.abs(values) < ROUND_OFF * greatest, 0.0, values)]  # fmt: skip
