"""Facts of the addition of stiffness blocks to the storage of the system matrix."""

import numpy as np
import pytest

from softrobot_twin.mechanics.block_addition import (
    add_blocks,
    add_contiguous_blocks,
    are_contiguous,
)
from softrobot_twin.mechanics.element_batches import BATCH


def blocks(seed):
    """Random blocks, their places (some absent, some shared), and a storage."""
    rng = np.random.default_rng(seed)
    places = 9 * rng.integers(0, 12, BATCH)
    places[rng.random(BATCH) < 0.2] = -1
    return places, rng.standard_normal(9 * BATCH), rng.standard_normal(9 * 12)


@pytest.mark.parametrize("seed", range(20))
def test_contiguous_blocks_are_added_as_others_are_to_the_bit(seed):
    places, K, storage = blocks(seed)
    one_by_one = storage.copy()
    add_blocks(places, np.full(BATCH, 3), K, one_by_one)
    add_contiguous_blocks(places, K, storage)
    np.testing.assert_array_equal(storage, one_by_one)


def test_each_block_goes_to_its_place():
    places, K, storage = blocks(100)
    expected = storage.copy()
    for e in np.flatnonzero(places >= 0):
        expected[places[e] : places[e] + 9] += K.reshape(9, BATCH)[:, e]
    add_contiguous_blocks(places, K, storage)
    np.testing.assert_allclose(storage, expected, rtol=1e-14, atol=1e-14)


def test_blocks_that_are_absent_may_have_any_stride():
    places = np.array([[0, -1, 9]])
    assert are_contiguous(places, np.array([[3, 0, 3]]))
    assert not are_contiguous(places, np.array([[3, 0, 4]]))
