"""How targets are followed: a radius, in which a linearization is trusted.

Each step solves the inverse problem in a box around where the actuators are, the radius, a share of
their scales. The next one compares what came of it with what was promised, as in every trust region
method (Nocedal and Wright 2006, section 4.1), by

    T = ½ Σ q (x - x_d)²

of the places x that the effectors have in balance at held actuators, as its own factor sees them. A move
that keeps too little is taken back, and the radius shrinks. Where settling alone changes more than a move
promises, nothing could be learnt from it: then the actuators stay, until the body has settled. They rest
where the promise vanishes, or the radius. Where targets or loads change in each step, nothing is judged.

Far from the targets a promise counts how effectors curve on their way, as moves before have taught, see
`Curvature`. Else moves go to and fro across the edge of the workspace.

What targets leave open goes to where its energy is least, by moves that promise nothing and are not
judged; where they get no shorter, the radius shrinks. Where a robot comes no nearer for long, it goes
back to the nearest place in stable balance, at once where the body snaps, and on from there a few times,
by shorter moves; then it rests at the nearest of all stable places that it passed. Where its shape at
rest is much nearer, it was caught: it lets go once, and where that does not help, its effectors are led
back through the places where they were. It rests in balance only: on the way there an unstable body may
go far.

A move of which the body accepts less than a half, since it would fold or go too far, is solved for again
in a smaller box: the direction of a small share would be poor.

Where a taut cable is at its greatest shortening, a nearer place may have it slack, and no small
move leads there. Before the actuators rest, the problem is solved in each branch in which one cable
changes, and they follow the most promising one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.result import RATE
from softrobot_twin.simulation.step.actuation import NO_EFFORT, Actuation
from softrobot_twin.simulation.step.apparent_stiffness import StiffnessRows
from softrobot_twin.simulation.step.curvature import Curvature, jacobian_by_drives
from softrobot_twin.simulation.step.direct_actuation import DirectActuation
from softrobot_twin.simulation.step.effector_path import EffectorPath
from softrobot_twin.simulation.step.inverse_actuation import (
    Asked,
    InverseActuation,
    Tracking,
    rest_rows,
    rows_to_track,
    with_contacts_closed,
    with_stiffness,
    write_wanted,
)
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.passed_places import MUCH_NEARER, PROGRESS, PassedPlaces, Place
from softrobot_twin.simulation.step.situation import Situation, half_squares, longest_move
from softrobot_twin.solvers.inverse_problem import Bounds

# Greatest and least radius, as shares of the actuators' scales.
GREATEST, LEAST = 0.25, 1.0e-7
# Shares of a promise that came true: below the first a move is taken back, below the second the
# radius shrinks, above the third it grows; by these factors.
KEEP, POOR, GOOD, SHRINK, GROW = 0.05, 0.25, 0.7, 0.25, 2.0
# Tries of one linearization, and the least share of a move that is made.
TRIES, LEAST_SHARE = 8, 0.5
# Where settling changes T by more than this share of a promise, it is waited for; so many steps.
DRIFT, MOST_WAITS = 0.5, 40
# Moves at targets that are no shorter than this share of the one before, until they are shortened.
SETTLING, MOST_SWINGS = 0.95, 8
# Promises below these shares of T, and of T where targets count as reached, are none.
NO_PROMISE, NEAR_ENOUGH = 1.0e-5, 1.0e-2
# With wanted stiffnesses, which hardly change at first, such shares of these.
STIFFNESS = 1.0e-3
# Round-off, as a share of T, and of the limit of contact forces.
NOISE, EXCESS = 1.0e-9, 1.0e-7
# The share by which T must promise to fall beyond a kink, and fall until it is looked again.
LEAST_LEAP = 0.02
# A robot has been caught where its shape at rest is nearer than this share of its distance.
CAUGHT = 0.5
# A resting robot whose effectors were moved by this share of the tolerance follows again.
WAKES = 0.1
# A cable that is to bear where a finger pushes bears this multiple of what the push takes from it.
BEARS = 1.5


class Pending(NamedTuple):
    """A move that is not judged yet.

    Attributes:
        now: T before it [m²].
        promised: Decrease of T that it promised [m²].
        rise: What the curvature makes T rise by [m²].
        length: How far it went, as a share of the actuators' scales.
        targets: Targets that it was made for [m], shape (m,).
        drives: Where it began, shape (actuator_count,).
    """

    now: float
    promised: float
    rise: float
    length: float
    targets: np.ndarray
    drives: np.ndarray


class Follower(InverseActuation):
    """Finds actuation that brings effectors nearer to targets, as far as it is trusted.

    Attributes:
        move_limit: The radius, a share of the actuators' scales.
        is_departing: Whether the actuators go to a place first, see `depart`.
    """

    def __init__(self, model: Model, direct: DirectActuation):
        """See `InverseActuation`."""
        self._curvature = Curvature(model.actuators.limits.drive_scale)
        count = model.effectors.position_row_count
        self._positions, self._ones = slice(count), np.ones(count)
        super().__init__(model, direct)
        self._at_rest = np.zeros(len(self._scales))

    def reset(self) -> None:
        """Forget the last solution, the contacts that bore it, and all moves."""
        super().reset()
        self.forget()

    def forget(self) -> None:
        """Forget all targets."""
        self._first: Situation | None = None
        self._situation: Situation | None = None
        self._departure: np.ndarray | None = None
        # Places of effectors with the actuators at rest [m], where seen; whether it went there.
        self._placed_at_rest: np.ndarray | None = None
        self._is_noted = False
        # Coordinates of orientations change while their targets stay.
        asking = self._positions if self._model.effectors.orientations else slice(None)
        self._path = EffectorPath(asking, self._positions.stop, self._longest)
        self._keyed: Linearized | None = None
        self._task: Asked | None = None
        self._open()

    def _open(self) -> None:
        """Trust anew."""
        # The greatest radius: a 256th each time that a resting robot wakes, until it is at its targets.
        self.move_limit = self._greatest = GREATEST
        self._pending, self._waits = None, 0
        self._goal: np.ndarray | None = None
        self._swing_count, self._last_length, self._is_freed = 0, np.inf, False
        # Steps in a row that did not end in balance.
        self._arriving = 0
        self._passed = PassedPlaces()
        self._resting: np.ndarray | None = None
        self._rests_balanced = False
        self._holds = self._stays = self._ends = self.is_departing = False
        self._is_stuck = self._is_refused = False
        # T where it looked beyond kinks last; cables that are slack in the branch it chose there, and before.
        self._looked, self._branch, self._branch_before = np.inf, None, None

    @property
    def misses(self) -> np.ndarray:
        """Distances from targets where the last step began, times the roots of their weights [m]."""
        last = self._situation
        return np.sqrt(last.weights) * (last.places - last.targets)

    @property
    def rests(self) -> bool:
        """Whether the actuators stay, since nothing brings the effectors nearer."""
        return self._resting is not None

    @property
    def least_share(self) -> float:
        """Least share of a move that is made rather than a shorter one sought."""
        return 0.0 if self._task is None else LEAST_SHARE

    def depart(self, goal: np.ndarray) -> None:
        """Forget all targets, and let the actuators go to a place first.

        Args:
            goal: Their displacements there, shape (actuator_count,).
        """
        self.forget()
        self._departure = goal

    def solve(
        self, linear: Linearized, target_rows: np.ndarray, held: Actuation, bounds: Bounds,
        stiffness: StiffnessRows | None = None,
    ) -> tuple[Actuation, Actuation]:  # fmt: skip
        """Solve the inverse problem around one state.

        Args:
            linear: The condensed system.
            target_rows: Wanted effector coordinates [m], NaN where free,
                shape (effector_row_count,).
            held: What the actuators do when they stay.
            bounds: Bounds of this step.
            stiffness: Rows of wanted stiffnesses; None if none is wanted.

        Returns:
            The actuation, or the held one with `solved` False; and what a shorter step than that
            begins with: the held actuation, in which commanded actuators do as they are told.
        """
        begins, self._begins = self._learns and self._begins, False
        if begins:
            self._path.follow(linear.effectors_now, target_rows)
        if self._path.back:
            # Effectors that were caught are led back along their path.
            target_rows = self._path.back[-1]
        least, most = self._limits.drive_bounds(bounds)
        commanded, drives = least == most, held.drives(self._limits)
        any_commanded = bool(commanded.any())
        if begins:
            wanted = np.empty((2, len(target_rows)))
            write_wanted(target_rows, self._target_rows.weights, *wanted)
            situation = Situation(
                *wanted,
                linear.effector_places(held.efforts, held.contact.multipliers),
                drives, np.where(commanded, most, np.nan) if any_commanded else self._nowhere,
                self._is_balanced, self._loads, self._load, self._guided, self._is_stable,
            )  # fmt: skip
            self._begin(with_stiffness(situation, stiffness, held.efforts), linear, held)
        if any_commanded:
            held = self._direct.at_drives(linear, np.where(commanded, most, drives), bounds)
        # Where nothing is left to choose, how hard contacts press is told all the same.
        if len(held.contact.multipliers):
            held = self._with_limits(held)
        if (any_commanded and commanded.all()) or self.rests:
            return held, held
        return self._follow(Asked(linear, target_rows, held, bounds, commanded, stiffness)), held

    def _begin(self, situation: Situation, linear: Linearized, held: Actuation) -> None:
        """Judge what came of the last step, and choose what to do, where a step begins."""
        situation = self._with_forces(situation, linear, held)
        now, greatest, is_same = situation.compared(self._first)
        if not is_same:
            self._begin_anew(situation)
        last, self._situation = self._situation, situation
        self._now, self._reached = now, 0.5 * greatest * self._tolerance**2
        if not self._passed.balanced:
            self._passed.balanced.append(Place(situation.displacements, now))
        # Coordinates of orientations change while their targets stay.
        places = self._positions
        self._stays = (
            is_same and situation.bears_the_same(last)
            and half_squares(self._ones, last.targets[places], situation.targets[places]) == 0.0
            and np.array_equal(last.guided, situation.guided)
        )
        if now <= self._reached and not self._path.back:
            self._path.places.clear()
            self._greatest = GREATEST
        # Without misses there is no curvature, and it would hold what targets leave open.
        if self._curvature.last is not None and not (is_same and now > self._reached):
            self._curvature.forget()
        if is_same:
            self._see_drift(linear, situation)
        if self._departure is not None:
            self._goal, self._departure = self._departure, None
            self.is_departing, self._waits = True, 0
        self._settles, self._is_first = False, True
        if self._ends:
            self._resting, self._ends = situation.places, False
        self._is_same = is_same
        if self._goal is not None:
            self._arrive(situation)
        if self.rests:
            self._wake(situation)
        elif self._pending is not None and self._goal is None:
            is_judged = self._judge(situation)
            if is_judged and self._stays and self._may_settle and now > self._reached:
                self._learn_curvature(situation, linear, held)
        if self._goal is None:
            if self._is_stuck:
                # It goes back from where the body cannot even stay.
                self._passed.leave(situation.displacements, self._scales, SHRINK * GREATEST)
                self._resting = None
                self._go_back()
            elif self._stays and not self.rests:
                if self._passed.pass_by(situation, now, self._reached, self._settles):
                    self._go_back()
        self._is_stuck = self._is_refused = False
        self._limit_at_first = self.move_limit

    def _learn_curvature(self, situation: Situation, linear: Linearized, held: Actuation) -> None:
        """Learn how effectors curve, from how they answer to the drives here."""
        forces = held.contact.multipliers
        if len(situation.places) != len(linear.effectors):
            # Wanted stiffnesses are no places, and curve in other ways.
            return
        W, _ = with_contacts_closed(linear, forces)
        loads = linear.efforts(held.efforts, forces) / self._effort_scales
        bears = ~self._one_sided | (loads > NO_EFFORT * loads.max(initial=0.0))
        # Slides translate effectors, and curve nothing.
        jacobian = jacobian_by_drives(
            W, linear.groups.effectors, bears & ~self._by_effort, bears & ~self._is_moved,
            linear.augmentation.stiffness,
        )  # fmt: skip
        pull = situation.weights * (situation.places - situation.targets)
        presses = [key for key, force in zip(self._contact_keys(linear), forces, strict=True) if force > 0.0]
        bearing = bears.tobytes() + repr(presses).encode()
        self._curvature.learn(self._still(linear, held), jacobian, pull, bearing)

    def _begin_anew(self, situation: Situation) -> None:
        """Follow other targets, or under other loads."""
        self._first, radius, is_refused = situation, self.move_limit, self._is_refused
        self._open()
        if is_refused:
            # What bodies did not accept for one target, they hardly accept for the next one beside it.
            self.move_limit = min(GROW * radius, GREATEST)
        if longest_move(self._at_rest, situation.displacements, self._scales) <= LEAST:
            self._placed_at_rest = situation.places

    def _with_forces(self, situation: Situation, linear: Linearized, held: Actuation) -> Situation:
        """A situation with what else is judged; forces within their limits need not be."""
        return situation

    def _go_back(self) -> None:
        """Go to the nearest place in stable balance, and on from there by much shorter moves."""
        self._passed.since, self._pending, self._waits = 0, None, 0
        if (not self._is_freed or self._passed.is_over) and self._lets_go():
            self._passed.returns = 0
            return
        self._holds = self._passed.go_back()
        self.move_limit, self._goal = SHRINK**2 * self.move_limit, self._passed.nearest.drives
        self._branch = self._branch_before = None

    def _see_drift(self, linear: Linearized, situation: Situation) -> None:
        """How much T changes while the body settles at held actuators [m²], and whether it may."""
        places = situation.places.copy()
        places[: len(linear.effectors_now)] = linear.effectors_now
        missed = situation.tracking(places)
        self._drift = abs(missed - self._now)
        # What is not stable does not settle where the linearization sees it. Where effectors are at
        # their targets, and as stiff as wanted, only balance is missing, and moves go on for a while.
        self._arriving = 0 if situation.is_balanced else self._arriving + 1
        is_arriving = missed <= self._reached and self._arriving <= MOST_SWINGS
        self._may_settle = situation.is_stable and not is_arriving

    def _arrive(self, situation: Situation) -> None:
        """Follow on, or rest, where the actuators have come to their goal."""
        distance = longest_move(self._goal, situation.displacements, self._scales)
        self._waits += 1
        if (distance <= LEAST and situation.is_balanced) or self._waits >= MOST_WAITS:
            self._goal, self._waits, self.is_departing = None, 0, False
            if self._passed.drop_lost(self._now, self._reached, self._holds):
                self._goal = self._passed.nearest.drives if self._holds else None
            elif self._holds:
                self._resting, self._holds = situation.places, False

    def _wake(self, situation: Situation) -> None:
        """Follow again where something else moved a resting robot, each time less far."""
        if not self._rests_balanced:
            self._resting, self._rests_balanced = situation.places, situation.is_balanced
            return
        moved = np.abs(situation.places - self._resting)[situation.weights > 0.0]
        if situation.is_balanced and moved.max(initial=0.0) > WAKES * self._tolerance:
            self._greatest *= SHRINK**4
            self._resting, self._rests_balanced = None, False
            self.move_limit = self._greatest

    def _judge(self, situation: Situation) -> bool:
        """Fit the radius to how much of a promise came true, once the body has settled; whether it has."""
        move = self._pending
        if not self._may_settle:
            self._pending, self._waits = None, 0
            return False
        if self._stays and self._drift > DRIFT * move.promised and self._waits < MOST_WAITS:
            self._waits += 1
            self._settles = True
            return False
        self._pending, self._waits = None, 0
        noise = NOISE * max(move.now, self._reached)
        now = half_squares(situation.weights, situation.places, move.targets)
        share = (move.now - now + noise) / (move.promised + noise)
        if self._curvature.is_known:
            straight = move.promised + (move.rise if self._curvature.is_used else 0.0)
            self._curvature.compare(move.now - now, straight, move.rise)
        if not share >= KEEP:
            self.move_limit = SHRINK * min(move.length, self.move_limit)
            if self._stays:
                self._goal, self._branch = move.drives, self._branch_before
        elif share < POOR:
            self.move_limit = max(0.5 * move.length, LEAST)
        elif share > GOOD and move.length >= 0.9 * self.move_limit:
            self.move_limit = min(GROW * self.move_limit, self._greatest)
        return True

    def _follow(self, asked: Asked) -> Actuation:
        """What the actuators do; the held actuation with `solved` False where nothing is found."""
        held, self._task, self._is_noted = asked.held, None, False
        if self._goal is not None:
            return self._to_goal(asked)
        # Staying may press harder than allowed.
        touches = len(held.contact.multipliers) > 0
        pressed = held.contact.multipliers.max() if touches else 0.0
        is_allowed = pressed <= (1.0 + EXCESS) * self.force_limit
        if self._learns and self._settles and is_allowed:
            return held
        if self._learns and not self._is_first and self._by_effort.any():
            # What refused efforts may accept them once it has settled; their scales say little.
            self.move_limit = max(self.move_limit, self._limit_at_first)
        found = self._best(asked, self._branch)
        if found is None:
            if self._branch is not None:
                self._branch = None
                return held
            # Where the tangent is augmented, a small box may hold no optimum; balance comes first.
            return held._replace(solved=not self._is_balanced)
        if not self._learns:
            return found
        is_first, self._is_first = self._is_first, False
        # Where no actuation keeps the limit, staying is no worse.
        if touches:
            is_allowed |= found.contact.multipliers.max() >= (1.0 - EXCESS) * pressed
        self._task = asked
        if not (is_first and is_allowed):
            return found
        if self._is_same:
            return self._weighed(asked, found)
        is_none = self._promised(asked, found) <= NO_PROMISE * self._now
        rests = is_none and self._now > self._reached and not self._is_hindered(asked, found)
        return held if rests else found

    def _weighed(self, asked: Asked, found: Actuation) -> Actuation:
        """The optimum, if it promises enough; else what is done instead."""
        promised, is_missed = self._promised(asked, found), self._now > self._reached
        none = max(NO_PROMISE * self._now, NEAR_ENOUGH * self._reached)
        if asked.stiffness is not None:
            none *= STIFFNESS
        self._branch_before = self._branch
        drifts = self._may_settle and self._drift > max(DRIFT * promised, none)
        is_early = is_missed and promised <= none and not self._situation.is_balanced
        if self._stays and self._waits < MOST_WAITS and (drifts or is_early):
            self._waits += 1
            self._settles, self._task = True, None
            return asked.held
        self._waits = 0
        if promised <= none and is_missed:
            is_slow = self._is_hindered(asked, found)
            return found if is_slow else self._without_promise(asked, found)
        if promised > none:
            self._note(asked, found, promised)
        else:
            self._ends = self._is_open_at_rest(self._length(asked, found))
        return found

    def _without_promise(self, asked: Asked, found: Actuation) -> Actuation:
        """Leap beyond a kink, go back, let go, or else rest."""
        if self._now < (1.0 - MUCH_NEARER) * self._looked:
            found, leaps = self._leap(asked, found)
            if leaps:
                # It is judged by where it leads in the end: on the way it may be further away.
                self._task, self._passed.since = None, 0
                return found
        goes_back = self.move_limit > LEAST and self._now > (1.0 + PROGRESS) * self._passed.nearest.now
        if goes_back:
            self._go_back()
        if goes_back or self._lets_go():
            return asked.held if self._goal is None else self._to_goal(asked)
        self._ends = self._settles = True
        return asked.held

    def _to_goal(self, asked: Asked) -> Actuation:
        self._task, drives = None, asked.held.drives(self._limits)
        bounds = self._near(drives, asked, GREATEST, self._scales)
        goal = self._limits.drives_within(self._goal, bounds)
        return self._with_limits(self._direct.at_drives(asked.linear, goal, bounds))

    def _lets_go(self) -> bool:
        """Let go, then lead effectors back, once each, where the robot was caught; whether it does."""
        is_free = np.isnan(self._situation.commanded).all()
        if not (not self._path.has_turned and is_free and self._is_caught()):
            return False
        if self._is_freed:
            self._path.turn()
        else:
            self._open()
            self._goal, self._is_freed = self._at_rest, True
        return True

    def _is_caught(self) -> bool:
        """Whether the shape at rest, as drawn or under loads, is much nearer to the target."""
        # Of what else is wanted than places, such as a stiffness, the shape at rest has nothing.
        rest, own = np.zeros(len(self._situation.targets)), rest_rows(self._model)
        rest[: len(own)] = own
        nearest = self._situation.tracking(rest)
        if self._placed_at_rest is not None:
            rest[self._positions] = self._placed_at_rest[self._positions]
            nearest = min(nearest, self._situation.tracking(rest))
        return nearest < CAUGHT**2 * self._now

    def _is_open_at_rest(self, length: float) -> bool:
        """Whether what targets leave open has come to rest; it goes on by ever shorter moves.

        Args:
            length: Length of the next move, as a share of the actuators' scales.
        """
        self._swing_count += length > SETTLING * self._last_length
        self._last_length = length
        if self._swing_count > MOST_SWINGS:
            self.move_limit *= SHRINK
        return min(length, self.move_limit) <= LEAST

    def _note(self, asked: Asked, found: Actuation, promised: float) -> None:
        """Note a move, to judge it in the next step."""
        self._is_noted, length = True, self._length(asked, found)
        rise, drives = self._rise(asked, found) if self._curvature.is_known else 0.0, asked.held.drives(self._limits)
        self._pending = Pending(self._now, promised, rise, length, self._situation.targets, drives)

    def _promised(self, asked: Asked, found: Actuation) -> float:
        """Decrease of T that an actuation promises [m²]."""
        rows = asked.stiffness and self._in_branch(asked.stiffness, self._branch)
        promised = self._now - self._situation.tracking(self._places(asked.linear, found, rows))
        return promised - self._rise(asked, found) if self._curvature.is_used else promised

    def _rise(self, asked: Asked, found: Actuation) -> float:
        """By how much the curvature makes T rise on the way to an actuation [m²]."""
        return self._curvature.rise(self._still(asked.linear, found) - self._still(asked.linear, asked.held))

    def _length(self, asked: Asked, found: Actuation) -> float:
        """How far an actuation moves the actuators, as a share of their scales."""
        still = self._still(asked.linear, asked.held)
        return longest_move(still, found.drives(self._limits), self._held_scales(asked))

    def _held_scales(self, asked: Asked) -> np.ndarray:
        """Scales by which the radius holds the drives: slides only within the greatest one.

        A slide that touches nothing translates effectors, which the linearization tells exactly.
        """
        if not self._has_slides or asked.linear.contact_row_count:
            return self._scales
        return np.where(self._is_moved, max(self._greatest / self.move_limit, 1.0), 1.0) * self._scales

    def _is_hindered(self, asked: Asked, found: Actuation) -> bool:
        """Whether an actuation would go further but for a rate."""
        names = self._limits.binding(found.displacements, found.efforts, asked.bounds)
        return any(name.endswith(RATE) for name in names)

    def tries(self, found: Actuation, held: Actuation) -> Iterator[Actuation]:
        """What is tried until the bodies accept a move: the optimum, then those within ever smaller boxes.

        Args:
            found: What was found by `solve`.
            held: What the actuators do when they stay.
        """
        asked, before, judges = self._task, self.move_limit, self._is_noted
        yield found
        if asked is None or found is held:
            return
        for _ in range(TRIES):
            self.move_limit = SHRINK * min(self._length(asked, found), self.move_limit)
            shorter = self._best(asked, self._branch) if self.move_limit > LEAST else None
            if shorter is None:
                break
            found = shorter
            if judges:
                self._note(asked, found, self._promised(asked, found))
            yield found
        # What refuses the shortest move may accept a longer one once it has settled.
        self.move_limit = before
        if judges:
            self._pending = None
            if self._situation.is_balanced:
                self.move_limit = SHRINK**2 * before

    def refuse(self, is_stuck: bool) -> None:
        """Note that the bodies accepted less than what was found; the radius has shrunk already.

        Args:
            is_stuck: Whether they cannot even stay as they are.
        """
        self._is_stuck, self._is_refused = is_stuck, True

    def _best(self, asked: Asked, branch: np.ndarray | None = None) -> Actuation | None:
        """The optimum within the radius, in a branch of slack cables or in any."""
        linear, held = asked.linear, asked.held
        steps, weights = self.steps_to_targets(linear, asked.target_rows)
        if not self._proves:
            self._energy_now = self._weight_of_energy(linear, steps)
        rows = asked.stiffness and self._in_branch(asked.stiffness, branch)
        errors, weights, extra = rows_to_track(linear, steps, weights, rows)
        bounds = self._bearing(rows, branch, self._within_radius(asked))
        if self._curvature.is_used and rows is None and branch is None:
            errors, weights, extra = self._curved(asked, errors, weights)
        given = linear, errors, weights, held, bounds
        if extra is None and branch is None and not asked.commanded.any():
            found = self.guessed(*given)
            if found is not None:
                return found
        return self._over_branches(Tracking(*given, asked.commanded, extra), branch)

    def _curved(
        self, asked: Asked, errors: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Errors and weights with rows of the curvature below, and how multipliers change these rows."""
        linear, L = asked.linear, self._curvature.rows
        a, _, c = linear.groups
        by = np.concatenate([linear.W[a, a], linear.W[a, c]], axis=1)
        by = np.where(self._by_effort[:, None], np.eye(*by.shape), by)
        free = np.where(self._by_effort, 0.0, linear.violation[a])
        errors = np.concatenate([errors, L @ (free - self._still(linear, asked.held))])
        return errors, np.concatenate([weights, np.ones(len(L))]), L @ by

    def _contact_keys(self, linear: Linearized) -> list[tuple[int, int]]:
        # Shorter moves are solved for when contacts were detected elsewhere already.
        if linear is not self._keyed:
            self._keyed, self._keys = linear, list(super()._contact_keys(linear))
        return self._keys

    def _within_radius(self, asked: Asked) -> Bounds:
        """The box of the radius: of displacements, and of efforts that are drives."""
        # A slack cable is wound in to its path at once.
        still = self._still(asked.linear, asked.held)
        near = self._near(still, asked, self.move_limit, self._held_scales(asked))
        by_effort = self._by_effort & ~asked.commanded
        # Scales of efforts say little of how far they may go: the greatest radius holds none of them.
        if self.move_limit >= GREATEST or not by_effort.any():
            return near
        reach = np.where(by_effort, self.move_limit * self._scales, np.inf)
        return near._replace(
            effort_min=np.minimum(np.maximum(near.effort_min, still - reach), near.effort_max),
            effort_max=np.maximum(np.minimum(near.effort_max, still + reach), near.effort_min),
        )

    def _leap(self, asked: Asked, here: Actuation) -> tuple[Actuation, bool]:
        """The optimum of the most promising branch: one cable bears, or is slack, that did not, or none.

        Args:
            asked: What is asked for.
            here: The optimum without a leap.

        Returns:
            The optimum, or the one without a leap; and whether it leaps.
        """
        best, chosen, least = here, self._branch, (1.0 - LEAST_LEAP) * self._now
        self._looked, radius, self.move_limit = self._now, self.move_limit, GREATEST
        remembered = self._search.memory
        # In unstable places the radius vanishes, which says nothing of the stable one that it has come to.
        is_settled = self._situation.is_balanced and self._situation.is_stable
        here_too = [self._branch] if is_settled and radius < GREATEST else []
        for branch in (*here_too, *self._branches(asked)):
            rows = asked.stiffness and self._in_branch(asked.stiffness, branch)
            if rows is not None and not (rows.gradient.compliance > 0.0).all():
                continue
            found = self._best(asked, branch)
            self._search.memory = remembered
            if found is not None:
                left = self._situation.tracking(self._places(asked.linear, found, rows))
                if left < least:
                    best, chosen, least = found, branch, left
        self._direct.remember(best.efforts)
        self._branch = chosen
        if best is here:
            self.move_limit = radius
        return best, best is not here

    def _branches(self, asked: Asked) -> Iterator[np.ndarray]:
        """Slack cables of each branch beyond a kink, shape (actuator_row_count,)."""
        linear, held = asked.linear, asked.held
        count, forces = linear.groups.actuators.stop, held.contact.multipliers
        upper = asked.bounds.displacement_max
        if asked.stiffness is None:
            slack = np.zeros(count, dtype=bool) if self._branch is None else self._branch
            loads = linear.efforts(held.efforts, forces) / self._effort_scales
            bears = loads > NO_EFFORT * loads.max(initial=0.0)
            may_change = slack | (bears & (held.displacements >= upper - self._at_limit))
        else:
            bears = asked.stiffness.gradient.holds.any(axis=0)
            slack = self._may_hang & ~bears
            path = linear.actuator_displacements(held.efforts, forces)
            may_change = bears | (path <= upper + self._at_limit)
        for cable in np.flatnonzero(may_change & self._may_hang & ~asked.commanded):
            branch = slack.copy()
            branch[cable] = not branch[cable]
            yield branch

    def _in_branch(self, stiffness: StiffnessRows, branch: np.ndarray | None) -> StiffnessRows:
        """The rows of wanted stiffnesses with just these cables slack."""
        if branch is None:
            return stiffness
        holds = stiffness.gradient.holds
        bears = np.where(self._may_hang, ~branch, holds.any(axis=0))
        return stiffness if (holds == bears).all() else stiffness.with_bearing(bears)

    @staticmethod
    def _bearing(stiffness: StiffnessRows | None, branch: np.ndarray | None, bounds: Bounds) -> Bounds:
        """Bounds within which the cables of a branch bear where a finger pushes."""
        if stiffness is None or branch is None:
            return bounds
        least = np.where(branch, 0.0, BEARS * stiffness.gradient.bearing.max(axis=0))
        a = slice(0, len(least))
        effort_min = bounds.effort_min.copy()
        effort_min[a] = np.minimum(np.maximum(effort_min[a], least), bounds.effort_max[a])
        return bounds._replace(effort_min=effort_min)
