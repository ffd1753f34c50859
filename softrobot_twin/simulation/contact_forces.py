"""Contacts of a step with their forces, for reports, pictures and messages."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.compilation import KERNEL, njit
from softrobot_twin.constraints.contact import Contacts

# Contacts that carry less than this share of all loads are omitted.
CARRIES = 1.0e-9


@njit(**KERNEL)
def find_carrying(multipliers, row_starts, least, carrying):
    """Write the contacts whose normal force is above the least, in their order.

    Args:
        multipliers: λ of the contacts' rows [N], shape (contact_row_count,).
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        least: Least normal force [N].
        carrying: Takes the contacts, shape (contact_count,).

    Returns:
        Number of these contacts.
    """
    count = 0
    for c in range(len(row_starts) - 1):
        if multipliers[row_starts[c]] > least:
            carrying[count] = c
            count += 1
    return count


@njit(**KERNEL)
def write_contact_forces(chosen, multipliers, directions, row_starts, forces):
    """Σ λ d of some contacts.

    Args:
        chosen: The contacts, shape (count,).
        multipliers: λ of the rows of all contacts [N], shape (contact_row_count,).
        directions: Normal and tangents of each contact, shape (contact_count, 3, 3).
        row_starts: First row of each contact and the number of rows, shape (contact_count + 1,).
        forces: Takes the forces [N], shape (count, 3).
    """
    for c in range(len(chosen)):
        for i in range(3):
            forces[c, i], first = 0.0, row_starts[chosen[c]]
            for k in range(row_starts[chosen[c] + 1] - first):
                forces[c, i] += multipliers[first + k] * directions[chosen[c], k, i]


class PairForces(NamedTuple):
    """Forces of each pair of bodies as a whole.

    Attributes:
        names: Names of both bodies of each pair, each pair once.
        resultants: Sum of the forces on the first body [N], shape (pair_count, 3); the force on the
            second is opposite. Forces of a body on itself partly cancel.
        magnitude_sums: Sum of the forces' magnitudes [N], shape (pair_count,): how strongly the two
            are pressed together, also if they touch on several sides.
    """

    names: tuple[tuple[str, str], ...]
    resultants: np.ndarray
    magnitude_sums: np.ndarray


class ContactForces(NamedTuple):
    """Contacts that carry force.

    Attributes:
        positions: Points of the first body [m], shape (count, 3).
        forces: Force on the first body [N], shape (count, 3); that on the second is opposite.
        gaps: Distance there, negative where they overlap [m], shape (count,).
        pairs: Pair of each, an index into `names`, shape (count,).
        names: Names of both bodies of each pair that may touch.
    """

    positions: np.ndarray
    forces: np.ndarray
    gaps: np.ndarray
    pairs: np.ndarray
    names: tuple[tuple[str, str], ...]

    def of_pairs(self) -> PairForces:
        """Resultant and sum of magnitudes of every pair, zero without contact."""
        names = tuple(dict.fromkeys(self.names))
        place = np.array([names.index(pair) for pair in self.names], dtype=np.int64)[self.pairs]
        resultants, sums = np.zeros((len(names), 3)), np.zeros(len(names))
        np.add.at(resultants, place, self.forces)
        np.add.at(sums, place, np.linalg.norm(self.forces, axis=1))
        return PairForces(names, resultants, sums)


def contact_forces(
    contacts: Contacts, multipliers: np.ndarray, positions: np.ndarray, load: float
) -> ContactForces:
    """Contacts that carry force.

    Args:
        contacts: The contact term.
        multipliers: λ of the present contacts [N], shape (contact_row_count,).
        positions: Node positions after the step [m], shape (node_count, 3).
        load: Sum of the magnitudes of all loads [N], the scale of round-off.
    """
    row_starts, carrying = contacts.row_starts, np.empty(contacts.count, np.int64)
    count = find_carrying(multipliers, row_starts, CARRIES * load, carrying)
    carrying, forces = carrying[:count], np.empty((count, 3))
    write_contact_forces(carrying, multipliers, contacts.directions, row_starts, forces)
    return ContactForces(
        contacts.positions[carrying], forces, contacts.gaps(positions)[carrying],
        contacts.pair[carrying], contacts.pair_names,
    )  # fmt: skip
