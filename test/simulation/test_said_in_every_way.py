"""A robot answers the same however its scene says it, or a status or a warning tells why not."""

from random import Random

import pytest

from test.robots_said_in_every_way import KINDS, disagreements

# Each case is drawn anew. One of each kind is for `make test`, all for `make test-all`.
CASES = [pytest.param(count, marks=[pytest.mark.exhaustive] * (count >= 1)) for count in range(20)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", CASES)
def test_a_robot_answers_the_same_however_it_is_said(kind, count, tmp_path, drawn_seed):
    assert not disagreements(KINDS[kind](Random(drawn_seed), tmp_path))
