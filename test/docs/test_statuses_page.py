"""docs/statuses.md names each word that a run or a node may show."""


import pytest

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.engagement import Activity
from softrobot_twin.simulation import Status
from test.places import ROOT

TEXT = (ROOT / "docs" / "statuses.md").read_text()
@pytest.mark.parametrize("word", [*Status, *Activity, *Refusal], ids=lambda word: word.name)
def test_the_page_has_a_row_for_each_word(word):
    rows = [line for line in TEXT.splitlines() if line.startswith(f"| `{word.value}` |")]
    assert len(rows) == 1
    meaning, remedy = rows[0].strip("| ").split(" | ")[1:3]
    assert len(meaning) > 10 and remedy
