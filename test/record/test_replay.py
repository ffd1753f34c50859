"""A recorded run again: the same bits, or the first one that differs; damaged and other files."""

import csv
import json
import shutil
import struct
import threading
import time
from dataclasses import asdict

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from softrobot_twin.__main__ import main
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_description import describe, scene_text
from softrobot_twin.record.run_file import (
    CALL,
    FORMAT,
    SCHEMA,
    TEXT,
    TEXT_DEFINITION,
    TICK,
    RunFile,
    RunFileError,
    text_of_cdr,
    text_to_cdr,
)
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.tables.column_names import is_output

from .conftest import ROOT, START, TICKS, TIP, TOPIC, Live, drive
from test.scene_changes import entries_of, yaml_file

SOFTER = "body.material.young_modulus=1.53e5"


def replayed(path, *arguments, **options):
    run = RunFile(path)
    return run, Replay(run, *arguments, **options).all_ticks()


@pytest.mark.libraries
def test_a_replay_gives_all_bits_of_the_run_again(recorded):
    run, found = replayed(recorded.path)
    assert run.is_complete and not run.lost
    assert found.ticks == TICKS and found.is_equal and found.calls > 2 * TICKS
    activities = [outcome.activity.value for outcome in recorded.outcomes]
    assert {"disabled", "resynchronising", "holding", "following"} <= set(activities)


def test_a_softer_body_differs_and_the_largest_differences_are_told(recorded, capsys):
    run, found = replayed(recorded.path, changes=(SOFTER,))
    assert found.ticks == TICKS and not found.is_equal
    efforts = found.by_quantity["efforts"]
    assert efforts.ticks == TICKS and efforts.largest.size > 0.0
    assert efforts.largest.place.split()[0] in run.description.names["actuators"]
    # What reached the loop is the same.
    assert "source" not in found.by_quantity and "measured_markers" not in found.by_quantity
    assert main(["replay", str(recorded.path), "--set", SOFTER]) == 0
    told = capsys.readouterr().out
    assert "first difference: tick 0" in told and "efforts" in told and "[N]" in told


def test_another_scene_file_is_compared_with_the_recorded_one(recorded, tmp_path):
    mapping = entries_of(recorded.scene, {"body.mesh.file": str(recorded.scene.parent / "mesh.vtk")})
    same, other = tmp_path / "same.yaml", tmp_path / "other.yaml"
    same.write_text(yaml.safe_dump(mapping))
    mapping["body"]["material"]["young_modulus"] = 153e3
    other.write_text(yaml.safe_dump(mapping))
    assert replayed(recorded.path, same)[1].is_equal
    assert not replayed(recorded.path, other)[1].is_equal


def test_a_scene_with_other_actuators_is_refused_by_their_names(recorded, tmp_path):
    mapping = entries_of(recorded.scene,
                         {"body.mesh.file": str(recorded.scene.parent / "mesh.vtk"), "cables.0.name": "nord"})
    other = yaml_file(tmp_path / "other.yaml", mapping)
    with pytest.raises(RunFileError, match="actuators north.*has nord"):
        Replay(RunFile(recorded.path), other)


def rewritten(recorded, path, change):
    """The run with other entries: `change` gets each content and may change it."""
    from mcap.writer import Writer

    with recorded.path.open("rb") as source, path.open("wb") as target:
        writer = Writer(target)
        writer.start()
        schema = writer.register_schema(TEXT, "ros2msg", TEXT_DEFINITION)
        channel = writer.register_channel("/twin/record", "cdr", schema, {"content": SCHEMA})
        for _, channel_of, message in make_reader(source).iter_messages():
            if channel_of.metadata.get("content") != SCHEMA:
                continue
            content = json.loads(text_of_cdr(message.data))
            change(content)
            writer.add_message(
                channel, message.log_time, text_to_cdr(json.dumps(content)), message.publish_time,
                message.sequence,
            )  # fmt: skip
        writer.finish()
    return path


def test_one_bit_of_one_value_is_found_with_its_tick_and_its_name(recorded, tmp_path, capsys):
    def change(content):
        if content["kind"] == TICK and content["tick"] == 12:
            positions = content["values"]["effector_positions"]
            positions[0][2] = float(np.nextafter(positions[0][2], 1.0))

    path = rewritten(recorded, tmp_path / "changed.mcap", change)
    _, found = replayed(path)
    assert list(found.by_quantity) == ["effector_positions"]
    assert found.first.tick == 12 and found.first.place == "tip z [m]"
    assert 0.0 < found.first.size < 1e-15
    assert main(["replay", str(path)]) == 1
    assert "tick 12" in capsys.readouterr().out


def test_a_call_at_another_place_changes_what_follows(recorded, tmp_path):
    def change(content):
        if content["kind"] == CALL and content["to"] == "targets.accept_point":
            if content["arguments"][1] == list(TIP):
                content["arguments"][1][0] += 1e-3

    _, found = replayed(rewritten(recorded, tmp_path / "changed.mcap", change))
    targets = found.by_quantity["targets"]
    assert targets.first.tick == found.first.tick == 4
    assert targets.first.size == pytest.approx(1e-3)


def test_recorded_readings_of_the_clock_decide_the_number_of_linearizations(scene_file, tmp_path):
    path = tmp_path / "hurried.mcap"
    live = Live(scene_file, path, settings={"deadline": 1e-9})
    drive(live, 16)
    live.recorder.close()
    _, found = replayed(path)
    assert found.is_equal
    assert any(outcome.result.report.is_overloaded for outcome in live.outcomes)

    def change(content):
        if content["kind"] == TICK:
            content["clock"] = [0.0] * len(content["clock"])

    recorded = type("Recorded", (), {"path": path})
    _, found = replayed(rewritten(recorded, tmp_path / "timeless.mcap", change))
    assert {"compute_time", "factor_age"} <= found.by_quantity.keys()


def test_what_a_replay_gave_is_written_in_the_columns_of_all_runs(recorded, tmp_path, capsys):
    output = tmp_path / "run.csv"
    assert main(["replay", str(recorded.path), "--output", str(output)]) == 0
    assert f"wrote {output}" in capsys.readouterr().out
    with output.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == TICKS and is_output(rows[0])
    for row, outcome in zip(rows, recorded.outcomes, strict=True):
        assert float(row["tip_z_m"]) == outcome.result.effector_positions[0, 2]
        assert float(row["north_length_m"]) == outcome.result.setpoints[0]
        wanted = float(row["tip_target_x_m"]), float(row["tip_error_m"])
        given = outcome.reading.targets[0, 0], outcome.tracking_errors[0]
        assert np.array_equal(wanted, given, equal_nan=True)
        assert row["status"] == outcome.result.status.value


@pytest.mark.parametrize("option", ["--output", "--record-view"])
def test_a_replay_never_replaces_its_run(recorded, option, capsys):
    before = recorded.path.read_bytes()
    assert main(["replay", str(recorded.path), option, str(recorded.path)]) == 2
    assert f"{option}: {recorded.path} would overwrite {recorded.path}" in capsys.readouterr().err
    assert recorded.path.read_bytes() == before


# --- files ---------------------------------------------------------------------------------------


def test_a_file_that_was_cut_off_is_replayed_up_to_there(scene_file, recorded, tmp_path, capsys):
    path = tmp_path / "running.mcap"
    live = Live(scene_file, path)
    drive(live, 12)
    # As SIGKILL leaves it: what the thread gave to the system, and nothing after it.
    killed, deadline = tmp_path / "killed.mcap", time.monotonic() + 30.0
    while True:
        shutil.copy(path, killed)
        if sum(entry.kind == TICK for entry in RunFile(killed).entries()) == 12:
            break
        assert time.monotonic() < deadline
        time.sleep(0.05)
    live.recorder.close()
    run, found = replayed(killed)
    assert found.is_equal and found.ticks == 12 and not run.is_complete
    assert main(["replay", str(killed)]) == 0
    assert "cut off after tick" in capsys.readouterr().err


def test_a_file_cut_at_any_byte_gives_whole_ticks_or_a_clear_refusal(recorded, tmp_path):
    content, cut = recorded.path.read_bytes(), tmp_path / "cut.mcap"
    counts = []
    for share in np.linspace(0.0, 1.0, 40):
        cut.write_bytes(content[: int(share * len(content))])
        try:
            run = RunFile(cut)
        except RunFileError as error:
            assert "holds no run of a twin" in str(error)
            continue
        counts.append(sum(entry.kind == TICK for entry in run.entries()))
        assert bool(run.damage) == (share < 1.0)
        if run.is_complete:
            assert counts[-1] == TICKS
    assert counts == sorted(counts) and counts[-1] == TICKS and run.is_complete


def index_of(content):
    """Where the index of a file begins: its footer tells it."""
    return struct.unpack_from("<Q", content, len(content) - 28)[0]


@pytest.mark.parametrize("place", [k / 20 for k in range(20)])
def test_a_byte_that_changed_before_the_index_is_found(recorded, tmp_path, place):
    content, entries = bytearray(recorded.path.read_bytes()), list(RunFile(recorded.path).entries())
    content[int(place * index_of(content))] ^= 0x10
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    try:
        run = RunFile(damaged)
    except RunFileError:
        return
    found = list(run.entries())
    assert run.damage and found == entries[: len(found)]
    assert run.is_complete == (len(found) == len(entries))


def moved(recorded, folder):
    """The run and its scene's mesh in another folder; they are no more where they were."""
    folder.mkdir()
    run = folder / "run.mcap"

    def change(content):
        if content["kind"] == "run":
            content["scene_path"] = "/gone/diamond.yaml"
            content["files"][0]["path"] = "/gone/mesh.vtk"

    return rewritten(recorded, run, change)


def test_a_missing_mesh_is_refused_by_name_and_found_beside_the_run(recorded, tmp_path, capsys):
    run = moved(recorded, tmp_path / "elsewhere")
    assert main(["replay", str(run)]) == 2
    told = capsys.readouterr().err
    assert "mesh.vtk: no such file" in told and "/gone/mesh.vtk" in told
    shutil.copy(recorded.scene.parent / "mesh.vtk", run.parent)
    assert replayed(run)[1].is_equal


def test_a_changed_mesh_is_refused_by_name(recorded, tmp_path):
    run = moved(recorded, tmp_path / "elsewhere")
    mesh = (recorded.scene.parent / "mesh.vtk").read_bytes()
    (run.parent / "mesh.vtk").write_bytes(mesh + b"\n")
    with pytest.raises(RunFileError, match="mesh.vtk has changed since the run"):
        Replay(RunFile(run))


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"time_s,tip_x_m\n0,1\n"])
def test_a_file_without_a_run_is_refused(tmp_path, content, capsys):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    assert main(["replay", str(path)]) == 2
    assert "holds no run of a twin" in capsys.readouterr().err


def test_a_file_of_another_format_is_refused(recorded, tmp_path):
    def change(content):
        if content["kind"] == "run":
            content["format"] = FORMAT + 1

    with pytest.raises(RunFileError, match=f"format {FORMAT + 1}, this version reads"):
        RunFile(rewritten(recorded, tmp_path / "newer.mcap", change))


def test_other_tools_find_scene_parameters_and_topics_in_the_file(recorded):
    with recorded.path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        topics = {channel.topic: channel.message_encoding for channel in summary.channels.values()}
        # Else ``ros2 bag`` refuses the whole file.
        assert topics == {"/twin/record": "cdr", TOPIC.name: "cdr"}
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        texts = [message.data for _, _, message in reader.iter_messages([TOPIC.name])]
        assert texts == [f"tick {number}".encode() for number in range(TICKS)]
        (scene,) = reader.iter_attachments()
        assert read_yaml(scene.data.decode()) == read_yaml(recorded.scene.read_text())
        kept = {record.name: record.metadata for record in reader.iter_metadata()}
        assert kept["parameters"]["frame_id"] == '"base_link"' and "numpy" in kept["machine"]


def test_the_text_of_every_shipped_scene_is_read_back_as_it_is():
    for path in sorted((ROOT / "config/scenes").glob("*.yaml")):
        mapping = written_out(read_yaml(path.read_text()), path)
        assert repr(read_yaml(scene_text(mapping))) == repr(mapping)


# --- recording -----------------------------------------------------------------------------------


def test_what_does_not_fit_the_queue_is_counted_and_ends_the_replay_there(scene_file, tmp_path, capsys):
    path, gate = tmp_path / "slow.mcap", threading.Event()
    live = Live(scene_file, path, most_waiting=3)
    write = live.recorder.write

    def slow(noted):
        gate.wait(30.0)
        write(noted)

    live.recorder.write = slow
    drive(live, 12)
    assert live.recorder.lost > 0
    gate.set()
    live.recorder.close()
    assert not live.recorder.failure
    run, found = replayed(path)
    assert found.is_equal and found.ticks < 12 and run.lost > 0
    assert main(["replay", str(path)]) == 1
    assert "entries were dropped after tick" in capsys.readouterr().err


def test_a_disk_that_is_full_stops_the_recording_and_not_the_loop(scene_file, tmp_path):
    path = tmp_path / "full.mcap"
    live = Live(scene_file, path)

    def full(*arguments):
        raise OSError(28, "No space left on device")

    drive(live, 4)
    live.recorder.writer.add_entry = full
    drive(live, 2)
    live.recorder.close()
    assert len(live.outcomes) == 6
    assert "No space left on device" in live.recorder.failure
    RunFile(path)


def test_a_recording_never_replaces_a_file(scene_file, recorded):
    before = recorded.path.read_bytes()
    with pytest.raises(RunFileError, match="exists already"):
        Live(scene_file, recorded.path)
    assert recorded.path.read_bytes() == before


def test_the_description_names_scene_files_parameters_and_machine(recorded):
    description = RunFile(recorded.path).description
    assert description.scene_path == str(recorded.scene) and description.began == START
    (mesh,) = description.files
    assert mesh.name == "mesh.vtk" and len(mesh.sha256) == 64
    live = Replay(RunFile(recorded.path)).loop
    parameters = description.parameters
    again = asdict(describe(live, "/twin", START, parameters))
    assert again == asdict(description)


def test_a_recorded_run_with_a_part_replays_to_the_bit(fatigue, scene_file, tmp_path):
    live = Live(scene_file, tmp_path / "run.mcap")
    drive(live, 8)
    live.recorder.close()
    told = [outcome.result.report.figures["fatigue.steps"] for outcome in live.outcomes[3:]]
    assert told[-1] > told[0] >= 1.0
    found = Replay(RunFile(tmp_path / "run.mcap")).all_ticks()
    assert found.is_equal and found.ticks == 8
