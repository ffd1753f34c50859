"""Who linearizes a scene and who finds λ; those of contact are imported only where it is named."""

from __future__ import annotations

from softrobot_twin.simulation.actuation import DirectActuation
from softrobot_twin.simulation.interpretation import why_not_followed
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.solvers.inverse_problem import LEAST_ENERGY_WEIGHT


def build_solution(model: Model) -> tuple:
    """Who linearizes, and who finds λ of what is commanded or held.

    Args:
        model: The built scene.
    """
    if model.contacts is None:
        return Newton(model), DirectActuation()
    from softrobot_twin.simulation.contact_actuation import ContactActuation
    from softrobot_twin.simulation.contact_newton import ContactNewton

    return ContactNewton(model), ContactActuation(model)


def build_inverse(model: Model, direct, qp_solvers: tuple | None):
    """Who finds λ that leads to targets; None for a scene that cannot be inverted.

    Args:
        model: The built scene.
        direct: Finds λ of what is commanded or held.
        qp_solvers: Solvers in the order they are asked, in place of the scene's.
    """
    if why_not_followed(model):
        return None
    weight = model.scene.solver.energy_weight
    if weight < LEAST_ENERGY_WEIGHT:
        model.notes.append(
            f"solver.energy_weight: {weight:g} is less than the arithmetic bears: "
            f"{LEAST_ENERGY_WEIGHT:.2g} is used"
        )
    if model.contacts is not None:
        from softrobot_twin.simulation.inverse_in_contact import InverseInContact

        return InverseInContact(model, direct)
    from softrobot_twin.simulation.inverse_actuation import InverseActuation

    return InverseActuation(model, qp_solvers)
