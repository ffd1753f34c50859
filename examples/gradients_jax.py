"""Poses of a robot inside JAX: their derivatives by its design come from the adjoint.

Heights of a finger's cable [mm] go in, places of its tip and tensions come out; any loss may follow.
Here it is the distance from wanted places. Writes ``gradients_jax.png``. Needs JAX and matplotlib:

    python examples/gradients_jax.py
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

import softrobot_twin as st

SCENE = Path(__file__).resolve().parents[1] / "config/scenes/finger.yaml"
jax.config.update("jax_enable_x64", True)  # single precision is too coarse for balance


def poses_of(model):
    """Values of the variables -> places of effectors, efforts; also inside ``jax.jit``."""
    like = jax.tree.map(lambda one: jax.ShapeDtypeStruct(one.shape, one.dtype), model.solve(model.start).found)

    def solve(values):
        return jax.pure_callback(lambda own: model.solve(np.asarray(own)).found, like, values)

    def gradient(values, *weights):
        return model.gradient(np.asarray(values), st.Equilibria(*map(np.asarray, weights)))

    poses = jax.custom_vjp(solve)
    poses.defvjp(lambda values: (solve(values), values), lambda values, weights: (
        jax.pure_callback(gradient, jax.ShapeDtypeStruct(values.shape, values.dtype), values, *weights),))
    return poses


finger = st.load(SCENE)
heights = {f"height_{place}": {f"cables.flexor.points[{place}][2]": 1e-3} for place in (1, 4)}
model = finger.design_model(heights, [st.setpoints(flexor_shortening_m=pull) for pull in (0.006, 0.012)])
poses, wanted = poses_of(model), model.solve([0.8, -1.2]).found.effectors


def loss(values):
    """Squared distance from the wanted places [mm²]."""
    return ((1e3 * (poses(values).effectors - wanted)) ** 2).sum()


losses, slopes = [], jax.jit(jax.value_and_grad(loss))
found = minimize(lambda values: tuple(map(np.array, slopes(values))), [0.0, 0.0], jac=True, tol=1e-4,
                 callback=lambda values: losses.append(float(loss(values))))
print(f"heights {found.x} mm, wanted 0.8 and -1.2 mm")

plt.semilogy([float(loss(np.zeros(2))), *losses], "o-")
plt.xlabel("step")
plt.ylabel("squared distance [mm²]")
plt.savefig("gradients_jax.png", dpi=100)
