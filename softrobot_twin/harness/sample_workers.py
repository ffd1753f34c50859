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
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import closing, suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from softrobot_twin.errors import NamedError, SoftRobotTwinError, one_line
from softrobot_twin.harness.figure import MissingExtraError
from softrobot_twin.harness.terminal import progress
from softrobot_twin.kernels.worker_threads import use_one_thread
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


class WorkerError(SoftRobotTwinError):
    """Processes of this machine end before they compute anything."""


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
        with closing(_Pool(job, count)) as pool:
            yield from pool.run(samples)


class _Process:
    """A process, its pipe, and the sample that it has."""

    def __init__(self, job: Job):
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, job), daemon=True)
        self.process.start()
        other.close()
        self.sample: tuple[int, np.ndarray] | None = None
        self.is_ready = False

    def give(self, sample: tuple[int, np.ndarray]) -> None:
        """Send a sample."""
        self.sample = sample
        with suppress(OSError):  # It has ended, which is noticed at its pipe.
            self.pipe.send(sample)


def _serve(pipe: Connection, job: Job) -> None:
    """Computes the samples that come through a pipe, until it is closed."""
    # Ctrl-C reaches the parent too, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_one_thread()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        compute = job.make(job.scene, job.content)
        pipe.send(None)
        while True:
            index, setpoints = pipe.recv()
            pipe.send((index, compute(setpoints)))


class _Pool:
    """Gives samples to processes, and replaces those that are lost."""

    def __init__(self, job: Job, count: int):
        self._job = job
        self._processes = [_Process(job) for _ in range(count)]
        self._was_ready, self._lost = False, 0

    def run(self, samples: Sequence[tuple[int, np.ndarray]]) -> Iterator[SampleOutcome]:
        """See `LocalWorkers.run`."""
        waiting, tries, left = list(reversed(samples)), {}, len(samples)
        while left:
            by_pipe = {process.pipe: process for process in self._processes}
            for process in [by_pipe[pipe] for pipe in wait(list(by_pipe))]:
                outcome = None
                try:
                    answer = process.pipe.recv()
                except (EOFError, OSError):
                    outcome = self._replace(process, waiting, tries)
                else:
                    process.is_ready = self._was_ready = True
                    if answer is not None:
                        process.sample, outcome = None, SampleOutcome(*answer)
                if outcome is not None:
                    left -= 1
                    yield outcome
            for process in self._processes:
                if process.is_ready and process.sample is None and waiting:
                    process.give(waiting.pop())

    def _replace(self, process: _Process, waiting: list, tries: dict) -> SampleOutcome | None:
        """Start another process; tells the sample that is given up."""
        process.process.join()
        code, sample = process.process.exitcode, process.sample
        self._lost += 1
        if not self._was_ready and self._lost >= MOST_TRIES * len(self._processes):
            raise WorkerError(
                f"the processes of --workers end before they compute anything, with code {code}"
            )
        place = self._processes.index(process)
        process.pipe.close()
        self._processes[place] = _Process(self._job)
        if sample is None:
            return None
        tries[sample[0]] = tries.get(sample[0], 0) + 1
        if tries[sample[0]] < MOST_TRIES:
            waiting.append(sample)
            return None
        return SampleOutcome(sample[0], None, f"its process ended with code {code}")

    def close(self) -> None:
        """End all processes."""
        for process in self._processes:
            process.process.terminate()
        for process in self._processes:
            process.process.join()
            process.pipe.close()


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
