"""What is asked of a training of a reduced model, and what is taken where nothing is asked.

The command line shows these defaults in its help. This file needs neither numpy nor the simulation,
so that a help text does not wait for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

ENERGY = 3.0e-6
"""Share of the energy of all displacements that the modes in use leave out."""
SPARE_MODES = 24
"""Modes beyond those in use, for the estimate of the error."""
VIBRATIONS = 12
"""Slowest vibrations at rest among the modes of a body that moves in time."""
TOLERANCE = 3.0e-3
"""Error of the virtual work that the sampled points leave, as a share."""
SNAPSHOTS, FIRST_SNAPSHOTS = 300, 120
"""States of a training without a wanted error, and those that one with it begins with."""
FRESH_STATES = 40
"""Fresh states that a training is judged at."""
TEST_STATES = 32
"""Fresh states that superelements are judged at."""
AROUND = 0.005
"""Greatest shift of a pass of a path of targets [m]."""


class TargetBox(NamedTuple):
    """Where the targets of an effector lie.

    Attributes:
        effector: Its name.
        low: Least coordinates [m].
        high: Greatest [m].
    """

    effector: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def widened(self, share: float) -> TargetBox:
        """The box, wider at each side by a share of its width.

        Args:
            share: Share of the width.
        """
        wider = [share * (high - low) for low, high in zip(self.low, self.high)]
        low = tuple(end - more for end, more in zip(self.low, wider))
        high = tuple(end + more for end, more in zip(self.high, wider))
        return TargetBox(self.effector, low, high)  # type: ignore[arg-type]  # three each


@dataclass(frozen=True)
class TrainingOptions:
    """What is asked of a training.

    Attributes:
        body: The body; None for the only one.
        output: File to write; None for one beside the mesh.
        snapshots: Number of states, that at rest included; None for the default.
        ranges: Bounds in place of the scene's; see `sampled_axes`.
        targets: Boxes of targets; none for the box of the actuators.
        along: File with a path of targets in place of both; the scene keeps its contact then.
        around: Greatest shift of a pass of this path along each axis [m].
        load: Greatest force at a point [N].
        load_points: Loaded points [m]; none for the effectors.
        spread_loads: Number of further loaded points, spread over the surface.
        tilt: Greatest tilt of gravity [rad].
        energy: Share of the energy that the modes in use leave out.
        modes: Number of modes in place of that; None for the energy.
        spare: Number of spare modes.
        vibrations: Slowest vibrations at rest among the modes in use; None for the default where the
            scene has inertia, else none.
        tolerance: Error of the virtual work that sampled points leave.
        error: Wanted error at fresh states, as a share of the effectors' displacement; None for a
            training of a given number of states.
        states: Fresh states that the result is judged at.
        seed: Seed of all samples.
        workers: Processes on this machine; None for one on each core.
        scheduler: Address of a Dask scheduler in place of these.
    """

    body: str | None = None
    output: Path | None = None
    snapshots: int | None = None
    ranges: tuple[str, ...] = ()
    targets: tuple[TargetBox, ...] = ()
    load: float = 0.0
    load_points: tuple[tuple[float, float, float], ...] = ()
    spread_loads: int = 0
    tilt: float = 0.0
    energy: float = ENERGY
    modes: int | None = None
    spare: int = SPARE_MODES
    tolerance: float = TOLERANCE
    error: float | None = None
    states: int = FRESH_STATES
    seed: int = 0
    workers: int | None = None
    scheduler: str | None = None
    along: Path | None = None
    around: float = AROUND
    vibrations: int | None = None
