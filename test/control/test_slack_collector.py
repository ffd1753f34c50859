"""When garbage is collected."""

import gc

import pytest

from softrobot_twin.control.slack_collector import SlackCollector


class Clock:
    def __init__(self):
        self.time = 0.0

    def __call__(self):
        return self.time


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def collector(clock):
    def collect():
        clock.time += 0.002

    return SlackCollector(interval=1.0, patience=10.0, clock=clock, collect=collect)


def test_it_collects_once_an_interval(collector, clock):
    collected = 0
    for _ in range(100):
        clock.time += 0.1
        collected += collector.offer(slack=0.05)
    assert 9 <= collected <= 10
    assert collector.forced == 0


def test_it_waits_for_enough_slack(collector, clock):
    clock.time = 1.5
    assert collector.offer(slack=0.05)
    clock.time = 3.0
    # The last collection took 2 ms: less than twice that is too little.
    assert not collector.offer(slack=0.003)
    assert not collector.offer(slack=-0.1)
    assert collector.offer(slack=0.005)


def test_it_collects_without_slack_when_there_never_is_any(collector, clock):
    clock.time = 9.9
    assert not collector.offer(slack=-0.1)
    clock.time = 10.1
    assert collector.offer(slack=-0.1)
    assert (collector.collections, collector.forced) == (1, 1)


def test_automatic_collection_is_off_inside_and_back_on_after():
    assert gc.isenabled()
    before = gc.get_freeze_count()
    with SlackCollector():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > before
    assert gc.isenabled()
    assert gc.get_freeze_count() <= before


def test_what_a_loop_leaves_behind_is_collected():
    class Knot:
        pass

    with SlackCollector(interval=0.0) as collector:
        knot = Knot()
        knot.itself = knot
        kept = id(knot)
        del knot
        assert any(id(thing) == kept for thing in gc.get_objects())
        assert collector.offer(slack=1.0)
        assert not any(isinstance(thing, Knot) for thing in gc.get_objects())
