"""What viewers show of a simulation: its draw list, and each plot once, with where frames take it from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.simulation.result import GRIP
from softrobot_twin.view.colours import pressure_legend
from softrobot_twin.view.draw_list import DrawList, Shown, pressure_range
from softrobot_twin.view.frame import Frame, Plot, Stage, ViewError

# Sections of a scene whose actuators have drawings of their own.
_DRAWN_SECTIONS = ("cables", "cavities")
_WHOLE_STEP = "whole step"

Curves = tuple[str, str, Sequence[str], Callable[[StepResult, tuple[float, ...]],
                                                Sequence[float] | np.ndarray]]  # fmt: skip
"""Title, path and names of the curves of a plot, and their values after a step with errors of the
effectors: to the target, of linearizing, of the mesh [m]."""


def _contacts(result: StepResult) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Points of contacts [m], forces [N] and margins of their pairs; see `Shown`."""
    contacts, none = result.contacts, np.empty((0, 3))
    if contacts is None:
        return none, none, None
    margins, figures = None, result.report.figures
    if any(name.startswith(GRIP) for name in figures):
        told = [figures.get(f"{GRIP}.{'.'.join(names)}", np.nan) for names in contacts.names]
        margins = np.array(told)[contacts.pairs]
    return contacts.positions, contacts.forces, margins


class SimulationFrames:
    """The stage of a simulation, and frames of its states.

    Args:
        simulation: The simulation to show.
        force_scale: Length of the arrow of a contact force [m/N].

    Attributes:
        stage: The constant part of the view.

    Raises:
        ViewError: The force scale is not positive.
    """

    def __init__(self, simulation: Simulation, force_scale: float = 0.1):
        if not (np.isfinite(force_scale) and force_scale > 0.0):
            raise ViewError("force_scale", force_scale, "must be above zero, in m/N")
        self._simulation = simulation
        self._drawing = DrawList(simulation, force_scale)
        self._curves = [curves for curves in self._all_curves() if curves[2]]
        title = simulation.scene.name
        if self._drawing.cavities.skins:
            title += f"; cavities: {pressure_legend(pressure_range(self._drawing.cavities))}"
        self.stage = Stage(
            simulation.scene.name, title,
            self._drawing.entities,
            tuple(Plot(*curves[:3]) for curves in self._curves),
        )  # fmt: skip

    def _all_curves(self) -> Iterator[Curves]:
        """All that may be drawn as curves but times; a robot may have none of a kind."""
        simulation = self._simulation
        actuators, cavities = simulation.actuators, self._drawing.cavities
        yield ("Effector error [mm]", "/plots/effector_error",
               ("to the target", "of linearizing, estimated", "of the mesh, estimated"),
               lambda _, errors: 1e3 * np.array(errors))  # fmt: skip
        cables = actuators.of_section("cables")
        names = simulation.actuator_names[cables]
        yield ("Cable lengths [mm]", "/plots/cable_lengths", names,
               lambda result, _: 1e3 * result.setpoints[cables])  # fmt: skip
        yield ("Cable tensions [N]", "/plots/cable_tensions", names, lambda result, _: result.efforts[cables])
        walls = [skin.name for skin in cavities.skins]
        yield ("Cavity gauge pressures [kPa]", "/plots/cavity_pressures",
               [f"{name} [kPa]" for name in walls],
               lambda result, _: 1e-3 * cavities.pressures(simulation.state))  # fmt: skip
        yield ("Cavity volumes [cm³]", "/plots/cavity_volumes",
               [f"{name} [cm³]" for name in walls],
               lambda result, _: 1e6 * cavities.volumes(simulation.state))  # fmt: skip
        others = [(place, name, kind)
                  for place, (name, kind) in enumerate(actuators.kind_of.items())
                  if kind.section not in _DRAWN_SECTIONS]  # fmt: skip
        places = [place for place, _, _ in others]
        factors = np.array([1e3 if kind.setpoint.unit == "m" else 1.0 for _, _, kind in others])
        yield ("Actuators", "/plots/actuators", [
            f"{name} [{unit}]" for _, name, kind in others
            for unit in ("mm" if kind.setpoint.unit == "m" else kind.setpoint.unit,
                         kind.effort.unit)
        ], lambda result, _: np.column_stack(
            [factors * result.setpoints[places], result.efforts[places]]
        ).ravel())  # fmt: skip
        is_touching = simulation.scene.contact is not None
        yield ("Contacts", "/plots/contacts", ("count", "largest force [N]") if is_touching else (),
               lambda result, _: [len(_contacts(result)[1]), np.linalg.norm(
                   _contacts(result)[1], axis=1).max(initial=0.0)])  # fmt: skip
        yield ("Residual [N]", "/plots/residual", ("residual",),
               lambda result, _: [result.report.residual])  # fmt: skip

    def frame(
        self, step: int, time_ns: int, result: StepResult, *, targets: np.ndarray,
        target_orientations: np.ndarray, errors: np.ndarray, predicted_markers: np.ndarray,
        measured_markers: np.ndarray, status: str, discretization_error: float = float("nan"),
    ) -> Frame:  # fmt: skip
        """The frame of a step, just after it.

        Args:
            step: Count of steps.
            time_ns: Its time [ns].
            result: Its result.
            targets: Targets of the effectors [m], NaN for none, shape (effector_count, 3).
            target_orientations: Wanted turns (x, y, z, w), NaN for none, shape (effector_count, 4).
            errors: Distances of effectors from targets [m], NaN without one.
            predicted_markers: Markers where the model has them [m], shape (marker_count, 3).
            measured_markers: Measured markers [m], NaN for none, same shape.
            status: Text to show.
            discretization_error: Estimate of the effectors' error due to the mesh [m].
        """
        report, known = result.report, errors[np.isfinite(errors)]
        shown = Shown(
            result.efforts, _contacts(result), result.effector_positions,
            result.effector_orientations, targets, target_orientations, predicted_markers,
            measured_markers,
        )  # fmt: skip
        largest = float(known.max()) if len(known) else float("nan")
        three = largest, report.linearization_error, discretization_error
        return Frame(
            step=step, time_ns=time_ns, drawn=self._drawing.drawn(shown),
            curves={path: values(result, three) for _, path, _, values in self._curves},
            times={_WHOLE_STEP: report.compute_time, **report.stage_times},
            status=status,
        )  # fmt: skip
