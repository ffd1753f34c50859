"""A finger without a file, small enough that its steps take milliseconds."""

import copy

import pytest

import softrobot_twin as st
from test.builder import at_rest

FINGER = {
    "name": "finger",
    "body": {
        "mesh": {"box": {"size": [0.1, 0.02, 0.02], "cells": [6, 2, 2]}},
        "element": "linear",
        "material": {"young_modulus": 2.0e5, "poisson_ratio": 0.4, "density": 1000.0},
        "fixed": [{"box": {"minimum": [-0.001, -1, -1], "maximum": [0.001, 1, 1]}}],
    },
    "cables": [
        {"name": name, "pull_point": [-0.01, 0.01, height], "rate": 0.05,
         "points": [[x, 0.01, height] for x in (0.02, 0.06, 0.1)],
         "shortening": [0.0, 0.02], "tension": [0.0, 20.0]}
        for name, height in (("upper", 0.018), ("lower", 0.002))
    ],
    "effectors": [{"name": "tip", "points": [[0.1, 0.01, 0.01]], "directions": "z"}],
}
# The same held by a palm that is guided, with an orientation and a touch.
HELD = {
    **{key: value for key, value in FINGER.items() if key != "body"},
    "name": "held",
    "body": {
        **{key: value for key, value in FINGER["body"].items() if key != "fixed"},
        "attached": [{"to": "palm", "box": {"minimum": [-1, -1, -1], "maximum": [0.001, 1, 1]}}],
    },
    "rigid_bodies": [{"name": "palm", "motion": "guided", "position": [-0.01, 0.01, 0.01],
                      "speed": 0.1, "box": {"size": [0.02, 0.04, 0.04]}}],
    "effectors": [{"name": "tip", "points": [[0.1, 0.01, 0.01]],
                   "orientation": {"points": [[0.1, 0, 0], [0.1, 0.02, 0], [0.1, 0, 0.02]]}}],
    "touches": [{"name": "fingertip", "points": [[0.1, 0.01, 0.02]], "directions": "z"}],
}


@pytest.fixture
def entries():
    """Entries of the finger, which a test may change."""
    return copy.deepcopy(FINGER)


@pytest.fixture(scope="module")
def built():
    """The finger, built once for the tests of a module."""
    return st.build(**FINGER)


finger = at_rest("built")
"""The finger at rest."""


@pytest.fixture(scope="module")
def built_held():
    """The finger at a palm, built once for the tests of a module."""
    return st.build(**HELD)


held = at_rest("built_held")
"""The finger at a palm, at rest."""
