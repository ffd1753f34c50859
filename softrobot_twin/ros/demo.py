"""A demo: twin, device and target as three processes, driven open loop and then closed loop.

This process starts them, listens, flips one parameter half-way, and ends them. It computes
nothing of theirs: all that it knows of them came over DDS.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import rclpy
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.ros.demo_plan import START_TOPIC, DemoPlan, isolate
from softrobot_twin.ros.demo_processes import DemoProcess, Place, places, stop_all
from softrobot_twin.ros.demo_recorder import DemoRecorder
from softrobot_twin.ros.processor_share import ProcessorTimes, processor_times, share_of_others

_START_PATIENCE = 180.0
"""Longest time from the start of a process to its first message; compiling takes a while [s]."""
_PATIENCE = 60.0
"""Longest wait for an answer of a process that runs [s]."""
_WATCH_PERIOD = 0.1
"""Time between two looks at the processes and the status line [s]."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

RUNS = ("open_loop", "closed_loop")


class _Stopped(Exception):
    """The demo was told to end."""


class DemoError(SoftRobotTwinError):
    """A process of the demo does not do what it was asked to.

    Attributes:
        name: Which one.
        reason: What is lacking.
    """

    def __init__(self, name: str, reason: str):
        self.name = name
        self.reason = reason
        super().__init__(f"{name}: {reason}")


class DemoStatus(NamedTuple):
    """What the live line shows.

    Attributes:
        elapsed: Time since the demo began [s].
        phase: What is being done.
        error: Distance of the device from the target [m]; NaN when not known.
        compute_time: Median time of the twin's last steps [s]; NaN when not known.
        missed_ticks: Ticks missed so far.
        cause: Why the error is large; empty when it is not.
    """

    elapsed: float
    phase: str
    error: float
    compute_time: float
    missed_ticks: int
    cause: str


@dataclass
class DemoOutcome:
    """How a demo went.

    Attributes:
        recorder: All that was heard.
        starts: When each run began [s], by name; a run that did not begin is not there.
        end: When the last run ended [s].
        accounts_before: Accounts of the loop that came before the first run.
        was_stopped: True when Ctrl-C ended it.
        exit_codes: How the processes ended, by name.
        others: Share of the processor that other programs took during the runs, 0 to 1; None
            when nobody can tell.
    """

    recorder: DemoRecorder
    starts: dict[str, float]
    end: float
    accounts_before: int
    was_stopped: bool
    exit_codes: dict[str, int | None]
    others: float | None = None

    def span(self, run: str) -> tuple[float, float]:
        """Start and end of a run [s]."""
        later = [start for start in self.starts.values() if start > self.starts[run]]
        return self.starts[run], min(later, default=self.end)


class Demo:
    """Runs a plan once.

    Args:
        plan: What to run.
        tell: Takes the status, some ten times a second.
    """

    def __init__(self, plan: DemoPlan, tell: Callable[[DemoStatus], None]):
        self._plan, self._tell = plan, tell
        self._cores = os.sched_getaffinity(0)
        self._processes: list[DemoProcess] = []
        self._starts: dict[str, float] = {}
        self._end = -math.inf
        self._accounts_before = 0
        self._times_before: ProcessorTimes | None = None
        self._began = self._looked = time.monotonic()
        self._phase = ""
        self._must_stop = False

    def run(self) -> DemoOutcome:
        """Runs it; always ends every process that it started.

        Raises:
            ProcessDiedError: A process ended by itself.
            DemoError: A process did not answer.
        """
        isolate(os.environ)
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._recorder = DemoRecorder("/twin", "/device", self._plan.effector, START_TOPIC)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._recorder)
        was_stopped = False
        # Set even for SIGINT: a shell starts a background job with it ignored.
        previous = {number: signal.signal(number, self._remember_to_stop) for number in _SIGNALS}
        try:
            self._drive()
        except _Stopped:
            was_stopped = True
        finally:
            # A second Ctrl-C is remembered too and leaves no process behind; each wait has its end.
            others = self._share_of_others()
            exit_codes = stop_all(self._processes)
            self._recorder.destroy_node()
            rclpy.try_shutdown()
            for number, handler in previous.items():
                signal.signal(number, handler)
        end = min(self._end, self._last_target())
        return DemoOutcome(self._recorder, self._starts, end, self._accounts_before, was_stopped,
                           exit_codes, others)

    def _remember_to_stop(self, number: int, frame: object) -> None:
        """Takes a signal; raised here, it could strike inside rclpy, which makes another of it."""
        self._must_stop = True

    def _drive(self) -> None:
        """From the start of the processes to the end of the last run."""
        heard = self._recorder
        self._phase = "starting"
        of_twin, of_rest = places(self._cores)
        for node in ("twin", "device", "target"):
            self._start(node, of_twin if node == "twin" else of_rest)
        # Only now: what this process starts begins where it is.
        of_rest.give(0)
        self._until(lambda: heard.twin_effector.times and heard.device_effector.times,
                    _START_PATIENCE, "twin", "it and the device do not publish their effectors")
        self._until(heard.target_is_found, _START_PATIENCE, "target", "it does not appear")
        self._phase = "enabling"
        self._enable()
        self._until(lambda: heard.lengths.times, _PATIENCE, "twin", "it commands no cables")
        heard.start_target()
        self._until(lambda: heard.target.times, _PATIENCE, "target", "it publishes nothing")
        self._accounts_before = len(heard.accounts)
        self._times_before = self._processor_times()
        start = heard.target.times[0]
        for number, run in enumerate(RUNS):
            self._phase = run.replace("_", " ")
            if run == "closed_loop":
                self._close_loop()
            self._starts[run] = start + number * self._plan.run_time
            self._end = start + (number + 1) * self._plan.run_time
            self._until(lambda: self._last_target() >= self._end,
                        self._plan.run_time + _PATIENCE, "target", "it stopped publishing")
        self._phase = "ending"

    def _start(self, node: str, place: Place) -> None:
        log = self._plan.folder / f"{node}.log"
        self._processes.append(DemoProcess(node, self._plan.command(node), log, place))

    def _processor_times(self) -> ProcessorTimes | None:
        try:
            return processor_times((process.session for process in self._processes), self._cores)
        except OSError:
            return None

    def _share_of_others(self) -> float | None:
        """What other programs took of the processor since the runs began."""
        before, after = self._times_before, self._processor_times()
        return None if before is None or after is None else share_of_others(before, after)

    def _last_target(self) -> float:
        times = self._recorder.target.times
        return times[-1] if times else -math.inf

    def _enable(self) -> None:
        """Asks until the twin has heard the device and agrees."""
        client = self._recorder.create_client(SetBool, "/twin/enable")
        deadline = time.monotonic() + _PATIENCE
        while True:
            answer = self._ask(client, SetBool.Request(data=True), "/twin/enable")
            if answer.success:
                return
            if time.monotonic() > deadline:
                raise DemoError("twin", f"cannot be enabled: {answer.message}")
            self._until(_after(0.2), _PATIENCE, "twin", "")

    def _close_loop(self) -> None:
        name = "/twin/set_parameters"
        client = self._recorder.create_client(SetParameters, name)
        value = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
        request = SetParameters.Request(parameters=[Parameter(name="closed_loop", value=value)])
        (result,) = self._ask(client, request, name).results
        if not result.successful:
            raise DemoError("twin", f"the loop cannot be closed: {result.reason}")

    def _ask(self, client, request, name: str):
        """Answer of a service."""
        self._until(client.service_is_ready, _PATIENCE, "twin", f"offers no service {name}")
        future = client.call_async(request)
        self._until(future.done, _PATIENCE, "twin", f"does not answer on {name}")
        return future.result()

    def _until(self, is_done: Callable[[], object], patience: float, name: str,
               reason: str) -> None:
        """Listens until something is so; watches over the processes meanwhile.

        Raises:
            ProcessDiedError: A process ended.
            DemoError: It took too long.
            _Stopped: A signal came.
        """
        deadline = time.monotonic() + patience
        while not is_done():
            if self._must_stop:
                raise _Stopped
            self._executor.spin_once(timeout_sec=0.02)
            now = time.monotonic()
            if now - self._looked < _WATCH_PERIOD:
                continue
            self._looked = now
            for process in self._processes:
                process.refuse_death()
            self._tell(self._status(now))
            if now > deadline:
                raise DemoError(name, f"{reason}, waited {patience:g} s; see {name}.log in "
                                f"{self._plan.folder}")

    def _status(self, now: float) -> DemoStatus:
        accounts = self._recorder.accounts
        before = accounts[self._accounts_before - 1].missed if self._accounts_before else 0
        return DemoStatus(
            now - self._began, self._phase, self._recorder.error(),
            accounts[-1].compute_p50 if accounts else math.nan,
            accounts[-1].missed - before if accounts else 0,
            self._recorder.cause)


def _after(seconds: float) -> Callable[[], bool]:
    due = time.monotonic() + seconds
    return lambda: time.monotonic() >= due
