"""Files of ``simulate`` are written completely or not at all, and never replace an input."""

import pytest

from softrobot_twin.harness.output_file import OutputError, output_file
from softrobot_twin.simulation import Simulation
from softrobot_twin.study import direct_run, offline_run
from test.run_files import rows_of

pytestmark = pytest.mark.libraries

TARGETS = "time_s,tip_x_m,tip_y_m,tip_z_m\n0,0.0105,0.01,0.098\n0.02,0.011,0.01,0.0975\n"
OLD = "what an earlier run wrote\n"


@pytest.fixture
def targets(tmp_path):
    path = tmp_path / "targets.csv"
    path.write_text(TARGETS)
    return path


@pytest.fixture
def output(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(OLD)
    return path


def left_as_it_was(output):
    beside = {path.name for path in output.parent.iterdir()}
    return output.read_text() == OLD and beside <= {"run.csv", "targets.csv", "scene.yaml"}


@pytest.mark.parametrize("arguments", [
    ("none.yaml", "--targets", "targets.csv"),
    ("{scene}", "--targets", "none.csv"),
    ("{scene}", "--targets", "targets.csv", "--picture", "shape.xyz"),
    ("{scene}", "--targets", "targets.csv", "--picture", "run.csv"),
    ("{scene}", "--seconds", "1", "--picture", "shape"),
    ("{scene}", "--seconds", "0"),
    ("{scene}", "--steps", "0"),
    ("{scene}", "--steps", "3", "--settle", "1"),
    ("{scene}", "--commands", "targets.csv"),
])  # fmt: skip
def test_a_refused_run_does_not_change_an_existing_output(
    column, targets, output, call, monkeypatch, arguments
):
    monkeypatch.chdir(output.parent)
    done = call("simulate", *(word.format(scene=column) for word in arguments), "--output", output, code=2)
    assert "Traceback" not in done.errors
    assert left_as_it_was(output)


@pytest.mark.parametrize("command", ["targets", "steps"])
def test_a_failed_run_does_not_change_an_existing_output(column, targets, output, monkeypatch, command):
    def break_off(*_):
        raise MemoryError

    rows = []
    monkeypatch.setattr(Simulation, "step", lambda *arguments: rows.append(1) or break_off())
    monkeypatch.setattr(Simulation, "warm_up", lambda _: None)
    with pytest.raises(MemoryError):
        if command == "targets":
            offline_run.simulate(column, targets, output)
        else:
            direct_run.simulate_alone(column, 0.1, output)
    assert rows and left_as_it_was(output)


def test_an_interrupted_output_is_kept_beside_the_existing_one(column, targets, output, monkeypatch):
    whole_run = offline_run.run

    def stop(*arguments):
        yield from list(whole_run(*arguments))[:1]
        raise KeyboardInterrupt

    monkeypatch.setattr(offline_run, "run", stop)
    with pytest.raises(KeyboardInterrupt):
        offline_run.simulate(column, targets, output)
    assert output.read_text() == OLD
    assert len(rows_of(output.with_name("run.csv.part"))) == 1


def test_a_picture_that_cannot_be_drawn_changes_neither_run_nor_picture(column, targets, output, monkeypatch):
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fail)
    picture = output.with_name("shape.png")
    picture.write_text(OLD)
    with pytest.raises(OutputError, match="No space left"):
        offline_run.simulate(column, targets, output, picture=picture)
    assert output.read_text() == OLD and picture.read_text() == OLD


@pytest.mark.parametrize("name", ["targets.csv", "scene.yaml"])
def test_an_input_file_is_not_overwritten(column, targets, output, call, name):
    scene = output.with_name("scene.yaml")
    scene.write_text(column.read_text().replace("column.vtk", str(column.parent / "column.vtk")))
    before = output.with_name(name).read_text()
    done = call("simulate", scene, "--targets", targets, "--output", output.with_name(name), code=2)
    assert "would overwrite" in done.errors
    assert output.with_name(name).read_text() == before


def test_a_file_is_written_through_a_link_and_keeps_its_mode(tmp_path):
    target, link = tmp_path / "target.csv", tmp_path / "link.csv"
    target.write_text(OLD)
    target.chmod(0o640)
    link.symlink_to(target)
    with output_file(link) as partial:
        partial.write_text("new")
        assert target.read_text() == OLD
    assert link.is_symlink() and target.read_text() == "new"
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("follows", [True, False])
def test_a_run_states_shortenings_and_lengths_at_rest(column, targets, output, call, follows):
    asked = ("--targets", targets) if follows else ("--steps", 2)
    call("simulate", column, *asked, "--output", output)
    rest = dict(zip("abcd", Simulation.from_scene_file(column).rest_setpoints, strict=True))
    for row in rows_of(output):
        for name, length in rest.items():
            assert float(row[f"{name}_rest_length_m"]) == length
            assert float(row[f"{name}_shortening_m"]) == length - float(row[f"{name}_length_m"])


def test_an_error_of_the_run_is_not_reported_as_a_file_error(tmp_path):
    path = tmp_path / "run.csv"
    with pytest.raises(ValueError, match="of the run"), output_file(path):
        raise ValueError("of the run")
    assert not list(tmp_path.iterdir())
