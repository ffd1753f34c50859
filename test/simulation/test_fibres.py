"""Fibres in a body: inextensible-fibre kinematics of braids, hoops, paths and edges of the mesh."""

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import Hold
from test.builder import builder
from test.scene_changes import repeat_step

INNER, OUTER, HEIGHT = 0.008, 0.010, 0.06
MIDDLE = 0.009
"""Radius of the threads: within the wall of the tube, which has 16 facets."""
EA = 200.0


@builder
def tube_entry(tmp_path, block, /, poisson_ratio=0.0, cells=(16, 1, 12), element="quadratic") -> dict:
    """Makes the entry of a soft tube about z whose ends are attached to two guided plates."""
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


@builder
def stretched(simulate, tube_entry, /, stretch, fibres, **body):
    """Makes a tube with fibres whose head has been moved along its axis; statics."""
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


def thread_stretches(scene):
    """Strain of each segment of the threads."""
    (term,) = [term.on_points for term in scene.model.forces if term.name == "springs"]
    return term.lengths(scene.state.positions) / term.rest_lengths - 1.0


@pytest.mark.exhaustive
@pytest.mark.parametrize(("angle", "stretch"), [(35.0, 1.06), (54.7, 1.1), (60.0, 1.1)])
def test_a_braided_tube_contracts_as_inextensible_threads_make_it(stretched, angle, stretch):
    """cos²α λ_z² + sin²α λ_θ² = 1; the bare tube, ν = 0, does not contract at all."""
    around, along = middle_stretches(stretched(stretch, []))
    assert around == pytest.approx(1.0, abs=2e-3)
    braided = stretched(stretch, [helix(angle)])
    assert np.abs(thread_stretches(braided)).max() < 2e-3
    around, along = middle_stretches(braided)
    a = np.radians(angle)
    expected = np.sqrt((1.0 - (np.cos(a) * along) ** 2) / np.sin(a) ** 2)
    print(f"{angle}°: λz {along:.4f} λθ {around:.4f}, threads {expected:.4f}")
    assert 1.0 - expected > 0.03
    assert 1.0 - around == pytest.approx(1.0 - expected, rel=0.04)


@pytest.mark.exhaustive
def test_hoops_stop_radial_growth_and_are_slack_where_the_tube_contracts(stretched):
    tight = helix(87.5, handedness="right", count=1, segments_per_turn=12)
    bare, _ = middle_stretches(stretched(0.95, [], poisson_ratio=0.45))
    hooped, _ = middle_stretches(stretched(0.95, [tight], poisson_ratio=0.45))
    assert bare > 1.02
    assert abs(hooped - 1.0) < 0.05 * (bare - 1.0)
    # Stretched along, the tube contracts, and the hoops are slack.
    bare = stretched(1.05, [], poisson_ratio=0.45)
    slack = stretched(1.05, [tight], poisson_ratio=0.45)
    np.testing.assert_allclose(slack.state.positions, bare.state.positions, atol=1e-6 * HEIGHT)
    both = stretched(1.05, [{**tight, "tension_only": False}], poisson_ratio=0.45)
    assert middle_stretches(bare)[0] < 0.98
    assert abs(middle_stretches(both)[0] - 1.0) < 0.05 * (1.0 - middle_stretches(bare)[0])


@builder
def bar(simulate, tmp_path, block, /, fibres, element="linear", gravity=(1.0, 0.0, 0.0)):
    """Makes a bar along x with fibres, held at its foot; its file names the edges `rim`."""
    mesh = block(size=(0.1, 0.02, 0.02), cells=(5, 1, 1), shake=0.0)
    x = mesh.node_positions
    along = np.flatnonzero((x[:, 1:] == 0.0).all(axis=1))
    along = along[np.argsort(x[along, 0])]
    rim = np.stack([along[:-1], along[1:]], axis=1)
    meshio.Mesh(
        x, [("tetra", mesh.cells), ("line", rim)],
        cell_sets={"rim": [np.empty(0, int), np.arange(len(rim))]},
    ).write(tmp_path / "bar.inp", file_format="abaqus")  # fmt: skip
    scene = simulate(
        body={
            "mesh": {"file": "bar.inp"}, "element": element,
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}],
        }, fibres=fibres, gravity=list(gravity),
    )  # fmt: skip
    result = repeat_step(scene, Hold(0.05), 4)
    assert result.report.residual < 1e-8
    return scene


ENDS = [[0.02 * k, 0.0, 0.0] for k in range(6)]


@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_edges_of_the_mesh_are_the_path_through_their_nodes(bar, element):
    edges = bar([{"name": "rim", "edges": "rim", "stiffness": 100.0}], element)
    path = bar([{"name": "rim", "points": ENDS, "stiffness": 100.0}], element)
    plain = bar([], element)
    np.testing.assert_allclose(edges.state.positions, path.state.positions, atol=1e-9)
    moved = np.abs(plain.state.positions - edges.state.positions).max()
    assert moved > 0.2 * np.abs(plain.state.positions - plain.model.nodes.rest_positions).max()


def test_a_pressed_thread_is_slack_unless_it_resists_both_ways(bar):
    up = (-1.0, 0.0, 0.0)
    plain = bar([], gravity=up).state.positions
    thread = {"name": "rim", "edges": "rim", "stiffness": 100.0}
    np.testing.assert_allclose(bar([thread], gravity=up).state.positions, plain, atol=1e-10)
    rod = bar([{**thread, "tension_only": False}], gravity=up)
    assert np.abs(rod.state.positions - plain).max() > 1e-5


@pytest.mark.parametrize("entry, key, told", [
    ({"edges": "seam"}, "fibres[0].edges",
     "bar.inp: has no set of edges named seam; of this kind it names rim"),
    ({}, "fibres[0]", "has exactly one of helix, points, edges"),
    ({"edges": "rim", "points": ENDS}, "fibres[0]", "exactly one of helix, points, edges"),
    ({"points": [[0, 0, 0], [0.1, 0, 0.05]]}, "fibres[0].points[1]", "outside the body"),
    ({"helix": {"radius": 0.05, "pitch": 0.1, "reach": [0, 0.02]}}, "fibres[0].helix",
     "outside the body"),
    ({"helix": {"radius": 0.05, "pitch": 0.1, "reach": [0.1, 0.02]}}, "fibres[0].helix",
     "is not before the last"),
    ({"helix": {"radius": 0.05, "pitch": 0.1, "reach": [0, 1], "direction": [0, 0, 0]}},
     "fibres[0].helix", "must not be zero"),
    ({"helix": {"radius": 0.05, "pitch": 1e-6, "reach": [0, 1]}}, "fibres[0].helix",
     "more than 50000: are pitch and reach in metres?"),
    ({"edges": "rim", "on": "other"}, "fibres[0].on", "which the scene does not have"),
])  # fmt: skip
def test_an_entry_that_cannot_be_used_is_refused(bar, entry, key, told):
    with pytest.raises(SceneError) as caught:
        bar([{"name": "f", "stiffness": 1.0, **entry}])
    assert caught.value.key.startswith(key) and told in str(caught.value)
