"""One size measured: a robot follows a circle or holds, one thread, no garbage collection."""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter, thread_time

import numpy as np

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.study.bench.bench_cases import BenchCase
from softrobot_twin.study.bench.circle_tour import CircleTour
from softrobot_twin.study.bench.dense_speed import DenseSpeed
from softrobot_twin.study.bench.flop_count import FlopCount, flop_count
from softrobot_twin.study.bench.held_commands import HeldCommands
from softrobot_twin.study.bench.process_memory import resident_bytes
from softrobot_twin.study.bench.superlu_yardstick import SuperLUYardstick
from softrobot_twin.study.bench.target_stretch import TargetStretch
from softrobot_twin.study.offline.run_summary import Spread, spread

WHOLE_STEP = "whole step"
OUTSIDE = "outside the stages"
"""What a caller waits for besides the stages: commands checked, states and reports made."""
# SuperLU takes much longer than a step: it is asked now and then, between steps that are timed.
_YARDSTICK_SAMPLES = 20
_YARDSTICK_SECONDS = 20.0
_FEWEST_SAMPLES = 3
INTERRUPTION = 1.0e-4
"""A step that waited longer than this for the processor was interrupted [s]."""
# Stages that factorize and solve, to be compared with the speed of dense products.
_ALGEBRA = ("factor", "condense", "correct")


@dataclass(frozen=True)
class SizeMeasurement:
    """What one size took.

    Attributes:
        case: What was measured.
        factorization: Name of the factorization.
        node_count: Nodes of the mesh.
        tet_count: Its tetrahedra.
        dof_count: Unknowns.
        row_count: Rows of H, median.
        contact_count: Contacts that carry force, median.
        stages: Time of each stage [s], of what is outside them, and of the whole step.
        step_count: Steps timed.
        superlu: Time of one SuperLU factorization of the same matrices [s].
        superlu_count: How many were timed.
        superlu_page_faults: Page faults in one of them, median; see `YardstickTime`.
        interrupted_share: Share of steps during which the processor was taken away.
        flops: Operations of factor and solves; None where they cannot be counted.
        dense_speed: Speed of a dense product in the same run [flop/s].
        factor_bytes: Buffers of the factor; None where they are not ours.
        resident: Memory of the process before SuperLU came [B].
        statuses: How the timed steps ended.
        qp_solvers: Which solver answered.
    """

    case: BenchCase
    factorization: str
    node_count: int
    tet_count: int
    dof_count: int
    row_count: float
    contact_count: float
    stages: dict[str, Spread]
    step_count: int
    superlu: Spread
    superlu_count: int
    superlu_page_faults: float
    interrupted_share: float
    flops: FlopCount | None
    dense_speed: float
    factor_bytes: int | None
    resident: int | None
    statuses: Counter[str]
    qp_solvers: Counter[str]

    @property
    def ratio(self) -> float:
        """The whole step in SuperLU factorizations, medians."""
        return self.stages[WHOLE_STEP].median / self.superlu.median

    @property
    def tail(self) -> float:
        """99th percentile of the whole step over its median."""
        return self.stages[WHOLE_STEP].p99 / self.stages[WHOLE_STEP].median

    @property
    def limit(self) -> float:
        """Time of factor and solves if every operation ran at the speed of a dense product [s]."""
        return float("nan") if self.flops is None else self.flops.total / self.dense_speed

    @property
    def share_of_dense_speed(self) -> float:
        """How much of that speed factor and solves reach."""
        return self.limit / sum(self.stages[stage].median for stage in _ALGEBRA)


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Collects now and not again until the end."""
    was_on = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def measure(case: BenchCase, steps: int) -> SizeMeasurement:
    """Builds a case and times its steps.

    Args:
        case: What to measure.
        steps: Steps to time.

    Raises:
        SoftRobotTwinError: The scene cannot be built, or has nothing to follow.
    """
    simulation = Simulation(case.scene)
    simulation.warm_up()
    tour = _tour(simulation, case)
    resident = resident_bytes()
    model = simulation.model
    with without_garbage_collection():
        record = _follow(simulation, tour, steps)
    factorization = model.factorization
    return SizeMeasurement(
        case, factorization.name, simulation.node_count, simulation.tet_count,
        simulation.dof_count, float(np.median(record.row_counts)),
        float(np.median(record.contact_counts)), record.stages(simulation.stages), steps,
        spread(record.superlu),
        len(record.superlu), float(np.median(record.page_faults)),
        record.interrupted / steps,
        flop_count(factorization, model.rows.node_index, model.rows.row_count),
        float(np.median(record.dense)), _factor_bytes(factorization), resident,
        record.statuses, record.qp_solvers)


def _tour(simulation: Simulation, case: BenchCase):
    """What the case does while it is timed."""
    if case.stretch is not None:
        return TargetStretch(simulation, case.stretch)
    if case.commands is not None:
        return HeldCommands(simulation, case.commands)
    return CircleTour(simulation)


class _Record:
    """Times as they come."""

    def __init__(self) -> None:
        self.steps: list[float] = []
        self.reports: list[dict[str, float]] = []
        self.superlu: list[float] = []
        self.page_faults: list[int] = []
        self.interrupted = 0
        self.row_counts: list[int] = []
        self.contact_counts: list[int] = []
        self.dense: list[float] = []
        self.statuses: Counter[str] = Counter()
        self.qp_solvers: Counter[str] = Counter()

    def add(self, time: float, worked: float, result: StepResult, row_count: int) -> None:
        self.steps.append(time)
        self.interrupted += time - worked > INTERRUPTION
        self.reports.append(result.report.stage_times)
        self.row_counts.append(row_count)
        self.contact_counts.append(result.report.contact_count)
        self.statuses[result.status.value] += 1
        self.qp_solvers[result.report.qp_solver] += 1

    def stages(self, names: tuple[str, ...]) -> dict[str, Spread]:
        whole = np.array(self.steps)
        booked = np.array([[report.get(name, 0.0) for name in names] for report in self.reports])
        spreads = {name: spread(booked[:, index]) for index, name in enumerate(names)}
        return {**spreads, OUTSIDE: spread(whole - booked.sum(axis=1)), WHOLE_STEP: spread(whole)}


def _follow(simulation: Simulation, tour, steps: int) -> _Record:
    """Times steps, and between them SuperLU and dense products."""
    yardstick, dense = SuperLUYardstick(simulation.model.factorization), DenseSpeed()
    record = _Record()
    dense.measure()
    first = yardstick.factorize()
    samples = int(np.clip(_YARDSTICK_SECONDS / first.time, _FEWEST_SAMPLES, _YARDSTICK_SAMPLES))
    interval = max(1, steps // samples)
    for number in range(steps):
        if number % interval == 0:
            timed = yardstick.factorize()
            record.superlu.append(timed.time)
            record.page_faults.append(timed.page_faults)
            record.dense.append(dense.measure())
            # They leave caches cold, which is theirs and not a step's.
            simulation.step(tour.next())
        command, worked = tour.next(), thread_time()
        start = perf_counter()
        result = simulation.step(command)
        time = perf_counter() - start
        record.add(time, thread_time() - worked, result, simulation.model.rows.row_count)
    return record


def _factor_bytes(factorization) -> int | None:
    """Panels, updates, triangles and the assembled blocks."""
    if not isinstance(factorization, Multifrontal):
        return None
    layout = factorization.layout
    doubles = (layout.panels_size + layout.updates_size + layout.triangles_size
               + factorization.storage.size)
    return 8 * int(doubles)
