"""Without a device a twin that is started again continues from the last command."""

import errno
import os
import time

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from softrobot_twin.control.last_command import LastCommand
from softrobot_twin.ros.claim import LIFE_TIME
from softrobot_twin.simulation import Simulation

RATE = 0.05


def drive(world, twin):
    """Lets a twin follow a target; its last command [m]."""
    targets = world.speaker(PointStamped, "/twin/target/tip")
    rest = twin.loop.simulation.rest_setpoints
    while np.abs(twin.loop.last_command.setpoints - rest).max() < 0.004:
        targets.publish(world.target_message((0.012, 0.0, 0.134)))
        world.run(0.02)
    twin.stop()
    world.probe.destroy_publisher(targets)
    return twin.loop.last_command.setpoints.copy()


@pytest.mark.parametrize("ends", ("at once", "cleanly"))
def test_a_twin_that_is_started_again_continues_where_the_hardware_is(world, make_twin, ends):
    first = make_twin(rate=50.0)
    last = drive(world, first)
    first.last_command.read()  # Its thread has written then.
    first.claim.close()
    if ends == "cleanly":
        first.destroy_node()
    time.sleep(LIFE_TIME)
    heard = world.hear(JointState, "/twin/cables", 100)
    second = make_twin(rate=50.0)
    world.until(lambda: len(heard) > 5)
    commands = np.vstack([last, *(message.position for message in heard)])
    assert np.abs(np.diff(commands, axis=0)).max() <= RATE / 50.0 + 1e-9
    assert second.loop.is_enabled


def test_a_twin_enabled_after_another_continues_where_that_one_ended(world, make_twin):
    first, second = make_twin(rate=50.0), make_twin(rate=50.0)
    assert not second.loop.is_enabled
    last = drive(world, first)
    first.last_command.read()
    heard = world.hear(JointState, "/twin/cables", 100)
    first.claim.close()
    time.sleep(LIFE_TIME + 0.2)
    assert second.enable(SetBool.Request(data=True), SetBool.Response()).success
    world.until(lambda: len(heard) > 5)
    commands = np.vstack([last, *(message.position for message in heard)])
    assert np.abs(np.diff(commands, axis=0)).max() <= RATE / 50.0 + 1e-9


def test_a_folder_that_cannot_be_written_stops_nothing(simulation_of, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    stored = LastCommand(simulation_of, "1 /twin/cables")
    stored.keep(simulation_of.rest_setpoints, np.zeros(4), {})
    stored.close()
    assert stored.failure and stored.read() is None


@pytest.fixture
def slow_disk(monkeypatch):
    """Each write takes 0.3 s."""
    write = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda *line: (time.sleep(0.3), write(*line)))


@pytest.mark.parametrize("ends", (False, True))
def test_what_is_read_is_never_older_than_what_was_kept(simulation_of, slow_disk, ends):
    stored, rest = LastCommand(simulation_of, "1 /twin/cables"), simulation_of.rest_setpoints
    for number in range(3):
        stored.keep(rest + number, np.zeros(4), {})
        time.sleep(0.05)
    if ends:
        stored.close()
    assert (stored.read().setpoints == rest + 2).all()
    stored.close()


def test_after_a_failed_write_the_file_is_too_old_to_be_used(simulation_of, monkeypatch):
    stored, rest = LastCommand(simulation_of, "1 /twin/cables"), simulation_of.rest_setpoints
    stored.keep(rest, np.zeros(4), {})
    assert stored.read() is not None

    def fail(*line):
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(os, "pwrite", fail)
    stored.keep(rest + 0.01, np.zeros(4), {})
    assert stored.read() is None and "no space left" in stored.failure
    stored.close()


@pytest.fixture
def simulation_of(small_scene_file):
    """The small Diamond."""
    return Simulation.from_scene_file(small_scene_file)
