"""How much of a move towards a static equilibrium is made: a merit that it must lower.

At held actuators an equilibrium is a minimum of the energy E among the states that cables and
contacts allow. The merit of a state is

    φ = E + Σ_i µ_i max(0, prescribed_i - δ_i) + Σ_p µ_p max(0, deepest overlap of pair p)

(in place of the penalty, for an actuator that stretches the energy of its stretch, and for one at
a given effort λ the work -λ δ), with exact penalties µ, 1.5 times the multipliers of the
linearization (Nocedal and Wright 2006, section 17.2). Overlaps are
detected anew at the tried state, because contacts of other edges and facets are what the
linearization does not know. The change of E is the work of the forces along the move, by Simpson's
rule. A move is shortened until it lowers φ by a share of what the linearization promises (Armijo's
condition).

A slide prescribes where a base is, and an equilibrium is a minimum of E among the states with that
base. So the base moves first, wholly, and carries its bodies as they are: no shape changes, and no
cable, since all that holds such a body rides with it. φ of this state is what a move must lower:
the work that the slide does against weights and obstacles is not counted, and overlaps that the
slide makes are there from the start. Seen from the base, moves are judged as without slides.

Most moves need no merit. With r = b + Hᵀλ, the slope of the Lagrangian along a move falls from
-r(0)·dq to zero where the linearization holds. Where r(1)·dq is as small, which the residual tells,
and where the next detection finds no overlap that counts, the move was good, and nothing is
computed that is not needed anyway.

Of a move any share can be made, and it can be taken back. Slides prescribe where a base is, so it goes there at once, and carries what is attached to it as a
rigid body; only the displacement of the unknowns has shares.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.vector_arrays import copy_vectors
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation

# µ by multiplier.
PENALTY = 1.5
# Least share of the promised decrease (Armijo).
DECREASE = 1.0e-4
# Least and greatest factor by which a refused move is shortened; tries of one linearization.
SHORTEST, LONGEST, MOST_TRIALS = 0.1, 0.5, 8
# Largest -r(1)·dq of a trusted move, by r(0)·dq; beyond, it went too far.
OVERSHOOT = 0.5
# Largest penalty of overlaps after a trusted move, by r(0)·dq.
OVERLAP = 0.25
# Moves that are searched after a doubtful one, before moves are trusted again. It doubles each
# time, so that no cycle of trusted and searched moves lasts.
FIRST_DOUBT = 3


class Move:
    """The last correction of one simulation. Its arrays are allocated once.

    Attributes:
        start: Node positions when slides have moved, and before anything else has [m], shape
            (node_count, 3).
        displacement: What it displaces the unknowns by [m], shape (free_node_count, 3).
    """

    def __init__(self, model: Model):
        """Allocate.

        Args:
            model: The built scene.
        """
        self._nodes, self._slides = model.nodes, model.slides
        self.start = np.empty_like(model.nodes.rest_positions)
        # Without slides it starts from where the positions were.
        self._before = self.start if model.slides is None else np.empty_like(self.start)
        self.displacement = np.zeros((model.nodes.free_node_count, 3))

    def begin(
        self, before: np.ndarray, displacement: np.ndarray, efforts: np.ndarray | None = None
    ) -> None:
        """Note a correction before it is made.

        Args:
            before: Node positions [m], shape (node_count, 3).
            displacement: Of the unknowns [m], shape (free_node_count, 3).
            efforts: Those of `Actuation`, of slides their displacements, shape (actuator_count,);
                needed with slides.
        """
        copy_vectors(before, self.start)
        copy_vectors(displacement, self.displacement)
        if self._slides is not None:
            self._before[:] = before
            self._slides.shift(self.start, -efforts[-self._slides.count :])

    def make(self, positions: np.ndarray, share: float) -> None:
        """Go from where it starts by a share of the displacement.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
            share: The share.
        """
        copy_vectors(self.start, positions)
        self._nodes.advance(positions, self.displacement, share)

    def take_back(self, positions: np.ndarray) -> None:
        """Go back to where the positions were before it, also those of slides.

        Args:
            positions: Takes the node positions [m], shape (node_count, 3).
        """
        positions[:] = self._before


class Begin(NamedTuple):
    """The merit where a move begins.

    Attributes:
        energy_slope: Slope of the energy along the whole move [J].
        penalty: Penalties [J].
        slope: Slope of the merit; without meaning where it is not negative [J].
    """

    energy_slope: float
    penalty: float
    slope: float


class Trial(NamedTuple):
    """The merit where a share of a move leads.

    Attributes:
        change: Its change [J].
        is_lower: Whether it falls by a share of what was promised, or nothing was.
    """

    change: float
    is_lower: bool


class Merit:
    """Judges the moves of one simulation at held actuators, where equilibria are minima of an energy.

    Slender parts are stretched on their way: Newton's method needs a quarter of the moves where
    their energy may rise in between, 4 to 19 for the elastica from rest instead of 14 to 42.

    Where contacts stick or slide, equilibria depend on the way there and are minima of no
    energy. One pair that may rub decides it for all moves of the scene: a contact that begins
    to rub within a step would change what the moves of the step are judged by.

    Attributes:
        judges: Whether equilibria are minima of an energy that falls on the way.
        is_judging: Whether the last move is judged.
        trials: States tried in the last search.
    """

    def __init__(
        self, model: Model, move: Move, gather_forces: Callable[[np.ndarray], np.ndarray]
    ):
        """Take the terms.

        Args:
            model: The built scene.
            move: The last correction of the positions.
            gather_forces: Gives b = p - F(q) at positions [N], shape (free_node_count, 3), and
                evaluates the rows there.
        """
        self._model, self._move, self._gather = model, move, gather_forces
        self.trials, conserves = 0, all(term.conserves for term in model.rows.terms)
        is_slender = any(term.is_slender for term in model.forces)
        self.judges = conserves and not (model.is_dynamic or is_slender)
        self.forget()

    def forget(self) -> None:
        """Trust the next move."""
        self.is_judging = False
        self._bears = np.empty(0)
        self._doubt, self._next_doubt = 0, FIRST_DOUBT

    def begin(self, actuation: Actuation, slope: float) -> None:
        """Judge a move, before it is made.

        Args:
            actuation: What actuators and contacts do, λ.
            slope: Work of the forces b + Hᵀλ there along the whole move, r(0)·dq [J].
        """
        self.is_judging, self._actuation, self._slope = True, actuation, slope
        contacts = self._model.contacts
        if contacts is not None:
            normal_forces = actuation.contact.multipliers[contacts.row_starts[:-1]]
            self._bears = np.bincount(
                contacts.pair[: contacts.count], normal_forces, len(contacts.pairs)
            )

    def skip(self) -> None:
        """Do not judge the next move."""
        self.is_judging = False

    def trusts(self, forces: np.ndarray) -> bool:
        """Whether the linearization held along the move.

        Args:
            forces: b + Hᵀλ after the move [N], shape (free_node_count, 3).
        """
        left = float(np.vdot(forces, self._move.displacement))
        return self._doubt == 0 and left >= -OVERSHOOT * abs(self._slope)

    def see_overlaps(self) -> None:
        """Look at what was detected after the last move; doubt the next ones if it overlaps."""
        contacts = self._model.contacts
        if not self.is_judging or contacts is None:
            return
        overlaps = np.zeros(len(contacts.pairs))
        np.maximum.at(overlaps, contacts.pair[: contacts.count], contacts.overlaps)
        if PENALTY * float(self._bears @ overlaps) > OVERLAP * abs(self._slope):
            if self._doubt == 0:
                self._next_doubt *= 2
            self._doubt = self._next_doubt
        elif self._doubt:
            self._doubt -= 1

    def accepts(self, positions: np.ndarray, share: float) -> bool:
        """Whether a share of the move lowers the merit.

        Args:
            positions: Node positions [m], shape (node_count, 3); where that share leads.
            share: The share.
        """
        return self.try_share(positions, share, self.at_start()).is_lower

    def search(self, positions: np.ndarray, share: float) -> float:
        """Make as much of the move as lowers the merit.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved from where `begin` was.
            share: Share of the move that is tried first.

        Returns:
            The share that was made.
        """
        begin = self.at_start()
        for trial in range(1, MOST_TRIALS + 1):
            self.trials = trial
            tried = self.try_share(positions, share, begin)
            if tried.is_lower:
                break
            if trial < MOST_TRIALS:
                bend = (tried.change - share * begin.slope) / share**2
                shorter = -begin.slope / (2.0 * bend)
                share = min(LONGEST * share, max(SHORTEST * share, shorter))
        return share

    def at_start(self) -> Begin:
        """The merit where the move begins."""
        energy_slope = self.energy_slope(self._move.start)
        penalty = self.penalty(self._move.start)
        return Begin(energy_slope, penalty, energy_slope + self._promised_penalty() - penalty)

    def energy_slope(self, positions: np.ndarray) -> float:
        """Slope of the energy along the whole move [J], at node positions [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return -float(np.vdot(self._gather(positions), self._move.displacement))

    def try_share(self, positions: np.ndarray, share: float, begin: Begin) -> Trial:
        """Make a share of the move, and compare the merit.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            share: The share.
            begin: Where the move begins.
        """
        self._move.make(positions, 0.5 * share)
        half = self.energy_slope(positions)
        self._move.make(positions, share)
        work = share * (begin.energy_slope + 4.0 * half + self.energy_slope(positions)) / 6.0
        change = work + self.penalty(positions) - begin.penalty
        round_off = np.finfo(float).eps * (abs(begin.penalty) + share * abs(begin.energy_slope))
        is_lower = begin.slope >= 0.0 or change <= DECREASE * share * begin.slope + round_off
        return Trial(change, is_lower)

    def penalty(self, positions: np.ndarray) -> float:
        """Penalties of actuators and overlaps at the state whose forces were taken last [J].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        rows = self._model.rows
        total = self._of_actuators(rows.values[rows.groups.actuators])
        if self._bears.any():
            overlaps = self._model.contacts.deepest_overlaps(positions)
            total += PENALTY * float(self._bears @ overlaps)
        return total

    def _of_actuators(self, values: np.ndarray) -> float:
        """Penalties of displacements δ that are not as prescribed [J]; slack ones cost nothing."""
        count, actuators = len(values), self._model.actuators
        efforts = self._actuation.efforts[:count]
        are_given = self._actuation.are_efforts_given
        stretch = None if are_given else self._model.rows.stretch_compliance()
        missing = efforts * (self._actuation.displacements[:count] - values)
        if stretch is None and not are_given and actuators.one_sided[:count].all():
            return PENALTY * float(np.maximum(missing, 0.0).sum())
        penalties = np.where(actuators.one_sided[:count], np.maximum(missing, 0.0), np.abs(missing))
        by_effort = actuators.is_effort_driven[:count] | are_given
        costs = np.where(by_effort, -efforts * values, PENALTY * penalties)
        if self._model.rows.is_told is not None:
            # The energy contains the work of told efforts.
            costs[by_effort & self._model.rows.is_told] = 0.0
        if stretch is not None:
            yields = stretch > 0.0
            costs[yields] = self._stretch_energies(values, stretch)[yields]
        return float(costs.sum())

    def _stretch_energies(self, values: np.ndarray, stretch: np.ndarray) -> np.ndarray:
        """Energy of actuators that stretch, at held displacements [J], shape (row_count,).

        Its slope is the effort, which stays within its limits.

        Args:
            values: δ without efforts, shape (row_count,).
            stretch: Compliance of each, shape (row_count,).
        """
        limits, count = self._model.actuators.limits, len(values)
        missing = self._actuation.displacements[:count] - values
        efforts = np.clip(
            np.divide(missing, stretch, out=np.zeros(count), where=stretch > 0.0),
            limits.effort_min[:count], limits.effort_max[:count],
        )  # fmt: skip
        return efforts * (missing - 0.5 * stretch * efforts)

    def _promised_penalty(self) -> float:
        """The same after the whole move, as the linearization sees it [J]."""
        rows = self._model.rows
        values = rows.values.copy()
        np.add.at(
            values, rows.row_index, (rows.blocks * self._move.displacement[rows.node_index]).sum(axis=1)
        )
        a, c = rows.groups.actuators, rows.groups.contacts
        total = self._of_actuators(values[a])
        if self._bears.any():
            contacts = self._model.contacts
            overlaps = np.zeros(len(contacts.pairs))
            np.maximum.at(
                overlaps, contacts.pair[: contacts.count],
                -values[c][contacts.row_starts[:-1]],
            )
            total += PENALTY * float(self._bears @ overlaps)
        return total
