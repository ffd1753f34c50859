"""Computes the samples of a run in processes of this machine, or on a Dask cluster.

Each sample is a job of its own, whose result does not depend on where, or after which other sample,
it is computed. A process that is lost takes only the sample with it that it had, which is tried
once more; so does a worker of a cluster.

The file contains, in this order: what a run that goes on must have in common with the one before
it, the workers, and the run with its progress.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections import Counter
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import closing
from functools import partial
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from softrobot_twin.errors import NamedError, one_line
from softrobot_twin.harness.figure import MissingExtraError
from softrobot_twin.harness.terminal import progress
from softrobot_twin.harness.worker_process import WorkerError, WorkerProcess
from softrobot_twin.scene import Scene
from softrobot_twin.scene.entry import values_below
from softrobot_twin.simulation.result import Status

LOST = "lost"
"""Status of a sample whose worker was lost or failed."""
NOT_AT_REST = (
    LOST, *(status.value for status in Status
            if status.is_failure or status in (Status.NOT_CONVERGED, Status.INVERTED)),
)  # fmt: skip
"""Statuses of samples that are no equilibrium."""

# A sample is given up when it has taken so many processes with it.
MOST_TRIES = 2
# A cluster that does not answer for this long is refused [s].
CONNECTION_TIMEOUT = 10.0


class SchedulerError(NamedError):
    """A Dask scheduler cannot be used."""


class RunError(NamedError):
    """A run cannot go on: what an earlier run left, or a worker's scene, is of another one."""


# --- what a run is of -----------------------------------------------------------------------------


def scene_fingerprint(scene: Scene) -> str:
    """Hash of a scene and of the content of all files that it names.

    Args:
        scene: The scene.
    """
    entries = "\n".join(f"{key}: {value!r}" for key, _, value in values_below(scene)
                        if not isinstance(value, Path) and key != "solver.threads")  # fmt: skip
    found = hashlib.sha256(entries.encode())
    for _, name, file in values_below(scene):
        if name == "file" and file is not None:
            found.update(scene.file_path(file).read_bytes())
    return found.hexdigest()


def check_fingerprint(scene: Scene, content: str) -> None:
    """Refuses a scene that is not that of a run.

    Args:
        scene: The scene.
        content: Its fingerprint when the run began.

    Raises:
        RunError: Its fingerprint is another one.
    """
    if scene_fingerprint(scene) != content:
        raise RunError(scene.path, "is not the scene of this run, or one of its files is not")


def check_run(path: Path, before: str, run: dict[str, object]) -> None:
    """Refuses what another run left.

    Args:
        path: What is there.
        before: What identifies the run that left it, as JSON.
        run: What identifies the present one, by name.

    Raises:
        RunError: It is of another run.
    """
    try:
        known = json.loads(before)
        if not isinstance(known, dict):
            raise ValueError
    except ValueError:
        raise RunError(path, "is no unfinished run of this command; remove it to begin anew") from None
    for name, value in json.loads(json.dumps(run)).items():  # JSON has no tuples
        if known.get(name) != value:
            raise RunError(
                path, f"is of a run with another {name}: {_short(known.get(name))}, not "
                f"{_short(value)}; remove it to begin anew, or take another --output",
            )  # fmt: skip


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 24 else f"{text[:12]}..."


# --- the workers ----------------------------------------------------------------------------------


class Job(NamedTuple):
    """What a worker needs to compute any sample of a run.

    Attributes:
        make: Makes the function that computes the row of a sample, or whatever else becomes of it,
            from its array; it is called once in each worker, with `scene` and `content`.
        scene: The scene file; on a cluster all workers must see it under this path.
        content: Fingerprint of the scene and its files, which `make` checks.
    """

    make: Callable[[Path, str], Callable[[np.ndarray], object]]
    scene: Path
    content: str


class SampleOutcome(NamedTuple):
    """What became of one sample.

    Attributes:
        index: The sample.
        row: Its row, or what else the job computes; None where it was lost.
        cause: Why it was lost; else empty.
    """

    index: int
    row: object | None
    cause: str = ""


class SampleWorkers(Protocol):
    """Something that computes samples."""

    def run(self, job: Job, samples: Sequence[tuple[int, np.ndarray]]) -> Iterator[SampleOutcome]:
        """Computes samples, and yields each when it is done, in any order.

        Args:
            job: What they share.
            samples: Index of each and its array, such as its setpoints.
        """


class LocalWorkers:
    """Processes of this machine, each with one thread; this process alone where it is one."""

    def __init__(self, count: int):
        """Take their number.

        Args:
            count: At least 1.
        """
        self._count = count

    def run(self, job: Job, samples: Sequence[tuple[int, np.ndarray]]) -> Iterator[SampleOutcome]:
        """See `SampleWorkers.run`.

        Raises:
            WorkerError: No process lives until it can compute.
        """
        count = min(self._count, len(samples))
        if count <= 1:
            compute = job.make(job.scene, job.content) if samples else None
            for index, setpoints in samples:
                yield SampleOutcome(index, compute(setpoints))
            return
        start = partial(WorkerProcess, job.make, job.scene, job.content)
        waiting, tries, lost, is_any_done = list(reversed(samples)), Counter[int](), 0, False
        idle, busy = [start() for _ in range(count)], dict[Any, tuple[WorkerProcess, tuple[int, np.ndarray]]]()
        try:
            while waiting or busy:
                while idle and waiting:
                    process, sample = idle.pop(), waiting.pop()
                    busy[process.pipe] = process.ask(sample[1]), sample
                for pipe in wait(list(busy)):
                    process, sample = busy.pop(pipe)
                    try:
                        outcome = SampleOutcome(sample[0], process.result())
                        is_any_done = True
                    except WorkerError as error:
                        process.close()
                        process, lost = start(), lost + 1
                        if not is_any_done and lost >= MOST_TRIES * count:
                            raise WorkerError(f"the processes of --workers compute nothing: {error}") from None
                        # As long as none computes anything, the sample is not the cause.
                        tries[sample[0]] += is_any_done
                        outcome = SampleOutcome(sample[0], None, str(error))
                    idle.append(process)
                    if outcome.row is None and tries[sample[0]] < MOST_TRIES:
                        waiting.append(sample)
                    else:
                        yield outcome
        finally:
            for process in [*idle, *(process for process, _ in busy.values())]:
                process.close()


class DaskWorkers:
    """Workers of a Dask cluster. The package must be installed there, and the scene readable."""

    def __init__(self, address: str):
        """Connect.

        Args:
            address: Address of its scheduler, such as ``tcp://10.0.0.1:8786``.

        Raises:
            MissingExtraError: dask.distributed is not installed.
            SchedulerError: The scheduler does not answer.
        """
        try:
            import distributed
        except ImportError as error:
            raise MissingExtraError("distributed", "--scheduler needs it") from error
        self._distributed, self.address = distributed, address
        self._client = self._connected()

    def _connected(self):
        try:
            return self._distributed.Client(self.address, timeout=CONNECTION_TIMEOUT)
        except (OSError, ValueError, TypeError) as error:
            # OSError is the base of the time-outs of sockets, too.
            raise SchedulerError(f"--scheduler {self.address}", f"cannot be reached: {error}") from error

    def run(self, job: Job, samples: Sequence[tuple[int, np.ndarray]]) -> Iterator[SampleOutcome]:
        """See `SampleWorkers.run`; each run has a connection of its own."""
        client, self._client = self._client or self._connected(), None
        futures = {
            client.submit(
                _compute_on_cluster, job, setpoints, pure=False, retries=MOST_TRIES - 1
            ): index
            for index, setpoints in samples
        }
        try:
            for future in self._distributed.as_completed(futures):
                index = futures[future]
                try:
                    # A worker that was lost with it since is replaced: this waits for it.
                    outcome = SampleOutcome(index, future.result())
                except Exception as error:  # whatever a job raises
                    outcome = SampleOutcome(index, None, one_line(error))
                yield outcome
                future.release()
        finally:
            client.cancel(list(futures))
            client.close()


_of_thread = threading.local()


def _compute_on_cluster(job: Job, setpoints: np.ndarray) -> object:
    """Computes one sample on a worker of a cluster, each of whose threads builds the scene once."""
    made = getattr(_of_thread, "made", None)
    if made is None or made[0] != job:
        made = _of_thread.made = job, job.make(job.scene, job.content)
    return made[1](setpoints)


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


# --- the run --------------------------------------------------------------------------------------


def workers_of(count: int | None, scheduler: str | None) -> SampleWorkers:
    """The workers that are asked for.

    Args:
        count: Processes on this machine; None for one on each core.
        scheduler: Address of the scheduler of a Dask cluster, in place of these.
    """
    return LocalWorkers(count or core_count()) if scheduler is None else DaskWorkers(scheduler)


def run_samples(
    title: str, crew: SampleWorkers, job: Job, samples: Sequence[np.ndarray], done: Container[int],
    keep: Callable[[SampleOutcome], Sequence[str]],
) -> None:  # fmt: skip
    """Computes the samples of a run that are not done, and shows the progress on standard error.

    Args:
        title: What is computed.
        crew: Computes them.
        job: What they share.
        samples: All samples; one with several rows counts as several.
        done: Indices of those that an earlier call left.
        keep: Keeps the outcome of a sample; gives its status, or that of each of its rows.
    """
    left = [(index, sample) for index, sample in enumerate(samples) if index not in done]
    total, open_count = (sum(len(np.atleast_2d(sample)) for sample in own)
                         for own in (samples, (sample for _, sample in left)))
    not_at_rest = 0
    # The workers end at once, whatever ends the loop.
    with (progress(title, total, total - open_count, tells_ends=True) as count,
          closing(crew.run(job, left)) as outcomes):  # fmt: skip
        for outcome in outcomes:
            statuses = keep(outcome)
            not_at_rest += sum(status in NOT_AT_REST for status in statuses)
            count(len(statuses), f"{not_at_rest} not at rest" if not_at_rest else "")
