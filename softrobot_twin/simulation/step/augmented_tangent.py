"""A tangent that is positive definite where held actuators stabilise the bodies.

At prescribed displacements of its actuators a body can be stable although its tangent A at
prescribed efforts is indefinite. With the rows H of the actuators and a stiffness ρ of each row,

    (A + Hᵀ ρ H) dq = b + Hᵀ (λ + ρ H dq)

has the same solutions dq as A dq = b + Hᵀ λ. Its matrix is positive definite wherever held
actuators stabilise the body (it is the Hessian of the augmented Lagrangian; Nocedal and Wright,
Numerical Optimization, 2006, theorem 17.5). An optimisation then solves for

    λ̂ = λ + ρ (δ - δ_ref),     δ = δ(q) + H dq,

which is λ where an actuator stays at its reference δ_ref, and b becomes b + Hᵀ ρ (δ_ref - δ(q)).

Hᵀ ρ H couples all nodes of a cable, which the pattern of A does not hold. The row of a cable is the
sum of the rows h_s of its n stretches, and n Σ h_s h_sᵀ - (Σ h_s)(Σ h_s)ᵀ is never negative and has
the rank n - 1. So what is factorized is

    B = A + ρ n Σ h_s h_sᵀ,      A + Hᵀ ρ H = B - Sᵀ U Uᵀ S,     U = √(ρ n) Q

with the rows S of all stretches and an orthonormal basis Q of what is orthogonal to (1, …, 1). B
couples only nodes that a stretch couples. The Woodbury identity subtracts the second part from the
condensed system, and the whole is positive definite exactly where I - Uᵀ (S B⁻¹ Sᵀ) U is.

A cable that stretches, δ = δ(q) + H dq + C λ, is augmented by its displacement at the winch. Then

    λ = s λ̂ - ρ s (δ(q) + H dq - δ_ref),   δ - δ_ref = s (δ(q) + H dq - δ_ref) + s C λ̂,

with s = 1 / (1 + ρ C): the tangent is augmented by ρ s, which is below 1/C however large ρ is, and
the system is condensed onto the rows s H, with the compliance s C of their own.

The row of a cavity reaches hundreds of nodes. So where volumes are prescribed, A itself is factorized,
although it is indefinite, as LU (`AugmentedLU`), and the Woodbury identity adds Hᵀ ρ H. That is
slower by an order of magnitude, and needed only past limit points.

The row of a hinge that a motor turns has one entry: Hᵀ ρ H adds to the diagonal of A, and needs
nothing else (`AugmentedHinges`). Nor does it where A is dense anyway (`AugmentedDense`). A beam that only its motor holds has a singular A, not an
indefinite one, of which a factorization may take no notice; so a scene with motors begins with the
augmented tangent, and takes A alone where this shows that it is definite by a margin.

Where displacements are prescribed, contacts that pressed in the last solution are augmented too,
with δ_ref = 0, if the nodes of their rows are those of one facet: a body that leans on a rod may be
stable only there. In a solution 0 ≤ λ̂ ⊥ δ ≥ 0 they press by λ = λ̂, or open against a force -ρ δ
that the next linearization drops.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.compilation import INNER, KERNEL, njit
from softrobot_twin.constraints.cable import Cables
from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.constraints.hinge_angle import HingeAngles
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.mechanics.kinematics import add_clique, clique_slots
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.solvers.dense_stiffness import DenseStiffness
from softrobot_twin.solvers.factorization import (
    Condensed,
    Factorization,
    NodeRows,
    laid_out_like,
)
from softrobot_twin.solvers.small_cholesky import backward, factorize, forward
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
        displacements: δ_ref [m], shape (actuator_count,).
        effort_min: Least efforts [N], same shape.
        effort_max: Greatest efforts [N], same shape.
        is_prescribed: Whether the displacements are prescribed.
    """

    displacements: np.ndarray
    effort_min: np.ndarray
    effort_max: np.ndarray
    is_prescribed: bool = True


class Augmentation(NamedTuple):
    """What turns multipliers λ̂ of an augmented system into efforts λ = λ̂ - ρ (δ - δ_ref).

    Attributes:
        stiffness: ρ of each actuator row, zero where it is not augmented [N/m],
            shape (actuator_row_count,).
        reference: δ_ref [m], same shape.
        share: s = 1 / (1 + ρ C) of rows with a compliance C of their own, one for the others, same
            shape; None without any. The condensed system has the rows s H.
    """

    stiffness: np.ndarray
    reference: np.ndarray
    share: np.ndarray | None = None

    def efforts(self, solved: np.ndarray, displacements: np.ndarray) -> np.ndarray:
        """λ of a solution [N], shape (actuator_row_count,).

        Args:
            solved: λ̂ [N], same shape.
            displacements: δ of the actuators in the solution [m], same shape.
        """
        return solved - self.stiffness * (displacements - self.reference)


class AugmentedRows:
    """A + Hᵀ ρ H of rows of actuators, by a factor of A with what `_add` adds; base of the others.

    Where that is another matrix B = A + Hᵀ ρ H - Sᵀ C S, the Woodbury identity makes up for the low
    rank: (A + Hᵀ ρ H)⁻¹ b = B⁻¹ (b + Sᵀ (…) S B⁻¹ b), with S and (…) in `_low_rank`.

    Attributes:
        stiffness: ρ of each actuator row, zero where it is not augmented, shape (row_count,).
        contact_stiffness: ρ of each contact, shape (contact_count,); empty where none is augmented.
        comes_first: Whether a scene begins with the augmented tangent.
        margin: Share of the augmented tangent that A alone must have to serve again.
        serves_near: Whether it serves an inverse where the tangent alone is hardly definite.
        has_kernels: Whether kernels are compiled for it alone.
    """

    comes_first, has_kernels, serves_near, margin = False, True, True, SAFELY_DEFINITE

    def __init__(
        self, factorization: Factorization, may_be_held: np.ndarray, own: np.ndarray | None = None,
        contacts: Contacts | None = None,
    ):  # fmt: skip
        """Take the rows.

        Args:
            factorization: Holds the tangent A in its storage.
            may_be_held: Whether each actuator row is augmented where it holds its displacement,
                shape (row_count,).
            own: Stiffness of the bodies along the actuators, same shape; None before `measure`.
            contacts: The term of contacts that are augmented where they press; None without.
        """
        self._factorization, self._may_be_held, self._own = factorization, may_be_held, own
        self._contacts, self._low_rank = contacts, None
        self.rows = slice(0, len(may_be_held))
        self.stiffness, self.contact_stiffness = np.zeros(len(may_be_held)), np.empty(0)

    @property
    def is_measured(self) -> bool:
        """Whether the stiffness of the bodies along their actuators is known."""
        return self._own is not None

    def measure(self, W_aa: np.ndarray) -> None:
        """Take the stiffness of the bodies along their actuators from the compliance at rest."""
        self._own = 1.0 / np.maximum(W_aa.diagonal()[self.rows], np.finfo(float).tiny)

    def choose(self, efforts: np.ndarray, held: HeldActuators) -> bool:
        """Augment what holds its displacement by an effort within bounds: a taut cable that does
        not slip; also contacts that press, where displacements are prescribed.

        Args:
            efforts: Efforts of the actuators, in their units, shape (actuator_count,).
            held: What holds them.

        Returns:
            Whether there is any.
        """
        a = self.rows
        inside = (efforts[a] > held.effort_min[a]) & (efforts[a] < held.effort_max[a])
        self.stiffness = np.where(inside & self._may_be_held, AUGMENTATION * self._own, 0.0)
        self.contact_stiffness, contacts = np.empty(0), self._contacts
        if contacts is not None and contacts.count and held.is_prescribed:
            pressing = self._may_be_augmented(contacts) & (contacts.last_multipliers > 0.0)
            self.contact_stiffness = np.where(pressing, AUGMENTATION * self._own.max(), 0.0)
        return bool(self.stiffness.any() or self.contact_stiffness.any())

    def _may_be_augmented(self, contacts: Contacts) -> np.ndarray | bool:
        """Whether each contact may be augmented where it presses."""
        return True

    def _add(self, positions: np.ndarray, storage: np.ndarray) -> None:
        """Add to the tangent A in storage what makes it definite."""

    def factor(self, positions: np.ndarray) -> bool:
        """Factorize the augmented tangent, from the tangent A in storage.

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Whether what is factorized is positive definite.
        """
        self._add(positions, self._factorization.storage)
        return self._factorization.factor()

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> None:
        """None: W is formed as a whole; see `Factorization.condense_low_rank`."""

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """W and the free violations of the augmented tangent; see `Factorization.condense`.

        Raises:
            numpy.linalg.LinAlgError: The augmented tangent is not positive definite.
        """
        return self._factorization.condense(H, b)

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """The displacement for multipliers λ̂ of the condensed rows; see `Factorization`."""
        return self._factorization.expand(multipliers)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """(A + Hᵀ ρ H)⁻¹ b after `condense`, shape (free_node_count, 3); see `Factorization`."""
        found = self._factorization.solve(b)
        if self._low_rank is None:
            return found
        S, loads_of = self._low_rank
        moved = np.einsum("ij,ij->i", S.blocks, found[S.node_index])
        loads, forces = loads_of(np.bincount(S.row_index, moved, S.row_count)), np.array(b)
        np.add.at(forces, S.node_index, S.blocks * loads[S.row_index, None])
        return self._factorization.solve(forces)

    def augmentation(self, held: HeldActuators, row_count: int) -> Augmentation:
        """What turns λ̂ into λ.

        Args:
            held: What holds the actuators.
            row_count: Number of actuator rows.
        """
        return Augmentation(self.stiffness, held.displacements[:row_count])

    def contact_shift(self, gaps: np.ndarray) -> np.ndarray:
        """-ρ δ(q) of the contacts [N].

        Args:
            gaps: δ(q) of their rows [m], shape (count,).
        """
        if not len(self.contact_stiffness):
            return np.zeros(len(gaps))
        return -self.contact_stiffness * gaps

    def is_near(self, W_aa: np.ndarray) -> bool:
        """Whether the tangent without the augmentation is definite by too little for an inverse.

        Args:
            W_aa: Its compliance of the actuators [m/N], shape (actuator_row_count,) twice.
        """
        stiffness = np.where(self._may_be_held, AUGMENTATION * self._own, 0.0)
        return self.serves_near and _is_soft(W_aa[self.rows, self.rows], stiffness)

    def is_needed(self, W: np.ndarray, first_contact: int) -> bool:
        """Whether the tangent without the augmentation is indefinite, or nearly.

        Args:
            W: Compliance of the augmented tangent [m/N], shape (row_count, row_count).
            first_contact: First row of the contacts.
        """
        rows, root = self._augmented_rows(first_contact)
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


@njit(**INNER)
def _sum_stretches(values, of, share, more, sums):
    """Add rows of stretches, times the shares of their cables, to rows of cables; others follow.

    Args:
        values: A number for each stretch and each other row, shape (m,).
        of: Cable of each stretch, shape (stretch_count,).
        share: Factor of each cable, shape (cable_count,).
        more: Number of stretches less that of cables.
        sums: Takes a number for each cable and each other row, shape (m - more,).
    """
    sums[: len(share)] = 0.0
    for s in range(len(of)):
        sums[of[s]] += share[of[s]] * values[s]
    for i in range(len(of), len(values)):
        sums[i - more] = values[i]


@njit(**INNER)
def _squares_of_sums(of, stiffness, m):
    """U = √(ρ n) Q, with orthonormal columns Q that are orthogonal to (1, …, 1), shape (m, k).

    Args:
        of: Cable of each stretch, ascending, shape (stretch_count,).
        stiffness: ρ s of each cable [N/m], shape (cable_count,).
        m: Number of rows, those of the stretches first.
    """
    U, columns, first = np.zeros((m, len(of))), 0, 0
    while first < len(of):
        stop = first
        while stop < len(of) and of[stop] == of[first]:
            stop += 1
        n, rho = stop - first, stiffness[of[first]]
        for k in range(1, n if rho != 0.0 else 1):
            scale = np.sqrt(rho * n / (k * (k + 1.0)))
            for i in range(k):
                U[first + i, columns] = scale
            U[first + k, columns] = -k * scale
            columns += 1
        first = stop
    return U[:, :columns].copy()


@njit(**KERNEL)
def without_squared_stretches(G, free, of, stiffness, share, row_count):
    """Subtract Sᵀ U Uᵀ S from a tangent by the Woodbury identity; see the top of this file.

    Args:
        G: Compliance by B of the rows S of all stretches, then of the other rows [m/N],
            shape (m, m).
        free: Their free violations [m], shape (m,).
        of: Cable of each stretch, ascending, shape (stretch_count,).
        stiffness: ρ s of each cable [N/m], shape (cable_count,).
        share: s of each cable, same shape.
        row_count: Rows n in which stretches are summed to cables.

    Returns:
        Whether the whole is positive definite; W of the n rows [m/N], shape (n, n); their free
        violations [m], shape (n,); then U, shape (m, k), and with C = I - Uᵀ G U = L Lᵀ: L, shape
        (k, k), Z = L⁻¹ Uᵀ G, shape (k, m), and z = L⁻¹ Uᵀ δ_free, shape (k,).
    """
    m, stretches = len(free), len(of)
    U = _squares_of_sums(of, stiffness, m)
    more, columns = m - row_count, U.shape[1]
    Z, z, L = np.zeros((columns, m)), np.zeros(columns), np.zeros((columns, columns))
    W, sums, loose = np.empty((row_count, row_count)), np.empty(row_count), free.copy()
    for c in range(columns):
        for s in range(stretches):
            if U[s, c] != 0.0:
                z[c] += U[s, c] * free[s]
                for i in range(m):
                    Z[c, i] += U[s, c] * G[s, i]
        for d in range(c + 1):
            for s in range(stretches):
                L[c, d] -= U[s, d] * Z[c, s]
        L[c, c] += 1.0
    if not factorize(L, 0.0):
        return False, W, sums, U, L, Z, z
    forward(L, z)
    column = np.empty(columns)
    for i in range(m):
        for c in range(columns):
            column[c] = Z[c, i]
        forward(L, column)
        for c in range(columns):
            Z[c, i] = column[c]
            loose[i] += column[c] * z[c]
    summed, row = np.empty((m, row_count)), np.empty(m)
    for i in range(m):
        for j in range(m):
            row[j] = G[i, j]
            for c in range(columns):
                row[j] += Z[c, i] * Z[c, j]
        _sum_stretches(row, of, share, more, summed[i])
    for j in range(row_count):
        for i in range(m):
            row[i] = summed[i, j]
        _sum_stretches(row, of, share, more, sums)
        for i in range(row_count):
            W[i, j] = sums[i]
    for i in range(row_count):
        for j in range(i):
            W[i, j] = W[j, i] = 0.5 * (W[i, j] + W[j, i])
    _sum_stretches(loose, of, share, more, sums)
    return True, W, sums, U, L, Z, z


@njit(**KERNEL)
def loads_of_stretches(multipliers, of, share, U, L, Z, z):
    """Multipliers of the rows by which B is expanded, shape (m,).

    Args:
        multipliers: λ̂ of the condensed rows [N], shape (n,).
        of: This and the following: see `without_squared_stretches`.
        share: See there.
        U: See there.
        L: See there.
        Z: See there.
        z: See there.
    """
    m, columns = U.shape
    more, loads, y = m - len(multipliers), np.empty(m), z.copy()
    for s in range(len(of)):
        loads[s] = share[of[s]] * multipliers[of[s]]
    for i in range(len(of), m):
        loads[i] = multipliers[i - more]
    for c in range(columns):
        for i in range(m):
            y[c] += Z[c, i] * loads[i]
    backward(L, y)
    for i in range(m):
        for c in range(columns):
            loads[i] += U[i, c] * y[c]
    return loads


class AugmentedTangent(AugmentedRows):
    """A + Hᵀ ρ H of cables, seen from constraint rows, by a factor of B.

    Attributes:
        rows: The rows of the cables among all rows, and their places among all actuators.
        stiffness: ρ s of each cable, zero where it is not augmented [N/m], shape (cable_count,).
    """

    def __init__(
        self, cables: Cables, factorization: Factorization, contacts: Contacts | None = None
    ):
        """Lay out the stretches.

        Args:
            cables: The term of the cables, whose rows are the first of all.
            factorization: Holds the factor of B when the system is condensed.
            contacts: The term of contacts with round shapes, without friction; else None.
        """
        super().__init__(factorization, np.ones(cables.row_count, bool), contacts=contacts)
        self._cables, self._share = cables, np.ones(cables.row_count)
        self._stretches = cables.yields

    def choose(self, efforts: np.ndarray, held: HeldActuators) -> bool:
        """See `AugmentedRows`."""
        holds = super().choose(efforts, held)
        if self._stretches:
            own_compliance = self._cables.compliance.diagonal()
            self.stiffness /= 1.0 + self.stiffness * own_compliance
        return holds

    def _may_be_augmented(self, contacts: Contacts) -> np.ndarray:
        """Those whose nodes are of one facet."""
        return contacts.curvature.couples_one_facet(contacts)

    def _add(self, positions: np.ndarray, storage: np.ndarray) -> None:
        """Add ρ n Σ h_s h_sᵀ to the system matrix."""
        of = self._cables.cable_of_stretch
        counts = np.bincount(of, minlength=len(self.stiffness))
        self._cables.add_row_stiffness(positions, (self.stiffness * counts)[of], storage)
        if self.contact_stiffness.any():
            self._contacts.curvature.add_row_stiffness(
                self._contacts, self.contact_stiffness, storage
            )

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """W and the free violations of the augmented tangent; see `Factorization.condense`.

        Args:
            H: All rows, those of the cables first.
            b: Forces on the unknowns [N], shape (free_node_count, 3).

        Raises:
            numpy.linalg.LinAlgError: The augmented tangent is not positive definite.
        """
        of, cables = self._cables.cable_of_stretch, len(self.stiffness)
        more = len(of) - cables
        own = self._cables.stretch_of_entry
        rows = np.concatenate([own, H.row_index[len(own) :] + more])
        count = H.row_count + more
        found = self._factorization.condense(NodeRows(rows, H.node_index, H.blocks, count), b)
        is_definite, W, free, *self._subtracted = without_squared_stretches(
            found.W, found.free, of, self.stiffness, self._share, H.row_count
        )
        if not is_definite:
            raise np.linalg.LinAlgError("held cables do not stabilise the bodies")
        entries = len(own)
        stretches = NodeRows(own, H.node_index[:entries], H.blocks[:entries], count)
        self._low_rank = (stretches, self._stretch_loads) if self._subtracted[0].size else None
        return Condensed(W, free)

    def _stretch_loads(self, moved: np.ndarray) -> np.ndarray:
        """U C⁻¹ Uᵀ of what moves by B⁻¹ b; see `without_squared_stretches`."""
        U, L, _, _ = self._subtracted
        return U @ np.linalg.solve(L.T, np.linalg.solve(L, U.T @ moved))

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """The displacement for multipliers λ̂ of the condensed rows [N]; see `Factorization`."""
        of = self._cables.cable_of_stretch
        return self._factorization.expand(
            loads_of_stretches(multipliers, of, self._share, *self._subtracted)
        )

    def augmentation(self, held: HeldActuators, row_count: int) -> Augmentation:
        """What turns λ̂ into λ.

        Args:
            held: What holds the actuators.
            row_count: Number of actuator rows; those of the cables come first.
        """
        stiffness, reference = np.zeros(row_count), held.displacements[:row_count]
        stiffness[self.rows] = self.stiffness
        if not self._stretches:
            return Augmentation(stiffness, reference)
        share = np.ones(row_count)
        # The compliance may have changed since the tangent was augmented by ρ s.
        self._share = 1.0 - self.stiffness * self._cables.compliance.diagonal()
        share[self.rows] = self._share
        return Augmentation(stiffness / share, reference, share)

    def is_needed(self, W: np.ndarray, first_contact: int) -> bool:
        """See `AugmentedRows`; of cables that stretch, that of their paths."""
        if not self._stretches:
            return super().is_needed(W, first_contact)
        rows, root = self._augmented_rows(first_contact)
        compliance = W[np.ix_(rows, rows)]
        own, share = self.rows, np.ones(len(rows))
        share[own] = self._share
        compliance[own, own] -= self._share[:, None] * self._cables.compliance
        compliance /= np.outer(share, share)
        return not is_below(compliance, np.arange(len(rows)), root, 1.0 - self.margin)


class AugmentedLU(AugmentedRows):
    """A + Hᵀ ρ H of actuators of any kind, by an LU of A; see `AugmentedTangent` for the methods.

    It has the same number of negative eigenvalues as A less those of 1/ρ + H A⁻¹ Hᵀ (the inertia of
    [[A, Hᵀ], [H, -1/ρ]] from both sides; Nocedal and Wright, section 16.3).
    """

    has_kernels = serves_near = False

    def __init__(self, factorization: Factorization, may_be_held: np.ndarray):
        """See `AugmentedRows`."""
        super().__init__(factorization, may_be_held)
        self._tangent, self._places = factorization, None

    def factor(self, positions: np.ndarray) -> bool:
        """Factorize A; False only where it is singular."""
        if self._places is None:
            # The place of each of its entries in the other storage.
            self._factorization, self._places = laid_out_like(self._tangent, SuperLU)
        self._factorization.storage[:] = self._tangent.storage[self._places]
        self._factorization.factor()
        return self._factorization.negative_count is not None

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """See `AugmentedTangent.condense`."""
        found = self._factorization.condense(H, b)
        self._k = np.flatnonzero(self.stiffness)
        G = found.W[:, self._k]
        M = np.diag(1.0 / self.stiffness[self._k]) + G[self._k]
        eigenvalues, vectors = np.linalg.eigh(M)
        if np.count_nonzero(eigenvalues < 0.0) != self._factorization.negative_count:
            raise np.linalg.LinAlgError("held actuators do not stabilise the bodies")
        inverse = vectors / eigenvalues @ vectors.T
        self._of_multipliers, self._of_forces = inverse @ G.T, inverse @ found.free[self._k]
        self._low_rank = H, self._loads_of_held
        self._inverse = inverse
        W = found.W - G @ self._of_multipliers
        return Condensed(0.5 * (W + W.T), found.free - G @ self._of_forces)

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """The displacement for multipliers λ̂ of the condensed rows; see `Factorization`."""
        loads = multipliers.copy()
        loads[self._k] -= self._of_forces + self._of_multipliers @ multipliers
        return self._factorization.expand(loads)

    def _loads_of_held(self, moved: np.ndarray) -> np.ndarray:
        """-(1/ρ + H A⁻¹ Hᵀ)⁻¹ of what moves by A⁻¹ b, zero for rows that are not augmented."""
        loads = np.zeros(len(moved))
        loads[self._k] = -self._inverse @ moved[self._k]
        return loads

    def is_needed(self, W: np.ndarray, first_contact: int) -> bool:
        """Whether A is indefinite."""
        return self._factorization.negative_count != 0


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


class AugmentedDense(AugmentedRows):
    """A + Hᵀ ρ H of actuators of any kind, where A has no zeros; see `AugmentedTangent` for the methods.
    """

    def __init__(
        self, rows: RowStack, contacts: Contacts | None, factorization: Factorization,
        may_be_held: np.ndarray,
    ):  # fmt: skip
        """Take the rows.

        Args:
            rows: All rows; evaluated where the tangent is assembled.
            contacts: The term of contacts without friction; else None.
            factorization: Holds the tangent A in its storage.
            may_be_held: See `AugmentedRows`.
        """
        super().__init__(factorization, may_be_held, contacts=contacts)
        rank = factorization.elimination_rank
        self._rows, self._places = rows, clique_slots(np.arange(len(rank)), rank, factorization.slots)
        self._matrix = np.empty((3 * len(rank), 3 * len(rank)))

    def _add(self, positions: np.ndarray, storage: np.ndarray) -> None:
        """Add Hᵀ ρ H."""
        rows, matrix = self._rows, self._matrix
        H, stiffness = np.empty((rows.row_count, len(matrix))), np.zeros(rows.row_count)
        stiffness[rows.groups.actuators] = self.stiffness
        if len(self.contact_stiffness):
            stiffness[rows.groups.contacts] = self.contact_stiffness
        write_squared_rows(rows.row_index, rows.node_index, rows.blocks, stiffness, H, matrix)
        add_clique(*self._places, matrix, storage)


class AugmentedHinges(AugmentedRows):
    """A + Hᵀ ρ H of motors that turn hinges; see `AugmentedTangent` for the methods.

    The stiffness of the bodies along motors is known from the beams.
    """

    comes_first, serves_near, margin = True, False, LEAST_DEFINITE

    def __init__(
        self, motors: HingeAngles, rows: slice, row_count: int, factorization: Factorization
    ):
        """Take the rows.

        Args:
            motors: The term of the motors.
            rows: Its rows among all.
            row_count: Number of actuator rows.
            factorization: Holds the tangent A in its storage.
        """
        self._motors, self._motor_rows = motors, rows
        is_motor, own = np.zeros(row_count, bool), np.zeros(row_count)
        is_motor[rows], own[rows] = True, motors.stiffness
        super().__init__(factorization, is_motor, own)

    def _add(self, positions: np.ndarray, storage: np.ndarray) -> None:
        """Add Hᵀ ρ H."""
        self._motors.add_row_stiffness(self.stiffness[self._motor_rows], storage)


def _is_soft(W: np.ndarray, stiffness: np.ndarray) -> bool:
    """Whether a body yields to its actuators by more than 1 / `NEARLY_INDEFINITE` times 1/ρ.

    Args:
        W: Compliance of the actuators [m/N], shape (n, n).
        stiffness: ρ of each [N/m], shape (n,).
    """
    most = 1.0 / NEARLY_INDEFINITE
    # No eigenvalue is above their sum.
    if float(W.diagonal() @ stiffness) < most:
        return False
    return not is_below(np.ascontiguousarray(W), np.arange(len(W)), np.sqrt(stiffness), most)


def augmented_tangent_of(model: Model) -> AugmentedRows | None:
    """The augmented tangent of a scene with cables, given volumes or angles.

    None with friction along cables: at held lengths equilibria are not minima of an energy.
    """
    rows, actuators, factorization = model.rows, model.actuators, model.factorization
    count, first = actuators.row_count, 0
    for term in actuators.terms:
        own = slice(first, first + term.row_count)
        first = own.stop
        if isinstance(term, HingeAngles):
            return AugmentedHinges(term, own, count, factorization)
    contacts = model.contacts if rows.varies and model.contacts.conserves else None
    is_held = ~actuators.is_effort_driven[:count]
    stretch = rows.stretch_compliance()
    may_be_held = is_held if stretch is None else is_held & ~(stretch > 0.0)
    if model.is_dense:
        if not count or not actuators.conserves:
            return None
        return AugmentedDense(rows, contacts, factorization, may_be_held)
    needs_lu = bool((is_held & ~actuators.one_sided[:count]).any())
    if rows.reaches_carried_points:
        # The rows of cables at points of frames are not those that cables write.
        needs_lu = needs_lu or not model.is_dynamic and actuators.conserves
        if not (needs_lu and is_held.any()):
            return None
    if needs_lu:
        is_plain = not isinstance(factorization, DenseStiffness)
        return AugmentedLU(factorization, may_be_held) if is_plain else None
    if not rows.terms or not isinstance(rows.terms[0], Cables) or not actuators.conserves:
        return None
    if contacts is not None and contacts.curvature is None:
        contacts = None
    return AugmentedTangent(rows.terms[0], factorization, contacts)
