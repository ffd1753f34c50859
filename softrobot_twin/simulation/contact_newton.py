"""One linearization with contacts: their rows stand below all others, as many as there are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.model import Model
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.simulation.pressing_contacts import PressingContacts, worth_leaving_out
from softrobot_twin.simulation.stage_clock import StageClock
from softrobot_twin.simulation.touching import ContactForces
from softrobot_twin.solvers.compliance import Compliance
from softrobot_twin.solvers.factorization import NodeRows

# Contacts with a gap within this share of what is watched may well press in a step.
CLOSE = 0.002
# Contacts that carry less [N] are not told.
CARRIES = 1.0e-9


@njit(cache=True, nogil=True, error_model="numpy")
def write_contact_forces(chosen, multipliers, directions, rows_per_contact, forces):
    """Σ λ d of some contacts."""
    for c in range(len(chosen)):
        for i in range(3):
            forces[c, i] = 0.0
            for k in range(rows_per_contact):
                multiplier = multipliers[rows_per_contact * chosen[c] + k]
                forces[c, i] += multiplier * directions[chosen[c], k, i]


class ContactLinearized(NamedTuple):
    """The robot seen from actuators, effectors and contacts, around one state (eq. 14).

    Attributes:
        compliance: Of all rows: cables, effectors, contacts.
        violation: Their δ without multipliers [m], shape (n,).
        values: Their δ at the state itself [m], shape (n,).
        cables: The cables' rows.
        effector_rows: The effectors' rows.
        contacts: The contacts' rows.
        slide_positions: Where the slides are [m], shape (slide_count,).
        G_e: Effector motion by slides, shape (effector_row_count, slide_count).
        G_c: Contact motion by slides, shape (contact_row_count, slide_count).
    """

    compliance: Compliance
    violation: np.ndarray
    values: np.ndarray
    cables: slice
    effector_rows: slice
    contacts: slice
    slide_positions: np.ndarray
    G_e: np.ndarray
    G_c: np.ndarray

    @property
    def W(self) -> np.ndarray:
        """The compliance as a matrix [m/N], shape (n, n)."""
        return self.compliance.W

    @property
    def actuators(self) -> np.ndarray:
        """δ of the cables without multipliers [m], shape (cable_count,)."""
        return self.violation[self.cables]

    @property
    def touching_system(self) -> tuple[Compliance, np.ndarray]:
        """Compliance and δ of cables, then contacts, without the effectors', copied."""
        first, stop = self.cables.stop, self.contacts.start
        violation = np.concatenate([self.violation[:first], self.violation[stop:]])
        return self.compliance.without(first, stop), violation

    def path_shortening(self, tensions: np.ndarray, contact_multipliers: np.ndarray) -> np.ndarray:
        """See `PressingContacts.path_shortening`."""
        a, multipliers = self.cables, np.zeros(len(self.violation))
        multipliers[a], multipliers[self.contacts] = tensions[a], contact_multipliers
        return self.compliance.motion(a, multipliers) + self.violation[a]


class ContactNewton(Newton):
    """Linearizes a model with contacts; see `Newton`."""

    def __init__(self, model: Model):
        """Allocate; see `Newton`."""
        super().__init__(model)
        self._positions = self._state_after = model.nodes.rest_positions
        self._pair_names = tuple(pair.names for pair in model.contacts.pairs)
        self._pressing: PressingContacts | None = None
        self._no_columns = np.empty((self._effectors.stop - self._effectors.start, 0))
        if model.slides is not None and model.effectors is not None:
            self._effector_columns = model.slides.effector_columns(model.effectors)
        else:
            self._effector_columns = np.empty((0, len(model.scene.slides)))

    @property
    def may_keep_factor(self) -> bool:
        """Never: with gaps that are off by an old compliance, effectors miss by millimetres."""
        return False

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
        self._positions = positions
        self._step_limit = min(self._step_limit, contacts.margin)
        self._multipliers = np.zeros(self._model.rows.row_count)
        clock.mark("detect")
        return super().linearize(positions, tensions, clock, with_stale_factor)

    def _assemble(self, positions: np.ndarray, tensions: np.ndarray, projected: bool) -> None:
        super()._assemble(positions, tensions, projected)
        contacts = self._model.contacts
        if contacts.curvature is not None:
            contacts.curvature.add(contacts, positions, self._model.factorization.storage)

    def _condense(self, clock: StageClock) -> ContactLinearized | PressingContacts:
        """See `Newton._condense`; W is not formed where few unknowns carry all rows, and not for
        those of many contacts that are expected to stay open."""
        rows, factorization = self._model.rows, self._model.factorization
        H = NodeRows(rows.row_index, rows.node_index, rows.blocks, rows.row_count)
        self._pressing = None
        condensed = factorization.condense_low_rank(H, self._forces)
        pressing = self._expected_to_press(rows.values)
        if condensed is None and pressing is not None:
            self._pressing = PressingContacts(
                factorization, H, self._forces, rows.values, self._actuators,
                self._effectors.stop, self._model.contacts.rows_per_contact, pressing,
            )  # fmt: skip
            clock.mark("condense")
            return self._pressing
        if condensed is not None:
            compliance = Compliance(Yt=condensed.Yt)
        else:
            condensed = factorization.condense(H, self._forces)
            compliance = Compliance(condensed.W)
        linear = self._seen(compliance, rows.values + condensed.free, rows.values)
        clock.mark("condense")
        return linear

    def _expected_to_press(self, values: np.ndarray) -> np.ndarray | None:
        """Which contacts pressed before or are close; None where all are condensed.

        Where an inverse is asked, or slides move what is touched, they are.
        """
        contacts = self._model.contacts
        if contacts.rows_per_contact == 1 or self._model.slides is not None:
            return None
        guess, normals = contacts.memory.guess, slice(None, None, contacts.rows_per_contact)
        gaps = values[self._effectors.stop :][normals]
        pressing = (guess[normals] > 0.0) | (gaps < CLOSE * contacts.margin)
        return pressing if worth_leaving_out(pressing, contacts.rows_per_contact) else None

    def _expand(self) -> np.ndarray:
        """See `Newton._expand`."""
        if self._pressing is None:
            return super()._expand()
        return self._model.factorization.expand(self._multipliers[self._pressing.rows])

    def _seen(self, compliance: Compliance, violation, values) -> ContactLinearized:
        model, c = self._model, slice(self._effectors.stop, len(violation))
        slides = model.slides
        if slides is None:
            now, G_e, G_c = np.empty(0), self._no_columns, np.empty((c.stop - c.start, 0))
        else:
            now = slides.positions(self._positions)
            G_e, G_c = self._effector_columns, slides.contact_columns(model.contacts)
        return ContactLinearized(
            compliance, violation, values, self._actuators, self._effectors, c, now, G_e, G_c
        )

    def _set_multipliers(self, actuation: Actuation) -> None:
        self._multipliers[self._actuators] = actuation.efforts[self._actuators]
        self._multipliers[self._effectors.stop :] = actuation.contact.multipliers

    def correct(self, positions: np.ndarray, actuation: Actuation) -> float:
        """See `Newton.correct`; no move is longer than what was looked at, so that nothing is
        passed through unseen. What slides is moved on as well."""
        self._model.contacts.memory.remember(actuation.contact.multipliers)
        share = super().correct(positions, actuation)
        if self._model.slides is not None:
            self._model.slides.shift(positions, share * actuation.contact.moves)
        return share

    def touching(self, actuation: Actuation) -> ContactForces:
        """Contacts that carry force."""
        contacts, multipliers = self._model.contacts, actuation.contact.multipliers
        per_contact = contacts.rows_per_contact
        carrying = np.flatnonzero(multipliers[::per_contact] > CARRIES)
        forces = np.empty((len(carrying), 3))
        write_contact_forces(carrying, multipliers, contacts.directions, per_contact, forces)
        return ContactForces(
            contacts.positions[carrying], forces, contacts.gaps(self._state_after)[carrying],
            contacts.pair[carrying], self._pair_names,
        )  # fmt: skip

    def residual(self, positions: np.ndarray, actuation: Actuation) -> float:
        """See `Newton.residual`."""
        self._state_after = positions
        return super().residual(positions, actuation)
