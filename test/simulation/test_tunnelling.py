"""Fast bodies and thin obstacles: a body from above never ends below."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Simulation

# At 10 m/s the impact presses with ρv² = 1e5 Pa: softer elements would be squashed inside out.
MATERIAL = {"young_modulus": 5.0e5, "poisson_ratio": 0.3, "density": 1000.0}
OBSTACLES = {
    "sheet": {"box": {"size": [0.1, 0.1, 0.001]}},
    "wire": {"capsule": {"ends": [[-0.05, 0, 0], [0.05, 0, 0]], "radius": 0.0005}},
}
THICKNESS = 0.0005


def flying(scene_of, write_block, on, speed, step, kind) -> Simulation:
    """A body some 40 mm above a thin obstacle, moving down at full speed."""
    body = {"translation": [0.0013, 0.0007, 0.04 + 0.37 * speed * step]}
    scene = {
        "gravity": [0, 0, 0], "integration": "dynamic",
        "obstacles": [{"name": "thin", **OBSTACLES[on]}],
        "contact": {"friction": 0.3, "between": [{"pair": ["tip", "thin"]}]},
    }  # fmt: skip
    if kind == "rigid":
        return scene_of(**scene, rigid_bodies=[{
            "name": "tip", "mass": 0.01, "position": body["translation"],
            "velocity": [0, 0, -speed], "box": {"size": [0.03, 0.03, 0.03]},
        }])  # fmt: skip
    if kind == "turned":
        body["rotation"] = [0.3, 0.2, 0.1]
    file = write_block((0.01, 0.01, 0.03), (2, 2, 6))
    simulation = scene_of(**scene, body={
        "name": "tip", "mesh": {"file": file, **body}, "element": "linear", "material": MATERIAL,
    })  # fmt: skip
    velocities = np.zeros_like(simulation.state.velocities)
    velocities[:, 2] = -speed
    simulation.restore(replace(simulation.state, velocities=velocities))
    return simulation


def nodes_of(simulation, kind):
    """Points of the body's own: mesh nodes, or a rigid box's corners."""
    x = simulation.state.positions
    if kind != "rigid":
        return x
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    return x[0] + 0.015 * signs @ (x[1:] - x[0])


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["rigid", "upright", "turned"])
@pytest.mark.parametrize("step", [0.001, 0.005, 0.02])
@pytest.mark.parametrize("speed", [1.0, 3.0, 10.0])
def test_no_body_passes_through_a_sheet_of_a_millimetre(scene_of, write_block, speed, step, kind):
    simulation = flying(scene_of, write_block, "sheet", speed, step, kind)
    touched = False
    for _ in range(int(0.07 / speed / step) + 6):
        result = simulation.step(Hold(step))
        touched |= result.report.contact_count > 0
        # Not a single point is below the middle of the sheet.
        assert nodes_of(simulation, kind)[:, 2].min() > 0.0
    assert touched


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["upright", "turned"])
@pytest.mark.parametrize("step", [0.001, 0.005, 0.02])
@pytest.mark.parametrize("speed", [1.0, 3.0, 10.0])
def test_no_body_passes_through_a_wire_of_a_millimetre(scene_of, write_block, speed, step, kind):
    simulation = flying(scene_of, write_block, "wire", speed, step, kind)
    astride = True
    touched = False
    for _ in range(int(0.07 / speed / step) + 6):
        result = simulation.step(Hold(step))
        touched |= result.report.contact_count > 0
        x = nodes_of(simulation, kind)
        ends = x[simulation.model.bodies[0].mesh.cells[:, [0, 1, 0, 2, 0, 3, 1, 2, 1, 3, 2, 3]]]
        ends = ends.reshape(-1, 2, 3)
        shares = np.linspace(0.0, 1.0, 9)[:, None, None]
        inner = ((1.0 - shares) * ends[:, 0] + shares * ends[:, 1]).reshape(-1, 3)
        # It may fall off to one side; as long as it hangs over both, what is over the wire's
        # axis is above it.
        astride = astride and x[:, 1].min() < -THICKNESS and x[:, 1].max() > THICKNESS
        over = inner[np.abs(inner[:, 1]) < 0.5 * THICKNESS] if astride else inner[:0]
        assert over[:, 2].min(initial=1.0) > 0.0
    assert touched
