"""What a kind of actuator declares, and the kinds that scenes may name.

An actuator a has a displacement δ_a against rest and an effort λ_a, whose product is work: the
shortening [m] and the tension [N] of a cable, the change of volume [m³] and the pressure [Pa] of a
cavity. A kind says how its entries in a scene become rows of H (Coevoet 2017, eq. 2), and by which
words and units its quantities are known in limits, files and messages. All the rest of the package
knows actuators, not cables.

A new kind is one class with what `ActuatorKind` lists, and one call of `register_actuator`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np

from softrobot_twin.scene.actuator_entries import ActuatorEntry
from softrobot_twin.scene.schema import add_actuator_section, remove_actuator_section
from softrobot_twin.simulation.scene_layout import Layout


class Quantity(NamedTuple):
    """A quantity of an actuator, as users know it.

    Attributes:
        word: In names of limits and columns of files, such as ``tension``.
        unit: Its SI unit, such as ``N``; in columns of files ``m3`` stands for cubic metres.
    """

    word: str
    unit: str


class ActuatorGroup(NamedTuple):
    """The actuators of one kind in a scene.

    Attributes:
        kind: Their kind.
        names: Their names, shape (count,).
        term: Constraint term with one row for each of them, in the group ``actuators``; it has
            `stencils` and `bind` like a force term, for its geometric stiffness. None for
            actuators without multipliers, see `moves`.
        moves: What prescribes displacements in place of rows, as slides do; else None.
        rest_setpoints: Setpoints at rest [setpoint unit], shape (count,).
        displacement_scale: A displacement that is large, such as the length of a cable at rest
            [displacement unit], shape (count,).
        displacement_bounds: Least and greatest displacement [displacement unit], shape (count, 2).
        rates: Greatest change of the setpoint in a second, infinite without a limit,
            shape (count,).
        effort_bounds: Least and greatest effort [effort unit], shape (count, 2).
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


class ActuatorKind(Protocol):
    """One kind of actuator.

    Attributes:
        section: Key of its entries in a scene, such as ``cables``.
        entry: What each entry is read as.
        noun: What one of them is called in messages.
        setpoint: What it is commanded to, an absolute value.
        displacement: How far that is from rest, positive in the direction in which it does work.
        effort: λ_a.
        sign: 1 where the setpoint grows with the displacement, -1 where it shrinks: the length of
            a cable is less the more it is shortened.
        one_sided: Whether its effort has one sign only: a cable cannot push. It then holds the
            displacement from below, 0 ≤ λ ⊥ δ - δ_set ≥ 0; else δ = δ_set.
        takes_efforts: Whether it can be commanded by an effort.
        least_setpoint: Setpoint below which nothing is, such as 0 for a length.
    """

    section: str
    entry: type[ActuatorEntry]
    noun: str
    setpoint: Quantity
    displacement: Quantity
    effort: Quantity
    sign: int
    one_sided: bool
    takes_efforts: bool
    least_setpoint: float

    def build(
        self, layout: Layout, entries: tuple[ActuatorEntry, ...], notes: list[str]
    ) -> ActuatorGroup:
        """The actuators of a scene.

        Args:
            layout: The bodies.
            entries: Entries of this kind, at least one.
            notes: Takes what looks wrong.

        Raises:
            SceneError: An entry does not fit the bodies.
        """

    def doubts(self, model, group: ActuatorGroup) -> Iterator[str]:
        """What is allowed and yet looks wrong, such as a limit in a wrong unit.

        Args:
            model: The built scene; its factorization may be used and left undefined.
            group: The actuators of this kind.

        Yields:
            A sentence for each doubt.
        """

    def paths(self, group: ActuatorGroup, positions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Lines by which the actuators are drawn [m], each of shape (point_count, 3).

        Args:
            group: The actuators of this kind.
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            A line for each actuator; nothing where the kind has none.
        """

    def details(self, entry: ActuatorEntry) -> str:
        """What `explain` says of an entry before its limits, such as ``3 points``."""


_KINDS: list[ActuatorKind] = []


def register_actuator(kind: ActuatorKind) -> None:
    """Let scenes name a kind of actuator.

    Args:
        kind: The kind; its section must not mean anything else in scenes.

    Raises:
        ValueError: Another kind, or another entry of scenes, has this section.
    """
    if any(other.section == kind.section for other in _KINDS):
        raise ValueError(f"there is a kind of actuator with the section {kind.section} already")
    add_actuator_section(kind.section, kind.entry)
    _KINDS.append(kind)


def withdraw_actuator(kind: ActuatorKind) -> None:
    """Take back what `register_actuator` did; scenes that name the kind are refused again.

    Args:
        kind: A kind that is registered.
    """
    _KINDS.remove(kind)
    remove_actuator_section(kind.section)


def actuator_kinds() -> tuple[ActuatorKind, ...]:
    """All kinds that are registered."""
    return tuple(_KINDS)
