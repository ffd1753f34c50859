"""Prints which kernels contact solvers of last resort compile after a warm-up: last_resorts.py SCENE_FILE"""

import sys

import numpy as np
from late_kernels import noted

from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.contact_problem import ContactProblem

simulation = Simulation.from_scene_file(sys.argv[1])
simulation.warm_up()
late, solvers, rng = noted(), simulation.direct.solvers, np.random.default_rng(1)
for contacts in (3, 40):
    Y = rng.standard_normal((3 * contacts, 3 * contacts + 10))
    none = np.empty(0)
    problem = ContactProblem(
        Y @ Y.T, rng.uniform(-1.0, 0.1, 3 * contacts), none, none, np.full(contacts, 0.4), 3)
    guess = np.zeros(3 * contacts)
    solvers.swept(problem, guess, guess)
    for solver in (solvers.sweeps, solvers.newton, solvers.judge):
        solver.solve(problem, guess)
    solvers.continuation.solve(problem, guess, guess)
print(late)
