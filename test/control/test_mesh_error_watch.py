"""Facts of the estimate of the mesh's error beside a running twin."""

import copy
import os
import time
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.analysis.mesh_error import ActuatorLoads, MeshErrorEstimator
from softrobot_twin.control import idle_process
from softrobot_twin.control.mesh_error_watch import MeshErrorWatch
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation
from test.builder import builder
from test.control.error_watches import offer_until
from test.places import ROOT


def discretization_error(simulation, forces_given=False):
    """Error of the effectors by the mesh at the state of a simulation [m]."""
    return MeshErrorEstimator(simulation.scene).at(ActuatorLoads.of(simulation, forces_given))


@builder
def diamond(small_scene_mapping, /, change=None) -> Simulation:
    """Makes the Diamond on its coarsest mesh; a function may change its scene first."""
    mapping = copy.deepcopy(small_scene_mapping)
    mapping["body"]["mesh"]["file"] = str(ROOT / "meshes/diamond_150.vtk")
    if change is not None:
        change(mapping)
    return Simulation(scene_from_mapping(mapping))


@pytest.fixture
def watch_of():
    """Starts watches, and ends them."""
    watches = []

    def start(simulation, yields=False) -> MeshErrorWatch:
        # A process of the lowest priority might never run on a busy machine.
        watches.append(MeshErrorWatch(simulation, yields))
        return watches[-1]

    yield start
    for watch in watches:
        watch.close()


@pytest.mark.exhaustive
def test_the_process_estimates_the_error_that_the_simulation_does_then_tells_what_failed(diamond, watch_of):
    simulation = diamond()
    simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.006, 0.003, 0.0, 0.0], 1.0))
    watch = watch_of(simulation)
    offer_until(watch, simulation, lambda: watch.answers == 1)
    assert watch.cause == ""
    assert 0.0 < watch.at_rest.own.lengths < watch.at_rest.own.forces
    assert watch.newest == pytest.approx(discretization_error(simulation), rel=1e-9)
    watch.request_of = lambda *_: "no state"
    offer_until(watch, simulation, lambda: watch.cause)
    assert watch.cause.startswith("it failed: AttributeError: ")
    assert watch.at_rest is not None and np.isnan(watch.newest)


def test_a_scene_without_an_estimate_gives_the_reason(diamond, watch_of):
    simulation = diamond(lambda mapping: mapping.pop("effectors"))
    watch = watch_of(simulation)
    offer_until(watch, simulation, lambda: watch.cause)
    assert "no effector" in watch.cause and watch.at_rest is None
    assert np.isnan(watch.newest)


def test_a_dead_process_is_reported_and_receives_no_more_requests(diamond, watch_of):
    simulation = diamond()
    watch = watch_of(simulation)
    watch.process.kill()
    watch.process.wait()
    offer_until(watch, simulation, lambda: watch.cause)
    assert watch.cause == "its process has ended"
    watch.offer(simulation, False, time.monotonic())
    assert np.isnan(watch.newest)


def test_the_process_has_the_lowest_priority_and_ends_with_its_watch(diamond, watch_of):
    simulation = diamond()
    watch = watch_of(simulation, yields=True)
    offer_until(
        watch, simulation, lambda: os.sched_getscheduler(watch.process.pid) == os.SCHED_IDLE
    )
    watch.close()
    assert watch.process.returncode is not None


def resident(process) -> int:
    """Memory of a process [MB]."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) // 1024


@pytest.mark.exhaustive
def test_a_state_is_asked_about_once_and_then_the_process_gives_its_memory_back(
    diamond, watch_of, monkeypatch
):
    program = idle_process.PROGRAM.replace("run(", "idle_process.LINGER = 0.2; run(")
    monkeypatch.setattr(
        idle_process, "PROGRAM", "from softrobot_twin.control import idle_process; " + program
    )
    simulation = diamond()
    simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.006, 0.003, 0.0, 0.0], 1.0))
    watch = watch_of(simulation)
    offer_until(watch, simulation, lambda: watch.answers == 1)
    at_rest = watch.at_rest
    offer_until(watch, simulation, lambda: resident(watch.process) < 40)
    assert watch.answers == 1 and not watch.cause
    simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.009, 0.003, 0.0, 0.0], 1.0))
    offer_until(watch, simulation, lambda: watch.answers == 2)
    assert watch.newest == pytest.approx(discretization_error(simulation), rel=1e-9)
    assert watch.at_rest is at_rest
