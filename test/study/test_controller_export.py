"""``reduce --export``: the lines of docs/reduced_controller.md step what the package steps."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrobot_twin.__main__ import main
from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.reduced_elements import SampledPoints, all_points
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.loading import written_out
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from softrobot_twin.simulation.building.reduced_body import (
    BodyReduction,
    read_body_reduction,
    reduction_fingerprints,
    write_body_reduction,
)
from softrobot_twin.simulation.building.scene_layout import lay_out
from softrobot_twin.study.controller_export import controller_arrays, export_controller

pytestmark = pytest.mark.libraries

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "reduced_controller.md"
EXACT = {"newton_iterations": 30, "residual_tolerance": 1e-10}
METRE = 1e-9
"""How far positions, shortenings and coordinates may differ where both have settled [m]."""


def write_scene(path, mapping):
    path.write_text(yaml.safe_dump(mapping))
    return path


def trained(scene, *options):
    """File of a controller, made as a user makes it; and the scene with its body reduced."""
    files = [scene.with_name(f"{scene.stem}_{name}.npz") for name in ("reduced", "robot")]
    arguments = ["reduce", scene, "--output", files[0], "--export", files[1], "--workers", 1,
                 "--states", 0, *options]  # fmt: skip
    assert main([str(argument) for argument in arguments]) == 0
    return files[1], reduced_by(scene, files[0])


def reduced_by(scene, file):
    """Scene file with its body reduced, and solved exactly."""
    mapping = yaml.safe_load(scene.read_text())
    mapping["body"]["reduced"], mapping["solver"] = {"file": str(file)}, EXACT
    reduced = scene.with_name(f"{scene.stem}_reduced.yaml")
    return write_scene(reduced, mapping)


def in_polynomials(scene, every=1):
    """The same of a body whose modes are polynomials that vanish at z = 0, with some of its points:
    nothing is trained; with all points the package rounds no gradients."""
    (body,) = lay_out(load_scene(scene), []).bodies
    x, y, z = (body.mesh.node_positions / np.ptp(body.mesh.node_positions, axis=0)).T
    fields = np.stack([z, z**2, z**3, z**4, z * x, z * y, z**2 * x, z**2 * y])
    fields /= np.abs(fields).max(axis=1, keepdims=True)
    basis = np.einsum("fn,ij->nifj", fields, np.eye(3)).reshape(len(x), 3, -1)
    (block,) = body.mesh.blocks()
    points = SampledPoints(*(field[::every] for field in all_points(block)))
    points = points._replace(weights=every * points.weights)
    count = basis.shape[2]
    reduction = BodyReduction(
        basis, count, points, points, np.full(count, 0.005), np.full(2, np.nan), {}
    )
    write_body_reduction(scene.with_suffix(".npz"), reduction, reduction_fingerprints(body))
    reduced = reduced_by(scene, scene.with_suffix(".npz"))
    robot = scene.with_name(f"{scene.stem}_robot.npz")
    export_controller(load_scene(reduced), robot)
    return robot, reduced


@pytest.fixture(scope="module")
def page():
    """The lines of the page, run; and those that show how they are used."""
    *blocks, usage = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    lines = {}
    exec(compile("\n".join(blocks), str(PAGE), "exec"), lines)
    return lines, usage


@pytest.fixture(scope="module")
def diamond(tmp_path_factory):
    mapping = written_out(yaml.safe_load((ROOT / "config/scenes/diamond.yaml").read_text()))
    mapping["body"]["mesh"]["file"] = str(ROOT / "meshes/diamond_150.vtk")
    mapping["body"]["element"] = "linear"
    scene = write_scene(tmp_path_factory.mktemp("diamond") / "diamond.yaml", mapping)
    return trained(scene, "--snapshots", 40, "--modes", 15, "--spare-modes", 3)


@pytest.fixture(scope="module")
def with_all_points(diamond):
    """The same modes with all points of the mesh."""
    reduced = diamond[1]
    file = Path(yaml.safe_load(reduced.read_text())["body"]["reduced"]["file"])
    (body,) = lay_out(without_reductions(load_scene(reduced)), []).bodies
    (block,) = body.mesh.blocks()
    trained, points = read_body_reduction(file, body), all_points(block)
    all_of_it = trained._replace(sampled=points, spare_sampled=points)
    write_body_reduction(file.with_stem("all"), all_of_it, reduction_fingerprints(body))
    scene = reduced_by(reduced, file.with_stem("all"))
    export_controller(load_scene(scene), robot := file.with_stem("robot_of_all"))
    return robot, scene


@pytest.fixture(scope="module")
def air(air_scene, tmp_path_factory):
    """Three cavities, one of them by volume, and a cable; a rubber."""
    material = air_scene["body"]["material"] | {"law": "neo_hookean"}
    mapping = air_scene | {"solver": {}, "body": air_scene["body"] | {"material": material}}
    mapping["effectors"] = [{"name": "top", "points": [[0.01, 0.01, 0.1], [0.0, 0.0, 0.1]],
                             "directions": ["x", "z"], "weight": 2.0}]  # fmt: skip
    return in_polynomials(write_scene(tmp_path_factory.mktemp("air") / "air.yaml", mapping))


@pytest.fixture(scope="module")
def slender(column, tmp_path_factory):
    """A column that buckles where tensions are held, and not where lengths are."""
    mapping = yaml.safe_load(column.read_text())
    mapping["body"]["mesh"]["file"] = str(column.parent / "column.vtk")
    scene = write_scene(tmp_path_factory.mktemp("slender") / "slender.yaml", mapping)
    return in_polynomials(scene, every=3)


class Pair:
    """One robot in the lines of the page and in the package."""

    def __init__(self, page, files):
        lines, _ = page
        self.step, self.robot = lines["step"], lines["load"](files[0])
        self.package = Simulation(load_scene(files[1]), with_warnings=False)
        self.lines = lines
        count = len(self.robot["actuators"])
        self.state = np.zeros(len(self.robot["load"])), np.zeros(count), np.zeros(count)

    def settle(self, dt=0.05, steps=60, **asked):
        """Step both until both have settled; gives the status of the package."""
        robot = self.robot
        if "drives" in asked:
            setpoints = robot["setpoint_rest"] + robot["setpoint_slope"] * asked["drives"]
            command = CommandSetpoints(setpoints, dt)
        else:
            command = FollowTargets(asked["targets"], dt)
        for _ in range(steps):
            before = self.values()
            self.state = self.step(robot, self.state, dt, iterations=4, **asked)
            result = self.package.step(command)
            if all(abs(a - b).max() <= 1e-13 * (1.0 + abs(a).max())
                   for a, b in zip(before, self.values(), strict=True)):
                break
        return result.status

    def values(self):
        """Coordinates, tips, drives and efforts by the lines, then by the package."""
        package, robot = self.package, self.robot
        nodes = package.model.bodies[0].reduction.coordinate_nodes
        tips = robot["effector_rest"] + robot["effector_modes"] @ self.state[0]
        return (
            self.state[0], tips, *self.state[1:], package.state.positions[nodes].ravel(),
            package.effector_positions(), package.actuators.drives(package.state.setpoints),
            package.state.efforts,
        )

    def assert_same(self, effort_error=1e-9, length_error=METRE):
        q, tips, drives, efforts, own_q, own_tips, own_drives, own_efforts = self.values()
        scale = np.where(self.robot["is_effort_driven"], np.abs(own_efforts).max(), 1.0)
        np.testing.assert_allclose(q, own_q, atol=length_error, rtol=0)
        np.testing.assert_allclose(tips, own_tips, atol=METRE, rtol=0)
        np.testing.assert_allclose(drives / scale, own_drives / scale, atol=length_error, rtol=0)
        np.testing.assert_allclose(
            efforts, own_efforts, atol=effort_error * np.abs(own_efforts).max(), rtol=0
        )


def test_given_lengths_lead_to_the_same_shape(page, diamond, drawn_rng):
    pair, moved = Pair(page, diamond), 0.0
    for _ in range(3):
        drives = drawn_rng.uniform(0.0, 0.02, 4)
        assert pair.settle(drives=drives).name == "OK"
        np.testing.assert_array_equal(pair.state[1], drives)
        pair.assert_same()
        moved = max(moved, np.abs(pair.values()[1] - pair.robot["effector_rest"]).max())
    assert moved > 1e-3


def test_a_cable_that_others_slacken_pulls_with_nothing(page, diamond):
    pair = Pair(page, diamond)
    pair.settle(drives=np.array([0.02, 0.0, 0.02, 0.0]))
    pair.settle(drives=np.array([0.03, 0.0, 0.03, 0.0]))
    pair.assert_same()
    assert pair.state[2][[1, 3]].max() < 1e-12 and pair.state[2][0] > 1.0  # N


@pytest.mark.exhaustive
def test_targets_lead_to_the_same_lengths(page, with_all_points):
    """The package rounds the tangents of points that are sampled, and which of four cables pull how

    much follows from these by whatever factor the training led to; of all points it rounds none.
    """
    pair = Pair(page, with_all_points)
    for offset in ([0.008, 0.0, 0.006], [-0.005, 0.006, 0.008], [0.0, 0.0, 0.01]):
        target = pair.robot["effector_rest"] + offset
        assert pair.settle(targets=target).name == "OK"
        pair.assert_same(effort_error=1e-8)
        assert np.abs(pair.values()[1] - target).max() < 1e-5


def test_with_sampled_points_targets_are_reached_at_the_same_tips(page, diamond):
    pair = Pair(page, diamond)
    for offset in ([0.008, 0.0, 0.006], [-0.005, 0.006, 0.008], [0.0, 0.0, 0.01]):
        target = pair.robot["effector_rest"] + offset
        assert pair.settle(targets=target).name == "OK"
        _, tips, *_ = values = pair.values()
        np.testing.assert_allclose(tips, values[5], atol=METRE, rtol=0)
        assert np.abs(tips - target).max() < 1e-5


def test_a_target_out_of_reach_is_left_at_the_same_limits(page, diamond):
    pair = Pair(page, diamond)
    target = pair.robot["effector_rest"] + [0.0, 0.0, -0.06]
    pair.settle(targets=target)
    q, tips, drives, *_ = pair.values()
    np.testing.assert_allclose(tips, pair.package.effector_positions(), atol=1e-5)
    limits = pair.robot["displacement_limits"]
    assert (drives >= limits[:, 0]).all() and (drives <= limits[:, 1]).all()


def test_drives_follow_no_faster_than_their_rate(page, diamond):
    pair = Pair(page, diamond)
    target = pair.robot["effector_rest"] + [0.01, 0.0, -0.01]
    reach = 0.002 * pair.robot["rate"]
    for _ in range(10):
        before = pair.state[1]
        pair.state = pair.step(pair.robot, pair.state, 0.002, targets=target)
        assert (np.abs(pair.state[1] - before) <= reach * (1.0 + 1e-9)).all()
    assert np.isclose(np.abs(pair.state[1] - before), reach).any()


def test_a_body_that_is_stable_at_held_lengths_only_is_the_same(page, slender):
    pair = Pair(page, slender)
    drives = np.array([0.0097, 0.006, 0.0157, 0.0154])
    for share in np.linspace(0.1, 1.0, 10):
        pair.settle(drives=share * drives, steps=20 if share == 1.0 else 3)
    pair.assert_same(effort_error=1e-8)
    K = pair.lines["elastic"](pair.robot, pair.state[0])[1]
    K = K + pair.lines["rows"](pair.robot, pair.state[0], pair.state[2])[2]
    assert np.linalg.eigvalsh(K)[0] < 0.0


def test_pressures_volumes_and_cables_lead_to_the_same_shape(page, air):
    pair = Pair(page, air)
    assert pair.robot["actuators"].tolist() == ["east", "low", "high", "syringe"]
    assert pair.robot["is_effort_driven"].tolist() == [False, True, True, False]
    for drives in ([0.002, 1.0e4, -2.0e3, 2.0e-7], [0.005, 0.0, 8.0e3, -1.0e-7]):
        assert pair.settle(drives=np.array(drives)).name == "OK"
        pair.assert_same(effort_error=1e-8)
        np.testing.assert_array_equal(pair.state[2][1:3], drives[1:3])


@pytest.mark.exhaustive
def test_targets_lead_to_the_same_pressures(page, air):
    there = Pair(page, air)
    pair = Pair(page, air)
    for drives in ([0.003, 8.0e3, 2.0e3, 2.0e-7], [0.005, 4.0e3, 5.0e3, 1.0e-7]):
        there.settle(drives=np.array(drives))
        target = there.values()[1].copy()
        target[:, 1] = np.nan
        assert pair.settle(targets=target).name == "OK"
        pair.assert_same(effort_error=1e-6)
        assert np.nanmax(np.abs(pair.values()[1] - target)) < 1e-5


def test_stiffness_is_the_derivative_of_the_forces(page, diamond, air, drawn_rng):
    lines, _ = page
    for file, efforts in ((diamond[0], [1.0, 0.0, 2.0, 3.0]), (air[0], [1.0, 2e3, -1e3, 5e3])):
        robot, efforts = lines["load"](file), np.array(efforts)

        def forces(q):
            moved, H, _ = lines["rows"](robot, q, efforts)
            return lines["elastic"](robot, q)[0] + H.T @ efforts, moved

        q, dq = (drawn_rng.uniform(-1.0, 1.0, len(robot["load"])) * robot["coordinate_ranges"]
                 for _ in range(2))  # fmt: skip
        q, dq = 0.5 * q, 1e-4 * dq
        K = lines["elastic"](robot, q)[1] + lines["rows"](robot, q, efforts)[2]
        (ahead, far), (behind, near) = forces(q + dq), forces(q - dq)
        change = 0.5 * (behind - ahead)
        np.testing.assert_allclose(K @ dq, change, atol=1e-6 * np.abs(change).max())
        moved = 0.5 * (far - near)
        H = lines["rows"](robot, q, efforts)[1]
        np.testing.assert_allclose(H @ dq, moved, atol=1e-6 * np.abs(moved).max())


def test_the_use_that_the_page_shows_runs(page, diamond, monkeypatch):
    lines, usage = page
    monkeypatch.chdir(diamond[0].parent)
    diamond[0].rename("robot.npz")
    try:
        names = dict(lines)
        exec(usage, names)
    finally:
        Path("robot.npz").rename(diamond[0])
    assert np.linalg.norm(names["tip"] - names["target"]) < 1e-4
    assert names["setpoints"].shape == (4,) and 0.0 < names["spread"] < 1.0


def test_the_table_of_the_page_names_every_array_and_its_shape(air, diamond):
    page = PAGE.read_text()
    for file in (air[0], diamond[0]):
        with np.load(file) as saved:
            arrays = dict(saved)
        counts = {"m": len(arrays["load"]), "p": len(arrays["weights"]), "3": 3, "9": 9, "2": 2,
                  "a": len(arrays["actuators"]), "v": len(arrays["cavity_linear"]),
                  "n": len(arrays["cable_rest"]), "e": len(arrays["effectors"])}  # fmt: skip
        counts["n - c"] = counts["n"] - (counts["a"] - counts["v"])
        for name, array in arrays.items():
            (row,) = [line for line in page.splitlines() if line.startswith("| `")
                      and f"`{name}`" in line.split("|")[1]]  # fmt: skip
            shape = re.findall(r"n - c|\w+", row.split("|")[2])
            assert tuple(counts[letter] for letter in shape) == array.shape, name


def test_the_file_says_what_it_is(diamond):
    with np.load(diamond[0], allow_pickle=False) as saved:
        readme = str(saved["readme"])
        assert saved["gradients"].dtype == np.float32
    for words in ("diamond", "corotational", "15 coordinates", "north", "tip", "controller.md"):
        assert words in readme


def test_a_reduced_scene_is_exported_without_training(diamond, call, tmp_path, monkeypatch):
    from softrobot_twin.study import controller_export
    monkeypatch.setattr(controller_export, "reduce", None)
    done = call("reduce", diamond[1], "--export", tmp_path / "again.npz")
    assert done.code == 0, done.errors
    assert "15 coordinates" in done.output and "4 actuators" in done.output
    with np.load(diamond[0]) as first, np.load(tmp_path / "again.npz") as second:
        assert first.files == second.files
        for name in first.files:
            if name != "newton_iterations":  # that of the scene
                np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.parametrize("change, key", [
    ({"contact": {"between": [{"pair": ["body", "ball"]}]},
      "obstacles": [{"name": "ball", "sphere": {"centre": [0, 0, 1], "radius": 0.1}}]},
     "contact"),
    ({"integration": "dynamic"}, "integration"),
    ({"touches": [{"name": "side", "points": [[0.01, 0.01, 0.1]]}]}, "touches"),
    ({"friction": 0.1}, r"cables\[0\].friction"),
    ({"axial_stiffness": 1e4}, r"cables\[0\].axial_stiffness"),
    ({"orientation": {}}, r"effectors\[0\].orientation"),
    ({}, "body.reduced"),
])  # fmt: skip
def test_what_the_lines_cannot_step_is_refused_by_name(column, change, key, tmp_path):
    mapping = yaml.safe_load(column.read_text())
    mapping["body"]["mesh"]["file"] = str(column.parent / "column.vtk")
    parts = {"friction": mapping["cables"][0], "axial_stiffness": mapping["cables"][0],
             "orientation": mapping["effectors"][0], "law": mapping["body"]["material"]}  # fmt: skip
    parts.get(next(iter(change), ""), mapping).update(change)
    scene = tmp_path / "scene.yaml"
    scene.write_text(yaml.safe_dump(mapping))
    with pytest.raises(SceneError, match=rf"scene.yaml:\d+: {key} = .*not built for a reduced"):
        controller_arrays(load_scene(scene))


@pytest.mark.parametrize("change, told", [
    ({"integration": "dynamic"}, "integration = 'dynamic': motion: not built"),
    ({"law": "saint_venant_kirchhoff"}, "body.material.law = 'saint_venant_kirchhoff': a law other"),
])  # fmt: skip
def test_what_cannot_be_exported_is_not_trained_first(air_scene, change, told, call, tmp_path):
    body = air_scene["body"] | {"material": air_scene["body"]["material"] | change}
    scene = tmp_path / "scene.yaml"
    write_scene(scene, air_scene | (change if "integration" in change else {"body": body}))
    done = call("reduce", scene, "--export", tmp_path / "robot.npz")
    assert done.code == 2 and told in done.errors
    assert [file.name for file in tmp_path.iterdir()] == ["scene.yaml"]
