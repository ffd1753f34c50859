"""Who speaks on an input: two publishers on one topic are noticed by the numbers of their messages,
two devices by what they measure.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

CONTESTED_TIME = 1.0
"""An input is contested for this time after two publishers were last heard by turns [s]."""
SILENT_AFTER = 3.0
"""A publisher or device that was not heard for so many of its intervals has ended."""
LEAST_SILENCE, LONGEST_SILENCE = 0.1, 1.0
"""It has ended after this time at the earliest, and at the latest [s]."""
LAG_RATE = 3.0
"""As long as a device follows its commands, its distance from them increases at most at this
multiple of the rates."""
LAG_TIME = 0.05
"""The distance increases that fast for at most this time [s]. After that the worst case is a device
that does not move, while its command moves at the actuators' rates."""
LAG_SHARE = 0.02
"""Share of the travel that is allowed for noise. A device that is nearer than this to its command
counts as being at its command."""
_FIRST_INTERVAL = 0.1
"""Interval of one that was heard once [s]."""
_MOST_LOST, _MOST_LOST_FACTOR = 20, 5.0
"""Messages of one publisher that may be missing in a row, beside so many times those that its
interval lets expect. A larger gap is another publisher's number."""
_REMEMBERED = 10.0
"""A publisher is forgotten after this time [s]."""
_MOST_VOICES = 8
_NEAREST_OF, _LEARNED_FROM, _ENOUGH = 3, 40, 8
"""A measurement is compared with the nearest of so many before. The noise is learned from so many
comparisons, and known from so many on. Of random turns of two devices at most one comparison in
eight is with the other one."""
_LEARN_EVERY, _LEARN_FIRST = 20, 4
"""It is learned anew after so many comparisons, and at the beginning after so many."""
_STEADY = 5
"""The speed of a motion is the median of so many comparisons."""
_TYPICAL, _OF_MANY, _OF_ONE = 0.7, 4.0, 4.0
"""Noise is typically as large as this quantile of comparisons, and at most so many times as large, more
with few actuators, and with few comparisons: normal noise goes beyond less than once in 10⁵."""
_TINY = 1.0e-300
_FADES = 0.9
"""What was learned falls to this share at most where less is learned anew."""
NOISE_SHARE = 0.25
"""What is a larger share of the travel than this is not noise."""


class _Publisher:
    """What is heard of one publisher: its newest number, when it was sent and heard, the time between
    what is heard of it, and the time between its messages [s]. Some messages may be lost.
    """

    def __init__(self, number: int, sent: float, time: float):
        self.number, self.sent, self.heard = number, sent, time
        self.interval = self.spacing = _FIRST_INTERVAL

    def continues(self, number: int, sent: float) -> bool:
        """Whether a message of this number, sent at this time [s], can be its next one.

        After a listener was stopped, messages arrive in one moment, and most of them are lost. The
        times at which they were sent are as far apart as ever.
        """
        expected = (sent - self.sent) / self.spacing if self.spacing > 0.0 else 0.0
        return 0 < number - self.number <= _MOST_LOST + _MOST_LOST_FACTOR * max(expected, 0.0)

    def hear(self, number: int, sent: float, time: float) -> None:
        """It sends a message."""
        self.interval = time - self.heard
        self.spacing = (sent - self.sent) / (number - self.number)
        self.number, self.sent, self.heard = number, sent, time

    def is_silent(self, now: float) -> bool:
        """Whether it has ended, as far as its interval tells."""
        silence = min(max(SILENT_AFTER * self.interval, LEAST_SILENCE), LONGEST_SILENCE)
        return now - self.heard > silence


class PublisherWatch:
    """Notices that two publishers send on one topic, by the numbers that each gives its messages.

    A publisher that was started again counts anew, and the one before is never heard again: that is
    no contest. A message of a new publisher is not used until the one before is silent. When a
    publisher is heard again after another, two of them send, and neither is used.
    """

    def __init__(self) -> None:
        self._voices: list[_Publisher] = []
        self._last: _Publisher | None = None
        self._used: _Publisher | None = None
        self._contested = -math.inf

    def hear(self, number: int | None, sent: float, time: float) -> bool:
        """Hears a message.

        Args:
            number: Its number by its publisher; None where the middleware does not number them.
            sent: When it was sent, on the clock of its publisher [s].
            time: When it arrived [s].

        Returns:
            Whether it may be used.
        """
        if number is None:
            return True
        self._voices = [voice for voice in self._voices if time - voice.heard < _REMEMBERED]
        known = [voice for voice in self._voices if voice.continues(number, sent)]
        if known:
            # Of two at the same number the last speaker is meant: the other may have ended.
            voice = max(known, key=lambda one: (one.number, one is self._last))
            voice.hear(number, sent, time)
            if voice is not self._last:
                self._contested, self._used = time, None
        else:
            voice = _Publisher(number, sent, time)
            self._voices = [*self._voices[1 - _MOST_VOICES:], voice]
        self._last = voice
        if self.is_contested(time):
            return False
        if self._used is None or self._used.is_silent(time):
            self._used = voice
        return voice is self._used

    def is_contested(self, now: float) -> bool:
        """Whether two publishers were heard by turns lately; `now` is a time [s].

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        return now - self._contested < CONTESTED_TIME


class SensorNoise:
    """What noise changes of measured setpoints, learned from measurement to measurement.

    Each measurement is compared with that of the last few which is nearest. So two devices that
    measure by turns teach the noise of each, and not their distance. Steady motion is taken away.

    Args:
        least: Noise that is always allowed, in the unit of each actuator, shape (actuator_count,).
        most: Changes that are never noise, same shape.

    Attributes:
        bound: What noise changes at most from one measurement to the next, same shape.
    """

    def __init__(self, least: np.ndarray, most: np.ndarray):
        count = len(least)
        self._least, self._most, self.bound = least, most, least.copy()
        self._scale = np.where(np.isfinite(least) & (least > 0.0), least, 1.0)
        # Rings: the newest measurements with their times, and comparisons with their spans [s].
        self._places = np.full((_NEAREST_OF, count), np.inf)
        self._times = np.full((_NEAREST_OF, count), -np.inf)
        self._changes, self._spans = np.zeros((2, _LEARNED_FROM, count))
        self._counts, self._heard = np.zeros((2, count), int)

    def is_known(self, named: np.ndarray) -> bool:
        """Whether enough was measured of some actuators to judge by.

        Args:
            named: Which ones, shape (actuator_count,).
        """
        return bool((self._counts[named] >= _ENOUGH).all())

    def learn(self, named: np.ndarray, measured: np.ndarray, time: float) -> None:
        """Learns from a measurement.

        Args:
            named: Which actuators are measured, shape (actuator_count,).
            measured: Their setpoints, same shape.
            time: When it arrived [s].
        """
        places = np.flatnonzero(named)
        if not len(places):
            return
        values, before = measured[places], self._places[:, places]
        away = (np.abs(values - before) / self._scale[places]).max(axis=1)
        nearest = int(away.argmin())
        if away[nearest] < np.inf:
            counts = self._counts[places]
            rows = counts % _LEARNED_FROM
            self._changes[rows, places] = values - before[nearest]
            self._spans[rows, places] = time - self._times[nearest, places]
            counts += 1
            self._counts[places] = counts
            known = int(counts.min())
            if known % (_LEARN_EVERY if known > _LEARNED_FROM else _LEARN_FIRST) == 0:
                self._renew(places, min(known, _LEARNED_FROM))
        rows = self._heard[places] % _NEAREST_OF
        self._places[rows, places], self._times[rows, places] = values, time
        self._heard[places] += 1

    def _renew(self, places: np.ndarray, known: int) -> None:
        """Renews the bounds of some actuators by the newest comparisons, of which so many are known."""
        if known < _ENOUGH:
            return
        rows = (self._counts[places] - known + np.arange(known)[:, None]) % _LEARNED_FROM
        changes, spans = self._changes[rows, places], self._spans[rows, places]
        # At the same moment nothing moves.
        speeds = np.divide(changes, spans, out=np.zeros_like(changes), where=spans > 0.0)
        middle = _STEADY // 2
        steady = np.sort(sliding_window_view(speeds, _STEADY, axis=0), axis=-1)[..., middle]
        inner = slice(middle, known - middle)
        residuals = np.sort(np.abs(changes[inner] - steady * spans[inner]), axis=0)
        typical = residuals[round(_TYPICAL * (len(residuals) - 1))]
        # Of few actuators one of the last measurements is nearer by chance: of few with noise.
        shares = typical / self._scale[places]
        noisy = shares.sum() / max(shares.max(), _TINY)
        times = (_OF_MANY + _OF_ONE / max(noisy, 1.0)) * (1.0 + _ENOUGH / known)
        learned = times * typical
        bound = np.maximum(np.maximum(learned, _FADES * self.bound[places]), self._least[places])
        self.bound[places] = np.minimum(bound, self._most[places])


class PlaceWatch:
    """Notices that actuators are measured at two places by turns, as by two devices.

    A measurement that is further from the one before than the actuator can have moved is used once
    nothing is measured at the old place any more: so it is where a device was started again. When
    the old place is measured again twice within `CONTESTED_TIME`, two devices measure.

    Args:
        rate: Greatest speed of each actuator, in its unit per second, shape (actuator_count,).
        noise: What is allowed beside that at least, same shape; more where the measurements have it.

    Attributes:
        noise: What is allowed for noise.
    """

    def __init__(self, rate: np.ndarray, noise: np.ndarray):
        self._rate, self.noise = rate, SensorNoise(noise, NOISE_SHARE / LAG_SHARE * noise)
        self._places = np.full(len(rate), np.nan)
        self._heard = np.full(len(rate), -np.inf)
        self._interval = np.full(len(rate), _FIRST_INTERVAL)
        self._elsewhere = np.full(len(rate), -np.inf)
        self._returned = self._contested = -math.inf

    def hear(self, named: np.ndarray, measured: np.ndarray, time: float) -> bool:
        """Hears a measurement.

        Args:
            named: Which actuators are measured, shape (actuator_count,).
            measured: Their setpoints, same shape.
            time: When it arrived [s].

        Returns:
            Whether it may be used.
        """
        since = np.minimum(time - self._heard, LONGEST_SILENCE)
        # Without a rate limit, the product with a time of 0 would be NaN.
        since = np.maximum(since, 1.0e-9)
        longest = self._rate * np.maximum(LAG_RATE * np.minimum(since, LAG_TIME), since)
        self.noise.learn(named, measured, time)
        moved = named & (np.abs(measured - self._places) > longest + self.noise.bound)
        silence = np.clip(SILENT_AFTER * self._interval, LEAST_SILENCE, LONGEST_SILENCE)
        if (moved & (time - self._heard <= silence)).any():
            self._elsewhere[moved] = time
            return False
        if (named & ~moved & np.isfinite(self._elsewhere)).any():
            if time - self._returned < CONTESTED_TIME:
                self._contested = time
            if self.noise.is_known(named):
                self._returned = time
        self._elsewhere[named] = -np.inf
        self._places = np.where(named, measured, self._places)
        self._interval = np.where(named & np.isfinite(self._heard), since, self._interval)
        self._heard = np.where(named, time, self._heard)
        return True

    def is_contested(self, now: float) -> bool:
        """Whether two places were measured by turns lately; `now` is a time [s].

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        return now - self._contested < CONTESTED_TIME

    def is_disputed(self, now: float) -> bool:
        """Whether the newest measurement is not used yet, or two places are contested.

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        is_new = (now - self._elsewhere <= SILENT_AFTER * _FIRST_INTERVAL).any()
        return bool(is_new) or self.is_contested(now)
