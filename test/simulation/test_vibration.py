"""A cantilever swings at the frequency of beam theory, however its mass is spread."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from softrobot_twin.simulation import Hold
from test.builder import builder

# Beam theory has no clamp that prevents lateral strain: without Poisson's ratio there is
# nothing to hinder.
E, POISSON, DENSITY, LENGTH, WIDTH = 1e5, 0.0, 1000.0, 0.2, 0.02
AREA, INERTIA = WIDTH**2, WIDTH**4 / 12.0
HELD = [{"box": {"minimum": [-1e-6, -1, -1], "maximum": [1e-6, 1, 1]}}]


def timoshenko_frequency():
    """First angular frequency of a Timoshenko cantilever [rad/s], by its transfer matrix."""
    shear = 10.0 * (1 + POISSON) / (12 + 11 * POISSON) * E / (2 * (1 + POISSON)) * AREA

    def end_determinant(omega):
        # Of deflection, turn, moment and shear force: w' = θ + Q/κGA, θ' = M/EI, and so on.
        matrix = np.zeros((4, 4))
        matrix[0, 1], matrix[0, 3] = 1.0, 1.0 / shear
        matrix[1, 2] = 1.0 / (E * INERTIA)
        matrix[2, 1], matrix[2, 3] = -DENSITY * INERTIA * omega**2, -1.0
        matrix[3, 0] = -DENSITY * AREA * omega**2
        return np.linalg.det(expm(LENGTH * matrix)[2:, 2:])

    slender = 1.875104**2 * np.sqrt(E * INERTIA / (DENSITY * AREA)) / LENGTH**2
    return brentq(end_determinant, 0.5 * slender, 1.1 * slender)


def swing_frequency(simulation, time_step, half_periods):
    """Angular frequency of the tip [rad/s] after its weight is let go, from where it turns back."""
    nodes = simulation.model.nodes
    tip = np.flatnonzero(nodes.rest_positions[nodes.free_nodes, 0] > LENGTH - 1e-6)
    speeds, turns = [0.0], []
    while len(turns) < half_periods:
        speeds.append(simulation.step(Hold(time_step)).state.velocities[tip, 2].mean())
        if speeds[-1] * speeds[-2] < 0.0:
            share = speeds[-2] / (speeds[-2] - speeds[-1])
            turns.append(time_step * (len(speeds) - 2 + share))
    slow = np.pi / np.diff(turns).mean()
    # Backward Euler turns by atan(ωh) where it should turn by ωh.
    return np.tan(slow * time_step) / time_step


@builder
def cantilever(simulate, body_of, block, /, cells, poisson_ratio=POISSON, **entries):
    """Makes a cantilever of square section that a weak weight bends."""
    mesh = block(size=(LENGTH, WIDTH, WIDTH), cells=cells, shake=0)
    body = body_of(mesh, young_modulus=E, poisson_ratio=poisson_ratio, fixed=HELD, **entries)
    return simulate(body=body, integration="dynamic", gravity=[0, 0, -0.05])


def test_shear_and_rotary_inertia_lower_the_frequency_of_a_beam():
    slender = 1.875104**2 * np.sqrt(E * INERTIA / (DENSITY * AREA)) / LENGTH**2
    assert 0.98 < timoshenko_frequency() / slender < 0.995


@pytest.mark.sampled
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
@pytest.mark.parametrize("element, cells, error", [
    ("smoothed", (30, 3, 3), 0.02), ("quadratic", (10, 1, 1), 0.003),
])  # fmt: skip
def test_a_cantilever_s_frequency_is_that_of_beam_theory(cantilever, element, cells, error, mass):
    found = swing_frequency(cantilever(cells, element=element, mass=mass), 0.012, 4)
    assert found == pytest.approx(timoshenko_frequency(), rel=error)


def test_a_clamp_that_prevents_lateral_strain_stiffens_the_beam_slightly(cantilever):
    beam = cantilever((10, 1, 1), poisson_ratio=0.3, element="quadratic", mass="consistent")
    free_to_widen = timoshenko_frequency()
    assert 1.003 * free_to_widen < swing_frequency(beam, 0.012, 4) < 1.02 * free_to_widen


def test_lumped_and_consistent_mass_converge_as_the_mesh_is_refined(cantilever):
    differences = []
    for cells in ((4, 1, 1), (8, 1, 1)):
        lumped, consistent = (
            swing_frequency(cantilever(cells, mass=mass), 0.005, 3)
            for mass in ("lumped", "consistent")
        )
        # Lumps are further out than what they stand for.
        assert lumped < consistent
        differences.append(1.0 - lumped / consistent)
    assert differences[1] < 0.5 * differences[0]
