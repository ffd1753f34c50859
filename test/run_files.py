"""Files that runs read and write."""

import csv
from pathlib import Path

# The tip of the column of the tests is brought to three places.
TARGETS = ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0.0105,0.01,0.098\n0.02,0.011,0.01,0.0975\n"
           "0.04,0.011,0.0095,0.097\n")  # fmt: skip


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a file, as texts by their columns."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
