"""Numbers of a scene that bring its poses where they are wanted, by derivatives of equilibria.

A design has a few variables, each a number of the scene or several that change together, and poses,
each an equilibrium at what its actuators are commanded. Each trial builds the scene with other
numbers and settles its poses from those of the last accepted trial. Derivatives follow from the
tangents at the poses (`analysis/sensitivities.py`), so a trial costs as much as ten variables.

Wanted places are met by bounded least squares, any other function by a quasi-Newton method within
bounds. A trial that has no such equilibria is refused: the next one is nearer.

What the data cannot tell is the flatness: how far a variable can move, while the others make up for
it as well as they can, until the poses tell the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.analysis.sensitivities import Sensitivities
from softrobot_twin.errors import NamedError, SoftRobotTwinError
from softrobot_twin.harness.equilibrium import FollowedPoses
from softrobot_twin.scene import Scene
from softrobot_twin.scene.scene_parameters import JointParameter, Parameter
from softrobot_twin.simulation import Simulation, State
from softrobot_twin.simulation.building.limits import DISPLACEMENT_MARGIN, HOLDING_MARGIN
from softrobot_twin.tables.input_tables import real_array

# A search ends where variables move by less than this share of their bounds, or the objective changes
# by less than this share.
STILL, MOST_TRIALS = 1.0e-5, 100
# Least squares end where no move over the whole bounds betters half of the square of the misfit, in
# tolerances, by more than this.
ENOUGH = 1.0e-3
# Second derivatives of a function are differences over this share of the bounds.
SECOND_STEP = 1.0e-3
# How often a refused trial may bring the search back.
MOST_REFUSALS = 12


class DesignError(NamedError):
    """A design cannot be asked for, or has no such equilibria."""


class Pose(NamedTuple):
    """What actuators are commanded in a pose.

    Attributes:
        setpoints: Each in the unit of its kind, shape (actuator_count,).
        drives: The displacements from rest, such as shortenings, or efforts that these hold in the
            scene that is given, same shape.
        holds_setpoints: Whether each keeps its setpoint in other scenes, such as the length of a
            cable; else its drive; same shape.
        efforts: With which actuators act in place of setpoints, NaN for the others, same shape; None
            for no efforts.
    """

    setpoints: np.ndarray
    drives: np.ndarray
    holds_setpoints: np.ndarray
    efforts: np.ndarray | None = None


class Equilibria(NamedTuple):
    """What is found at all poses, or derivatives of it or by it, which may have a last axis more.

    Attributes:
        effectors: Positions of the effectors [m], shape (pose_count, effector_count, 3).
        efforts: Of the actuators, in their units, shape (pose_count, actuator_count).
    """

    effectors: np.ndarray
    efforts: np.ndarray


Objective = Callable[[Equilibria], tuple[float, Equilibria]]
"""Gives a number that shall be small, and its derivatives by effectors and efforts."""


class Solved(NamedTuple):
    """The poses of one trial.

    Attributes:
        values: Of the variables, shape (variable_count,).
        simulation: Of the scene with these.
        states: Of each pose.
        found: Places and efforts.
        slack: Names of actuators that hold nothing, of each pose.
    """

    values: np.ndarray
    simulation: Simulation
    states: tuple[State, ...]
    found: Equilibria
    slack: tuple[tuple[str, ...], ...]


class DesignModel:
    """Poses of a robot as a differentiable function of some numbers of its scene.

    Attributes:
        scene: The scene that is given.
        variables: The numbers.
        start: Their values in that scene, shape (variable_count,).
        poses: The poses.
    """

    def __init__(self, scene: Scene, variables: Sequence[Parameter | JointParameter], poses: Sequence[Pose]):
        """Build the scene.

        Args:
            scene: The scene, in statics.
            variables: What changes.
            poses: What actuators are commanded.

        Raises:
            DesignError: There is nothing to change or to settle, or the scene moves.
        """
        if not variables or not poses:
            raise DesignError("design", "needs at least one parameter and one pose")
        if scene.integration != "quasi_static":
            raise DesignError("integration", f"{scene.integration} has no equilibria to design: use "
                              "a scene of statics, quasi_static")
        self.scene, self.variables, self.poses = scene, tuple(variables), tuple(poses)
        self._followed = FollowedPoses(scene, self.variables)
        self.start = self._followed.values
        self._last: Solved | None = None

    def scene_at(self, values: np.ndarray) -> Scene:
        """The scene with other values of the variables.

        Args:
            values: Each in its unit, shape (variable_count,).

        Raises:
            SceneError: The scene does not take a value.
        """
        return self._followed.scene_at(values)

    def solve(self, values: np.ndarray) -> Solved:
        """The poses at values of the variables.

        Args:
            values: Each in its unit, shape (variable_count,).

        Raises:
            DesignError: A pose is not reached, or an actuator does not hold what it is commanded.
            SceneError: The scene does not take a value.
        """
        values = np.array(values, float)
        if self._last is not None and np.array_equal(self._last.values, values):
            return self._last
        self._followed.take(values)
        simulation, is_first = self._followed.simulation, self._last is None
        states, places, efforts, slack = [], [], [], []
        for index in range(len(self.poses)):
            slack.append(self._settle(index))
            states.append(simulation.state)
            if is_first:
                self._followed.keep(index, simulation.state)
            places.append(simulation.effector_positions())
            efforts.append(simulation.state.efforts)
        found = Equilibria(np.array(places), np.array(efforts))
        self._last = Solved(values, simulation, tuple(states), found, tuple(slack))
        return self._last

    def derivatives(self, values: np.ndarray) -> Equilibria:
        """Derivatives of the poses by the variables, shapes (..., variable_count).

        Args:
            values: See `solve`.

        Raises:
            SensitivityError: A derivative does not exist.
        """
        found = []
        for index, pose in enumerate(self.poses):
            tangent = self._tangent(values, index)
            found.append(tangent.of_parameters(self.variables, pose.holds_setpoints))
            self._followed.keep(index, self._last.states[index], found[-1])
        return Equilibria(np.array([one.effectors for one in found]),
                          np.array([one.efforts for one in found]))

    def gradient(self, values: np.ndarray, weights: Equilibria) -> np.ndarray:
        """Derivatives of one function of the poses by all variables, by the adjoint.

        Args:
            values: See `solve`.
            weights: Derivatives of the function by the poses.

        Returns:
            Shape (variable_count,).

        Raises:
            SensitivityError: A derivative does not exist.
        """
        gradient = np.zeros(len(self.variables))
        for index, pose in enumerate(self.poses):
            gradient += self._tangent(values, index).gradient(
                self.variables, weights.effectors[index], weights.efforts[index],
                pose.holds_setpoints)
        return gradient

    def _tangent(self, values: np.ndarray, index: int) -> Sensitivities:
        """The tangent at a pose; the trial is where the next ones begin."""
        solved, efforts = self.solve(values), self.poses[index].efforts
        self._followed.take(values)
        tangent = self._followed.tangent
        tangent.by_effort = False if efforts is None else np.isfinite(efforts)
        self._followed.simulation.restore(solved.states[index])
        self._followed.keep(index, solved.states[index])
        return tangent

    def _settle(self, index: int) -> tuple[str, ...]:
        """Brings the simulation to a pose; gives the names of actuators that hold nothing."""
        pose, simulation = self.poses[index], self._followed.simulation
        setpoints = np.where(pose.holds_setpoints, pose.setpoints,
                             simulation.actuators.setpoints(pose.drives))
        rest = self._followed.settle(index, setpoints, pose.efforts)
        if not rest.is_reached:
            at = ", ".join(rest.result.report.active_limits)
            raise DesignError(f"pose {index}", f"does not come to rest: {rest.status}{at and f' ({at})'}")
        return _check_held(simulation, setpoints, pose, index)


def _check_held(simulation: Simulation, setpoints: np.ndarray, pose: Pose, index: int) -> tuple[str, ...]:
    """Refuses actuators at limits; gives the names of those that hang slack."""
    actuators, efforts, slack = simulation.actuators, simulation.state.efforts, []
    limits, wanted = actuators.limits, actuators.drives(setpoints)
    has, margins = actuators.drives(simulation.state.setpoints), HOLDING_MARGIN * limits.effort_scale
    is_far = np.abs(has - wanted) > DISPLACEMENT_MARGIN * limits.drive_scale
    is_commanded = np.ones(len(has), bool) if pose.efforts is None else ~np.isfinite(pose.efforts)
    for place in np.flatnonzero(is_commanded):
        name, kind, margin = actuators.names[place], actuators.kinds[place], margins[place]
        quantity = kind.effort if kind.is_effort_driven else kind.displacement
        if is_far[place]:
            raise DesignError(name, f"is commanded a {quantity.word} of {wanted[place]:.6g} {quantity.unit} "
                              f"in pose {index}, but its limit is {has[place]:.6g} {quantity.unit}")
        if actuators.is_effort_driven[place]:
            continue
        least, most = limits.effort_min[place], limits.effort_max[place]
        is_least, is_most = efforts[place] <= least + margin, efforts[place] >= most - margin
        if is_least and kind.one_sided and least == 0.0:
            slack.append(name)
        elif is_least or is_most:
            word, end = ("least", least) if is_least else ("greatest", most)
            raise DesignError(name, f"is at its {word} {kind.effort.word} of {end:g} {kind.effort.unit} in "
                              f"pose {index}, where it no longer holds its {kind.displacement.word}")
    return tuple(slack)


# --- the search ----------------------------------------------------------------------------------


class Found(NamedTuple):
    """A design.

    Attributes:
        values: Of the variables, shape (variable_count,).
        before: The objective at the start: the distance of effectors from their wanted places, RMS
            [m], or the value of the function.
        after: The same at the end.
        tolerance: A change of the objective that is not told; see `flatness`.
        flatness: How far each variable can move until the objective tells, in its unit, its bounds'
            width at most, shape (variable_count,).
        told: By how many tolerances the objective tells a move of variables over the whole width of
            their bounds along each direction, the most first, shape (variable_count,): singular
            values of the derivatives, or roots of curvatures.
        directions: Shares of the bounds' widths in each of these moves, as rows, each of norm 1,
            shape (variable_count, variable_count).
        promise: By how much less the objective would be by its derivatives at the end, in its unit:
            much where a kink is near, at which no trial keeps what they promise.
        refusals: Why trials were refused, each reason once.
        trials: Number of trials.
        solved: The poses at the end.
    """

    values: np.ndarray
    before: float
    after: float
    tolerance: float
    flatness: np.ndarray
    told: np.ndarray
    directions: np.ndarray
    promise: float
    refusals: tuple[str, ...]
    trials: int
    solved: Solved


class DesignSearch:
    """Looks for values of the variables within bounds."""

    def __init__(self, model: DesignModel, bounds: np.ndarray):
        """Take the bounds.

        Args:
            model: The poses.
            bounds: Least and greatest values, shape (variable_count, 2).

        Raises:
            DesignError: Bounds are empty, or the scene's value is outside.
        """
        self._model = model
        self._low, self._width = bounds[:, 0], bounds[:, 1] - bounds[:, 0]
        for one, (low, high), value in zip(model.variables, bounds, model.start, strict=True):
            if not (np.isfinite([low, high]).all() and low < high):
                raise DesignError(one.key, f"has the bounds {low:g} and {high:g} {one.unit}, which must be "
                                  "finite, the lower one first")
            if not low <= value <= high:
                raise DesignError(one.key, f"is {value:g} {one.unit} in the scene, outside of its bounds "
                                  f"{low:g} to {high:g} {one.unit}")
        self._refusals, self._trials = dict[str, None](), 0

    def _shares(self, values: np.ndarray) -> np.ndarray:
        """Shares of the bounds at values, both of shape (variable_count,)."""
        return (values - self._low) / self._width

    def meet(self, wanted: np.ndarray, tolerance: float) -> Found:
        """Values by which effectors are nearest to wanted places, by bounded least squares.

        Args:
            wanted: Places [m], NaN where an effector is free, shape (pose_count, effector_count, 3).
            tolerance: Distance, RMS, below which places count as the same [m].

        Raises:
            DesignError: The poses of the scene itself cannot be settled.
            SensitivityError: A derivative does not exist.
        """
        from scipy.optimize import least_squares  # it loads slowly

        is_asked = np.isfinite(wanted)
        scale = 1.0 / np.sqrt(max(1, is_asked.any(axis=2).sum()))

        def errors(shares: np.ndarray) -> np.ndarray:
            solved = self._tried(shares)
            if solved is None:
                return np.full(np.count_nonzero(is_asked), np.nan)
            return scale * (solved.found.effectors - wanted)[is_asked] / tolerance

        def slopes(shares: np.ndarray) -> np.ndarray:
            found = self._model.derivatives(self._values(shares)).effectors[is_asked]
            return scale * found * self._width / tolerance

        start = self._shares(self._model.start)
        self._model.solve(self._values(start))
        before = errors(start)
        found = least_squares(errors, start, slopes, bounds=(0.0, 1.0), xtol=STILL, ftol=STILL,
                              gtol=ENOUGH, max_nfev=MOST_TRIALS)
        J = slopes(found.x)
        _, singular, directions = np.linalg.svd(J)
        told = np.pad(singular, (0, len(directions) - len(singular)))
        before, after = (tolerance * float(np.linalg.norm(each)) for each in (before, found.fun))
        gain = _promised(found.x, found.fun @ J, told, directions)
        promise = after - np.sqrt(max(0.0, after**2 - 2.0 * gain * tolerance**2))
        return self._found(found.x, before, after, tolerance, told, directions, promise)

    def minimise(self, objective: Objective, tolerance: float | None = None) -> Found:
        """Values by which a function of the poses is least, by L-BFGS-B.

        Args:
            objective: The function.
            tolerance: Change of its value that does not matter; None for 1 % of its change by the
                search.

        Raises:
            DesignError: The poses of the scene itself cannot be settled.
            SensitivityError: A derivative does not exist.
        """
        def value_and_slopes(shares: np.ndarray) -> tuple[float, np.ndarray]:
            solved = self._tried(shares)
            if solved is None:
                raise _Refused(shares)
            told, shapes = objective(solved.found), [np.shape(one) for one in solved.found]
            try:
                value, weights = told
                number = real_array(value).item()
                weights = Equilibria(*weights)
                if not np.isfinite(number) or [np.shape(one) for one in weights] != shapes:
                    raise ValueError
            except (TypeError, ValueError, OverflowError):
                raise DesignError("objective", "must return a finite number and its derivatives as Equilibria "
                                  f"of the shapes {shapes[0]} and {shapes[1]}") from None
            return number, self._width * self._model.gradient(self._values(shares), weights)

        shares = self._shares(self._model.start)
        self._model.solve(self._values(shares))
        before, _ = value_and_slopes(shares)
        shares, after = _least(value_and_slopes, shares, before)
        if tolerance is None:
            tolerance = 0.01 * (abs(before - after) or abs(after) or 1.0)
        _, slopes = value_and_slopes(shares)
        curvatures, directions = np.linalg.eigh(self._second(value_and_slopes, shares, slopes))
        told = np.sqrt(np.maximum(curvatures[::-1], 0.0) / (2.0 * tolerance))
        directions = directions.T[::-1]
        gain = 2.0 * tolerance * _promised(shares, slopes / (2.0 * tolerance), told, directions)
        found = self._found(shares, before, after, tolerance, told, directions, gain)
        # At a bound the slope tells, too.
        with np.errstate(divide="ignore"):
            steep = np.minimum(found.flatness, self._width * tolerance / np.abs(slopes))
        return found._replace(flatness=steep)

    def _second(self, value_and_slopes: _Function, shares: np.ndarray, middle: np.ndarray) -> np.ndarray:
        """Second derivatives of a function, by differences of its slopes; square, symmetric."""
        rows = []
        for index, one in enumerate(np.eye(len(shares))):
            step = SECOND_STEP if shares[index] < 0.5 else -SECOND_STEP
            try:
                rows.append((value_and_slopes(shares + step * one)[1] - middle) / step)
            except _Refused:  # There are no equilibria on this side.
                rows.append((value_and_slopes(shares - step * one)[1] - middle) / -step)
        return 0.5 * (np.array(rows) + np.array(rows).T)

    def _found(
        self, shares: np.ndarray, before: float, after: float, tolerance: float, told: np.ndarray,
        directions: np.ndarray, promise: float,
    ) -> Found:  # fmt: skip
        """The design, with its flatness: the box around the ellipsoid of moves that are not told."""
        with np.errstate(divide="ignore"):
            lengths = np.minimum(1.0 / told, np.sqrt(len(told)))
        flatness = np.minimum(np.linalg.norm(directions * lengths[:, None], axis=0), 1.0)
        values = self._values(shares)
        return Found(values, before, after, tolerance, flatness * self._width, told, directions, promise,
                     tuple(self._refusals), self._trials, self._model.solve(values))

    def _values(self, shares: np.ndarray) -> np.ndarray:
        """Values of the variables at shares of their bounds, both of shape (variable_count,)."""
        return self._low + self._width * np.clip(shares, 0.0, 1.0)

    def _tried(self, shares: np.ndarray) -> Solved | None:
        """The poses at shares of the bounds; None where the trial is refused."""
        self._trials += 1
        try:
            return self._model.solve(self._values(shares))
        except SoftRobotTwinError as error:
            self._refusals[str(error)] = None
            return None


def _promised(shares: np.ndarray, slopes: np.ndarray, told: np.ndarray, directions: np.ndarray) -> float:
    """By how much a quadratic function with these slopes and curvatures told² falls in the bounds."""
    is_held = ((shares < STILL) & (slopes > 0.0)) | ((shares > 1.0 - STILL) & (slopes < 0.0))
    along = directions @ np.where(is_held, 0.0, slopes)
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = np.where(along == 0.0, 0.0, np.clip(-along / told**2, -1.0, 1.0))
    return float(-(along * moves + 0.5 * (told * moves) ** 2).sum())


_Function = Callable[[np.ndarray], tuple[float, np.ndarray]]


class _Refused(Exception):
    """A trial has no equilibria."""

    def __init__(self, shares: np.ndarray):
        super().__init__()
        self.shares = shares.copy()


def _least(value_and_slopes: _Function, shares: np.ndarray, value: float) -> tuple[np.ndarray, float]:
    """Shares at which a function is least, and its value there, beside refused trials."""
    from scipy.optimize import minimize  # it loads slowly

    best, scale, reach = (shares, value), abs(value) or 1.0, 1.0

    def scaled(place: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal best
        found, slopes = value_and_slopes(place)
        if found < best[1]:
            best = place.copy(), found
        return found / scale, slopes / scale

    for _ in range(MOST_REFUSALS):
        bounds = np.clip([best[0] - reach, best[0] + reach], 0.0, 1.0)
        try:
            minimize(scaled, best[0], jac=True, method="L-BFGS-B", bounds=bounds.T,
                     options={"ftol": STILL**2, "gtol": STILL, "maxfun": MOST_TRIALS})
        except _Refused as refused:
            reach = 0.5 * np.abs(refused.shares - best[0]).max()
            continue
        inner = (bounds > 0.0) & (bounds < 1.0)
        if not (inner & (np.abs(bounds - best[0]) < STILL)).any():
            break
        reach *= 2.0
    return best


def hull_volume(points: np.ndarray) -> tuple[float, np.ndarray]:
    """Volume of the convex hull of points, such as places in a workspace, and its derivatives.

    Args:
        points: The points [m], shape (count, 3).

    Returns:
        The volume [m³], and its derivatives by the points [m²], zero inside, shape (count, 3).

    Raises:
        DesignError: The points span no volume.
    """
    from scipy.spatial import ConvexHull  # it loads slowly

    try:
        points = real_array(points)
        hull, slopes = ConvexHull(points), np.zeros_like(points)
        a, b, c = (points[hull.simplices].swapaxes(0, 1) - points.mean(axis=0))
    except (TypeError, ValueError, IndexError, OverflowError, RuntimeError) as error:
        raise DesignError("points", "must be four or more places [m] that span a volume, shape (count, 3)") from error
    # Triangles whose corners go round the other way have normals that point inwards.
    sides = np.sign(np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]))[:, None]
    for corner, (second, third) in enumerate(((b, c), (c, a), (a, b))):
        np.add.at(slopes, hull.simplices[:, corner], sides * np.cross(second, third) / 6.0)
    return float(hull.volume), slopes
