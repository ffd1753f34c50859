"""A tangent that is positive definite where held actuators stabilise the bodies.

At prescribed displacements of its actuators a body can be stable although its tangent A at
prescribed efforts is indefinite. With the rows H of the actuators and a stiffness ρ of each row,

    (A + Hᵀ ρ H) dq = b + Hᵀ (λ + ρ H dq)

has the same solutions dq as A dq = b + Hᵀ λ. Its matrix is positive definite wherever held
actuators stabilise the body (it is the Hessian of the augmented Lagrangian; Nocedal and Wright
2006, theorem 17.5). An optimisation then solves for

    λ̂ = λ + ρ (δ - δ_ref),     δ = δ(q) + H dq,

which is λ where an actuator stays at its reference δ_ref, and b becomes b + Hᵀ ρ (δ_ref - δ(q)).

Hᵀ ρ H couples all nodes of a cable, which the pattern of A does not hold. The row of a cable is the
sum of the rows h_s of its n stretches, and n Σ h_s h_sᵀ - (Σ h_s)(Σ h_s)ᵀ is never negative. So what is
assembled is A + ρ n Σ h_s h_sᵀ, which couples only nodes that a stretch couples, and dense rows make up
for the difference (`dense_stiffness.py`), as they do for the rows of cavities, which reach hundreds of
nodes. There A itself is factorized, although it is indefinite, as LU (`AugmentedLU`). That is slower by
an order of magnitude, and needed only past limit points. The row of a hinge that a motor turns has one
entry: Hᵀ ρ H adds to the diagonal of A. Where A is dense anyway, all is added to it (`AugmentedDense`).

A cable that stretches, δ = δ(q) + H dq + C λ, is augmented by its displacement at the winch. Then

    λ = s λ̂ - ρ s (δ(q) + H dq - δ_ref),   δ - δ_ref = s (δ(q) + H dq - δ_ref) + s C λ̂,

with s = 1 / (1 + ρ C): the tangent is augmented by ρ s, which is below 1/C however large ρ is, and
the system is condensed onto the rows s H, with the compliance s C of their own.

A beam that only its motor holds has a singular A, not an indefinite one, of which a factorization may
take no notice; so a scene with motors begins with the augmented tangent, and takes A alone where this
shows that it is definite by a margin.

Where displacements are prescribed, contacts that pressed in the last solution are augmented too,
with δ_ref = 0, if the nodes of their rows are those of one facet: a body that leans on a rod may be
stable only there. In a solution 0 ≤ λ̂ ⊥ δ ≥ 0 they press by λ = λ̂, or open against a force -ρ δ
that the next linearization drops.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.cable import Cables
from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.constraints.hinge_angle import HingeAngles
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.force_term import NO_DENSE_ROWS, DenseRows
from softrobot_twin.mechanics.kinematics import add_clique, clique_slots
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.solvers.dense_stiffness import DenseStiffness, with_rows_of
from softrobot_twin.solvers.factorization import (
    Condensed,
    Factorization,
    NodeRows,
    laid_out_like,
)
from softrobot_twin.solvers.inverse_problem import Bounds
from softrobot_twin.solvers.small_cholesky import factorize
from softrobot_twin.solvers.superlu import SuperLU

# ρ as a multiple of the stiffness that the body at rest has along an actuator.
AUGMENTATION = 10.0
# Share of the augmented tangent that A must have in every direction of the motors, if it is taken
# alone.
LEAST_DEFINITE = 1.0e-6


# Where a tangent is hardly definite, efforts move the body along its softest way by so much that its
# energy decides in place of the targets, and an inverse problem is left to the augmented tangent. It
# is where the stiffness that the actuators see is below this share of ρ, and stays so up to another.
NEARLY_INDEFINITE, SAFELY_DEFINITE = 0.01, 0.02


class HeldActuators(NamedTuple):
    """Actuators whose displacements are prescribed, or whose displacements a step starts from.

    Attributes:
        drives: What they are held at: displacements [m], or efforts of what is effort-driven,
            shape (actuator_count,).
        bounds: Bounds of the step; δ_ref are the drives within them.
        reach: Bounds of the step by the hardware alone.
        is_prescribed: Whether the displacements are prescribed.
    """

    drives: np.ndarray
    bounds: Bounds
    reach: Bounds
    is_prescribed: bool


class Augmentation(NamedTuple):
    """What turns multipliers λ̂ of an augmented system into efforts λ = λ̂ - ρ (δ - δ_ref).

    Attributes:
        stiffness: ρ of each actuator row, zero where it is not augmented [N/m],
            shape (actuator_row_count,).
        reference: δ_ref [m], same shape.
        share: s = 1 / (1 + ρ C) of rows with a compliance C of their own, one for the others, same
            shape. The condensed system has the rows s H.
        acts: Whether the tangent is augmented; else ρ is zero, and multipliers are the efforts.
    """

    stiffness: np.ndarray
    reference: np.ndarray
    share: np.ndarray
    acts: bool = True

    def efforts(self, solved: np.ndarray, displacements: np.ndarray) -> np.ndarray:
        """λ of a solution [N], shape (actuator_row_count,).

        Args:
            solved: λ̂ [N], same shape.
            displacements: δ of the actuators in the solution [m], same shape.
        """
        return solved - self.stiffness * (displacements - self.reference)


class AugmentedTangent:
    """A + Hᵀ ρ H of rows of actuators; base of those of LU and dense matrices.

    Attributes:
        stiffness: ρ s of each actuator row, zero where it is not augmented [N/m],
            shape (row_count,).
        contact_stiffness: ρ of each contact, shape (contact_count,); empty where none is augmented.
        dense_rows: What is not assembled, while the augmented tangent is factorized.
        comes_first: Whether a scene begins with the augmented tangent.
        margin: Share of the augmented tangent that A alone must have to serve again.
        serves_near: Whether it serves an inverse where the tangent alone is hardly definite.
        has_kernels: Whether kernels are compiled for it alone.
    """

    comes_first, has_kernels, serves_near, margin = False, True, True, SAFELY_DEFINITE

    def __init__(
        self, rows: RowStack, factorization: Factorization, may_be_held: np.ndarray,
        own: np.ndarray | None = None, contacts: Contacts | None = None,
    ):  # fmt: skip
        """Take the rows.

        Args:
            rows: All rows; evaluated where the tangent is assembled.
            factorization: Holds the tangent A in its storage.
            may_be_held: Whether each actuator row is augmented where it holds its displacement,
                shape (row_count,).
            own: Stiffness of the bodies along the actuators, same shape; None before `measure`.
            contacts: The term of contacts that are augmented where they press; None without.
        """
        self._rows, self._factorization = rows, factorization
        self._may_be_held, self._contacts = may_be_held, contacts
        self._take(own)
        self.stiffness, self.contact_stiffness = np.zeros(len(may_be_held)), np.empty(0)
        self.dense_rows, self._share = NO_DENSE_ROWS, np.ones(len(may_be_held))
        self._stretches = any(term.yields for term in rows.terms)
        self._whole = self._with_own_rows()

    def _with_own_rows(self) -> Factorization:
        """What factorizes A with the dense rows; A's factorization where there are none."""
        if not any(isinstance(term, Cables) for term in self._rows.terms):
            return self._factorization
        return with_rows_of(self, self._factorization)

    @property
    def is_measured(self) -> bool:
        """Whether the stiffness of the bodies along their actuators is known."""
        return self._own is not None

    def measure(self, W_aa: np.ndarray) -> None:
        """Take the stiffness of the bodies along their actuators from the compliance at rest.

        Args:
            W_aa: Compliance of the actuators at rest [m/N], shape (actuator_row_count,
                actuator_row_count).
        """
        self._take(1.0 / np.maximum(W_aa.diagonal(), np.finfo(float).tiny))

    def _take(self, own: np.ndarray | None) -> None:
        """Take it, and the greatest ρ of each actuator row."""
        self._own, self._greatest = own, None
        if own is not None:
            self._greatest = AUGMENTATION * np.where(self._may_be_held, own, 0.0)

    def choose(self, efforts: np.ndarray, held: HeldActuators) -> bool:
        """Augment what holds its displacement by an effort within bounds: a taut cable that does
        not slip; also contacts that press, where displacements are prescribed.

        Args:
            efforts: Efforts of the actuators, in their units, shape (actuator_count,).
            held: What holds them.

        Returns:
            Whether there is any.
        """
        inside = (efforts > held.reach.effort_min) & (efforts < held.reach.effort_max)
        self.stiffness = np.where(inside[: len(self._greatest)], self._greatest, 0.0)
        if self._stretches:
            self.stiffness /= 1.0 + self.stiffness * self._rows.stretch_compliance()
        self.contact_stiffness, contacts = np.empty(0), self._contacts
        if contacts is not None and contacts.count and held.is_prescribed:
            pressing = self._may_be_augmented(contacts) & (contacts.last_multipliers > 0.0)
            greatest = self._own[self._may_be_held].max()
            self.contact_stiffness = np.where(pressing, AUGMENTATION * greatest, 0.0)
        return bool(self.stiffness.any() or self.contact_stiffness.any())

    def _may_be_augmented(self, contacts: Contacts) -> np.ndarray | bool:
        """Whether each contact may be augmented where it presses: where its nodes are of one facet."""
        return contacts.curvature.couples_one_facet(contacts)

    def _add(self, positions: np.ndarray, storage: np.ndarray) -> DenseRows:
        """Add to the tangent A in storage what makes it definite; gives what it lacks of Hᵀ ρ H."""
        lacking = NO_DENSE_ROWS
        for term, rows in self._rows.constant_terms:
            if self.stiffness[rows].any():
                lacking = term.add_row_stiffness(positions, self.stiffness[rows], storage) or lacking
        if self.contact_stiffness.any():
            self._contacts.curvature.add_row_stiffness(
                self._contacts, self.contact_stiffness, storage
            )
        return lacking

    def factor(self, positions: np.ndarray) -> bool:
        """Factorize the augmented tangent, from the tangent A in storage.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Whether what is assembled is positive definite.
        """
        self.dense_rows = self._add(positions, self._factorization.storage)
        is_definite = self._whole.factor()
        self.dense_rows = NO_DENSE_ROWS
        return is_definite

    def clear_dense_rows(self) -> None:
        """Nothing: there are some only while it is factorized."""

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> None:
        """None: W is formed as a whole; see `Factorization.condense_low_rank`."""

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """W and the free violations of the augmented tangent; see `Factorization.condense`.

        Raises:
            numpy.linalg.LinAlgError: The augmented tangent is not positive definite.
        """
        if self._stretches:
            of_row = np.ones(H.row_count)
            of_row[: len(self._share)] = self._share
            H = H._replace(blocks=H.blocks * of_row[H.row_index, None])
        return self._whole.condense(H, b)

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """The displacement for multipliers λ̂ of the condensed rows; see `Factorization`."""
        return self._whole.expand(multipliers)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """(A + Hᵀ ρ H)⁻¹ b after `condense`, shape (free_node_count, 3); see `Factorization`."""
        return self._whole.solve(b)

    def augmentation(self, displacements: np.ndarray) -> Augmentation:
        """What turns λ̂ into λ.

        Args:
            displacements: δ_ref of all actuators [m], shape (actuator_count,).
        """
        reference = displacements[: len(self.stiffness)]
        if self._stretches:
            # The compliance may have changed since the tangent was augmented by ρ s.
            self._share = 1.0 - self.stiffness * self._rows.stretch_compliance()
        return Augmentation(self.stiffness / self._share, reference, self._share)

    def contact_shift(self, gaps: np.ndarray) -> np.ndarray:
        """-ρ δ(q) of the contacts [N].

        Args:
            gaps: δ(q) of their rows [m], shape (count,).
        """
        if not len(self.contact_stiffness):
            return np.zeros(len(gaps))
        return -self.contact_stiffness * gaps

    def is_near(self, W: np.ndarray) -> bool:
        """Whether the tangent without the augmentation is definite by too little for an inverse.

        Args:
            W: Its compliance [m/N], rows of actuators first, shape (row_count, row_count).
        """
        return self.serves_near and is_soft(W, self._greatest)

    def is_needed(self, W: np.ndarray, first_contact: int) -> bool:
        """Whether the tangent without the augmentation is indefinite, or nearly.

        Args:
            W: Compliance of the augmented tangent [m/N], shape (row_count, row_count).
            first_contact: First row of the contacts.
        """
        rows, root = self._augmented_rows(first_contact)
        if self._stretches:
            # Of cables that stretch, that of their paths.
            count = len(self._share)
            of_row = np.ones(len(W))
            of_row[:count] = self._share
            W = W.copy()
            W.ravel()[: count * (len(W) + 1) : len(W) + 1] -= self._share * self._rows.stretch_compliance()
            W /= np.outer(of_row, of_row)
        return not is_below(W, rows, root, 1.0 - self.margin)

    def _augmented_rows(self, first_contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of actuators and contacts that may be augmented, and √ρ of each."""
        contacts = first_contact + np.arange(len(self.contact_stiffness))
        rows = np.concatenate([np.arange(len(self.stiffness)), contacts])
        return rows, np.sqrt(np.concatenate([self.stiffness, self.contact_stiffness]))


@njit(**KERNEL)
def is_below(W, rows, root, limit):
    """Whether all eigenvalues of √ρ W √ρ of some rows are below a limit.

    Args:
        W: Compliance [m/N], shape (m, m).
        rows: The rows, shape (n,).
        root: √ρ of each [(N/m)^½], shape (n,).
        limit: The limit.
    """
    n = len(rows)
    left = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            left[i, j] = -root[i] * W[rows[i], rows[j]] * root[j]
        left[i, i] += limit
    return factorize(left, 0.0)


class AugmentedLU(AugmentedTangent):
    """A + Hᵀ ρ H of actuators of any kind, by an LU of A; see `AugmentedTangent` for the methods."""

    has_kernels = serves_near = False

    def _with_own_rows(self) -> Factorization:
        """Made where it is needed first."""
        self._lu = self._places = None
        return self._factorization

    def factor(self, positions: np.ndarray) -> bool:
        """Factorize A; False only where it is singular."""
        if self._lu is None:
            # The place of each of its entries in the other storage.
            self._lu, self._places = laid_out_like(self._factorization, SuperLU)
            self._whole = with_rows_of(self, self._lu)
        self._lu.storage[:] = self._factorization.storage[self._places]
        rows, held = self._rows, np.flatnonzero(self.stiffness)
        own = np.isin(rows.row_index, held)
        self.dense_rows = DenseRows(
            np.searchsorted(held, rows.row_index[own]), rows.node_index[own], rows.blocks[own],
            self.stiffness[held],
        )  # fmt: skip
        return self._whole.factor()

    def is_needed(self, W: np.ndarray, first_contact: int) -> bool:
        """Whether A is indefinite."""
        return self._lu.negative_count != 0


@njit(**KERNEL)
def write_squared_rows(row_index, node_index, blocks, stiffness, H, matrix):
    """Write Σ k h hᵀ of the rows h.

    Args:
        row_index: Row of each entry, shape (entry_count,).
        node_index: Unknown of each entry, same shape.
        blocks: Derivative by that unknown, shape (entry_count, 3).
        stiffness: k of each row [N/m], shape (row_count,); only positive k count.
        H: Takes the rows, shape (row_count, dof_count).
        matrix: Takes the sum [N/m], shape (dof_count, dof_count).
    """
    H[:] = 0.0
    matrix[:] = 0.0
    for e in range(len(row_index)):
        for i in range(3):
            H[row_index[e], 3 * node_index[e] + i] += blocks[e, i]
    for r in range(len(H)):
        for j in range(H.shape[1]):
            factor = max(stiffness[r], 0.0) * H[r, j]
            if factor != 0.0:
                for i in range(H.shape[1]):
                    matrix[j, i] += factor * H[r, i]


class AugmentedDense(AugmentedTangent):
    """A + Hᵀ ρ H of actuators of any kind, where A has no zeros; see `AugmentedTangent` for the methods.
    """

    def _with_own_rows(self) -> Factorization:
        rank = self._factorization.elimination_rank
        self._places = clique_slots(np.arange(len(rank)), rank, self._factorization.slots)
        self._matrix = np.empty((3 * len(rank), 3 * len(rank)))
        return self._factorization

    def _may_be_augmented(self, contacts: Contacts) -> np.ndarray | bool:
        return True

    def _add(self, positions: np.ndarray, storage: np.ndarray) -> DenseRows:
        """Add Hᵀ ρ H."""
        rows, matrix = self._rows, self._matrix
        H, stiffness = np.empty((rows.row_count, len(matrix))), np.zeros(rows.row_count)
        stiffness[rows.groups.actuators] = self.stiffness
        if len(self.contact_stiffness):
            stiffness[rows.groups.contacts] = self.contact_stiffness
        write_squared_rows(rows.row_index, rows.node_index, rows.blocks, stiffness, H, matrix)
        add_clique(*self._places, matrix, storage)
        return NO_DENSE_ROWS


class AugmentedHinges(AugmentedTangent):
    """A + Hᵀ ρ H of motors that turn hinges; see `AugmentedTangent` for the methods.

    The stiffness of the bodies along motors is known from the beams.
    """

    comes_first, serves_near, margin = True, False, LEAST_DEFINITE


@njit(**KERNEL)
def is_soft(W, stiffness):
    """Whether a body yields to its actuators by more than 1 / `NEARLY_INDEFINITE` times 1/ρ.

    Args:
        W: Compliance, the rows of the actuators first [m/N], shape (m, m).
        stiffness: ρ of each actuator [N/m], shape (n,).
    """
    most, total = 1.0 / NEARLY_INDEFINITE, 0.0
    for i in range(len(stiffness)):
        total += W[i, i] * stiffness[i]
    # No eigenvalue is above their sum.
    return total >= most and not is_below(W, np.arange(len(stiffness)), np.sqrt(stiffness), most)


def augmented_tangent_of(model: Model) -> AugmentedTangent | None:
    """The augmented tangent of a scene with cables, given volumes or angles.

    None with friction along cables: at held lengths equilibria are not minima of an energy.

    Args:
        model: The model of a simulation.
    """
    rows, actuators, factorization = model.rows, model.actuators, model.factorization
    count = actuators.row_count
    is_cable, is_motor, own = np.zeros(count, bool), np.zeros(count, bool), np.zeros(count)
    for term, its_rows in rows.constant_terms:
        if isinstance(term, Cables):
            is_cable[its_rows] = True
        elif isinstance(term, HingeAngles):
            is_motor[its_rows], own[its_rows] = True, term.stiffness
    if is_motor.any():
        return AugmentedHinges(rows, factorization, is_motor, own)
    contacts = model.contacts if rows.varies and model.contacts.conserves else None
    is_held = ~actuators.is_effort_driven[:count]
    may_be_held = is_held & ~(rows.stretch_compliance() > 0.0)
    if model.is_dense:
        if not count or not actuators.conserves:
            return None
        return AugmentedDense(rows, factorization, may_be_held, contacts=contacts)
    needs_lu = bool((is_held & ~actuators.one_sided[:count]).any())
    if rows.reaches_carried_points:
        # The rows of cables at points of frames are not those that cables write.
        needs_lu = needs_lu or not model.is_dynamic and actuators.conserves
        if not (needs_lu and is_held.any()):
            return None
    if needs_lu:
        is_plain = not isinstance(factorization, DenseStiffness)
        return AugmentedLU(rows, factorization, may_be_held) if is_plain else None
    if not is_cable.any() or not actuators.conserves:
        return None
    if contacts is not None and contacts.curvature is None:
        contacts = None
    return AugmentedTangent(rows, factorization, is_cable, contacts=contacts)
