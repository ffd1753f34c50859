"""The discretisation error of a running twin, estimated by a process of lowest priority.

The solution of a state with elements of higher order takes longer than a tick; see
`idle_process.py`. `MeshErrorWatch` runs in the twin; `serve` answers in the other process.
"""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING

from softrobot_twin.control.idle_process import STATE, UNKNOWN, IdleWatch, Replies, Requests

# The other process lowers its priority before numpy is imported.
if TYPE_CHECKING:
    from softrobot_twin.analysis.mesh_error import MeshError
    from softrobot_twin.simulation import Simulation

REST = "rest"
"""Kind of the first reply: the mesh at rest."""


class MeshErrorWatch(IdleWatch):
    """Requests estimates and keeps the newest.

    Attributes:
        at_rest: Discretisation error at rest; None until it is known.
        newest: Error of the effectors' positions by the mesh, in the newest estimated state [m];
            NaN before the first estimate, and when there is none.
    """

    at_rest: MeshError | None = None
    newest = float("nan")

    def request_of(self, simulation: Simulation, forces_given: bool) -> object:
        """What the actuators prescribe; see `IdleWatch`.

        Args:
            simulation: The simulation at the state that is asked about.
            forces_given: Whether efforts are held, in place of setpoints.
        """
        from softrobot_twin.analysis.mesh_error import ActuatorLoads

        return ActuatorLoads.of(simulation, forces_given)

    def take(self, kind: str, content: list) -> None:
        """Keeps an estimate; see `IdleWatch`."""
        if kind == REST:
            self.at_rest = content[0]
        else:
            self.newest = content[0]

    def end(self, cause: str) -> None:
        """Records that there will be no more estimates.

        Args:
            cause: Why, for messages.
        """
        super().end(cause)
        self.newest = float("nan")


def serve(requests: Requests, reply: Replies) -> None:
    """Answers until the other end closes: first the mesh at rest, then each requested state.

    Args:
        requests: The scene, then `ActuatorLoads` for each state.
        reply: Takes ``(REST, MeshError)``, then ``(STATE, error [m], duration [s])`` for each
            state; ``(UNKNOWN, reason)`` and the end when there is no estimate.
    """
    from softrobot_twin.analysis.mesh_error import (
        MeshErrorEstimator,
        MeshErrorUnknown,
        check_judges_states,
    )

    scene = requests.read()
    if scene is None:
        return
    try:
        estimator = MeshErrorEstimator(scene)
        reply(REST, estimator.at_rest())
        check_judges_states(scene)
        while (asked := requests.read()) is not None:
            begin = perf_counter()
            reply(STATE, estimator.at(asked), perf_counter() - begin)
    except MeshErrorUnknown as unknown:
        reply(UNKNOWN, unknown.reason)
