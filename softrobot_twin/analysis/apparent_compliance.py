"""Compliance of the effectors after actuation, and the Jacobian of their motion by the actuators.

A force f pushes an effector, while the actuators hold what they hold. With W = H A⁻¹ Hᵀ over the
three coordinates e of the effector and the rows h that hold their displacement,

    ∂x/∂f   = W_ee - W_eh (W_hh + C)⁻¹ W_he
    J_a     = W_eh (W_hh + C)⁻¹ (a)                  (column of the actuator; Coevoet 2017, eq. 16)

where C is the compliance of the actuators themselves, such as that of cables that stretch. The
rows h are those of:

- Actuators whose displacement is set, as long as their effort is between its bounds. A slack cable
  holds nothing, nor does a motor that stalls or a cable at its greatest tension. What is driven by
  an effort, such as a cavity under pressure, keeps its effort, and holds only where its
  displacement is at a limit: an empty cavity bears on its walls.
- The gaps of pressing contacts; with friction, their tangents too where they stick. Where they
  slide, the friction stays as it is.

A is the stiffness of statics, also in scenes that move: without inertia and damping, it is what a
slow touch feels. Where it is singular or indefinite, a robot may be stable because its actuators
hold it. Then the equations of unknowns and multipliers are solved together,

    A dq - Hᵀ dλ = f,     D dq + C dλ = dδ,

with the rows D of displacements. D is H, except in scenes with friction along cables.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrobot_twin.constraints.effector import Effectors
from softrobot_twin.constraints.hinge_angle import HingeAngles
from softrobot_twin.mechanics.held_axes import HELD
from softrobot_twin.simulation.building.limits import DISPLACEMENT_MARGIN, HOLDING_MARGIN
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.simulation.step.apparent_stiffness import SHARING, effector_rows, sharing
from softrobot_twin.solvers.dense_stiffness import laid_out_alike
from softrobot_twin.solvers.factorization import Factorization, NodeRows, laid_out_like
from softrobot_twin.solvers.superlu import SuperLU

# Stiffness of what nothing holds, as a share of the mean stiffness.
FREE_SHARE = 1.0e-10


class ApparentCompliance(NamedTuple):
    """What effectors yield to forces, and to their actuators, around one state.

    Attributes:
        compliance: ∂x/∂f of each effector at its own force [m/N], shape (effector_count, 3, 3);
            NaN where the equations have no solution.
        jacobian: ∂x/∂δ_a of each effector by the displacement of each actuator, in the direction in
            which its effort does work, such as the shortening of a cable [m/m] and the growth of a
            cavity [m/m³]; by the effort of what is driven by its effort, such as a pressure [m/Pa];
            shape (effector_count, 3, actuator_count). Zero for a slack cable.
        is_held: Whether each actuator holds its displacement, shape (actuator_count,).
        is_by_effort: Whether each is driven by its effort, and its column of the Jacobian too, same
            shape.
        contact_count: Contacts that hold their gaps.
    """

    compliance: np.ndarray
    jacobian: np.ndarray
    is_held: np.ndarray
    is_by_effort: np.ndarray
    contact_count: int

    def principal_stiffness(self, effector: int) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness along the directions in which an effector yields straight to a force.

        Args:
            effector: Index of the effector.

        Returns:
            Stiffnesses [N/m], the least first, infinite where the effector does not yield, shape
            (3,), and their directions as rows, shape (3, 3). With friction along cables the
            compliance is not quite symmetric, and these are of its symmetric part.
        """
        return principal_stiffness(self.compliance[effector])


def principal_stiffness(compliance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Principal stiffnesses of a compliance, the least first; see `ApparentCompliance`.

    A negative one is that of an unstable direction; it is listed first.

    Args:
        compliance: [m/N], shape (3, 3).

    Returns:
        Stiffnesses [N/m], shape (3,), and unit directions as rows, shape (3, 3).
    """
    if not np.isfinite(compliance).all():
        return np.full(3, np.nan), np.full((3, 3), np.nan)
    yields, directions = np.linalg.eigh(0.5 * (compliance + compliance.T))
    greatest = np.abs(yields).max(initial=0.0)
    stiffness = np.full(3, np.inf)
    moving = np.abs(yields) > SHARING * greatest
    stiffness[moving] = 1.0 / yields[moving]
    order = np.argsort(stiffness, kind="stable")
    directions = directions.T[order]
    # Each direction points to the side on which its largest component is positive.
    largest = directions[np.arange(3), np.abs(directions).argmax(axis=1)]
    return stiffness[order], directions * np.sign(largest)[:, None]


class HeldTangent:
    """The tangent of statics at the present state of a simulation, and what holds there.

    Nothing of a step depends on it: it changes neither the state nor what the next step finds. Its
    memory is allocated when it is made, so a simulation that nobody asks has none.
    """

    def __init__(self, simulation: Simulation):
        """Lay out three rows for each effector, whatever directions the scene controls.

        Args:
            simulation: The simulation.
        """
        self._simulation, self._model = simulation, simulation.model
        model, effectors = self._model, simulation.model.effectors
        self._count = len(effectors.effectors)
        self.own_rows = effector_rows(effectors, model.nodes)
        # A free body, or a beam that only a motor holds, has a singular stiffness, of which a
        # factorization may take no notice.
        self._may_be_definite = not (
            any(part.is_free for part in model.rigid) or any(isinstance(term, HingeAngles) for term in model.rows.terms)
            or not model.actuators.conserves
        )  # fmt: skip

    @cached_property
    def _storage(self) -> np.ndarray:
        """Takes A of statics, in the layout of the model's factorization."""
        return np.zeros_like(self._model.factorization.storage)

    @cached_property
    def _alike(self) -> tuple[Factorization, np.ndarray | slice]:
        """A factorization of its own, and the place of each of its entries in that storage."""
        return laid_out_alike(self._model.factorization)

    @cached_property
    def _lu(self) -> tuple[Factorization, np.ndarray]:
        """The same, which factorizes what is not definite."""
        return laid_out_like(self._model.factorization, SuperLU)

    def _holding(self, by_effort: np.ndarray | bool = False) -> _Holding:
        """Which rows hold at the state; evaluates all rows there."""
        self._simulation.finish_result()
        model, state = self._model, self._simulation.state
        rows, actuators, limits = model.rows, model.actuators, model.actuators.limits
        for part in self._simulation.parts:
            part.recall(state)
        if rows.varies:
            rows.detect(state.positions)
            rows.choose_stiffness(True)
            rows.limit_stiffness(False)
        rows.tell_efforts(state.efforts)
        rows.evaluate(state.positions)
        a = rows.groups.actuators
        efforts = state.efforts[a]
        path = rows.actuator_paths(efforts)
        is_driven = actuators.is_effort_driven[a].copy()
        margin = DISPLACEMENT_MARGIN * limits.displacement_scale[a]
        at_limit = (path <= limits.displacement_min[a] + margin) | (
            path >= limits.displacement_max[a] - margin
        )
        held = np.where(is_driven, at_limit, limits.can_hold(efforts))
        drives = actuators.drives(state.setpoints)[a]
        # A cable without tension that is not slack either moves the effector when it is shortened.
        touching = ~held & ~is_driven & (np.abs(path - drives) <= margin)
        touching &= efforts < limits.effort_max[a] - HOLDING_MARGIN * limits.effort_scale[a]
        commanded = np.broadcast_to(by_effort, actuators.count)[a]
        held, touching = held & ~commanded, touching & ~commanded
        is_driven |= commanded
        contacts, pressing = self._contact_rows()
        own = rows.own_compliance()
        own = np.zeros((a.stop, a.stop)) if own is None else own
        return _Holding(held, touching, is_driven, contacts, pressing, own, rows.stretch_ratios())

    def _contact_rows(self) -> tuple[np.ndarray, int]:
        """Contact rows that hold, and how many contacts press."""
        model = self._model
        if not model.rows.varies:
            return np.empty(0, np.int64), 0
        contacts, forces = model.contacts, model.contacts.last_multipliers
        starts, row_counts = contacts.row_starts[:-1], np.diff(contacts.row_starts)
        pressing, slipping = contacts.touch(forces)
        holds = np.repeat(pressing & ~slipping, row_counts)
        holds[starts] = pressing
        first = model.rows.groups.contacts.start
        return first + np.flatnonzero(holds), int(np.count_nonzero(pressing))

    def _rows(self, positions: np.ndarray, holding: _Holding) -> _Rows:
        """Rows of the actuators, of the contacts that hold, then of the effectors."""
        rows = self._model.rows
        chosen = np.concatenate([np.arange(rows.groups.actuators.stop), holding.contacts])
        place = np.full(rows.row_count, -1)
        place[chosen] = np.arange(len(chosen))
        row_index = place[rows.row_index]
        kept = row_index >= 0
        effectors, count = self.own_rows, len(chosen)
        effectors.evaluate(positions)
        H = NodeRows(
            np.concatenate([row_index[kept], count + effectors.row_index]),
            np.concatenate([rows.node_index[kept], effectors.node_index]),
            np.concatenate([rows.blocks[kept], effectors.blocks]), count + effectors.row_count,
        )  # fmt: skip
        slides, G = self._model.slides, np.empty((H.row_count, 0))
        if slides:
            G = np.zeros((H.row_count, slides.count))
            for points, own in effectors.constant_terms:
                # Nothing asks how slides move what sensors show.
                if isinstance(points, Effectors):
                    G[count:][own] = slides.effector_columns(points)
            if rows.varies:
                by_slide = slides.contact_columns(self._model.contacts)
                G[rows.groups.actuators.stop : count] = by_slide[
                    holding.contacts - rows.groups.contacts.start
                ]
        return _Rows(H, G)

    def _definite(self, positions: np.ndarray) -> Factorization | None:
        """Assembles A of statics at a state, and factorizes it; None where it is not definite."""
        self._assemble(positions)
        if not self._may_be_definite:
            return None
        factorization, places = self._alike
        factorization.storage[:] = self._storage[places]
        with suppress(np.linalg.LinAlgError):
            if factorization.factor():
                return factorization
        return None

    def _saddle(self, rows: _Rows, holding: _Holding) -> Saddle:
        """The equations of unknowns and multipliers together, by the A that was assembled last."""
        model = self._model
        lu, places = self._lu
        lu.storage[:] = self._storage[places]
        terms = (*model.forces, *model.rows.terms)
        dense = [term.dense_rows for term in terms if term.dense_rows is not None]
        A, state = lu.matrix(), self._simulation.state
        multipliers = model.rows.multipliers(state.efforts)
        for term, own in model.rows.constant_terms:
            lacking = term.lacking_stiffness(state.positions, multipliers[own], A.shape[0])
            A = A if lacking is None else A + lacking
        return Saddle(A, dense, rows.H, self._displacement_rows(rows), holding)

    def _assemble(self, positions: np.ndarray) -> None:
        """Sum the exact stiffness of statics, in the layout of the model's factorization."""
        model, state = self._model, self._simulation.state
        still = np.zeros((model.nodes.free_node_count, 3))
        for term in model.forces:
            # A step that takes infinitely long has neither inertia nor damping. The next step
            # begins all these terms again.
            if term.remembers_start:
                term.begin_step(positions, still, np.inf)
        self._storage[:] = 0.0
        for term in model.forces:
            term.add(positions, still, self._storage, False)
        multipliers = model.rows.multipliers(state.efforts)
        model.rows.add_stiffness(positions, multipliers, self._storage, False)

    def _displacement_rows(self, rows: _Rows) -> NodeRows:
        """D: the rows H, with those of displacements where friction makes them others."""
        H, other = rows.H, self._model.rows.displacement_rows()
        if other is None:
            return H
        kept = ~np.isin(H.row_index, other.actuators)
        return NodeRows(
            np.concatenate([H.row_index[kept], other.actuators[other.row_index]]),
            np.concatenate([H.node_index[kept], other.node_index]),
            np.concatenate([H.blocks[kept], other.blocks]), H.row_count,
        )  # fmt: skip


class EffectorCompliance(HeldTangent):
    """Computes the apparent compliance of the effectors of a simulation at its present state."""

    def at_state(self, by_effort: np.ndarray | bool = False) -> ApparentCompliance:
        """The compliance at the state where the simulation stands, exactly.

        Assembles the stiffness of statics there, and factorizes it.

        Args:
            by_effort: Actuators that were commanded by efforts although they are driven by
                displacements, which therefore hold nothing, shape (actuator_count,); False for
                none but those that the scene names.
        """
        return self._found(by_effort, None)

    def after_step(self, by_effort: np.ndarray | bool = False) -> ApparentCompliance:
        """The same by the factorization of the last step, where it has that of statics.

        It belongs to the state before the last correction, so while the robot moves the result is
        that of one correction ago. Else this is `at_state`: in motion, after steps whose tangent
        was indefinite, and with friction along cables.

        Args:
            by_effort: See `at_state`.
        """
        return self._found(by_effort, self._simulation.newton.tangent.static_factorization)

    def _found(self, by_effort: np.ndarray | bool, factorization: Factorization | None) -> ApparentCompliance:
        model, state = self._model, self._simulation.state
        actuator_count = model.actuators.count
        if not self._count:
            no = np.zeros(actuator_count, bool)
            return ApparentCompliance(np.empty((0, 3, 3)), np.empty((0, 3, actuator_count)), no, no, 0)
        holding = self._holding(by_effort)
        rows = self._rows(state.positions, holding)
        try:
            factorization = factorization or self._definite(state.positions)
            if factorization:
                moves = _condensed(factorization, model.nodes.free_node_count, rows, holding)
            else:
                moves = _solved_together(self._saddle(rows, holding), rows, holding)
        except np.linalg.LinAlgError:  # Only where a stiffness is not finite.
            moves = (np.full((3 * self._count, 3 * self._count), np.nan),
                     np.full((3 * self._count, actuator_count), np.nan))  # fmt: skip
        return self._put_together(holding, *moves)

    def _put_together(
        self, holding: _Holding, by_force: np.ndarray, by_actuator: np.ndarray
    ) -> ApparentCompliance:
        """The result, from the motion of the effectors by each unit load.

        Args:
            holding: What holds.
            by_force: Motion by forces on the effectors, shape (3 effector_count, same).
            by_actuator: Motion by the actuators, shape (3 effector_count, actuator_count).
        """
        n, own = self._count, np.arange(self._count)
        compliance = by_force.reshape(n, 3, n, 3)[own, :, own, :]
        # Slides, which have no rows, hold their displacements.
        count = self._model.actuators.count
        slides = count - len(holding.held)
        return ApparentCompliance(
            compliance, by_actuator.reshape(n, 3, count),
            np.append(holding.held, np.ones(slides, bool)),
            np.append(holding.is_by_effort, np.zeros(slides, bool)), holding.contact_count,
        )  # fmt: skip


def apparent_compliance(simulation: Simulation, by_effort: np.ndarray | bool = False) -> ApparentCompliance:
    """The compliance of the effectors and their Jacobian at the state of a simulation.

    Whoever asks at many states keeps one `EffectorCompliance`.

    Args:
        simulation: The simulation; where things touch, after a step to this state.
        by_effort: See `EffectorCompliance.at_state`.
    """
    return EffectorCompliance(simulation).at_state(by_effort)


class _Holding(NamedTuple):
    """What the actuators with rows, and the contacts, hold.

    Attributes:
        held: Actuators that hold their displacement, shape (actuator_row_count,).
        touching: Cables without tension that are not slack either, same shape.
        is_by_effort: Actuators that are driven by their effort, and keep it where they are not
            held; same shape.
        contacts: Contact rows that hold, among all rows, shape (contact_row_count,).
        contact_count: Contacts that press.
        own: Compliance C of the actuators, shape (actuator_row_count, same).
        ratios: By how much more the path of each moves than its winch, shape (actuator_row_count,).
    """

    held: np.ndarray
    touching: np.ndarray
    is_by_effort: np.ndarray
    contacts: np.ndarray
    contact_count: int
    own: np.ndarray
    ratios: np.ndarray

    @property
    def places(self) -> np.ndarray:
        """Places of the rows that hold among those of `_Rows`, shape (held_count,)."""
        count = len(self.held)
        return np.concatenate([np.flatnonzero(self.held), count + np.arange(len(self.contacts))])

    @property
    def own_of_places(self) -> np.ndarray:
        """C of the rows that hold, shape (held_count, same)."""
        places, count = self.places, len(self.held)
        own = np.zeros((count + len(self.contacts),) * 2)
        own[:count, :count] = self.own
        return own[np.ix_(places, places)]


class _Rows(NamedTuple):
    """Rows of the actuators, of the contacts that hold, then of the effectors.

    Attributes:
        H: They.
        G: Their motion by the slides, shape (row_count, slide_count).
    """

    H: NodeRows
    G: np.ndarray


def _columns_of_actuators(
    holding: _Holding, by_set: np.ndarray, by_effort: np.ndarray, own_by_effort: np.ndarray,
    by_slide: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """The Jacobian, shape (3 effector_count, actuator_count).

    Args:
        holding: What holds.
        by_set: Motion by the displacement of each held actuator, shape (3 effector_count, held).
        by_effort: Motion by the effort of each actuator with a row, shape (.., row_count).
        own_by_effort: Displacement of each of these by its own effort, shape (row_count,).
        by_slide: Motion by each slide, shape (3 effector_count, slide_count).
    """
    columns = np.zeros_like(by_effort)
    follows = holding.held & ~holding.is_by_effort
    columns[:, follows] = by_set[:, follows[holding.held]] * holding.ratios[follows]
    keeps_effort = holding.is_by_effort & ~holding.held
    columns[:, keeps_effort] = by_effort[:, keeps_effort]
    yields = holding.touching & (own_by_effort > 0.0)
    columns[:, yields] = by_effort[:, yields] / own_by_effort[yields]
    # A positive move of a slide is a negative displacement.
    return np.concatenate([columns, -by_slide], axis=1)


def _condensed(
    factorization: Factorization, node_count: int, rows: _Rows, holding: _Holding
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the effectors by forces on them, and by the actuators, by W of a factorization."""
    W = factorization.condense(rows.H, np.zeros((node_count, 3))).W
    h, count = holding.places, len(holding.held)
    e, a = slice(count + len(holding.contacts), None), slice(0, count)
    W[a, a] += holding.own
    M = W[np.ix_(h, h)]
    M[np.diag_indices_from(M)] += sharing(M.diagonal())
    by_set = np.linalg.solve(M, W[h]).T if len(h) else np.empty((len(W), 0))
    W = W - by_set @ W[h]
    own = W[a, a].diagonal()
    # What holds does not follow a slide; what is carried by it does.
    by_slide = rows.G[e] - by_set[e] @ rows.G[h]
    return W[e, e], _columns_of_actuators(
        holding, by_set[e, : np.count_nonzero(holding.held)], W[e, a], own, by_slide
    )


class CondensedHold:
    """Unknowns and multipliers by a factorization of A and the condensed system of what holds."""

    def __init__(self, factorization: Factorization, held: np.ndarray, own: np.ndarray):
        """Condense.

        Args:
            factorization: A⁻¹.
            held: Rows of what holds, shape (held_count, 3 node_count).
            own: Their compliance, shape (held_count, held_count).
        """
        self._factorization, self._held = factorization, held
        self._by_efforts = self._moves(self._held.T)
        self._M = self._held @ self._by_efforts + own
        self._M[np.diag_indices_from(self._M)] += sharing(self._M.diagonal())

    def _moves(self, forces: np.ndarray) -> np.ndarray:
        """A⁻¹ of forces, shape (3 node_count, load_count)."""
        solved = [self._factorization.solve(np.ascontiguousarray(one).reshape(-1, 3)).reshape(-1)
                  for one in forces.T]  # fmt: skip
        return np.array(solved).T.reshape(forces.shape)

    def solve(
        self, above: np.ndarray, below: np.ndarray, transposed: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `Saddle.solve`."""
        moves, sign = self._moves(above), -1.0 if transposed else 1.0
        M = self._M.T if transposed else self._M
        multipliers = np.linalg.solve(M, below - sign * (self._held @ moves))
        return moves + sign * (self._by_efforts @ multipliers), multipliers


class Saddle:
    """Unknowns and multipliers of what holds, solved together, whether A is definite or not.

    Attributes:
        H: Rows of forces, of the actuators, the contacts that hold and the effectors, shape
            (row_count, 3 node_count).
        D: Those of displacements.
    """

    def __init__(self, A: sp.csc_array, dense: list, H: NodeRows, D: NodeRows, holding: _Holding):
        """Take the stiffness.

        Args:
            A: Its sparse part, shape (3 node_count, same).
            dense: Parts Σ k h hᵀ of it that are not assembled.
            H: Rows of forces.
            D: Rows of displacements.
            holding: What holds.
        """
        self._size, self._system, self._lu = A.shape[0], None, None
        self.H, self.D = self._sparse(H), self._sparse(D)
        h = holding.places
        H, D = self.H[h], self.D[h]
        stiff, stiffness = sp.csr_array((0, self._size)), np.empty(0)
        if dense:
            stiff = sp.vstack([
                self._sparse(NodeRows(*part[:3], len(part.stiffness))) for part in dense
            ]).tocsr()  # fmt: skip
            stiffness = np.concatenate([part.stiffness for part in dense])
        # Redundant rows share the load.
        diagonal = np.abs(A.diagonal())
        free = (diagonal > 0.0) & (diagonal < HELD)
        scale = diagonal[free].mean() if free.any() else 1.0
        by_node = np.where(diagonal > 0.0, diagonal, scale)
        softness = (D.multiply(D) @ (1.0 / by_node)) if D.shape[0] else np.empty(0)
        C = sp.csr_array(holding.own_of_places + np.diag(sharing(softness)))
        none = sp.csr_array((len(stiffness), len(softness)))
        self._between = len(stiffness)
        free = sp.dia_array((np.ones((1, self._size)), [0]), shape=(self._size, self._size))
        for share in (0.0, FREE_SHARE * scale):
            system = sp.bmat([
                [A + share * free, stiff.T, -H.T],
                [stiff, sp.csr_array(np.diag(-1.0 / stiffness)), none],
                [D, none.T, C],
            ]).tocsc()  # fmt: skip
            if not np.isfinite(system.data).all():
                break
            with suppress(RuntimeError):  # Something is free to move, such as a body in the air.
                self._lu = splu(sp.csc_matrix(system))
                self._system = system
                break

    def solve(
        self, above: np.ndarray, below: np.ndarray, transposed: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and multipliers by loads; NaN where there are none.

        Args:
            above: Forces on the unknowns [N], shape (3 node_count, load_count).
            below: Displacements of what holds, less those by the efforts, shape
                (held_count, load_count).
            transposed: Whether the equations are those of the adjoint.

        Returns:
            Both, in the shapes of the loads.
        """
        size = self._size
        right = np.concatenate([above, np.zeros((self._between, above.shape[1])), below])
        if self._lu is None:
            found = np.full_like(right, np.nan)
        else:
            letter, system = ("T", self._system.T) if transposed else ("N", self._system)
            found = self._lu.solve(right, letter)
            found += self._lu.solve(right - system @ found, letter)
        return found[:size], found[size + self._between :]

    def _sparse(self, rows: NodeRows) -> sp.csr_array:
        """Rows of H as a sparse matrix, shape (row_count, 3 node_count)."""
        columns = 3 * rows.node_index[:, None] + np.arange(3)
        row_index = np.repeat(rows.row_index, 3)
        return sp.coo_array(
            (rows.blocks.ravel(), (row_index, columns.ravel())), shape=(rows.row_count, self._size)
        ).tocsr()


def _solved_together(saddle: Saddle, rows: _Rows, holding: _Holding) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the effectors by forces on them, and by the actuators."""
    h, count, held = holding.places, len(holding.held), np.count_nonzero(holding.held)
    first, G = count + len(holding.contacts), rows.G
    E = saddle.H[first:]
    # The told efforts of an actuator change its displacement by C.
    own = np.zeros((len(h), count))
    own[:held] = holding.own[holding.held]
    # Loads: forces on the effectors, efforts of all actuators, displacements of what is held,
    # moves of the slides.
    counts = E.shape[0], count, len(h), G.shape[1]
    above = np.zeros((E.shape[1], sum(counts)))
    above[:, : E.shape[0] + count] = sp.vstack([E, saddle.H[:count]]).toarray().T
    below = np.hstack([np.zeros((len(h), E.shape[0])), -own, np.eye(len(h)), -G[h]])
    moves, _ = saddle.solve(above, below)
    by_force, by_effort, by_set, by_slide = np.split(E @ moves, np.cumsum(counts[:-1]), axis=1)
    own_by_effort = (saddle.D[:count] @ moves)[:, E.shape[0] :].diagonal() + holding.own.diagonal()
    return by_force, _columns_of_actuators(
        holding, by_set[:, :held], by_effort, own_by_effort, by_slide + G[first:]
    )
