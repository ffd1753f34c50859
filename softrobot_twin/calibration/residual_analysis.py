"""What the residuals of a fit tell: which numbers it needs, which rows are faulty, and how errors grow.

All functions take the residuals r and the Jacobian J of a linear model at its optimum z, scaled by the
noise and by what is known of the numbers before, so that a fit minimises ‖r‖² + ‖z‖². Poses, and not
single coordinates, are held back: the points of one pose share its errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

FOLDS = 8
"""Parts of which each is held back once."""
IN_MODEL, SLAB, DRAWS = 0.3, 0.5, 200
"""Before the data a number differs from its start with this probability, and then by so many deviations of what is
known of it; and sets of numbers that are drawn for each number, of which the first quarter only leads to likely ones."""
LEFT, RANGE = 1.0, 4.0
"""What a chosen set may leave of the averaged prediction: the sum of squares over all measurements, over their noise;
and by how many deviations of what is known of it a number may move for that."""
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


def averaged(linear: Linear, always: Sequence[int] = ()) -> np.ndarray:
    """Numbers averaged over sets of them, each by its probability (spike and slab; George and McCulloch 1993).

    Args:
        linear: With all candidates.
        always: Indices of numbers that are in each set, with all of what is known of them.

    Returns:
        Scaled as z, shape (p,).
    """
    J, count = linear.jacobian, linear.jacobian.shape[1]
    G, b = J.T @ J, J.T @ (J @ linear.z - linear.residuals)
    known, free = np.full(count, SLAB**-2), np.delete(np.arange(count), always)
    known[list(always)] = 1.0

    def of_set(own: np.ndarray) -> tuple[float, np.ndarray]:
        A, mean = G[np.ix_(own, own)] + np.diag(known[own]), np.zeros(count)
        mean[own] = np.linalg.solve(A, b[own])
        odds = np.log(known[own]) + 2.0 * np.log(IN_MODEL / (1.0 - IN_MODEL))
        return 0.5 * float(b @ mean - np.linalg.slogdet(A)[1] + odds.sum()), mean

    rng, own, total, draws = np.random.default_rng(0), np.ones(count, bool), np.zeros(count), DRAWS * len(free)
    now, mean = of_set(own)
    for draw in range(draws):
        one, other = rng.choice(free, 2)  # A number comes or goes, or two change places.
        new = own.copy()
        new[one], new[other] = (own[other], own[one]) if draw % 2 else (not own[one], own[other] ^ (one == other))
        told, there = of_set(new)
        if np.log(rng.random()) < told - now:
            own, now, mean = new, told, there
        total += mean * (draw >= draws // 4)
    return total / max(1, draws - draws // 4) if draws else mean


def selected(linear: Linear, always: Sequence[int] = (), shown: np.ndarray | None = None) -> list[Step]:
    """The fewest numbers that predict as all sets averaged do, the one that takes most of it first.

    Single sets are chosen by luck where several explain as much, their average is not (projection
    predictive selection; Piironen and Vehtari 2017).

    Args:
        linear: With all candidates.
        always: Indices of numbers that are fitted in any case, and are told first.
        shown: Mask of the residuals that steps tell, shape (n,); None for all.
    """
    chosen, count = list(dict.fromkeys(always)), linear.jacobian.shape[1]
    # A number stands for others within its range only, which is narrow where it was measured.
    ranges = np.where(np.isin(np.arange(count), always), 1.0, RANGE)
    Q, R = np.linalg.qr(np.concatenate([linear.jacobian, np.diag(1.0 / ranges)]))
    wanted = Q[: len(linear.jacobian)].T @ (linear.jacobian @ averaged(linear, chosen))

    def left(own: list[int]) -> float:
        return float(np.sum((wanted - R[:, own] @ np.linalg.lstsq(R[:, own], wanted, rcond=None)[0]) ** 2))

    while left(chosen) > LEFT:
        chosen.append(min((k for k in range(count) if k not in chosen), key=lambda k: left([*chosen, k])))
    folds, own = linear.folds(), slice(None) if shown is None else shown
    held_back = (linear.held_back(chosen[:k], folds)[own] for k in range(len(chosen) + 1))
    errors = [float(np.sqrt(np.mean(residuals**2))) for residuals in held_back]
    return [Step(*one) for one in zip(chosen, errors, errors[1:])]


class Reach(NamedTuple):
    """How the error of predictions grows outside of the poses of a fit.

    Attributes:
        centre: Mean of the setpoints of the fit, shape (actuator_count,).
        inverse: Inverse of their covariance, shape (actuator_count, actuator_count).
        farthest: Largest distance of them from the centre.
        factor: Error at the outer poses by a fit to the others, over the error of that fit; at least 1.
        sessions: Names of the sessions of the fit.
        between: Standard deviation of how far a session is shifted along each axis [m]; NaN where one session or no point
            was measured.
    """

    centre: np.ndarray
    inverse: np.ndarray
    farthest: float
    factor: float
    sessions: tuple[str, ...] = ()
    between: float = np.nan

    @property
    def further(self) -> float:
        """What a session adds to the noise that is not of the fit [m], where a few sessions told how they vary.

        The shift of the sessions of the fit is in their noise, that of their mean is not known.
        """
        if not self.between > 0.0:
            return 0.0
        count = len(self.sessions)
        wide = (stdtrit(3 * (count - 1), 0.975) / 1.96) ** 2
        return float(self.between * np.sqrt((1.0 + 1.0 / count) * wide - 1.0 + 1.0 / count))

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


def spread_between(off: np.ndarray, sessions: np.ndarray) -> float:
    """Standard deviation of how far a session is shifted along each axis [m]; NaN for less than two.

    Args:
        off: Mean error of the points of each pose [m], shape (pose_count, 3).
        sessions: Name of the session of each, shape (pose_count,).
    """
    seen = np.isfinite(off).all(axis=1)
    each = [off[seen & (sessions == one)] for one in np.unique(sessions[seen])]
    if len(each) < 2:
        return np.nan
    by_noise = np.mean([np.var(one, axis=0) / len(one) for one in each])
    return float(np.sqrt(max(0.0, np.var([one.mean(axis=0) for one in each], axis=0, ddof=1).mean() - by_noise)))


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
