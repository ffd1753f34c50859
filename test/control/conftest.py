"""The Diamond on its coarsest mesh, built once: every test resets it first."""

import copy

import numpy as np
import pytest
import yaml

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation
from test.builder import at_rest
from test.places import ROOT
from test.scene_changes import entries_of

START = 1_000 * NANOSECONDS
FRAME = "base_link"


def coarse(scene, mesh):
    """The mapping of a scene on a coarse mesh of linear elements."""
    mapping = entries_of(ROOT / f"config/scenes/{scene}.yaml",
                         {"body.mesh.file": str(ROOT / f"meshes/{mesh}.vtk"), "body.element": "linear"})
    return mapping


@pytest.fixture(scope="session")
def small_scene_mapping():
    return coarse("diamond", "diamond_400")


def of_mapping(name):
    """A fixture that builds the simulation of a fixture's scene, once."""

    @pytest.fixture(scope="session")
    def make(request):
        return warmed_up(Simulation(scene_from_mapping(request.getfixturevalue(name))))

    return make


def warmed_up(simulation):
    simulation.warm_up()
    return simulation


_built = of_mapping("small_scene_mapping")
simulation = at_rest("_built")


@pytest.fixture(scope="session")
def _built_device(small_scene_mapping):
    """Softer by 15 %, its cables anchored 1 mm beside where they should be."""
    mapping = yaml.safe_load(yaml.safe_dump(small_scene_mapping))
    mapping["body"]["material"]["young_modulus"] = 0.85 * 180e3
    for cable, offset in zip(mapping["cables"], ([1, 0, 0], [0, 0, 1], [0, 0, -1], [0, -1, 0])):
        cable["points"] = (np.array(cable["points"]) + 1e-3 * np.array([offset])).tolist()
    return warmed_up(Simulation(scene_from_mapping(mapping)))


device_simulation = at_rest("_built_device")


@pytest.fixture(scope="session")
def _built_grasper():
    return warmed_up(Simulation.from_scene_file(ROOT / "config/scenes/grasper.yaml"))


grasper = at_rest("_built_grasper")
"""The Grasper, at rest: dynamic, in contact, its palm guided, one motor for three cables."""


@pytest.fixture(scope="session")
def trunk_mapping():
    """The Trunk before its two cylinders, on its coarse mesh."""
    return coarse("trunk_cylinders", "trunk_700")


_built_trunk = of_mapping("trunk_mapping")
trunk = at_rest("_built_trunk")
"""The Trunk, at rest: eight cables and a slide, inverse in contact."""

_built_air = of_mapping("air_scene")
air = at_rest("_built_air")
"""A block with three cavities and a cable, at rest; see `air_scene`."""


class Driver:
    """Drives a loop tick by tick, on a clock of its own."""

    def __init__(self, simulation, mode=None, use_device=False, ambient_pressure=None, **settings):
        arguments = {} if mode is None else {"mode": mode}
        if ambient_pressure is not None:
            arguments["ambient_pressure"] = ambient_pressure
        self.loop = TwinLoop(
            simulation, LoopSettings(**{"rate": 20.0, **settings}), use_device=use_device,
            **arguments,
        )
        self.time = 0.0
        self.outcomes = []

    def arrival(self, age=0.0, frame_id=FRAME):
        now = START + round(self.time * NANOSECONDS)
        return Arrival(frame_id, now - round(age * NANOSECONDS), now, self.time)

    def target(self, *position, **header):
        return self.loop.targets.accept_point(0, position, self.arrival(**header))

    def measure(self, lengths, **header):
        names = self.loop.simulation.actuator_names
        return self.loop.device.accept(names, lengths, [], self.arrival(**header))

    def lead(self, name, *position, quaternion=(0.0, 0.0, 0.0, 1.0), **header):
        return self.loop.poses.accept(name, position, quaternion, self.arrival(**header))

    def wind(self, names, lengths=(), tensions=(), **header):
        return self.loop.direct.accept(names, lengths, tensions, self.arrival(**header))

    def choose(self, names, lengths=(), tensions=(), **header):
        return self.loop.selected.accept(names, lengths, tensions, self.arrival(**header))

    def press(self, name, pressure, **header):
        return self.loop.pressures.accept(name, pressure, self.arrival(**header))

    def sense(self, name, pressure, **header):
        return self.loop.measured_pressures.accept(name, pressure, self.arrival(**header))

    def see(self, positions, ids=None, **header):
        ids = self.loop.simulation.marker_ids if ids is None else np.array(ids, dtype=np.uint32)
        return self.loop.markers.accept(ids, np.asarray(positions), self.arrival(**header))

    def tick(self, count=1):
        for _ in range(count):
            outcome = self.loop.tick(self.time, START + round(self.time * NANOSECONDS))
            self.outcomes.append(outcome)
            self.time += self.loop.settings.period
        return outcome

    @property
    def commands(self):
        """Lengths that were published [m], shape (n, actuator_count)."""
        return np.array([o.command.setpoints for o in self.outcomes if o.command is not None])

    @property
    def largest_step(self):
        """Largest change of a length from command to command, the first from rest [m]."""
        rest = self.loop.simulation.rest_setpoints
        return np.abs(np.diff(np.vstack([rest, self.commands]), axis=0)).max()


def driver_of(name, **defaults):
    """A fixture that makes drivers of the simulation of another fixture."""

    @pytest.fixture
    def make(request):
        simulation = request.getfixturevalue(name)
        return lambda **arguments: Driver(simulation, **defaults | arguments)

    return make


drive = driver_of("simulation")
drive_grasper = driver_of("grasper", mode=Mode.DIRECT, rate=100.0)
drive_trunk = driver_of("trunk", rate=50.0, approach_speed=0.05)
drive_air = driver_of("air", rate=50.0)


@pytest.fixture
def drive_posed(small_scene_mapping):
    """Makes a driver of the small Diamond, whose tip has a height and an axis that points."""
    mapping = copy.deepcopy(small_scene_mapping)
    markers = {marker["id"]: marker["point"] for marker in mapping["markers"]}
    patch = [markers[marker] for marker in (4, 5, 6, 7)]
    mapping["effectors"][0] |= {
        "orientation": {"pointing": [0.0, 0.0, 1.0], "points": patch}, "directions": ["z"],
    }  # fmt: skip

    def make(**arguments):
        return Driver(Simulation(scene_from_mapping(mapping)), **arguments)

    return make
