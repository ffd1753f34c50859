"""Facts of what is remembered of contacts from step to step."""

import numpy as np
import pytest

from softrobot_twin.constraints.contact import ContactMemory


@pytest.fixture
def memory():
    """Three contacts of two pairs, with friction, and what they bore."""
    memory = ContactMemory(3)
    memory.recognise(np.array([0, 0, 1]), np.array([7, 9, 7]))
    memory.remember(np.arange(9.0))
    return memory


def test_the_same_contacts_begin_where_they_ended(memory):
    memory.recognise(np.array([0, 0, 1]), np.array([7, 9, 7]))
    np.testing.assert_array_equal(memory.guess, np.arange(9.0))


def test_a_contact_is_found_whatever_row_it_stands_in_and_a_new_one_bears_nothing(memory):
    memory.recognise(np.array([0, 1, 1, 0]), np.array([9, 9, 7, 7]))
    np.testing.assert_array_equal(memory.guess, [3, 4, 5, 0, 0, 0, 6, 7, 8, 0, 1, 2])


def test_what_is_done_to_a_guess_is_not_remembered(memory):
    memory.recognise(np.array([0, 0, 1]), np.array([7, 9, 7]))
    memory.guess[:] = -1.0
    memory.recognise(np.array([1]), np.array([7]))
    np.testing.assert_array_equal(memory.guess, [6, 7, 8])


def test_what_parted_and_comes_back_is_new(memory):
    memory.recognise(np.zeros(0, np.int64), np.zeros(0, np.int64))
    memory.remember(np.zeros(0))
    memory.recognise(np.array([0]), np.array([7]))
    np.testing.assert_array_equal(memory.guess, np.zeros(3))


def test_forgetting_leaves_nothing(memory):
    memory.forget()
    assert memory.known == [] and len(memory.guess) == 0
    memory.recognise(np.array([0]), np.array([7]))
    np.testing.assert_array_equal(memory.guess, np.zeros(3))


def test_the_change_of_the_step_before_is_expected_again(memory):
    memory.begin_step()
    memory.recognise(np.array([0, 0, 1]), np.array([7, 9, 7]))
    memory.remember(np.arange(9.0) + 2.0)
    memory.begin_step()
    memory.recognise(np.array([0, 1, 1]), np.array([9, 8, 7]))
    np.testing.assert_array_equal(memory.guess, [5, 6, 7, 0, 0, 0, 8, 9, 10])
    np.testing.assert_array_equal(memory.expected, [7, 8, 9, 0, 0, 0, 10, 11, 12])


def test_the_change_counts_from_where_the_step_began_whatever_was_found_within_it(memory):
    memory.begin_step()
    for change in (5.0, 1.0):
        memory.recognise(np.array([0, 0, 1]), np.array([7, 9, 7]))
        memory.remember(np.arange(9.0) + change)
    memory.recognise(np.array([0, 0, 1]), np.array([7, 9, 7]))
    np.testing.assert_array_equal(memory.expected, memory.guess)
    memory.begin_step()
    memory.recognise(np.array([0, 0, 1]), np.array([7, 9, 7]))
    np.testing.assert_array_equal(memory.expected, memory.guess + 1.0)


def test_after_forgetting_nothing_is_expected(memory):
    memory.begin_step()
    memory.forget()
    memory.recognise(np.array([0]), np.array([7]))
    np.testing.assert_array_equal(memory.expected, np.zeros(3))
