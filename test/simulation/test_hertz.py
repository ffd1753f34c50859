"""A ball pressed on a soft block, against Hertz: F = 4/3 E* √R δ^1.5."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Status
from test.builder import builder

RADIUS, SIZE, HEIGHT = 0.05, 0.1, 0.08
YOUNG, POISSON = 1.0e5, 0.3
# Nodes draw together below the ball by this power.
GRADING = 2.2


def drawn_together(x):
    """Cells grow from the middle of the top outwards and downwards."""
    out = x.copy()
    across = x[:, :2] / (SIZE / 2)
    out[:, :2] = SIZE / 2 * np.sign(across) * np.abs(across) ** GRADING
    out[:, 2] = HEIGHT / 2 - HEIGHT * ((HEIGHT / 2 - x[:, 2]) / HEIGHT) ** GRADING
    return out


@builder
def pressed(scene_of, write_block, /, cells, depth, element="linear") -> float:
    """Force of a ball, pressed in by a depth, on a block of some cells across [N]."""
    simulation = scene_of(
        gravity=[0, 0, 0],
        body={"name": "block", "element": element,
              "mesh": {"file": write_block((SIZE, SIZE, HEIGHT), (cells, cells, cells // 2),
                                           drawn_together, shake=0.0)},
              "material": {"young_modulus": YOUNG, "poisson_ratio": POISSON,
                           "density": 1000.0},
              "fixed": [{"box": {"minimum": [-1, -1, -1],
                                 "maximum": [1, 1, -HEIGHT / 2 + 1e-6]}}]},
        rigid_bodies=[{"name": "ball", "motion": "guided",
                       "position": [0, 0, HEIGHT / 2 + RADIUS], "sphere": {"radius": RADIUS}}],
        contact={"alarm_distance": 0.002, "between": [{"pair": ["block", "ball"]}]},
    )  # fmt: skip
    simulation.model.guides.aim("ball", [0, 0, HEIGHT / 2 + RADIUS - depth])
    forces = []
    for _ in range(16):
        result = simulation.step(Hold(1.0))
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
        forces.append(-result.contacts.forces.sum(axis=0)[2])
    # Facets rock on the ball from step to step: the mean of the last ones is meant.
    return float(np.mean(forces[-8:]))


def hertz(depth) -> float:
    """Force on a half space [N], and the share that a glued layer of this height adds.

    The layer's correction: Dimitriadis et al. 2002, with χ = √(R δ) / height.
    """
    half_space = 4.0 / 3.0 * YOUNG / (1.0 - POISSON**2) * np.sqrt(RADIUS) * depth**1.5
    chi = np.sqrt(RADIUS * depth) / HEIGHT
    alpha = -(1.2876 - 1.4678 * POISSON + 1.3442 * POISSON**2) / (1.0 - POISSON)
    slope = -2.0 * alpha / np.pi * chi
    return half_space * (1.0 + slope + slope**2)


@pytest.mark.exhaustive
def test_linear_elements_converge_to_hertz_as_the_mesh_is_refined(pressed):
    ratios = np.array([pressed(cells, 0.001) / hertz(0.001) for cells in (8, 12, 16, 20)])
    assert np.all(np.diff(ratios) < 0.0)
    assert 1.0 < ratios[-1] < 1.13
    # With cells of half the size well over half of the error is gone.
    assert ratios[2] - 1.0 < 0.42 * (ratios[0] - 1.0)


@pytest.mark.exhaustive
def test_quadratic_elements_agree_with_hertz(pressed):
    assert pressed(12, 0.001, "quadratic") == pytest.approx(hertz(0.001), rel=0.035)
