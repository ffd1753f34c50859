"""The optional effects around a step: a new one is a file with a `StepPart`, and a line here."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.effects.exploration import Explorer
from softrobot_twin.simulation.effects.grip_margins import grip_margins_of
from softrobot_twin.simulation.effects.gripping import Gripping
from softrobot_twin.simulation.effects.guiding import Guiding
from softrobot_twin.simulation.effects.moving_base import MovingBase
from softrobot_twin.simulation.effects.near_burst import near_burst_of
from softrobot_twin.simulation.effects.observed_forces import Observed
from softrobot_twin.simulation.effects.reactions import Reactions
from softrobot_twin.simulation.effects.sensing import Sensing
from softrobot_twin.simulation.effects.stiffness_targets import StiffnessTargets
from softrobot_twin.simulation.effects.touches import Touches
from softrobot_twin.simulation.effects.trusted_ranges import (
    HexahedraRange,
    SampledRanges,
    StrainRanges,
    reduced_bodies,
)
from softrobot_twin.simulation.step.step_part import StepPart, memories_of_terms

PartsOf = Callable[[Model], Iterator[StepPart]]


def _where(is_asked: Callable[[Model], object], part: Callable[[Model], StepPart]) -> PartsOf:
    """One part, of models for which something holds."""
    return lambda model: iter([part(model)] if is_asked(model) else [])


EFFECTS: list[PartsOf] = [
    _where(lambda model: model.scene.solver.exploration, lambda model: Explorer()),
    _where(lambda model: model.guides, Guiding),
    _where(lambda model: model.superelements or reduced_bodies(model), SampledRanges),
    _where(lambda model: model.strain_watches, StrainRanges),
    _where(lambda model: model.compression_watches, HexahedraRange),
    memories_of_terms,
    _where(lambda model: model.scene.touches, Touches),
    _where(lambda model: model.scene.observer, Observed),
    _where(lambda model: model.weighs_stiffness, StiffnessTargets),
    near_burst_of,
    grip_margins_of,
    _where(lambda model: model.scene.reactions, Reactions),
    _where(lambda model: model.sensors, Sensing),
    _where(lambda model: model.scene.grips, Gripping),
    _where(lambda model: model.scene.moving_base, MovingBase),
]
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
        if part.conflict:
            scene, (key, value) = model.scene, part.entry
            error = SceneError(scene.path, key or part.name, value, "", part.refusal.format(part.conflict))
            raise scene.source.error(error)
    return parts
