"""What touches what, as a step found it: a value for reports, pictures and messages."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class ContactForces(NamedTuple):
    """Contacts that carry force.

    Attributes:
        positions: Where the first body is touched [m], shape (count, 3).
        forces: Force on the first body [N], shape (count, 3); the second bears the opposite.
        gaps: Distance there, negative where they overlap [m], shape (count,).
        pairs: Which pair of the scene each belongs to, an index into `names`, shape (count,).
        names: Names of both bodies of each pair that may touch.
    """

    positions: np.ndarray
    forces: np.ndarray
    gaps: np.ndarray
    pairs: np.ndarray
    names: tuple[tuple[str, str], ...]
