"""Forces that nobody modelled, found from where the markers are beside the model.

A force f at a place moves the markers by G f, while the actuators hold what they hold; G comes from
the factorization of the last step. So the displacements y of the markers by all loads that the model
does not have otherwise are measurements of f. The force is a random walk, and a Kalman filter follows
it (Kalman 1960): with the variance R of a coordinate,

    P ← P + walk² Δt,    C = (P⁻¹ + Gᵀ w G / R)⁻¹,    f ← f + C Gᵀ w (y - G f) / R,    P ← C

One that is far off counts less, by weights w of markers (Huber 1964). A force that changes at
once does not walk: where what the markers tell is far off the prediction, P begins anew.

An unknown place is the point of the surface at which a pushing force explains the markers best. What
the model itself is off does not vanish by averaging: it is carried to the deviations of the forces.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.model_history import Moment
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.effects.observed_forces import ObservedForces, numbers_of
from softrobot_twin.simulation.marker_compliance import MarkerCompliance

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
NOTICEABLE = 0.25
"""The model bears a changed force when it is off by this share of its deviation."""
UNSETTLED = 0.3
"""What the last step left to move of the markers, as a share that forces may be wrong by."""
LONG, CAREFUL = 0.02, 0.6
"""A change of forces that moves a marker further than this share of the robot's size is made by a share
at once, because a linearization does not tell so far."""
GREATEST = 3.0
"""No force is larger than so many times the `greatest_force` of the scene."""


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
        explained: Displacements of the markers by what the model bears [m], shape
            (marker_count, 3).
        lag: What the last step left to move of them [m], same shape.
        is_settling: Whether forces have changed so much that they are not yet known.
        by_loads: Their motion by each number of the loads, shape (3 marker_count, load_count).
    """

    def __init__(self, simulation: Simulation):
        self._simulation, self._entry = simulation, simulation.scene.observer
        self._compliance = MarkerCompliance(simulation)
        self._places = self._compliance.rows.places
        self.names = tuple(place.name for place in self._places)
        sizes = [place.dimension for place in self._places]
        ends = np.cumsum(sizes)
        self._own = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        # A torque counts as a force at the arm of the robot's size.
        size = simulation.model.nodes.size if np.isfinite(simulation.model.nodes.size) else 1.0
        arms = np.concatenate([np.repeat([1.0, size], 3)[:count] for count in sizes])
        self._arms, self._size = arms, size
        self.reset()

    def reset(self) -> None:
        """Forgets all forces."""
        count = len(self._places)
        self.found, self.is_settling = ObservedForces.none(count), False
        count = len(self._simulation.marker_ids)
        self.explained, self.lag = np.zeros((2, count, 3))
        self.by_loads = np.zeros((3 * count, len(self._arms)))
        self._loads = np.zeros(len(self._arms))
        self._covariance = self._prior()
        self._stamp = 0

    def _prior(self) -> np.ndarray:
        """Covariance before anything is seen."""
        return np.diag((self._entry.greatest_force * self._arms) ** 2)

    def look(self) -> None:
        """Finds what forces do to the markers where the last step ended. Called after each step."""
        self.by_loads, lag = self._compliance.at_state(self.found.points)
        self.lag = lag.reshape(-1, 3)
        self.explained = (self.by_loads @ self._given).reshape(-1, 3)

    @property
    def _given(self) -> np.ndarray:
        """Numbers of the loads that the model bears, shape (load_count,)."""
        return numbers_of(self._places, self.found.wrenches)

    def is_new(self, stamp: int) -> bool:
        """Whether a measurement has not been used yet.

        Args:
            stamp: Its time [ns].
        """
        return stamp != self._stamp

    def under_loads(self, model: Moment) -> Moment:
        """The model of an earlier moment as it would have been under the loads that are known now.

        Args:
            model: The model of that moment.
        """
        shifts = (model.by_loads @ self._given).reshape(-1, 3) - model.explained
        return model._replace(markers=model.markers + shifts)

    @property
    def load_count(self) -> int:
        """Numbers of all loads."""
        return len(self._arms)

    def update(
        self, displacements: np.ndarray, by_loads: np.ndarray, noise: float, stamp: int
    ) -> bool:
        """Uses the markers of one measurement.

        Args:
            displacements: By how much the markers are beside the model in balance, without the
                loads that it bore then [m], NaN for hidden ones, shape (marker_count, 3).
            by_loads: Their motion by the loads then.
            noise: Standard deviation of each coordinate, where the scene gives none [m].
            stamp: Time of the measurement [ns]; an old one is not used again.

        Returns:
            Whether a load acts at another place than before.
        """
        since, self._stamp = (stamp - self._stamp) / NANOSECONDS, stamp
        seen = np.isfinite(displacements).all(axis=1)
        if since == 0.0 or not seen.any():
            return False
        R = (self._entry.marker_noise or noise) ** 2 + self._entry.systematic_error**2
        y = np.where(seen[:, None], displacements, 0.0).ravel()
        weights = seen.astype(float)
        shown = by_loads @ self._loads
        finds = [place for place, one in enumerate(self._places) if one.is_found]
        has_moved = any([self._find(place, y, weights, R) for place in finds])
        G = self.by_loads if has_moved else by_loads
        walked = np.diag((self._entry.walk * self._arms) ** 2) * min(abs(since), 1.0)
        before, self._covariance = self._loads, self._covariance + walked
        free, spread, _ = _estimate(np.zeros_like(before), self._prior(), y, G, R, weights)
        for own in self._own:
            off = free[own] - before[own]
            both = (self._covariance + spread)[own, own]
            if off @ np.linalg.solve(both, off) > greatest_square(len(off)):
                self._covariance[own, :] = self._covariance[:, own] = 0.0
                self._covariance[own, own] = self._prior()[own, own]
        after, spread, weights = _estimate(before, self._covariance, y, G, R, weights)
        moved = np.linalg.norm((G @ after - shown).reshape(-1, 3), axis=1).max()
        self.is_settling = bool(moved > LONG * self._size)
        if self.is_settling:
            # So far a linearization does not tell: go a part of the way, and expect the rest.
            start = np.zeros_like(before) if has_moved else before
            change = after - start
            after = start + CAREFUL * change
            spread = spread + (1.0 - CAREFUL) ** 2 * np.diag(change**2)
        self._loads, self._covariance = after, spread
        most = GREATEST * self._entry.greatest_force * self._arms
        self._loads = np.clip(self._loads, -most, most)
        self._tell(G, R, weights)
        return has_moved

    def _tell(self, G: np.ndarray, R: float, weights: np.ndarray) -> None:
        """Says what the model is to bear, and how sure it is."""
        w = np.repeat(weights, 3) / R
        gain = np.linalg.solve(np.linalg.inv(self._prior()) + (G.T * w) @ G, G.T * w)
        off = self._entry.systematic_error**2 + UNSETTLED**2 * float(np.mean(self.lag**2))
        covariance = self._covariance + off * gain @ gain.T
        deviations = np.sqrt(covariance.diagonal())
        # What noise and the model's own error alone would make of no force.
        by_noise = (R + off) * gain @ gain.T
        given, points = self._given, self.found.points
        is_detected = np.zeros(len(self._places), bool)
        for place, own in enumerate(self._own):
            loads = self._loads[own]
            square = loads @ np.linalg.solve(by_noise[own, own], loads)
            is_detected[place] = square > greatest_square(len(loads))
            if self._places[place].is_found and not is_detected[place]:
                self._loads[own] = 0.0
        least = NOTICEABLE * np.sqrt(by_noise.diagonal())
        if (np.abs(self._loads - given) > least).any():
            given = self._loads
        wrenches, spreads = np.zeros((2, len(self._places), 6))
        for place, own in enumerate(self._own):
            count = self._places[place].dimension
            wrenches[place, :count], spreads[place, :count] = given[own], deviations[own]
        self.found = ObservedForces(wrenches, spreads, points, is_detected)
        self.explained = (G @ given).reshape(-1, 3)

    def _find(self, place: int, y: np.ndarray, weights: np.ndarray, R: float) -> bool:
        """Looks for the point at which a force explains the displacements best; whether it is new."""
        own, points = self._own[place], self.found.points
        others = self._loads.copy()
        others[own] = 0.0
        y = y - self.by_loads @ others
        w = np.repeat(weights, 3) / R
        here = self.by_loads[:, own]
        left = y - here @ np.linalg.lstsq(here * np.sqrt(w)[:, None], y * np.sqrt(w), rcond=None)[0]
        if w @ (left * left) <= greatest_square(np.count_nonzero(w)):
            return False
        field = self._compliance.by_candidates(place)
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
            off = np.linalg.norm((y - field[best] @ forces[best]).reshape(-1, 3), axis=1)
            w = np.repeat(weights * np.minimum(1.0, HUBER / np.maximum(off / np.sqrt(R), HUBER)), 3) / R
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


def _estimate(
    before: np.ndarray, covariance: np.ndarray, y: np.ndarray, G: np.ndarray, R: float,
    seen: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
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
    weights, known = seen, np.linalg.inv(covariance)
    for _ in range(ROUNDS):
        tried = weights
        w = np.repeat(weights, 3) / R
        after = np.linalg.inv(known + (G.T * w) @ G)
        loads = before + after @ (G.T @ (w * (y - G @ before)))
        off = np.linalg.norm((y - G @ loads).reshape(-1, 3), axis=1) / np.sqrt(R)
        weights = seen * (HUBER / np.maximum(off, HUBER)) ** 2
        if np.abs(weights - tried).max() < ALIKE:
            break
    return loads, after, weights
