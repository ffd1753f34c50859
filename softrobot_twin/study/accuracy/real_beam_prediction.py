"""A real beam predicted: Young's modulus from its own weight, then how it bears and swings loads.

The beam lies along z, clamped at z = 0; x points up, as in the recordings. A load hangs on threads
from the top edge of the tip, and is a mass too.

Silicone creeps: by its own weight the beam swings about a height some 5 % less low than where it
comes to rest seconds later. Two moduli are fitted, to the one and to the other, both with nothing
hung on it: the settled one for sags, the swinging one for frequencies, which are given for both.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from rich.table import Table

from softrobot_twin.scene import Scene, scene_from_mapping
from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.accuracy.real_beam import (
    HELD_SECONDS,
    UP,
    read_beam_recording,
    ringing,
    settled_displacement,
    swing_centre,
)
from softrobot_twin.study.bench.structured_column import column_mesh, write_mesh
from softrobot_twin.study.reports.terminal import table

SIZE = (0.030, 0.030, 0.100)
"""Height, width and length [m]."""
CELLS = (3, 3, 8)
"""Boxes of six quadratic tetrahedra along each."""
POISSON_RATIO, DENSITY, GRAVITY = 0.499, 1070.0, 9.80709
"""As its makers published them [-], [kg/m³], [m/s²]."""
MARKER, MARKER_POINT = "Tip-2", (0.009, -0.015, -0.100)
"""The marker that is followed, and the point of the beam that it stands on [m]."""
THREADS, THREAD_LENGTH, THREAD_STIFFNESS = 5, 0.2, 5.0e4
"""A load hangs on so many threads along the edge, of [m], of [N/m] each."""
TURN_PER_STEP = 0.1
"""A step is so short that the beam swings on by this angle [rad]: it loses some 5 % of critical
damping by that, about as much as the real one."""
SWINGS = 3.5
"""Swings that a frequency is read from."""
SETTLING_STEPS = 40


class BeamLoad(NamedTuple):
    """What was hung on the beam, and what is known of it.

    Attributes:
        name: As in the names of the recordings.
        weight: [N].
        comsol_sag: Sag that the beam's makers computed [m].
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
    """What the recordings say of one load, a value for each run.

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
        load: What hung on it.
        measured: What was recorded.
        sag: How far the marker sinks, with the settled modulus [m].
        frequency: How fast it swings, with the swinging modulus [Hz].
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
    """What the recordings of a load say.

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

    def __init__(self, folder: Path, cells: tuple[int, int, int] = CELLS):
        """Mesh it.

        Args:
            folder: Where the mesh is written.
            cells: Boxes along height, width and length.
        """
        self._folder, self._cells = folder, cells
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
            "material": {"young_modulus": young_modulus, "poisson_ratio": POISSON_RATIO,
                         "density": DENSITY},
            "fixed": [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}],
        }  # fmt: skip
        return scene_from_mapping({
            "name": "real_beam", "gravity": [-GRAVITY, 0.0, 0.0], "integration": integration,
            "body": body, "markers": [{"id": 0, "body": "beam", "point": MARKER_POINT}],
            "solver": {"newton_iterations": 10, "residual_tolerance": 1e-6}, **loaded,
        }, self._folder / "beam.yaml")  # fmt: skip

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
