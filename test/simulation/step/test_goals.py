"""A step asks its goal for all that differs by the command, and no command for its type."""

import re
from pathlib import Path

from softrobot_twin.simulation import simulation

ROOM = Path(simulation.__file__).parent
KINDS = r"isinstance\([^)]*(FollowTargets|CommandSetpoints|CommandEfforts|Hold)\b|type\((command|goal)\)"


def test_only_goals_know_which_kind_a_command_is():
    files = ROOM / "simulation.py", *(ROOM / "step").glob("*.py")
    assert [one.name for one in files if re.search(KINDS, one.read_text())] == ["goals.py"]
