"""Inflation against closed forms, and past a limit point."""

import meshio
import numpy as np

from softrobot_twin.simulation import CommandSetpoints
from test.builder import builder

YOUNG, POISSON = 1e5, 0.3
INNER, OUTER = 0.01, 0.015
# A drag so small, over a step so long, that a floating body comes to rest.
DRAG, STEP = 1.0, 1e3


@builder
def inflated_shell(simulate, body_of, tmp_path, layered, /, layers, triangles, **entries):
    """Makes a floating shell of layers, the first of which is the wall of its cavity."""
    mesh, file = layered(layers, triangles), tmp_path / "wall.vtk"
    meshio.write(file, meshio.Mesh(layers[0], [("triangle", triangles)]))
    body = body_of(mesh, "shell", YOUNG, POISSON, damping={"mass": DRAG}, element="quadratic",
                   **entries)  # fmt: skip
    body["material"]["law"] = "linear"
    cavity = {"name": "air", "walls": [{"file": str(file)}], "pressure": [0.0, 1e5]}
    return simulate(
        integration="first_order", gravity=[0.0, 0.0, 0.0], body=body, cavities=[cavity],
        # Displacements are small: more linearizations would only turn the body by round-off.
        solver={"newton_iterations": 1},
    )


def test_a_sphere_grows_as_by_lame(inflated_shell, icosphere):
    errors, pressure = [], 100.0
    for level, count in ((0, 3), (1, 5)):
        points, triangles = icosphere(level)
        radii = np.linspace(INNER, OUTER, count)
        simulation = inflated_shell([radius * points for radius in radii], triangles)
        result = simulation.step(CommandSetpoints([pressure], STEP))
        moved = result.state.positions[: len(points)] - radii[0] * points
        outward = float(np.mean(np.sum(moved * points, axis=1)))
        # Timoshenko and Goodier, Theory of Elasticity, section 136.
        a3, b3 = INNER**3, OUTER**3
        expected = pressure * INNER / YOUNG * (
            (1 - 2 * POISSON) * a3 + 0.5 * (1 + POISSON) * b3
        ) / (b3 - a3)  # fmt: skip
        errors.append(abs(outward / expected - 1.0))
    # The polyhedra have less volume and thinner walls than the sphere.
    assert errors[1] < 0.04 and errors[1] < 0.6 * errors[0], errors
