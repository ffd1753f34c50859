"""The system condensed onto its constraints, around one state (Coevoet 2017, eq. 11-14).

    δ = W λ + δ_free,   W = H A⁻¹ Hᵀ,   δ_free = δ(q) + H A⁻¹ b

over named groups of rows: actuators, effectors, contacts. A group that a scene does not name has no
rows; so a scene without contact is the same condensed system with an empty group.

Rows that yield to their efforts by themselves add their own compliance
C to W; where their values are those at the told efforts λ₀, -C λ₀ to δ_free. So do rows of the
effectors that show contact forces.

The time of condensing grows with the square of the rows. Of many contacts within the alarm
distance, some stay open: they have no force, and only their gaps must stay positive. So the rows
that are condensed can be chosen: those of contacts that pressed before, or overlap. The gaps of the
others follow from the corrected motion, H dq (eq. 15), without their compliance; contacts that
would penetrate are added, and the problem is solved again.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.row_stack import RowGroups, RowStack
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.step.augmented_tangent import Augmentation
from softrobot_twin.solvers.compliance import Compliance
from softrobot_twin.solvers.factorization import Condensed, Factorization, NodeRows

# With fewer rows, or a smaller share of omitted contacts, the check costs more than it saves.
FEWEST_ROWS, LEAST_SHARE = 100, 0.02
# A contact whose gap is below this share of the alarm distance may press in a step.
CLOSE = 0.002
# Where friction makes the compliance of a cable's path far less than that of its forces, W has at
# least this share of the latter.
LEAST_SYMMETRIC = 0.02


@njit(**KERNEL)
def row_motion(W, first, stop, efforts, violation):
    """δ of some rows under the efforts of actuators [m], shape (stop - first,).

    Args:
        W: Compliance, the rows of the actuators first [m/N], shape (n, n).
        first: The first row.
        stop: The first row after them.
        efforts: λ of the actuators [N], shape (actuator_row_count,).
        violation: δ_free of all rows [m], shape (n,).
    """
    moved = np.empty(stop - first)
    for r in range(first, stop):
        total = 0.0
        for j in range(len(efforts)):
            total += W[r, j] * efforts[j]
        moved[r - first] = total + violation[r]
    return moved


@njit(**KERNEL)
def with_moves(W, free, first, displacements, columns):
    """W and δ_free with a row and a column for each slide.

    A slide is where it is prescribed to be: no force moves it, and it moves all that rides.

    Args:
        W: Compliance without slides [m/N], shape (n, n).
        free: δ_free of its rows [m], shape (n,).
        first: Row before which those of the slides stand.
        displacements: δ of each slide [m], shape (move_count,).
        columns: Change of all rows by their displacements, shape (n, move_count).
    """
    n, count = len(W), len(displacements)
    grown, violation = np.zeros((n + count, n + count)), np.empty(n + count)
    for i in range(n):
        row = i if i < first else i + count
        violation[row] = free[i]
        for j in range(n):
            grown[row, j if j < first else j + count] = W[i, j]
        if i >= first:
            for k in range(count):
                grown[row, first + k] = columns[i, k]
    for k in range(count):
        grown[first + k, first + k] = 1.0
        violation[first + k] = displacements[k]
    return grown, violation


@njit(**KERNEL)
def add_compliance(W, free, own, told):
    """Add a compliance of the first rows, and what it yields by at told efforts.

    Args:
        W: Compliance of all rows [m/N], shape (n, n); added to.
        free: δ_free less δ of all rows [m], shape (n,); added to.
        own: C of the first rows [m/N], shape (m, m).
        told: λ₀ of these rows [N], shape (m,).
    """
    yielded = np.dot(own, told)
    for i in range(len(own)):
        free[i] -= yielded[i]
        for j in range(len(own)):
            W[i, j] += own[i, j]


class PrescribedMoves(NamedTuple):
    """Actuators whose unknown is their displacement, such as slides.

    Attributes:
        displacements: δ of each [m], shape (move_count,).
        columns: Change of all rows by their displacements, shape (row_count, move_count).
    """

    displacements: np.ndarray
    columns: np.ndarray


NO_MOVES = PrescribedMoves(np.empty(0), np.empty((0, 0)))
NOT_AUGMENTED = Augmentation(*np.empty((3, 0)), acts=False)


class Linearized:
    """The condensed system around one state.

    Attributes:
        compliance: W of the condensed rows [m/N].
        violation: δ_free of the condensed rows [m], shape (n,).
        groups: The condensed rows of each group.
        is_whole: Whether all rows are condensed.
        rows: Indices of the condensed rows, shape (n,), or a slice of all.
        chosen: Condensed contacts, ascending, or a slice of all.
        contact_rows: Rows of these, counted from the first contact's.
        augmentation: Relation between multipliers of the actuators and their efforts.
        move_count: Number of slides, the last of the actuators; their multipliers are their
            displacements from the state.
        stored: W of the energy of the multipliers, where it is not `W`; else None.
        ties: T and t of a system whose multipliers follow from fewer; else empty.
    """

    stored: np.ndarray | None = None
    ties: tuple[np.ndarray, ...] = ()

    def __init__(
        self, factorization: Factorization, stack: RowStack, forces: np.ndarray,
        moves: PrescribedMoves = NO_MOVES, row_starts: np.ndarray | None = None,
        pressing: np.ndarray | None = None, augmentation: Augmentation = NOT_AUGMENTED,
        multipliers: np.ndarray | None = None,
    ):  # fmt: skip
        """Condense the rows evaluated last.

        Args:
            factorization: A⁻¹, or the augmented tangent in its place.
            stack: All rows at the state.
            forces: b [N], shape (free_node_count, 3).
            moves: The slides.
            row_starts: First row of each contact and the number of all rows, shape
                (contact_count + 1,); None if no contact may be omitted.
            pressing: Contacts that are expected to press, if the others may be omitted, shape
                (contact_count,); None to condense all rows.
            augmentation: Relation between the multipliers of the tangent and efforts.
            multipliers: λ of all rows at the state, shape (row_count,); needed where cables have
                friction.
        """
        self.augmentation = augmentation
        self._factorization, self._forces = factorization, forces
        self._H = NodeRows(stack.row_index, stack.node_index, stack.blocks, stack.row_count)
        self._values, self._all, self._moves = stack.values.copy(), stack.groups, moves
        self.move_count = len(moves.displacements)
        self._own, self._told, self._shown = stack.own_compliance(), stack.told, stack.by_contacts()
        self._row_starts = row_starts
        self._has_contacts = stack.groups.contacts.stop > stack.groups.contacts.start
        self._paths, self._present = stack.displacement_rows(), multipliers
        self._is_chosen: np.ndarray | None = None
        self._placed_by = self._places = None
        if not self._condense_low_rank():
            if pressing is None:
                self._condense_all()
            else:
                self._is_chosen = pressing.copy()
                self._condense_chosen()

    def _condense_low_rank(self) -> bool:
        """Store the factor of W, if few unknowns carry all rows of contacts."""
        if not self.contact_row_count or self._shown or self._own is not None:
            return False
        condensed = self._factorization.condense_low_rank(self._H, self._forces)
        if condensed is None:
            return False
        self._take_in(Compliance(Yt=condensed.Yt), condensed.free)
        return True

    def _condense_all(self) -> None:
        if self._paths is None:
            condensed = self._factorization.condense(self._H, self._forces)
        else:
            condensed = self._condense_with_friction()
        free = self._add_own(condensed.W, condensed.free)
        if self._shown:
            self._show_forces(condensed.W, free)
        self._take_in(Compliance(condensed.W), free)

    def _show_forces(self, W: np.ndarray, free: np.ndarray) -> None:
        """Write rows of contact forces: the force of a pair in metres, less the gap that closes most easily.

        One of both is zero. So actuators bring a pair together that is apart.
        """
        (rows, columns), contacts = self._shown, self._all.contacts
        free[rows] -= self._values[rows]
        W[rows, contacts] += columns
        yielding, gaps = W.diagonal()[contacts], self._values[contacts]
        for row, shares in zip(range(rows.start, rows.stop), columns, strict=True):
            own = np.flatnonzero((shares > 0.0) & (yielding > 0.0))
            if len(own):
                first = contacts.start + own[np.argmin(gaps[own] / yielding[own])]
                W[row] -= W[first]
                free[row] -= free[first]
                self._values[row] -= self._values[first]

    def _add_moves(self) -> None:
        """Add rows and columns of the slides behind those of the other actuators."""
        (a, e, c), count = self._all, self.move_count
        W, self.violation = with_moves(self.W, self.violation, a.stop, *self._moves)
        self.compliance = Compliance(W)
        self.groups = RowGroups(
            slice(0, a.stop + count), slice(e.start + count, e.stop + count),
            slice(c.start + count, c.stop + count),
        )  # fmt: skip
        if self.augmentation.acts:
            stiffness, reference, share, _ = self.augmentation
            self.augmentation = Augmentation(
                np.pad(stiffness, (0, count)), np.pad(reference, (0, count)),
                np.pad(share, (0, count), constant_values=1.0),
            )  # fmt: skip

    def _condense_with_friction(self) -> Condensed:
        """W and the free motion where rows D of displacements are not those of forces, H.

        D A⁻¹ Hᵀ is not symmetric. In its place W is S H A⁻¹ Hᵀ S, with the diagonal S that gives it
        the same diagonal; what that changes at the present multipliers λ₀ is in the free motion. So
        the condensed system is exact at λ₀, and W positive semidefinite. Effectors, which have no
        multipliers, keep their rows.
        """
        H, D, count = self._H, self._paths, self._H.row_count
        found = self._factorization.condense(NodeRows(
            np.concatenate([H.row_index, count + D.row_index]),
            np.concatenate([H.node_index, D.node_index]), np.concatenate([H.blocks, D.blocks]),
            count + len(D.actuators),
        ), self._forces)  # fmt: skip
        true, free = found.W[:count, :count].copy(), found.free[:count].copy()
        own = true.diagonal()[D.actuators]
        true[D.actuators] = found.W[count:, :count]
        free[D.actuators] = found.free[count:]
        scale, wanted = np.ones(count), true.diagonal()[D.actuators]
        shares = np.divide(wanted, own, out=np.ones(len(own)), where=own > 0.0)
        scale[D.actuators] = np.sqrt(np.maximum(shares, LEAST_SYMMETRIC))
        W = found.W[:count, :count] * np.outer(scale, scale)
        e = self._all.effectors
        W[e] = found.W[e, :count]
        W[:, e] = W[e].T
        change = (true - W) @ np.where(np.isfinite(self._present), self._present, 0.0)
        change[e] = 0.0
        return Condensed(W, free + change)

    def _add_own(self, W: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Add the compliance of rows that yield by themselves to W; gives the free motion."""
        if self._own is None:
            return free
        a, own = self._all.actuators, self._own
        if self.augmentation.acts:
            _, reference, share, _ = self.augmentation
            own = own * share[:, None]
            free = free.copy()
            free[a] += (share - 1.0) * (self._values[a] - reference)
        add_compliance(W, free, own, np.zeros(len(own)) if self._told is None else self._told)
        return free

    def _take_in(self, compliance: Compliance, free: np.ndarray) -> None:
        self.compliance, self.violation = compliance, self._values + free
        self.groups, self.is_whole = self._all, True
        self.rows = self.chosen = self.contact_rows = slice(None)
        if self.move_count:
            self._of_rows = compliance
            self._add_moves()

    def _condense_chosen(self) -> None:
        """Condense the actuators' rows and those of the chosen contacts."""
        H, first, actuators = self._H, self._all.contacts.start, self._all.actuators
        self.is_whole, self.chosen = False, np.flatnonzero(self._is_chosen)
        self.contact_rows = np.flatnonzero(np.repeat(self._is_chosen, np.diff(self._row_starts)))
        self.rows = np.concatenate([np.arange(actuators.stop), first + self.contact_rows])
        place = np.full(H.row_count, -1)
        place[self.rows] = np.arange(len(self.rows))
        row_index = place[H.row_index]
        kept = row_index >= 0
        part = NodeRows(row_index[kept], H.node_index[kept], H.blocks[kept], len(self.rows))
        condensed = self._factorization.condense(part, self._forces)
        free = self._add_own(condensed.W, condensed.free)
        self.compliance = Compliance(condensed.W)
        self.violation = self._values[self.rows] + free
        count = actuators.stop
        self.groups = RowGroups(actuators, slice(count, count), slice(count, len(self.rows)))

    @property
    def contact_row_count(self) -> int:
        """Rows of all contacts, whether they are condensed or not."""
        return self._all.contacts.stop - self._all.contacts.start

    @property
    def W(self) -> np.ndarray:
        """Compliance of the condensed rows as a matrix [m/N], shape (n, n)."""
        return self.compliance.W

    @property
    def W_aa(self) -> np.ndarray:
        """Actuator displacement by effort [m/N], shape (actuator_row_count, same)."""
        return self.W[self.groups.actuators, self.groups.actuators]

    @property
    def W_ea(self) -> np.ndarray:
        """Effector displacement by effort [m/N], shape (effector_row_count, actuator_row_count)."""
        return self.W[self.groups.effectors, self.groups.actuators]

    @property
    def actuators(self) -> np.ndarray:
        """δ_a,free: actuator displacements without multipliers [m]."""
        return self.violation[self.groups.actuators]

    @property
    def effectors(self) -> np.ndarray:
        """δ_e,free: effector coordinates without multipliers [m]."""
        return self.violation[self.groups.effectors]

    @property
    def effectors_now(self) -> np.ndarray:
        """Effector coordinates at the state itself [m], shape (effector_row_count,)."""
        return self._values[self._all.effectors]

    def of_actuators_and_contacts(self, moves: np.ndarray) -> tuple[Compliance, np.ndarray]:
        """Compliance and δ_free of the actuators but slides, then of the condensed contacts.

        Args:
            moves: Displacements of the slides from the state [m], shape (move_count,).

        Returns:
            W and δ, which is a copy.
        """
        first, stop = self.groups.actuators.stop - self.move_count, self.groups.contacts.start
        violation = np.concatenate([self.violation[:first], self.violation[stop:]])
        if not self.move_count:
            return self.compliance.without(first, stop), violation
        violation[first:] += self.W[stop:, first : first + self.move_count] @ moves
        return self._of_rows.without(first, stop - self.move_count), violation

    def actuator_displacements(self, efforts: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """δ_a under multipliers [m], shape (actuator_row_count,).

        Args:
            efforts: λ of the actuators [N], shape (actuator_count,).
            contact: λ of all contact rows [N]; zero where they are open.
        """
        return self._displacements(self.groups.actuators, efforts, contact)

    def _displacements(self, rows: slice, efforts: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """δ of some condensed rows under multipliers; see `actuator_displacements`."""
        a = self.groups.actuators
        if not self._has_contacts:
            return row_motion(self.compliance.W, rows.start, rows.stop, efforts[a], self.violation)
        multipliers = np.zeros(len(self.violation))
        multipliers[a] = efforts[a]
        multipliers[self.groups.contacts] = contact[self.contact_rows]
        return self.compliance.motion(rows, multipliers) + self.violation[rows]

    def efforts(self, multipliers: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """λ_a of the multipliers of a solution [N], shape (actuator_row_count,).

        Args:
            multipliers: Those of the actuators; efforts, but for an augmented tangent [N].
            contact: λ of all contact rows [N]; zero where they are open.
        """
        if not self.augmentation.acts:
            return multipliers
        path = self.actuator_displacements(multipliers, contact)
        return self.augmentation.efforts(multipliers, path)

    def effector_places(self, efforts: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """δ_e under multipliers [m], shape (effector_row_count,); see `actuator_displacements`.

        Without contacts, those of the efforts that were asked for last are known.
        """
        if self._has_contacts or efforts is not self._placed_by:
            self._placed_by = efforts
            self._places = self._displacements(self.groups.effectors, efforts, contact)
        return self._places

    def open_gaps(self, multipliers: np.ndarray) -> np.ndarray:
        """δ_n of each contact that is not condensed, +∞ for the others [m].

        Args:
            multipliers: λ of the condensed rows [N], shape (n,).
        """
        H, move = self._H, self._factorization.expand(multipliers)
        normals = self._all.contacts.start + self._row_starts[:-1]
        opened = np.flatnonzero(~self._is_chosen)
        gaps = np.full(len(self._is_chosen), np.inf)
        gaps[opened] = self._values[normals[opened]]
        contact = np.full(H.row_count, -1)
        contact[normals[opened]] = opened
        entries = np.flatnonzero(contact[H.row_index] >= 0)
        moved = np.einsum("ij,ij->i", H.blocks[entries], move[H.node_index[entries]])
        np.add.at(gaps, contact[H.row_index[entries]], moved)
        return gaps

    def with_violation(self, violation: np.ndarray) -> Linearized:
        """The same system, whose rows begin elsewhere.

        Args:
            violation: δ_free of the condensed rows [m], shape (n,).
        """
        other = copy(self)
        other.violation, other._placed_by = violation, None
        return other

    def tied(self, rows: np.ndarray, ties: np.ndarray, offset: np.ndarray) -> Linearized:
        """The same system in fewer multipliers z, from which all follow: λ = T z + t.

        Args:
            rows: Condensed rows that are left, those of contacts the last, shape (m,).
            ties: T, shape (n, m).
            offset: t [N], shape (n,).

        Returns:
            The system, of which nothing but W, δ_free, `ties` (T and t) and what follows is of use.
        """
        tied, (a, e, c), W = copy(self), self.groups, self.W @ ties
        tied.compliance, tied.stored = Compliance(W[rows]), ties.T @ W
        tied.violation, tied.ties = self.violation[rows] + self.W[rows] @ offset, (ties, offset)
        left = len(rows) - c.start
        tied.groups = RowGroups(a, e, slice(c.start, len(rows)))
        first = self._all.contacts.start
        tied._all = self._all._replace(contacts=slice(first, first + left))
        return tied

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """A⁻¹ (b + Hᵀλ), shape (free_node_count, 3); the next call may overwrite it.

        Args:
            multipliers: λ of all rows, zero for those that are not condensed [N],
                shape (row_count,).
        """
        condensed = multipliers if self.is_whole else multipliers[self.rows]
        if self._paths is not None:
            condensed = np.concatenate([condensed, np.zeros(len(self._paths.actuators))])
        return self._factorization.expand(condensed)

    def take(self, contacts: np.ndarray) -> None:
        """Condense these contacts in addition.

        Args:
            contacts: True for each that is added, shape (contact_count,).
        """
        self._is_chosen |= contacts
        self._condense_chosen()


class LinearizedState(NamedTuple):
    """A linearized state, and how it was linearized.

    Attributes:
        linear: The condensed system.
        solver: A⁻¹, or the augmented tangent in its place.
        forces: b of the condensed system [N], shape (free_node_count, 3).
        positions: Node positions [m], shape (node_count, 3).
        efforts: λ₀ of the actuators there, shape (actuator_row_count,).
    """

    linear: Linearized
    solver: Factorization
    forces: np.ndarray
    positions: np.ndarray
    efforts: np.ndarray


def expected_to_press(contacts, gaps: np.ndarray) -> np.ndarray | None:
    """Contacts that pressed in the last solution or have a small gap.

    Args:
        contacts: The contact term.
        gaps: δ of its rows at the state [m], shape (contact_row_count,).

    Returns:
        True for each such contact, shape (contact_count,); None if omitting the others would save
        less than the check of their gaps costs.
    """
    if len(gaps) <= FEWEST_ROWS:
        return None
    normals = contacts.row_starts[:-1]
    pressing = (contacts.last_multipliers[normals] > 0.0) | (gaps[normals] < CLOSE * contacts.margin)
    return pressing if worth_leaving_out(pressing) else None


def worth_leaving_out(pressing: np.ndarray) -> bool:
    """Whether omitting the other contacts saves more than the check of their gaps costs.

    Args:
        pressing: Contacts that are expected to press, shape (contact_count,).
    """
    count = len(pressing)
    left_out = count - np.count_nonzero(pressing)
    return LEAST_SHARE * count < left_out < count
