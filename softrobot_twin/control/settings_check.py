"""Settings that a scene cannot carry out."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.activity import Mode
from softrobot_twin.control.effector_measurement import EffectorMeasurement
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import Simulation


def refuse_what_cannot_be(
    settings: LoopSettings, simulation: Simulation, measurement: EffectorMeasurement, mode: Mode
) -> None:
    """Refuses settings that the scene cannot carry out.

    Args:
        settings: The settings.
        simulation: The model.
        measurement: Knows which markers measure which effector.
        mode: What drives the twin.

    Raises:
        ParameterError: The loop should be closed and no marker measures an effector, or what is
            sent to targets or poses stands outside the workspace at rest: it would be driven
            from there to the box by whatever it is told.
    """
    if settings.closed_loop and not measurement.is_possible:
        raise ParameterError(
            "closed_loop", True, "", "no effector of the scene is measured_by a marker"
        )
    for name, position in _places_at_rest(simulation, mode).items():
        for corner, outside in (
            ("workspace_min", position < settings.workspace_min),
            ("workspace_max", position > settings.workspace_max),
        ):
            if outside.any():
                where = ", ".join(f"{value:.4g}" for value in position)
                raise ParameterError(
                    corner, getattr(settings, corner), "m",
                    f"{name} is outside of the workspace at rest, at ({where}) m",
                )  # fmt: skip


def _places_at_rest(simulation: Simulation, mode: Mode) -> dict[str, np.ndarray]:
    """Where effectors and guided bodies are at rest [m], by name."""
    model, places = simulation.model, {}
    if mode is Mode.INVERSE and model.effectors is not None:
        positions = model.effectors.positions(model.nodes.rest_positions)
        places = dict(zip(simulation.effector_names, positions, strict=True))
    guided = simulation.guided_names
    return places | {part.name: part.origin for part in model.rigid if part.name in guided}
