"""Coulomb friction of cables at the points of their paths: the capstan equation, with stick and slip.

Where a path turns by the angle β over a point, the tension falls in the direction in which the cable
slips. With the tension T_0 = λ at the winch,

    T_s = T_(s-1) exp(-µ β_s z_s),    -1 ≤ z_s ≤ 1.

z_s is the share of the friction that acts: 1 where the cable slips to the winch, -1 where it slips
away from it, and between them where it sticks. Rate does not matter. The length that passed the point
to the winch since the step began is u_s = U_s(begin) - U_s, with the unstretched length U_s beyond
the point, and

    z_s = min(max(z_s(begin) + u_s / s_0, -1), 1).

The presliding s_0 [m] is how far the cable moves over a point until friction that was absent acts
wholly (the Prandtl element of an elastic-plastic bristle). It regularises sticking of a cable that
does not stretch. Where the cable stretches, U_s depends on its tensions, and these on z:

    U_s = Σ_(r ≥ s) ℓ_r (1 - ε_r),    ε_r = T_r / (EA + T_r),

so that a cable slips over points that do not move. With the diagonal D = µ β, D times the equations for
z is the slope of a convex function of z. So they have one solution, which Newton's method with bounds
finds from any state.

The shares z are part of the state: they say in which direction each point slipped last, so that a
loop of pulling and releasing closes. The tensions depend on the positions through z too. Of that
dependence the tangent takes the symmetric part

    Σ_sr g_s L_sp X_pq L_rq g_r h_s h_rᵀ,    X = (s_0 / D + K)⁻¹ of sticking points,  g² = T (1 - ε),

which is exact where the tensions beyond a point are alike; L sums over the points before a segment.
It couples all points of a cable, and is given as dense rows. The change of the angles β in a step is
in the forces, but not in the tangent.

The rows of forces, t_s h_s with t = ∂T/∂λ, differ from the rows of shortenings, e_s h_s: friction has
no potential. `Linearized` makes the condensed system symmetric, and exact at its own state.

Arguments of the kernels here that tell of a path are as in `cable`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.cable import CablePath, add_stiffness_kernel, write_matrices
from softrobot_twin.constraints.elastic_cable import ElasticCables
from softrobot_twin.constraints.row_stack import add_row_forces
from softrobot_twin.geometry.vector3 import cross, divided, dot, norm
from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.mechanics.force_term import DenseRows, ForceTerm
from softrobot_twin.mechanics.kinematics import CarriedPoints, CarriedRows
from softrobot_twin.mechanics.springs import segment_vector

# Iterations of Newton's method, halvings of a step that does not lower the potential enough, and
# changes of the active set by point.
MOST_ITERATIONS, MOST_HALVINGS, MOST_SETS = 100, 40, 10
# Least share of the promised decrease (Armijo), and a share of the potential's parts below which no
# decrease can be told from round-off.
DECREASE, EPSILON = 1.0e-4, 1.0e-12
# A change of z, and a miss as a share of the cable's length, that counts as none.
ROUND_OFF = 1.0e-14
# A share this near to its bound is on it.
BOUND = 1.0e-12


@njit(**KERNEL)
def write_turns(x, nodes, coefficients, constants, least, rounding, cable, lengths, angles):
    """Length of each segment, and the angle by which the path turns where it begins.

    A segment without length has no direction: the path turns from the segment before to the segment
    after.

    Args:
        cable: Cable of each segment, ascending, shape (segment_count,).
        lengths: Takes the lengths [m], shape (segment_count,).
        angles: Takes the angles β [rad], zero where a cable begins, same shape.
    """
    last = (0.0, 0.0, 0.0)
    has_last = False
    for s in range(len(nodes)):
        if s == 0 or cable[s] != cable[s - 1]:
            has_last = False
        r = segment_vector(x, nodes[s], coefficients[s], constants[s])
        length = norm(r)
        angles[s] = 0.0
        if length > least:
            d = divided(r, length)
            if has_last:
                angles[s] = np.arctan2(norm(cross(last, d)), dot(last, d))
            last = d
            has_last = True
        if length < rounding[s]:
            length = 0.5 * (length * length / rounding[s] + rounding[s])
        lengths[s] = length


@njit(**KERNEL)
def write_tensions(winch, friction, flexibility, angles, shares, tensions, strains):
    """Tensions and strains along one cable, at given shares of friction.

    Args:
        winch: Tension λ where the cable begins [N].
        friction: Coefficient µ.
        flexibility: 1/EA [1/N].
        angles: β of each segment [rad], shape (segment_count,).
        shares: z of each segment, -1 to 1, same shape.
        tensions: Takes T [N], same shape.
        strains: Takes the strains ε, same shape.
    """
    tension = winch
    for s in range(len(angles)):
        tension *= np.exp(-friction * angles[s] * shares[s])
        tensions[s] = tension
        strains[s] = tension * flexibility / (1.0 + tension * flexibility)


@njit(**KERNEL)
def write_beyond(lengths, strains, beyond):
    """Unstretched length from the beginning of each segment of one cable on.

    Args:
        lengths: Of the segments [m], shape (segment_count,).
        strains: ε of the segments, same shape.
        beyond: Takes the unstretched lengths [m], same shape.
    """
    total = 0.0
    for s in range(len(lengths) - 1, -1, -1):
        total += lengths[s] * (1.0 - strains[s])
        beyond[s] = total


@njit(**ONCE)
def write_slopes(lengths, angles, tensions, flexibility, friction, presliding, slopes):
    """∂F/∂z of one cable, F = s_0 (z - z_begin) - u: s_0 + K D; its first segment has no point.

    Args:
        lengths: Of the segments [m], shape (segment_count,).
        angles: β of each segment [rad], same shape.
        tensions: T of each segment [N], same shape.
        flexibility: 1/EA [1/N].
        friction: Coefficient µ.
        presliding: s_0 [m].
        slopes: Takes ∂F/∂z [m] but for the first row and column, shape (segment_count,
            segment_count).
    """
    n = len(lengths)
    yielding = 0.0
    for s in range(n - 1, 0, -1):
        strain_slope = flexibility / (1.0 + tensions[s] * flexibility) ** 2
        yielding += lengths[s] * strain_slope * tensions[s]
        for q in range(1, s + 1):
            slopes[s, q] = yielding * friction * angles[q]
            slopes[q, s] = yielding * friction * angles[s]
    for s in range(1, n):
        slopes[s, s] += presliding


@njit(**ONCE)
def write_misses(shares, begin_shares, beyond, begin_beyond, presliding, misses):
    """F of each point of one cable.

    Args:
        shares: z of each segment, shape (segment_count,).
        begin_shares: z where the step began, same shape.
        beyond: Unstretched length from each segment on [m], same shape.
        begin_beyond: This length where the step began [m], same shape.
        presliding: s_0 [m].
        misses: Takes F [m], same shape; its first entry is left as it is.
    """
    for s in range(1, len(shares)):
        misses[s] = presliding * (shares[s] - begin_shares[s]) - (begin_beyond[s] - beyond[s])


@njit(**INNER)
def potential(winch, lengths, turns, flexibility, presliding, begin_shares, begin_beyond, shares):
    """Convex function of z whose slopes are D F: s_0 D (z²/2 - z_begin z) - D U_begin z + Ψ.

    Ψ = Σ ℓ ln(exp(a) + λ / EA) with a_s = Σ_(p ≤ s) D_p z_p, whose slope in z_p is D_p U_p.

    Args:
        winch: Tension λ where the cable begins [N].
        lengths: ℓ of the segments [m], shape (segment_count,).
        turns: D = µ β of each segment, same shape.
        flexibility: 1/EA [1/N].
        presliding: s_0 [m].
        begin_shares: z where the step began, same shape as `lengths`.
        begin_beyond: U there [m], same shape.
        shares: z, same shape.

    Returns:
        The potential [m], and the sum of the magnitudes of its parts [m]. The parts may cancel;
        their round-off remains.
    """
    total, size, a = 0.0, 0.0, 0.0
    for s in range(len(lengths)):
        z = shares[s]
        a += turns[s] * z
        slid = turns[s] * z * (presliding * (0.5 * z - begin_shares[s]) - begin_beyond[s])
        # ln(exp(a) + c) without overflow.
        if a > 0.0:
            stretched = lengths[s] * (a + np.log1p(winch * flexibility * np.exp(-a)))
        else:
            stretched = lengths[s] * np.log(winch * flexibility + np.exp(a))
        total += slid + stretched
        size += abs(slid) + abs(stretched)
    return total, size


@njit(**ONCE)
def bounded_change(shares, misses, slopes, turns, round_off, change):
    """Newton's change of the shares of one cable within their bounds, by a primal active set.

    It minimises the quadratic model of the potential over -1 ≤ z + change ≤ 1 (Nocedal and Wright
    2006, section 16.5).

    Args:
        shares: z, as the other arrays of shape (segment_count,).
        misses: F [m].
        slopes: ∂F/∂z [m], shape (segment_count, segment_count).
        turns: D = µ β; a share where it is zero is left as it is.
        round_off: A miss that counts as none [m].
        change: Takes the change.
    """
    n = len(shares)
    held = np.ones(n, np.bool_)
    change[:] = 0.0
    for s in range(1, n):
        if turns[s] > 0.0:
            held[s] = (shares[s] >= 1.0 and misses[s] <= 0.0) or (shares[s] <= -1.0 and misses[s] >= 0.0)
    for _ in range(MOST_SETS * n):
        places = np.flatnonzero(~held)
        J, right = np.empty((len(places), len(places))), np.empty(len(places))
        for i in range(len(places)):
            p = places[i]
            right[i] = -misses[p]
            for q in range(1, n):
                if held[q]:
                    right[i] -= slopes[p, q] * change[q]
            for k in range(len(places)):
                J[i, k] = slopes[p, places[k]]
        wanted = np.linalg.solve(J, right)
        length, blocking = 1.0, -1
        for i in range(len(places)):
            p = places[i]
            room = (1.0 if wanted[i] > change[p] else -1.0) - shares[p] - change[p]
            move = wanted[i] - change[p]
            if abs(move) * length > abs(room):
                length, blocking = abs(room) / abs(move), p
        for i in range(len(places)):
            change[places[i]] += length * (wanted[i] - change[places[i]])
        if blocking >= 0:
            end = 1.0 if shares[blocking] + change[blocking] > 0.0 else -1.0
            change[blocking] = end - shares[blocking]
            held[blocking] = True
            continue
        released, most = -1, round_off
        for p in range(1, n):
            if held[p] and turns[p] > 0.0:
                slope = misses[p]
                for q in range(1, n):
                    slope += slopes[p, q] * change[q]
                inwards = slope if shares[p] + change[p] > 0.0 else -slope
                if inwards > most:
                    released, most = p, inwards
        if released < 0:
            break
        held[released] = False


@njit(**ONCE)
def solve_shares(
    winch, lengths, angles, friction, flexibility, presliding, begin_shares, begin_beyond, shares,
    tensions, strains, beyond,
):
    """Shares z of one cable, and its tensions, strains and unstretched lengths.

    By Newton's method within the bounds of z, with a line search on the potential.

    Args:
        winch: Tension λ where the cable begins [N].
        lengths: ℓ of the segments [m], shape (segment_count,).
        angles: β of each segment [rad], same shape.
        friction: Coefficient µ.
        flexibility: 1/EA [1/N].
        presliding: s_0 [m].
        begin_shares: z where the step began, same shape as `lengths`.
        begin_beyond: Unstretched length from each segment on where the step began [m], same shape.
        shares: z to begin with; takes the solution, same shape.
        tensions: Takes T [N], same shape.
        strains: Takes ε, same shape.
        beyond: Takes the unstretched length from each segment on [m], same shape.
    """
    n = len(lengths)
    slopes, misses, change = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    turns, tried = friction * angles, np.zeros(n)
    round_off = ROUND_OFF * lengths.sum()
    for _ in range(MOST_ITERATIONS):
        write_tensions(winch, friction, flexibility, angles, shares, tensions, strains)
        write_beyond(lengths, strains, beyond)
        write_misses(shares, begin_shares, beyond, begin_beyond, presliding, misses)
        write_slopes(lengths, angles, tensions, flexibility, friction, presliding, slopes)
        bounded_change(shares, misses, slopes, turns, round_off, change)
        slope, largest = 0.0, 0.0
        for s in range(1, n):
            slope += turns[s] * misses[s] * change[s]
            largest = max(largest, abs(change[s]))
        if largest <= ROUND_OFF:
            break
        now, size = potential(
            winch, lengths, turns, flexibility, presliding, begin_shares, begin_beyond, shares
        )
        length = 1.0
        for _ in range(MOST_HALVINGS):
            for s in range(n):
                z = shares[s] + length * change[s]
                if abs(z) > 1.0 - BOUND:
                    z = 1.0 if z > 0.0 else -1.0
                tried[s] = z
            then, _ = potential(
                winch, lengths, turns, flexibility, presliding, begin_shares, begin_beyond, tried
            )
            if then <= now + DECREASE * length * slope or -slope <= EPSILON * size:
                break
            length *= 0.5
        for i in range(len(shares)):
            shares[i] = tried[i]
    write_tensions(winch, friction, flexibility, angles, shares, tensions, strains)
    write_beyond(lengths, strains, beyond)
    # Where the path does not turn, no tension depends on z.
    for s in range(1, n):
        if turns[s] == 0.0:
            slid = begin_shares[s] + (begin_beyond[s] - beyond[s]) / presliding
            shares[s] = min(max(slid, -1.0), 1.0)
    shares[0] = 0.0


@njit(**ONCE)
def write_rates(
    winch, lengths, angles, friction, flexibility, presliding, shares, tensions, strains,
    force_slopes, length_slopes, stick,
):
    """How the tensions of one cable change, at a solution of `solve_shares`.

    Args:
        winch: λ [N]; the arguments up to `strains` are those of the solution.
        force_slopes: Takes t = ∂T/∂λ of each segment.
        length_slopes: Takes e of each segment: ∂δ/∂q = Σ e h.
        stick: Takes g L C of each point and segment, with C Cᵀ = X [√(N/m)], shape (n, n).

    Returns:
        ∂δ/∂λ at held positions [m/N].
    """
    n = len(lengths)
    stick[:] = 0.0
    strain_slopes = np.empty(n)
    for s in range(n):
        strain_slopes[s] = flexibility / (1.0 + tensions[s] * flexibility) ** 2
        force_slopes[s] = tensions[s] / winch if winch > 0.0 else ratio_at(s, friction, angles, shares)
        length_slopes[s] = 1.0 - strains[s]
    inside = np.zeros(n, np.bool_)
    for s in range(1, n):
        inside[s] = abs(shares[s]) < 1.0 and friction * angles[s] > 0.0 and tensions[s] > 0.0
    points = np.flatnonzero(inside)
    m = len(points)
    if m:
        R = np.empty((m, m))
        for i in range(m):
            for j in range(m):
                yielding = 0.0
                for s in range(max(points[i], points[j]), n):
                    yielding += lengths[s] * strain_slopes[s] * tensions[s]
                R[i, j] = yielding
            R[i, i] += presliding / (friction * angles[points[i]])
        X = np.linalg.inv(R)
        # D ∂z/∂λ = X c with c = Σ ℓ ε' t beyond each point at held z.
        c = np.zeros(m)
        for i in range(m):
            for s in range(points[i], n):
                c[i] += lengths[s] * strain_slopes[s] * force_slopes[s]
        turned = X @ c
        for s in range(n):
            for i in range(m):
                if points[i] <= s:
                    force_slopes[s] -= tensions[s] * turned[i]
        # Σ_s ℓ ε' ∂T_s/∂ℓ_r.
        weights = np.zeros(m)
        for i in range(m):
            for s in range(points[i], n):
                weights[i] += lengths[s] * strain_slopes[s] * tensions[s]
        shared = X @ weights
        for r in range(n):
            back = 0.0
            for i in range(m):
                if points[i] <= r:
                    back += shared[i]
            length_slopes[r] -= (1.0 - strains[r]) * back
        C = np.linalg.cholesky(0.5 * (X + X.T))
        for k in range(m):
            for s in range(n):
                total = 0.0
                for i in range(m):
                    if points[i] <= s:
                        total += C[i, k]
                stick[points[k], s] = np.sqrt(tensions[s] * (1.0 - strains[s])) * total
    compliance = 0.0
    for s in range(n):
        compliance += lengths[s] * strain_slopes[s] * force_slopes[s]
    return compliance


@njit(**ONCE)
def ratio_at(segment, friction, angles, shares):
    """T_s / λ of one segment.

    Args:
        segment: Index s of the segment in its cable.
        friction: Coefficient µ.
        angles: β of each segment [rad], shape (segment_count,).
        shares: z of each segment, same shape.
    """
    total = 0.0
    for s in range(segment + 1):
        total += angles[s] * shares[s]
    return np.exp(-friction * total)


@njit(**KERNEL)
def solve_cables(
    firsts, winches, friction, flexibility, presliding, lengths, angles, begin_shares, begin_beyond,
    shares, tensions, strains, beyond, force_slopes, length_slopes, stick, compliances,
):
    """`solve_shares` and `write_rates` of every cable; cable k has the segments firsts[k] on.

    Args:
        firsts: First segment of each cable, and the end of the last, shape (cable_count + 1,).
        winches: Tension λ where each cable begins [N], shape (cable_count,).
        friction: Coefficient µ of each cable, same shape.
        flexibility: 1/EA of each cable [1/N], same shape.
        presliding: s_0 of each cable [m], same shape.
        lengths: ℓ of the segments of all cables [m], shape (segment_count,).
        angles: β of each segment [rad], same shape.
        begin_shares: z where the step began, same shape.
        begin_beyond: Unstretched length from each segment on where the step began [m], same shape.
        shares: Takes z, same shape.
        tensions: Takes T [N], same shape.
        strains: Takes ε, same shape.
        beyond: Takes the unstretched length from each segment on [m], same shape.
        force_slopes: Takes ∂T/∂λ, same shape.
        length_slopes: Takes e with ∂δ/∂q = Σ e h, same shape.
        stick: See `write_rates` [√(N/m)], shape (segment_count, segments of the longest cable).
        compliances: Takes ∂δ/∂λ of each cable [m/N], shape (cable_count,).
    """
    for k in range(len(winches)):
        own = slice(firsts[k], firsts[k + 1])
        n = firsts[k + 1] - firsts[k]
        shares[own] = begin_shares[own]
        solve_shares(
            winches[k], lengths[own], angles[own], friction[k], flexibility[k], presliding[k],
            begin_shares[own], begin_beyond[own], shares[own], tensions[own], strains[own],
            beyond[own],
        )
        compliances[k] = write_rates(
            winches[k], lengths[own], angles[own], friction[k], flexibility[k], presliding[k],
            shares[own], tensions[own], strains[own], force_slopes[own], length_slopes[own],
            stick[own, :n],
        )


class CableMaterials(NamedTuple):
    """How cables stretch and rub.

    Attributes:
        axial_stiffness: EA of each, infinite for one that does not stretch [N], shape (count,).
        friction: µ of each, zero for one without friction, shape (count,).
        presliding: s_0 of each [m], positive, shape (count,).
    """

    axial_stiffness: np.ndarray
    friction: np.ndarray
    presliding: np.ndarray


class FrictionCables(ElasticCables):
    """Constraint term of cables of which some rub on the points of their paths; it takes efforts.

    Attributes:
        shares: z at the point where each segment begins, 0 for those at pull points, in the state
            evaluated last, shape (segment_count,).
        tensions: Tension in each segment there [N], same shape.
        angles: Angle by which the path turns where each segment begins [rad], same shape.
        held_forces: Force term of the forces at the told tensions.
    """

    yields = conserves = may_rest = False
    loss = "friction along cables"
    takes_efforts = True
    memory_name = "cable_friction"

    def __init__(
        self, paths: tuple[CablePath, ...], free_index: np.ndarray, rest_positions: np.ndarray,
        materials: CableMaterials, points: CarriedPoints | None = None,
    ):  # fmt: skip
        """Divide the paths into segments.

        Args:
            paths: The cables.
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            materials: How they stretch and rub.
            points: The carried points of the scene; None without any.
        """
        super().__init__(paths, free_index, rest_positions, points, axial_stiffness=materials.axial_stiffness)
        self._carried = None
        if self._points is not None:
            self._carried = CarriedRows(points, len(self.entry_rows))
        self.materials, self._flexibility = materials, 1.0 / materials.axial_stiffness
        count = len(self.cable_of_stretch)
        self._firsts = np.searchsorted(self.cable_of_stretch, np.arange(len(paths) + 1))
        widest = int(np.diff(self._firsts).max(initial=0))
        self._base = np.zeros((len(self.entry_rows), 3))
        self._lengths, self.angles = np.zeros(count), np.zeros(count)
        self.shares, self.tensions = np.zeros(count), np.zeros(count)
        self._strains, self.beyond = np.zeros(count), np.zeros(count)
        self._force_slopes, self._length_slopes = np.ones(count), np.ones(count)
        self._stick = np.zeros((count, widest))
        self.recall(self.memory_at_rest(), rest_positions, np.zeros(len(paths)))
        self.held_forces = HeldCableForces(self)

    def memory_at_rest(self) -> dict[str, np.ndarray]:
        """Shares z of the friction that acts, -1 to 1; see `recall`."""
        return {"shares": np.zeros(len(self.cable_of_stretch))}

    def recall(self, memory: Mapping[str, np.ndarray], positions: np.ndarray, efforts: np.ndarray) -> None:
        """Let a step begin.

        Args:
            memory: `shares`, z where the step begins, shape (segment_count,).
            positions: Node positions there [m], shape (node_count, 3).
            efforts: Tensions at the winches [N], shape (row_count or more,).
        """
        shares = memory["shares"]
        self.begin_shares = np.array(shares)
        self.begin_beyond = np.zeros(len(shares))
        self._measure(positions)
        tensions, strains = np.zeros(len(shares)), np.zeros(len(shares))
        for k, winch in enumerate(efforts[: self.row_count]):
            own = slice(self._firsts[k], self._firsts[k + 1])
            write_tensions(
                winch, self.materials.friction[k], self._flexibility[k], self.angles[own],
                self.begin_shares[own], tensions[own], strains[own],
            )  # fmt: skip
            write_beyond(self._lengths[own], strains[own], self.begin_beyond[own])

    def memory_after(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """z at a state of this step, as `recall` takes it.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            efforts: Tensions at the winches [N], shape (row_count or more,).
        """
        self.tell_efforts(efforts[: self.row_count])
        self.solve(positions)
        return {"shares": self.shares.copy()}

    def _measure(self, positions: np.ndarray) -> None:
        write_turns(
            positions, self._nodes, self._coefficients, self._constants, self._least,
            self._rounding, self.cable_of_stretch, self._lengths, self.angles,
        )  # fmt: skip

    def solve(self, positions: np.ndarray) -> None:
        """Find the tensions along the cables at a state and the told efforts.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        self._measure(positions)
        compliances = np.zeros(self.row_count)
        solve_cables(
            self._firsts, self._told, self.materials.friction, self._flexibility,
            self.materials.presliding, self._lengths, self.angles, self.begin_shares,
            self.begin_beyond, self.shares, self.tensions, self._strains, self.beyond,
            self._force_slopes, self._length_slopes, self._stick, compliances,
        )  # fmt: skip
        np.fill_diagonal(self.compliance, compliances)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H, what a change of the tensions at the winches adds, and the shortenings there [m].

        See `ConstraintTerm.takes_efforts`.
        """
        self._measure_base(positions, values)
        self.solve(positions)
        of = self.stretch_of_entry
        np.multiply(self._base, self._force_slopes[of, None], out=blocks)
        np.subtract(self.rest_lengths, self.beyond[self._firsts[:-1]], out=values)

    def _measure_base(self, positions: np.ndarray, lengths: np.ndarray) -> None:
        """Find the lengths of the paths [m], and what each segment pulls at, by unknowns."""
        self._write_rows(positions, self._base, lengths)
        self._on_unknowns = self.stretch_of_entry, self.entry_nodes, self._base
        if self._carried is not None:
            count = self._carried.reduce(positions, *self._on_unknowns)
            found = self._carried.row_index, self._carried.node_index, self._carried.blocks
            self._on_unknowns = tuple(own[:count] for own in found)

    def displacement_entries(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows, unknowns and blocks of ∂δ/∂q at the state evaluated last."""
        of, nodes, blocks = self._on_unknowns
        return self.cable_of_stretch[of], nodes, blocks * self._length_slopes[of, None]

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """See `Cables.bind`."""
        super().bind(elimination_rank, slots)
        self._base = np.zeros((len(self.entry_rows), 3))

    def add_held_forces(self, positions: np.ndarray, forces: np.ndarray) -> None:
        """Add the forces at the told tensions.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
        """
        self._measure_base(positions, np.zeros(self.row_count))
        self.solve(positions)
        add_row_forces(*self._on_unknowns, self.tensions, forces)

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the geometric stiffness of the told tensions; see `ConstraintTerm.add_stiffness`."""
        self.solve(positions)
        of_segments = (positions, self._nodes, self._coefficients, self._constants, self._least,
                       self._rounding, np.arange(len(self.cable_of_stretch)), self.tensions)  # fmt: skip
        if self._carried is None:
            add_stiffness_kernel(*of_segments, self._bound.offsets, self._bound.strides, storage)
            return
        write_matrices(*of_segments, self._matrices)
        self._fold_matrices(positions, self.stretch_of_entry, self.tensions, projected, storage)

    def stick_rows(self) -> DenseRows:
        """Rows of the stiffness of sticking points, at the state evaluated last."""
        (of, reached, base), parts = self._on_unknowns, []
        point, local = [], []
        for first, last in zip(self._firsts[:-1], self._firsts[1:], strict=True):
            point += range(first + 1, last)
            local += [slice(first, last)] * max(0, last - first - 1)
        rows, nodes = [], []
        for row, (p, own) in enumerate(zip(point, local, strict=True)):
            entries = np.flatnonzero((of >= own.start) & (of < own.stop))
            factors = self._stick[p, of[entries] - own.start]
            parts.append(base[entries] * factors[:, None])
            rows.append(np.full(len(entries), row))
            nodes.append(reached[entries])
        none = np.empty(0, np.int64)
        return DenseRows(
            np.concatenate([none, *rows]), np.concatenate([none, *nodes]),
            np.concatenate([np.empty((0, 3)), *parts]), np.ones(len(point)),
        )  # fmt: skip


class HeldCableForces(ForceTerm):
    """Force term of cables with friction: their forces at the told tensions, and sticking."""

    name = "cable_friction"

    def __init__(self, cables: FrictionCables):
        """Take the cables."""
        self._cables = cables

    def stencils(self) -> np.ndarray:
        """None: sticking is given as dense rows, and the cables have the geometric stiffness."""
        return np.empty((0, 1), np.int64)

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Nothing to find; see `ForceTerm.bind`."""

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """See `ForceTerm.add_forces`."""
        self._cables.add_held_forces(positions, forces)
        return 0

    def add(self, positions: np.ndarray, forces: np.ndarray, storage: np.ndarray, projected: bool) -> None:
        """See `ForceTerm.add`."""
        self._cables.add_held_forces(positions, forces)

    @property
    def dense_rows(self) -> DenseRows:
        """Stiffness of sticking points; see `ForceTerm`."""
        return self._cables.stick_rows()
