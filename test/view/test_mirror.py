import socket
import sys
import threading

import numpy as np
import pytest

from softrobot_twin.view import RerunMirror, ViewError
from softrobot_twin.view.recording import CAN_SERVE

pytestmark = pytest.mark.libraries

serving = pytest.mark.skipif(not CAN_SERVE, reason="this rerun cannot serve safely")


def offer_all(mirror, frames):
    """Offer each frame once the file has the one before."""
    for frame in frames:
        mirror.offer(frame)
        mirror.wait(10.0)
        assert not mirror.drawing_threads[0].is_busy


@pytest.mark.parametrize(("key", "asked"), [
    ("serve", dict(serve=False)),
    ("spawn_viewer", dict(serve=False, record="run.rrd", spawn_viewer=True)),
    ("record_every", dict(serve=False, record="run.rrd", record_every=0)),
    ("live_rate", dict(serve=True, live_rate=0.0)),
    pytest.param("memory_limit", dict(serve=True, port=0, memory_limit="plenty"), marks=serving),
])
def test_invalid_options_are_refused_by_name(stage, key, asked):
    with pytest.raises(ViewError, match=asked.get("memory_limit")) as refusal:
        RerunMirror(stage, **asked)
    assert refusal.value.key == key


def test_a_failed_import_of_rerun_is_reported(stage, tmp_path, monkeypatch):
    # With None in sys.modules the import fails.
    for name in ("recording", "picture"):
        monkeypatch.delitem(sys.modules, f"softrobot_twin.view.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ViewError, match="rerun"):
        RerunMirror(stage, serve=False, record=tmp_path / "run.rrd")


def test_a_file_holds_the_offered_frames(stage, make_frame, tmp_path, read_recording):
    path = tmp_path / "made" / "on the way" / "run.rrd"
    with RerunMirror(stage, serve=False, record=path) as mirror:
        frames = [make_frame(step) for step in range(5)]
        offer_all(mirror, frames)
    assert (mirror.frames_offered, mirror.frames_logged, mirror.frames_dropped) == (5, 5, 0)
    assert mirror.failure is None and mirror.address is None
    positions = read_recording(path).at_steps("/robot/surface/body", "Mesh3D:vertex_positions")
    assert positions.keys() == set(range(5))
    last = frames[4].drawn["/robot/surface/body"].points
    assert np.array(positions[4]) == pytest.approx(last, abs=1e-8)


def test_a_file_can_be_thinned(stage, make_frame, tmp_path, read_recording):
    with RerunMirror(stage, serve=False, record=tmp_path / "run.rrd", record_every=3) as mirror:
        offer_all(mirror, [make_frame(step) for step in range(8)])
    recorded = read_recording(tmp_path / "run.rrd")
    assert recorded.at_steps("/robot/effectors", "Points3D:positions").keys() == {0, 3, 6}
    assert (mirror.frames_offered, mirror.frames_logged, mirror.frames_dropped) == (8, 3, 0)


def test_a_frame_that_cannot_be_drawn_is_reported_and_the_run_continues(
    stage, make_frame, tmp_path, read_recording
):
    with RerunMirror(stage, serve=False, record=tmp_path / "run.rrd") as mirror:
        wrong = {"/targets": None}
        offer_all(mirror, [make_frame(0), make_frame(1, wrong), make_frame(2)])
        assert mirror.failure
    assert (mirror.frames_logged, mirror.frames_failed) == (2, 1)
    steps = read_recording(tmp_path / "run.rrd").at_steps("/plots/residual", "Scalars:scalars") \
        or read_recording(tmp_path / "run.rrd").curves("/plots/residual")
    assert steps.keys() == {0, 2}


def test_a_file_that_cannot_be_written_is_refused_by_name(stage, tmp_path):
    with pytest.raises(ViewError, match=str(tmp_path)):
        RerunMirror(stage, serve=False, record=tmp_path)


def test_two_mirrors_are_separate_and_do_not_use_the_global_recording(
    stage, make_frame, tmp_path, read_recording
):
    import rerun
    with RerunMirror(stage, serve=False, record=tmp_path / "a.rrd") as first, \
            RerunMirror(stage, serve=False, record=tmp_path / "b.rrd") as second:
        offer_all(first, [make_frame(1)])
        offer_all(second, [make_frame(2)])
        assert rerun.get_global_data_recording() is None
    for name, step in (("a", 1), ("b", 2)):
        recorded = read_recording(tmp_path / f"{name}.rrd")
        assert recorded.at_steps("/targets", "Points3D:positions").keys() == {step}


@pytest.mark.skipif(CAN_SERVE, reason="this rerun can serve safely")
def test_serving_is_refused_by_name_where_rerun_cannot_do_it_safely(stage):
    with pytest.raises(ViewError, match="cannot serve to this machine only"):
        RerunMirror(stage, serve=True)


@serving
def test_a_taken_port_is_refused_by_name_without_a_remaining_server(stage, tmp_path):
    before = set(threading.enumerate())  # threads that earlier tests abandoned
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ViewError, match=str(port)) as refusal:
            RerunMirror(stage, serve=True, port=port, record=tmp_path / "run.rrd")
    assert refusal.value.key == "port" and refusal.value.value == port
    left = set(threading.enumerate()) - before
    assert not [thread for thread in left if thread.name.startswith("view-")]


@serving
def test_port_zero_takes_a_free_port_on_this_machine_only(stage):
    with RerunMirror(stage, serve=True, port=0) as mirror:
        port = int(mirror.address.rpartition(":")[2].partition("/")[0])
        assert mirror.address == f"rerun+http://127.0.0.1:{port}/proxy"
        socket.create_connection(("127.0.0.1", port), timeout=5.0).close()
        # A server on every interface would occupy this address too.
        socket.create_server(("127.0.0.2", port)).close()
