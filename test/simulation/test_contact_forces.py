"""Forces of a pair of bodies as a whole."""

import numpy as np

from softrobot_twin.simulation.result import ContactForces


def contact_forces(forces, pairs, names):
    count = len(forces)
    return ContactForces(
        np.zeros((count, 3)), np.array(forces, float).reshape(-1, 3), np.zeros(count),
        np.array(pairs, int), names,
    )  # fmt: skip


def test_forces_from_two_sides_cancel_in_the_resultant_and_not_in_the_sum_of_magnitudes():
    names = (("finger", "cube"), ("cube", "floor"))
    contacts = contact_forces([[2, 0, 0], [-2, 0, 1], [0, 0, 3]], [0, 0, 1], names)
    of_pairs = contacts.of_pairs()
    assert of_pairs.names == names
    np.testing.assert_allclose(of_pairs.resultants, [[0, 0, 1], [0, 0, 3]])
    np.testing.assert_allclose(of_pairs.magnitude_sums, [2 + np.sqrt(5), 3])


def test_a_pair_defined_twice_is_reported_once():
    names = (("a", "a"), ("a", "b"), ("a", "a"))
    contacts = contact_forces([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0, 1, 2], names)
    of_pairs = contacts.of_pairs()
    assert of_pairs.names == (("a", "a"), ("a", "b"))
    np.testing.assert_allclose(of_pairs.resultants, [[1, 0, 1], [0, 1, 0]])


def test_without_contacts_every_pair_has_zero_force():
    of_pairs = contact_forces([], [], (("a", "b"),)).of_pairs()
    np.testing.assert_array_equal(of_pairs.resultants, [[0, 0, 0]])
    np.testing.assert_array_equal(of_pairs.magnitude_sums, [0])
