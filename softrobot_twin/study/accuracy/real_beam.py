"""A real beam, held near its rest shape and let go: how far it sags, how it rings.

Markers on a clamped silicone beam, seen by cameras. In the frame of the recordings the beam lies
along z and the columns' x points up, whatever letter the height bears elsewhere.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks

from softrobot_twin.errors import SoftRobotTwinError

UP = 0
"""Axis of the recordings that points up."""
HELD_SECONDS, SETTLED_SECONDS = 0.4, 1.0
"""The beam is surely held at first and surely at rest at last, for so long [s]."""
STILL = 0.5e-3
"""A marker at rest stays within this of its mean [m]; it creeps, and a hand trembles."""
LEAST_SWING = 0.1
"""Swings of a smaller share of the first are not counted: creep and noise spoil them."""


class BeamRecording(NamedTuple):
    """Markers over time.

    Attributes:
        times: [s], shape (sample_count,), growing.
        marker_names: Names of the markers.
        marker_positions: [m], shape (sample_count, marker_count, 3).
    """

    times: np.ndarray
    marker_names: tuple[str, ...]
    marker_positions: np.ndarray

    def marker(self, name: str) -> np.ndarray:
        """Positions of one marker [m], shape (sample_count, 3)."""
        return self.marker_positions[:, self.marker_names.index(name)]


class Ringing(NamedTuple):
    """How something swings and dies away.

    Attributes:
        frequency: Swings to and fro in a second [Hz].
        damping_ratio: Damping over critical damping.
        swing_count: Half periods this was read from.
    """

    frequency: float
    damping_ratio: float
    swing_count: int


def read_beam_recording(path: Path | str) -> BeamRecording:
    """Read a recording.

    Args:
        path: CSV with a head; a column of times, then x, y and z of each marker [m].

    Raises:
        SoftRobotTwinError: The file cannot be read, or is not such a table.
    """
    try:
        head, *lines = Path(path).read_text(encoding="utf-8").splitlines()
        values = np.array([line.split(",") for line in lines], dtype=float)
    except (OSError, ValueError) as error:
        raise SoftRobotTwinError(f"{path}: not a recording of markers: {error}") from error
    columns = head.split(",")
    names = tuple(column.removesuffix("_x_m") for column in columns[1::3])
    expected = ["t_s", *(f"{name}_{axis}_m" for name in names for axis in "xyz")]
    if columns != expected or values.ndim != 2 or values.shape[1] != len(columns):
        raise SoftRobotTwinError(f"{path}: not a recording of markers: its columns are {columns}")
    if not np.isfinite(values).all() or not np.all(np.diff(values[:, 0]) > 0.0):
        raise SoftRobotTwinError(f"{path}: a marker is missing, or time does not grow")
    return BeamRecording(values[:, 0], names, values[:, 1:].reshape(len(values), -1, 3))


def settled_displacement(times: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """From where a marker is held to where it comes to rest [m], shape (3,).

    Args:
        times: [s], shape (sample_count,).
        positions: Of the marker [m], shape (sample_count, 3).

    Raises:
        ValueError: The marker does not keep still at first or at last.
    """
    means = []
    for when in (times < times[0] + HELD_SECONDS, times > times[-1] - SETTLED_SECONDS):
        mean = positions[when].mean(axis=0)
        unrest = np.abs(positions[when] - mean).max()
        if not unrest < STILL:
            raise ValueError(f"a marker at rest moves by {unrest:.3g} m")
        means.append(mean)
    return means[1] - means[0]


def ringing(times: np.ndarray, heights: np.ndarray) -> Ringing:
    """Frequency and damping after a fall, from turning points.

    Its lowest point is the first. Only the swings between turning points count, so that neither
    the height of rest nor its slow creep matters.

    Args:
        times: Evenly spaced [s], shape (sample_count,).
        heights: [m], shape (sample_count,).

    Raises:
        ValueError: It swings less than twice after its lowest point.
    """
    moments, turned = _turning_points(times, heights)
    half_period = np.polyfit(np.arange(len(moments)), moments, 1)[0]
    swings = np.abs(np.diff(turned))
    decrement = -np.polyfit(np.arange(len(swings)), np.log(swings), 1)[0]
    ratio = decrement / np.hypot(np.pi, decrement)
    return Ringing(float(0.5 / half_period), float(ratio), len(swings))


def swing_centre(times: np.ndarray, heights: np.ndarray) -> float:
    """Height about which something swings while its swings are counted [m].

    What creeps comes to rest lower than that: its material is stiffer when it is quick.

    Args:
        times: Evenly spaced [s], shape (sample_count,).
        heights: [m], shape (sample_count,).

    Raises:
        ValueError: It swings less than twice after its lowest point.
    """
    _, turned = _turning_points(times, heights)
    # Swings to both sides of a centre cancel in this, growing and shrinking ones too.
    return float(np.mean(0.25 * (turned[:-2] + 2.0 * turned[1:-1] + turned[2:])))


def _turning_points(times, heights) -> tuple[np.ndarray, np.ndarray]:
    """Moments and heights where it turns back, from the lowest point on."""
    lowest = int(np.argmin(heights))
    least = LEAST_SWING * (heights[lowest:].max() - heights[lowest])
    turns = np.concatenate(
        [find_peaks(sign * heights, prominence=least)[0] for sign in (1.0, -1.0)]
    )
    turns = np.sort(turns[turns >= lowest])
    if len(turns) < 3:
        raise ValueError(f"{len(turns)} turning points are too few to tell a frequency")
    return _vertices(times, heights, turns)


def _vertices(times, heights, turns) -> tuple[np.ndarray, np.ndarray]:
    """Tops of the parabolas through turning points and their neighbours: times and heights."""
    before, top, after = (heights[turns + shift] for shift in (-1, 0, 1))
    curvature = before - 2.0 * top + after
    # On a plateau, which has no curvature, its middle is the turning point.
    shift = np.divide(
        0.5 * (before - after), curvature, out=np.zeros(len(turns)), where=curvature != 0.0
    )
    return times[turns] + shift * (times[1] - times[0]), top - 0.25 * (before - after) * shift
