import pytest

from softrobot_twin.view.drawing_thread import AtMost, EveryNth


def test_the_first_of_every_so_many_frames_goes_on():
    thinning = EveryNth(3)
    assert [thinning.wants_next() for _ in range(7)] == [True, False, False] * 2 + [True]


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def passed(thinning, clock, times):
    count = 0
    for clock.now in times:
        count += thinning.wants_next()
    return count


@pytest.mark.parametrize("offered_rate", [200.0, 90.0, 51.0])
def test_the_mean_rate_is_held_although_frames_do_not_fall_on_its_grid(offered_rate):
    clock = Clock()
    thinning = AtMost(50.0, clock)
    times = [100.0 + k / offered_rate for k in range(int(10 * offered_rate))]
    assert passed(thinning, clock, times) == pytest.approx(500, abs=2)


def test_slow_frames_all_go_on():
    clock = Clock()
    assert passed(AtMost(50.0, clock), clock, [100.0 + 0.1 * k for k in range(30)]) == 30


def test_a_pause_is_not_made_up_for():
    clock = Clock()
    thinning = AtMost(50.0, clock)
    assert passed(thinning, clock, [100.0]) == 1
    assert passed(thinning, clock, [200.0 + 0.001 * k for k in range(40)]) == 2
