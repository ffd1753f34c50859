"""A policy learns on 32 robots in two processes.

Natural policy gradient: what exploration gained moves a linear policy. The Diamonds are reduced
models, their cables up to 1 mm aside. Writes ``many_robots.png`` and ``policy.csv``. One minute:

    python examples/many_robots.py [ROUNDS]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

SCENE = Path(__file__).resolve().parents[1] / "config/scenes/diamond_reduced.yaml"
COUNT, STEPS, NOISE, RATE = 32, 12, 0.4, 0.1
SCALES = np.repeat([1.0, 30.0], [4, 6])  # of four setpoints, and of two places


def improved(policy, robots, random):
    """A better policy, and how far tips were from targets in the end while it explored [mm]."""
    seen, tried, gained = [], NOISE * random.standard_normal((STEPS, COUNT, 4)), []
    now, infos = robots.reset()
    for more in tried:
        before = infos["distance"]
        seen.append(np.column_stack([SCALES * now, np.ones(COUNT)]))
        now, *_, infos = robots.step(np.clip(seen[-1] @ policy + more, -1.0, 1.0))
        gained.append(before - infos["distance"])
    for step in reversed(range(STEPS - 1)):
        gained[step] += 0.7 * gained[step + 1]
    seen, tried, gained = np.concatenate(seen), tried.reshape(-1, 4), np.concatenate(gained)
    known = np.column_stack([seen, np.linalg.norm(seen[:, 7:10], axis=1)])
    better = gained - known @ np.linalg.lstsq(known, gained, rcond=None)[0]  # than usual
    push = seen.T @ (tried * (better / better.std() / NOISE)[:, None])
    fisher = seen.T @ seen + 0.01 * len(seen) * np.eye(11)
    return policy + RATE * np.linalg.solve(fisher, push), 1e3 * infos["distance"].mean()


if __name__ == "__main__":  # the two processes import this file
    model = st.load(SCENE)
    aside = {one: one.read(model.scene) + np.array([-1e-3, 1e-3])  # m
             for one in model.parameters("cables.*.pull_point")}
    robots = st.vector_env(SCENE, COUNT, 2, most_steps=STEPS + 1, reached_within=0.0, travel=0.35,
                           states=64, randomize=aside, redraw_every=20)
    print(robots)
    robots.reset(seed=0)
    policy, far, random = np.zeros((11, 4)), [], np.random.default_rng(0)
    for _ in range(int(sys.argv[1]) if len(sys.argv) > 1 else 40):
        policy, missed = improved(policy, robots, random)
        far.append(missed)
        print(f"round {len(far)}: {missed:.1f} mm from targets while it explores")
    robots.close()
    np.savetxt("policy.csv", policy, delimiter=",")
    plt.plot(range(1, len(far) + 1), far)
    plt.xlabel("round of 32 episodes")
    plt.ylabel("distance to targets while it explores [mm]")
    plt.savefig("many_robots.png", dpi=100)
