"""Waits for what the processes beside a twin tell of its errors."""

import time


def offer_until(watch, simulation, condition, forces_given=False, patience=120.0):
    """Offers as the node does, until something is so."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        watch.offer(simulation, forces_given, time.monotonic())
        time.sleep(0.02)
