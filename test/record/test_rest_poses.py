"""Poses at rest, of recorded runs and of tables."""


import numpy as np
import pytest

from softrobot_twin.control.rest_watch import MOST_POSES, RestPose, RestWatch, Sample
from softrobot_twin.record.rest_poses import poses_of_run, poses_of_table, read_poses
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.tables.input_tables import Axes, AxesError, TableFileError

from .conftest import MESH, ROOT, Live


@pytest.fixture(scope="module")
def simulation():
    return Simulation(load_scene(ROOT / "config/scenes/diamond.yaml", {"body.mesh.file": str(MESH)}))


def sample(time, simulation, shortening=0.0, markers=0.0):
    command = simulation.rest_setpoints - shortening
    none = np.full(4, np.nan)
    seen = RestPose(none, simulation.marker_positions() + markers, np.full((1, 3), np.nan), none,
                    np.zeros((0, 3)))  # fmt: skip
    return Sample(time, command, seen)


def watched(simulation, samples):
    watch = RestWatch(simulation, "test")
    for one in samples:
        watch.add(one)
    watch.end()
    return watch


def test_a_rest_is_one_pose_and_motion_is_none(simulation):
    times = np.arange(0.0, 6.0, 0.05)
    shortening = np.where(times < 2.0, 0.0, np.where(times < 4.0, 0.005 * (times - 2.0), 0.01))
    watch = watched(simulation, [sample(t, simulation, s) for t, s in zip(times, shortening, strict=True)])
    assert len(watch.found) == 2
    assert watch.found[1].setpoints == pytest.approx(simulation.rest_setpoints - 0.01)
    assert watch.found[1].origin == "test at 5.95 s"
    assert watch.moving_time > 1.0
    assert "2 poses at rest" in watch.in_words() and "motion" in watch.in_words()


def test_rests_are_dropped_for_a_reason(simulation):
    times = np.arange(0.0, 2.0, 0.05)
    drifting = [sample(t, simulation, 0.0, 0.002 * t) for t in times]
    unseen = [sample(t + 3.0, simulation, 0.01, np.nan) for t in times]
    still = [sample(t + 6.0, simulation, 0.02) for t in times]
    again = [sample(t + 12.0, simulation, 0.02) for t in times]
    between = [sample(9.0, simulation, 0.03)]
    watch = watched(simulation, [*drifting, *unseen, *still, *between, *again])
    assert len(watch.found) == 1
    assert dict(watch.dropped) == {"the markers still moved": 1, "nothing was measured": 1,
                                   "it repeats an earlier pose": 1}  # fmt: skip


def test_one_false_frame_does_not_move_a_marker(simulation):
    samples = [sample(t, simulation, 0.0) for t in np.arange(0.0, 2.0, 0.05)]
    samples[-3] = sample(samples[-3].time, simulation, 0.0, 0.05)
    watch = watched(simulation, samples)
    assert np.array_equal(watch.found[0].markers, simulation.marker_positions())


def test_poses_of_a_recorded_run_are_what_the_cameras_saw(tmp_path):
    scene = tmp_path / "diamond.yaml"
    text = (ROOT / "config/scenes/diamond.yaml").read_text()
    scene.write_text(text.replace("../../meshes/diamond_600.vtk", str(MESH))
                     + "\nmarker_frame: {position: [0.01, 0.0, 0.02]}\n")  # fmt: skip
    live = Live(scene, tmp_path / "run.mcap", settings={"closed_loop": False})
    simulation = live.loop.simulation
    seen = simulation.scene.marker_frame.of_cameras(simulation.marker_positions()) + 1e-4
    for number in range(40):
        if number == 2:
            assert live.loop.enable(live.time)[0]
        assert live.loop.markers.accept(simulation.marker_ids, seen, live.arrival()) is None
        live.tick()
        live.time += 0.05
    live.recorder.close()
    own = Simulation(changed_scene(simulation.scene, {"markers": simulation.scene.markers[::-1]}))
    poses, words = poses_of_run(tmp_path / "run.mcap", own)
    assert len(poses) == 1, words
    assert np.allclose(poses[0].markers, seen[::-1], atol=1e-12)
    assert poses[0].setpoints == pytest.approx(simulation.rest_setpoints, abs=1e-4)
    assert np.isnan(poses[0].effectors).all()


def test_a_table_without_times_has_a_pose_in_each_row(simulation):
    rest = simulation.rest_setpoints
    table = {f"{name}_length_m": rest[i] - np.array([0.0, 0.01])
             for i, name in enumerate(simulation.actuator_names)}  # fmt: skip
    table |= {f"marker_4_{axis}_m": [0.1, np.nan] for axis in "xyz"}
    table |= {"south_tension_N": [1.5, 2.5], "marker_4_x_mm": [100.0, 0.0]}
    poses, words = poses_of_table(table, simulation)
    assert words == "table: 2 poses at rest, one of each row; not read: marker_4_x_mm"
    place = list(simulation.marker_ids).index(4)
    assert poses[0].markers[place].tolist() == [0.1] * 3 and np.isnan(poses[1].markers).all()
    assert np.isfinite(poses[0].efforts).tolist() == [name == "south" for name in simulation.actuator_names]
    shortenings = {name.replace("_length_m", "_shortening_m"): np.array([0.0, 0.01])
                   for name in table if name.endswith("_length_m")}  # fmt: skip
    same, _ = poses_of_table(shortenings | {"tip_x_m": [0.0, 0.1], "tip_y_m": [0, 0], "tip_z_m": [0, 0]},
                             simulation)
    assert same[1].setpoints == pytest.approx(poses[1].setpoints)
    assert same[1].effectors[0].tolist() == [0.1, 0.0, 0.0]
    with pytest.raises(TableFileError, match="lacks what drives north.*north_length_m|north_length_m"):
        poses_of_table({"marker_4_x_m": [0.0]}, simulation)


@pytest.mark.parametrize("period", [0.01, 0.05])
def test_noise_of_the_cameras_is_no_motion(simulation, period, drawn_rng):
    random, samples = drawn_rng, []
    for time in np.arange(0.0, 100.0, period):
        noise = random.normal(0.0, 2e-4, (8, 3))
        samples.append(sample(time, simulation, 1e-3 * (time // 2.0), noise))
    watch = watched(simulation, samples)
    assert len(watch.found) >= 48, watch.in_words()


def test_the_table_of_a_watch_is_read_again(simulation, tmp_path):
    watch = RestWatch(simulation)
    efforts = np.array([1.0, np.nan, 0.25, 3.0])
    for place in range(3):
        at = simulation.rest_setpoints - 0.003 * place
        markers = simulation.marker_positions() + 0.001 * place
        markers[place] = np.nan
        watch.found.append(RestPose(at, markers, np.full((1, 3), np.nan), efforts, np.zeros((0, 3))))
    file = tmp_path / "rests.csv"
    file.write_text(watch.table())
    poses, _ = poses_of_table(file, simulation)
    for one, own in zip(poses, watch.found, strict=True):
        for name in ("setpoints", "markers", "effectors", "efforts", "forces"):
            assert np.allclose(getattr(one, name), getattr(own, name), rtol=1e-8, equal_nan=True), name


def test_files_of_one_name_in_two_folders_are_told_apart(simulation, tmp_path):
    files = [tmp_path / day / "poses.csv" for day in ("monday", "tuesday")]
    for file in files:
        file.parent.mkdir()
        watch = RestWatch(simulation)
        watch.found.append(RestPose(simulation.rest_setpoints, simulation.marker_positions(), np.full((1, 3), np.nan),
                                    np.full(4, np.nan), np.zeros((0, 3))))  # fmt: skip
        file.write_text(watch.table())
    poses, words = read_poses(files, simulation)
    assert [pose.origin for pose in poses] == [f"{file}, line 2" for file in files]
    assert all(told.startswith(str(file)) for file, told in zip(files, words, strict=True))
    assert read_poses(files[:1], simulation)[0][0].origin == "poses.csv, line 2"


def test_what_is_kept_of_a_long_run_is_bounded(simulation):
    watch = RestWatch(simulation)
    for number in range(2 * MOST_POSES):
        # The robot goes to and fro: what it repeats pushes no other pose out.
        command = simulation.rest_setpoints - 0.01 * (number % 2)
        pose = RestPose(command, simulation.marker_positions(), np.full((1, 3), np.nan), np.full(4, np.nan),
                        np.zeros((0, 3)))  # fmt: skip
        for time in np.arange(0.0, 1.5, 0.05):
            watch.add(Sample(2.0 * number + time, command, pose))
    watch.end()
    assert len(watch.found) == 2 and watch.dropped["it repeats an earlier pose"] == 2 * MOST_POSES - 2


def test_a_table_with_other_axes_and_signs_is_read_in_the_frame_of_the_scene():
    emio = Simulation(load_scene(ROOT / "config/scenes/emio.yaml"))
    table = {f"servo_{k}_angle_rad": [0.1 * k] for k in (1, 2, 3, 4)}
    table |= {f"marker_0_{axis}_m": [value] for axis, value in zip("xyz", (0.01, 0.02, 0.03), strict=True)}
    (pose,), _ = poses_of_table(table, emio, Axes.read("z,x,y", ["servo_2", "servo_4"]))
    assert pose.markers[0] == pytest.approx([0.03, 0.01, 0.02])
    assert pose.setpoints == pytest.approx([0.1, -0.2, 0.3, -0.4])
    (pose,), _ = poses_of_table(table, emio, Axes.read("-y,x,z"))
    assert pose.markers[0] == pytest.approx([-0.02, 0.01, 0.03])
    with pytest.raises(AxesError, match="servo_5: is no actuator of the scene"):
        poses_of_table(table, emio, Axes.read("x,y,z", ["servo_5"]))


@pytest.mark.parametrize("words, reason", [("x,y", "once each"), ("x,y,y", "once each"), ("y,x,z", "left-handed"),
                                           ("-x,y,z", "left-handed"), ("", "once each")])  # fmt: skip
def test_axes_that_are_no_frame_are_refused(words, reason):
    with pytest.raises(AxesError, match=reason):
        Axes.read(words)
