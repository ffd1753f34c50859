"""Choice of the inverse of a scene, by what its contacts do."""

from __future__ import annotations

from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.direct_actuation import DirectActuation
from softrobot_twin.simulation.step.follower import Follower
from softrobot_twin.simulation.step.inverse_with_friction import InverseWithFriction
from softrobot_twin.solvers.inverse_problem import LEAST_ENERGY_WEIGHT


def why_not_followed(model: Model) -> str:
    """Reason why a scene's effectors cannot follow targets; empty if they can.

    Args:
        model: The model of a simulation.
    """
    if not model.target_rows.count or not model.actuators.count:
        return "this scene has no effectors or no actuators"
    return ""


def build_inverse(model: Model, direct: DirectActuation) -> Follower | None:
    """The inverse of a scene; None for a scene that cannot follow targets.

    Args:
        model: The built scene; its notes tell of a weight that is too small to be used.
        direct: Finds λ of what is commanded or held.
    """
    if why_not_followed(model):
        return None
    weight = model.scene.solver.energy_weight
    if weight < LEAST_ENERGY_WEIGHT:
        model.notes.append(
            f"solver.energy_weight: {weight:g} is less than the arithmetic bears: "
            f"{LEAST_ENERGY_WEIGHT:.2g} is used"
        )
    kind = InverseWithFriction if model.rubs else Follower
    return kind(model, direct)
