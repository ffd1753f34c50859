"""Calibration of a running twin by the poses at which its robot rested.

The tick gathers the poses. A process of the lowest priority runs the command `calibrate`, which writes
a proposal: the twin stays as it is. `LiveCalibration` runs in the twin, `serve` in the other process.
"""

from __future__ import annotations

import io
import os
import runpy
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from softrobot_twin.control.idle_process import STATE, IdleWatch, Replies, Requests, framed

# Before it is asked the other process needs none of these.
if TYPE_CHECKING:
    from softrobot_twin.control.rest_watch import RestWatch, Sample
    from softrobot_twin.simulation import Simulation

PERIOD = 0.05
"""Time between two samples of what is measured [s]."""
LEAST_POSES = 3
"""As many as `calibrate` needs."""
WIDTH = "160"
"""Columns of the tables that are printed."""


class LiveCalibration(IdleWatch):
    """Gathers poses at rest, and asks for fits.

    Attributes:
        watch: Finds the poses.
        proposal: File of the scene that is proposed.
        rests: File of the poses.
        code: Exit code of the last fit: 0 where there is a proposal; None while none has ended.
        told: What the last fit printed.
    """

    def __init__(self, simulation: Simulation, watch: RestWatch, fit: Sequence[str], changes: Sequence[str]):
        """Starts the process, which waits.

        Args:
            simulation: That of the twin.
            watch: Finds the poses.
            fit: Keys of the numbers; empty for the choice of `calibrate`.
            changes: Other values of the scene's entries, as ``--set`` takes them.
        """
        path = simulation.scene.path
        self.watch, self._simulation, self._due = watch, simulation, 0.0
        self.proposal, self.rests = (path.with_name(f"{path.stem}_{end}")
                                     for end in ("calibrated.yaml", "rests.csv"))
        options = (("--fit", fit), ("--output", [str(self.proposal)]), ("--set", changes))
        self._words = ["calibrate", str(path), "--data", str(self.rests)] + [
            word for option, values in options if values for word in (option, *values)]  # fmt: skip
        self.code: int | None = None
        self.told, self._asked_at = "", 0.0
        super().__init__(simulation)
        self._waiting = False

    def first_message(self, simulation: Simulation) -> object:
        """Nothing: what is needed comes with the request; see `IdleWatch`.

        Args:
            simulation: That of the twin.
        """
        return None

    def offer_sample(self, now: float, sample: Callable[[], Sample]) -> None:
        """Takes a sample where one is due.

        Args:
            now: Time on a monotonic clock [s].
            sample: Makes it.
        """
        if now >= self._due:
            self._due = now + PERIOD
            self.watch.add(sample())

    def ask(self, now: float) -> tuple[bool, str]:
        """Asks for a fit.

        Args:
            now: See `offer_sample`.

        Returns:
            Whether it was begun, and what is to be said.
        """
        if self.cause:
            return False, f"the process that fits has ended: {self.cause}"
        if self._waiting:
            return False, f"a fit is under way for {now - self._asked_at:.0f} s already"
        self.watch.end()
        count, words = len(self.watch.found), self.watch.in_words()
        if count < LEAST_POSES:
            return False, (f"{words}; {LEAST_POSES} are needed: let the robot rest for more than a second at "
                           "other targets, where the cameras see its markers")  # fmt: skip
        text = self.watch.table()
        self._unsent, self._asked_at, self._waiting = framed((self._words, self.rests, text)), now, True
        self.code, self.told = None, ""
        self._send()
        return True, (f"{words}; fitting: the result comes in /diagnostics and the log, a scene that is better "
                      f"in {self.proposal}")  # fmt: skip

    def look(self, now: float) -> bool:
        """Takes the result that has arrived; whether there is a new one. Never waits.

        Args:
            now: See `offer_sample`.
        """
        before = self.answers
        self._receive(now)
        self._send()
        if self.cause:
            self.process.poll()
        return self.answers > before

    @property
    def is_fitting(self) -> bool:
        """Whether a fit is under way."""
        return self._waiting and not self.cause

    @property
    def outcome(self) -> str:
        """The last line of the last fit; empty without one."""
        return self.told.rstrip().rpartition("\n")[2]

    def take(self, kind: str, content: list) -> None:
        """Keeps a result; see `IdleWatch`."""
        self.code, self.told = content


def serve(requests: Requests, reply: Replies) -> None:
    """Answers until the other end closes.

    Args:
        requests: Nothing, then for each fit the words of the command, the file of the poses, and its
            text.
        reply: Takes ``(STATE, exit code, what was printed, duration [s])`` for each fit.
    """
    requests.read()
    while (asked := requests.read()) is not None:
        words, rests, text = asked
        begin, told = perf_counter(), io.StringIO()
        os.environ["COLUMNS"], sys.argv = WIDTH, ["softrobot_twin", *words]
        try:
            Path(rests).write_text(text, encoding="utf-8")
            with redirect_stdout(told), redirect_stderr(told):
                runpy.run_module("softrobot_twin", run_name="__main__")
        except SystemExit as end:
            code = int(end.code or 0)
        except OSError as error:
            code = 2
            told.write(f"{rests} cannot be written: {error.strerror}")
        except Exception as error:  # The next request is answered all the same.
            code = 2
            told.write(f"the fit failed by an error of the program: {type(error).__name__}: {error}")
        reply(STATE, code, told.getvalue(), perf_counter() - begin)
