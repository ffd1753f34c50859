"""A real silicone beam: its measurements, and how well a model predicts its sag and its ringing."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from rich.table import Table

from specimens import column_mesh

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.terminal import console, table
from softrobot_twin.mechanics.laws import law_named, law_names
from softrobot_twin.mechanics.material import shear_modulus
from softrobot_twin.scene import Scene, scene_from_mapping
from softrobot_twin.scene.material_presets import MATERIAL_PRESETS
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.accuracy_study import write_mesh

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
    from scipy.signal import find_peaks  # it loads slowly, in each process that collects tests

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


SIZE = (0.030, 0.030, 0.100)
"""Height, width and length [m]."""
CELLS = (3, 3, 8)
"""Boxes of six quadratic tetrahedra along each."""
POISSON_RATIO, DENSITY, GRAVITY = 0.499, 1070.0, 9.80709
"""As its makers published them [-], [kg/m³], [m/s²]."""
MARKER, MARKER_POINT = "Tip-2", (0.009, -0.015, -0.100)
"""The tracked marker, and its point on the beam [m]."""
THREADS, THREAD_LENGTH, THREAD_STIFFNESS = 5, 0.2, 5.0e4
"""A load hangs on so many threads along the edge, of [m], of [N/m] each."""
TURN_PER_STEP = 0.1
"""A step is so short that the beam swings on by this angle [rad]: it loses some 5 % of critical
damping by that, about as much as the real one."""
SWINGS = 3.5
"""Swings that a frequency is read from."""
SETTLING_STEPS = 40


class BeamLoad(NamedTuple):
    """A load on the beam, with its published values.

    Attributes:
        name: As in the names of the recordings.
        weight: [N].
        comsol_sag: Sag that the authors of the data computed [m].
    """

    name: str
    weight: float
    comsol_sag: float


LOADS = (
    BeamLoad("gravity", 0.0, 6.75e-3),
    BeamLoad("load52", 0.51012, 16.84e-3),
    BeamLoad("load101", 1.00062, 26.35e-3),
)


class BeamMeasurement(NamedTuple):
    """Measurements of one load, a value for each run.

    Attributes:
        sags: From where the marker was held to where it came to rest [m].
        swinging_sags: From there to the height about which it swung before [m].
        frequencies: [Hz].
    """

    sags: tuple[float, ...]
    swinging_sags: tuple[float, ...]
    frequencies: tuple[float, ...]


class BeamPrediction(NamedTuple):
    """One load: what was measured and what is predicted.

    Attributes:
        load: The load.
        measured: Its measurements.
        sag: Sag of the marker, with the settled modulus [m].
        frequency: Frequency, with the modulus of vibration [Hz].
        settled_frequency: The same with the settled modulus [Hz].
    """

    load: BeamLoad
    measured: BeamMeasurement
    sag: float
    frequency: float
    settled_frequency: float


class BeamStudy(NamedTuple):
    """All that was fitted and predicted.

    Attributes:
        settled_modulus: Young's modulus from where the beam comes to rest by its own weight [Pa].
        swinging_modulus: From where it swings about [Pa].
        predictions: The loads' predictions; the first sag is what was fitted.
    """

    settled_modulus: float
    swinging_modulus: float
    predictions: tuple[BeamPrediction, ...]


def measure(data_folder: Path, load: BeamLoad) -> BeamMeasurement:
    """Measurements of a load.

    Args:
        data_folder: Folder of the recordings.
        load: The load.
    """
    runs = []
    for run in "ab":
        recording = read_beam_recording(data_folder / f"beam_{load.name}_V2_{run}.csv")
        times, positions = recording.times, recording.marker(MARKER)
        heights = positions[:, UP]
        held = heights[times < times[0] + HELD_SECONDS].mean()
        runs.append((
            -float(settled_displacement(times, positions)[UP]),
            float(held - swing_centre(times, heights)), ringing(times, heights).frequency,
        ))  # fmt: skip
    return BeamMeasurement(*zip(*runs, strict=True))


class BeamModel:
    """The beam on one mesh."""

    def __init__(self, folder: Path, cells: tuple[int, int, int] = CELLS, law: str = "corotational"):
        """Mesh it.

        Args:
            folder: Where the mesh is written.
            cells: Boxes along height, width and length.
            law: Name of its law: one of Young's modulus, or a preset, whose constants are scaled
                so that it has that modulus at rest.
        """
        self._folder, self._cells, self._law = folder, cells, law
        write_mesh(folder / "beam.vtk", column_mesh(SIZE, cells))

    def scene(self, young_modulus: float, weight: float, integration: str) -> Scene:
        """The beam with a weight hung on it.

        Args:
            young_modulus: [Pa].
            weight: [N].
            integration: As scenes say it.
        """
        height, width, length = SIZE
        across = np.linspace(-0.5 * width, 0.5 * width, THREADS)
        edge = [[0.5 * height, float(y), -length] for y in across]
        hung = [[0.5 * height - THREAD_LENGTH, y, z] for _, y, z in edge]
        loaded = {} if weight == 0.0 else {
            "mass_springs": [
                {"name": "load", "points": hung, "masses": [weight / GRAVITY / THREADS]}
            ],
            "springs": [
                {"name": f"thread{k}", "stiffness": THREAD_STIFFNESS, "ends": [
                    {"on": "beam", "point": edge[k]}, {"on": "load", "point": hung[k]}]}
                for k in range(THREADS)
            ],
        }  # fmt: skip
        body = {
            "name": "beam", "mesh": {"file": "beam.vtk"}, "element": "quadratic",
            "mass": "consistent",
            "material": self._material(young_modulus),
            "fixed": [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}],
        }  # fmt: skip
        return scene_from_mapping({
            "name": "real_beam", "gravity": [-GRAVITY, 0.0, 0.0], "integration": integration,
            "body": body, "markers": [{"id": 0, "body": "beam", "point": MARKER_POINT}],
            "solver": {"newton_iterations": 10, "residual_tolerance": 1e-6}, **loaded,
        }, self._folder / "beam.yaml")  # fmt: skip

    def _material(self, young_modulus: float) -> dict:
        """Its material as scenes say it, with a modulus at rest [Pa]."""
        others = {"poisson_ratio": POISSON_RATIO, "density": DENSITY}
        preset = MATERIAL_PRESETS.get(self._law)
        if preset is None:
            return {"law": self._law, "young_modulus": young_modulus, **others}
        own = law_named(preset.law).own.shear_modulus(preset.constants)
        factor = shear_modulus(young_modulus, POISSON_RATIO) / own
        constants = {name: factor * value for name, value in preset.constants.items()}
        return {"law": preset.law, "constants": constants, **others}

    def sag(self, young_modulus: float, weight: float) -> float:
        """How far the marker sinks from where the beam is straight [m]."""
        simulation = Simulation(self.scene(young_modulus, weight, "quasi_static"))
        heights = [_height(simulation)]
        for _ in range(SETTLING_STEPS):
            residual = simulation.step(Hold()).report.residual
            heights.append(_height(simulation))
            if residual < 1e-6:
                return heights[0] - heights[-1]
        raise RuntimeError(f"the beam did not settle: {residual:.3g} N are out of balance")

    def frequency(self, young_modulus: float, weight: float, guess: float) -> float:
        """How fast it swings after it is let go where it is straight [Hz].

        Args:
            young_modulus: [Pa].
            weight: [N].
            guess: About its frequency [Hz]; chooses the time step.
        """
        simulation = Simulation(self.scene(young_modulus, weight, "dynamic"))
        time_step = TURN_PER_STEP / (2.0 * np.pi * guess)
        heights = [_height(simulation)]
        for _ in range(round(SWINGS / guess / time_step)):
            simulation.step(Hold(time_step))
            heights.append(_height(simulation))
        slow = ringing(time_step * np.arange(len(heights)), np.array(heights)).frequency
        # Backward Euler turns by atan(ωh) where it should turn by ωh.
        return float(np.tan(2.0 * np.pi * slow * time_step) / (2.0 * np.pi * time_step))

    def fitted_modulus(self, sag: float, guess: float = 2.6e5) -> float:
        """Young's modulus with which the beam sags so far by its own weight [Pa].

        Args:
            sag: [m].
            guess: Where to begin [Pa].
        """
        young_modulus = guess
        for _ in range(4):
            # It sags in inverse proportion to its modulus, nearly.
            young_modulus *= self.sag(young_modulus, 0.0) / sag
        return young_modulus


class SagFit(NamedTuple):
    """One Young's modulus fitted to the sags of all loads.

    Attributes:
        law: Name of the law.
        young_modulus: [Pa].
        sags: Sag of the marker for each load [m].
        errors: Relative error of each, against the mean of the runs.
    """

    law: str
    young_modulus: float
    sags: tuple[float, ...]
    errors: tuple[float, ...]


def fit_sags(
    data_folder: Path, law: str, cells: tuple[int, int, int] = CELLS, guess: float = 2.4e5
) -> SagFit:
    """Fit Young's modulus so that the largest relative error of the three sags is least.

    Args:
        data_folder: Folder of the recordings.
        law: Name of the law.
        cells: Boxes of the mesh along height, width and length.
        guess: Where to begin [Pa].
    """
    measured = np.array([np.mean(measure(data_folder, load).sags) for load in LOADS])
    young_modulus = guess
    with TemporaryDirectory() as folder:
        beam = BeamModel(Path(folder), cells, law)
        for _ in range(3):
            used = young_modulus
            sags = np.array([beam.sag(used, load.weight) for load in LOADS])
            ratios = sags / measured
            # Sags go in inverse proportion to the modulus, nearly.
            young_modulus *= 0.5 * (ratios.max() + ratios.min())
    return SagFit(law, used, tuple(sags), tuple(ratios - 1.0))


def sag_table(data_folder: Path, fits: list[SagFit]) -> Table:
    """Sags by one modulus for all loads, with the error of each."""
    made = table(
        "Young's modulus fitted to the three settled sags at once", "law", "modulus [kPa]",
        *(f"{load.weight:.3f} N: sag [mm], error" for load in LOADS),
    )  # fmt: skip
    made.add_row(
        "measured", "", *(_listed(measure(data_folder, load).sags, 1e3) for load in LOADS)
    )
    for fit in fits:
        cells = [f"{1e3 * sag:.2f}, {100.0 * error:+.1f} %"
                 for sag, error in zip(fit.sags, fit.errors, strict=True)]  # fmt: skip
        made.add_row(fit.law, f"{1e-3 * fit.young_modulus:.1f}", *cells)
    return made


def _height(simulation: Simulation) -> float:
    return float(simulation.model.markers.positions(simulation.state.positions)[0, UP])


def predict_beam(data_folder: Path, cells: tuple[int, int, int] = CELLS) -> BeamStudy:
    """Fit Young's modulus on the beam's own weight alone; predict all else.

    Args:
        data_folder: Folder of the recordings.
        cells: Boxes of the mesh along height, width and length.
    """
    with TemporaryDirectory() as folder:
        beam = BeamModel(Path(folder), cells)
        own = measure(data_folder, LOADS[0])
        settled = beam.fitted_modulus(float(np.mean(own.sags)))
        swinging = beam.fitted_modulus(float(np.mean(own.swinging_sags)))
        predictions = []
        for load in LOADS:
            found = measure(data_folder, load)
            guess = float(np.mean(found.frequencies))
            predictions.append(BeamPrediction(
                load, found, beam.sag(settled, load.weight),
                beam.frequency(swinging, load.weight, guess),
                beam.frequency(settled, load.weight, guess),
            ))  # fmt: skip
    return BeamStudy(settled, swinging, tuple(predictions))


def prediction_table(study: BeamStudy) -> Table:
    """Measured, ours and the makers', beside each other."""
    made = table(
        f"A real beam; Young's modulus by its own weight: {1e-3 * study.settled_modulus:.1f} kPa "
        f"settled, {1e-3 * study.swinging_modulus:.1f} kPa swinging",
        "load [N]", "sag measured [mm]", "ours", "COMSOL", "frequency measured [Hz]", "ours",
        "by settled modulus",
    )  # fmt: skip
    for row in study.predictions:
        made.add_row(
            f"{row.load.weight:.3f}", _listed(row.measured.sags, 1e3), f"{1e3 * row.sag:.2f}",
            f"{1e3 * row.load.comsol_sag:.2f}", _listed(row.measured.frequencies, 1.0),
            f"{row.frequency:.2f}", f"{row.settled_frequency:.2f}",
        )  # fmt: skip
    return made


def _listed(values: tuple[float, ...], factor: float) -> str:
    return " / ".join(f"{factor * value:.2f}" for value in values)


def main() -> int:
    """Reads the command line, predicts, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", metavar="FOLDER", type=Path, help="folder with the recordings")
    parser.add_argument(
        "--sags", metavar="LAW", nargs="+",
        choices=[*law_names(), *MATERIAL_PRESETS],
        help="only fit one modulus of these laws or presets to the three sags",
    )  # fmt: skip
    given = parser.parse_args()
    try:
        if given.sags:
            fits = [fit_sags(given.data, law) for law in given.sags]
            console().print(sag_table(given.data, fits))
        else:
            console().print(prediction_table(predict_beam(given.data)))
    except SoftRobotTwinError as error:
        print(f"real_beam: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
