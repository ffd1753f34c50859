"""The result of a step: the new state, setpoints and efforts of the actuators, and a report.

Contacts are given with their forces, for reports, pictures and messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.strain_watch import StrainOutside
from softrobot_twin.mechanics.touch_loads import TouchState
from softrobot_twin.simulation.state import State, made

# Contacts that carry less than this share of all loads are omitted.
CARRIES = 1.0e-9
# Ending of the name of a limit that only delays a motion.
RATE = ".rate"
# Ending of the name that tells that a reduced body is out of the range in which its superelements
# were sampled, or its basis was trained, such as ``fetch.sampled_range``.
SAMPLED = "sampled_range"
# Ending of the name that tells that a body is strained beyond the range of its law, such as
# ``finger.strain_range``.
STRAINED = "strain_range"
# Ending of the name that tells that hexahedra are too few for their compression, such as
# ``pad.coarse_hexahedra``.
COARSE = "coarse_hexahedra"
# Ending of the name that tells that a cavity is near the pressure at which it bursts, such as
# ``air.near_burst``.
BURST = "near_burst"
# Ending of the name that tells that a grip is near slipping, such as ``finger.cube.grip_margin``.
GRIP = "grip_margin"
# Tells that the state is unstable where the commanded efforts are held, as hardware without a position
# loop would: a little more effort leads far away.
UNSTABLE = "unstable_at_efforts"


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


class Status(Enum):
    """How a step ended, the gravest last. The value is the word that diagnostics and CSV files show."""

    OK = "ok"
    """The command was carried out, and the residual is within `residual_tolerance`."""
    LINEARIZED = "linearized"
    """The command was carried out according to the linearizations that the scene or the deadline
    allows. The residual is above its tolerance, at most a quarter of all loads, and is reported.
    """
    RATE_LIMITED = "rate_limited"
    """Still moving: a rate limits an actuator, or the target is several steps away."""
    UNREACHABLE = "unreachable"
    """No limit is active except that a cable cannot push: this is the nearest point."""
    SATURATED = "saturated"
    """A limit that the report names prevents the command from being carried out: of length,
    tension, contact force, inversion, or the weight of the energy."""
    NOT_CONVERGED = "not_converged"
    """The residual is above what is allowed; the state can be used, its error is reported, as are
    the active limits."""
    INVERTED = "inverted"
    """Elements are flat or inverted: the shape is not reliable."""
    REFUSED = "refused"
    """Every command that was tried would have inverted elements, or led bodies through each other; the
    last state was kept."""
    UNSOLVED = "unsolved"
    """The optimisation has no solution; the last setpoints were held."""
    DIVERGED = "diverged"
    """The new state would not be finite; the last good state was kept."""

    @property
    def is_success(self) -> bool:
        """True when the command was carried out, at least according to a linearization."""
        return self in (Status.OK, Status.LINEARIZED)

    @property
    def is_failure(self) -> bool:
        """True when the command was not carried out and the last safe one was kept."""
        return self in (Status.REFUSED, Status.UNSOLVED, Status.DIVERGED)


@dataclass(frozen=True)
class StepReport:
    """Times, residuals and active limits of one step.

    Attributes:
        stage_times: Time of each stage [s], in the order they ran.
        compute_time: Time of the whole step [s].
        residual: Largest residual nodal force at the new state [N].
        iterations: Linearizations done.
        active_limits: Names of active limits, such as ``north.shortening_max``; independent of the
            status.
        contact_count: Contacts that carry force.
        projected_tangent: True when the exact tangent was not positive definite and its
            element-wise projection was used in its place, or a mean of both.
        inverted_count: Number of elements that are flat or inverted at the new state.
        linearization_error: Distance of the effectors from equilibrium before this step, at held
            lengths, by its first linearization [m]; NaN without effectors.
        factor_age: Linearizations since the factor was made; above zero in overload, when there
            was no time for a new one.
        is_late: True when a whole linearization was made without time for it, because there was no
            earlier factor, or none that made progress.
        qp_solver: Name of the solver of the inverse problem; empty in direct steps.
        contact_sweeps: Sweeps of the contact solver over all contacts, and its Newton steps.
        contact_residual: Largest residual of gaps and sticking [m].
        contact_force_residual: The same in newtons [N].
        sampled_range: Largest share of the range in which superelements were sampled, or a basis was
            trained, above 1 outside of it; 0 without reduced bodies.
        strains: Materials that are strained beyond the range of their law.
        driven_by: What drove the step: ``targets``, ``setpoints``, ``efforts`` or ``hold``.
        is_resting: True when the step was not made, because it would have changed nothing.
        is_exploring: True when the same step was made elsewhere in place, to look for a nearer pose.
        figures: What optional effects tell, by "part.figure"; see `step_part`.
    """

    stage_times: dict[str, float]
    compute_time: float
    residual: float
    iterations: int
    active_limits: tuple[str, ...] = ()
    contact_count: int = 0
    projected_tangent: bool = False
    inverted_count: int = 0
    linearization_error: float = float("nan")
    factor_age: int = 0
    is_late: bool = False
    qp_solver: str = ""
    contact_sweeps: int = 0
    contact_residual: float = 0.0
    contact_force_residual: float = 0.0
    sampled_range: float = 0.0
    strains: tuple[StrainOutside, ...] = ()
    driven_by: str = ""
    is_resting: bool = False
    is_exploring: bool = False
    figures: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_overloaded(self) -> bool:
        """True when the budget left no time for a linearization."""
        return self.factor_age > 0 or self.is_late


def _none() -> None:
    """Default of an entry that may be made when it is read: a class has no attribute for it."""


@dataclass(frozen=True)
class StepResult:
    """The outcome of one step. Most steps are read in part or not at all: it is made when first read.

    Attributes:
        state: The new state.
        status: How the step ended.
        setpoints: Command to each actuator, such as a cable's length [m], shape (actuator_count,).
        efforts: Effort of each actuator, such as a cable's tension [N], shape (actuator_count,).
        displacements: Displacement δ_a of each actuator from rest, such as a cable's shortening
            [m], shape (actuator_count,).
        effector_positions: Positions of the effectors [m], shape (effector_count, 3).
        effector_errors: Distance of each effector from its target over the controlled
            directions [m], shape (effector_count,); NaN without a target.
        report: Time, residual, iterations, active limits.
        contacts: Contacts, with their points and forces; None if the scene has no contact.
        effector_orientations: Turn of each effector from rest as a quaternion (x, y, z, w), NaN for
            effectors without orientation, shape (effector_count, 4); None if the scene has none.
        orientation_errors: Angle of each effector from its target over what its orientation asks
            for [rad], NaN without a target, shape (effector_count,); None if the scene has none.
        effector_stiffness: Apparent stiffness of each effector along x, y and z [N/m], NaN where
            none is wanted, shape (effector_count, 3); None if none is wanted of any.
        stiffness_errors: Share of its target that a stiffness of each effector is wrong by, the
            largest of its axes; NaN where none is wanted, shape (effector_count,); None if none is
            wanted of any.
    """

    state: State
    status: Status
    setpoints: np.ndarray
    efforts: np.ndarray
    displacements: np.ndarray
    effector_positions: np.ndarray
    effector_errors: np.ndarray
    report: StepReport
    contacts: ContactForces | None = field(default_factory=_none)
    effector_orientations: np.ndarray | None = field(default_factory=_none)
    orientation_errors: np.ndarray | None = field(default_factory=_none)
    effector_stiffness: np.ndarray | None = field(default_factory=_none)
    stiffness_errors: np.ndarray | None = field(default_factory=_none)

    @classmethod
    def when_read(cls, state: State, make: Callable[[], dict[str, object]]) -> StepResult:
        """A result of which all but the state is made when it is read first.

        Args:
            state: The new state.
            make: Makes all other fields, by their names.
        """
        return made(cls, state=state, _make=make)

    def make(self) -> None:
        """Make what was not made yet, before that which it is made from changes."""
        make = self.__dict__.get("_make")
        if make is not None:
            self.__dict__.update(make())
            self.__dict__.pop("_make", None)

    def __getattr__(self, name: str):
        if "_make" not in self.__dict__:
            raise AttributeError(name)
        self.make()
        return getattr(self, name)

    def __getstate__(self) -> dict:
        self.make()
        return self.__dict__

    @property
    def touches(self) -> TouchState | None:
        """Forces and displacements of the touches; None if the scene has none."""
        return TouchState.of(self.state.memory)
