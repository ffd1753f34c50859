"""Cables that can do nothing, and limits of cables that may be in a wrong unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import Scene

# Limits outside these shares of what a cable can do at all are told: a wrong unit is a factor of a
# thousand.
SHORTENING_RANGE = (1.0e-3, 10.0)
"""Of the cable's length at rest."""
RATE_RANGE = (1.0e-3, 100.0)
"""Of the cable's length at rest, in a second."""
TENSION_RANGE = (2.0e-3, 50.0)
"""Of the tension that would wind in the whole cable, were the body linear."""


def check_cables_move(cables, rest_positions: np.ndarray, scene: Scene) -> None:
    """Refuse cables that pull on nothing that can move.

    Args:
        cables: The cable term.
        rest_positions: Node positions at rest [m], shape (node_count, 3).
        scene: The scene.

    Raises:
        SceneError: All points of a cable are in the fixed part of its body.
    """
    pulls = np.zeros(len(scene.cables))
    blocks, values = _rows(cables, rest_positions)
    np.add.at(pulls, cables.entry_rows, np.abs(blocks).sum(axis=1))
    for index in np.flatnonzero(pulls == 0.0):
        raise SceneError(
            scene.path, f"cables[{index}].points", scene.cables[index].name, "",
            "lies wholly in what is fixed: it moves nothing",
        )  # fmt: skip


def doubtful_limits(model) -> Iterator[str]:
    """Limits of cables that are a thousand times out of scale.

    Args:
        model: The built scene; its factorization is used and left undefined.

    Yields:
        A sentence for each.
    """
    scene = model.scene
    if not scene.cables:
        return
    lengths = model.cables.rest_lengths
    tensions = _full_tensions(model)
    for index, cable in enumerate(scene.cables):
        key, length = f"cables[{index}]", float(lengths[index])
        stated = f"the cable is {length:.4g} m long at rest"
        ends = [abs(end) for end in cable.shortening if np.isfinite(end)]
        yield from _doubt(f"{key}.shortening", max(ends, default=0.0), "m", length,
                          SHORTENING_RANGE, f"{stated}; is the limit in metres?")  # fmt: skip
        yield from _doubt(f"{key}.rate", cable.rate or 0.0, "m/s", length, RATE_RANGE,
                          f"{stated}; is the rate in m/s?")  # fmt: skip
        if tensions is not None:
            yield from _doubt(
                f"{key}.tension", cable.tension[1], "N", float(tensions[index]), TENSION_RANGE,
                f"some {tensions[index]:.2g} N would wind it in whole; is the limit in newtons?",
            )  # fmt: skip


def _doubt(
    key: str, value: float, unit: str, whole: float, usual: tuple[float, float], hint: str
) -> Iterator[str]:
    """Zero is no limit of the wrong unit, nor is none."""
    if value == 0.0 or not np.isfinite(value) or usual[0] * whole <= value <= usual[1] * whole:
        return
    size = "large" if value > whole else "small"
    yield f"{key} = {value:g} {unit} is very {size}: {hint}"


def _rows(cables, rest_positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Entries of H at rest, shape (entry_count, 3), and the violations [m]."""
    blocks, values = np.zeros((len(cables.entry_rows), 3)), np.zeros(cables.row_count)
    cables.evaluate(rest_positions, blocks, values)
    return blocks, values


def _full_tensions(model) -> np.ndarray | None:
    """Tension that would wind in each whole cable, by the stiffness at rest [N].

    Shape (cable_count,); None where bodies are not held, or move with rigid ones.
    """
    nodes, factorization, cables = model.nodes, model.factorization, model.cables
    asked = any(0.0 < cable.tension[1] < np.inf for cable in model.scene.cables)
    if not asked or model.is_dynamic or any(part.is_free for part in model.rigid):
        return None
    forces = np.zeros((nodes.free_node_count, 3))
    factorization.clear()
    for term in model.forces:
        term.add(nodes.rest_positions, forces, factorization.storage, True)
    if not all(body.is_held for body in model.bodies) or not factorization.factor():
        return None
    blocks, _ = _rows(cables, nodes.rest_positions)
    full = np.empty(cables.row_count)
    for cable in range(cables.row_count):
        own = cables.entry_rows == cable
        pull = np.zeros_like(forces)
        np.add.at(pull, cables.entry_nodes[own], blocks[own])
        compliance = float(np.sum(pull * factorization.solve(pull)))
        full[cable] = cables.rest_lengths[cable] / compliance
    return full
