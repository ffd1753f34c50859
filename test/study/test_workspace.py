"""``workspace``: samples that depend on nothing but the scene and the seed, and runs that go on."""

import copy
import os
import shutil
import signal
import sys

import numpy as np
import pytest

from softrobot_twin.analysis.apparent_compliance import apparent_compliance
from softrobot_twin.harness import sample_workers
from softrobot_twin.harness.sample_workers import DaskWorkers, Job, LocalWorkers
from softrobot_twin.harness.sampled_axes import sampled_axes, sampled_setpoints
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.study.workspace import SampleComputer, UnfinishedFile
from test.lost_samples import lose_second
from test.run_files import rows_of
from test.scene_changes import repeat_step, yaml_file

NOBODY = "--scheduler tcp://127.0.0.1:9"


@pytest.fixture(scope="module")
def sampled(column, tmp_path_factory):
    """File of a run of one process in this one: 7 samples, seed 3; and its picture."""
    from softrobot_twin.__main__ import main
    folder = tmp_path_factory.mktemp("sampled")
    code = main(["workspace", str(column), "--output", str(folder / "w.csv"), "--samples", "7",
                 "--seed", "3", "--workers", "1", "--picture", str(folder / "w.png")])  # fmt: skip
    assert code == 0
    return folder / "w.csv"


def test_each_row_is_an_equilibrium_with_its_stiffness(sampled, column):
    rows = rows_of(sampled)
    assert [row["sample"] for row in rows] == list("0123456")
    simulation = Simulation.from_scene_file(column)
    names = simulation.actuator_names
    for row in rows:
        assert row["status"] == "ok" and float(row["residual_N"]) < 1e-4
    row = rows[4]
    lengths = np.array([float(row[f"{name}_length_m"]) for name in names])
    result = repeat_step(simulation, CommandSetpoints(lengths, 1e6), 40)
    place = [float(row[f"tip_{axis}_m"]) for axis in "xyz"]
    np.testing.assert_allclose(result.effector_positions[0], place, atol=1e-8)
    tensions = [float(row[f"{name}_tension_N"]) for name in names]
    np.testing.assert_allclose(result.efforts, tensions, atol=1e-5)
    found = apparent_compliance(simulation)
    stiffness = [float(row[f"tip_stiffness_{rank}_N_per_m"]) for rank in (1, 2, 3)]
    np.testing.assert_allclose(found.principal_stiffness(0)[0], stiffness, rtol=1e-4)
    assert float(row["tip_compliance_xz_m_per_N"]) == pytest.approx(
        found.compliance[0, 0, 2], rel=1e-3, abs=1e-7
    )


def test_the_first_sample_is_the_robot_at_rest(sampled, column):
    row, simulation = rows_of(sampled)[0], Simulation.from_scene_file(column)
    for name, length in zip(simulation.actuator_names, simulation.rest_setpoints):
        assert float(row[f"{name}_length_m"]) == length


@pytest.mark.libraries
@pytest.mark.exhaustive
def test_two_processes_write_the_same_bytes(sampled, column, call, tmp_path):
    done = call("workspace", column, "--output", tmp_path / "w.csv", "--samples", 7, "--seed", 3,
                "--workers", 2)  # fmt: skip
    assert (tmp_path / "w.csv").read_bytes() == sampled.read_bytes()
    assert not (tmp_path / "w.csv.part").exists()
    assert "7 of 7" in done.errors and "7 ok" in done.output


def test_samples_fill_the_box_and_more_of_them_begin_with_the_same(column):
    simulation = Simulation.from_scene_file(column)
    axes = sampled_axes(simulation)
    few, many = (sampled_setpoints(simulation, axes, count, 5) for count in (50, 257))
    np.testing.assert_array_equal(few, many[:50])
    drives = np.array([simulation.actuators.drives(sample) for sample in many[1:]])
    low, high = (np.array([getattr(axis, end) for axis in axes]) for end in ("least", "most"))
    shares = (drives - low) / (high - low)
    assert shares.min() >= -1e-12 and shares.max() <= 1.0 + 1e-12
    for column_of in shares.T:
        counts, _ = np.histogram(column_of, 16, (0.0, 1.0))
        np.testing.assert_allclose(counts, 16, atol=1)
    assert (sampled_setpoints(simulation, axes, 50, 6)[1:] != few[1:]).any()


def test_cables_of_one_motor_are_sampled_as_one(column, tmp_path):
    scene = tmp_path / "motor.yaml"
    shutil.copy(column.parent / "column.vtk", tmp_path)
    scene.write_text(column.read_text() + "motors: [{name: both, cables: [a, b]}]\n")
    simulation = Simulation.from_scene_file(scene)
    axes = sampled_axes(simulation, ["both_shortening_m=0:0.002"])
    assert [axis.name for axis in axes] == ["both", "c", "d"]
    setpoints = sampled_setpoints(simulation, axes, 20, 0)
    drives = np.array([simulation.actuators.drives(sample) for sample in setpoints])
    np.testing.assert_allclose(drives[:, 0], drives[:, 1], atol=1e-12)
    assert drives[:, 0].max() <= 0.002 and np.ptp(drives[:, 0]) > 0.001


@pytest.mark.exhaustive
def test_a_stopped_run_goes_on_where_it_was(column, sampled, stop, call, tmp_path):
    output, part = tmp_path / "w.csv", tmp_path / "w.csv.part"
    arguments = ["workspace", column, "--output", output, "--samples", 12, "--seed", 3]
    stopped = stop(*arguments, "--workers", 2, after=4)
    assert stopped.code == 130 and "the same command goes on" in stopped.errors
    assert part.read_bytes().count(b"\n") == 2 + 4 and not output.exists()
    # A row that was being written when the power failed is computed again.
    part.write_bytes(part.read_bytes()[:-5])
    before = part.read_bytes()
    done = call(*arguments, "--range", "a_shortening_m=0:0.001", "--workers", 1, code=2)
    assert "w.csv.part" in done.errors and "another range" in done.errors
    assert part.read_bytes() == before
    again = call(*arguments, "--workers", 1)
    assert not part.exists()
    assert "3 of 12" in again.errors
    lines = output.read_text().splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == [str(index) for index in range(12)]
    assert lines[:8] == sampled.read_text().splitlines()


@pytest.mark.parametrize("change, named", [
    ({"seed": 4}, "another seed: 3, not 4"), ({"scene": "other"}, "another scene"),
    ({"number of samples": 8}, "another number of samples: 7, not 8"),
])  # fmt: skip
def test_rows_of_another_run_are_refused_by_name(tmp_path, change, named):
    run = {"scene": "this", "seed": 3, "number of samples": 7}
    first = UnfinishedFile(tmp_path / "w.csv", run, ["sample", "status"])
    first.add(2, ["ok"])
    first.close()
    again = UnfinishedFile(tmp_path / "w.csv", run, ["sample", "status"])
    assert again.rows == {2: ["2", "ok"]}
    again.close()
    before = again.path.read_bytes()
    with pytest.raises(Exception, match=named):
        UnfinishedFile(tmp_path / "w.csv", run | change, ["sample", "status"])
    assert again.path.read_bytes() == before


def test_what_is_no_unfinished_run_is_left_alone(tmp_path):
    other = tmp_path / "w.csv.part"
    other.write_text("my notes\nare here\n")
    with pytest.raises(Exception, match="is no unfinished run"):
        UnfinishedFile(tmp_path / "w.csv", {"seed": 1}, ["sample", "status"])
    assert other.read_text() == "my notes\nare here\n"


def test_a_fingerprint_depends_on_the_mesh_and_not_on_the_folder(column, tmp_path):
    def run_of(folder):
        computer = SampleComputer(folder / column.name)
        from softrobot_twin.harness.sample_workers import scene_fingerprint
        return scene_fingerprint(computer.simulation.scene)

    shutil.copytree(column.parent, tmp_path / "copy")
    assert run_of(tmp_path / "copy") == run_of(column.parent)
    mesh = tmp_path / "copy" / "column.vtk"
    mesh.write_bytes(mesh.read_bytes() + b"\n")
    assert run_of(tmp_path / "copy") != run_of(column.parent)
    with pytest.raises(Exception, match="is not the scene of this run"):
        SampleComputer(tmp_path / "copy" / column.name, run_of(column.parent))


_WORKERS = """
import os


class Fragile:
    # Ends its process at 3 always, and at 5 the first time.

    def __init__(self, folder, content):
        self._folder = folder

    def __call__(self, sample):
        first = not (self._folder / "five").exists()
        if sample == 3 or (sample == 5 and first):
            (self._folder / "five").touch()
            os._exit(9)
        return [int(sample) ** 2]


class Broken:
    # Ends its process before it computes anything.

    def __init__(self, folder, content):
        os._exit(7)


class Failing:
    def __init__(self, folder, content):
        pass

    def __call__(self, sample):
        if sample == 4:
            raise ArithmeticError("four is refused")
        return [int(sample) ** 2]
"""


@pytest.fixture(scope="module")
def squares(tmp_path_factory):
    """A module of workers that compute squares, which other processes can import."""
    folder = tmp_path_factory.mktemp("squares")
    (folder / "squares_for_tests.py").write_text(_WORKERS)
    sys.path.insert(0, str(folder))
    import squares_for_tests
    yield squares_for_tests
    sys.path.remove(str(folder))
    del sys.modules["squares_for_tests"]


@pytest.mark.exhaustive
def test_a_lost_process_costs_only_its_own_sample(squares, tmp_path):
    samples = [(index, index) for index in range(8)]
    job = Job(squares.Fragile, tmp_path, "")
    found = {one.index: one for one in LocalWorkers(2).run(job, samples)}
    assert sorted(found) == list(range(8))
    assert found[3].row is None and "code 9" in found[3].cause
    assert all(found[index].row == [index**2] for index in found if index != 3)


@pytest.mark.exhaustive
def test_processes_that_cannot_begin_are_told(squares, tmp_path):
    with pytest.raises(sample_workers.WorkerError, match="code 7"):
        list(LocalWorkers(2).run(Job(squares.Broken, tmp_path, ""), [(0, 0), (1, 1)]))


def test_a_lost_sample_is_a_row_with_its_status(column, call, tmp_path, monkeypatch):
    lose_second(monkeypatch)
    done = call("workspace", column, "--output", tmp_path / "w.csv", "--samples", 3,
                "--picture", tmp_path / "w.png", code=1)  # fmt: skip
    assert "sample 1 is lost: no power" in done.errors
    rows = rows_of(tmp_path / "w.csv")
    assert [row["status"] for row in rows] == ["ok", "lost", "ok"]
    assert rows[1]["tip_x_m"] == "nan" and "1 lost" in done.output


def test_an_actuator_without_bounds_is_refused_by_name(air_scene, tmp_path, call):
    mapping = copy.deepcopy(air_scene)
    del mapping["cavities"][0]["pressure"]
    scene = yaml_file(tmp_path / "air.yaml", mapping)
    done = call("workspace", scene, "--output", tmp_path / "w.csv", "--samples", 2, code=2)
    assert "cavities: low has no greatest pressure [Pa]" in done.errors
    assert "--range low_pressure_Pa=LOW:HIGH" in done.errors
    assert not list(tmp_path.glob("w.csv*"))
    axes = sampled_axes(Simulation.from_scene_file(scene), ["low_pressure_Pa=0:1000"])
    assert [(axis.name, axis.least, axis.most) for axis in axes] == [
        ("east", 0.0, 0.01), ("low", 0.0, 1000.0), ("high", -5.0e3, 1.0e4),
        ("syringe", -4.0e-7, 1.0e-6),
    ]  # fmt: skip


@pytest.mark.parametrize("told", [
    f"{NOBODY}: cannot be reached", "distributed is not installed",
])
def test_a_cluster_that_is_not_there_is_refused_by_name(column, call, tmp_path, monkeypatch, told):
    if "installed" in told:
        monkeypatch.setitem(sys.modules, "distributed", None)
    else:
        pytest.importorskip("distributed")
        monkeypatch.setattr(sample_workers, "CONNECTION_TIMEOUT", 1.0)
    done = call("workspace", column, "--output", tmp_path / "w.csv", "--samples", 2, *NOBODY.split(), code=2)
    assert told in done.errors


@pytest.fixture(scope="module")
def cluster(squares):
    """A Dask cluster of two processes on this machine."""
    distributed = pytest.importorskip("distributed")
    made = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    yield made
    made.close(timeout=60)


@pytest.mark.libraries
@pytest.mark.exhaustive
def test_a_cluster_computes_the_same_and_a_failure_costs_only_its_sample(
    cluster, column, sampled, squares, call, tmp_path
):
    address = cluster.scheduler_address
    call("workspace", column, "--output", tmp_path / "w.csv", "--samples", 7, "--seed", 3,
         "--scheduler", address)  # fmt: skip
    assert (tmp_path / "w.csv").read_bytes() == sampled.read_bytes()
    samples = [(index, index) for index in range(6)]
    job = Job(squares.Failing, tmp_path, "")
    found = {one.index: one for one in DaskWorkers(address).run(job, samples)}
    assert sorted(found) == list(range(6))
    assert found[4].row is None and "four is refused" in found[4].cause
    assert all(found[index].row == [index**2] for index in found if index != 4)


@pytest.mark.exhaustive
def test_a_killed_worker_of_a_cluster_loses_no_sample(cluster, column, tmp_path):
    simulation = Simulation.from_scene_file(column)
    setpoints = sampled_setpoints(simulation, sampled_axes(simulation), 30, 0)
    job = Job(SampleComputer, column, "")
    running = DaskWorkers(cluster.scheduler_address).run(job, list(enumerate(setpoints)))
    found = [next(running)]
    os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
    found += list(running)
    assert sorted(one.index for one in found) == list(range(30))
    assert all(one.row is not None and one.row[-1] == "ok" for one in found)
