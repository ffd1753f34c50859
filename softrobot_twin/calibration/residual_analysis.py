"""What the residuals of a fit tell: which numbers it needs, which rows are faulty, and how errors grow.

All functions take the residuals r and the Jacobian J of a linear model at its optimum z, scaled by the
noise and by what is known of the numbers before, so that a fit minimises ‖r‖² + ‖z‖². Poses, and not
single coordinates, are held back: the points of one pose share its errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

FOLDS = 8
"""Parts of which each is held back once."""
GAIN, IN_DEVIATIONS = 2.0, 0.5
"""A number is worth its place where the held-back error falls by this (Akaike 1974: two for each number),
and by this share of the standard deviation of the sum of what single poses gain."""
FAULTY, MOST_FAULTY = 4.0, 0.3
"""A point is faulty where it is off by so many times the median of its errors, or the median of all points if that is
larger or if this point is off in most poses; where more than this share are, the model is wrong."""
_DIRECTIONS, _TOLD = 12, 3.0
"""Least poses that tell a hysteresis, and its least ratio to its standard error."""


class Linear(NamedTuple):
    """A linear model of residuals.

    Attributes:
        residuals: At z, over their noise, shape (n,).
        jacobian: By z, shape (n, p).
        z: Where, shape (p,).
        poses: Index of the pose of each residual, shape (n,).
    """

    residuals: np.ndarray
    jacobian: np.ndarray
    z: np.ndarray
    poses: np.ndarray

    def held_back(self, numbers: Sequence[int], parts: Sequence[np.ndarray]) -> np.ndarray:
        """Residuals of each part of the poses by a fit to the others, NaN where a part has none.

        Args:
            numbers: Indices of the numbers that are fitted; the others are zero.
            parts: Poses that are held back together, one mask over the residuals for each part.
        """
        J = self.jacobian[:, list(numbers)]
        start = self.residuals - self.jacobian @ self.z
        found = np.full(len(start), np.nan)
        for part in parts:
            A, b = J[~part], start[~part]
            z = -np.linalg.solve(A.T @ A + np.eye(len(numbers)), A.T @ b) if len(numbers) else np.empty(0)
            found[part] = start[part] + J[part] @ z
        return found

    def folds(self) -> list[np.ndarray]:
        """Masks of the parts of `FOLDS` among the residuals, each with poses from everywhere."""
        place = np.unique(self.poses, return_inverse=True)[1]
        count = min(FOLDS, int(place.max(initial=0)) + 1)
        return [place % count == k for k in range(count)]


class Step(NamedTuple):
    """A number that was added to a fit.

    Attributes:
        number: Its index.
        before: Root mean square of the shown held-back residuals without it.
        after: The same with it.
    """

    number: int
    before: float
    after: float


def selected(linear: Linear, always: Sequence[int] = (), shown: np.ndarray | None = None) -> list[Step]:
    """The numbers that lower the held-back error, the one that brings most first.

    Numbers are added one after the other, and those that became needless taken away. Numbers that only help
    together are missed so; the set that remains where needless ones are taken from all of them replaces
    the first where its error is less by more than luck.

    Args:
        linear: With all candidates.
        always: Indices of numbers that are fitted in any case, and are told first.
        shown: Mask of the residuals that steps tell, shape (n,); None for all.
    """
    search = _Search(linear, list(always))
    added = search.grown(list(always))
    left = search.thinned(list(range(linear.jacobian.shape[1])))
    chosen = left if search.is_gain(added, left) else added
    own, steps = slice(None) if shown is None else shown, list[Step]()
    so_far, waiting = list[int](), list(dict.fromkeys([*always, *chosen]))
    while waiting:
        first = waiting[:1] if len(so_far) < len(always) else waiting
        best = min(first, key=lambda k: search.error([*so_far, k]))
        before, after = (search.residuals(one)[own] for one in (so_far, [*so_far, best]))
        steps.append(Step(best, *(float(np.sqrt(np.mean(one**2))) for one in (before, after))))
        so_far.append(best)
        waiting.remove(best)
    return steps


class _Search:
    """Held-back residuals of sets of numbers."""

    def __init__(self, linear: Linear, always: list[int]):
        self._linear, self._always, self._folds = linear, always, linear.folds()
        self._places = np.unique(linear.poses, return_inverse=True)[1]
        self._known: dict[frozenset[int], np.ndarray] = {}

    def residuals(self, numbers: Sequence[int]) -> np.ndarray:
        """Those of a set, shape (n,)."""
        key = frozenset(numbers)
        if key not in self._known:
            self._known[key] = self._linear.held_back(sorted(key), self._folds)
        return self._known[key]

    def error(self, numbers: Sequence[int]) -> float:
        """Their sum of squares."""
        return float(np.sum(self.residuals(numbers) ** 2))

    def is_gain(self, before: Sequence[int], after: Sequence[int]) -> bool:
        """Whether a set is better than another one by more than luck."""
        return _is_gain(np.bincount(self._places, self.residuals(before) ** 2 - self.residuals(after) ** 2))

    def grown(self, chosen: list[int]) -> list[int]:
        """A set to which numbers were added as long as one brings something."""
        seen = set[frozenset[int]]()
        while frozenset(chosen) not in seen:
            seen.add(frozenset(chosen))
            left = [k for k in range(self._linear.jacobian.shape[1]) if k not in chosen]
            best = min(left, key=lambda k: self.error([*chosen, k]), default=None)
            if best is None or not self.is_gain(chosen, [*chosen, best]):
                break
            chosen = self.thinned([*chosen, best])
        return chosen

    def thinned(self, chosen: list[int]) -> list[int]:
        """A set without its needless numbers."""
        while True:
            free = [k for k in chosen if k not in self._always]
            least = min(free, key=lambda k: self.error([one for one in chosen if one != k]), default=None)
            without = [one for one in chosen if one != least]
            if least is None or self.is_gain(without, chosen):
                return chosen
            chosen = without


def _is_gain(gains: np.ndarray) -> bool:
    """Whether what each pose gains is more than a number costs, and no luck of single poses."""
    return gains.sum() > max(GAIN, IN_DEVIATIONS * np.sqrt(len(gains)) * gains.std())


class Reach(NamedTuple):
    """How the error of predictions grows outside of the poses of a fit.

    Attributes:
        centre: Mean of the setpoints of the fit, shape (actuator_count,).
        inverse: Inverse of their covariance, shape (actuator_count, actuator_count).
        farthest: Largest distance of them from the centre.
        factor: Error at the outer poses by a fit to the others, over the error of that fit; at least 1.
    """

    centre: np.ndarray
    inverse: np.ndarray
    farthest: float
    factor: float

    def factors(self, setpoints: np.ndarray) -> np.ndarray:
        """By how much the noise grows at setpoints: `factor` outside of those of the fit.

        Args:
            setpoints: Shape (pose_count, actuator_count).
        """
        far = _distances(setpoints - self.centre, self.inverse) > self.farthest
        return np.where(far, self.factor, 1.0)


def reach_of(linear: Linear, setpoints: np.ndarray) -> Reach:
    """How errors grow: the outer third of the poses along each setpoint is predicted by the others.

    Args:
        linear: The fit.
        setpoints: Of its poses, shape (pose_count, actuator_count).
    """
    centre = setpoints.mean(axis=0)
    inverse = np.linalg.pinv(np.atleast_2d(np.cov(setpoints.T)))
    within, errors = float(np.mean(linear.residuals**2)), []
    for own in setpoints.T:
        for outer in (own > np.quantile(own, 2.0 / 3.0), own < np.quantile(own, 1.0 / 3.0)):
            part = outer[linear.poses]
            if part.any() and not part.all():
                found = linear.held_back(range(len(linear.z)), [part])
                errors.append(float(np.nanmean(found**2)))
    factor = np.sqrt(max(1.0, np.mean(errors) / max(within, 1.0e-12))) if errors else 1.0
    return Reach(centre, inverse, float(_distances(setpoints - centre, inverse).max()), float(factor))


def _distances(off: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("ki,ij,kj->k", off, inverse, off))


def faulty(off: np.ndarray, least: float = 0.0) -> np.ndarray:
    """Points that are off as no noise is, shape (pose_count, point_count); none where too many are.

    Args:
        off: Predicted less measured places [m], NaN where none was measured, shape (pose_count,
            point_count, 3).
        least: Least median that is assumed [m].
    """
    distances = np.linalg.norm(off, axis=2)
    seen = np.isfinite(distances)
    if not seen.any():
        return seen
    median = max(np.median(distances[seen]), least)
    of_points = np.median(np.where(seen, distances, median), axis=0)  # a tip is further off than a base
    of_points[(of_points < median) | (of_points > FAULTY * median)] = median
    found = seen & (distances > FAULTY * of_points)
    return found if found.sum() <= MOST_FAULTY * seen.sum() else np.zeros_like(found)


class Hysteresis(NamedTuple):
    """The part of an error that depends on the direction of the motion before a pose.

    Attributes:
        amplitudes: Along each axis by the direction along each axis [m], zero where the data do not tell
            it, shape (3, 3).
        before: Root mean square along each axis of the error of a pose that does not grow with its place [m],
            shape (3,).
        after: The same without the hysteresis.
    """

    amplitudes: np.ndarray
    before: np.ndarray
    after: np.ndarray


def hysteresis(off: np.ndarray, places: np.ndarray) -> Hysteresis | None:
    """Separates from noise what the direction of motion explains; None where it explains nothing.

    Robots mostly came from below to what is high: errors that grow with the place are told apart.

    Args:
        off: Predicted less measured, mean of the points of each pose [m], in the order in which the poses
            were driven, shape (pose_count, 3).
        places: Mean measured place of each pose [m], same shape.
    """
    ways, errors = np.sign(np.diff(places, axis=0)), -off[1:]
    known = np.isfinite(ways).all(axis=1) & np.isfinite(errors).all(axis=1)
    ways, errors, at = ways[known], errors[known], places[1:][known]
    if len(ways) < _DIRECTIONS:
        return None
    A = np.column_stack([ways, np.ones(len(ways)), at - at.mean(axis=0)])
    solution = np.linalg.lstsq(A, errors, rcond=None)[0]
    left = errors - A @ solution
    scale = np.sqrt(np.diag(np.linalg.pinv(A.T @ A))[:3, None] * np.sum(left**2, axis=0) / (len(A) - A.shape[1]))
    told = np.where(np.abs(solution[:3]) > _TOLD * scale, solution[:3], 0.0)
    if not told.any():
        return None
    apart = errors - A[:, 4:] @ solution[4:]
    return Hysteresis(told.T, apart.std(axis=0), (apart - ways @ told).std(axis=0))
