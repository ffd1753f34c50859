"""The result of a step: the new state, setpoints and efforts of the actuators, and a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from softrobot_twin.mechanics.strain_watch import StrainOutside
from softrobot_twin.mechanics.touch_loads import TouchState
from softrobot_twin.simulation.state import State

if TYPE_CHECKING:
    from softrobot_twin.simulation.contact_forces import ContactForces

# Ending of the name of a limit that only delays a motion.
RATE = ".rate"
# Ending of the name that tells that a reduced body is out of the range in which its superelements
# were sampled, or its basis was trained, such as ``fetch.sampled_range``.
SAMPLED = "sampled_range"
# Ending of the name that tells that a body is strained beyond the range of its law, such as
# ``finger.strain_range``.
STRAINED = "strain_range"
# Tells that the state is unstable where the commanded efforts are held, as hardware without a position
# loop would: a little more effort leads far away.
UNSTABLE = "unstable_at_efforts"


class Status(Enum):
    """How a step ended. The value is the word that diagnostics and CSV files show."""

    OK = "ok"
    """The command was carried out, and the residual is within `residual_tolerance`."""
    LINEARIZED = "linearized"
    """The command was carried out according to the linearizations that the scene or the deadline
    allows. The residual is above its tolerance, at most a quarter of all loads, and is reported.
    """
    RATE_LIMITED = "rate_limited"
    """Still moving: a rate limits an actuator, or the target is several steps away."""
    SATURATED = "saturated"
    """A limit that the report names prevents the command from being carried out: of length,
    tension, contact force, inversion, or the weight of the energy."""
    UNREACHABLE = "unreachable"
    """No limit is active except that a cable cannot push: this is the nearest point."""
    NOT_CONVERGED = "not_converged"
    """The residual is above what is allowed; the state can be used, its error is reported, as are
    the active limits."""
    INVERTED = "inverted"
    """Elements are flat or inverted: the shape is not reliable."""
    REFUSED = "refused"
    """Every command that was tried would have inverted elements; the last state was kept."""
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
    def when_read(cls, state: State, make: Callable[[], StepResult]) -> StepResult:
        """A result of which all but the state is made when it is read first.

        Args:
            state: The new state.
            make: Makes the result.
        """
        result = object.__new__(cls)
        result.__dict__.update(state=state, _make=make)
        return result

    def make(self) -> None:
        """Make what was not made yet, before that which it is made from changes."""
        make = self.__dict__.get("_make")
        if make is not None:
            self.__dict__.update(make().__dict__)
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
