"""The balance of forces at a state: F(q), A, the rows H and δ, and what is out of balance.

    r = p - F(q) + Hᵀλ

Force terms and constraint terms are summed in loops: nothing here knows what kinds a scene has. Each
sum is a stage that is traced and run by one driver, see `kernels/traced_stage.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.kernels.traced_stage import TracedStages, clear
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.volume_barrier import BARRIER_VOLUME
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.step.actuation import Actuation
from softrobot_twin.solvers.dense_stiffness import without_rows

# Places of the traced stages, of terms and of rows apart from them; moves are with the rows.
MOVE, LOAD, GATHER, ASSEMBLE, ASSEMBLE_LATER, GATHER_KNOWN = range(6)
EVALUATE, ADD_STIFFNESS = GATHER, ASSEMBLE


class ForceBalance:
    """Sums the terms of a model. Its arrays are allocated once.

    Attributes:
        forces: Sum of the forces on free nodes that was taken last [N], shape (free_node_count, 3).
        multipliers: λ of all rows that acted in them, shape (row_count,).
        largest: Largest force out of balance on a node in the residual taken last [N], shape (1,).
        inverted_count: Elements that were flat or inside out when the forces were taken last.
        is_folded: True when there were some, or elements beyond the barrier that keeps them so;
            None until forces are taken.
        is_nearly_flat: True when the barrier against flat elements acted in them.
        constant_load: Sum of the forces on the nodes at rest, the body's weight [N].
        makes_whole: Whether a whole move is a traced stage.
        time_step: Duration of the step [s].
    """

    def __init__(self, model: Model, make_whole: Callable[[np.ndarray], bool]):
        """Allocate.

        Args:
            model: The built scene.
            make_whole: Makes a whole move, see `make_whole`; traced with the sums that it depends on.
        """
        self._model, self._rows = model, model.rows
        self.forces = np.zeros((model.nodes.free_node_count, 3))
        self.multipliers, self.largest = np.zeros(self._rows.row_count), np.zeros(1)
        self._actuation: Actuation | None = None
        self.time_step, factorization = 0.0, model.factorization
        are_traceable = all(getattr(one, "is_traceable", False) for one in (*model.forces, factorization))
        are_rows = self._rows.is_traceable
        reaches_points = are_rows and self._rows.reaches_carried_points
        self._row_points = model.nodes.carried if reaches_points else None
        # Rows that vary have other arrays where there are more or fewer.
        self._has_rows_apart = self._rows.varies or not are_rows
        # What moves the nodes depends on nothing but arrays, where nothing but A holds them.
        self._memory_count = getattr(factorization, "memory_count", None)
        self.makes_whole = (
            are_traceable and are_rows and not model.slides and hasattr(factorization, "memory_count")
            and all(getattr(kind, "is_traceable", False) for kind in model.nodes.kinds)
        )  # fmt: skip
        self._knowing: list = [
            term for term in model.forces if type(term).knows is not ForceTerm.knows
        ]
        if self._rows.may_know:
            self._knowing.append(self._rows)
        # Terms that remember where a step began do something else there than later in it.
        self._starts_apart = any(term.remembers_start for term in model.forces)
        self._is_at_start = True
        moves = make_whole, self._load_rows
        self._stages = TracedStages(
            are_traceable, *moves, self._gather, self._assemble, self._assemble, self._gather
        )
        self._row_stages = TracedStages(
            are_rows, *moves, self._rows.evaluate, self._rows.add_stiffness
        )
        self._move_stages = self._row_stages if self._has_rows_apart else self._stages
        self._traced = [self._stages, self._row_stages]
        assembled = without_rows(factorization)
        if hasattr(assembled, "stages"):
            self._traced.append(assembled.stages)
        self.forget()
        self.gather_forces(model.nodes.rest_positions)
        self.constant_load = float(np.linalg.norm(self.forces, axis=1).sum())

    def forget(self) -> None:
        """Forget what earlier states taught."""
        for stages in self._traced:
            stages.begin_anew()
        self.inverted_count, self.is_folded = 0, None
        self._rows.forget()

    def forget_folds(self) -> None:
        """Take the state where the next linearization begins for one without folds."""
        self.inverted_count, self.is_folded = 0, False

    def expect(self, time_step: float) -> None:
        """Let a step begin; its stages run in Python where terms learn that its duration is another one.

        Args:
            time_step: Its duration [s].
        """
        self._is_at_start = True
        if time_step != self.time_step and self._model.beginners:
            self.forget_stages()
        self.time_step = time_step

    def forget_stages(self) -> None:
        """Let the stages run in Python once: something else than their arrays has changed."""
        self._stages.forget()
        self._row_stages.forget()

    def set_multipliers(self, actuation: Actuation) -> None:
        """Take λ of every row; an effector bears no load.

        Args:
            actuation: λ.
        """
        groups, is_fit = self._rows.groups, len(self.multipliers) == self._rows.row_count
        if is_fit and actuation is self._actuation:
            return
        if not is_fit:
            self.multipliers = np.zeros(self._rows.row_count)
        self._actuation = actuation
        self.multipliers[groups.actuators] = actuation.efforts[groups.actuators]
        self.multipliers[groups.contacts] = actuation.contact.multipliers

    def make_whole(self, positions: np.ndarray) -> bool:
        """Make a whole move by the multipliers; see `Newton`.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.

        Returns:
            Whether it is made.
        """
        if self._memory_count != self._model.factorization.memory_count:
            self._memory_count = self._model.factorization.memory_count
            self._move_stages.forget()
        return self._move_stages.run(MOVE, positions)

    def warm_up(self, positions: np.ndarray) -> None:
        """Run what a body needs only where it folds, or is nearly flat: no move of a warm-up does that.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        # It ends beside the state, of which elements know their deformation already.
        self.folds(positions, positions + np.spacing(1.0))
        flat = positions * [1.0, 1.0, 0.5 * BARRIER_VOLUME]
        self._assemble(flat, np.zeros(self._model.rows.row_count))

    def folds(self, start: np.ndarray, positions: np.ndarray) -> bool:
        """Whether elements fold on the way between two states, or are folded at its end.

        Args:
            start: Node positions where it begins [m], shape (node_count, 3).
            positions: Those where it ends [m], same shape.
        """
        if self.upright_share(start, positions) < 1.0:
            return True
        # Contacts are not detected yet: rows are not evaluated here.
        self.sum_forces(positions)
        return self.is_folded

    def upright_share(self, start: np.ndarray, positions: np.ndarray) -> float:
        """How much of the way between two states keeps the elements upright.

        Args:
            start: Node positions where it begins [m], shape (node_count, 3).
            positions: Those where it ends [m], same shape.
        """
        return min(term.largest_share(start, positions) for term in self._model.forces)

    def residual(self, positions: np.ndarray, actuation: Actuation) -> float:
        """Largest force out of balance on a node, p - F(q) + Hᵀλ [N]; counts inverted elements.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            actuation: λ.
        """
        self._rows.tell_efforts(actuation.efforts)
        self.gather_forces(positions)
        self.set_multipliers(actuation)
        if self.makes_whole:
            self._move_stages.run(LOAD)
        else:
            self._load_rows()
        return float(self.largest[0])

    def _load_rows(self) -> None:
        """Add Hᵀλ to the forces gathered last, and find the largest on a node."""
        self._rows.add_forces(self.multipliers, self.forces)
        self._model.nodes.write_largest(self.forces, True, self.largest)

    def load(self, actuation: Actuation) -> None:
        """Add Hᵀλ to the forces gathered last.

        Args:
            actuation: λ.
        """
        self.set_multipliers(actuation)
        self._rows.add_forces(self.multipliers, self.forces)

    def gather_forces(self, positions: np.ndarray, are_known: bool = False) -> np.ndarray:
        """Sum b = p - F(q) and the rows H, δ of all terms; A stays as it is.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            are_known: Whether terms know these positions mostly, where a step begins: they do less then.

        Returns:
            The forces.
        """
        self._note_folds(self._stages.run(GATHER_KNOWN if are_known else GATHER, positions))
        if self._has_rows_apart:
            self._row_stages.run(EVALUATE, positions)
        return self.forces

    def _gather(self, positions: np.ndarray) -> tuple[int, int, int]:
        """Sum b of all terms, and evaluate the rows that may be traced."""
        if self._row_points is not None:
            # Else rows apart would be the first to ask for these points here, but not in `assemble`.
            self._row_points.update(positions)
        counts = self._add_forces(positions)
        if not self._has_rows_apart:
            self._rows.evaluate(positions)
        return counts

    def sum_forces(self, positions: np.ndarray) -> None:
        """Sum b = p - F(q) of all terms, and leave the rows.

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        self._stages.forget()
        self._note_folds(self._add_forces(positions))

    def _add_forces(self, positions: np.ndarray) -> tuple[int, int, int]:
        """Sum b of all terms; counts elements that are inverted, nearly flat, and crossed."""
        clear(self.forces.reshape(-1))
        inverted_count = nearly_flat_count = crossed_count = 0
        for term in self._model.forces:
            inverted_count += term.add_forces(positions, self.forces)
            nearly_flat_count += term.nearly_flat_count
            crossed_count += term.crossed_count
        return inverted_count, nearly_flat_count, crossed_count

    def _note_folds(self, counts: tuple[int, int, int]) -> None:
        """Note what the forces that were taken last tell."""
        inverted_count, nearly_flat_count, crossed_count = counts
        self.inverted_count, self.is_nearly_flat = inverted_count, nearly_flat_count > 0
        self.is_folded = inverted_count > 0 or crossed_count > 0

    def assemble(self, positions: np.ndarray, multipliers: np.ndarray, projected: bool) -> None:
        """Sum b = p - F(q), A and the rows H, δ of all terms.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            multipliers: λ of all rows, shape (row_count,).
            projected: Whether A is made positive definite, element by element.
        """
        model = self._model
        self._rows.tell_efforts(multipliers)
        if not all([term.knows(positions) for term in self._knowing]):
            # Terms that find it out themselves would do something else than in most steps.
            self._stages.run(GATHER, positions)
        if projected:
            self._stages.forget()
            self._assemble(positions, multipliers, True)
        else:
            is_later = self._starts_apart and not self._is_at_start
            self._stages.run(ASSEMBLE_LATER if is_later else ASSEMBLE, positions, multipliers)
        self._is_at_start = False
        if self._has_rows_apart:
            storage = model.factorization.storage
            self._row_stages.run(ADD_STIFFNESS, positions, multipliers, storage, projected)
            self._row_stages.run(EVALUATE, positions)

    def _assemble(self, positions: np.ndarray, multipliers: np.ndarray, projected: bool = False) -> None:
        """Sum the force terms, and the rows that may be traced; see `assemble`."""
        factorization = self._model.factorization
        clear(self.forces.reshape(-1))
        factorization.clear()
        for term in self._model.forces:
            term.add(positions, self.forces, factorization.storage, projected)
        if not self._has_rows_apart:
            self._rows.add_stiffness(positions, multipliers, factorization.storage, projected)
            if not self._rows.may_know:
                self._rows.evaluate(positions)
