"""HTML by which notebooks show robots, results and tables."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.harness.figure import png_of
from softrobot_twin.harness.length_units import SHOWN
from softrobot_twin.harness.terminal import by_key
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.actuator_kinds import Quantity

# Most rows of a table; of more the first and the last ones are shown.
_MOST_ROWS = 20
_SHARPNESS = 90  # pixels per inch of a picture


class Actuator(NamedTuple):
    """What is told of an actuator.

    Attributes:
        name: Its name.
        noun: What it is, such as ``cable``.
        quantities: Its setpoint, displacement and effort.
    """

    name: str
    noun: str
    quantities: tuple[Quantity, Quantity, Quantity]


def actuators_of(simulation: Simulation) -> tuple[Actuator, ...]:
    """The actuators of a simulation, in its order.

    Args:
        simulation: The simulation.
    """
    return tuple(Actuator(name, kind.noun, (kind.setpoint, kind.displacement, kind.effort))
                 for name, kind in simulation.actuators.kind_of.items())  # fmt: skip


def table_html(header: Iterable[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table; texts are escaped, and of many rows the first and the last are shown.

    Args:
        header: Titles of the columns.
        rows: Cells of each row, of any type; numbers are shown with few digits.
    """
    lines = [list(map(_cell, row)) for row in rows]
    if len(lines) > _MOST_ROWS:
        half = _MOST_ROWS // 2
        lines = [*lines[:half], ["…"] * len(lines[0]), *lines[-half:]]
    cells = [_row("th", header), *(_row("td", line) for line in lines)]
    more = f"<p>{len(rows)} rows</p>" if len(rows) > _MOST_ROWS else ""
    return f"<table>{''.join(cells)}</table>{more}"


def _cell(value: Any) -> str:
    """A number with four digits, empty for NaN; anything else as text."""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value + 0.0:.4g}"  # 0 in place of -0
    return str(value)


def _row(tag: str, cells: Iterable[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def text_html(text: str, tag: str = "p") -> str:
    """A text as a paragraph, or within another tag.

    Args:
        text: The text; it is escaped.
        tag: Name of the tag, such as ``p``.
    """
    return f"<{tag}>{escape(text)}</{tag}>"


def actuators_html(actuators: Sequence[Actuator], *values: np.ndarray) -> str:
    """A table for each kind of actuator, with the units of its columns.

    Args:
        actuators: The actuators.
        *values: Setpoints, displacements and efforts in SI units, shape (actuator_count,) each.
    """
    alike: dict[tuple[str, tuple[Quantity, ...]], list[int]]
    alike = by_key(((one.noun, one.quantities), place) for place, one in enumerate(actuators))
    tables = []
    for (noun, quantities), places in alike.items():
        # The setpoint of an actuator that is driven by its effort is the effort.
        columns = dict(zip(quantities, values, strict=True))
        shown = {one: SHOWN.get(one.unit, (1.0, one.unit)) for one in columns}
        tables.append(table_html(
            [noun, *(f"{one.word} [{unit}]" for one, (_, unit) in shown.items())],
            [[actuators[place].name, *(shown[one][0] * column[place]
                                       for one, column in columns.items())] for place in places],
        ))  # fmt: skip
    return "".join(tables)


def effectors_html(names: Sequence[str], positions: np.ndarray, errors: np.ndarray | None = None) -> str:
    """A table of the effectors.

    Args:
        names: Their names.
        positions: Their positions [m], shape (effector_count, 3).
        errors: Distances from their targets [m], NaN without one, shape (effector_count,).
    """
    if not names:
        return ""
    places = positions.round(12)  # without round-off beside 0
    columns = dict(zip(("x [mm]", "y [mm]", "z [mm]"), places.T, strict=True))
    if errors is not None and np.isfinite(errors).any():
        columns["from its target [mm]"] = errors
    rows = zip(names, *(1e3 * column for column in columns.values()), strict=True)
    return table_html(["effector", *columns], list(rows))


def figure_html(figure: Any, text: str) -> str:
    """A matplotlib figure as an image inside the page, with a text for who does not see it.

    Args:
        figure: The figure.
        text: The text.
    """
    picture = base64.b64encode(png_of(figure, _SHARPNESS)).decode()
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{picture}">'
