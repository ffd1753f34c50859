"""Limits of actuators that are out of scale: a wrong unit is a factor of a thousand."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def unlikely(
    key: str, value: float, unit: str, whole: float, usual: tuple[float, float], hint: str
) -> Iterator[str]:
    """Warn of a limit that is far from its natural scale.

    Args:
        key: Key of the limit.
        value: The limit, in its unit. Zero and infinity are limits in any unit.
        unit: Its unit.
        whole: The natural scale, in the same unit.
        usual: Least and greatest usual share of the scale.
        hint: What the scale is, and a question about the unit.

    Yields:
        A sentence, if the limit is unlikely.
    """
    if value == 0.0 or not np.isfinite(value) or usual[0] * whole <= value <= usual[1] * whole:
        return
    size = "large" if value > whole else "small"
    yield f"{key} = {value:g} {unit} is very {size}: {hint}"


def rows_at(term, positions: np.ndarray) -> np.ndarray:
    """Entries of H of a constraint term at a state, shape (entry_count, 3).

    Args:
        term: The constraint term.
        positions: Node positions [m], shape (node_count, 3).
    """
    blocks, values = np.zeros((len(term.entry_rows), 3)), np.zeros(term.row_count)
    term.evaluate(positions, blocks, values)
    return blocks


def efforts_at_scale(model, term) -> np.ndarray | None:
    """Effort that would displace each actuator by its natural scale, by the stiffness at rest.

    Args:
        model: The built scene; its factorization is left undefined.
        term: Constraint term of the actuators.

    Returns:
        Efforts in the unit of their kind, shape (row_count,); None where bodies are not held, or
        move with rigid ones.
    """
    nodes, factorization = model.nodes, model.factorization
    if model.is_dynamic or model.nodes.carried is not None:
        return None
    forces = np.zeros((nodes.free_node_count, 3))
    factorization.clear()
    for force in model.forces:
        force.add(nodes.rest_positions, forces, factorization.storage, True)
    if not all(body.is_held for body in model.bodies) or not factorization.factor():
        return None
    blocks = rows_at(term, nodes.rest_positions)
    efforts = np.empty(term.row_count)
    for index in range(term.row_count):
        own = term.entry_rows == index
        load = np.zeros_like(forces)
        np.add.at(load, term.entry_nodes[own], blocks[own])
        efforts[index] = term.scales[index] / float(np.sum(load * factorization.solve(load)))
    return efforts
