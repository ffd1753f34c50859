"""The errors of a running twin's reduced bodies, estimated by a process of lowest priority.

The process holds the scene with the modes in use, with the spare ones too, and with all nodes. It
gets states of the twin, and answers both estimates: by the spare modes, and by the full model, whose
nodes it places by the coordinates of the bodies (`analysis/reduction_error.py`). The tick computes none of
this; see `idle_process.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from types import MappingProxyType
from typing import TYPE_CHECKING

from softrobot_twin.control.idle_process import STATE, IdleWatch, Replies, Requests

# The other process lowers its priority before numpy is imported.
if TYPE_CHECKING:
    from softrobot_twin.simulation import Simulation
    from softrobot_twin.analysis.reduction_error import BodyError, ReductionState

READY = "ready"
"""Kind of the first reply: the models are built."""


class ReductionErrorWatch(IdleWatch):
    """Requests errors of reduced bodies and keeps the newest.

    Attributes:
        is_ready: Whether the models are built.
        states: How far each body can be believed, by the spare modes, in the newest judged state;
            empty as `newest`.
        newest: Error of each reduced body by the full model; NaN where that found no balance; empty
            before the first answer, and when there are no more.
        linearizations: Linearizations of the full model that the newest took.
    """

    is_ready, linearizations = False, 0
    states: Mapping[str, ReductionState] = MappingProxyType({})
    newest: Mapping[str, BodyError] = MappingProxyType({})

    def request_of(self, simulation: Simulation, forces_given: bool) -> object:
        """The state itself: coordinates, setpoints and efforts; see `IdleWatch`.

        Args:
            simulation: The simulation at the state that is asked about.
            forces_given: Whether efforts are held; makes no difference here.
        """
        # Its time is left out: a robot at rest has one state.
        return replace(simulation.state, step_count=0, time=0.0)

    def take(self, kind: str, content: list) -> None:
        """Keeps an answer; see `IdleWatch`."""
        if kind == READY:
            self.is_ready = True
        else:
            self.states, self.newest, self.linearizations = content

    def end(self, cause: str) -> None:
        """Records that there will be no more answers.

        Args:
            cause: Why, for messages.
        """
        super().end(cause)
        self.states, self.newest = {}, {}


def serve(requests: Requests, reply: Replies) -> None:
    """Answers until the other end closes.

    Args:
        requests: The scene, then a `State` each.
        reply: Takes ``(READY,)``, then ``(STATE, states by body, errors by body, linearizations,
            duration [s])`` for each state; errors and linearizations are those of the full model.
    """
    from softrobot_twin.simulation import Simulation
    from softrobot_twin.analysis.reduction_error import FullModelError, ReductionStates

    scene = requests.read()
    if scene is None:
        return
    simulation = Simulation(scene, with_warnings=False)
    judge, reduction = FullModelError(simulation), ReductionStates(simulation)
    reply(READY)
    while (state := requests.read()) is not None:
        begin = perf_counter()
        simulation.restore(state)
        states, errors = reduction.read(), judge.errors(state)
        reply(STATE, states, errors, judge.linearizations, perf_counter() - begin)
