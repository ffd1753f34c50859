"""The ranges in which bodies can be believed: those of reductions, of strains of laws, and of hexahedra.

Of a body in the coordinates of a basis, each coordinate counts by the largest magnitude that it had
in the training. The root mean square of these shares is known in every step for next to nothing.
The largest share would be above one at a tenth to a quarter of fresh states inside of the range:
the last coordinates are small and noisy, and the more of them there are, the more often one exceeds
what it had in a few hundred states. The root mean square is above one at 1 % of these states.
Outside of the range it is several times one, since coordinates that were small grow first.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.strain_watch import StrainOutside
from softrobot_twin.simulation.building.deformable_body import of_kind
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.reduced_body import ReducedBody
from softrobot_twin.simulation.result import COARSE, SAMPLED, STRAINED
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import PartReport, StepPart


class CoordinateRange(NamedTuple):
    """The range that the coordinates of a body had in its training.

    Attributes:
        name: The body.
        nodes: Its coordinate nodes, which follow each other.
        scales: One over the largest magnitude of each coordinate in the training, by the root of
            their number [1/m], shape (mode_count / 3, 3).
    """

    name: str
    nodes: slice
    scales: np.ndarray

    def share(self, positions: np.ndarray) -> float:
        """Root mean square of the coordinates, each as a share of its range.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        shares = positions[self.nodes] * self.scales
        return math.sqrt(np.vdot(shares, shares))


class SampledRanges(StepPart):
    """Tells how much of their ranges reduced bodies use, and which body left its range."""

    name = "sampled_ranges"

    def __init__(self, model: Model):
        """Take what has a range.

        Args:
            model: The built scene.
        """
        self._superelements, self._coordinates = model.superelements, coordinate_ranges(model)

    def report(self, state: State, newton: Newton) -> PartReport:
        """See `StepPart`."""
        shares = {name: np.maximum.reduce(one.ranges, None) for name, one in self._superelements.items()}
        shares |= {one.name: one.share(state.positions) for one in self._coordinates}
        most, outside = max(shares.values()), ()
        if most > 1.0:
            outside = tuple(f"{name}.{SAMPLED}" for name, share in shares.items() if share > 1.0)
        return PartReport(outside, entries={"sampled_range": most})


def reduced_bodies(model: Model) -> tuple[ReducedBody, ...]:
    """The bodies in the coordinates of a basis, in the order of their nodes.

    Args:
        model: The model of a simulation.
    """
    return of_kind(model.bodies, ReducedBody)


def coordinate_ranges(model: Model) -> tuple[CoordinateRange, ...]:
    """Ranges of all bodies in the coordinates of a basis; empty without any.

    Args:
        model: The model of a simulation.
    """
    return tuple(map(_range_of, reduced_bodies(model)))


def _range_of(body: ReducedBody) -> CoordinateRange:
    count = body.mode_count
    ranges = body.reduction.ranges[:count]
    # A coordinate that the training never moved has no range to leave but that of rounding.
    least = np.finfo(np.float32).eps * max(float(ranges.max(initial=0.0)), np.finfo(float).tiny)
    scales = 1.0 / (np.sqrt(count) * np.maximum(ranges, least))
    own = slice(body.first_node, body.first_point)
    return CoordinateRange(body.name, own, scales.reshape(-1, 3))


class StrainRanges(StepPart):
    """Watches the strains where each step ends."""

    name = "strain_ranges"

    def __init__(self, model: Model):
        """Take the watches.

        Args:
            model: A scene with materials that have a range of strains.
        """
        self._watches = model.strain_watches
        self._outside: list[StrainOutside] = []

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        watched = (watch.outside(positions) for watch in self._watches)
        self._outside = [outside for outside in watched if outside is not None]
        return {}

    def report(self, state: State, newton: Newton) -> PartReport:
        """See `StepPart`."""
        limits = dict.fromkeys(f"{outside.body}.{STRAINED}" for outside in self._outside)
        return PartReport(tuple(limits), entries={"strains": tuple(self._outside)})


class HexahedraRange(StepPart):
    """Tells where hexahedra are too few for their compression, as long as they are."""

    name = "hexahedra_range"

    def __init__(self, model: Model):
        """Take the watches.

        Args:
            model: A scene with hexahedra.
        """
        self._watches = model.compression_watches
        self._coarse: tuple[str, ...] = ()

    def end(self, positions: np.ndarray, efforts: np.ndarray) -> dict[str, np.ndarray]:
        """See `StepPart`."""
        # Above a coarseness of 1 the force may be more than 25 % too high.
        bodies = (watch.body for watch in self._watches
                  if watch.elements.coarseness(positions, watch.lame) > 1.0)
        self._coarse = tuple(dict.fromkeys(f"{body}.{COARSE}" for body in bodies))
        return {}

    def report(self, state: State, newton: Newton) -> PartReport:
        """See `StepPart`."""
        return PartReport(self._coarse, is_trusted=not self._coarse)
