import threading

import pytest

from softrobot_twin.view.drawing_thread import EveryNth, Outlet


class Canvas:
    """Draws when it is let, and fails when it is told to."""

    def __init__(self):
        self.drawn = []
        self.entered = threading.Semaphore(0)
        self.let = threading.Semaphore(0)
        self.failing = set()
        self.close_fails = False
        self.closed = False

    def log(self, frame):
        self.entered.release()
        assert self.let.acquire(timeout=10.0)
        if frame in self.failing:
            raise ValueError(f"no {frame}")
        self.drawn.append(frame)

    def close(self, timeout):
        self.closed = True
        if self.close_fails:
            raise RuntimeError("not flushed")


@pytest.fixture
def canvas():
    canvas = Canvas()
    yield canvas
    for _ in range(100):
        canvas.let.release()


def wait_for_entry(canvas):
    assert canvas.entered.acquire(timeout=10.0)


def test_offering_returns_while_the_drawing_thread_is_held_up(canvas):
    outlet = Outlet("test", canvas, EveryNth(1))
    outlet.offer(0)
    wait_for_entry(canvas)
    for frame in range(1, 1000):
        outlet.offer(frame)
    assert canvas.drawn == []
    assert outlet.dropped_count == 998


def test_after_a_hold_up_the_newest_frame_is_drawn(canvas):
    outlet = Outlet("test", canvas, EveryNth(1))
    outlet.offer(0)
    wait_for_entry(canvas)
    for frame in (1, 2, 3):
        outlet.offer(frame)
    canvas.let.release()
    wait_for_entry(canvas)
    canvas.let.release()
    outlet.end(10.0)
    outlet.join()
    assert canvas.drawn == [0, 3]
    assert (outlet.logged_count, outlet.dropped_count, outlet.failure) == (2, 2, None)


def test_a_frame_that_fails_is_told_and_the_next_one_is_drawn(canvas):
    outlet = Outlet("test", canvas, EveryNth(1))
    canvas.failing = {0}
    for frame in (0, 1):
        outlet.offer(frame)
        wait_for_entry(canvas)
        canvas.let.release()
        if frame == 0:
            canvas.let.release()
    outlet.end(10.0)
    outlet.join()
    assert canvas.drawn == [1]
    assert (outlet.logged_count, outlet.failed_count) == (1, 1)
    assert outlet.failure == "test: ValueError: no 0"


def test_the_last_frame_is_drawn_before_the_end(canvas):
    outlet = Outlet("test", canvas, EveryNth(1))
    canvas.let.release()
    outlet.offer(7)
    outlet.end(10.0)
    outlet.join()
    outlet.offer(8)
    assert canvas.drawn == [7]
    assert canvas.closed


def test_the_end_does_not_wait_longer_than_told_for_a_thread_that_is_held_up(canvas):
    outlet = Outlet("test", canvas, EveryNth(1))
    outlet.offer(0)
    wait_for_entry(canvas)
    outlet.end(0.05)
    outlet.join()
    assert "not finished in time" in outlet.failure


def test_a_finish_that_fails_is_told(canvas):
    outlet = Outlet("test", canvas, EveryNth(1))
    canvas.close_fails = True
    outlet.end(10.0)
    outlet.join()
    assert outlet.failure == "test: RuntimeError: not flushed"


def test_only_the_frames_that_are_wanted_are_drawn(canvas):
    outlet = Outlet("test", canvas, EveryNth(2))
    for _ in range(3):
        canvas.let.release()
    for frame in range(5):
        outlet.offer(frame)
        if frame % 2 == 0:
            wait_for_entry(canvas)
    outlet.end(10.0)
    outlet.join()
    assert canvas.drawn == [0, 2, 4]
    assert outlet.dropped_count == 0
