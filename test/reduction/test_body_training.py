"""``reduce``: a trained body that is as its full one at fresh states, and runs that go on."""

import numpy as np
import pytest
import yaml

from softrobot_twin.analysis.linear_model import ModalTangent
from softrobot_twin.reduction import body_training
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Simulation
from softrobot_twin.simulation.building.reduced_body import BodyReduction, ModelFile, read_body_reduction
from softrobot_twin.study.accuracy_study import only_body
from test.lost_samples import lose_second
from test.scene_changes import entries_of, repeat_step, yaml_file

RANGE = ("--range", *(f"{name}_shortening_m=0:0.008" for name in "abcd"))
SMALL = ("--snapshots", 48, "--modes", 17, "--spare-modes", 6, "--states", 8, *RANGE)


@pytest.fixture(scope="module")
def trained(column, tmp_path_factory):
    """File of a small training in this process."""
    from softrobot_twin.__main__ import main
    output = tmp_path_factory.mktemp("trained") / "column_reduced.npz"
    arguments = ["reduce", column, "--output", output, "--workers", 1, *SMALL]
    assert main([str(argument) for argument in arguments]) == 0
    return output


def reduced(column, file):
    """The scene with its body reduced, as a user writes it."""
    mapping = entries_of(column, {"body.reduced": {"file": str(file)}})
    return yaml_file(column.parent / "reduced.yaml", mapping)


def read(scene, file) -> BodyReduction:
    """The reduced model of a file, for the body of a scene file."""
    return read_body_reduction(ModelFile(file), only_body(load_scene(scene)))


def equal(scene, first, second):
    """Whether two files hold the same reduced model; the time of the training may differ."""
    one, other = (read(scene, file) for file in (first, second))
    np.testing.assert_array_equal(one.basis, other.basis)
    for name in ("sampled", "spare_sampled"):
        for a, b in zip(getattr(one, name), getattr(other, name), strict=True):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one.ranges, other.ranges)
    np.testing.assert_array_equal(one.measured, other.measured)
    return True


def test_the_file_says_how_it_was_made(column, trained):
    found = read(column, trained)
    assert found.mode_count == 18 and found.basis.shape[2] == 24
    assert found.training["states"] == 48 and found.training["seed"] == 0
    assert len(found.sampled.cells) < 120 == 2 * 2 * 5 * 6
    assert found.ranges[0] > 1e-3 and (np.diff(found.ranges[[0, 5, 23]]) < 0.0).all()
    assert 0.0 < found.measured[0] <= found.measured[1] < 0.02
    assert list(trained.parent.iterdir()) == [trained]


def test_a_scene_with_the_file_moves_as_the_full_one(trained, column):
    full, small = (Simulation.from_scene_file(scene)
                   for scene in (column, reduced(column, trained)))  # fmt: skip
    rest = full.effector_positions()
    setpoints = full.rest_setpoints - [0.008, 0.003, 0.0, 0.001]
    for share in np.linspace(0.1, 1.0, 20):
        wanted = full.rest_setpoints + share * (setpoints - full.rest_setpoints)
        for simulation in (full, small):
            repeat_step(simulation, CommandSetpoints(wanted, 1e6), 3)
        truth = full.effector_positions()
        error = np.linalg.norm(small.effector_positions() - truth)
        assert error < 0.02 * np.linalg.norm(truth - rest)
    np.testing.assert_allclose(small.state.efforts, full.state.efforts,
                               atol=0.03 * full.state.efforts.max())  # fmt: skip


@pytest.mark.exhaustive
def test_two_processes_train_the_same(trained, column, call, tmp_path):
    done = call("reduce", column, "--output", tmp_path / "r.npz", "--workers", 2, *SMALL)
    assert equal(column, trained, tmp_path / "r.npz")
    assert "48 of 48" in done.output and "8 fresh states" in done.output
    assert "56 of 56" in done.errors


def test_the_scene_that_names_the_file_trains_it_again(trained, column, call, tmp_path):
    scene = reduced(column, tmp_path / "missing.npz")
    call("reduce", scene, "--output", tmp_path / "r.npz", "--workers", 1, *SMALL)
    assert equal(column, trained, tmp_path / "r.npz")


def test_the_file_lies_beside_the_mesh(column, call):
    call("reduce", column, "--workers", 1, "--snapshots", 8, "--modes", 3,
         "--spare-modes", 3, "--states", 0)  # fmt: skip
    file = column.parent / "column_reduced.npz"
    assert np.isnan(read(column, file).measured).all()
    file.unlink()


def test_modes_follow_from_the_energy_that_they_may_leave_out(column, call, tmp_path):
    counts = []
    for energy in (1e-2, 1e-5):
        call("reduce", column, "--output", tmp_path / "r.npz", "--workers", 1,
             "--snapshots", 40, "--energy", energy, "--states", 0)  # fmt: skip
        found = read(column, tmp_path / "r.npz")
        assert found.training["energy left out"] <= energy and found.mode_count % 3 == 0
        counts.append(found.mode_count)
    assert counts[0] < counts[1]


def test_a_body_that_saw_loads_follows_them(trained, column, call, tmp_path):
    """One that never saw a load does not."""
    call("reduce", column, "--output", tmp_path / "r.npz", "--workers", 1,
         "--snapshots", 80, "--modes", 24, "--loads", 0.1, "--tilts", 120,
         *RANGE)  # fmt: skip
    told = read(column, tmp_path / "r.npz")
    assert told.measured[1] < 0.05 and told.training["load [N]"] == 0.1
    mapping = entries_of(column, {"gravity": [0.0, 9.81, 0.0]})
    moved = []
    for file in (None, tmp_path / "r.npz", trained):
        if file is not None:
            mapping["body"]["reduced"] = {"file": str(file)}
        scene = yaml_file(column.parent / "tilted.yaml", mapping)
        simulation = Simulation.from_scene_file(scene)
        for _ in range(20):
            simulation.step(CommandSetpoints(simulation.rest_setpoints, 1e6))
        moved.append(simulation.effector_positions()[0])
    truth, seen, _ = moved
    start = np.array([0.01, 0.01, 0.10])
    assert np.linalg.norm(seen - truth) < 0.03 * np.linalg.norm(truth - start)


@pytest.mark.exhaustive
def test_a_wanted_error_is_met_by_adding_where_it_is_worst(column, call, tmp_path, monkeypatch):
    for name, value in (("FIRST_SNAPSHOTS", 8), ("CANDIDATES", 16), ("ADDED", 8), ("JUDGES", 8)):
        monkeypatch.setattr(body_training, name, value)
    done = call("reduce", column, "--output", tmp_path / "r.npz", "--workers", 1,
                "--error", "2%", "--states", 8, *RANGE)  # fmt: skip
    assert "round 1: 8 states" in done.output and "round 2" in done.output
    found = read(column, tmp_path / "r.npz")
    assert found.training["wanted error"] == 0.02 and found.training["states"] > 8
    assert found.measured[1] < 0.03


def test_a_wanted_error_that_is_not_met_is_said(column, call, tmp_path, monkeypatch):
    monkeypatch.setattr(body_training, "MOST_ROUNDS", 1)
    for name, value in (("CANDIDATES", 6), ("JUDGES", 4)):
        monkeypatch.setattr(body_training, name, value)
    done = call("reduce", column, "--output", tmp_path / "r.npz", "--workers", 1, "--snapshots", 8,
                "--error", "0.0001%", "--states", 4, code=1)  # fmt: skip
    assert "0.0001 % is not met after 1 round" in done.errors
    assert (tmp_path / "r.npz").is_file()


@pytest.mark.exhaustive
def test_a_training_by_targets_tells_which_were_reached_and_is_judged_between_them_too(
    column, call, tmp_path
):
    """The box reaches above the column, which no cable can lengthen."""
    done = call("reduce", column, "--output", tmp_path / "r.npz", "--workers", 1, "--targets",
                "tip=0.004:0.016,0.004:0.016,0.096:0.104", "--snapshots", 24, "--modes", 9,
                "--spare-modes", 3, "--states", 6)  # fmt: skip
    training = read(column, tmp_path / "r.npz").training
    sought, missed = training["targets sought"], training["missed targets"]
    assert sought == 23 and 0 < missed < 23
    assert 0.001 < training["largest miss [m]"] < 0.01
    words = f"{sought - missed} of 23 targets were reached, the others missed by up to "
    assert words in done.errors and words in " ".join(done.output.split())
    assert "at 12 fresh states" in done.output


def test_lost_chains_are_told_and_the_rest_is_used(column, call, tmp_path, monkeypatch):
    lose_second(monkeypatch)
    done = call("reduce", column, "--output", tmp_path / "r.npz", "--snapshots", 40, "--modes", 6,
                "--states", 0, code=1)  # fmt: skip
    assert "10 states are lost: no power" in done.errors
    assert read(column, tmp_path / "r.npz").training["states"] == 30


@pytest.mark.exhaustive
def test_a_stopped_run_goes_on_where_it_was(column, stop, call, tmp_path):
    output, part = tmp_path / "r.npz", tmp_path / "r.npz.part"
    arguments = ["reduce", column, "--output", output, "--workers", 1, "--snapshots", 60,
                 "--modes", 6, "--states", 0]  # fmt: skip
    stopped = stop(*arguments, after=2)  # chains of twelve samples
    assert stopped.code == 130 and "the same command goes on from there" in stopped.errors
    assert len(list(part.glob("[!.]*.npz"))) == 2 and not output.exists()
    done = call(*arguments)
    assert not part.exists()
    assert "24 of 60" in done.errors
    assert read(column, output).training["states"] == 60


def test_an_error_that_fresh_states_exceed_after_the_last_round_is_said(capsys):
    options = body_training.TrainingOptions(error=0.01)
    shares = np.array([0.001, 0.02, 0.005])
    judged = body_training.Judgement(shares * 0.1, shares)
    assert not body_training.tell_whether_met(options, [], True, judged)
    assert "is exceeded at 1 of the 3 fresh states" in capsys.readouterr().err
    assert body_training.tell_whether_met(options, [], True, judged._replace(shares=shares / 3))


def in_motion(column, file=None, **changes):
    """The column as it moves in time, reduced by a file or with all nodes."""
    mapping = yaml.safe_load(column.read_text()) | {"integration": "dynamic", "time_scheme": "generalized_alpha"}
    mapping |= {"solver": {"newton_iterations": 20, "residual_tolerance": 1e-9}} | changes
    mapping["body"]["damping"] = {"mass": 1.0, "stiffness": 1e-3}
    for cable in mapping["cables"]:
        cable.pop("rate", None)
        cable["shortening"] = [-0.05, 0.05]
    if file is not None:
        mapping["body"]["reduced"] = {"file": str(file)}
    return yaml_file(column.parent / f"moving_{'full' if file is None else file.stem}.yaml", mapping)


def slowest(simulation, count):
    """Frequencies of the slowest modes under tensions [Hz]."""
    for _ in range(200):
        simulation.step(CommandEfforts(np.full(4, 0.3), 0.1))
    for _ in range(10):
        simulation.step(CommandEfforts(np.full(4, 0.3), 0.01))
    return np.sort(ModalTangent(simulation, np.ones(4, bool)).at_state(None).frequencies)[:count]


@pytest.fixture(scope="module")
def moving(column, tmp_path_factory):
    """The full column in motion, that reduced with vibrations and that without."""
    from softrobot_twin.__main__ import main
    scene, folder = in_motion(column), tmp_path_factory.mktemp("moving")
    simulations = [Simulation.from_scene_file(scene)]
    for name, more in (("shaken", ()), ("still", ("--vibration-modes", 0))):
        file = folder / f"{name}.npz"
        small = ("--snapshots", 48, "--states", 0, "--spare-modes", 3, *RANGE)
        arguments = ["reduce", scene, "--output", file, "--workers", 1, *small, *more]
        assert main([str(argument) for argument in arguments]) == 0
        assert read(column, file).training["vibration modes"] == (0 if more else 12)
        simulations.append(Simulation.from_scene_file(in_motion(column, file)))
    return simulations


def test_where_a_scene_moves_slow_vibrations_are_among_the_modes(moving):
    full, shaken, still = (slowest(simulation, 6) for simulation in moving)
    print(f"full {full.round(2)} Hz, with vibrations {shaken.round(2)}, without {still.round(2)}")
    assert shaken == pytest.approx(full, rel=0.01)
    assert np.abs(still / full - 1.0).max() > 0.2


def test_pulled_and_let_go_a_trained_body_swings_as_the_full_one(moving):
    swings = []
    for simulation in moving[:2]:
        simulation.reset()
        own = []
        for pull in 60 * [0.6] + 150 * [0.0]:
            simulation.step(CommandEfforts(np.array([pull, 0.0, 0.2 * pull, 0.0]), 0.1 if pull else 0.002))
            own.append(simulation.effector_positions()[0])
        swings.append(np.array(own[59:]))
    full, shaken = swings
    apart = np.linalg.norm(shaken - full, axis=1)
    size = np.linalg.norm(full - full[-1], axis=1)
    print(f"apart by {apart.max() / size.max():.3f} of the swing")
    assert apart.max() < 0.05 * size.max()


def test_fewer_modes_than_vibrations_are_refused(column, call, tmp_path):
    done = call("reduce", in_motion(column), "--output", tmp_path / "r.npz", "--workers", 1, "--snapshots", 24,
                "--modes", 9, "--states", 0, *RANGE, code=2)  # fmt: skip
    assert "--vibration-modes" in done.errors
