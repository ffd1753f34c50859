"""A linearization that is condensed to the contacts which are expected to press.

Condensing takes a time that grows with the square of the rows. Of many contacts that are watched
some stay open: they have no part in the solution, only their gaps have to stay. So the contacts
that pressed before, or overlap, are condensed and solved; the gaps of the others follow from the
corrected motion, H dq (Coevoet 2017, eq. 15), without their compliance. What would cross is taken
in, and solved again.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.solvers.factorization import Factorization, NodeRows

# Fewer rows, or a smaller share of contacts that are left out, are not worth the check.
FEWEST_ROWS, LEAST_SHARE = 100, 0.02


class PressingContacts:
    """Rows of actuators and of some contacts, condensed; the other contacts open.

    Attributes:
        chosen: Contacts that are condensed, ascending.
        cables: The actuators' rows.
        W: Compliance of the actuators and of the chosen contacts [m/N], shape (k, k).
        violation: Their δ without multipliers [m], shape (k,).
        rows: Rows of H that are condensed, shape (k,).
        contact_rows: Those of the chosen contacts, counted from the first contact's.
        slide_positions: Empty: there are no slides, shape (0,).
    """

    slide_positions = np.empty(0)

    def __init__(
        self, factorization: Factorization, H: NodeRows, forces: np.ndarray, values: np.ndarray,
        cables: slice, first: int, per_contact: int, pressing: np.ndarray,
    ):  # fmt: skip
        """Condense.

        Args:
            factorization: A⁻¹.
            H: All rows: actuators, effectors, contacts.
            forces: b [N], shape (node_count, 3).
            values: δ of all rows at the state [m], shape (row_count,).
            cables: The actuators' rows.
            first: The first contact's row.
            per_contact: Rows of a contact.
            pressing: Which contacts are expected to press, shape (contact_count,).
        """
        self._factorization, self._H, self._forces = factorization, H, forces
        self._values, self._first, self._per_contact = values, first, per_contact
        self.cables, self._is_chosen = cables, pressing.copy()
        self._condense()

    def _condense(self) -> None:
        H, first, per_contact = self._H, self._first, self._per_contact
        self.chosen = np.flatnonzero(self._is_chosen)
        self.contact_rows = (per_contact * self.chosen[:, None] + range(per_contact)).ravel()
        self.rows = np.concatenate([np.arange(self.cables.stop), first + self.contact_rows])
        place = np.full(H.row_count, -1)
        place[self.rows] = np.arange(len(self.rows))
        lane = place[H.row_index]
        kept = lane >= 0
        part = NodeRows(lane[kept], H.node_index[kept], H.blocks[kept], len(self.rows))
        condensed = self._factorization.condense(part, self._forces)
        self.W, self.violation = condensed.W, self._values[self.rows] + condensed.free

    def take(self, contacts: np.ndarray) -> None:
        """Condense these contacts too.

        Args:
            contacts: True for each that is taken, shape (contact_count,).
        """
        self._is_chosen |= contacts
        self._condense()

    def gaps(self, multipliers: np.ndarray) -> np.ndarray:
        """δ_n of every contact that is not chosen after the correction, +∞ for the chosen [m].

        Args:
            multipliers: λ of the rows that are condensed [N], shape (k,).
        """
        H, move = self._H, self._factorization.expand(multipliers)
        gaps = np.full(len(self._is_chosen), np.inf)
        contact, row = np.divmod(H.row_index - self._first, self._per_contact)
        entries = np.flatnonzero((contact >= 0) & (row == 0))
        entries = entries[~self._is_chosen[contact[entries]]]
        moved = np.einsum("ij,ij->i", H.blocks[entries], move[H.node_index[entries]])
        opened = np.flatnonzero(~self._is_chosen)
        gaps[opened] = self._values[self._first + self._per_contact * opened]
        np.add.at(gaps, contact[entries], moved)
        return gaps

    def path_shortening(self, tensions: np.ndarray, contact_multipliers: np.ndarray) -> np.ndarray:
        """Shortening of each actuator's path [m], shape (actuator_count,).

        Args:
            tensions: λ of the actuators [N].
            contact_multipliers: λ of all contacts' rows [N]; zero where they are open.
        """
        a = self.cables
        multipliers = np.concatenate([tensions[a], contact_multipliers[self.contact_rows]])
        return self.W[a] @ multipliers + self.violation[a]


def worth_leaving_out(pressing: np.ndarray, per_contact: int) -> bool:
    """Whether leaving out what is not expected to press saves more than the check costs.

    Args:
        pressing: Which contacts are expected to press, shape (contact_count,).
        per_contact: Rows of a contact.
    """
    count = len(pressing)
    left_out = count - np.count_nonzero(pressing)
    return per_contact * count > FEWEST_ROWS and LEAST_SHARE * count < left_out < count
