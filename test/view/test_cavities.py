"""Cavities in a recording: their walls coloured by pressure, and curves of what fills them."""

import dataclasses

import numpy as np
import pytest

from softrobot_twin.simulation import colours as module
from softrobot_twin.simulation.colours import pressure_colours, pressure_legend
from softrobot_twin.view import Surface, ViewError

TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
CORNERS = 0.02 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


@pytest.fixture
def inflated_stage(stage):
    """The stage with two cavities and no cables."""
    cavities = (Surface("left", TRIANGLES), Surface("right", TRIANGLES[:2]))
    return dataclasses.replace(
        stage, cable_names=(), cavities=cavities, pressure_range=(-5.0e3, 20.0e3)
    )


@pytest.fixture
def make_inflated(make_frame):
    """Makes a frame of that stage."""

    def make(step, pressures=(0.0, 0.0), **changes):
        return make_frame(step, **{
            "cable_paths": (), "cable_lengths": np.empty(0), "cable_tensions": np.empty(0),
            "cavity_positions": (CORNERS * (1.0 + 0.1 * step), CORNERS + [0.1, 0.0, 0.0]),
            "cavity_pressures": np.array(pressures), "cavity_volumes": np.array([5.0e-6, 2.0e-6]),
            **changes})

    return make


@pytest.fixture
def draw(tmp_path, read_recording):
    """Draws frames of a stage into a file, one by one, and reads it back."""
    from softrobot_twin.view import recording
    from softrobot_twin.view.picture import Picture, layout

    def draw(stage, frames):
        path = tmp_path / "drawn.rrd"
        drawn = Picture(recording.record_to(path, "test", layout(stage)), stage)
        for frame in frames:
            drawn.log(frame)
        drawn.close(10.0)
        return read_recording(path)

    return draw


def test_the_walls_of_each_cavity_are_at_their_state_in_the_colour_of_its_pressure(
    draw, inflated_stage, make_inflated
):
    frames = [make_inflated(0), make_inflated(3, (20.0e3, -5.0e3))]
    recorded = draw(inflated_stage, frames)
    assert recorded.static("/robot/cavities/left", "Mesh3D:triangle_indices") == TRIANGLES.tolist()
    for index, name in enumerate(("left", "right")):
        places = recorded.at_steps(f"/robot/cavities/{name}", "Mesh3D:vertex_positions")
        colours = recorded.at_steps(f"/robot/cavities/{name}", "Mesh3D:albedo_factor")
        assert places.keys() == colours.keys() == {0, 3}
        for frame in frames:
            expected = frame.cavity_positions[index]
            assert np.array(places[frame.step]) == pytest.approx(expected, abs=1e-7)
            colour = pressure_colours(frame.cavity_pressures, (-5.0e3, 20.0e3))[index]
            red, green, blue, alpha = map(int, colour)
            assert colours[frame.step] == [red << 24 | green << 16 | blue << 8 | alpha]


def test_curves_name_cavities_and_units(draw, inflated_stage, make_inflated):
    recorded = draw(inflated_stage, [make_inflated(1, (2500.0, -100.0))])
    assert recorded.curve_names("/plots/cavity_pressures") == ["left [kPa]", "right [kPa]"]
    assert recorded.curve_names("/plots/cavity_volumes") == ["left [cm³]", "right [cm³]"]
    assert recorded.curves("/plots/cavity_pressures")[1] == pytest.approx([2.5, -0.1])
    assert recorded.curves("/plots/cavity_volumes")[1] == pytest.approx([5.0, 2.0])


def test_nothing_is_drawn_for_cables_or_cavities_that_a_robot_does_not_have(
    draw, stage, make_frame, inflated_stage, make_inflated
):
    with_cavities = draw(inflated_stage, [make_inflated(0)]).entities
    assert not [path for path in with_cavities if "cable" in path]
    with_cables = draw(stage, [make_frame(0)]).entities
    assert not [path for path in with_cables if "cavit" in path]


@pytest.mark.parametrize("key", ["cavity_positions", "cavity_pressures", "cavity_volumes"])
def test_a_frame_with_one_cavity_too_few_is_refused_by_name(inflated_stage, make_inflated, key):
    frame = make_inflated(0)
    short = dataclasses.replace(frame, **{key: getattr(frame, key)[:1]})
    with pytest.raises(ViewError, match=key):
        short.check_against(inflated_stage)


def test_no_pressure_is_grey_the_limit_red_and_a_vacuum_blue():
    vacuum, nothing, limit = pressure_colours(
        np.array([-20.0e3, 0.0, 20.0e3]), (-20.0e3, 20.0e3)
    ).astype(int)
    assert vacuum[2] > 180 and vacuum[0] < 80
    assert np.ptp(nothing[:3]) < 15
    assert limit[0] > 200 and limit[1:3].max() < 60
    assert vacuum[3] == nothing[3] == limit[3] == 255


def test_a_vacuum_is_as_strong_a_colour_as_the_same_pressure():
    weak = pressure_colours(np.array([-1.0e3, -20.0e3, 40.0e3]), (-1.0e3, 20.0e3))
    strong = pressure_colours(np.array([-1.0e3]), (-20.0e3, 20.0e3))
    # Beyond the range it is the colour of the range's end.
    assert (weak[0] == weak[1]).all() and (weak[0] == strong[0]).all()
    assert (weak[2] == pressure_colours(np.array([20.0e3]), (0.0, 20.0e3))[0]).all()
    lab = module.to_oklab(np.array([weak[0], pressure_colours([0.0], (0.0, 1.0))[0]])[:, :3] / 255)
    assert np.linalg.norm(lab[0] - lab[1]) < 0.02


def test_a_pressure_that_is_not_finite_is_magenta():
    assert pressure_colours([np.nan, np.inf], (0.0, 1.0)).tolist() == [[255, 0, 255, 255]] * 2


@pytest.mark.parametrize(("pressures", "words"), [
    ((0.0, 20.0e3), "grey 0, red 20 kPa"),
    ((-5.0e3, 20.0e3), "blue -20, grey 0, red 20 kPa"),
    ((-5.0e3, 0.0), "blue -5, grey 0 kPa"),
])
def test_the_legend_states_both_ends_of_the_scale(pressures, words):
    assert pressure_legend(pressures) == words
