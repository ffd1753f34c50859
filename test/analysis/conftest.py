"""Scenes that the tests of this room share with those of the simulation."""

from test.simulation.conftest import (  # noqa: F401
    beam, body_of, diamond, hollow, inflatable, rod, simulate, two_cavities, write_block)
