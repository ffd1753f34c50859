"""A soft strip pulled over a drum: friction lets its tension grow exponentially along the wrap."""

import meshio
import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, Status
from test.builder import builder

DRUM, THICKNESS, WIDTH, TAIL = 0.02, 0.001, 0.004, 0.02
INNER = 1.0005 * DRUM  # its facets, not its corners, lie on the drum
WRAP = np.pi
CELLS = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))


def bent(s: float, height: float) -> tuple[float, float]:
    """Where a point of the strip lies at rest, half around the drum, both tails hanging."""
    r = INNER + height
    if abs(s) <= 0.5 * WRAP * DRUM:
        return r * np.sin(s / DRUM), r * np.cos(s / DRUM)
    return np.sign(s) * r, 0.5 * WRAP * DRUM - abs(s)


@builder
def strip(tmp_path, /, count: int) -> str:
    """File of a strip of so many cells along."""
    length = WRAP * DRUM + 2.0 * TAIL
    nodes = [
        (x, y, z)
        for s in np.linspace(-0.5 * length, 0.5 * length, count + 1)
        for y in (-0.5 * WIDTH, 0.5 * WIDTH)
        for x, z in (bent(s, 0.0), bent(s, THICKNESS))
    ]
    corners = np.array([0, 4, 6, 2, 1, 5, 7, 3])
    tets = [4 * cell + corners[list(tet)] for cell in range(count) for tet in CELLS]
    meshio.write(tmp_path / "strip.vtk", meshio.Mesh(np.array(nodes), [("tetra", tets)]))
    return str(tmp_path / "strip.vtk")


def cable(name: str, side: float) -> dict:
    x = side * (INNER + 0.5 * THICKNESS)
    return {"name": name, "pull_point": [x, 0, -TAIL - 0.03], "points": [[x, 0, -TAIL]],
            "shortening": [-0.05, 0.02], "tension": [0, 50]}  # fmt: skip


@pytest.mark.parametrize("friction, cells", [
    (0.2, 28), pytest.param(0.2, 50, marks=pytest.mark.exhaustive),
    pytest.param(0.5, 40, marks=pytest.mark.exhaustive),
])  # fmt: skip
def test_tension_grows_along_the_wrap_by_the_capstan_equation(scene_of, strip, friction, cells):
    simulation = scene_of(
        gravity=[0, 0, 0], integration="dynamic",
        body={"name": "strip", "mesh": {"file": strip(cells)}, "damping": {"mass": 50.0},
              "element": "linear",
              "material": {"young_modulus": 5e6, "poisson_ratio": 0.0, "density": 1000.0}},
        obstacles=[{"name": "drum",
                    "cylinder": {"ends": [[0, -0.05, 0], [0, 0.05, 0]], "radius": DRUM}}],
        contact={"friction": friction, "alarm_distance": 0.001,
                 "between": [{"pair": ["strip", "drum"]}]},
        cables=[cable("loose", -1.0), cable("pulled", 1.0)],
        solver={"newton_iterations": 2},
    )  # fmt: skip
    rest = simulation.rest_setpoints
    for step in range(120):
        # Both are taut first; then only one is shortened, and the strip slides towards it.
        taut = 5e-4 * min(1.0, step / 20)
        wound = [taut, taut + 4e-3 * max(0.0, min(1.0, (step - 20) / 80))]
        result = simulation.step(CommandSetpoints(rest - np.array(wound), 0.01))
    assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
    # Friction acts on the strip's inner face, tension in its middle.
    lever = DRUM / (DRUM + 0.5 * THICKNESS)
    expected = np.exp(friction * WRAP * lever)
    assert result.efforts[1] / result.efforts[0] == pytest.approx(expected, rel=0.015)
