"""A real viewer process without a window that connects late, is frozen and is killed."""

import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.view import Drawn, Entity, Frame, RerunMirror, Stage
from softrobot_twin.view.recording import CAN_SERVE
from test.memory import resident_memory

pytestmark = pytest.mark.skipif(not CAN_SERVE, reason="this rerun cannot serve safely")

MEBIBYTE = 2**20


def until(condition, timeout=120.0, meanwhile=lambda: time.sleep(0.02)):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        meanwhile()


@pytest.fixture
def join(tmp_path):
    """Starts viewers that connect to an address and write the received data into a file."""
    import rerun_cli
    # Not the script beside Python: a signal to that one would not reach its child.
    program = Path(rerun_cli.__file__).with_name("rerun")
    viewers = []

    def join(address: str, path: Path) -> subprocess.Popen:
        with socket.create_server(("127.0.0.1", 0)) as probe:
            own_port = probe.getsockname()[1]
        viewers.append(subprocess.Popen(
            [program, address, "--save", path, "--bind", "127.0.0.1", "--port", str(own_port)],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        return viewers[-1]

    yield join
    for viewer in viewers:
        viewer.kill()
        viewer.wait()
    # Python aborts when it ends while such a thread returns from rerun.
    for thread in threading.enumerate():
        if thread.name.startswith("view-"):
            thread.join(30.0)


def size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def heavy_stage_and_frames(node_count: int):
    """A stage whose frames weigh about 24 bytes a node; few triangles, so that they are drawn at once."""
    random = np.random.default_rng(0)
    positions = random.random((node_count, 3))
    triangles = random.integers(0, node_count, (node_count // 100, 3))
    path = "/robot/surface/body"
    stage = Stage("heavy", "heavy", (Entity(path, "surface", triangles=triangles),), ())

    def make(step: int) -> Frame:
        moved = positions + 1e-3 * random.random((node_count, 3))
        return Frame(step, step * 10_000_000, {path: Drawn(moved)}, {}, {"whole step": 1e-3}, "ok")

    return stage, make


def test_a_viewer_that_connects_late_receives_the_stage_and_past_frames(
    stage, make_frame, tmp_path, join, read_recording
):
    path = tmp_path / "late.rrd"
    with RerunMirror(stage, serve=True, port=0, live_rate=1e6) as mirror:
        for step in range(10):
            mirror.offer(make_frame(step))
            until(lambda: mirror.frames_logged == step + 1)
        viewer = join(mirror.address, path)

        def has_come(step):
            try:
                return step in read_recording(path).at_steps("/targets", "Points3D:positions")
            except (ValueError, RuntimeError):
                return False  # Nothing of the recording has been written yet, or half a message.

        until(lambda: size(path) > 0)
        until(lambda: has_come(9))
        mirror.offer(make_frame(10))
        until(lambda: has_come(10))
    viewer.kill()
    recorded = read_recording(path)
    assert recorded.static("/robot/surface/body", "Mesh3D:triangle_indices") == \
        stage.entities[0].triangles.tolist()
    positions = recorded.at_steps("/robot/surface/body", "Mesh3D:vertex_positions")
    assert positions.keys() == set(range(11))
    assert np.array(positions[10]) == pytest.approx(
        make_frame(10).drawn["/robot/surface/body"].points, abs=1e-8)


def test_a_frozen_viewer_of_an_ordinary_robot_has_no_effect(tmp_path, join):
    stage, make = heavy_stage_and_frames(node_count=1000)
    frames = iter(range(10**9))
    with RerunMirror(stage, serve=True, port=0, memory_limit="16MiB") as mirror:

        def offer():
            mirror.offer(make(next(frames)))
            time.sleep(0.005)

        viewer = join(mirror.address, tmp_path / "frozen.rrd")
        until(lambda: size(tmp_path / "frozen.rrd") > 10_000, meanwhile=offer)
        viewer.send_signal(signal.SIGSTOP)
        logged, memory = mirror.frames_logged, resident_memory()
        until(lambda: mirror.frames_logged > logged + 300, meanwhile=offer)
        assert resident_memory() - memory < 150 * MEBIBYTE
        assert mirror.failure is None


@pytest.mark.exhaustive
def test_a_frozen_viewer_blocks_large_frames_but_nothing_else(tmp_path, join, read_recording):
    stage, make = heavy_stage_and_frames(node_count=100_000)
    ready = [make(step) for step in range(20)]
    with RerunMirror(stage, serve=True, port=0, live_rate=100.0, memory_limit="16MiB",
                     record=tmp_path / "run.rrd", record_every=50) as mirror:
        file, live = mirror.drawing_threads

        def offer():
            mirror.offer(ready[mirror.frames_offered % len(ready)])
            time.sleep(0.005)

        viewer = join(mirror.address, tmp_path / "frozen.rrd")
        until(lambda: size(tmp_path / "frozen.rrd") > MEBIBYTE, meanwhile=offer)
        viewer.send_signal(signal.SIGSTOP)

        def held_up():
            before = live.logged_count
            offered, recorded = mirror.frames_offered, file.logged_count
            until(lambda: mirror.frames_offered >= offered + 200, meanwhile=offer)
            return live.logged_count == before and file.logged_count > recorded

        memory = resident_memory()
        until(held_up, timeout=120.0, meanwhile=offer)
        # While the live thread waits, frames are accepted and the file is written: see held_up.
        assert resident_memory() - memory < 1200 * MEBIBYTE
        logged = live.logged_count
        viewer.kill()
        until(lambda: live.logged_count > logged + 20, meanwhile=offer)
        assert mirror.failure is None

        late = tmp_path / "late.rrd"
        join(mirror.address, late)
        until(lambda: size(late) > MEBIBYTE, meanwhile=offer)

        def shows_the_surface():
            try:
                recording = read_recording(late)
            except RuntimeError:  # its last message is still being written
                return False
            return bool(recording.static("/robot/surface/body", "Mesh3D:triangle_indices"))

        until(shows_the_surface)
    # On a busy machine the file's thread may come late for a frame; a viewer that hangs stops it
    # altogether.
    assert file.latest.dropped_count < 0.1 * file.logged_count


@pytest.mark.exhaustive
def test_closing_with_a_frozen_viewer_takes_no_longer_than_its_timeout(tmp_path, join):
    stage, make = heavy_stage_and_frames(node_count=100_000)
    ready = [make(step) for step in range(20)]
    mirror = RerunMirror(stage, serve=True, port=0, live_rate=100.0, memory_limit="16MiB")

    def offer():
        mirror.offer(ready[mirror.frames_offered % len(ready)])
        time.sleep(0.005)

    viewer = join(mirror.address, tmp_path / "frozen.rrd")
    until(lambda: size(tmp_path / "frozen.rrd") > MEBIBYTE, meanwhile=offer)
    viewer.send_signal(signal.SIGSTOP)

    def held_up():
        before, offered = mirror.frames_logged, mirror.frames_offered
        until(lambda: mirror.frames_offered >= offered + 200, meanwhile=offer)
        return mirror.frames_logged == before

    until(held_up, timeout=120.0, meanwhile=offer)
    mirror.close(timeout=0.5)
    assert "not finished in time" in mirror.failure
