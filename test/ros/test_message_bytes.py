"""Messages as bytes against the same messages made as objects."""

import numpy as np
import pytest
from std_msgs.msg import Header

from softrobot_twin.ros.message_bytes import JointStateBytes, exact_bytes
from softrobot_twin.ros.messages import cables_message, stamp_of


@pytest.mark.parametrize("count", [0, 1, 3, 4])
def test_joints_whose_numbers_change_have_the_bytes_of_a_message_made_anew(count):
    rng = np.random.default_rng(count)
    names = [f"cable_{'x' * k}" for k in range(count)]
    joints = JointStateBytes(names, "base_link")
    for stamp in (0, 5, 1_700_000_000_987_654_321):
        positions, efforts = rng.standard_normal((2, count))
        header = Header(stamp=stamp_of(stamp), frame_id="base_link")
        made = cables_message(names, positions, efforts, header)
        assert joints.message(stamp, positions, efforts) == exact_bytes(made)
