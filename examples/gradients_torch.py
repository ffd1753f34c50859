"""Poses of a robot inside PyTorch: their derivatives by its design come from the adjoint.

Heights of a finger's cable [mm] go in, places of its tip and tensions come out; any loss may follow.
Here it is the distance from wanted places. Writes ``gradients_torch.png``. Needs PyTorch, matplotlib:

    python examples/gradients_torch.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import torch

import softrobot_twin as st

SCENE = Path(__file__).resolve().parents[1] / "config/scenes/finger.yaml"


def poses_of(model):
    """Values of the variables -> places of effectors, efforts; tensors of double precision."""
    class Poses(torch.autograd.Function):
        @staticmethod
        def forward(context, values):
            context.save_for_backward(values)
            return tuple(map(torch.tensor, model.solve(values.numpy()).found))

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(context, *weights):
            by = st.Equilibria(*(one.numpy() for one in weights))
            return torch.tensor(model.gradient(context.saved_tensors[0].numpy(), by))

    return lambda values: st.Equilibria(*Poses.apply(values))


finger = st.load(SCENE)
heights = {f"height_{place}": {f"cables.flexor.points[{place}][2]": 1e-3} for place in (1, 4)}
model = finger.design_model(heights, [st.setpoints(flexor_shortening_m=pull) for pull in (0.006, 0.012)])
poses, wanted = poses_of(model), torch.tensor(model.solve([0.8, -1.2]).found.effectors)
values, losses = torch.zeros(2, dtype=torch.double, requires_grad=True), []
search = torch.optim.LBFGS([values], max_iter=12, line_search_fn="strong_wolfe")


def loss():
    """Squared distance from the wanted places [mm²]; its slopes go into the values."""
    search.zero_grad()
    distance = ((1e3 * (poses(values).effectors - wanted)) ** 2).sum()
    distance.backward()
    losses.append(distance.item())
    return distance


search.step(loss)
print(f"heights {values.detach().numpy()} mm, wanted 0.8 and -1.2 mm")

plt.semilogy(losses, "o-")
plt.xlabel("trial")
plt.ylabel("squared distance [mm²]")
plt.savefig("gradients_torch.png", dpi=100)
