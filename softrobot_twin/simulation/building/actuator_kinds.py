"""The protocol of a kind of actuator, and the registered kinds.

An actuator a has a displacement δ_a against rest and an effort λ_a, whose product is work: the
shortening [m] and the tension [N] of a cable, the change of volume [m³] and the pressure [Pa] of a
cavity. A kind makes rows of H from its entries in a scene (Coevoet 2017, eq. 2), and gives the
names and units of its quantities in limits, files and messages. All other parts of the package use
actuators, not cables.

A new kind is one class with the members of `ActuatorKind`, and one call of `register_actuator`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.scene.actuator_entries import ActuatorEntry
from softrobot_twin.scene.schema import add_actuator_section
from softrobot_twin.simulation.building.scene_layout import Layout


class Quantity(NamedTuple):
    """A quantity of an actuator, with its name and unit.

    Attributes:
        word: Name in limits and columns of files, such as ``tension``.
        unit: Its SI unit, such as ``N``; in columns of files ``m3`` stands for cubic metres, ``Nm``
            for newton metres.
    """

    word: str
    unit: str


def column(name: str, quantity: Quantity) -> str:
    """Column of a quantity of an actuator or pulley, such as ``north_length_m``.

    Args:
        name: Name of the actuator or pulley.
        quantity: The quantity, with its word and unit.
    """
    return f"{name}_{quantity.word}_{quantity.unit}".removesuffix("_")


@dataclass
class ActuatorGroup:
    """The actuators of one kind in a scene. `group_of` makes one, and fills in what is usual.

    Attributes:
        kind: Their kind.
        names: Their names, shape (count,).
        term: Constraint term with one row for each of them, in the group ``actuators``; it has
            `stencils` and `bind` like a force term, for its geometric stiffness. None for
            actuators without multipliers, see `moves`.
        moves: Object that prescribes displacements in place of rows, as for slides; else None.
        rest_setpoints: Setpoints at rest [setpoint unit], with the zero error of what is commanded
            by them, shape (count,).
        displacement_scale: A large displacement, such as the length of a cable at rest
            [displacement unit], shape (count,).
        displacement_bounds: Least and greatest displacement [displacement unit], shape (count, 2).
        rates: Greatest change of the setpoint in a second, infinite without a limit,
            shape (count,).
        effort_bounds: Least and greatest effort [effort unit], shape (count, 2).
        force_per_effort: Force on the bodies by one unit of effort, in sum over all nodes: 1 for a
            tension, an area for a pressure [N per effort unit], shape (count,).
        kinds: Kind of each actuator, where they are driven in different ways; by default `kind`.
        flows: Greatest change of the displacement in a second of effort-driven actuators, infinite
            without a limit, shape (count,); by default without limits.
        rest_extents: Extents at rest [displacement unit], shape (count,); by default the setpoints
            at rest.
        limit_names: Names of the least and the greatest displacement of each in reports, such as
            ``shortening_min`` and ``angle_max``, shape (count, 2); by default those of the kind.
        effort_zeros: What is told of an effort of 0 [effort unit], shape (count,); by default 0. Of
            what is effort-driven it is the setpoint at rest.
        effort_gains: Effort by what is told of it, less the zero, shape (count,); by default 1.
        has_rest_efforts: Whether the zeros are efforts at rest, such as moduli, and not errors of
            sensors.
        entries: Entry of each, where an entry is several actuators; by default one after the other.
    """

    kind: ActuatorKind
    names: tuple[str, ...]
    term: object | None
    moves: object | None
    rest_setpoints: np.ndarray
    displacement_scale: np.ndarray
    displacement_bounds: np.ndarray
    rates: np.ndarray
    effort_bounds: np.ndarray
    force_per_effort: np.ndarray
    kinds: tuple[ActuatorKind, ...]
    flows: np.ndarray
    rest_extents: np.ndarray
    limit_names: tuple[tuple[str, str], ...]
    effort_zeros: np.ndarray
    effort_gains: np.ndarray
    entries: tuple[ActuatorEntry, ...] = ()
    has_rest_efforts: bool = False


class ActuatorKind(Protocol):
    """One kind of actuator; a class that derives from it takes what is usual.

    Attributes:
        section: Key of its entries in a scene, such as ``cables``.
        entry: Type of each entry.
        setpoint: Commanded quantity, an absolute value.
        displacement: Its difference from rest, positive in the direction in which the effort
            does work.
        effort: λ_a.
        sign: 1 where the setpoint grows with the displacement, -1 where it shrinks: the length of
            a cable is less the more it is shortened.
        one_sided: Whether its effort has one sign only: a cable cannot push. It then holds the
            displacement from below, 0 ≤ λ ⊥ δ - δ_set ≥ 0; else δ = δ_set.
        takes_efforts: Whether it can be commanded by an effort.
        is_effort_driven: Whether its setpoint is an effort, as where a regulator holds the pressure
            of a cavity; else the setpoint is a displacement from its value at rest.
        least_setpoint: Least possible setpoint, such as 0 for a length.
        acts_at_rest: Whether its effort moves something at rest, unlike that of a modulus.
        stalls: Whether it stops where the bodies hold it, when its effort is at a limit. Actuators of
            other kinds reach the set displacement even then: a cable at its greatest tension slips.

    A kind that is effort-driven has one more: `extent`, the quantity that the displacement changes,
    such as a volume. Of other kinds it is the setpoint.
    """

    section: str
    entry: type[ActuatorEntry]
    setpoint: Quantity
    displacement: Quantity
    effort: Quantity
    sign: int = 1
    one_sided: bool = False
    takes_efforts: bool = True
    is_effort_driven: bool = False
    least_setpoint: float = -np.inf
    acts_at_rest: bool = True
    stalls: bool = False

    @property
    def noun(self) -> str:
        """Name of one of them in messages."""
        return self.entry.noun

    def build(self, layout: Layout, entries: tuple[ActuatorEntry, ...], notes: list[str]) -> ActuatorGroup:
        """The actuators of a scene.

        Args:
            layout: The bodies.
            entries: Entries of this kind, at least one.
            notes: List to which warnings are appended.

        Raises:
            SceneError: An entry does not fit the bodies.
        """

    def doubts(self, model, group: ActuatorGroup) -> Iterator[str]:
        """Warnings of unlikely values, such as a limit in a wrong unit.

        Args:
            model: The built scene; its factorization may be used and left undefined.
            group: The actuators of this kind.

        Yields:
            A sentence for each warning.
        """
        return iter(())

    def paths(self, group: ActuatorGroup, positions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Lines by which the actuators are drawn [m], each of shape (point_count, 3).

        Args:
            group: The actuators of this kind.
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            A line for each actuator; nothing where the kind has none.
        """
        return ()

    def details(self, entry: ActuatorEntry, group: ActuatorGroup, index: int) -> str:
        """Text of `explain` for an actuator before its limits, such as ``3 points``.

        Args:
            entry: Its entry.
            group: The actuators of this kind.
            index: Its place in the group.
        """


def numbers_of(entries: Sequence[ActuatorEntry], key: str) -> np.ndarray:
    """The values of a key, infinite where an entry has none, shape (entry_count, ...).

    Args:
        entries: The entries.
        key: Name of a number, or of its limits.
    """
    values = [getattr(entry, key) for entry in entries]
    return np.array([np.inf if value is None else value for value in values], float)


def group_of(
    kind: ActuatorKind, owners: Sequence[ActuatorEntry], term: ConstraintTerm | None,
    displacement_scale: np.ndarray, effort_bounds: np.ndarray, force_per_effort: np.ndarray, **others: Any,
) -> ActuatorGroup:  # fmt: skip
    """The group of entries that have a `rate`, with displacements from 0 without limits.

    Args:
        kind: See `ActuatorGroup`, as all others.
        owners: Entry of each actuator.
        term: See there.
        displacement_scale: See there.
        effort_bounds: See there.
        force_per_effort: See there.
        **others: Further fields, also those that this fills in.
    """
    count, word = len(owners), kind.displacement.word
    usual: dict[str, Any] = {
        "names": tuple(entry.name for entry in owners), "moves": None, "rest_setpoints": np.zeros(count),
        "displacement_bounds": np.tile([-np.inf, np.inf], (count, 1)), "rates": numbers_of(owners, "rate"),
        "kinds": (kind,) * count, "limit_names": ((f"{word}_min", f"{word}_max"),) * count,
        "entries": tuple(owners), "flows": np.full(count, np.inf),
        "effort_zeros": np.zeros(count), "effort_gains": np.ones(count),
    }  # fmt: skip
    fields = {"rest_extents": others.get("rest_setpoints", np.zeros(count))} | usual | others
    return ActuatorGroup(
        kind, term=term, displacement_scale=displacement_scale, effort_bounds=effort_bounds,
        force_per_effort=force_per_effort, **fields,
    )  # fmt: skip


# The kinds that are registered; `register_actuator` adds to them.
ACTUATOR_KINDS: list[ActuatorKind] = []


def register_actuator(kind: ActuatorKind) -> None:
    """Register a kind of actuator for scenes.

    Args:
        kind: The kind; its section must not have another meaning in scenes.

    Raises:
        ValueError: Another kind, or another entry of scenes, has this section.
    """
    if any(other.section == kind.section for other in ACTUATOR_KINDS):
        raise ValueError(f"there is a kind of actuator with the section {kind.section} already")
    add_actuator_section(kind.section, kind.entry)
    ACTUATOR_KINDS.append(kind)


def actuator_kinds() -> tuple[ActuatorKind, ...]:
    """All kinds that are registered."""
    return tuple(ACTUATOR_KINDS)
