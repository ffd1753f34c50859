"""A rerun recording. This is the only file that depends on the version of rerun.

The newest versions that run with Ubuntu 24.04's numpy 1.26 are rerun 0.22.1 to 0.23.1. They write
files. They cannot serve to this machine only without blocking the sender; therefore serving is
refused with them. rerun 0.41 reads files of 0.23.1 after ``rerun rrd migrate``, but not those of
0.22.1; the viewers of these versions read them. Importing this module imports rerun.
"""

from __future__ import annotations

import socket
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from softrobot_twin.view.frame import ViewError

# Names of the two timelines.
TIME = "time"
STEP = "step"

# Whether this rerun can serve on this machine only without blocking the sender.
CAN_SERVE = hasattr(rr, "GrpcServerSink")
_START_TIMEOUT = 5.0
_ADDRESS = "127.0.0.1"
# Interval at which a server sends [s]. With rerun's 0.2 s the picture jumps; with 0.008 s, one
# chunk per entity and frame, it sent nine times as many bytes.
_LIVE_FLUSH_TICK = 0.04


class Recording:
    """One rerun stream to a file, a server or a notebook. Each thread has its own present time.

    Attributes:
        address: Address for viewers, or None where nothing is served.
        viewer: The viewer inside a notebook, or None.
    """

    def __init__(self, stream: rr.RecordingStream, address: str | None = None, viewer: object = None):
        self._stream = stream
        self.address, self.viewer = address, viewer

    def set_time(self, step: int, time_ns: int) -> None:
        """Sets the time on both timelines for what this thread logs next.

        Args:
            step: Number of the step.
            time_ns: Time [ns].
        """
        self._stream.set_time(TIME, timestamp=np.datetime64(time_ns, "ns"))
        self._stream.set_time(STEP, sequence=step)

    def log(self, path: str, *archetypes: object, static: bool = False) -> None:
        """Logs archetypes at an entity path; static ones are valid at all times.

        Args:
            path: Path of the entity.
            *archetypes: rerun's archetypes.
            static: Whether they are valid at all times.
        """
        self._stream.log(path, *archetypes, static=static)

    def name_series(self, path: str, names: Sequence[str], colours: Sequence) -> None:
        """Sets names and colours of the curves of a plot, for all times.

        Args:
            path: Entity path of the plot.
            names: Curve names.
            colours: sRGB colours, one for each name.
        """
        style = rr.SeriesLines(names=list(names), colors=np.array(colours, dtype=np.uint8))
        self._stream.log(path, style, static=True)

    def log_series(self, path: str, values: Sequence[float] | np.ndarray) -> None:
        """Logs the present value of every curve of a plot, in the order of its names.

        Args:
            path: Path of the plot.
            values: A value of each curve.
        """
        self._stream.log(path, rr.Scalars(np.asarray(values, dtype=float)))

    def close(self, timeout: float) -> None:
        """Sends the remaining data within a timeout [s] and ends the stream.

        Before rerun 0.26 the timeout is ignored for files.

        Args:
            timeout: Longest time that it may take [s].
        """
        try:
            _flush(self._stream, timeout)
        finally:
            self._stream.disconnect()


def record_to(path: Path, application: str, blueprint: rrb.Blueprint) -> Recording:
    """Opens a recording into a file; creates its folder and replaces an old file.

    Args:
        path: File to write, ``.rrd``.
        application: Name under which a viewer stores the layout.
        blueprint: The layout.

    Raises:
        ViewError: The file cannot be written.
    """
    if path.suffix.lower() != ".rrd":
        raise ViewError("record", str(path), "a recording of rerun is a .rrd file; plot draws "
                        "pictures, save_vtu writes shapes")  # fmt: skip
    stream = _new_stream(application)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream.save(str(path), default_blueprint=blueprint)
    except (OSError, RuntimeError) as error:
        raise ViewError("record", str(path), f"cannot be written: {error}") from error
    return Recording(stream)


def serve_at(port: int, memory_limit: str, application: str, blueprint: rrb.Blueprint) -> Recording:
    """Opens a recording that viewers on this machine can connect to.

    Args:
        port: TCP port; 0 selects a free one.
        memory_limit: Memory for viewers that connect late, such as ``256MiB``.
        application: Name under which a viewer stores the layout.
        blueprint: The layout.

    Raises:
        ViewError: This rerun cannot serve, the port is taken, or the limit is not an amount of
            memory.
    """
    if not CAN_SERVE:
        raise ViewError("serve", True, f"rerun {rr.__version__} cannot serve to this machine only "
                        "without blocking the sender; record into a file, or install rerun 0.41")
    port = check_port(port)
    sink = rr.GrpcServerSink(_ADDRESS, port, server_memory_limit=memory_limit)
    stream = _new_stream(application, batcher_config=rr.ChunkBatcherConfig(flush_tick=_LIVE_FLUSH_TICK))
    try:
        stream.set_sinks(sink, default_blueprint=blueprint)
    except RuntimeError as error:
        raise ViewError("memory_limit", memory_limit, str(error)) from error
    try:
        _flush(stream, _START_TIMEOUT)
    except RuntimeError as error:
        stream.disconnect()
        raise ViewError("port", port, f"the server did not start: {error}") from error
    return Recording(stream, sink.uri)


def in_notebook(application: str, blueprint: rrb.Blueprint) -> Recording:
    """Opens a recording into a viewer that is shown inside a notebook.

    Args:
        application: Name under which the viewer stores the layout.
        blueprint: The layout.

    Raises:
        ViewError: rerun's package for notebooks is not installed.
    """
    if find_spec("rerun_notebook") is None:
        raise ViewError("notebook", True, "a view in a notebook needs rerun-notebook: pip install "
                        f"rerun-notebook=={rr.__version__}")  # fmt: skip
    from rerun.notebook import Viewer
    stream = _new_stream(application)
    return Recording(stream, viewer=Viewer(recording=stream, blueprint=blueprint))


def time_panel() -> rrb.TimePanel:
    """The time panel, collapsed; on the timeline of time if this rerun can select it."""
    try:
        return rrb.TimePanel(state="collapsed", timeline=TIME)
    except TypeError:
        return rrb.TimePanel(state="collapsed")


def past_range(seconds: float) -> rrb.VisibleTimeRange | None:
    """Time range of a plot: the last `seconds` before the cursor, on the timeline of time.

    Returns None, which shows the whole run, for rerun 0.23 with numpy 1.26: this pair cannot
    express a time relative to the cursor.

    Args:
        seconds: Length of the range [s].
    """
    if rr.__version__.startswith("0.23.") and int(np.__version__.partition(".")[0]) < 2:
        return None
    boundary = rrb.TimeRangeBoundary
    return rrb.VisibleTimeRange(TIME, start=boundary.cursor_relative(seconds=-seconds),
                                end=boundary.cursor_relative())


def _new_stream(application: str, **settings: object) -> rr.RecordingStream:
    stream = rr.RecordingStream(application, **settings)
    if hasattr(stream, "set_log_time_enabled"):
        # The time of logging is not recorded, because every frame has its own time.
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
    return stream


def _flush(stream: rr.RecordingStream, timeout: float) -> None:
    try:
        stream.flush(timeout_sec=timeout)
    except TypeError:
        stream.flush(blocking=True)


def check_port(port: int) -> int:
    """Returns a port that can be used, a free one for 0; rerun itself only logs a failure.

    Args:
        port: The port; 0 for any free one.
    """
    with socket.socket(socket.AF_INET) as probe:
        # Bind as the server does, so that a port with recently closed connections counts as free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((_ADDRESS, port))
        except (OSError, OverflowError) as error:
            raise ViewError("port", port, f"cannot listen on {_ADDRESS}: {error}; "
                            "choose another, or 0 for a free one") from error
        return probe.getsockname()[1]
