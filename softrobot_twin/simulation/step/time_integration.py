"""Schemes in time: none in statics; backward Euler and the generalised-α scheme in dynamics.

**Generalised α** is of second order with chosen numerical damping: Chung and Hulbert 1993, in the
form of Arnold and Brüls 2007, which needs the forces at the end of a step only. Of a spectral radius ρ at infinite frequency,

    αm = (2ρ - 1)/(ρ + 1),   αf = ρ/(ρ + 1),   γ = 1/2 - αm + αf,   β = (1 - αm + αf)²/4,

    (1 - αm) a₁ + αm a₀ = (1 - αf) v̇₁ + αf v̇₀,            M v̇₁ = p - F(q₁, v₁) + Hᵀλ₁
    q₁ = q₀ + h v₀ + h² ((1/2 - β) a₀ + β a₁),            v₁ = v₀ + h ((1 - γ) a₀ + γ a₁)

So a step solves  -M ((q₁ - q₀)/h - u)/(ζ h) + p - F(q₁, v₁) + Hᵀλ = 0  with ζ = β (1 - αf)/(1 - αm)
and a velocity u of the past: inertia is that of backward Euler with another velocity and the weight
1/ζ. Velocities of damping terms are v₁ = (q₁ - q_r)/τ, τ = h β/γ. Accelerations a are kept as
v̇ + h j: a is ahead of v̇ in proportion to h, which may differ from step to step.

Rotations: with ω = J⁻¹ l and rows J⁻¹ l̇ in place of v and v̇, the same formulas hold for the angular
momentum l in world axes, carried along with J; its mean over the step is J φ/h with J in the middle
of the turn φ (implicit midpoint rule).

The first step, without a past, takes the acceleration as constant: ζ = 1/2, v₁ = 2 (q₁ - q₀)/h - v₀. So does one that is more
than three times as long as the step before: h j, extrapolated from there, would be far too large for stiff
vibrations, which grow where long and short steps take turns.

**Actuators**: λ of cables at given lengths and of given volumes acts at the end of the step, like an
elastic force; what rings of it after a jump of the command falls by ρ in each step. A step towards
targets is another case: it leads the effectors to where they shall be at its end, whatever velocity
that leaves them, and with ρ near 1 they would swing between the limits of the actuators. These steps
take the weights of ρ = 0, which are of second order too.

**Contacts** prevent motion: at impact λ has no bound as h goes to zero, and with
the formulas above the body would rebound, and λ would ring. So λ is divided. What it had in each of
the last three steps already is a regular force, treated as above. The excess P acts as in backward
Euler: it moves the unknowns by c with A c = P, A the tangent of the step, and the velocity by c/h;
the scheme itself sees q₁ - c. Since λ̃ of the step's system stands for a force λ̃ ζ where it acts
so, the force told is r + ζ (λ̃ - r). Where λ changes smoothly P is of the order of h², and the
scheme stays of second order. An impact is inelastic for what A joins rigidly within a step, the
velocity of a body at rest is zero, and all rows of one contact are divided alike, so that the cone of
friction and the balance of momentum hold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.row_stack import add_row_forces
from softrobot_twin.mechanics.reduced_points import ReducedPoints
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.state import PastMotion, State
from softrobot_twin.simulation.step.actuation import Actuation

DEFAULT_RADIUS = 0.8
# Steps in which a force must have acted to count as regular: an impact and the step after it, which
# closes what gap it left, are over then.
REMEMBERED = 3
# A step that is longer than so many times the one before begins anew. Vibrations faster than steps grow by
# 2 % in each where lengths take turns by 3, and by 13 % by 5, if they go on.
LONGEST_GROWTH = 3.001


class Motion(NamedTuple):
    """How a state moves at the end of a step.

    Attributes:
        velocities: Of each unknown [m/s], of rotations [rad/s], shape (free_node_count, 3).
        past: What the next step needs beside them; None where that is nothing.
        actuation: The actuation with the forces that acted on average.
    """

    velocities: np.ndarray
    past: PastMotion | None
    actuation: Actuation


class Statics:
    """Every state is an equilibrium: there are no velocities."""

    def at_rest(self) -> np.ndarray:
        """Initial velocities [m/s] and [rad/s], shape (free_node_count, 3); (0, 3) in statics."""
        return np.empty((0, 3))

    def knows(self, past: PastMotion | None) -> bool:
        """Whether a state's past is one of this scheme and this scene.

        Args:
            past: The past of the state; None for none.
        """
        return past is None

    def begin_step(
        self, beginners: tuple, positions: np.ndarray, velocities: np.ndarray,
        past: PastMotion | None, time_step: float, follows_targets: bool = False,
    ) -> bool:  # fmt: skip
        """Let all that remembers look at the state where a step begins; move what is guided.

        Args:
            beginners: Objects that use it; see `Model.beginners`.
            positions: Node positions [m], shape (node_count, 3); those of guided bodies are moved.
            velocities: Of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            past: What the scheme knows of the steps before.
            time_step: h [s].
            follows_targets: Whether the step leads effectors towards targets.

        Returns:
            Whether the tangent of an equally long step before is of no use for this one.
        """
        for beginner in beginners:
            beginner.begin_step(positions, velocities, time_step)
        return False

    def end_step(
        self, before: State, positions: np.ndarray, actuation: Actuation, time_step: float
    ) -> Motion:
        """How the state moves after a step.

        Args:
            before: The state at its beginning.
            positions: Node positions at its end [m], shape (node_count, 3).
            actuation: Efforts and contact forces of its system.
            time_step: Its length [s].
        """
        return Motion(np.empty((0, 3)), None, actuation)


class Dynamics(Statics):
    """The velocity is the displacement of a step over its duration (Coevoet 2017, eq. (6))."""

    def __init__(self, model: Model):
        """Take the nodes.

        Args:
            model: The built scene.
        """
        self._nodes = model.nodes
        self._rigid = [part for part in model.rigid if part.is_free]
        self._first = model.nodes.kinds[0].first_unknown if self._rigid else 0

    def at_rest(self) -> np.ndarray:
        """See `Statics.at_rest`."""
        velocities = np.zeros((self._nodes.free_node_count, 3))
        for index, part in enumerate(self._rigid):
            turning = np.array(part.entry.angular_velocity)
            # The scene gives the velocity of the entry's origin, not of the centre of mass.
            arm = part.rotation @ part.centre_of_mass
            first = self._first
            velocities[first + 2 * index] = part.entry.velocity + np.cross(turning, arm)
            velocities[first + 2 * index + 1] = turning
        return velocities

    def end_step(
        self, before: State, positions: np.ndarray, actuation: Actuation, time_step: float
    ) -> Motion:
        """See `Statics.end_step`."""
        velocities = self._nodes.displacement(before.positions, positions)
        velocities /= time_step
        return Motion(velocities, None, actuation)


class Weights(NamedTuple):
    """Weights of the scheme; see the module.

    Attributes:
        alpha_m: αm.
        alpha_f: αf.
        beta: β.
        gamma: γ.
        zeta: ζ.
    """

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    zeta: float

    @classmethod
    def of_radius(cls, radius: float | None) -> Weights:
        """The weights of least damping at low frequencies for a spectral radius, 0 to 1.

        Args:
            radius: The spectral radius at high frequencies [-]; None for `DEFAULT_RADIUS`.
        """
        radius = DEFAULT_RADIUS if radius is None else radius
        alpha_m, alpha_f = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        gamma = 0.5 - alpha_m + alpha_f
        beta = 0.25 * (1.0 - alpha_m + alpha_f) ** 2
        return cls(alpha_m, alpha_f, beta, gamma, beta * (1.0 - alpha_f) / (1.0 - alpha_m))


class GeneralizedAlpha(Dynamics):
    """Velocities and accelerations of second order in the time step."""

    def __init__(self, model: Model):
        """Take the terms that a step begins with.

        Args:
            model: The built scene, with integration dynamic.
        """
        super().__init__(model)
        self._own_weights = Weights.of_radius(model.scene.spectral_radius)
        self._towards_targets = Weights.of_radius(0.0)
        self._weights = self._own_weights
        self._model = model
        moving = [term for term in model.forces if term.remembers_start]
        self._inertia = [term for term in moving if term.is_inertia]
        self._damping = [term for term in moving if not term.is_inertia]
        self._rigid_inertia = [term for term in self._inertia if hasattr(term, "carry_rates")]
        self._zeta = 0.0
        self._has_contacts = model.rows.varies

    def knows(self, past: PastMotion | None) -> bool:
        """See `Statics.knows`."""
        if past is None:
            return True
        unknowns = (self._nodes.free_node_count, 3)
        forces = unknowns if self._has_contacts else (0, 3)
        return (
            past.accelerations.shape == past.acceleration_rates.shape == unknowns
            and past.contact_forces.shape == (REMEMBERED, *forces)
        )

    def begin_step(
        self, beginners: tuple, positions: np.ndarray, velocities: np.ndarray,
        past: PastMotion | None, time_step: float, follows_targets: bool = False,
    ) -> bool:  # fmt: skip
        """See `Statics.begin_step`."""
        self._weights = self._towards_targets if follows_targets else self._own_weights
        model, w = self._model, self._weights
        before = positions.copy()
        if model.guides:
            model.guides.begin_step(positions, velocities, time_step)
        for other in beginners:
            if other is not model.guides and other not in model.forces:
                other.begin_step(before, velocities, time_step)
        h, past = time_step, _in_use(past, time_step)
        if past is None:
            zeta, span, ahead, rate = 0.5, 0.5 * h, velocities, 0.5 * velocities
            v_dot = np.zeros_like(velocities)
        else:
            v, v_dot = velocities, past.accelerations
            a = v_dot + h * past.acceleration_rates
            zeta, span = w.zeta, h * w.beta / w.gamma
            share = h * w.beta / (1.0 - w.alpha_m)
            ahead = v + h * (0.5 - w.beta) * a + share * (w.alpha_f * v_dot - w.alpha_m * a)
            ratio = w.beta / w.gamma
            rate = (1.0 - ratio) * v + h * (0.5 - w.beta - ratio * (1.0 - w.gamma)) * a
        for term in self._inertia:
            term.weight = 1.0 / zeta
            term.begin_second_order(positions, ahead, velocities, v_dot, h)
        if self._damping:
            reference = self._reference(before, positions, h * rate, 1.0 - span / h)
            for term in self._damping:
                term.begin_rates(before, reference, velocities, span)
        is_new, self._zeta = zeta != self._zeta, zeta
        return is_new

    def _reference(self, before, guided, move, share: float) -> np.ndarray:
        """Positions q_r from where rates are taken [m], shape (node_count, 3).

        Guided nodes move steadily from where they were, `before`, to where they are, `guided`.
        """
        reference = before.copy()
        if self._model.guides:
            reference += share * (guided - before)
            free = self._model.nodes.free_nodes
            reference[free] = before[free]
        self._model.nodes.advance(reference, move, 1.0)
        return reference

    def end_step(
        self, before: State, positions: np.ndarray, actuation: Actuation, time_step: float
    ) -> Motion:
        """See `Statics.end_step`."""
        past, h, zeta = _in_use(before.past, time_step), time_step, self._zeta
        regular = self._regular_shares(before, actuation)
        excess = self._forces(regular.excess)
        displacement = self._nodes.displacement(before.positions, positions)
        is_pushed = excess.any()
        if is_pushed:
            pushed = self._model.factorization.solve(excess).copy()
            yielded = -self._accelerations(positions, excess)
            yielded += pushed / (zeta * h * h)
            displacement -= pushed
        mean = displacement / h
        self._carry(before.positions, positions, mean, in_middle=True)
        v = before.velocities.copy()
        self._carry(before.positions, positions, v)
        if past is None:
            v_dot = 2.0 * (mean - v) / h
            a, velocities = v_dot.copy(), 2.0 * mean - v
            lead = 1.0
        else:
            a, v_dot, velocities = self._advanced(before, positions, mean, v, h)
            lead = (1.0 - self._weights.alpha_f) / (1.0 - self._weights.alpha_m)
        if is_pushed:
            velocities += pushed / h
            # v̇ is by the forces where the step ends, the displacement by P included.
            v_dot += yielded
            a += lead * yielded
        return Motion(
            velocities, self._past(before, regular, v_dot, (a - v_dot) / h, h),
            actuation._replace(
                contact=actuation.contact._replace(multipliers=regular.contacts)
            ),
        )  # fmt: skip

    def _advanced(self, before: State, positions, mean, v, h: float) -> tuple:
        """a, v̇ and v at the end of a step, from the mean velocity of its smooth part."""
        w, past = self._weights, before.past
        v_dot_0, rate = past.accelerations.copy(), past.acceleration_rates.copy()
        self._carry(before.positions, positions, v_dot_0)
        self._carry(before.positions, positions, rate)
        a_0 = v_dot_0 + h * rate
        a = ((mean - v) / h - (0.5 - w.beta) * a_0) / w.beta
        v_dot = ((1.0 - w.alpha_m) * a + w.alpha_m * a_0 - w.alpha_f * v_dot_0) / (1.0 - w.alpha_f)
        return a, v_dot, v + h * ((1.0 - w.gamma) * a_0 + w.gamma * a)

    def _carry(self, before, after, rates, in_middle: bool = False) -> None:
        for term in self._rigid_inertia:
            term.carry_rates(before, after, rates, in_middle)

    def _accelerations(self, positions: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """M⁻¹ f [m/s²] and [rad/s²], shape (free_node_count, 3)."""
        accelerations = np.zeros_like(forces)
        for term in self._inertia:
            term.add_accelerations(positions, forces, accelerations)
        return accelerations

    def _forces(self, multipliers: np.ndarray) -> np.ndarray:
        """Hᵀ λ on the unknowns, shape (free_node_count, 3)."""
        rows, forces = self._model.rows, np.zeros((self._nodes.free_node_count, 3))
        if multipliers.any():
            add_row_forces(rows.row_index, rows.node_index, rows.blocks, multipliers, forces)
        return forces

    def _regular_shares(self, before: State, actuation: Actuation) -> Divided:
        """Divide the contact forces of a step into what is regular and what is not."""
        groups, zeta = self._model.rows.groups, self._zeta
        excess = np.zeros(self._model.rows.row_count)
        contacts = np.array(actuation.contact.multipliers)
        regular = np.zeros_like(excess)
        if contacts.any():
            row_counts = np.diff(self._model.contacts.row_starts)
            own = np.repeat(self._contact_shares(before, contacts), row_counts)
            excess[groups.contacts] = (1.0 - own) * contacts
            regular[groups.contacts] = own * contacts
            contacts *= own + zeta * (1.0 - own)
        return Divided(excess, regular, contacts)

    def _contact_shares(self, before: State, multipliers: np.ndarray) -> np.ndarray:
        """Share of each contact's force that is regular, shape (contact_count,)."""
        rows = self._model.rows
        first = rows.groups.contacts.start
        at = np.flatnonzero(rows.row_index >= first)
        row, starts = rows.row_index[at] - first, self._model.contacts.row_starts
        contact = np.searchsorted(starts, row, "right") - 1
        unknowns = rows.node_index[at]
        shares = np.ones(len(starts) - 1)
        if before.past is None:
            # At the start all is regular, but where things meet.
            normal = starts[contact] == row
            speeds = np.einsum("ij,ij->i", rows.blocks[at], before.velocities[unknowns])
            approach = np.bincount(contact[normal], speeds[normal], len(shares))
            shares[approach < 0.0] = 0.0
            return shares
        everywhere = np.zeros(rows.row_count)
        everywhere[first:] = multipliers
        forces = self._forces(everywhere)
        along = np.einsum("kij,ij->ki", before.past.contact_forces, forces)
        squares = np.einsum("ij,ij->i", forces, forces)
        # Force and torque on a frame make one load, and so do forces on the coordinates of a body.
        for frames in self._nodes.kinds:
            if isinstance(frames, ReducedPoints):
                own = frames.unknowns
                along[:, own] = along[:, own].sum(axis=1, keepdims=True)
                squares[own] = squares[own].sum()
                continue
            t, r, arms = frames.translations, frames.rotations, frames.radii**2
            along[:, t] += along[:, r] / arms
            squares[t] += squares[r] / arms
            along[:, r], squares[r] = along[:, t], squares[t]
        np.minimum.at(shares, contact, _share_of(along, squares)[unknowns])
        return shares

    def _past(self, before: State, divided: Divided, v_dot, rate, time_step: float) -> PastMotion:
        """What the next step needs of the past."""
        past = before.past
        contact_forces = np.empty((REMEMBERED, 0, 3))
        if self._has_contacts:
            everywhere = np.zeros(self._model.rows.row_count)
            everywhere[self._model.rows.groups.contacts] = divided.contacts
            newest = self._forces(everywhere)[None]
            if past is None:
                regular = self._forces(divided.regular)
                older = np.tile(regular, (REMEMBERED - 1, 1, 1))
            else:
                older = past.contact_forces[:-1]
            contact_forces = np.concatenate([newest, older])
        return PastMotion(v_dot, rate, contact_forces, time_step)


def _in_use(past: PastMotion | None, time_step: float) -> PastMotion | None:
    """The past that a step goes on from; None for a step that begins anew."""
    return None if past is None or time_step > LONGEST_GROWTH * past.time_step else past


class Divided(NamedTuple):
    """The contact forces of a step, divided.

    Attributes:
        excess: What acts as in backward Euler, of each row, shape (row_count,).
        regular: What is regular, of each row, shape (row_count,).
        contacts: Mean force of each contact row over the step [N], shape (contact_row_count,).
    """

    excess: np.ndarray
    regular: np.ndarray
    contacts: np.ndarray


def _share_of(along: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Least share that past forces have of present ones, 0 to 1; 1 where there are none.

    Args:
        along: Products of past and present forces, shape (step_count, count).
        squares: Squares of present forces, shape (count,).
    """
    least = along.min(axis=0)
    is_loaded = squares > 0.0
    return np.where(is_loaded, np.clip(least / np.where(is_loaded, squares, 1.0), 0.0, 1.0), 1.0)
