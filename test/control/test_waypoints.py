"""Paths from CSV files."""

import numpy as np
import pytest

from softrobot_twin.control.target_path import Round, make_path
from softrobot_twin.errors import ParameterError

AROUND = Round((0.0, 0.0, 0.0), 0.02, 10.0)
HEADER = "t,tip.x,tip.y,tip.z,other.x"


def read(tmp_path, text):
    file = tmp_path / "path.csv"
    file.write_text(text)
    return make_path(str(file), "tip", AROUND)


def test_a_file_is_followed_in_straight_lines_and_kept_at_its_end(tmp_path):
    path = read(tmp_path, f"{HEADER}\n0.0,0.0,0.0,0.1,9\n2.0,0.02,0.0,0.1,9\n")
    assert path.position(0.5) == pytest.approx([0.005, 0.0, 0.1])
    assert path.position(100.0) == pytest.approx([0.02, 0.0, 0.1])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("t,tip.x,tip.y\n0,0,0\n", r"lacks the columns \['tip.z'\]"),
        (f"{HEADER}\n", "no rows"),
        ("", "no rows"),
        (f"{HEADER}\n0,0,0,zero,0\n", "is not numbers"),
        (f"{HEADER}\n0,0\n", "is not numbers"),
        (f"{HEADER}\n0,0,0,nan,0\n", "not finite"),
        (f"{HEADER}\n1,0,0,0,0\n1,0,0,0,0\n", "must increase"),
    ],
)
def test_a_file_that_is_no_path_is_refused_with_the_reason(tmp_path, text, reason):
    with pytest.raises(ParameterError, match=reason):
        read(tmp_path, text)


def test_a_file_that_is_not_there_is_refused():
    with pytest.raises(ParameterError, match="cannot be read"):
        make_path("/nowhere/path.csv", "tip", AROUND)


def test_a_file_of_one_point_holds_it(tmp_path):
    path = read(tmp_path, f"{HEADER}\n0,0.01,0.02,0.03,0\n")
    assert np.array_equal(path.position(7.0), [0.01, 0.02, 0.03])
