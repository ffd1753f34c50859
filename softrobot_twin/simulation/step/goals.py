"""Goals: what a command asks of a step, how that is solved for, and when it is met.

A command is read once, at the beginning of a step. From there on the step asks its goal, which is one
of four:

    goal        asks for                  is solved by                          is met where
    setpoints   drives of actuators       drives within the bounds              drives are near them
    efforts     efforts of actuators      the nearest efforts within bounds     efforts are near them
    targets     places of effectors       the inverse problem                   no effector misses more
                                                                                than the tolerance
    hold        that actuators stay       their drives at the beginning         always

A drive is what the setpoint of an actuator holds: a displacement, or the effort of what is
effort-driven; see `Actuators.drives`. Actuators without a command hold their drives.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.sensor_kinds import in_order
from softrobot_twin.simulation.command import (
    EFFORTS,
    HOLD,
    SETPOINTS,
    TARGETS,
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    fitting,
)
from softrobot_twin.simulation.state import State, made
from softrobot_twin.simulation.step.actuation import NO_EFFORT, Actuation
from softrobot_twin.simulation.step.augmented_tangent import HeldActuators
from softrobot_twin.simulation.step.direct_actuation import DirectActuation
from softrobot_twin.simulation.step.follower import Follower
from softrobot_twin.simulation.step.inverse_choice import why_not_followed
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.solvers.inverse_problem import Bounds

# Named where a target is further away than one step leads, or the steps are not there yet.
REACH = "effectors.reach"
# Named of a wanted contact force where nothing touches.
APART = "apart"
# Named where less weight of the energy would bring an effector nearer.
ENERGY = "solver.energy_weight"
# A demand is met when a displacement is this near to it, as a share of the actuator's scale.
DISPLACEMENT_MET = 1.0e-6
# And an effort, as a share of the demand and of the actuator's scale.
EFFORT_MET, EFFORT_NOTICED = 1.0e-4, 5.0e-6
# A step in balance that moves no node by more than this share of the body's size, and changes no
# effort by more than this share of its scale, keeps the state: at rest round-off leaves 1e-14.
KEPT_SHARE = 1.0e-12
# The same of a step towards targets, which moves setpoints too: where they come from an inverse
# problem, round-off leaves 1e-11.
KEPT_SHARE_TOWARDS_TARGETS = 1.0e-10
# And where the inverse lets the actuators stay: a soft, stable body turns round-off into so much.
KEPT_SHARE_WHILE_STAYING = 1.0e-6


@njit(**KERNEL)
def are_within(first, second, slack):
    """Whether `first` and `second` are within `slack`, all of shape (n,); NaN is not."""
    for i in range(len(first)):
        if not abs(first[i] - second[i]) <= slack[i]:
            return False
    return True


@njit(**KERNEL)
def are_near(displacements, made, scales):
    """Whether no displacement is off by more than `DISPLACEMENT_MET` of its scale; NaN is not.

    Args:
        displacements: Displacements wanted, in the actuators' units, shape (actuator_count,).
        made: Displacements made, same shape.
        scales: Scale of each, same shape.
    """
    for i in range(len(made)):
        if abs(displacements[i] - made[i]) > DISPLACEMENT_MET * scales[i]:
            return False
    return True


class Goal:
    """What a step is asked for, checked, and the bounds of the step; base of the four goals.

    Attributes:
        command: The command.
        drives: What the setpoints hold at the beginning of the step, shape (actuator_count,).
        reach: Bounds of this step by the hardware alone.
        bounds: Bounds of this step, in which commanded actuators are fixed.
        wanted: What is asked for: drives, efforts, or coordinates of effectors [m].
        driven_by: What it is called in tables.
        follows: Whether effectors are led to targets.
        seeks_once: Whether the first linearization of a step in contact alone seeks the actuators.
        needs_held: Whether it asks what actuators do when they stay, also in scenes with contacts.
    """

    driven_by: str
    follows = seeks_once = False
    needs_held = True

    def __init__(self, command: Command, state: State, goals: Goals):
        """Check a command, and compute the bounds of this step.

        Args:
            command: The command.
            state: State at the beginning of the step.
            goals: Knows the scene and its solvers.

        Raises:
            CommandError: The command does not fit the scene, or is not finite.
        """
        self.command, self._goals, self._model = command, goals, goals.model
        self._limits = goals.model.actuators.limits
        self.drives = goals.model.actuators.drives(state.setpoints)
        self.bounds = self.reach = self._reach(state)
        self.wanted = self.drives

    def _reach(self, state: State) -> Bounds:
        """Where the actuators may move in the step."""
        command, limits = self.command, self._limits
        moving = command.time_step if command.reach_time is None else command.reach_time
        if not (math.isfinite(moving) and moving >= 0.0):
            raise CommandError("reach_time", f"{moving} s is not a duration")
        bounds = limits.bounds(self.drives, moving)
        if limits.has_flow and moving > 0.0:
            grown = self._model.actuators.displacements(state.setpoints, state.positions)
            bounds = limits.with_flow(bounds, grown, moving)
        return bounds

    @property
    def held(self) -> HeldActuators | None:
        """What the actuators are held at, or a step towards targets starts from; None where efforts
        are prescribed."""
        return HeldActuators(self.wanted, self.bounds, self.reach, True)

    def solve(
        self, linear: Linearized, held: Actuation | None, rows: Any
    ) -> tuple[Actuation, Actuation | None]:
        """Find λ as it is asked for.

        Args:
            linear: The condensed system.
            held: What the actuators do when they stay; None where nothing asks for it.
            rows: Rows of parts, below those of the effectors; None without any.

        Returns:
            The actuation, and the one that a shorter step begins with.
        """
        raise NotImplementedError

    def is_met(self, actuation: Actuation, missed: np.ndarray) -> bool:
        """Whether what was asked is so.

        Args:
            actuation: What was done.
            missed: Distance of each effector from its target [m], NaN without one,
                shape (effector_count,).
        """
        raise NotImplementedError

    def _are_there(self, drives: np.ndarray, actuation: Actuation) -> bool:
        """Whether actuators are where they should be; NaN asks nothing."""
        return are_near(drives, actuation.drives(self._limits), self._limits.drive_scale)

    def limits_met(self, actuation: Actuation, is_slack=None) -> tuple[str, ...]:
        """Names of the limits that restrict an actuation.

        Args:
            actuation: What was done.
            is_slack: See `ActuatorLimits.binding`.
        """
        efforts = actuation.efforts
        binding = self._limits.binding(actuation.displacements, efforts, self.reach, is_slack)
        return (*binding, *actuation.given_up)

    def errors(self, places: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """How far each effector is from its target.

        Args:
            places: Where the effectors are [m], shape (effector_count, 3).
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Distances over the directions that it is controlled along [m], and angles over what its
            orientation asks for [rad], None in a scene without orientations; NaN without a target,
            each of shape (effector_count,).
        """
        effectors = self._model.effectors
        none = np.full(len(effectors.effectors), np.nan)
        return none, none if effectors.orientations else None

    def misses_of_sensors(self, positions: np.ndarray) -> np.ndarray:
        """How far sensors are from their targets; see `TargetGoal`."""
        return np.empty(0)

    def keeps(self, before: State, after: State, is_stable: bool) -> bool:
        """Whether a step that ended in balance changed nothing but by round-off.

        Args:
            before: State where it began.
            after: State where it ended.
            is_stable: Whether the bodies are stable where actuators are held.
        """
        return self._is_kept(before, after, np.zeros(len(after.setpoints)), KEPT_SHARE)

    def _is_kept(self, before: State, after: State, slack: np.ndarray, share: float) -> bool:
        """Whether setpoints changed by no more than their slack, and the rest by no more than a share.
        """
        size, efforts = self._model.nodes.size, share * self._limits.effort_scale
        return (
            are_within(after.setpoints, before.setpoints, slack) and math.isfinite(size)
            and bool((np.abs(after.positions - before.positions) <= share * size).all())
            and bool((np.abs(after.efforts - before.efforts) <= efforts).all())
        )  # fmt: skip


class HoldGoal(Goal):
    """All actuators hold their setpoints."""

    driven_by = HOLD

    def _reach(self, state: State) -> Bounds:
        return self._limits.bounds(self.drives, 0.0)

    def solve(self, linear, held, rows) -> tuple[Actuation, Actuation]:
        """See `Goal`."""
        return held, held

    def is_met(self, actuation: Actuation, missed: np.ndarray) -> bool:
        """See `Goal`."""
        return True

    def limits_met(self, actuation: Actuation, is_slack=None) -> tuple[str, ...]:
        """None: a command to hold needs no motion, so no limit restricts it."""
        return ()


def _refuse_nothing(name: str, values: np.ndarray) -> None:
    """Refuse values that command none of some actuators: a failed computation gives NaN for all."""
    if values.size and np.isnan(values).all():
        raise CommandError(name, f"holds {np.nan} for all actuators: Hold keeps them where they are")


class SetpointGoal(Goal):
    """Actuators move to setpoints, as far as the bounds let them; those without one hold theirs."""

    driven_by, needs_held = SETPOINTS, False

    def __init__(self, command: Command, state: State, goals: Goals):
        """See `Goal`."""
        super().__init__(command, state, goals)
        setpoints = fitting("setpoints", command.setpoints, self.drives.shape, True)
        _refuse_nothing("setpoints", setpoints)
        wanted = self._model.actuators.drives(setpoints)
        self.wanted = np.where(np.isnan(setpoints), self.drives, wanted)

    def solve(self, linear, held, rows) -> tuple[Actuation, Actuation | None]:
        """See `Goal`."""
        prescribed = self._limits.drives_within(self.wanted, self.bounds)
        return self._goals.direct.at_drives(linear, prescribed, self.bounds), held

    def is_met(self, actuation: Actuation, missed: np.ndarray) -> bool:
        """See `Goal`."""
        return self._are_there(self.wanted, actuation)


class EffortGoal(Goal):
    """Actuators act with given efforts, as far as the bounds let them; the others hold their drives."""

    driven_by, held = EFFORTS, None

    def __init__(self, command: Command, state: State, goals: Goals):
        """See `Goal`."""
        super().__init__(command, state, goals)
        efforts = fitting("efforts", command.efforts, self.drives.shape, True)
        _refuse_nothing("efforts", efforts[self._model.actuators.takes_efforts])
        keeps_effort = np.isnan(efforts) & self._limits.is_effort_driven
        self.wanted = np.where(keeps_effort, self.drives, efforts)

    def solve(self, linear, held, rows) -> tuple[Actuation, Actuation]:
        """See `Goal`."""
        found = self._goals.direct.at_efforts(linear, self.wanted, held, self.bounds)
        return found._replace(are_efforts_given=True), held

    def is_met(self, actuation: Actuation, missed: np.ndarray) -> bool:
        """See `Goal`."""
        prescribed = np.isfinite(self.wanted)
        slack = EFFORT_MET * np.abs(self.wanted) + EFFORT_NOTICED * self._limits.effort_scale
        return bool((np.abs(self.wanted - actuation.efforts) <= slack)[prescribed].all())


class TargetGoal(Goal):
    """Effectors are led to targets, while some actuators may be commanded beside them.

    Attributes:
        commanded: Drives commanded beside targets, NaN where free, shape (actuator_count,).
    """

    driven_by, follows = TARGETS, True

    def __init__(self, command: Command, state: State, goals: Goals):
        """See `Goal`."""
        super().__init__(command, state, goals)
        if not goals.inverse:
            raise CommandError("targets", why_not_followed(goals.model))
        self.seeks_once, effectors = goals.inverse.seeks_once, goals.model.effectors
        self.commanded = goals.none_commanded
        count, turns = len(effectors.effectors), command.orientations
        self.wanted = effectors.rows_of(fitting("targets", command.targets, (count, 3), True))
        if effectors.orientations:
            # They are aimed at their targets.
            free = np.full((count, 4), np.nan)
            turns = free if turns is None else fitting("orientations", turns, free.shape, True)
            self.wanted = np.concatenate([self.wanted, effectors.aim(turns, state.positions)])
        elif turns is not None:
            raise CommandError("orientations", "no effector of this scene asks for an orientation")
        self._sensors = goals.model.wanted_sensors
        if self._sensors or command.sensors is not None:
            self._add_sensors(command.sensors)
        if command.stiffness is not None:
            self._check_stiffness(command.stiffness)
        if command.commanded is not None:
            setpoints = fitting("commanded", command.commanded, self.drives.shape, True)
            self.commanded = goals.model.actuators.drives(setpoints)
            self.bounds = self._with_commanded()

    def _add_sensors(self, asked: np.ndarray | None) -> None:
        """Take wanted values of sensors, each in its unit, and refuse those of sensors without a weight."""
        own = self._goals.wanted_sensors
        values = np.full(len(own), np.nan) if asked is None else fitting("sensors", asked, (len(own),), True)
        for (name, is_wanted), value in zip(own.items(), values, strict=True):
            if not is_wanted and np.isfinite(value):
                raise CommandError(name, "is a sensor without a weight: it is told, not wanted")
        if self._sensors:
            self._of_sensors = self._sensors.lengths * values[list(own.values())]
            self.wanted = np.concatenate([self.wanted, self._of_sensors])
            if self._sensors.shows_contacts:
                forces = self.wanted[-len(self._of_sensors) :][self._sensors.contact_rows]
                if (forces < 0.0).any():
                    raise CommandError("sensors", "contacts only press: a force below 0 N is none of theirs")
                # What shall not press need not come near.
                forces[(forces == 0.0) & ~self._are_pressing()] = np.nan

    def misses_of_sensors(self, positions: np.ndarray) -> np.ndarray:
        """How far each sensor that may have a target is from it [m], NaN without one.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        if not self._sensors:
            return super().misses_of_sensors(positions)
        shown = self._sensors.readings(positions) * self._sensors.lengths
        return np.abs(shown - self._of_sensors)

    def _are_pressing(self) -> np.ndarray:
        """Whether each contact force that may have a target is above zero, in the order of its rows."""
        return self._sensors.readings(self._model.nodes.rest_positions)[self._sensors.contact_rows] > 0.0

    def _pairs_apart(self) -> tuple[str, ...]:
        """Names of the wanted contact forces of which nothing touches, such as ``touch.apart``."""
        if not (self._sensors and self._sensors.shows_contacts):
            return ()
        rows, names = self._sensors.contact_rows, [name for name, own in self._goals.wanted_sensors.items() if own]
        are_apart = (self._of_sensors[rows] > 0.0) & ~self._are_pressing()
        return tuple(f"{name}.{APART}" for name in np.array(names)[rows][are_apart])

    def _check_stiffness(self, stiffness: np.ndarray) -> None:
        """Refuse wanted stiffnesses [N/m] that are none, or of effectors that ask for none."""
        shape = (len(self._model.effectors.effectors), 3)
        wanted = fitting("stiffness", stiffness, shape, True)
        if not (np.isnan(wanted) | (wanted > 0.0)).all():
            worst = np.nanmin(wanted)
            raise CommandError("stiffness", f"{worst} N/m is not a positive stiffness")
        for effector, own in zip(self._model.scene.effectors, wanted, strict=True):
            if not effector.stiffness and np.isfinite(own).any():
                raise CommandError(effector.name, "asks for no stiffness in the scene")

    def _with_commanded(self) -> Bounds:
        """Bounds in which the commanded actuators are fixed, by displacement or by effort."""
        bounds, by_effort = self.reach, self._limits.is_effort_driven
        within, is_told = self._limits.drives_within(self.commanded, bounds), ~np.isnan(self.commanded)
        return Bounds(*(
            np.where(is_told & (by_effort == is_effort), within, bound)
            for bound, is_effort in zip(bounds, (False, False, True, True))
        ))  # fmt: skip

    @property
    def held(self) -> HeldActuators:
        """What the step starts from."""
        return HeldActuators(self.drives, self.bounds, self.reach, False)

    def solve(self, linear, held, rows) -> tuple[Actuation, Actuation]:
        """See `Goal`."""
        return self._goals.inverse.solve(linear, self.wanted, held, self.bounds, rows)

    def as_found(self, actuation: Actuation) -> SetpointGoal:
        """What moves the actuators as they were found, while the bodies come to balance.

        Args:
            actuation: What was found.
        """
        return made(SetpointGoal, self.__dict__, wanted=actuation.drives(self._limits), seeks_once=False)

    def is_met(self, actuation: Actuation, missed: np.ndarray) -> bool:
        """See `Goal`."""
        tolerance = self._model.reach_tolerance
        reached = all(miss <= tolerance for miss in missed.tolist() if math.isfinite(miss))
        return reached and self._are_there(self.commanded, actuation)

    def limits_met(self, actuation: Actuation, is_slack=None) -> tuple[str, ...]:
        """See `Goal`. A cable that is not commanded and has no tension holds nothing back: its winch
        may be at a limit, which binds nothing."""
        def hangs() -> np.ndarray:
            loads = actuation.efforts / self._limits.effort_scale
            slack = self._model.actuators.one_sided & (loads <= NO_EFFORT * loads.max(initial=0.0))
            return slack & np.isnan(self.commanded)

        return super().limits_met(actuation, is_slack or hangs)

    def errors(self, places: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """See `Goal`."""
        effectors = self._model.effectors
        misses, count = effectors.rows_of(places - self.command.targets), len(effectors.effectors)
        owners = effectors.row_effector[: len(misses)]
        distances = np.sqrt(np.bincount(owners, misses * misses, count))
        if not effectors.orientations:
            return distances, None
        distances[np.setdiff1d(np.arange(count), owners)] = np.nan
        return distances, effectors.angles(positions)

    def what_else_holds(
        self, linear: Linearized, held: Actuation | None, before: np.ndarray, after: np.ndarray
    ) -> tuple[str, ...]:
        """Names of limits other than those of actuators that keep effectors from their targets.

        Args:
            linear: The last linearization.
            held: What the actuators do there when they stay; None if bodies moved on since actuators
                were sought.
            before: Distances of the effectors from the same targets before the step [m],
                shape (effector_count,).
            after: After it [m], same shape.
        """
        inverse, tolerance = self._goals.inverse, self._model.reach_tolerance
        apart = self._pairs_apart()
        if apart:
            return apart if inverse.rests or self._model.is_dynamic else (REACH,)
        most = np.fmax.reduce(before, initial=0.0)
        nearer = most - np.fmax.reduce(after, initial=0.0)
        if nearer > tolerance or nearer > inverse.least_progress * most:
            return (REACH,)
        is_held = held is not None and inverse.is_held_by_energy(
            linear, self.wanted, held, self.bounds, tolerance
        )
        return (ENERGY,) if is_held else ()

    def keeps(self, before: State, after: State, is_stable: bool) -> bool:
        """See `Goal`."""
        stays = is_stable and self._goals.inverse.rests
        slack = KEPT_SHARE_TOWARDS_TARGETS * self._limits.drive_scale
        share = KEPT_SHARE_WHILE_STAYING if stays else KEPT_SHARE_TOWARDS_TARGETS
        if not self._is_kept(before, after, slack, share):
            return False
        # Where rates are very small, a robot under way looks like one at rest.
        least, most = self._limits.drive_bounds(self.bounds)
        return not bool(((least < most) & (most - least <= 4.0 * slack)).any())


_GOALS = {Hold: HoldGoal, CommandSetpoints: SetpointGoal, CommandEfforts: EffortGoal,
          FollowTargets: TargetGoal}  # fmt: skip


class Goals:
    """Reads commands for one scene.

    Attributes:
        model: The built scene.
        direct: Finds λ of what is commanded or held.
        inverse: Finds λ towards targets; None in scenes that cannot follow them.
        wanted_sensors: Whether each sensor may have a target, by name, in the order of all arrays.
        none_commanded: Drives where no actuator is commanded beside targets, NaN, shape (actuator_count,).
    """

    def __init__(self, model: Model, direct: DirectActuation, inverse: Follower | None):
        """Take what goals are read and solved by; see the attributes."""
        self.model, self.direct, self.inverse = model, direct, inverse
        self.wanted_sensors = {one.name: bool(one.weight) for _, one in in_order(model.scene)}
        self.none_commanded = np.full(model.actuators.count, np.nan)

    def read(self, command: Command, state: State) -> Goal:
        """Check a command, and compute the bounds of this step.

        Args:
            command: The command.
            state: State at the beginning of the step.

        Raises:
            CommandError: The command does not fit this scene, or is not finite.
        """
        if type(command) not in _GOALS:
            raise CommandError(type(command).__name__, "is not a command")
        if not (math.isfinite(command.time_step) and command.time_step >= 0.0):
            raise CommandError("time_step", f"{command.time_step} s is not a duration")
        if self.model.is_dynamic and command.time_step == 0.0:
            raise CommandError("time_step", "0 s: a scene that moves in time needs a time step")
        return _GOALS[type(command)](command, state, self)
