"""What a contact detector finds, for tests."""

import numpy as np

from softrobot_twin.geometry.proximities import found_by


def near(detector, *places_and_margin):
    """The pairs that a detector writes; a detector of one surface takes its points once."""
    *places, margin = places_and_margin
    places = [np.array(place, float, order="C") for place in places]
    return found_by(detector.write, *(places if len(places) > 1 else 2 * places), margin=margin)
