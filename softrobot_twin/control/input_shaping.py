"""Targets spread over time so that slow modes do not vibrate, without feedback.

A command that is given in two parts, half a period of a mode apart, leaves that mode still: the second
vibration cancels the first (zero vibration, ZV; Singer and Seering 1990). With the damping ratio ζ
and k = exp(-π ζ / √(1 - ζ²)) the parts are 1/(1 + k) and k/(1 + k); ZVD has three, the square of the
polynomial of ZV, and the first error of a wrong frequency vanishes too. Parts of several modes are
convolved. All parts sum to 1, so that a target that stands is reached.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from softrobot_twin.analysis.linear_model import LinearModel

LEAST_SHARE = 0.05
"""Modes with less than this share of the greatest motion of the effectors are left as they are."""
ALIKE = 0.1
"""Modes whose frequencies differ by less than this share count as one."""
FASTEST = 4
"""Modes with less than so many ticks in a period cannot be shaped."""
CALM = 0.5
"""Modes with a greater damping ratio do not vibrate."""


class Shaper:
    """Spreads targets over time by the modes of a linear model.

    Attributes:
        times: When the parts follow [s], shape (part_count,).
        parts: The parts, shape (part_count,); they sum to 1.
        frequencies: The modes that are kept still [Hz], shape (n,).
    """

    def __init__(self, model: LinearModel, outputs: np.ndarray, kind: str, period: float):
        """Find the parts.

        Args:
            model: The linear model.
            outputs: The outputs that follow targets, shape (output_count,).
            kind: ``zv`` or ``zvd``.
            period: Time of a tick [s].
        """
        gains = np.linalg.norm(model.E[outputs], axis=0) * np.linalg.norm(
            np.linalg.solve(model.K, model.H.T), axis=1)  # fmt: skip
        chosen: list[tuple[float, float]] = []
        for place in np.argsort(-gains):
            frequency, damping = model.frequencies[place], model.damping_ratios[place]
            if gains[place] < LEAST_SHARE * gains.max() or not 0.0 < frequency < 1.0 / (FASTEST * period):
                continue
            is_new = all(abs(frequency - other) > ALIKE * other for other, _ in chosen)
            if damping < CALM and is_new:
                chosen.append((frequency, damping))
        self.frequencies = np.array([frequency for frequency, _ in chosen])
        times, parts = np.zeros(1), np.ones(1)
        for frequency, damping in chosen:
            for _ in range(1 if kind == "zv" else 2):
                root = math.sqrt(1.0 - damping**2)
                k = math.exp(-math.pi * damping / root)
                half = 0.5 / (frequency * root)
                times = np.concatenate([times, times + half])
                parts = np.concatenate([parts, k * parts]) / (1.0 + k)
        self.times, self.parts = times, parts
        self._weights = _weights(times / period, parts)
        self.reset()

    @property
    def duration(self) -> float:
        """Time after which a target that stands is reached [s]."""
        return float(self.times.max())

    def reset(self) -> None:
        """Forgets earlier targets."""
        self._targets: deque[np.ndarray] = deque(maxlen=len(self._weights))

    def shaped(self, targets: np.ndarray) -> np.ndarray:
        """The targets of a tick, spread over time.

        Args:
            targets: [m], NaN without a target, shape (effector_count, 3).

        Returns:
            The same with the targets of the ticks before; before the first they stood where it is.
        """
        if self._targets:
            before = self._targets[0]
            # A first target, or one after none, was always there.
            is_new = np.isfinite(targets) & ~np.isfinite(before)
            if is_new.any():
                self._targets = deque(
                    [np.where(is_new, targets, one) for one in self._targets], self._targets.maxlen)
        else:
            self._targets.extend([targets] * self._targets.maxlen)
        self._targets.appendleft(targets)
        return np.tensordot(self._weights, np.array(self._targets), axes=1)


def _weights(ticks: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Weights of this tick and those before, of parts between ticks on straight lines.

    Args:
        ticks: When the parts follow, in ticks, shape (part_count,).
        parts: The parts, same shape.
    """
    first = np.floor(ticks).astype(int)
    share = ticks - first
    weights = np.zeros(first.max() + 2)
    np.add.at(weights, first, (1.0 - share) * parts)
    np.add.at(weights, first + 1, share * parts)
    return weights
