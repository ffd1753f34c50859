"""The mirror to rerun: it shows the control loop's frames, and the loop never waits for it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import AbstractContextManager
from pathlib import Path

from softrobot_twin.view.drawing_thread import DrawingThread, RateLimit, every_nth
from softrobot_twin.view.frame import Frame, Stage, ViewError

# Time between two looks whether frames are drawn [s].
_POLL = 0.0005


def open_viewer(address: str) -> subprocess.Popen | None:
    """Opens a viewer for an address, if there is a display.

    The viewer is that of this environment's rerun. It is a detached process: neither process is
    affected when the other one ends.

    Args:
        address: Address of the server, such as ``rerun+http://127.0.0.1:9876/proxy``.

    Returns:
        Its process, or None without a display.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None
    # A viewer also listens for senders, by default on every interface; limit it to this machine.
    command = [sys.executable, "-m", "rerun_cli", "--connect", address, "--bind", "127.0.0.1",
               "--port", "auto"]
    return subprocess.Popen(command, start_new_session=True, stdin=subprocess.DEVNULL,
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


class RerunMirror(AbstractContextManager):
    """Shows frames live in rerun viewers, records them into a file, or both.

    Viewers may be absent, connect late, freeze or be killed. Each of the two outputs (file and
    live) has its own drawing thread, rerun stream and newest frame, so a delay in one affects
    neither the loop nor the other. Measured with 60 frames of 1 MB per second and a frozen viewer:
    600 MB were queued, then the sending thread was blocked until the server dropped the viewer
    after about 30 s. With the frames of an ordinary robot, 25 kB each, nothing was blocked.

    Args:
        stage: The constant part of the view.
        serve: Whether viewers can connect.
        port: TCP port to listen on, on this machine only; 0 selects a free one.
        record: File to record into, or None. It grows without bound, by about 25 bytes for each
            surface node and frame; `record_every` reduces this.
        record_every: The first of every so many frames is recorded.
        live_rate: Highest rate of frames for viewers [Hz].
        memory_limit: Memory of the server for viewers that connect late.
        spawn_viewer: Whether to open a viewer, if there is a display.
        notebook: Whether to show them in a viewer inside a notebook, which gets every frame.

    Attributes:
        address: Address for viewers, or None when nothing is served.
        drawing_threads: The requested drawing threads, ``file``, ``live`` and ``notebook``, each
            with its own counts.
        frames_offered: Frames offered so far.
        viewer: Process of the viewer that was opened, or None.
        notebook_viewer: The viewer inside a notebook, or None.

    Raises:
        ViewError: No output was requested, rerun or what it needs for a notebook cannot be
            imported, the port is taken, the file cannot be written, or the installed rerun cannot
            serve.
    """

    def __init__(
        self,
        stage: Stage,
        *,
        serve: bool,
        port: int = 9876,
        record: Path | None = None,
        record_every: int = 1,
        live_rate: float = 50.0,
        memory_limit: str = "256MiB",
        spawn_viewer: bool = False,
        notebook: bool = False,
    ):
        if not (serve or notebook) and record is None:
            raise ViewError("serve", serve, "neither serving nor recording was requested")
        if spawn_viewer and not serve:
            raise ViewError("spawn_viewer", spawn_viewer, "a viewer needs serve=True")
        if record_every < 1:
            raise ViewError("record_every", record_every, "must be 1 or more")
        if not live_rate > 0.0:
            raise ViewError("live_rate", live_rate, "must be above 0 Hz")
        self.frames_offered = 0
        self.address: str | None = None
        self.drawing_threads: list[DrawingThread] = []
        self.viewer: subprocess.Popen | None = None
        self.notebook_viewer: object = None
        # Importing rerun takes half a second, so it is imported only when it is needed.
        try:
            from softrobot_twin.view import picture, recording
            from softrobot_twin.view.picture import Picture
        except ImportError as error:
            raise ViewError("rerun", "import", f"failed: {error}") from error
        application = f"softrobot_twin {stage.name}"
        layout = picture.layout(stage)
        try:
            if record is not None:
                file = recording.record_to(Path(record), application, layout)
                self.drawing_threads.append(
                    DrawingThread("file", Picture(file, stage), every_nth(record_every)))
            if serve:
                live = recording.serve_at(port, memory_limit, application, layout)
                self.address = live.address
                limit = RateLimit(live_rate)
                self.drawing_threads.append(DrawingThread(
                    "live", Picture(live, stage), lambda: limit.passes(time.monotonic())))
            if notebook:
                page = recording.in_notebook(application, layout)
                self.notebook_viewer = page.viewer
                self.drawing_threads.append(DrawingThread("notebook", Picture(page, stage), every_nth(1)))
        except BaseException:
            self.close()
            raise
        if spawn_viewer and self.address is not None:
            self.viewer = open_viewer(self.address)

    @property
    def frames_logged(self) -> int:
        """Frames that reached rerun; a frame counts once for the viewers and once for the file."""
        return sum(outlet.logged_count for outlet in self.drawing_threads)

    @property
    def frames_dropped(self) -> int:
        """Chosen frames that were replaced by newer ones before they were drawn."""
        return sum(outlet.latest.dropped_count for outlet in self.drawing_threads)

    @property
    def frames_failed(self) -> int:
        """Frames that could not be drawn; see `failure`."""
        return sum(outlet.failed_count for outlet in self.drawing_threads)

    @property
    def failure(self) -> str | None:
        """The last failure of the drawing threads, or None."""
        failures = [outlet.failure for outlet in self.drawing_threads if outlet.failure]
        return "; ".join(failures) or None

    def offer(self, frame: Frame) -> None:
        """Offers a frame; takes microseconds and never waits.

        It replaces a frame that has not been drawn yet. Calls after `close` are ignored. Only one
        thread may call this.

        Args:
            frame: The frame; the mirror takes over its arrays.
        """
        self.frames_offered += 1
        for outlet in self.drawing_threads:
            outlet.offer(frame)

    def wait(self, longest: float) -> None:
        """Waits until all frames are drawn, but no longer than this time [s]: a viewer may be frozen.

        A run that is faster than its drawing would else show few of its steps.

        Args:
            longest: Longest time [s].
        """
        end = time.monotonic() + longest
        while time.monotonic() < end and any(outlet.is_busy for outlet in self.drawing_threads):
            time.sleep(_POLL)

    def close(self, timeout: float = 5.0) -> None:
        """Draws the last frames, finishes the file and stops serving; may be called twice.

        Args:
            timeout: Longest duration [s]. Threads that take longer are abandoned and reported in
                `failure`; they do not keep the process alive.
        """
        for outlet in self.drawing_threads:
            outlet.end(timeout)
        for outlet in self.drawing_threads:
            outlet.join()

    def __exit__(self, *error: object) -> None:
        self.close()
