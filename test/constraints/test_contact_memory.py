"""Facts of what is remembered of contacts from step to step."""

import numpy as np
import pytest

from softrobot_twin.constraints.contact import ContactMemory


def recognise(memory, pairs, keys, row_counts=None):
    """Look up contacts, of three rows each where nothing else is said."""
    row_counts = np.full(len(pairs), 3) if row_counts is None else np.array(row_counts)
    starts = np.concatenate([[0], np.cumsum(row_counts, dtype=np.int64)])
    memory.recognise(np.array(pairs, np.int64), np.array(keys, np.int64), starts)


@pytest.fixture
def memory():
    """Three contacts of two pairs, with friction, and what they bore."""
    memory = ContactMemory(3)
    recognise(memory, [0, 0, 1], [7, 9, 7])
    memory.remember(np.arange(9.0))
    return memory


def test_known_contacts_start_from_their_last_forces(memory):
    recognise(memory, [0, 0, 1], [7, 9, 7])
    np.testing.assert_array_equal(memory.guess, np.arange(9.0))


def test_forces_follow_the_key_of_a_contact_and_are_zero_for_a_new_one(memory):
    recognise(memory, [0, 1, 1, 0], [9, 9, 7, 7])
    np.testing.assert_array_equal(memory.guess, [3, 4, 5, 0, 0, 0, 6, 7, 8, 0, 1, 2])


def test_a_contact_that_opened_is_new_when_it_closes_again(memory):
    recognise(memory, [], [])
    memory.remember(np.zeros(0))
    recognise(memory, [0], [7])
    np.testing.assert_array_equal(memory.guess, np.zeros(3))


def test_the_change_of_force_of_the_last_step_is_extrapolated(memory):
    memory.begin_step()
    recognise(memory, [0, 0, 1], [7, 9, 7])
    memory.remember(np.arange(9.0) + 2.0)
    memory.begin_step()
    recognise(memory, [0, 1, 1], [9, 8, 7])
    np.testing.assert_array_equal(memory.guess, [5, 6, 7, 0, 0, 0, 8, 9, 10])
    np.testing.assert_array_equal(memory.expected, [7, 8, 9, 0, 0, 0, 10, 11, 12])


def test_the_change_of_force_counts_from_the_start_of_the_step(memory):
    memory.begin_step()
    for change in (5.0, 1.0):
        recognise(memory, [0, 0, 1], [7, 9, 7])
        memory.remember(np.arange(9.0) + change)
    recognise(memory, [0, 0, 1], [7, 9, 7])
    np.testing.assert_array_equal(memory.expected, memory.guess)
    memory.begin_step()
    recognise(memory, [0, 0, 1], [7, 9, 7])
    np.testing.assert_array_equal(memory.expected, memory.guess + 1.0)
