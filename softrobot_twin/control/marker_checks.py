"""Which measured markers are plausible: an outlier or a swapped id must not move the robot.

Markers are compared with the model's markers at the time of the measurement.
"""

from __future__ import annotations

from statistics import median

import numpy as np

from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.simulation import Simulation

GREATEST_MISFIT = 0.25
"""A marker further from the model than this share of the robot's size is not accepted."""
FARTHEST_MISFIT = 1.0
"""Nor is one further than this, where most markers are elsewhere and others show that the robot is still
held: a camera that has moved displaces all of them."""
STRAIN = 0.35
"""Greatest difference of the misfits of two markers, relative to their distance."""
JUMP_SHARE = 0.01
"""In addition to noise, a misfit may change suddenly by this share of the size, for example when a
contact slips off an edge."""
SPEED_SHARE = 1.0
"""Greatest change of a misfit that several markers share, in sizes per second."""
ACCEPT_AFTER = 1.0
"""A marker displaced by no more than `STRAIN` allows is accepted again after this time [s]."""
DROPPED_AFTER = 1.0
"""The expected misfit of a marker is dropped when the marker was hidden for this time [s]."""
NOISE_FACTOR = 6.0
"""Changes below this number of standard deviations of a coordinate count as noise."""
_FIRST_NOISE_SHARE, _FIRST_FRAMES = 0.002, 5
_LEARNING, _NOISE_LEARNING = 0.5, 0.1
# Mean length of a vector of three normal coordinates, relative to their standard deviation.
_LENGTH_OF_NOISE = 1.6
_NEIGHBOURS = 3


class MarkerPlausibility:
    """Compares the misfit of each marker with its expected value, frame by frame.

    The misfit of a marker is its measured minus its predicted position. For a correct measurement
    the misfit is the model's error at the marker: it changes slowly, and nearly as much as the
    misfits of the markers around it. The expected misfit of a marker is its last accepted misfit. A
    marker is accepted when its misfit is as expected, or none, or when its misfit has changed as those of
    most markers around it, or is the same, no faster than the robot moves. This common change is the median
    over the markers around; one wrong marker of four does not change the median, nor do two markers with
    swapped ids. Where that leaves out more than half of the markers that are seen, those that changed
    together are accepted at any speed, and further from the model as long as others are near it: a
    robot, or its model, snaps to another equilibrium in one frame.

    When most markers around share a displacement, it is accepted as soon as a robot that moves one
    size per second could have made it. The displacement of a single marker is accepted after
    `ACCEPT_AFTER` if a rotation of the body explains its difference from the others, otherwise
    never. Otherwise a misfit of more than `GREATEST_MISFIT` of the size is not accepted. Markers that are
    not accepted are reported.

    Args:
        simulation: Has the markers at rest, the markers of each effector, and the robot's size.

    Attributes:
        left_out: Ids of the markers of the newest frame that are not accepted.
        noise: Standard deviation of each coordinate of a marker, as it is estimated [m].
    """

    def __init__(self, simulation: Simulation):
        self._ids = simulation.marker_ids
        places = simulation.marker_positions()
        self._size = simulation.model.nodes.finite_size
        self._around = _around(places, simulation.effector_markers)
        self._bend = STRAIN * _typical_distances(places, self._around)
        self.forget()

    def forget(self) -> None:
        """Drops all expected misfits, as before the first frame."""
        count = len(self._ids)
        self._expected = np.full((count, 3), np.nan)
        self._accepted_at = np.zeros(count)
        self._out_since = np.full(count, np.nan)
        self._seen_at = np.zeros(count)
        self._out, self._repeats = np.zeros((2, count), dtype=bool)
        self._measured = np.full((count, 3), np.nan)
        self.left_out: tuple[int, ...] = ()
        self.noise = _FIRST_NOISE_SHARE * self._size
        self._frames = 0
        self._stamp = 0

    def without_left_out(self, measured: np.ndarray) -> np.ndarray:
        """Measured positions [m], shape (marker_count, 3); NaN for markers that are left out.

        Args:
            measured: Measured positions [m], shape (marker_count, 3).
        """
        if not self.left_out:
            return measured
        return np.where(self._out[:, np.newaxis], np.nan, measured)

    def judge(
        self, misfits: np.ndarray | None, stamp: int, follows_robot: bool,
        bare: np.ndarray | None = None, measured: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Judges a frame, if it is new.

        Args:
            misfits: Measured minus predicted positions [m], shape (marker_count, 3); NaN for hidden
                markers; None where all are.
            stamp: Time of the measurement [ns].
            follows_robot: Whether the model is where the robot is; else no misfit is expected.
            bare: The same by the model without what an observer found, where `misfits` are by the model
                that bears it, same shape: a marker may be near either.
            measured: Measured positions [m], same shape: one that is that of the frame before, to the bit,
                tells nothing about noise.
        """
        if not follows_robot:
            if self._stamp:
                self.forget()
            return
        if misfits is None or not (seen := np.isfinite(misfits).all(axis=1)).any():
            self._out[:], self.left_out = False, ()
            return
        if stamp == self._stamp:
            return
        # After a clock was set back, earlier times cannot be compared with the present one.
        if stamp < self._stamp:
            self.forget()
        self._stamp = stamp
        if measured is not None:
            self._repeats, self._measured = (measured == self._measured).all(axis=1), measured
        self._judge(misfits, bare, seen, stamp / NANOSECONDS)

    def _judge(self, misfits: np.ndarray, bare: np.ndarray | None, seen: np.ndarray, now: float) -> None:
        known = now - self._seen_at <= DROPPED_AFTER
        known &= np.isfinite(self._expected[:, 0])
        changes = misfits - np.where(known[:, np.newaxis], self._expected, 0.0)
        votes = np.append(seen, False)[self._around].sum(axis=1)  # Visible ones around each.
        # All medians in one call: this runs in every tick with a new frame.
        others = [] if bare is None else [bare]
        medians = self._common(np.concatenate([changes, misfits, *others], axis=1), votes)
        common, typical = medians[:, :3], medians[:, 3:6]
        apart = np.linalg.norm(changes - common, axis=1)
        shared, as_seen = np.linalg.norm(common, axis=1), np.linalg.norm(changes, axis=1)
        # The median of one or two markers is their own change: then the change is the noise.
        in_company = votes > 2
        deviations = np.where(in_company, apart, np.where(known, as_seen, np.nan))
        if self._frames < _FIRST_FRAMES:
            self._learn_noise(deviations[seen & in_company & ~self._repeats])
        noise = NOISE_FACTOR * self.noise
        tolerance = noise + JUMP_SHARE * self._size
        with np.errstate(invalid="ignore"):
            possible = self._is_possible(GREATEST_MISFIT, noise, misfits, bare, medians[:, 3:])
            # A marker that was left out has an old expected misfit: that of the model, or of others, will do.
            as_before = np.minimum(as_seen, np.linalg.norm(misfits, axis=1)) <= tolerance
            together = apart <= tolerance + STRAIN * shared
            together |= np.linalg.norm(misfits - typical, axis=1) <= tolerance
            as_others = together & (shared <= tolerance + SPEED_SHARE * self._size * (now - self._accepted_at))
            for_long = now - self._out_since >= ACCEPT_AFTER
        accepted = seen & possible & (~known | as_before | as_others | for_long)
        if 2 * accepted.sum() < seen.sum():
            # Not so many are wrong: the robot or its model has snapped.
            if np.nanmin(np.linalg.norm(misfits, axis=1)) <= GREATEST_MISFIT * self._size:
                possible = self._is_possible(FARTHEST_MISFIT, noise, misfits, bare, medians[:, 3:])
            accepted |= seen & possible & in_company & together
        self._out = seen & ~accepted
        self.left_out = tuple(self._ids[self._out].tolist())
        self._out_since = np.where(accepted, np.nan, self._out_since)
        self._out_since[self._out & np.isnan(self._out_since)] = now
        if self._frames >= _FIRST_FRAMES:
            self._learn_noise(deviations[accepted & ~self._repeats])
        self._seen_at[seen] = now
        self._learn(misfits, accepted, known, now)

    def _is_possible(
        self, farthest: float, noise: float, misfits: np.ndarray, bare: np.ndarray | None,
        typical: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Whether each marker is near enough to either model, and no further bent than others.

        Args:
            farthest: How far it may be from the model, as a share of the robot's size.
            noise: What is allowed for noise [m].
            misfits: See `judge`.
            bare: See `judge`.
            typical: Medians of these two over the markers around, shape (marker_count, 3 or 6).
        """
        possible = np.zeros(len(misfits), bool)
        for index, one in enumerate([misfits] if bare is None else [misfits, bare]):
            common = typical[:, 3 * index : 3 * index + 3]
            bent = np.linalg.norm(one - common, axis=1)
            near = np.linalg.norm(one, axis=1) <= farthest * self._size + noise
            possible |= near & (bent <= self._bend + STRAIN * np.linalg.norm(common, axis=1) + noise)
        return possible

    def _learn(self, misfits, accepted, known, now: float) -> None:
        fresh = accepted & (~known | (now - self._accepted_at >= ACCEPT_AFTER))
        followed = accepted & ~fresh
        self._expected[fresh] = misfits[fresh]
        self._expected[followed] += _LEARNING * (misfits[followed] - self._expected[followed])
        self._accepted_at[accepted] = now

    def _learn_noise(self, deviations: np.ndarray) -> None:
        """Estimates noise from deviations [m]: of all markers at first, later of accepted ones."""
        self._frames += 1
        deviations = deviations[np.isfinite(deviations)]
        if not len(deviations):
            return
        learning = max(_NOISE_LEARNING, 1.0 / (1.0 + self._frames))
        # Limited, because one frame or one wrong marker could raise the noise without bound.
        most = max(3.0 * self.noise, _FIRST_NOISE_SHARE * self._size)
        typical = min(median(deviations.tolist()) / _LENGTH_OF_NOISE, most)
        self.noise += learning * (typical - self.noise)

    def _common(self, vectors: np.ndarray, votes: np.ndarray) -> np.ndarray:
        """Median over the markers around each one [m]; zero where none is visible.

        Where their number is even, the expected value, zero, is added to them.

        Args:
            vectors: A row for each marker, NaN for hidden ones, shape (marker_count, n).
            votes: Number of visible markers around each one, shape (marker_count,).
        """
        count, width = vectors.shape
        rows = np.full((count + 2, width), np.nan)
        rows[:count] = vectors
        rows[count] = 0.0
        last = np.where(votes % 2 == 0, count, count + 1)
        around = np.concatenate([self._around, last[:, np.newaxis]], axis=1)
        ordered = np.sort(rows[around], axis=1)
        return ordered[np.arange(count), votes // 2]


def _around(places: np.ndarray, groups: tuple[np.ndarray, ...]) -> np.ndarray:
    """For each marker its own index, then those to compare it with; padded with -1.

    These are the markers of the same effector if there are enough, else the nearest ones.

    Args:
        places: Positions of the markers at rest [m], shape (marker_count, 3).
        groups: For each effector, the indices of its markers.

    Returns:
        Indices, shape (marker_count, size of the largest group).
    """
    around = []
    for marker, place in enumerate(places):
        group = next((list(g) for g in groups if marker in g and len(g) >= _NEIGHBOURS), None)
        if group is None:
            distances = np.linalg.norm(places - place, axis=1)
            group = np.argsort(distances, kind="stable")[: _NEIGHBOURS + 1].tolist()
        around.append([marker, *(other for other in group if other != marker)])
    longest = max((len(group) for group in around), default=1)
    return np.array(
        [group + [-1] * (longest - len(group)) for group in around], dtype=np.int64
    ).reshape(-1, longest)


def _typical_distances(places: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Median distance from each marker to those around it [m]; zero for a single marker."""
    distances = np.zeros(len(places))
    for marker, group in enumerate(around):
        others = group[1:][group[1:] >= 0]
        if len(others):
            apart = np.sort(np.linalg.norm(places[others] - places[marker], axis=1))
            distances[marker] = apart[(len(apart) - 1) // 2]
    return distances
