"""Records the run of a node: what reaches its loop, its ticks, and the messages of its topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from rclpy.publisher import Publisher

from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.errors import ParameterError
from softrobot_twin.record.run_clock import RecordedClock
from softrobot_twin.record.run_description import describe
from softrobot_twin.record.run_file import INSTALL, SUFFIX, RunFileError, Topic
from softrobot_twin.record.run_recorder import RunRecorder
from softrobot_twin.ros.message_bytes import to_bytes
from softrobot_twin.ros.message_definitions import definition, type_name
from softrobot_twin.ros.ticking_node import TickingNode

PARAMETER = "record"


class RunRecording:
    """Records the run of a twin.

    Attributes:
        path: The file.
        clock: The clock that its simulation must read.
        recorder: Writes the file; None until `begin`.
    """

    def __init__(self, node: TickingNode, name: str):
        """Checks that the file can be written, before anything takes long.

        Args:
            node: The twin.
            name: The file.

        Raises:
            ParameterError: mcap is missing, or the file has another suffix or exists.
        """
        self._node, self.path, self.clock = node, Path(name), RecordedClock()
        self.recorder: RunRecorder | None = None
        suffix = f"must end in {SUFFIX}; for an .rrd file of the view set record_file"
        for is_wrong, why in (
            (self.path.suffix != SUFFIX, suffix), (find_spec("mcap") is None, INSTALL),
            (self.path.exists(), "exists already; move it away, or name another file"),
        ):
            if is_wrong:
                raise ParameterError(PARAMETER, name, "", why)

    def begin(self, loop: TwinLoop, parameters: Mapping[str, object]) -> None:
        """Opens the file, before any topic is open.

        Args:
            loop: The twin's loop, built and warmed up.
            parameters: All parameters of the node, by name.

        Raises:
            ParameterError: The file cannot be written.
        """
        node = self._node
        description = describe(
            loop, node.get_fully_qualified_name(), node.ros_time(),
            {"use_sim_time": node.is_simulated_time, **parameters},
        )  # fmt: skip
        try:
            self.recorder = RunRecorder(self.path, loop, self.clock, description, node.ros_time, to_bytes)
        except RunFileError as error:
            raise ParameterError(PARAMETER, str(self.path), "", error.reason) from None

    def publisher(self, publisher: Publisher) -> RecordedPublisher:
        """A publisher whose messages are recorded.

        Args:
            publisher: The publisher.
        """
        return RecordedPublisher(publisher, self.recorder)

    def receiver(self, kind: type, topic: str) -> Callable[[bytes], None]:
        """What records the bytes of messages.

        Args:
            kind: Type of the messages.
            topic: Full name of the topic.
        """
        return partial(self.recorder.note_message, _described(kind, topic, "in"))

    def pass_on(self) -> None:
        """Passes on what was noted in a tick; see `RunRecorder`."""
        self.recorder.pass_on()

    def close(self) -> None:
        """Writes the rest and closes the file."""
        if self.recorder is not None:
            self.recorder.close()


class RecordedPublisher:
    """Publishes and records messages; everything else is that of the publisher."""

    def __init__(self, publisher: Publisher, recorder: RunRecorder):
        self._publisher, self._recorder = publisher, recorder
        self._topic = _described(publisher.msg_type, publisher.topic_name, "out")

    def publish(self, message) -> None:
        """Publishes a message, which must not be changed any more.

        Args:
            message: The message.
        """
        self._publisher.publish(message)
        self._recorder.note_message(self._topic, message)

    def __getattr__(self, name: str):
        return getattr(self._publisher, name)


def _described(kind: type, name: str, direction: str) -> Topic:
    return Topic(name, type_name(kind), definition(kind), direction)
