"""Meshes of bad quality: faults are repaired and reported, or steps converge all the same."""

import itertools

import meshio
import numpy as np

from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation
from test.builder import builder

MATERIAL = {"young_modulus": 2.0e5, "poisson_ratio": 0.4, "density": 1070.0}


@builder
def column(block, tmp_path, /, spoil=None) -> Simulation:
    """Builds a column with one cable from a mesh that a function may spoil first."""
    mesh = block(size=(0.02, 0.02, 0.1), cells=(2, 2, 5), shake=0.0)
    points, tets = mesh.node_positions.copy(), mesh.cells.copy()
    if spoil is not None:
        points, tets = spoil(points, tets)
    file = tmp_path / "column.vtk"
    meshio.Mesh(points, [("tetra", tets)]).write(file)
    return Simulation(scene_from_mapping({
        "name": "column",
        "body": {
            "mesh": {"file": str(file)}, "element": "linear", "material": MATERIAL,
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.001]}}],
        },
        "cables": [{
            "name": "pull", "pull_point": [0.0, 0.01, -0.01],
            "points": [[0.0, 0.01, 0.03], [0.0, 0.01, 0.09]], "shortening": [0.0, 0.03],
            "tension": [0.0, 10.0],
        }],
        "effectors": [{"name": "tip", "points": [[0.01, 0.01, 0.095]]}],
    }))  # fmt: skip


def bent(simulation) -> np.ndarray:
    """Position of the tip with the shortened cable, at rest."""
    for _ in range(30):
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.004, 1.0))
        if result.report.residual < 1e-10:
            return result.effector_positions[0]
    raise AssertionError(f"residual {result.report.residual} N after 30 steps")


def with_a_sliver(points, tets):
    """Splits one tetrahedron by a node that lies almost in one of its faces."""
    corners = points[tets[100]]
    inside = corners[:3].mean(axis=0) + 2.0e-3 * (corners[3] - corners[:3].mean(axis=0))
    new = len(points)
    pieces = [np.where(np.arange(4) == i, new, tets[100]) for i in range(4)]
    return np.vstack([points, inside]), np.vstack([np.delete(tets, 100, axis=0), pieces])


def test_a_sliver_converges_to_the_same_shape_and_is_reported(column):
    plain, spoilt = column(), column(with_a_sliver)
    assert radius_ratios(spoilt.model.bodies[0].mesh).min() < 0.01
    assert any("radius ratio" in note for note in spoilt.notes)
    np.testing.assert_allclose(bent(spoilt), bent(plain), atol=2e-4)


def test_inverted_tetrahedra_are_repaired_with_a_warning_that_names_them(column):
    def swap(points, tets):
        tets[[3, 17], 0], tets[[3, 17], 1] = tets[[3, 17], 1], tets[[3, 17], 0].copy()
        return points, tets

    plain, spoilt = column(), column(swap)
    (note,) = spoilt.notes
    assert "3" in note and "17" in note and "invert" in note.lower()
    np.testing.assert_allclose(bent(spoilt), bent(plain), atol=1e-12)


def test_eight_cables_for_one_direction_are_unique_and_smooth(block, tmp_path):
    from softrobot_twin.simulation import FollowTargets

    mesh = block(size=(0.02, 0.02, 0.1), cells=(2, 2, 5), shake=0.0)
    file = tmp_path / "column.vtk"
    meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)]).write(file)
    cables = [
        {
            "name": f"c{x}{y}{top}",
            "pull_point": [0.02 * x, 0.02 * y, -0.01],
            "points": [[0.02 * x, 0.02 * y, 0.1 if top else 0.05]],
            "shortening": [0.0, 0.03],
            "tension": [0.0, 10.0],
        }
        for x, y, top in itertools.product((0, 1), repeat=3)
    ]
    scene = {
        "name": "column",
        "body": {
            "mesh": {"file": str(file)}, "element": "linear", "material": MATERIAL,
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 0.001]}}],
        },
        "cables": cables,
        "effectors": [{"name": "tip", "points": [[0.01, 0.01, 0.1]], "directions": ["x"]}],
    }  # fmt: skip

    def run():
        simulation = Simulation(scene_from_mapping(scene))
        start = simulation.effector_positions()
        steps = [
            simulation.step(FollowTargets(start + [[x, 0.0, 0.0]], 0.05))
            for x in np.linspace(0.0, 0.02, 80)
        ]
        return np.array([s.efforts for s in steps]), steps[-1].effector_errors[0]

    tensions, error = run()
    assert error < 1e-5
    np.testing.assert_array_equal(tensions, run()[0])
    bends = np.diff(tensions[5:], n=2, axis=0)
    assert np.abs(bends).max() < 0.02 * tensions.max()
