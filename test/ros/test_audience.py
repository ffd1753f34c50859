"""Who is asked who listens, and how often."""

from types import SimpleNamespace

from softrobot_twin.ros.audience import PERIOD, Audience


class Publisher:
    def __init__(self, listeners):
        self.listeners, self.asked = listeners, 0

    def get_subscription_count(self):
        self.asked += 1
        return self.listeners


def test_publishers_are_asked_once_a_period():
    clock = SimpleNamespace(time=5.0)
    audience = Audience(lambda: clock.time)
    heard, silent = Publisher(2), Publisher(0)
    for _ in range(100):
        assert audience.hears(heard) and not audience.hears(silent)
    assert audience.hears_any([silent, heard]) and not audience.hears_any([])
    assert heard.asked == silent.asked == 1
    silent.listeners = 1
    clock.time += 0.9 * PERIOD
    assert not audience.hears(silent)
    clock.time += 0.2 * PERIOD
    assert audience.hears(silent) and silent.asked == 2
