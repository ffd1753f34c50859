"""Inflation against closed forms, and past a limit point."""

import meshio
import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, Status
from test.builder import builder
from test.scene_changes import repeat_step

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


@pytest.mark.exhaustive
def test_a_long_cylinder_grows_as_by_lame(inflated_shell):
    sectors, half, pressure = 12, 8, 100.0
    angle = np.linspace(0.0, 2.0 * np.pi, sectors, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    heights = np.linspace(-0.05, 0.05, 2 * half + 1)
    caps = len(heights) * sectors + np.arange(2)
    triangles = []
    for k in range(len(heights) - 1):
        for i in range(sectors):
            a, b = k * sectors + i, k * sectors + (i + 1) % sectors
            triangles += [(a, b, b + sectors), (a, b + sectors, a + sectors)]
    for i in range(sectors):
        j, top = (i + 1) % sectors, (len(heights) - 1) * sectors
        triangles += [(j, i, caps[0]), (top + i, top + j, caps[1])]
    layers = []
    for radius in np.linspace(INNER, OUTER, 4):
        scale = 1.0 + (radius - INNER) / 0.05
        wall = [np.column_stack([radius * ring, np.full(sectors, scale * z)]) for z in heights]
        ends = [[0.0, 0.0, scale * heights[0]], [0.0, 0.0, scale * heights[-1]]]
        layers.append(np.vstack([*wall, ends]))
    simulation = inflated_shell(layers, np.array(triangles))
    result = simulation.step(CommandSetpoints([pressure], STEP))
    middle = half * sectors + np.arange(sectors)
    moved = (result.state.positions[middle] - layers[0][middle])[:, :2]
    outward = float(np.mean(np.sum(moved * ring, axis=1)))
    a2, b2 = INNER**2, OUTER**2
    expected = pressure * INNER / YOUNG * ((1 - 2 * POISSON) * a2 + (1 + POISSON) * b2) / (b2 - a2)
    # A polygon of 12 sides has 95.5 % of the circle's area.
    assert outward == pytest.approx(expected, rel=0.06)


@pytest.fixture
def dome(simulate, hollow):
    """Makes a chamber under a flat dome, 2 mm thick and 5 mm high, clamped all around."""
    height, rise, cells = 0.04, 0.005, 8

    def make(**entries):
        soft, surface = hollow(
            size=(0.1, 0.1, height), cells=(cells + 2, cells + 2, 4),
            hole=((1, cells + 1), (1, cells + 1), (1, 3)), element="quadratic",
        )  # fmt: skip
        border = 0.1 / (cells + 2)
        for file in (soft["mesh"]["file"], surface):
            mesh = meshio.read(file)
            x, y, z = mesh.points.T
            across = [np.sin(np.pi * np.clip((c - border) / (0.1 - 2 * border), 0, 1)) for c in (x, y)]
            top = 0.75 * height
            lifted = np.where(z > top, top + 0.2 * (z - top), z)
            ramp = np.clip((z - 0.25 * height) / (0.5 * height), 0, 1)
            mesh.points = np.column_stack([x, y, lifted + rise * across[0] * across[1] * ramp])
            mesh.write(file)
        low, high = border + 1e-4, 0.1 - border - 1e-4
        boxes = [((-1, -1, -1), (1, 1, 0.25 * height + 1e-6)), ((-1, -1, -1), (low, 1, 1)),
                 ((high, -1, -1), (1, 1, 1)), ((-1, -1, -1), (1, low, 1)),
                 ((-1, high, -1), (1, 1, 1))]  # fmt: skip
        soft["fixed"] = [{"box": {"minimum": a, "maximum": b}} for a, b in boxes]
        soft["material"]["young_modulus"] = 1e6
        cavity = {"name": "air", "walls": [{"file": surface}], "pressure": [-1e4, 1e4], **entries}
        return simulate(gravity=[0.0, 0.0, 0.0], body=soft, cavities=[cavity])

    return make


@pytest.mark.exhaustive
def test_a_volume_passes_the_limit_points_of_a_dome(dome):
    simulation, pressures, iterations = dome(control="volume"), [0.0], []
    shares = np.linspace(0.0, 1.0, 33)[1:]
    for share in shares:
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 2e-5 * share, 0.02))
        assert result.status is Status.OK
        pressures.append(float(result.efforts[0]))
        iterations.append(result.report.iterations)
    slopes = np.sign(np.diff(pressures))
    turns = np.flatnonzero(slopes[1:] != slopes[:-1])
    # Down to the first limit point, up to the second, and down again.
    assert len(turns) == 2 and slopes[0] == slopes[-1] == -1.0
    assert pressures[turns[0] + 1] < 1.4 * pressures[turns[1] + 1] < 0.0
    # Between them the body is unstable at a given pressure, and Newton still converges fast.
    assert max(iterations) <= 6
    # The way back is the same: nothing of it depends on the past.
    for share, pressure in zip(shares[::-1], pressures[:0:-1], strict=True):
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 2e-5 * share, 0.02))
        assert result.efforts[0] == pytest.approx(pressure, abs=1e-3)


@pytest.mark.exhaustive
def test_a_pressure_beyond_the_limit_point_of_a_dome_lets_it_snap_to_another_balance(dome):
    simulation = dome()
    before = simulation.step(CommandSetpoints([-90.0], 0.02))
    assert before.status is Status.OK and before.displacements[0] > -5e-6
    after = repeat_step(simulation, CommandSetpoints([-105.0], 0.02), 5)
    assert after.displacements[0] < -1e-5
    assert after.status is Status.OK and after.report.residual < 1e-8
