"""Content of an .rrd file after frames have been drawn into it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.simulation.colours import tension_colours
from softrobot_twin.view import ViewError
from softrobot_twin.view.frame import OtherActuator


@pytest.fixture
def draw(stage, tmp_path, read_recording):
    """Draws frames into a file, one by one, and reads it back."""
    from softrobot_twin.view import picture, recording
    from softrobot_twin.view.picture import Picture

    def draw(frames, path: Path = tmp_path / "drawn.rrd", stage=stage):
        file = recording.record_to(path, "test", picture.layout(stage))
        drawn = Picture(file, stage)
        for frame in frames:
            drawn.log(frame)
        drawn.close(10.0)
        return read_recording(path)

    return draw


def test_a_recording_holds_the_robot_its_surroundings_and_its_curves(draw, make_frame):
    entities = draw([make_frame(0)]).entities
    assert {"/robot/surface/body", "/robot/cables", "/robot/effectors", "/robot/effector_trail",
            "/targets", "/markers/predicted", "/markers/measured", "/status"} <= entities
    plots = {"/".join(path.split("/")[:3]) for path in entities if path.startswith("/plots/")}
    assert plots == {f"/plots/{name}" for name in (
        "effector_error", "cable_lengths", "cable_tensions", "stage_times", "residual")}


def test_space_is_right_handed_with_z_up(draw, make_frame):
    from rerun import ViewCoordinates
    (logged,) = draw([make_frame(0)]).static("/", "ViewCoordinates:xyz")
    expected = ViewCoordinates.RIGHT_HAND_Z_UP.as_component_batches()[-1].as_arrow_array()
    assert logged == expected.to_pylist()[-1]


def test_triangles_are_logged_once_and_positions_at_each_step(draw, make_frame, stage):
    frames = [make_frame(step) for step in (3, 4, 8)]
    recorded = draw(frames)
    assert recorded.static("/robot/surface/body", "Mesh3D:triangle_indices") == \
        stage.bodies[0].triangles.tolist()
    positions = recorded.at_steps("/robot/surface/body", "Mesh3D:vertex_positions")
    assert positions.keys() == {3, 4, 8}
    for frame in frames:
        assert np.array(positions[frame.step]) == pytest.approx(frame.surface_positions[0], abs=1e-8)


def test_the_surface_has_unit_normals_that_follow_it(draw, make_frame):
    normals = draw([make_frame(0), make_frame(50)]).at_steps(
        "/robot/surface/body", "Mesh3D:vertex_normals")
    assert np.linalg.norm(normals[0], axis=1) == pytest.approx(np.ones(4), abs=1e-6)
    assert np.abs(np.subtract(normals[50], normals[0])).max() > 0.1


def test_cables_are_lines_coloured_by_tension(draw, make_frame, stage):
    frame = make_frame(5, cable_tensions=np.array([3.0, 19.0]))
    recorded = draw([frame])
    strips = recorded.at_steps("/robot/cables", "LineStrips3D:strips")[5]
    for strip, path in zip(strips, frame.cable_paths, strict=True):
        assert np.array(strip) == pytest.approx(path, abs=1e-8)
    colours = np.array(recorded.at_steps("/robot/cables", "LineStrips3D:colors")[5], dtype=">u4")
    expected = tension_colours(frame.cable_tensions, stage.tension_range)
    assert colours.view(np.uint8).reshape(-1, 4).tolist() == expected.tolist()
    assert recorded.static("/robot/cables", "LineStrips3D:labels") == list(stage.cable_names)


def test_pull_points_are_the_beginnings_of_the_cables(draw, make_frame):
    frame = make_frame(5)
    places = draw([frame]).at_steps("/robot/pull_points", "Points3D:positions")
    assert places.keys() == {5}
    assert np.array(places[5]) == pytest.approx(np.array([p[0] for p in frame.cable_paths]), abs=1e-8)


def test_fixed_points_are_logged_once_and_only_where_there_are_any(draw, make_frame, stage):
    fixed = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.02]])
    recorded = draw([make_frame(0)], stage=replace(stage, fixed_points=fixed))
    assert np.array(recorded.static("/robot/fixed", "Points3D:positions")) == pytest.approx(fixed)
    assert "/robot/fixed" not in draw([make_frame(0)]).entities


def test_points_are_at_the_positions_of_the_frame(draw, make_frame):
    frame = make_frame(2)
    recorded = draw([frame])
    for entity, positions in (("/robot/effectors", frame.effector_positions),
                              ("/targets", frame.targets),
                              ("/markers/predicted", frame.predicted_markers),
                              ("/markers/measured", frame.measured_markers)):
        logged = recorded.at_steps(entity, "Points3D:positions")[2]
        assert np.array(logged) == pytest.approx(positions, abs=1e-8), entity


def test_a_hidden_marker_is_omitted_and_the_others_keep_their_names(draw, make_frame):
    markers = make_frame(0).measured_markers
    markers[1] = np.nan
    recorded = draw([make_frame(0, measured_markers=markers)])
    logged = recorded.at_steps("/markers/measured", "Points3D:positions")[0]
    assert np.array(logged) == pytest.approx(markers[[0, 2]], abs=1e-8)
    assert recorded.at_steps("/markers/measured", "Points3D:labels")[0] == ["4", "9"]
    assert recorded.static("/markers/predicted", "Points3D:labels") == ["4", "7", "9"]


def test_a_removed_target_is_no_longer_shown(draw, make_frame):
    nowhere = np.full((1, 3), np.nan)
    recorded = draw([make_frame(0), make_frame(1, targets=nowhere, effector_error=np.nan)])
    positions = recorded.at_steps("/targets", "Points3D:positions")
    assert len(positions[0]) == 1
    assert positions[1] == []


def test_the_trail_ends_at_the_effector(draw, make_frame):
    frames = [make_frame(step) for step in (0, 10, 20)]
    (effector_path,) = draw(frames).at_steps("/robot/effector_trail", "LineStrips3D:strips")[20]
    expected = np.vstack([frame.effector_positions for frame in frames])
    assert np.array(effector_path) == pytest.approx(expected, abs=1e-8)


def test_an_effector_of_nan_position_does_not_break_the_trail(draw, make_frame):
    lost = np.full((1, 3), np.nan)
    frames = [make_frame(0), make_frame(10, effector_positions=lost), make_frame(20)]
    (effector_path,) = draw(frames).at_steps("/robot/effector_trail", "LineStrips3D:strips")[20]
    assert np.isfinite(effector_path).all()


def test_curves_have_their_names_and_display_units(draw, make_frame, stage):
    frame = make_frame(4)
    recorded = draw([frame])
    assert recorded.curve_names("/plots/cable_lengths") == list(stage.cable_names)
    assert recorded.curve_names("/plots/cable_tensions") == list(stage.cable_names)
    assert recorded.curves("/plots/cable_lengths")[4] == pytest.approx([104.0, 200.0])
    assert recorded.curves("/plots/cable_tensions")[4] == pytest.approx([0.0, 20.0])
    assert recorded.curves("/plots/effector_error")[4] == pytest.approx([2.0, 0.5, 3.0])
    assert recorded.curves("/plots/residual")[4] == pytest.approx([1e-6])
    assert recorded.curve_names("/plots/stage_times") == ["whole step", "assembly", "factor"]
    assert recorded.curves("/plots/stage_times")[4] == pytest.approx([3.0, 1.0, 1.5])


def test_a_stage_that_appears_later_gets_its_own_curve(draw, make_frame):
    recorded = draw([make_frame(0, stage_times={"assembly": 0.001}),
                     make_frame(1, stage_times={"contact": 0.002, "assembly": 0.001}),
                     make_frame(2, stage_times={"contact": 0.002})])
    assert recorded.curve_names("/plots/stage_times") == ["whole step", "assembly", "contact"]
    curves = recorded.curves("/plots/stage_times")
    assert curves[0] == pytest.approx([3.0, 1.0])
    assert curves[1] == pytest.approx([3.0, 1.0, 2.0])
    assert curves[2] == pytest.approx([3.0, np.nan, 2.0], nan_ok=True)


def test_the_status_is_logged_when_it_changes(draw, make_frame):
    statuses = ["ok", "ok", "saturated", "saturated", "ok"]
    recorded = draw([make_frame(step, status=status) for step, status in enumerate(statuses)])
    assert recorded.at_steps("/status", "TextLog:text") == {0: ["ok"], 2: ["saturated"], 4: ["ok"]}


def test_other_actuators_than_cables_have_curves_in_their_own_units(draw, make_frame, stage):
    others = (OtherActuator("platform", "m", "N"), OtherActuator("cavity", "m3", "Pa"))
    moved = replace(stage, other_actuators=others)
    setpoints, efforts = np.array([0.012, 2e-6]), np.array([-1.5, 3e4])
    frame = make_frame(3, other_setpoints=setpoints, other_efforts=efforts)
    recorded = draw([frame], stage=moved)
    names = ["platform [mm]", "platform [N]", "cavity [m3]", "cavity [Pa]"]
    assert recorded.curve_names("/plots/actuators") == names
    assert recorded.curves("/plots/actuators")[3] == pytest.approx([12.0, -1.5, 2e-6, 3e4])
    assert recorded.curve_names("/plots/cable_lengths") == list(stage.cable_names)


def test_orientations_of_effectors_and_targets_are_drawn_as_axes(draw, make_frame, stage):
    half = np.sqrt(0.5)
    turned, none = np.array([[0.0, 0.0, half, half]]), np.full((1, 4), np.nan)
    posed = replace(stage, axis_length=0.02)
    frames = [make_frame(0, effector_orientations=turned, target_orientations=none),
              make_frame(1, effector_orientations=turned, target_orientations=turned)]
    recorded = draw(frames, stage=posed)
    axes = recorded.at_steps("/robot/effector_axes", "Arrows3D:vectors")
    np.testing.assert_allclose(axes[0], 0.02 * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
                               atol=1e-8)
    wanted = recorded.at_steps("/target_axes", "Arrows3D:vectors")
    assert len(wanted[0]) == 0 and len(wanted[1]) == 3


def test_nothing_is_drawn_of_orientations_that_no_effector_asks_for(draw, make_frame):
    assert not any("axes" in path for path in draw([make_frame(0)]).entities)


def test_orientations_must_fit_the_stage(make_frame, stage):
    with pytest.raises(ViewError, match="effector_orientations"):
        make_frame(0).check_against(replace(stage, axis_length=0.02))
