"""A rerun recording, whichever rerun is installed: the one file that knows its versions apart.

rerun 0.22.1 to 0.23.1 are the newest that run with the numpy 1.26 of Ubuntu 24.04. They write
files, but cannot serve to this machine only without blocking the sender: serving is refused there.
rerun 0.41 reads the files of 0.23.1 after ``rerun rrd migrate``, those of 0.22.1 not at all; their
own viewers do. Importing this module imports rerun.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from softrobot_twin.view.frame import ViewError

# Names of the two timelines.
TIME = "time"
STEP = "step"

# Whether this rerun can serve to this machine only, without ever blocking for good.
CAN_SERVE = hasattr(rr, "GrpcServerSink")
# Times by kind, several curves of a plot in one entity, streams made by their class.
_SINCE_0_23 = hasattr(rr, "Scalars")
_START_TIMEOUT = 5.0
# How often a server sends [s]. rerun's 0.2 s lets the picture jump; its 0.008 s, a chunk for each
# entity and frame, sent nine times the bytes.
_LIVE_FLUSH_TICK = 0.04


class Recording:
    """One rerun stream of its own, into a file or a server. Time is kept for each thread.

    Attributes:
        address: What a viewer joins, or None for a file.
    """

    def __init__(self, stream: rr.RecordingStream, address: str | None = None):
        self._stream = stream
        self.address = address

    def set_time(self, step: int, time_ns: int) -> None:
        """Place on both timelines what this thread logs from now on."""
        if _SINCE_0_23:
            self._stream.set_time(TIME, timestamp=np.datetime64(time_ns, "ns"))
            self._stream.set_time(STEP, sequence=step)
        else:
            self._stream.set_time_nanos(TIME, time_ns)
            self._stream.set_time_sequence(STEP, step)

    def log(self, path: str, *archetypes: object, static: bool = False) -> None:
        """Log archetypes at an entity path; static ones hold at all times."""
        self._stream.log(path, *archetypes, static=static)

    def name_series(self, path: str, names: Sequence[str], colours: Sequence) -> None:
        """Give the curves of a plot their names and colours, for all times.

        Args:
            path: Entity path of the plot.
            names: Curve names.
            colours: sRGB colours, one for each name.
        """
        if _SINCE_0_23:
            style = rr.SeriesLines(names=list(names), colors=np.array(colours, dtype=np.uint8))
            self._stream.log(path, style, static=True)
            return
        for index, (name, colour) in enumerate(zip(names, colours)):
            self._stream.log(f"{path}/{index}", rr.SeriesLine(name=name, color=colour),
                             static=True)

    def log_series(self, path: str, values: Sequence[float] | np.ndarray) -> None:
        """Log the present value of every curve of a plot, in the order of its names."""
        if _SINCE_0_23:
            self._stream.log(path, rr.Scalars(np.asarray(values, dtype=float)))
            return
        for index, value in enumerate(values):
            self._stream.log(f"{path}/{index}", rr.Scalar(float(value)))

    def close(self, timeout: float) -> None:
        """Send what is still on its way, for so long [s], and end the stream.

        Before rerun 0.26 a file is written to its end whatever the timeout.
        """
        try:
            _flush(self._stream, timeout)
        finally:
            self._stream.disconnect()


def record_to(path: Path, application: str, blueprint: rrb.Blueprint) -> Recording:
    """Open a recording into a file; its folder is made, an old file replaced.

    Args:
        path: File to write, ``.rrd``.
        application: Name under which a viewer keeps the layout.
        blueprint: The layout.

    Raises:
        ViewError: The file cannot be written.
    """
    stream = _new_stream(application)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream.save(str(path), default_blueprint=blueprint)
    except (OSError, RuntimeError) as error:
        raise ViewError("record", str(path), f"cannot be written: {error}") from error
    return Recording(stream)


def serve_at(address: str, port: int, memory_limit: str, application: str,
             blueprint: rrb.Blueprint) -> Recording:
    """Open a recording that viewers can join and leave.

    Args:
        address: Address of the interface to listen on, such as ``127.0.0.1``.
        port: TCP port; 0 takes a free one.
        memory_limit: How much is kept for viewers that come late, such as ``256MiB``.
        application: Name under which a viewer keeps the layout.
        blueprint: The layout.

    Raises:
        ViewError: This rerun cannot serve, the address is not one of this machine's, the port is
            taken, or the limit is no amount of memory.
    """
    if not CAN_SERVE:
        raise ViewError("serve", True, f"rerun {rr.__version__} cannot serve to this machine only "
                        "without blocking the sender; record into a file, or install rerun 0.41")
    port = _check_port(address, port)
    sink = rr.GrpcServerSink(address, port, server_memory_limit=memory_limit)
    stream = _new_stream(application,
                         batcher_config=rr.ChunkBatcherConfig(flush_tick=_LIVE_FLUSH_TICK))
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


def time_panel() -> rrb.TimePanel:
    """The time panel, collapsed, on the timeline of time where this rerun can be told to."""
    try:
        return rrb.TimePanel(state="collapsed", timeline=TIME)
    except TypeError:
        return rrb.TimePanel(state="collapsed")


def past_range(seconds: float) -> rrb.VisibleTimeRange | None:
    """The time that a plot shows: so many seconds up to the cursor, on the timeline of time.

    None, which makes it show the whole run, with rerun 0.23 beside numpy 1.26: that pair fails to
    express a time relative to the cursor.
    """
    if rr.__version__.startswith("0.23.") and int(np.__version__.partition(".")[0]) < 2:
        return None
    boundary = rrb.TimeRangeBoundary
    return rrb.VisibleTimeRange(TIME, start=boundary.cursor_relative(seconds=-seconds),
                                end=boundary.cursor_relative())


def _new_stream(application: str, **settings: object) -> rr.RecordingStream:
    if not _SINCE_0_23:
        return rr.new_recording(application)
    stream = rr.RecordingStream(application, **settings)
    if hasattr(stream, "set_log_time_enabled"):
        # The time of logging says nothing about the robot.
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
    return stream


def _flush(stream: rr.RecordingStream, timeout: float) -> None:
    try:
        stream.flush(timeout_sec=timeout)
    except TypeError:
        stream.flush(blocking=True)


def _check_port(address: str, port: int) -> int:
    """Return the port, or a free one for 0: rerun itself only complains in its log."""
    try:
        ipaddress.IPv4Address(address)
    except ValueError:
        raise ViewError("address", address, "is no IPv4 address, such as 127.0.0.1") from None
    with socket.socket(socket.AF_INET) as probe:
        # As the server does, so that connections that have just ended do not count as taken.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
        except (OSError, OverflowError) as error:
            raise ViewError("port", port, f"cannot listen on {address}: {error}; "
                            "choose another, or 0 for a free one") from error
        return probe.getsockname()[1]
