"""Pairs of a vertex and a triangle of one surface that never count, as a kernel looks them up."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.geometry.nearest_feature import EDGE, FACE

# Why a vertex must not be paired with a triangle, in `RestPairs.codes`: they are neighbours, or the
# vertex is a corner of it. SURROUNDED is added where the same holds for all triangles around that.
NEIGHBOUR, TOUCHING, SURROUNDED = 1, 2, 2
# Codes are below this.
_CODE_COUNT = 8


class RestPairs(NamedTuple):
    """Vertices and triangles of one surface that must never be paired.

    Attributes:
        offsets: Where the triangles of each point start, shape (point_count + 1,); length 0 where
            the two surfaces are not the same.
        triangles: The triangles.
        codes: Why, one for each of the triangles.
        stamps: Work space, shape (triangle_count,).
    """

    offsets: np.ndarray
    triangles: np.ndarray
    codes: np.ndarray
    stamps: np.ndarray


def no_rest_pairs() -> RestPairs:
    """What two different surfaces have: every pair counts."""
    none = np.zeros(0, dtype=np.int64)
    return RestPairs(none, none, none, none)


@njit(cache=True, nogil=True, error_model="numpy")
def stamp(rest, v):
    """Mark the triangles that vertex v must not be paired with."""
    for k in range(rest.offsets[v], rest.offsets[v + 1]):
        rest.stamps[rest.triangles[k]] = _CODE_COUNT * v + rest.codes[k]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def stamps_of_surrounded(v):
    """First and last stamp of the triangles of which no feature can be paired with vertex v."""
    return (_CODE_COUNT * v + SURROUNDED + 1, _CODE_COUNT * v + _CODE_COUNT - 1)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def code_of(stamps, v, t):
    """Why vertex v must not be paired with triangle t, 0 if it may; after `stamp`."""
    code = stamps[t] - _CODE_COUNT * v
    return code if 0 < code < _CODE_COUNT else 0


@njit(cache=True, nogil=True, error_model="numpy")
def is_barred(stamps, surface, v, kind, feature):
    """Whether a vertex must not be paired with a feature: with no triangle at it, or touching."""
    if kind == FACE:
        return code_of(stamps, v, feature) > 0
    every = True
    for k in range(2 if kind == EDGE else surface.fans[feature, 0]):
        t = surface.edges[feature, 2 + k] if kind == EDGE else surface.fans[feature, 1 + 3 * k]
        code = code_of(stamps, v, t)
        if code == TOUCHING or code == TOUCHING + SURROUNDED:
            return True
        every = every and code > 0
    return every
