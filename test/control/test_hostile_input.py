"""For any input in any order, commands are finite, within limits and rates.

Random sequences of targets, poses, lengths, markers, services, settings and losses of the device
are played to the loop. Every command that leaves is compared with what left before it, or with
what the device measured since.
"""

from dataclasses import replace

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import LoopSettings, Mode, WhenLost
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation, Status

RATES = (20.0, 50.0, 100.0)
ROUNDING = 1.0e-9
ABSURD = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e6, -5.0, 0.0, 1e-300)


@pytest.fixture(scope="module")
def _built_small(tmp_path_factory):
    """A beam of twelve nodes that is attached to a guided palm; one of its cables has no rate."""
    grid = np.array([(x, y, z) for z in range(3) for y in range(2) for x in range(2)], float)
    tetrahedra = [
        [4 * layer + node for node in tetrahedron]
        for layer in range(2)
        for tetrahedron in ((0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7),
                            (0, 5, 1, 7))
    ]  # fmt: skip
    path = tmp_path_factory.mktemp("small") / "beam.vtk"
    meshio.write(path, meshio.Mesh(grid * [0.02, 0.02, 0.03], [("tetra", np.array(tetrahedra))]))

    def cable(name, x, y, **limits):
        return {
            "name": name, "pull_point_on": "palm", "pull_point": [x, y, 0.0],
            "points": [[x, y, 0.03], [x, y, 0.06]], "shortening": [-0.005, 0.02],
            "tension": [0.0, 10.0], **limits,
        }  # fmt: skip

    foot = {"minimum": [-1.0, -1.0, -1e-6], "maximum": [1.0, 1.0, 1e-6]}
    simulation = Simulation(scene_from_mapping({
        "name": "small",
        "gravity": [0.0, 0.0, -9.81],
        "body": {
            "name": "beam", "mesh": {"file": str(path)}, "attached": [{"to": "palm", "box": foot}],
            "material": {"young_modulus": 2e5, "poisson_ratio": 0.4, "density": 1000.0},
        },
        "rigid_bodies": [{
            "name": "palm", "motion": "guided", "box": {"size": [0.03, 0.03, 0.01]},
            "position": [0.01, 0.01, -0.005], "speed": 0.1, "turn_rate": 2.0,
        }],
        "cables": [cable("east", 0.02, 0.01, rate=0.05), cable("north", 0.01, 0.02, rate=0.02),
                   cable("west", 0.0, 0.01)],
        "effectors": [{"name": "tip", "points": [[0.01, 0.01, 0.06]],
                       "directions": ["x", "y", "z"], "measured_by": [1, 2]}],
        "markers": [{"id": 1, "point": [0.0, 0.0, 0.06]}, {"id": 2, "point": [0.02, 0.0, 0.06]},
                    {"id": 9, "point": [0.0, 0.0, 0.03]}],
    }))  # fmt: skip
    simulation.warm_up()
    return simulation


@pytest.fixture
def scenes(simulation, _built_small, air):
    """Scenes by name."""
    return {"diamond": simulation, "small": _built_small, "air": air}


class Hostile:
    """Plays random input to a loop, and checks the commands.

    Args:
        simulation: The scene.
        seed: Seed of everything.
        mode: Mode of the loop.
        use_device: A device is driven.
    """

    def __init__(self, simulation, seed, mode, use_device):
        print(f"seed {seed}, {mode.value}, device {use_device}")
        simulation.reset()
        self.random = np.random.default_rng(seed)
        self.simulation, self.use_device = simulation, use_device
        self.settings = {"rate": 50.0, "message_timeout": 0.5, "approach_speed": 0.05}
        if len(simulation.marker_ids):
            self.settings |= {"closed_loop": mode is Mode.INVERSE, "correction_gain": 8.0}
        self.loop = TwinLoop(simulation, LoopSettings(**self.settings), mode, use_device)
        self.limits, self.rest = simulation.limits, np.array(simulation.rest_setpoints)
        self.low, self.high = self.limits.setpoint_range(self.rest)
        # Setpoints in metres deviate by centimetres, others by a share of their scale.
        is_metre = np.array([kind.setpoint.unit == "m" for kind in simulation.actuators.kinds])
        self.scale = np.where(is_metre, 0.01, 0.5 * self.limits.drive_scale)
        self.loads = np.where(is_metre, 5.0, self.limits.effort_scale)
        self.rounding = ROUNDING * np.maximum(1.0, self.limits.drive_scale)
        self.time, self.present = 0.0, use_device
        self.real = self.lengths()
        # The last command or measurement: the rate of the next command counts from it.
        self.last = self.rest.copy()
        self.last_poses = self.loop.tick(0.0, 1000 * NANOSECONDS).guided_poses

    def arrival(self):
        age = self.random.choice([0.0, 0.0, 0.0, 0.05, 2.0, -10.0])
        now = round((1000.0 + self.time) * NANOSECONDS)
        stamp = 0 if self.random.random() < 0.1 else now - round(age * NANOSECONDS)
        frame = "elsewhere" if self.random.random() < 0.05 else "base_link"
        return Arrival(frame, stamp, now, self.time)

    def numbers(self, count, scale, around=0.0):
        """Numbers of any kind: mostly sensible, at times absurd."""
        values = around + scale * self.random.uniform(-1.0, 1.0, count)
        while self.random.random() < 0.15:
            values[self.random.integers(count)] = self.random.choice(ABSURD)
        return values

    def lengths(self):
        """Setpoints that can be, in the units of their kinds."""
        share = self.random.uniform(0.0, 1.0, len(self.rest))
        end = np.where(self.low < self.rest, self.low, self.high)
        return self.rest + share * (end - self.rest)

    def send_target(self):
        if self.loop.targets is None or not self.simulation.effector_names:
            return
        place = self.simulation.effector_positions()[0]
        scale = self.random.choice([0.005, 0.03, 1.0, 1e9])
        self.loop.targets.accept_point(0, self.numbers(3, scale, place), self.arrival())

    def send_velocity(self):
        if self.loop.targets is not None:
            self.loop.targets.accept_velocity(self.numbers(3, 0.05), self.time)

    def send_command(self):
        names = self.simulation.actuator_names
        taker = self.loop.direct if self.loop.mode is Mode.DIRECT else self.loop.selected
        if self.random.random() < 0.3:
            loads = self.numbers(len(names), self.loads, self.loads)
            taker.accept(names, [], loads, self.arrival())
            return
        chosen = self.random.integers(0, len(names) + 1)
        if self.loop.mode is Mode.DIRECT:
            chosen = len(names)
        lengths = self.lengths() + self.numbers(len(names), self.scale)
        taker.accept(names[:chosen], lengths[:chosen], [], self.arrival())

    def send_pressure(self):
        cavities = self.loop.cavities
        if not cavities.names:
            return
        name = cavities.names[self.random.integers(len(cavities.names))]
        reach = float(self.limits.effort_scale[cavities.places[name]])
        pressure = float(self.numbers(1, reach, cavities.ambient_pressure)[0])
        self.loop.pressures.accept(name, pressure, self.arrival())

    def send_markers(self):
        ids = self.simulation.marker_ids
        if not len(ids):
            return
        seen = self.simulation.marker_positions() + self.random.normal(0.0, 1e-3, (len(ids), 3))
        if self.random.random() < 0.3:
            seen[self.random.integers(len(ids))] = self.numbers(3, 1.0)
        if self.random.random() < 0.1:
            ids = self.random.permutation(ids)
        self.loop.markers.accept(ids, seen, self.arrival())

    def send_pose(self):
        for name in self.simulation.guided_names:
            position = self.numbers(3, self.random.choice([0.02, 100.0]))
            self.loop.poses.accept(name, position, self.numbers(4, 1.0), self.arrival())

    def serve(self):
        """Calls a service; in any state."""
        asked = self.random.choice(["enable", "enable", "disable", "reset"])
        if asked == "enable":
            self.loop.enable(self.time)
        elif asked == "disable":
            self.loop.disable()
        else:
            self.loop.reset()

    def change_settings(self):
        changes = {"rate": float(self.random.choice(RATES))}
        if "closed_loop" in self.settings and self.loop.mode is Mode.INVERSE:
            changes["closed_loop"] = bool(self.random.random() < 0.7)
        policy = list(WhenLost)[self.random.integers(2)]
        self.settings |= {**changes, "on_lost_device": policy, "on_lost_markers": policy}
        self.loop.apply(LoopSettings(**self.settings))

    def lose_or_bring_back(self):
        """The device goes, or comes back, at times somewhere else."""
        self.present = self.use_device and not self.present
        if self.present and self.random.random() < 0.6:
            self.real = self.lengths()

    def spoil(self):
        """For some ticks the solver fails, or gives back nonsense."""
        honest, random = self.simulation.step, self.random
        status = (Status.DIVERGED, Status.INVERTED, Status.OK)[random.integers(3)]
        nonsense = random.random() < 0.5

        def step(command, budget=None):
            result = honest(command, budget)
            lengths = self.numbers(len(self.rest), 0.1) if nonsense else result.setpoints
            return replace(result, status=status, setpoints=lengths)

        self.simulation.step = step
        try:
            for _ in range(random.integers(1, 40)):
                self.tick()
        finally:
            del self.simulation.step

    def measure(self):
        """Measurements of the device, sometimes invalid."""
        if not self.present:
            return
        names, arrival = self.simulation.actuator_names, self.arrival()
        said = self.real.copy()
        if self.random.random() < 0.03:
            said = self.numbers(len(said), 1.0)
        self.loop.device.accept(names, said, [], arrival)
        cavities = self.loop.cavities
        for name, index in cavities.places.items():
            if name not in cavities.by_volume and self.random.random() < 0.5:
                absolute = cavities.ambient_pressure + float(said[index])
                self.loop.measured_pressures.accept(name, absolute, arrival)

    def tick(self):
        """One tick, watched."""
        period = self.loop.settings.period
        self.time += period
        self.measure()
        outcome = self.loop.tick(self.time, round((1000.0 + self.time) * NANOSECONDS))
        self.watch(outcome, period)
        if self.present and outcome.command is not None and self.random.random() < 0.9:
            self.real = np.array(outcome.command.setpoints)

    def watch(self, outcome, period):
        """Checks the command of a tick: what this file asserts of it."""
        if self.use_device and outcome.activity is Activity.RESYNCHRONISING:
            # The next command counts from what was measured now.
            self.last = np.array(self.loop.device.setpoints)
        if outcome.command is None:
            return
        lengths, tensions = outcome.command
        limits, before = self.limits, self.last
        assert np.isfinite(lengths).all() and np.isfinite(tensions).all()
        assert (tensions >= limits.effort_min).all() and (tensions <= limits.effort_max).all()
        assert (np.abs(lengths - before) <= limits.rate * period + self.rounding).all()
        # Setpoints measured outside the limits return and never move further out.
        low = np.minimum(self.low, before) - self.rounding
        high = np.maximum(self.high, before) + self.rounding
        assert all(p >= 0.0 for p in self.loop.cavities.absolute(tensions).values())
        assert (lengths >= low).all() and (lengths <= high).all()
        self.last = np.array(lengths)
        for name, pose in outcome.guided_poses.items():
            entry = next(body for body in self.simulation.scene.rigid_bodies if body.name == name)
            there = self.last_poses[name]
            assert np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all()
            way = np.linalg.norm(pose.position - there.position)
            assert way <= entry.speed * period + ROUNDING
            turn = Rotation.from_quat(pose.quaternion) * Rotation.from_quat(there.quaternion).inv()
            assert turn.magnitude() <= entry.turn_rate * period + ROUNDING
            self.last_poses[name] = pose

    def play(self, ticks):
        """Plays random input for a number of ticks."""
        often = (self.send_target, self.send_velocity, self.send_command, self.send_markers,
                 self.send_pose)  # fmt: skip
        if self.loop.cavities.names:
            often += (self.send_pressure,)
        seldom = (self.serve, self.change_settings, self.lose_or_bring_back, self.spoil)
        calm_until = 0.0
        for _ in range(ticks):
            # Quiet times in between: what follows a service is seen to its end.
            if self.random.random() < 0.005:
                calm_until = self.time + self.random.uniform(0.5, 2.0)
            if self.random.random() < 0.3:
                often[self.random.integers(len(often))]()
            if self.time > calm_until and self.random.random() < 0.04:
                seldom[self.random.integers(len(seldom))]()
            if self.random.random() < 0.02:
                self.loop.enable(self.time)
            if self.use_device and not self.present and self.random.random() < 0.03:
                self.lose_or_bring_back()
            self.tick()

    def answers_again(self, seconds):
        """True if it sends a command soon after a reset at rest, to an operator who insists."""
        loop, names = self.loop, self.simulation.actuator_names
        loop.disable()
        loop.reset()
        end = self.time + seconds
        while self.time < end:
            self.time += loop.settings.period
            now = round((1000.0 + self.time) * NANOSECONDS)
            arrival = Arrival("base_link", now, now, self.time)
            if self.use_device:
                loop.device.accept(names, self.rest, [], arrival)
            loop.enable(self.time)
            outcome = loop.tick(self.time, now)
            self.watch(outcome, loop.settings.period)
            if outcome.command is not None:
                return True
        return False


def play(scenes, name, seed, ticks):
    """Plays to a scene in both modes, with a device and without."""
    for mode in Mode:
        for use_device in (False, True):
            hostile = Hostile(scenes[name], seed, mode, use_device)
            hostile.play(ticks)
            # To send nothing would be safe, too. How much was sent so far depends on the seed.
            assert hostile.answers_again(seconds=300.0)


@pytest.mark.parametrize("name", ["diamond", "small", "air"])
def test_no_order_of_inputs_leads_to_an_unsafe_command(scenes, name):
    play(scenes, name, 0, 100)


@pytest.mark.parametrize("name", ["diamond", "small", "air"])
@pytest.mark.parametrize("ticks", [120, pytest.param(400, marks=pytest.mark.exhaustive)])
def test_runs_of_random_inputs_lead_to_no_unsafe_command(scenes, name, ticks, drawn_seed):
    play(scenes, name, drawn_seed, ticks)
