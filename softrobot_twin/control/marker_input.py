"""Measured markers, and how far the body is from where the twin believes it to be."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.arrival import Arrival, HeaderCheck
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal, RefusalCounts


class Misfit(NamedTuple):
    """Measured against predicted markers.

    Attributes:
        vectors: Measured minus predicted [m], shape (marker_count, 3); NaN where hidden.
        rms: Root mean square of the distances over the visible ones [m]; NaN without any.
        visible: Markers seen.
    """

    vectors: np.ndarray
    rms: float
    visible: int


class MarkerInput:
    """Keeps the newest measured position of each marker of the scene.

    Args:
        marker_ids: Ids of the scene's markers, shape (marker_count,).
        frame_id: The one frame that markers may be given in.
        settings: Timeouts.

    Attributes:
        refusals: Messages refused, by reason.
        unknown: Points with an id that the scene does not have; they are left out.
        positions: Measured positions [m], shape (marker_count, 3); NaN where hidden.
        stamp: When they were measured [ns].
    """

    def __init__(self, marker_ids: np.ndarray, frame_id: str, settings: LoopSettings):
        self.refusals = RefusalCounts()
        self.unknown = 0
        self._header = HeaderCheck(frame_id, 0.0, 0.0)
        self._order = np.argsort(marker_ids, kind="stable")
        self._sorted_ids = np.asarray(marker_ids, dtype=np.uint32)[self._order]
        self.apply(settings)
        self.reset()

    def apply(self, settings: LoopSettings) -> None:
        """Takes up changed timeouts."""
        self._timeout = settings.marker_timeout
        self._header.message_timeout = settings.message_timeout
        self._header.future_tolerance = settings.future_tolerance

    def reset(self) -> None:
        """Forgets what was measured; the counts stay."""
        self.positions = np.full((len(self._sorted_ids), 3), np.nan)
        self.stamp = 0
        self._newest = -math.inf
        self._header.forget()

    def accept(self, ids: np.ndarray, positions: np.ndarray, arrival: Arrival) -> Refusal | None:
        """Takes the markers of one message, or says why not.

        Args:
            ids: Marker ids, shape (n,).
            positions: Their positions [m], shape (n, 3); a row with a NaN is hidden.
            arrival: Header and moment of the message.
        """
        refusal = self._header.refusal(arrival)
        if refusal is None and positions.shape != (len(ids), 3):
            refusal = Refusal.WRONG_SIZE
        if refusal is None and np.isinf(positions).any():
            refusal = Refusal.NOT_FINITE
        if refusal is None and len(np.unique(ids)) != len(ids):
            refusal = Refusal.DUPLICATE_ID
        if refusal is not None:
            return self.refusals.add(refusal)
        self._header.remember(arrival)
        self._newest = arrival.time
        self.stamp = arrival.stamp or arrival.ros_time
        measured = np.full_like(self.positions, np.nan)
        if len(self._sorted_ids):
            place = np.searchsorted(self._sorted_ids, ids).clip(max=len(self._sorted_ids) - 1)
            known = self._sorted_ids[place] == ids
            measured[self._order[place[known]]] = positions[known]
            self.unknown += int((~known).sum())
        else:
            self.unknown += len(ids)
        measured[np.isnan(measured).any(axis=1)] = np.nan
        self.positions = measured
        return None

    def age(self, now: float) -> float:
        """Time since markers last arrived [s]; infinite when they never did."""
        return now - self._newest

    def measured(self, now: float) -> np.ndarray:
        """Positions to count on [m], shape (marker_count, 3): all NaN when they are too old."""
        if self.age(now) > self._timeout:
            return np.full_like(self.positions, np.nan)
        return self.positions

    @staticmethod
    def misfit(measured: np.ndarray, predicted: np.ndarray) -> Misfit:
        """Compares measured with predicted positions of the same moment [m], (marker_count, 3)."""
        vectors = measured - predicted
        visible = np.isfinite(vectors).all(axis=1)
        count = int(visible.sum())
        squares = np.einsum("ij,ij->i", vectors[visible], vectors[visible])
        return Misfit(vectors, float(np.sqrt(squares.mean())) if count else math.nan, count)
