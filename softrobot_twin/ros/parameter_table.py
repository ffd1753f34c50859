"""Parameters as a table: each declared with a description, a unit and a range."""

from __future__ import annotations

import math
from collections.abc import Iterable
from difflib import get_close_matches
from typing import NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from softrobot_twin.errors import ParameterError

_OF_RCLPY = ("qos_overrides.", "start_type_description_service")


class Entry(NamedTuple):
    """One parameter.

    Attributes:
        name: Its name.
        default: What it is when nothing is said; its type is the parameter's type.
        description: One sentence.
        unit: Unit of the value, or an empty string.
        low: Least value allowed, or None for no range.
        high: Greatest value allowed.
        choices: Words allowed, or empty.
        read_only: True when it cannot change while the node runs.
    """

    name: str
    default: object
    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """What ``ros2 param describe`` shows and what rclpy checks."""
        description = f"{self.description} [{self.unit}]" if self.unit else self.description
        descriptor = ParameterDescriptor(
            name=self.name, description=description, read_only=self.read_only
        )
        if self.choices:
            descriptor.additional_constraints = "one of " + ", ".join(self.choices)
        if self.low is not None and isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.low, to_value=self.high, step=0.0)
            ]
        elif self.low is not None:
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)
            ]
        return descriptor

    def check(self, value: object) -> None:
        """Refuses what a descriptor cannot express.

        Raises:
            ParameterError: The value is not one of the choices, or not finite.
        """
        if self.choices and value not in self.choices:
            raise ParameterError(self.name, value, self.unit, f"must be one of {self.choices}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(self.name, value, self.unit, "must be finite")


def declare(node: Node, table: Iterable[Entry]) -> dict[str, object]:
    """Declares every parameter of a table.

    Returns:
        Their values by name; arrays as tuples.

    Raises:
        ParameterError: A parameter file gives one of them a type or a value that does not fit.
    """
    values = {}
    for entry in table:
        try:
            parameter = node.declare_parameter(entry.name, entry.default, entry.descriptor())
        except InvalidParameterTypeException as error:
            raise ParameterError(
                entry.name, given_values(node).get(entry.name), entry.unit,
                f"must be of the type of {entry.default!r} ({error})",
            ) from None
        except InvalidParameterValueException as error:
            raise ParameterError(
                entry.name, given_values(node).get(entry.name), entry.unit, str(error)
            ) from None
        values[entry.name] = plain(parameter)
        entry.check(values[entry.name])
    return values


def plain(parameter: Parameter) -> object:
    """Value of a parameter, an array as a tuple."""
    value = parameter.value
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__"):
        return value
    return tuple(value)


def given_values(node: Node) -> dict[str, object]:
    """Values that parameter files and command line give to a node, known to it or not."""
    # rclpy ignores unknown ones in silence and has no public way to list them.
    overrides: dict[str, Parameter] = getattr(node, "_parameter_overrides", {})
    return {name: plain(parameter) for name, parameter in overrides.items()}


def unknown_parameters(node: Node, tables: Iterable[Iterable[Entry]]) -> list[str]:
    """Says which parameters a file or the command line gives and no node that shares it knows.

    Args:
        node: The node.
        tables: The parameters of all nodes that share a file.

    Returns:
        A sentence for each, with the nearest name that is known.
    """
    known = {entry.name for table in tables for entry in table}
    sentences = []
    for name in sorted(given_values(node).keys() - known):
        # What rclpy itself declares.
        if name == "use_sim_time" or name.startswith(_OF_RCLPY):
            continue
        near = get_close_matches(name.replace(".", "_"), sorted(known), n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        sentences.append(f"parameter {name} is unknown and ignored{hint}")
    return sentences
