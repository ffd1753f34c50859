"""One linearization with contacts: their rows stand below all others, as many as there are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.simulation.stage_clock import StageClock
from softrobot_twin.simulation.touching import ContactForces

# Contacts that carry less [N] are not told.
CARRIES = 1.0e-9


class ContactLinearized(NamedTuple):
    """The robot seen from actuators, effectors and contacts, around one state.

    Attributes:
        W_aa: Shortening by tension [m/N], shape (actuator_count, actuator_count).
        W_ea: Effector motion by tension [m/N], shape (effector_row_count, actuator_count).
        actuators: Path shortening without multipliers [m], shape (actuator_count,).
        effectors: Effector coordinates without multipliers [m], shape (effector_row_count,).
        effectors_now: Effector coordinates at the state itself [m], same shape.
        W: Compliance of actuators, then contacts [m/N], shape (row_count, row_count).
        violation: Their δ without multipliers [m], shape (row_count,).
    """

    W_aa: np.ndarray
    W_ea: np.ndarray
    actuators: np.ndarray
    effectors: np.ndarray
    effectors_now: np.ndarray
    W: np.ndarray
    violation: np.ndarray


class ContactNewton(Newton):
    """Linearizes a model with contacts; see `Newton`."""

    def __init__(self, model: Model):
        """Allocate; see `Newton`."""
        super().__init__(model)
        self._whole_limit = self._step_limit
        self._state_after = model.nodes.rest_positions

    def forget(self) -> None:
        """Forget what earlier states taught, contact forces too."""
        super().forget()
        self._model.contacts.memory.forget()

    def linearize(
        self, positions: np.ndarray, tensions: np.ndarray, clock: StageClock,
        with_stale_factor: bool = False,
    ) -> ContactLinearized | None:  # fmt: skip
        """Find what is near, then see the bodies from their constraints; see `Newton`."""
        contacts = self._model.contacts
        contacts.detect(positions)
        self._step_limit = min(self._whole_limit, contacts.margin)
        self._multipliers = np.zeros(self._model.rows.row_count)
        clock.mark("detect")
        return super().linearize(positions, tensions, clock, with_stale_factor)

    def _seen(self, W, violation, values) -> ContactLinearized:
        plain = super()._seen(W, violation, values)
        a, first_contact = self._actuators.stop, self._effectors.stop
        if a == first_contact:
            return ContactLinearized(*plain, W, violation)
        rows = np.r_[:a, first_contact : len(violation)]
        return ContactLinearized(*plain, W[np.ix_(rows, rows)], violation[rows])

    def _set_multipliers(self, actuation: Actuation) -> None:
        super()._set_multipliers(actuation)
        self._multipliers[self._effectors.stop :] = actuation.contact.multipliers

    def correct(self, positions: np.ndarray, actuation: Actuation) -> float:
        """See `Newton.correct`; no move is longer than what was looked at, so that nothing is
        passed through unseen."""
        self._model.contacts.memory.remember(actuation.contact.multipliers)
        return super().correct(positions, actuation)

    def touching(self, actuation: Actuation) -> ContactForces:
        """Contacts that carry force."""
        contacts = self._model.contacts
        count, per_contact = contacts.count, contacts.rows_per_contact
        multipliers = actuation.contact.multipliers.reshape(count, per_contact)
        carrying = np.flatnonzero(multipliers[:, 0] > CARRIES)
        forces = np.einsum(
            "ck,cki->ci", multipliers[carrying], contacts.directions[carrying, :per_contact]
        )
        return ContactForces(
            contacts.positions[carrying], forces,
            contacts.gaps(self._state_after)[carrying], contacts.pair[carrying],
            tuple(pair.names for pair in contacts.pairs),
        )  # fmt: skip

    def residual(self, positions: np.ndarray, actuation: Actuation) -> float:
        """See `Newton.residual`."""
        self._state_after = positions
        return super().residual(positions, actuation)
