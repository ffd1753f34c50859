"""The process that estimates the mesh's error for a running twin; see `mesh_error_watch.py`.

It takes no time from the twin: the system runs it only where nothing else wants the processor.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import sys
from time import perf_counter
from typing import BinaryIO

LENGTH = struct.Struct("<I")
"""What stands before each message: its length in bytes."""
REST, STATE, UNKNOWN = "rest", "state", "unknown"


def framed(content: object) -> bytes:
    """A message as it is sent."""
    body = pickle.dumps(content)
    return LENGTH.pack(len(body)) + body


def yield_to_all() -> None:
    """Run only where nobody else wants the processor, whatever priority was inherited.

    SCHED_IDLE where the system allows it, an ordinary thread otherwise, never one of real time; of
    the greatest nice value in both cases.
    """
    for policy in (os.SCHED_IDLE, os.SCHED_OTHER):
        try:
            os.sched_setscheduler(0, policy, os.sched_param(0))
            break
        except OSError:
            continue
    os.nice(19)


def serve(requests: BinaryIO, replies: BinaryIO) -> None:
    """Answers until the other end closes: the mesh at rest, then each state that is asked for.

    Args:
        requests: The scene, then `ActuatorLoads` for each state.
        replies: ``(REST, MeshError)``, then ``(STATE, error [m], duration [s])`` for each state;
            ``(UNKNOWN, reason)`` and the end where there is no estimate, or it failed.
    """
    from softrobot_twin.simulation.mesh_error import MeshErrorEstimator, check_judges_states
    from softrobot_twin.simulation.mesh_error import MeshErrorUnknown

    def reply(*content: object) -> None:
        replies.write(framed(content))
        replies.flush()

    scene = _read(requests)
    if scene is None:
        return
    try:
        estimator = MeshErrorEstimator(scene)
        reply(REST, estimator.at_rest())
        check_judges_states(scene)
        while (asked := _read(requests)) is not None:
            begin = perf_counter()
            reply(STATE, estimator.at(asked), perf_counter() - begin)
    except MeshErrorUnknown as unknown:
        reply(UNKNOWN, unknown.reason)
    except BrokenPipeError:
        raise
    except Exception as error:  # noqa: BLE001 - the twin tells it; nobody else would hear of it
        reply(UNKNOWN, f"it failed: {type(error).__name__}: {error}")


def _read(stream: BinaryIO):
    """The next message; None where the other end has closed."""
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    size = LENGTH.unpack(head)[0]
    body = stream.read(size)
    return pickle.loads(body) if len(body) == size else None


def main(yields: bool = True) -> None:
    """Serves standard input and output; an interrupt of the terminal is the twin's to hear.

    Args:
        yields: Whether to run only where nobody else wants the processor. Called before numpy is
            imported, so that threads of libraries inherit it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if yields:
        yield_to_all()
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # nothing printed may get in between
    try:
        serve(sys.stdin.buffer, replies)
    except BrokenPipeError:
        pass  # The twin has ended.
