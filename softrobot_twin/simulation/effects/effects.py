"""The optional effects around a step: a new one is a file with a `StepPart`, and a line here."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.effects.exploration import explorer_of
from softrobot_twin.simulation.effects.grip_margins import grip_margins_of
from softrobot_twin.simulation.effects.gripping import gripping_of
from softrobot_twin.simulation.effects.guiding import guiding_of
from softrobot_twin.simulation.effects.moving_base import moving_base_of
from softrobot_twin.simulation.effects.near_burst import near_burst_of
from softrobot_twin.simulation.effects.observed_forces import observed_forces_of
from softrobot_twin.simulation.effects.reactions import reactions_of
from softrobot_twin.simulation.effects.sensing import sensing_of
from softrobot_twin.simulation.effects.stiffness_targets import stiffness_targets_of
from softrobot_twin.simulation.effects.touches import touches_of
from softrobot_twin.simulation.effects.trusted_ranges import (
    hexahedra_range_of,
    sampled_ranges_of,
    strain_ranges_of,
)
from softrobot_twin.simulation.step.step_part import StepPart, memories_of_terms

EFFECTS: list[Callable[[Model], Iterator[StepPart]]] = [
    explorer_of, guiding_of, sampled_ranges_of, strain_ranges_of, hexahedra_range_of,
    memories_of_terms, touches_of, observed_forces_of, stiffness_targets_of, near_burst_of, grip_margins_of,
    reactions_of, sensing_of, gripping_of, moving_base_of,
]  # fmt: skip
"""Each gives the parts that a scene calls for."""


def step_parts(model: Model) -> tuple[StepPart, ...]:
    """All parts that a scene calls for.

    Args:
        model: The built scene.

    Raises:
        SceneError: One is not built beside something else in the scene.
    """
    parts = tuple(part for parts_of in EFFECTS for part in parts_of(model))
    for part in parts:
        if reason := part.why_not():
            scene, (key, value) = model.scene, part.entry
            error = SceneError(scene.path, key or part.name, value, "", part.refusal.format(reason))
            raise scene.source.error(error)
    return parts
