"""Forces that nobody modelled, found from where markers and sensors are beside the model.

A force f at a place moves the markers by G f, while the actuators hold what they hold; G comes from
the factorization of the last step. So the displacements y of the markers by all loads that the model
does not have otherwise are measurements of f. The force is a random walk, and a Kalman filter follows
it (Kalman 1960): with the variance R of a coordinate,

    P ← P + walk² Δt,    C = (P⁻¹ + Gᵀ w G / R)⁻¹,    f ← f + C Gᵀ w (y - G f) / R,    P ← C

One that is far off counts less, by weights w of markers (Huber 1964). A force that changes at
once does not walk: where what the markers tell is far off the prediction, P begins anew.

The model bears as much of a force as markers support. What moves all markers as the actuators would is
no force, but a robot that is not where it was sent, or markers that lie. What may be either moves the
effectors by a limit at most, and the correction of targets takes it over: the misfit is integrated once,
by the law that holds without an observer. A force without support decays.

A sensor is measured as a marker is, by one number in place of three: its value as it counts in metres,
with the deviation of its own noise. `ObservedRows` says how both are put together.

An unknown place is the point of the surface at which a pushing force explains the markers best. What
the model itself is off does not vanish by averaging: it is carried to the deviations of the forces.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.special import gammaincinv

from softrobot_twin.analysis.marker_compliance import MarkerCompliance
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.marker_checks import FARTHEST_MISFIT
from softrobot_twin.control.model_history import Moment
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation import CommandSetpoints, Hold, Simulation, State
from softrobot_twin.simulation.building.sensor_kinds import in_order
from softrobot_twin.simulation.command import LONG
from softrobot_twin.simulation.effects.observed_forces import ObservedForces, numbers_of

HUBER = 4.0
"""A marker counts less from so many standard deviations of its place on."""
ROUNDS, ALIKE = 12, 1.0e-3
"""Times that weights are found, at most, until they change by less."""
SURE = 0.999
"""A force that changes at once is noticed where noise would do the same with the rest of this
probability; so is one at an unknown place at all."""
NEARER = 9.0
"""Another point is taken for the place when it explains the squares of so many deviations more."""
CONE = 0.5
"""Cosine of the greatest angle of a force at an unknown place from the inward normal."""
KEPT = 0.95
"""After each measurement so much is left of the weight of those before, where a place is looked for."""
NOTICEABLE, CALM, CHANGED = 0.25, 0.1, 3.0
"""The model bears a changed force when it is off by this share of its deviation, or goes a part of a
long way towards it. By how many deviations a change must be more than noise in the second after a sudden
one; of others each measurement adds this share, as to the correction of a target that stands."""
DOUBT = 0.1
"""A linearization may be wrong by this share of how far the markers are from the model."""
UNSETTLED = 0.3
"""What the last step left to move of the markers, as a share that forces may be wrong by; where a
place is looked for, a long move waits for the one before, until no more of how far markers are is left."""
REACH = 0.02
"""A change of forces moves no marker further at once than this share of the robot's size, because a
linearization does not tell so far."""
LOOKS, BALANCES, STILL = 8, 3, 0.5
"""Steps that follow a larger change at once, and those after each tick of the next second, at most:
until it, and what a step left, move markers by less than so many deviations."""
FADES = 0.2
"""Time constant with which a force without support decays [s]."""
BLIND = 0.1
"""So long forces stay what they were where measurements cannot be used [s]."""
OUTVOTED = 3
"""Of markers that are seen, at most one of so many may not be plausible where forces are learnt."""
SURER = 4.0
"""A force is certain where the actuators leave so many times as much of the squares of deviations."""
SENSOR_NOISE = 0.002
"""Standard deviation of a sensor where the scene gives none, as it counts in metres, as a share of the
robot's size."""
USUAL_NOISE = 1.0e-4
"""Standard deviation of a marker's coordinate where neither scene nor measurement gives one [m]."""
GREATEST = 3.0
"""No force is larger than so many times the `greatest_force` of the scene."""


@cache
def greatest_square(dimension: int) -> float:
    """Square of normal numbers of deviation 1 that is exceeded with a probability of 1 - `SURE`.

    Args:
        dimension: How many numbers.
    """
    return float(2.0 * gammaincinv(0.5 * dimension, SURE))


class ForceObserver:
    """Follows the forces of one scene's observer.

    Args:
        simulation: The model, whose scene has an observer.

    Attributes:
        names: Names of the forces.
        found: What the model is to bear.
        lag: What the last step left to move of them [m], same shape.
        stamp: Time of the last measurement [ns].
        settled: The model where the last measurement was, if steps there have found a large change.
        is_settling: Whether forces have changed so much that they are not yet known.
        handed_over: How much further forces move the markers since the last `update` or `fade`, but for what
            is certain to be a sudden force: the correction of targets takes that over, so that no command
            changes [m], shape (quantity_count, 3).
        is_blind: Whether the tangent of the last look was indefinite: measurements are not used then.
        belief: The share of the forces that markers support, 0 to 1.
        by_loads: Their motion by each number of the loads, shape (3 quantity_count, load_count).
        quantity_count: Number of all that is measured, see `ObservedRows`.
    """

    def __init__(self, simulation: Simulation):
        self._simulation, self._entry = simulation, simulation.scene.observer
        self._compliance = MarkerCompliance(simulation)
        self._places = self._compliance.rows.places
        self._unknown = [index for index, one in enumerate(self._places) if one.is_found]
        self.names = tuple(place.name for place in self._places)
        sizes = [place.dimension for place in self._places]
        ends = np.cumsum(sizes)
        self._own = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        # A torque counts as a force at the arm of the robot's size.
        size = simulation.model.nodes.finite_size
        arms = np.concatenate([np.repeat([1.0, size], 3)[:count] for count in sizes])
        self._arms, self._size = arms, size
        rows = self._compliance.rows
        self.quantity_count = count = rows.quantity_count
        groups = [own for own in simulation.effector_markers if len(own)]
        groups += [[place] for place in range(count - len(rows.unseen), count)]
        groups = groups or np.arange(count)[:, None]
        # Means of the markers of each effector, or itself, or all quantities, shape (n, quantity_count).
        self._means = np.array([np.isin(np.arange(count), own) / len(own) for own in groups])
        # Of each quantity: whether it is of a sensor, its number of coordinates, and its noise [m].
        self._is_sensor = np.isin(np.arange(count) - rows.marker_count, np.arange(rows.sensor_count))
        self._coordinates = np.where(self._is_sensor, 1, 3)
        self._lengths = np.empty(0) if simulation.model.sensors is None else simulation.model.sensors.lengths
        self._sensor_noises = np.full(rows.sensor_count, SENSOR_NOISE * size)
        for index, (_, sensor) in enumerate(in_order(simulation.scene)):
            if sensor.noise is not None:
                self._sensor_noises[index] = sensor.noise * self._lengths[index]
        # Covariance before anything is seen, and what a second adds to it.
        self._prior = np.diag((self._entry.greatest_force * arms) ** 2)
        self._known = np.linalg.inv(self._prior)
        self._walk = np.diag((self._entry.walk * arms) ** 2)
        self.reset()

    def reset(self) -> None:
        """Forgets all forces."""
        count = self.quantity_count
        self.found, self._still = ObservedForces.none(len(self._places)), 0.0
        self.is_settling = self.is_blind = self._is_sure = False
        self.lag = np.zeros((count, 3))
        self.by_loads = np.zeros((3 * count, len(self._arms)))
        self._by_actuators = np.zeros((3 * count, 0))
        self.belief, self._blind_for = 0.0, 0.0
        self._loads = np.zeros(len(self._arms))
        self._covariance = self._prior
        self.stamp, self._moved, self.handed_over = 0, 0.0, np.zeros((count, 3))
        self.settled: State | None = None
        # Mean of what markers are beside the model, and how many measurements it is of.
        self._mean, self._counts = np.zeros((count, 3)), np.zeros(count)
        # When a change was followed by steps, and when forces began anew; one may be sure since.
        self._followed = self._begun = -math.inf

    def warm_up(self) -> None:
        """Compiles what measurements will need, and forgets all forces."""
        self.look()
        none, each = np.zeros(3 * self.quantity_count), np.ones(self.quantity_count)
        _estimate(self._loads, self._prior, none, self.by_loads, each, each)
        self.reset()

    def look(self) -> None:
        """Finds what forces do to the quantities where the last step ended. Called after each step."""
        found = self._compliance.at_state(self.found.points, may_be_slow=False)
        self.is_blind = found is None
        if found is None:
            self.lag = np.zeros_like(self.lag)
        else:
            self.by_loads, self.lag = found.by_loads, found.lag.reshape(-1, 3)
            self._by_actuators = found.by_actuators

    def balance(self, measured: tuple) -> None:
        """Looks after a step, and lets the model come to balance in the second after a large change.

        The robot follows quickly then, and it is compared with where the model has come to.

        Args:
            measured: What else steps are to bear.
        """
        self.look()
        for _ in range(BALANCES if self.stamp - self._followed < NANOSECONDS else 0):
            if np.abs(self.lag).max() < self._still:
                break
            if self._simulation.step(Hold(), None, [self.found, *measured]).status.is_failure:
                break
            self.look()

    def _together(self, markers: np.ndarray, sensors: np.ndarray, effectors: np.ndarray) -> np.ndarray:
        """All quantities [m], shape (quantity_count, 3).

        Args:
            markers: Places of the markers [m], shape (marker_count, 3).
            sensors: Values of the sensors, each in its unit, shape (sensor_count,).
            effectors: Places of all effectors [m], shape (effector_count, 3).
        """
        shown = np.zeros((len(sensors), 3))
        shown[:, 0] = self._lengths * sensors
        return np.concatenate([markers, shown, effectors[self._compliance.rows.unseen]])

    def _variances(self, noise: float) -> np.ndarray:
        """Variances of the coordinates of the quantities by noise [m²], shape (quantity_count,).

        Args:
            noise: Standard deviation of each coordinate of a marker, where the scene gives none [m].
        """
        noises = np.full(self.quantity_count, self._entry.marker_noise or noise)
        noises[self._is_sensor] = self._sensor_noises
        return noises**2

    def of_sensors(self, moves: np.ndarray) -> np.ndarray:
        """What sensors show of motions, each in its unit, shape (sensor_count,).

        Args:
            moves: Motion of the quantities [m], shape (quantity_count, 3).
        """
        return moves[self._is_sensor, 0] / self._lengths

    def moment(self, markers: np.ndarray, effectors: np.ndarray) -> Moment:
        """The model where the last step ended, as it will have settled.

        Args:
            markers: Its markers [m], shape (marker_count, 3).
            effectors: Its effectors [m], shape (effector_count, 3).
        """
        shown = self._together(markers, self._simulation.sensor_readings(), effectors)
        # Later looks write into the same matrix.
        return Moment(shown + self.lag, effectors, self.loads, self.by_loads.copy(),
                      setpoints=self._simulation.state.setpoints)  # fmt: skip

    @property
    def places(self) -> np.ndarray:
        """Where the loads act at the present state [m], shape (place_count, 3)."""
        return self._compliance.places_at(self.found.points)

    @property
    def loads(self) -> np.ndarray:
        """Numbers of the loads that the model bears, shape (load_count,)."""
        return numbers_of(self._places, self.found.wrenches)

    def told(self, noise: float) -> np.ndarray:
        """Standard deviations of the loads by all markers and sensors once, where the last look was.

        Of a place that is found these are the medians over its points.

        Args:
            noise: Standard deviation of each coordinate, where the scene gives none [m].

        Returns:
            [N] and [N m], shape (load_count,).
        """
        R = (self._variances(noise) + self._entry.systematic_error**2).repeat(3)
        R = R[: len(R) - 3 * len(self._compliance.rows.unseen)]
        seen = self.by_loads[: len(R)]
        information = self._known + seen.T / R @ seen
        deviations = np.sqrt(np.linalg.inv(information).diagonal())
        for place in self._unknown:
            own, field = self._own[place], self._compliance.by_candidates(place)[:, : len(R)]
            each = np.linalg.inv(self._known[own, own] + field.transpose(0, 2, 1) / R @ field)
            deviations[own] = np.median(np.sqrt(np.diagonal(each, axis1=1, axis2=2)), axis=0)
        return deviations

    def is_new(self, stamp: int) -> bool:
        """Whether a measurement has not been used yet.

        Args:
            stamp: Its time [ns].
        """
        return stamp != self.stamp

    def under_loads(self, model: Moment) -> Moment:
        """The model of an earlier moment as it would have been under the loads that are known now.

        What they move is taken from both ends of their change.

        Args:
            model: The model of that moment.
        """
        by_loads = 0.5 * (model.by_loads + self.by_loads)
        shifts = (by_loads @ (self.loads - model.loads)).reshape(-1, 3)
        return model._replace(markers=model.markers + shifts)

    @property
    def shifts(self) -> np.ndarray:
        """How far the forces that the model bears move the quantities [m], shape (quantity_count, 3)."""
        return (self.by_loads @ self.loads).reshape(-1, 3)

    def update(
        self, markers: np.ndarray, model: Moment, noise: float, stamp: int, measured: tuple = (),
        limit: float = math.inf, left_out: int = 0, sensors: np.ndarray | None = None,
    ) -> Moment | None:  # fmt: skip
        """Uses the markers and sensors of one measurement.

        The simulation stands where it did.

        Args:
            markers: Measured markers in the frame of the robot [m], NaN for hidden ones, shape (marker_count, 3).
            model: The model of the same moment.
            noise: Standard deviation of each coordinate, where the scene gives none [m].
            stamp: Time of the measurement [ns]; an old one is not used again.
            measured: What else steps are to bear.
            limit: Forces that are not certain move no effector further [m].
            left_out: How many more markers are seen, but not plausible.
            sensors: Measured sensors, each in its unit, NaN for others, shape (sensor_count,); None for
                none. Of those that are further from the model than a marker may be nothing is believed.

        Returns:
            The model of that moment under the loads that are known now, where it is another one
            than `under_loads` tells: at another place, or far off.
        """
        since, self.stamp, self.settled = (stamp - self.stamp) / NANOSECONDS, stamp, None
        self.handed_over[:] = 0.0
        if since == 0.0:
            return None
        sensors = np.full(len(self._lengths), np.nan) if sensors is None else sensors
        markers = self._together(markers, sensors, np.full_like(model.effectors, np.nan))
        off = np.abs(markers - model.markers)[:, 0]
        is_far = self._is_sensor & (off > FARTHEST_MISFIT * self._size)
        markers[is_far], left_out = np.nan, left_out + int(is_far.sum())
        since, seen = min(abs(since), 1.0), int(np.isfinite(markers).all(axis=1).sum())
        self._blind_for = self._blind_for + since if self.is_blind else 0.0
        is_unsupported = not seen or OUTVOTED * left_out > left_out + seen
        if self._blind_for > BLIND or is_unsupported:
            self.fade(since)
        if self.is_blind or is_unsupported:
            return None
        self._covariance = self._covariance + since * self._walk
        is_new = self._use(markers, model, noise, since, limit)
        if self.is_settling and not (self._unknown or self._simulation.model.is_dynamic):
            model, is_new = self._settle(markers, model, noise, measured, limit), True
        if not is_new:
            return None
        moved = self.by_loads @ self.loads - model.by_loads @ model.loads
        return model._replace(markers=model.markers + moved.reshape(-1, 3), loads=self.loads,
                              by_loads=self.by_loads)  # fmt: skip

    def fade(self, duration: float) -> None:
        """Lets the forces decay: no measurement supports them.

        Args:
            duration: Time that has passed [s].
        """
        share, found, before = math.exp(-duration / FADES), self.found, self.shifts
        self.handed_over[:] = 0.0
        if not found.is_any:
            return
        self.belief *= share
        least = NOTICEABLE * np.abs(found.deviations)
        fades = share * found.wrenches
        self.found = found._replace(
            wrenches=np.where(np.abs(fades) > least, fades, 0.0),
            is_detected=np.zeros_like(found.is_detected))  # fmt: skip
        self._loads, self._covariance = self.loads, self._prior
        self._counts[:], self.is_settling = 0.0, False
        self.handed_over[:] = self.shifts - before

    def _settle(
        self, markers: np.ndarray, model: Moment, noise: float, measured: tuple, limit: float
    ) -> Moment:
        """Follows a change for which one linearization is not enough, by steps of the model.

        Returns:
            The model of the moment, as the last of them left it.
        """
        simulation, before, borne = self._simulation, self._simulation.state, self.found
        command = CommandSetpoints(model.setpoints, LONG)
        for _ in range(LOOKS):
            result = simulation.step(command, None, [self.found, *measured])
            if result.status.is_failure:
                break
            self.look()
            if self.is_blind:
                # So far the model does not bear it.
                self.found, self.is_settling = borne, False
                simulation.restore(before)
                self._loads, self.settled = self.loads, None
                return model
            borne = self.found
            model = self.moment(simulation.marker_positions(), model.effectors)
            # The same measurement again, and not one more.
            self._covariance, self._counts[:] = self._prior.copy(), 0.0
            self._use(markers, model, noise, 0.0, limit)
            if max(self._moved, np.abs(self.lag).max()) < STILL * noise:
                break
        self.settled, self._followed, self._still = simulation.state, self.stamp, STILL * noise
        simulation.restore(before)
        return model

    def _use(self, markers: np.ndarray, model: Moment, noise: float, since: float, limit: float) -> bool:
        """Uses quantities by one linearization; whether a load acts at another place than before."""
        beside = markers - self.under_loads(model).markers
        seen = np.isfinite(beside).all(axis=1)
        beside = np.where(seen[:, None], beside, 0.0)
        moved = np.linalg.norm((markers - model.markers)[seen], axis=1)
        far = np.sort(moved)[len(moved) // 2]
        noises, systematic = self._variances(noise), self._entry.systematic_error**2 + (DOUBT * far) ** 2
        R = noises + systematic
        given = self.loads
        borne = self.by_loads @ given
        if self._unknown and self.is_settling and np.abs(self.lag).max() > UNSETTLED * far:
            return False
        if self._notice(borne + beside.ravel(), R, seen.astype(float)):
            self._counts[:] = 0.0
        if not self._counts.any():
            self._begun, self._is_sure = self.stamp, False
        self._counts = KEPT * self._counts + seen
        self._mean += (seen / np.maximum(self._counts, 1.0))[:, None] * (beside - self._mean)
        has_moved = self._find(borne + self._mean.ravel(), noises, systematic)
        y = borne + beside.ravel()
        after, spread, weights = _estimate(
            self._loads, self._covariance, y, self.by_loads, R, seen.astype(float))
        most = GREATEST * self._entry.greatest_force * self._arms
        after = np.clip(after, -most, most)
        weighted = self.by_loads.T * (seen / R).repeat(3)
        # Of what does nothing to the measurements of now, nothing is borne.
        unseen = np.linalg.solve(self._known + weighted @ self.by_loads, self._known @ after)
        borne_next = self._allowed(after - unseen, y, noise, seen.astype(float), since, limit)
        moved = np.linalg.norm((self.by_loads @ borne_next - borne).reshape(-1, 3), axis=1).max()
        self.is_settling = bool(moved > REACH * self._size)
        if self.is_settling:
            # So far a linearization does not tell: go a part of the way.
            borne_next = given + REACH * self._size / moved * (borne_next - given)
            after, spread, self._counts[:] = borne_next, self._prior, 0.0
        self._moved = moved
        self._loads, self._covariance = after, spread
        self._tell(borne_next, R, weights)
        self._mean -= (self.by_loads @ self.loads - borne).reshape(-1, 3)
        return has_moved

    def _allowed(
        self, loads: np.ndarray, y: np.ndarray, noise: float, seen: np.ndarray, since: float,
        limit: float,
    ) -> np.ndarray:  # fmt: skip
        """What the model shall bear of loads, by what supports them and how far they move effectors.

        Args:
            loads: Numbers of the loads, shape (load_count,).
            y: Displacements of the quantities by all loads [m], shape (3 quantity_count,).
            noise: Standard deviation of a coordinate of a marker [m].
            seen: 1 for each quantity that is seen, else 0, shape (quantity_count,).
            since: Time that has passed since the last measurement [s].
            limit: Forces that are not certain move no effector further [m].
        """
        noises = self._variances(noise)
        own = noises + self._entry.systematic_error**2
        far = np.sort(np.linalg.norm(y.reshape(-1, 3), axis=1)[seen > 0.0])
        R, G = own + (DOUBT * far[len(far) // 2]) ** 2, self.by_loads
        belief, is_certain = self._support(y, noises, own, R, seen)
        self._is_sure |= is_certain
        most = min(math.inf if is_certain else limit, FARTHEST_MISFIT * self._size)
        moved = self._means @ (G @ loads).reshape(-1, 3)
        furthest = np.linalg.norm(moved, axis=1).max(initial=0.0)
        allowed = min(belief, most / max(furthest, np.finfo(float).tiny)) * loads
        given, kept = self.loads, math.exp(-since / FADES)
        is_better = _squares(y - G @ allowed, R, seen) < _squares(y - G @ given, R, seen)
        if belief < self.belief and not is_better:
            allowed = allowed + kept * (given - allowed)
        self.belief = max(belief, belief + kept * (self.belief - belief))
        return allowed

    def _support(
        self, y: np.ndarray, noises: np.ndarray, own: np.ndarray, R: np.ndarray, seen: np.ndarray
    ) -> tuple[float, bool]:
        """How far measurements support loads, and whether no motion by the actuators explains them as well.

        Args:
            y: Displacements of the quantities by all loads [m], shape (3 quantity_count,).
            noises: Variance of a coordinate of each by noise [m²], shape (quantity_count,).
            own: The same with the model's error [m²].
            R: The same with what a linearization may be wrong by [m²].
            seen: 1 for each quantity that is seen, else 0, shape (quantity_count,).

        Returns:
            The share, 0 to 1, and whether loads of any size may move the effectors.
        """
        A, count = self._by_actuators, int(self._coordinates @ seen)
        A = A / np.maximum(np.abs(A).max(axis=0, initial=0.0), np.finfo(float).tiny)
        none, by_noise = _squares(y, R, seen), float(self._coordinates * seen @ (own / R))
        unexplained = _unexplained(y, self.by_loads, self._prior, R, seen)
        explained, left = none - unexplained, max(unexplained - by_noise, 0.0)
        wide = self._size**2 * np.eye(A.shape[1])
        elsewhere = max(_unexplained(y, A, wide, R, seen) - by_noise, 0.0)
        belief, loads = 0.0, len(self._arms)
        by_chance = greatest_square(min(loads, count)) * float((seen * noises / R).max())
        if explained > max(left, by_chance) and left <= elsewhere + NEARER:
            belief = min(2.0 - 2.0 * left / explained, 1.0)
        by_luck = NEARER + (greatest_square(count) / count - 1.0) * by_noise
        return belief, elsewhere > SURER * left + by_luck

    def _notice(self, y: np.ndarray, R: np.ndarray, seen: np.ndarray) -> bool:
        """Begins anew with each force that changed at once; whether one did."""
        count = len(self._loads)
        free, spread, _ = _estimate(np.zeros(count), self._prior, y, self.by_loads, R, seen)
        has_changed = False
        for own in self._own:
            off = free[own] - self._loads[own]
            both = (self._covariance + spread)[own, own]
            if square_by_deviations(off, both) > greatest_square(len(off)):
                self._covariance[own, :] = self._covariance[:, own] = 0.0
                self._covariance[own, own] = self._prior[own, own]
                has_changed = True
        return has_changed

    def _tell(self, allowed: np.ndarray, R: np.ndarray, weights: np.ndarray) -> None:
        """Says what the model is to bear of what is allowed, and how sure it is."""
        weighted, lag = self.by_loads.T * (weights / R).repeat(3), self.lag.ravel()
        gain = np.linalg.solve(self._known + weighted @ self.by_loads, weighted)
        off, square = self._entry.systematic_error**2 + UNSETTLED**2 * (lag @ lag) / lag.size, gain @ gain.T
        deviations = np.sqrt((self._covariance + off * square).diagonal())
        # What noise and the model's own error alone would make of no force.
        by_noise = (gain * (R + off).repeat(3)) @ gain.T
        given, points = self.loads, self.found.points
        is_detected = np.zeros(len(self._places), bool)
        for place, own in enumerate(self._own):
            loads = self._loads[own]
            is_detected[place] = square_by_deviations(loads, by_noise[own, own]) > greatest_square(len(loads))
            if self._places[place].is_found and not is_detected[place]:
                self._loads[own] = allowed[own] = 0.0
            is_detected[place] &= self.belief > 0.0
        least = NOTICEABLE * np.sqrt(by_noise.diagonal())
        changes = np.abs(allowed - given)
        is_new = self.stamp - self._begun < NANOSECONDS
        if self.is_settling or (is_new and (NOTICEABLE * changes > CHANGED * least).any()):
            given = allowed
        elif (changes > least).any():
            given = given + CALM * (allowed - given)
        if not (self.is_settling or (is_new and self._is_sure)):
            self.handed_over += (self.by_loads @ (given - self.loads)).reshape(-1, 3)
        wrenches, spreads = np.zeros((2, len(self._places), 6))
        for place, own in enumerate(self._own):
            count = self._places[place].dimension
            wrenches[place, :count], spreads[place, :count] = given[own], deviations[own]
        self.found = ObservedForces(wrenches, spreads, points, is_detected)

    def _find(self, y: np.ndarray, noises: np.ndarray, systematic: float) -> bool:
        """Looks for the points of the surface at which forces explain the displacements best.

        Args:
            y: Mean displacements by all loads [m], shape (3 quantity_count,).
            noises: Variance of a coordinate of each in one measurement [m²], shape (quantity_count,).
            systematic: What does not become less in a mean [m²].

        Returns:
            Whether any is new.
        """
        if not self._unknown:
            return False
        R = np.repeat(noises / np.maximum(self._counts, 1.0e-9) + systematic, 3)
        return any([self._find_one(place, y, R) for place in self._unknown])

    def _find_one(self, place: int, y: np.ndarray, R: np.ndarray) -> bool:
        """The same for one place; R is of each coordinate."""
        own, points = self._own[place], self.found.points
        others = self._loads.copy()
        others[own] = 0.0
        y = y - self.by_loads @ others
        w = 1.0 / R
        here = self.by_loads[:, own]
        left = y - here @ np.linalg.lstsq(here * np.sqrt(w)[:, None], y * np.sqrt(w), rcond=None)[0]
        if w @ (left * left) <= greatest_square(int(self._coordinates.sum())):
            return False
        field = self._compliance.by_candidates(place)
        if not np.isfinite(field).all():
            return False
        for _ in range(2):
            weighted = field * w[:, None]
            square = np.einsum("pki,pkj->pij", weighted, field)
            square += np.eye(3) / self._entry.greatest_force**2
            right = np.einsum("pki,k->pi", weighted, y)
            forces = np.linalg.solve(square, right[..., None])[..., 0]
            # What is left of the squares at the best force.
            left = w @ (y * y) - np.einsum("pi,pi->p", right, forces)
            pushes = -np.einsum("pi,pi->p", forces, self._places[place].normals)
            left = np.where(pushes >= CONE * np.linalg.norm(forces, axis=1), left, np.inf)
            best = int(np.argmin(left))
            if not np.isfinite(left[best]):
                return False
            off = (y - field[best] @ forces[best]) / np.sqrt(R)
            off = np.repeat(np.linalg.norm(off.reshape(-1, 3), axis=1), 3)
            w = HUBER / np.maximum(off, HUBER) / R
        is_new = bool(left[points[place]] > left[best] + NEARER)
        if is_new:
            points = points.copy()
            points[place] = best
            self.found = self.found._replace(points=points)
            self.by_loads[:, own] = field[best]
            self._loads[own] = forces[best]
            self._covariance[own, :] = self._covariance[:, own] = 0.0
            self._covariance[own, own] = np.linalg.inv(square[best])
        return is_new


@njit(**KERNEL)
def estimate(before, covariance, y, G, R, seen):
    """Forces after a measurement.

    Args:
        before: Those that are expected, shape (n,).
        covariance: Of what is expected, shape (n, n).
        y: Displacements of the markers [m], shape (3 marker_count,).
        G: Their motion by the forces, shape (3 marker_count, n).
        R: Variance of a coordinate [m²].
        seen: 1 for each marker that is seen, else 0, shape (marker_count,).

    Returns:
        The forces, their covariance, and the weights of the markers.
    """
    n, weights = len(before), seen.copy()
    off = y - G @ before
    variances, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(variances, 0.0))
    for _ in range(ROUNDS):
        sums, right = np.zeros((n, n)), np.zeros(n)
        for k in range(len(y)):
            w = weights[k // 3] / R
            for i in range(n):
                right[i] += w * G[k, i] * off[k]
                for j in range(n):
                    sums[i, j] += w * G[k, i] * G[k, j]
        # (P⁻¹ + A)⁻¹ = L (I + Lᵀ A L)⁻¹ Lᵀ with P = L Lᵀ: nothing is inverted that may be singular.
        squares, along = np.linalg.eigh(root.T @ sums @ root)
        spread = root @ along
        after = (spread / (1.0 + np.maximum(squares, 0.0))) @ spread.T
        change = after @ right
        left, largest = off - G @ change, 0.0
        for marker in range(len(seen)):
            x, y_, z = left[3 * marker], left[3 * marker + 1], left[3 * marker + 2]
            deviations = np.sqrt((x * x + y_ * y_ + z * z) / R)
            weight = seen[marker] * (HUBER / max(deviations, HUBER)) ** 2
            largest = max(largest, abs(weight - weights[marker]))
            weights[marker] = weight
        if largest < ALIKE:
            break
    return before + change, after, weights


def _estimate(
    before: np.ndarray, covariance: np.ndarray, y: np.ndarray, G: np.ndarray, R: np.ndarray,
    seen: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """The same by quantities of other variances each, R of shape (quantity_count,)."""
    per = np.sqrt(1.0 / R).repeat(3)
    return estimate(before, covariance, per * y, per[:, None] * G, 1.0, seen)


def square_by_deviations(values: np.ndarray, covariance: np.ndarray) -> float:
    """Square of values by their deviations; none along what no measurement tells.

    Args:
        values: The values, shape (n,).
        covariance: Of the values, shape (n, n).
    """
    return float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)


def _squares(off: np.ndarray, R: np.ndarray, seen: np.ndarray) -> float:
    """Sum of the squares of deviations of quantities; one that is far off counts as `HUBER` of them.

    Args:
        off: Displacements that nothing explains [m], shape (3 quantity_count,).
        R: Variance of a coordinate of each [m²], shape (quantity_count,).
        seen: 1 for each quantity that is seen, else 0, shape (quantity_count,).
    """
    squares = (off.reshape(-1, 3) ** 2).sum(axis=1) / R
    return float(seen @ np.minimum(squares, HUBER**2))


def _unexplained(
    y: np.ndarray, G: np.ndarray, covariance: np.ndarray, R: np.ndarray, seen: np.ndarray
) -> float:
    """Sum of the squares of deviations of quantities that motions G of a covariance leave; see `estimate`."""
    found, _, _ = _estimate(np.zeros(G.shape[1]), covariance, y, G, R, seen)
    return _squares(y - G @ found, R, seen)
