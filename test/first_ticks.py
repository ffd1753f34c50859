"""Prints which kernels are compiled, or loaded, in the first ticks of a loop: first_ticks.py SCENE CHANGES"""

import sys

import numpy as np
from late_kernels import noted

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation

simulation = Simulation(load_scene(f"config/scenes/{sys.argv[1]}.yaml", eval(sys.argv[2])))
loop = TwinLoop(simulation, LoopSettings(message_timeout=0.0))
simulation.warm_up()
late, rng = noted(), np.random.default_rng(5)
for tick in range(1, 100):
    arrival = Arrival("base_link", 20_000_000 * tick, 20_000_000 * tick, 0.02 * tick)
    if tick % 20 == 1:
        away = 0.1 * simulation.model.nodes.finite_size * rng.normal(size=3)
        loop.targets.accept_point(0, simulation.effector_positions()[0] + away, arrival)
    loop.markers.accept(simulation.marker_ids, simulation.marker_positions() + [2e-3, 0.0, 0.0], arrival)
    loop.tick(arrival.time, arrival.ros_time)
print(late)
