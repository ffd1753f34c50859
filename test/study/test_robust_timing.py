"""Timing on a busy machine, with a simulated clock."""

import numpy as np
import pytest

from softrobot_twin.study.timing import RobustTiming


class BusyMachine:
    """Steps take their time, times how slow the machine is just now."""

    def __init__(self, slowness):
        self._slowness = iter(slowness)
        self.now = 1.0

    def go_on(self):
        self.now = next(self._slowness)

    def steps(self, time):
        return lambda: np.full(50, time * self.now)


@pytest.mark.parametrize("seed", range(5))
def test_a_machine_that_slows_down_does_not_change_the_ranking(seed):
    slowness = np.random.default_rng(seed).uniform(1.0, 5.0, 8)
    slowness[3] = 1.0
    machine = BusyMachine(slowness)
    timing = RobustTiming(machine.steps(2e-3))
    for _ in range(4):
        for key, time in (("fast", 1e-3), ("slow", 1.2e-3)):
            machine.go_on()
            timing.add_round(key, machine.steps(time))
    assert timing.spread("fast").median == pytest.approx(1e-3)
    assert timing.spread("slow").p99 == pytest.approx(1.2e-3)
    assert timing.slowdown == pytest.approx(np.median(np.repeat(slowness, 2)))
