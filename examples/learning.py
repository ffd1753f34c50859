"""A policy learns to reach with the finger, without a model: it only sees the reward.

Cross-entropy method: try policies around a mean, keep the best, move the mean there. The policy is
linear: speeds of both cables = W · observation. One sees the distance to unknown targets fall, and
``learning.png`` shows how. Needs gymnasium and matplotlib; takes a minute:

    python examples/learning.py [GENERATIONS]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from softrobot_twin.scripting.gym_environment import ReachingEnvironment

ROOT = Path(__file__).resolve().parents[1]
STEPS, CANDIDATES, ELITE = 12, 32, 8
GENERATIONS = int(sys.argv[1]) if len(sys.argv) > 1 else 8

finger = ReachingEnvironment(ROOT / "config/scenes/finger.yaml", most_steps=STEPS)
random = np.random.default_rng(0)


def random_targets(count, seed):
    """Reachable places for the tip [m]."""
    finger.reset(seed=seed)
    return [finger.reset() and finger.target for _ in range(count)]


def last_distance(policy, target):
    """Distance of the tip from a target at the end of an episode [m]."""
    observation, info = finger.reset(options={"target": target})
    ended = False
    while not ended:
        action = np.clip(policy @ observation, -1.0, 1.0)
        observation, _, terminated, truncated, info = finger.step(action)
        ended = terminated or truncated
    return info["distance"]


known, unknown = random_targets(4, seed=1), random_targets(8, seed=2)
shape = finger.action_space.shape + finger.observation_space.shape
mean, spread, history = np.zeros(shape), np.full(shape, 3.0), []
for generation in range(GENERATIONS):
    policies = mean + spread * random.standard_normal((CANDIDATES, *shape))
    distances = [np.mean([last_distance(policy, one) for one in known]) for policy in policies]
    best = policies[np.argsort(distances)[:ELITE]]
    mean, spread = best.mean(axis=0), best.std(axis=0) + 0.3
    history.append(1e3 * np.mean([last_distance(mean, one) for one in unknown]))
    print(f"generation {generation + 1}: {history[-1]:.1f} mm from unknown targets")

plt.plot(range(1, GENERATIONS + 1), history, "o-")
plt.xlabel("generation")
plt.ylabel("distance to unknown targets [mm]")
plt.savefig("learning.png", dpi=100)
