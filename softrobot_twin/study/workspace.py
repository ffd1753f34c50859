"""``python -m softrobot_twin workspace``: where a robot gets by its actuators, and how stiff it is.

Sample 0 is the robot at rest. The others lie in the box of the actuators' bounds, on Sobol's
sequence shifted by a random vector of the seed (Cranley and Patterson 1976). Each is reached from
rest on a straight line of setpoints, so that it does not depend on any other sample, on the number
of workers, or on whether the run was interrupted.

The file contains, in this order: the row of a sample, the file of rows that a run leaves behind when it
is stopped, the picture, the command.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance
from softrobot_twin.harness.equilibrium import WAY, Rest, bring_to_rest
from softrobot_twin.harness.figure import figure_file, legend_below, load_pyplot
from softrobot_twin.harness.output_file import BROKEN_OFF, csv_output, writing
from softrobot_twin.harness.sample_workers import (
    LOST,
    NOT_AT_REST,
    Job,
    RunError,
    SampleOutcome,
    SampleWorkers,
    check_fingerprint,
    check_run,
    run_samples,
    scene_fingerprint,
    workers_of,
)
from softrobot_twin.harness.sampled_axes import WorkspaceError, sampled_axes, sampled_setpoints
from softrobot_twin.harness.terminal import console, print_apart, table, terminal_status, warn
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.simulation.result import Status
from softrobot_twin.tables.column_names import STATUS, position_columns
from softrobot_twin.tables.run_columns import (
    ACTIVE_LIMITS,
    actuator_cells,
    actuator_columns,
    magnitude_column,
    pair_names,
)


# --- the row of a sample -------------------------------------------------------------------------

_PARTS = ("xx", "xy", "xz", "yy", "yz", "zz")
_UPPER = np.triu_indices(3)
# Where the whole way did not lead to rest, one of so many times as many steps is tried.
FINER = 4


def _workspace_header(simulation: Simulation) -> list[str]:
    """Columns of the file: those of runs, and stiffness [N/m] and compliance [m/N] of effectors."""
    names, pairs = simulation.effector_names, pair_names(simulation)
    return [
        "sample",
        *(place for name in names for place in position_columns(name)),
        *(f"{name}_stiffness_{rank}_N_per_m" for name in names for rank in (1, 2, 3)),
        *(f"{name}_compliance_{part}_m_per_N" for name in names for part in _PARTS),
        *(column(*one) for one in actuator_columns(simulation.actuators)),
        *(["contact_count"] if pairs else []), *map(magnitude_column, pairs),
        "residual_N", ACTIVE_LIMITS, STATUS,
    ]  # fmt: skip


class SampleComputer:
    """Computes rows of samples by one simulation, which each sample begins at rest."""

    def __init__(self, scene: Path, content: str = ""):
        """Build the scene.

        Args:
            scene: Scene file.
            content: Its fingerprint, see `scene_fingerprint`; empty where it need not be checked.

        Raises:
            SoftRobotTwinError: The scene cannot be used, or is not that of the fingerprint.
        """
        self.simulation = Simulation.from_scene_file(scene)
        if content:
            check_fingerprint(self.simulation.scene, content)
        self._compliance = EffectorCompliance(self.simulation)

    def __call__(self, setpoints: np.ndarray) -> list:
        """The cells of a sample after its index.

        Args:
            setpoints: Each in the unit of its kind, shape (actuator_count,).
        """
        rest = self._rest(setpoints, WAY)
        if not rest.is_reached:
            rest = self._rest(setpoints, FINER * WAY)
        result, simulation = rest.result, self.simulation
        found = self._compliance.after_step()
        symmetric = 0.5 * (found.compliance + found.compliance.transpose(0, 2, 1))
        contacts, pairs = [], pair_names(simulation)
        if pairs:
            sums = np.zeros(len(pairs))
            if result.contacts is not None:
                sums = result.contacts.of_pairs().magnitude_sums
            contacts = [result.report.contact_count, *sums]
        cells = [
            *result.effector_positions.ravel(),
            *(stiffness for index in range(len(found.compliance))
              for stiffness in found.principal_stiffness(index)[0]),
            *symmetric[:, _UPPER[0], _UPPER[1]].ravel(),
            *actuator_cells(result, simulation.actuators), *contacts, result.report.residual,
            " ".join(result.report.active_limits), rest.status,
        ]  # fmt: skip
        return [cell.item() if isinstance(cell, np.generic) else cell for cell in cells]

    def _rest(self, setpoints: np.ndarray, way: int) -> Rest:
        self.simulation.reset()
        return bring_to_rest(self.simulation, setpoints, way)


# --- rows that a stopped run leaves behind -------------------------------------------------------


class UnfinishedFile:
    """Rows of a run in the order in which they were done, beside the file that it will write.

    The first line tells of which run they are. A row is on disk before the next one is taken.

    Attributes:
        path: The file.
        header: Columns.
        rows: Cells of the samples that are done, by their index, as text.
    """

    def __init__(self, output: Path, run: dict[str, object], header: Sequence[str]):
        """Read the rows that an earlier call of the same run left, and go on behind them.

        Args:
            output: File that the run will write.
            run: What identifies it, by name.
            header: Columns.

        Raises:
            RunError: The rows are of another run, or damaged.
            OutputError: The file cannot be read or written.
        """
        self.path = output.with_name(output.name + BROKEN_OFF)
        self._run, self.header = run, list(header)
        self.rows: dict[int, list[str]] = {}
        with writing(self.path, UnicodeDecodeError):
            size = self._read() if self.path.is_file() else 0
            output.parent.mkdir(parents=True, exist_ok=True)
            self._stream: TextIO = open(self.path, "a", encoding="utf-8", newline="")
            self._stream.truncate(size)
            if not size:
                self._stream.write(f"# {json.dumps(run)}\n")
                self._write(self.header)

    def _read(self) -> int:
        """Take in the rows; gives the bytes of all whole lines."""
        lines = self.path.read_bytes().split(b"\n")
        # What follows the last line feed was being written when the run was stopped.
        whole = [line.decode() for line in lines[:-1]]
        if len(whole) < 2:
            return 0
        check_run(self.path, whole[0].removeprefix("# "), self._run)
        for row in csv.reader(whole[2:]):
            if len(row) != len(self.header):
                raise RunError(
                    self.path, f"a row has {len(row)} cells, not {len(self.header)}: the file is "
                    "damaged; remove it to begin anew")  # fmt: skip
            self.rows[int(row[0])] = row
        return sum(len(line) + 1 for line in lines[:-1])

    def add(self, index: int, cells: Sequence) -> None:
        """Write a row.

        Args:
            index: Number of the sample.
            cells: The other cells of its row.
        """
        row = [str(index), *(repr(cell) if isinstance(cell, float) else str(cell)
                             for cell in cells)]  # fmt: skip
        self.rows[index] = row
        with writing(self.path):
            self._write(row)

    def _write(self, row: Sequence[str]) -> None:
        csv.writer(self._stream, lineterminator="\n").writerow(row)
        self._stream.flush()

    def close(self) -> None:
        """Stop writing; the file stays."""
        self._stream.close()

    def finish(self, output: Path) -> None:
        """Write the rows in their order to the file of the run, and remove this one.

        Args:
            output: The file of the run.
        """
        self.close()
        with csv_output(output, self.header) as write:
            for index in sorted(self.rows):
                write(self.rows[index])
        self.path.unlink(missing_ok=True)


# --- the picture ---------------------------------------------------------------------------------


class Cloud(NamedTuple):
    """What is drawn of one effector.

    Attributes:
        name: The effector.
        points: Its places [m], shape (count, 3).
        stiffness: Its least principal stiffness there [N/m], shape (count,).
        is_good: Whether the sample came to rest with success, shape (count,).
        rest: Its place at rest [m], shape (3,).
    """

    name: str
    points: np.ndarray
    stiffness: np.ndarray
    is_good: np.ndarray
    rest: np.ndarray


def clouds(names: Sequence[str], header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[Cloud]:
    """The places of each effector, from rows of the file; lost samples are left out.

    Args:
        names: Names of the effectors.
        header: Titles of the columns.
        rows: Cells of each row.
    """
    kept = [row for row in rows if row[-1] != LOST]
    status = np.array([row[-1] for row in kept])
    made = []
    for name in names:
        columns = [header.index(place) for place in position_columns(name)]
        columns.append(header.index(f"{name}_stiffness_1_N_per_m"))
        values = np.array([[float(row[column]) for column in columns] for row in kept])
        at_rest = values[[int(row[0]) == 0 for row in kept], :3]
        rest = at_rest[0] if len(at_rest) else np.full(3, np.nan)
        is_good = np.isin(status, [Status.OK.value, Status.LINEARIZED.value, Status.SATURATED.value])
        made.append(Cloud(name, values[:, :3], values[:, 3], is_good, rest))
    return made


def views_of(points: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]]:
    """The two coordinate planes on which points cover the most: axes to the right and up.

    Args:
        points: The points [m], shape (count, 3).
    """
    planes = ((0, 2), (1, 2), (0, 1))
    spread = np.ptp(points, axis=0) if len(points) else np.zeros(3)
    order = sorted(planes, key=lambda plane: -spread[plane[0]] * spread[plane[1]])
    first, second = sorted(order[:2], key=planes.index)
    return first, second


# From this ratio of the greatest to the least stiffness on, colours follow its logarithm.
WIDE_RANGE = 10.0


def draw_workspace(shown: Sequence[Cloud], outline: np.ndarray, path: Path, title: str, foot: str) -> None:
    """Writes a picture: two views of each effector's places, coloured by its least stiffness.

    Args:
        shown: The effectors.
        outline: Points of the robot's surface at rest [m], shape (count, 3).
        path: Picture to write.
        title: Title.
        foot: Small text below.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    from matplotlib.colors import LogNorm
    with figure_file(path, (11.0, 5.5 * len(shown)), title, foot) as figure:
        axes = figure.subplots(len(shown), 2, squeeze=False)
        for row, cloud in zip(axes, shown, strict=True):
            good = cloud.is_good & np.isfinite(cloud.stiffness) & (cloud.stiffness > 0.0)
            stiffness = cloud.stiffness[good]
            norm = None
            if len(stiffness) and stiffness.max() > WIDE_RANGE * stiffness.min():
                norm = LogNorm(stiffness.min(), stiffness.max())
            drawn = None
            for plot, (right, up) in zip(row, views_of(cloud.points), strict=True):
                plot.scatter(1e3 * outline[:, right], 1e3 * outline[:, up], s=3, c="#bbbbbb",
                             linewidths=0, label="robot at rest")
                # The softest are drawn last, on top: they tell where care is needed.
                order = np.argsort(-stiffness)
                places = 1e3 * cloud.points[good][order]
                drawn = plot.scatter(places[:, right], places[:, up], c=stiffness[order], s=14,
                                     norm=norm, cmap="viridis", linewidths=0)
                others = 1e3 * cloud.points[~good]
                if len(others):
                    plot.scatter(others[:, right], others[:, up], s=18, c="#d62728", marker="x",
                                 linewidths=0.8, label="not at rest, or unstable")
                plot.plot(*(1e3 * cloud.rest[[right, up]]), "k+", ms=10, mew=1.5,
                          label=f"{cloud.name} at rest")
                plot.set_xlabel(f"{'xyz'[right]} [mm]")
                plot.set_ylabel(f"{'xyz'[up]} [mm]")
                plot.set_title(f"{cloud.name}, seen along {'xyz'[3 - right - up]}")
                plot.set_aspect("equal", adjustable="datalim")
            legend_below(row[0], 4.5, markerscale=1.5)
            bar = figure.colorbar(drawn, ax=list(row), shrink=0.9, pad=0.02)
            bar.set_label("stiffness in the softest direction [N/m]")


# --- the command ---------------------------------------------------------------------------------

def workspace(
    scene: Path, output: Path, picture: Path | None = None, samples: int = 200, seed: int = 0,
    ranges: Sequence[str] = (), workers: int | None = None, scheduler: str | None = None,
) -> int:  # fmt: skip
    """Samples the workspace of a scene.

    Args:
        scene: Scene file.
        output: File to write, a row for each sample.
        picture: Picture to draw, or None.
        samples: Number of samples, that at rest included.
        seed: Seed of their places.
        ranges: Bounds in place of the scene's; see `sampled_axes`.
        workers: Processes on this machine; None for one on each core.
        scheduler: Address of the scheduler of a Dask cluster, in place of these.

    Returns:
        Exit code: 1 where samples did not come to rest or were lost.

    Raises:
        SoftRobotTwinError: The scene, an option or a file cannot be used.
    """
    if picture is not None:
        load_pyplot()  # An error is raised before the run, not after it.
    with terminal_status("building the scene"):
        simulation = Simulation.from_scene_file(scene)
    if not simulation.effector_names:
        raise WorkspaceError(scene, "there are no effectors, whose places could be told")
    axes = sampled_axes(simulation, ranges)
    setpoints = sampled_setpoints(simulation, axes, samples, seed)
    content = scene_fingerprint(simulation.scene)
    header = _workspace_header(simulation)
    run = {"scene": content, "seed": seed, "number of samples": samples,
           "range": [[axis.name, axis.least, axis.most] for axis in axes],
           "columns": hashlib.sha256(",".join(header).encode()).hexdigest()}  # fmt: skip
    # Before anything is computed: an unfinished run of something else is refused.
    unfinished = UnfinishedFile(output, run, header)
    try:
        crew = workers_of(workers, scheduler)
        job = Job(SampleComputer, scene.resolve(), content)
        causes = _compute(simulation.scene.name, crew, job, setpoints, unfinished)
    except KeyboardInterrupt:
        print(f"{len(unfinished.rows)} of {samples} samples are in {unfinished.path}; the same "
              "command goes on from there", file=sys.stderr)
        raise
    finally:
        unfinished.close()
    rows = [unfinished.rows[index] for index in sorted(unfinished.rows)]
    unfinished.finish(output)
    for index, cause in causes:
        warn(f"sample {index} is lost: {cause}")
    shown = clouds(simulation.effector_names, header, rows)
    if picture is not None:
        simulation.reset()
        outline = np.concatenate([np.empty((0, 3)), *simulation.skin_positions(),
                                  simulation.surface_positions()])  # fmt: skip
        foot = f"{samples} samples, seed {seed}, {scene}"
        draw_workspace(shown, outline, picture, f"Workspace of {simulation.scene.name}", foot)
    _print_summary(shown, [row[-1] for row in rows])
    return 1 if any(row[-1] in NOT_AT_REST for row in rows) else 0


def _compute(
    title: str, crew: SampleWorkers, job: Job, setpoints: np.ndarray, unfinished: UnfinishedFile
) -> list[tuple[int, str]]:
    """Computes the samples that are not done yet; gives those that were lost, with the cause."""
    causes: list[tuple[int, str]] = []

    def keep(outcome: SampleOutcome) -> list[str]:
        row = outcome.row
        if row is None:
            causes.append((outcome.index, outcome.cause))
            row = [math.nan] * (len(unfinished.header) - 3) + ["", LOST]
        unfinished.add(outcome.index, row)
        return row[-1:]

    run_samples(title, crew, job, setpoints, unfinished.rows, keep)
    return causes


def _print_summary(shown: Sequence[Cloud], statuses: Sequence[str]) -> None:
    rows = []
    for cloud in shown:
        good = cloud.is_good
        if not good.any():
            rows.append([cloud.name, *["nowhere"] * 3, ""])
            continue
        low, high = 1e3 * cloud.points[good].min(axis=0), 1e3 * cloud.points[good].max(axis=0)
        stiffness = cloud.stiffness[good & np.isfinite(cloud.stiffness)]
        softest = f"{stiffness.min():.4g} to {stiffness.max():.4g}" if len(stiffness) else ""
        rows.append([cloud.name, *(f"{a:.2f} to {b:.2f}" for a, b in zip(low, high)), softest])
    print_apart(table("Reached places", "effector", "x [mm]", "y [mm]", "z [mm]",
                      "stiffness in the softest direction [N/m]", rows=rows))
    counts = ", ".join(f"{number} {status}" for status, number in sorted(Counter(statuses).items()))
    console().print(f"{len(statuses)} samples: {counts}")
