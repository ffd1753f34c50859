"""Fibres in a body: inextensible-fibre kinematics of braids, hoops, paths and edges of the mesh."""

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import Hold
from softrobot_twin.study.explain import effects

INNER, OUTER, HEIGHT = 0.008, 0.010, 0.06
MIDDLE = 0.009
"""Radius of the threads: within the wall of the tube, which has 16 facets."""
EA = 2.0e3


@pytest.fixture
def tube_entry(tmp_path, block):
    """Makes the entry of a soft tube about z whose ends are attached to two guided plates."""

    def make(poisson_ratio=0.0, cells=(16, 1, 12), element="quadratic") -> dict:
        mesh = block(size=(1.0, 1.0, 1.0), cells=cells, shake=0.0)
        turn, wall, height = mesh.node_positions.T
        radius, angle = OUTER + (INNER - OUTER) * wall, 2.0 * np.pi * turn
        x = np.stack([radius * np.cos(angle), radius * np.sin(angle), HEIGHT * height], axis=1)
        meshio.Mesh(x, [("tetra", mesh.cells)]).write(tmp_path / "tube.vtk")
        ends = [{"to": name, "box": {"minimum": [-1, -1, low], "maximum": [1, 1, high]}}
                for name, low, high in (("foot", -1, 1e-6), ("head", HEIGHT - 1e-6, 1))]  # fmt: skip
        return {
            "mesh": {"file": "tube.vtk", "merge_distance": 1e-6}, "element": element,
            "material": {"young_modulus": 1e4, "poisson_ratio": poisson_ratio, "density": 1.0},
            "attached": ends,
        }  # fmt: skip

    return make


@pytest.fixture
def stretched(simulate, tube_entry):
    """Makes a tube with fibres whose head has been moved along its axis; statics."""

    def make(stretch, fibres, **body):
        plate = {"motion": "guided", "sphere": {"radius": 1e-3}, "speed": 1.0}
        scene = simulate(
            body=tube_entry(**body), fibres=fibres, gravity=[0, 0, 0],
            rigid_bodies=[{"name": "foot", **plate},
                          {"name": "head", **plate, "position": [0, 0, HEIGHT]}],
            solver={"newton_iterations": 60, "residual_tolerance": 1e-7},
        )  # fmt: skip
        for share in np.linspace(0.0, 1.0, 5)[1:]:
            top = [0.0, 0.0, HEIGHT * (1.0 + share * (stretch - 1.0))]
            scene.model.guides.aim("head", top, [0, 0, 0, 1])
            result = scene.step(Hold(0.1))
        assert result.report.residual < 1e-6
        return scene

    return make


def helix(angle, **entries):
    """Threads at an angle to the axis, over the whole tube, without its clamped ends."""
    return {
        "name": "braid", "stiffness": EA, "helix": {
            "radius": MIDDLE, "pitch": 2.0 * np.pi * MIDDLE / np.tan(np.radians(angle)),
            "reach": [0.001, HEIGHT - 0.001], "count": 8, **entries},
    }  # fmt: skip


def middle_stretches(scene):
    """Mean stretch around and along the tube at mid-height, of nodes between its faces."""
    rest = scene.model.nodes.rest_positions[: scene.node_count]
    now = scene.state.positions[: scene.node_count]
    r0, r = (np.linalg.norm(x[:, :2], axis=1) for x in (rest, now))
    third = (np.abs(rest[:, 2] - HEIGHT / 2) < HEIGHT / 8) & (r0 > 0.0)
    along = np.polyfit(rest[third, 2], now[third, 2], 1)[0]
    return np.mean(r[third] / r0[third]), along


def fibre_stretches(scene):
    """Mean stretch around and along of the ends of the springs at mid-height."""
    (term,) = [term for term in scene.model.forces if term.name == "springs"]
    rest, now = (term.first.positions(x) for x in (scene.model.nodes.rest_positions,
                                                  scene.state.positions))  # fmt: skip
    return rest, now


@pytest.mark.parametrize(("angle", "stretch"), [(35.0, 1.06), (54.7, 1.15), (70.0, 1.15)])
def test_a_braided_tube_contracts_as_inextensible_threads_make_it(stretched, angle, stretch):
    """cos²α λ_z² + sin²α λ_θ² = 1; the bare tube, ν = 0, would not contract at all."""
    bare = stretched(stretch, [])
    around, along = middle_stretches(bare)
    assert around == pytest.approx(1.0, abs=2e-3)
    braided = stretched(stretch, [helix(angle)])
    around, along = middle_stretches(braided)
    a = np.radians(angle)
    expected = np.sqrt((1.0 - (np.cos(a) * along) ** 2) / np.sin(a) ** 2)
    print(f"{angle}°: λz {along:.4f} λθ {around:.4f}, threads {expected:.4f}")
    assert 1.0 - expected > 0.02
    assert 1.0 - around == pytest.approx(1.0 - expected, rel=0.06)
