"""The mirror to rerun: it shows what the control loop does, and the loop never waits for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import TracebackType

from softrobot_twin.view.drawing_thread import AtMost, EveryNth, Outlet
from softrobot_twin.view.frame import Frame, Stage, ViewError


def open_viewer(address: str) -> subprocess.Popen | None:
    """Open a viewer on an address, where there is a display to open it on.

    The viewer is that of this environment's rerun. It is detached: it survives this process, and
    its end does not matter to it.

    Args:
        address: What the viewer joins, such as ``rerun+http://127.0.0.1:9876/proxy``.

    Returns:
        Its process, or None without a display.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None
    # A viewer also listens for senders, by default on every interface: keep it to this machine.
    command = [sys.executable, "-m", "rerun_cli", "--connect", address, "--bind", "127.0.0.1",
               "--port", "auto"]
    return subprocess.Popen(command, start_new_session=True, stdin=subprocess.DEVNULL,
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


class RerunMirror:
    """Shows frames live in rerun viewers, records them into a file, or both.

    Viewers may be absent, come late, freeze or be killed. Each of the two outlets has its own
    thread, its own rerun stream and its own place for the newest frame, so that what holds up one
    reaches neither the loop nor the other. It happens: with frames of 1 MB, 60 a second, a frozen
    viewer let 600 MB queue up before it and then held up the sending thread, until the server gave
    that viewer up after some 30 s. With frames of an ordinary robot, 25 kB, nothing was held up.

    Args:
        stage: What never changes.
        serve: Whether viewers can join.
        address: IPv4 address of the interface to listen on.
        port: TCP port to listen on; 0 takes a free one.
        record: File to record into, or None. It grows without bound, by about 25 bytes for each
            surface node and frame: thin with `record_every`.
        record_every: Record the first of every so many frames.
        live_rate: Frames a second that viewers get at most [Hz].
        memory_limit: What the server keeps for viewers that come late.
        spawn_viewer: Whether to open a viewer, where there is a display.

    Attributes:
        frames_offered: Frames offered so far.

    Raises:
        ViewError: Nothing was asked for, rerun cannot be imported, the port is taken, the file
            cannot be written, or the installed rerun cannot do what was asked.
    """

    def __init__(
        self,
        stage: Stage,
        *,
        serve: bool,
        address: str = "127.0.0.1",
        port: int = 9876,
        record: Path | None = None,
        record_every: int = 1,
        live_rate: float = 50.0,
        memory_limit: str = "256MiB",
        spawn_viewer: bool = False,
    ):
        if not serve and record is None:
            raise ViewError("serve", serve, "with no file to record into, there is nothing to do")
        if spawn_viewer and not serve:
            raise ViewError("spawn_viewer", spawn_viewer, "a viewer has nothing to join; serve too")
        if record_every < 1:
            raise ViewError("record_every", record_every, "must be 1 or more")
        if not live_rate > 0.0:
            raise ViewError("live_rate", live_rate, "must be above 0 Hz")
        self.frames_offered = 0
        self._address: str | None = None
        self._outlets: list[Outlet] = []
        self._viewer: subprocess.Popen | None = None
        # rerun takes half a second to import: only here, where it is wanted.
        try:
            from softrobot_twin.view import picture, recording
            from softrobot_twin.view.picture import Picture
        except ImportError as error:
            raise ViewError("rerun", "import", f"failed: {error}") from error
        application = f"softrobot_twin {stage.name}"
        layout = picture.layout(stage.name, stage.shows_contact, bool(stage.other_actuators))
        try:
            if record is not None:
                file = recording.record_to(Path(record), application, layout)
                self._outlets.append(Outlet("file", Picture(file, stage), EveryNth(record_every)))
            if serve:
                live = recording.serve_at(address, port, memory_limit, application, layout)
                self._address = live.address
                self._outlets.append(Outlet("live", Picture(live, stage), AtMost(live_rate)))
        except BaseException:
            self.close()
            raise
        if spawn_viewer:
            self._viewer = open_viewer(live.address)

    @property
    def address(self) -> str | None:
        """What a viewer joins at any time, or None when nothing is served."""
        return self._address

    @property
    def viewer_spawned(self) -> bool:
        """Whether a viewer was opened; without a display none is."""
        return self._viewer is not None

    @property
    def frames_logged(self) -> int:
        """Frames that reached rerun, counted once for the viewers and once for the file."""
        return sum(outlet.logged_count for outlet in self._outlets)

    @property
    def frames_dropped(self) -> int:
        """Frames that an outlet wanted, and that a newer one replaced before they were drawn."""
        return sum(outlet.dropped_count for outlet in self._outlets)

    @property
    def frames_failed(self) -> int:
        """Frames that could not be drawn; `failure` says why."""
        return sum(outlet.failed_count for outlet in self._outlets)

    @property
    def failure(self) -> str | None:
        """What last went wrong behind the loop's back, or None."""
        failures = [outlet.failure for outlet in self._outlets if outlet.failure]
        return "; ".join(failures) or None

    @property
    def outlets(self) -> tuple[Outlet, ...]:
        """The outlets, each with its own counts: ``file`` and ``live``, as far as asked for."""
        return tuple(self._outlets)

    def offer(self, frame: Frame) -> None:
        """Leave a frame to be shown; takes microseconds and never waits.

        A frame that has not been drawn yet is replaced. Offers after `close` are ignored. One
        thread offers.

        Args:
            frame: The frame; its arrays are the mirror's from now on.
        """
        self.frames_offered += 1
        for outlet in self._outlets:
            outlet.offer(frame)

    def close(self, timeout: float = 5.0) -> None:
        """Draw the last frames, finish the file and stop serving; may be called twice.

        Args:
            timeout: How long this may take [s]. Past it the threads are left behind, which
                `failure` tells; they do not keep the process alive.
        """
        for outlet in self._outlets:
            outlet.end(timeout)
        for outlet in self._outlets:
            outlet.join()

    def __enter__(self) -> RerunMirror:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
