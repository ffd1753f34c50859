"""Facts of the full model beside a running twin with reduced bodies."""

import os

import pytest

from softrobot_twin.analysis.reduction_error import FullModelError, ReductionStates
from softrobot_twin.control.reduction_error_watch import ReductionErrorWatch
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation
from test.control.error_watches import offer_until


@pytest.fixture(scope="module")
def bent(half_trained):
    """The reduced Diamond, two of whose cables are wound."""
    simulation = Simulation(load_scene(half_trained), with_warnings=False)
    lengths = simulation.rest_setpoints - [0.009, 0.0, 0.006, 0.0]
    for _ in range(20):
        simulation.step(CommandSetpoints(lengths, 0.05))
    return simulation


@pytest.fixture
def watch(bent):
    # A process of the lowest priority might never run on a busy machine.
    started = ReductionErrorWatch(bent, yields=False)
    yield started
    started.close()


@pytest.mark.exhaustive
def test_the_process_tells_the_error_that_the_full_model_has_then_what_failed(bent, watch):
    assert watch.newest == {} and not watch.is_ready
    offer_until(watch, bent, lambda: watch.answers == 1)
    assert watch.is_ready and watch.cause == ""
    judge = FullModelError(bent)
    for name, error in judge.errors(bent.state).items():
        assert watch.newest[name] == pytest.approx(error, rel=1e-6)
    for name, state in ReductionStates(bent).read().items():
        assert watch.states[name] == pytest.approx(state, rel=1e-6, nan_ok=True)
    assert watch.linearizations == judge.linearizations >= 2
    watch.request_of = lambda *_: "no state"
    offer_until(watch, bent, lambda: watch.cause)
    assert watch.cause.startswith("it failed: CommandError: state: ")
    assert watch.newest == watch.states == {}


def test_the_process_has_the_lowest_priority_and_ends_with_its_watch(bent):
    watch = ReductionErrorWatch(bent)
    offer_until(watch, bent, lambda: os.sched_getscheduler(watch.process.pid) == os.SCHED_IDLE)
    watch.close()
    assert watch.process.returncode is not None
