"""The thread that draws the newest frame."""

import threading

import pytest

from softrobot_twin.view.drawing_thread import DrawingThread, LatestItem, RateLimit, every_nth


def test_each_item_is_taken_once_in_order_or_counted_as_dropped():
    slot = LatestItem()
    taken = []

    def take_all():
        while (item := slot.take()) is not None:
            taken.append(item)

    taker = threading.Thread(target=take_all)
    taker.start()
    for item in range(1, 20_001):
        slot.put(item)
    slot.close()
    taker.join(5.0)
    assert taken == sorted(set(taken))
    assert taken[-1] == 20_000
    assert len(taken) + slot.dropped_count == slot.put_count == 20_000


def passed(thinning, times):
    return sum(map(thinning.passes, times))


@pytest.mark.parametrize("offered_rate", [200.0, 90.0, 51.0])
def test_the_mean_rate_is_held_although_frames_do_not_fall_on_its_grid(offered_rate):
    thinning = RateLimit(50.0)
    times = [100.0 + k / offered_rate for k in range(int(10 * offered_rate))]
    assert passed(thinning, times) == pytest.approx(500, abs=2)


@pytest.mark.parametrize("time", [0.1, 66_800.123, 5_711_234.567])
def test_a_clock_that_stands_draws_one_frame(time):
    assert passed(RateLimit(10.0), [time] * 50) == 1


def test_frames_are_drawn_at_once_after_the_clock_was_set_back():
    thinning = RateLimit(50.0)
    assert passed(thinning, [100.0, 100.001, 3.0, 3.001, 3.0201]) == 3


class FrameDrawing:
    """A drawing that a test can block, and whose end can fail."""

    def __init__(self):
        self.drawn = []
        self.entered = threading.Semaphore(0)
        self.let = threading.Semaphore(0)
        self.close_fails = False
        self.closed = False

    def log(self, frame):
        self.entered.release()
        assert self.let.acquire(timeout=10.0)
        self.drawn.append(frame)

    def close(self, timeout):
        self.closed = True
        if self.close_fails:
            raise RuntimeError("not flushed")


@pytest.fixture
def canvas():
    canvas = FrameDrawing()
    yield canvas
    for _ in range(100):
        canvas.let.release()


@pytest.fixture
def outlet(canvas):
    """The thread that draws every frame on the canvas."""
    return DrawingThread("test", canvas, every_nth(1))


def wait_for_entry(canvas):
    assert canvas.entered.acquire(timeout=10.0)


def end(outlet, timeout=10.0):
    outlet.end(timeout)
    outlet.join()


def test_offering_returns_while_the_thread_is_blocked_and_then_the_newest_frame_is_drawn(canvas, outlet):
    outlet.offer(0)
    wait_for_entry(canvas)
    for frame in range(1, 1000):
        outlet.offer(frame)
    assert canvas.drawn == [] and outlet.latest.dropped_count == 998
    canvas.let.release()
    wait_for_entry(canvas)
    canvas.let.release()
    end(outlet)
    assert canvas.drawn == [0, 999]
    assert (outlet.logged_count, outlet.latest.dropped_count, outlet.failure) == (2, 998, None)


def test_the_last_frame_is_drawn_before_the_end(canvas, outlet):
    canvas.let.release()
    outlet.offer(7)
    end(outlet)
    outlet.offer(8)
    assert canvas.drawn == [7]
    assert canvas.closed


def test_closing_waits_for_a_blocked_thread_no_longer_than_its_timeout(canvas, outlet):
    outlet.offer(0)
    wait_for_entry(canvas)
    end(outlet, 0.05)
    assert "not finished in time" in outlet.failure


def test_a_failed_finish_is_reported(canvas, outlet):
    canvas.close_fails = True
    end(outlet)
    assert outlet.failure == "test: RuntimeError: not flushed"
