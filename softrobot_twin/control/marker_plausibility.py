"""Which measured markers can be believed: an outlier or a swapped id must not lead the robot."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.clock_steps import NANOSECONDS
from softrobot_twin.simulation import Simulation

GREATEST_MISFIT = 0.25
"""A marker further from the model than this share of the robot's size is never believed."""
STRAIN = 0.35
"""How much the misfit differs between two markers at most, by the distance between them."""
SLACK_SHARE = 0.01
"""A misfit may leap by this share of the size beside noise, at an edge of contact for example."""
SPEED_SHARE = 1.0
"""Misfits that several markers share change by this share of the size in a second at most."""
ACCEPT_AFTER = 1.0
"""A marker displaced by no more than `STRAIN` allows is believed again after so long [s]."""
FORGOTTEN_AFTER = 1.0
"""What was expected of a marker that was hidden for so long counts no longer [s]."""
NOISE_FACTOR = 6.0
"""How many standard deviations of a coordinate still are noise."""
_FIRST_NOISE_SHARE, _FIRST_FRAMES = 0.002, 5
_LEARNING, _NOISE_LEARNING = 0.5, 0.1
# Mean length of a vector of three normal coordinates, by their standard deviation.
_LENGTH_OF_NOISE = 1.6
_NEIGHBOURS = 3


class MarkerPlausibility:
    """Judges each frame of markers by what is expected of them.

    What is expected of a marker is its misfit of before. The misfit of an honest marker, measured
    minus predicted, is the model's error there: it changes slowly, and by nearly as much as that
    of the markers around it. So a marker is believed when its misfit is as before, or has
    changed as that of most markers around it, no faster than the robot moves. The median over the
    markers around it is not moved by one wrong marker of four, nor by two whose ids were swapped.

    A displacement that most markers around share is believed as soon as the robot could have made
    it at one size in a second; that of a single marker is believed after `ACCEPT_AFTER`, if
    it is not further from the others than a turn of the body explains; else never. A misfit of
    more than `GREATEST_MISFIT` of the size is never believed. What is not is named.

    Args:
        simulation: Gives the markers at rest, which of them are around an effector, and the size.

    Attributes:
        left_out: Ids of the markers of the newest frame that are not believed.
    """

    def __init__(self, simulation: Simulation):
        self._ids = simulation.marker_ids
        places = simulation.marker_positions()
        size = simulation.model.nodes.size
        self._size = size if np.isfinite(size) else 1.0
        self._around = _around(places, simulation.effector_markers)
        self._bend = STRAIN * _typical_distances(places, self._around)
        self.forget()

    def forget(self) -> None:
        """Expects nothing of the markers, as before the first frame."""
        count = len(self._ids)
        self._expected = np.full((count, 3), np.nan)
        self._believed_at = np.zeros(count)
        self._out_since = np.full(count, np.nan)
        self._seen_at = np.zeros(count)
        self._out = np.zeros(count, dtype=bool)
        self._noise = _FIRST_NOISE_SHARE * self._size
        self._frames = 0
        self._stamp = 0

    @property
    def left_out(self) -> tuple[int, ...]:
        """See the attributes."""
        return tuple(self._ids[self._out].tolist()) if self._out.any() else ()

    def without_left_out(self, measured: np.ndarray) -> np.ndarray:
        """Measured positions [m], shape (marker_count, 3); NaN for those that are left out."""
        if not self._out.any():
            return measured
        return np.where(self._out[:, np.newaxis], np.nan, measured)

    def judge(self, misfits: np.ndarray, stamp: int, follows_robot: bool) -> None:
        """Takes a frame, if it is a new one.

        Args:
            misfits: Measured minus predicted [m], shape (marker_count, 3); NaN where hidden.
            stamp: When the frame was taken [ns].
            follows_robot: The model is where the robot is; else nothing can be expected.
        """
        if not follows_robot:
            if self._stamp:
                self.forget()
            return
        seen = np.isfinite(misfits).all(axis=1)
        if not seen.any():
            self._out[:] = False
            return
        if stamp == self._stamp:
            return
        # A clock that was set back begins anew: times of before tell nothing.
        if stamp < self._stamp:
            self.forget()
        self._stamp = stamp
        self._judge(misfits, seen, stamp / NANOSECONDS)

    def _judge(self, misfits: np.ndarray, seen: np.ndarray, now: float) -> None:
        known = now - self._seen_at <= FORGOTTEN_AFTER
        known &= np.isfinite(self._expected[:, 0])
        changes = misfits - np.where(known[:, np.newaxis], self._expected, 0.0)
        votes = self._votes(seen)
        # Both medians at once: this runs in every tick that brings a frame.
        both = self._common(np.concatenate([changes, misfits], axis=1), votes)
        common, typical = both[:, :3], both[:, 3:]
        apart = np.linalg.norm(changes - common, axis=1)
        shared, as_seen = np.linalg.norm(common, axis=1), np.linalg.norm(changes, axis=1)
        # Alone or in pairs markers are their own median: then noise is how they change.
        in_company = votes > 2
        strayed = np.where(in_company, apart, np.where(known, as_seen, np.nan))
        if self._frames < _FIRST_FRAMES:
            self._learn_noise(strayed[seen & in_company])
        noise = NOISE_FACTOR * self._noise
        slack = noise + SLACK_SHARE * self._size
        with np.errstate(invalid="ignore"):
            possible = np.linalg.norm(misfits, axis=1) <= GREATEST_MISFIT * self._size + noise
            bent = np.linalg.norm(misfits - typical, axis=1)
            possible &= bent <= self._bend + STRAIN * np.linalg.norm(typical, axis=1) + noise
            as_before = as_seen <= slack
            speed = SPEED_SHARE * self._size * (now - self._believed_at)
            as_others = (apart <= slack + STRAIN * shared) & (shared <= slack + speed)
            for_long = now - self._out_since >= ACCEPT_AFTER
        believed = seen & possible & (~known | as_before | as_others | for_long)
        self._out = seen & ~believed
        self._out_since = np.where(believed, np.nan, self._out_since)
        self._out_since[self._out & np.isnan(self._out_since)] = now
        if self._frames >= _FIRST_FRAMES:
            self._learn_noise(strayed[believed])
        self._seen_at[seen] = now
        self._learn(misfits, believed, known, now)

    def _learn(self, misfits, believed, known, now: float) -> None:
        fresh = believed & (~known | (now - self._believed_at >= ACCEPT_AFTER))
        followed = believed & ~fresh
        self._expected[fresh] = misfits[fresh]
        self._expected[followed] += _LEARNING * (misfits[followed] - self._expected[followed])
        self._believed_at[believed] = now

    def _learn_noise(self, strayed: np.ndarray) -> None:
        """Takes in how far markers strayed [m]: of all at first, later of those believed."""
        self._frames += 1
        strayed = strayed[np.isfinite(strayed)]
        if not len(strayed):
            return
        learning = max(_NOISE_LEARNING, 1.0 / (1.0 + self._frames))
        # One frame, or one bad marker alone, cannot make everything else look like noise.
        most = max(3.0 * self._noise, _FIRST_NOISE_SHARE * self._size)
        typical = min(float(np.median(strayed)) / _LENGTH_OF_NOISE, most)
        self._noise += learning * (typical - self._noise)

    def _votes(self, seen: np.ndarray) -> np.ndarray:
        """How many markers around each one are seen, itself among them, shape (marker_count,)."""
        return np.append(seen, False)[self._around].sum(axis=1)

    def _common(self, vectors: np.ndarray, votes: np.ndarray) -> np.ndarray:
        """Median over the markers around each one [m]; zero where none is seen.

        Where their number is even, the expectation has a vote too, which is zero.

        Args:
            vectors: A row for each marker, NaN where hidden, shape (marker_count, n).
            votes: How many markers around each one are seen, shape (marker_count,).
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
    """For each marker itself, then those to compare it with; padded with -1.

    These are the markers of the same effector where they are enough, else the nearest ones.

    Args:
        places: Where the markers are at rest [m], shape (marker_count, 3).
        groups: For each effector, places of its markers.

    Returns:
        Indices, shape (marker_count, greatest number).
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
    """Median distance from each marker to those around it [m]; zero for one alone."""
    distances = np.zeros(len(places))
    for marker, group in enumerate(around):
        others = group[1:][group[1:] >= 0]
        if len(others):
            apart = np.sort(np.linalg.norm(places[others] - places[marker], axis=1))
            distances[marker] = apart[(len(apart) - 1) // 2]
    return distances
