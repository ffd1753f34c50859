"""A linear model of small motions about a state: a few modes, and at once what all others do.

With the tangent K of statics at prescribed lengths and efforts, the mass M, the damping matrix C,
rows E of the effectors, and actuators that are driven by efforts u (rows H) or hold displacements u
(q = G u in balance),

    M q̈ + C q̇ + K q = Hᵀu,    D q + C_a λ = u where displacements are held.

The modes V have K V = M V Ω², Vᵀ M V = 1, and hold still what is held. With z = Vᵀ M q and N = Vᵀ M G,

    z̈ + c ż + Ω² z = B u + B' u̇,    y = E V z + D u,

of efforts with B = VᵀHᵀ, B' = 0, D = E K⁻¹Hᵀ - E V Ω⁻² B; of displacements with B = Ω² N,
B' = c N - VᵀC G, D = E (G - V N). So y of a standing robot is exact for any number of modes. The
matrices in discrete time solve the equations of a step of the scene's time scheme
(`time_integration`), or hold efforts and ramp displacements exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh, expm
from scipy.sparse.linalg import LinearOperator, eigsh

from softrobot_twin.analysis.sensitivities import Sensitivities
from softrobot_twin.errors import CommandError
from softrobot_twin.mechanics.remembering_elements import RememberingElements
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.simulation.command import DEFAULT_TIME_STEP
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.simulation.step.time_integration import Weights
from softrobot_twin.solvers.factorization import laid_out_like
from softrobot_twin.solvers.superlu import SuperLU

# The modes that count most are chosen among so many times as many slow ones, and so many more.
AMONG, AND_MORE = 4, 10
# A compliance below this share of the greatest is that of what is held.
HELD_SHARE = 1.0e-12


class StateSpace(NamedTuple):
    """x' = A x + B u, y = C x + D u, of deviations; x' is ẋ, or x a step later.

    Attributes:
        A: Shape (state_count, state_count).
        B: Shape (state_count, input_count).
        C: Shape (output_count, state_count).
        D: Shape (output_count, input_count).
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


@dataclass(frozen=True)
class LinearModel:
    """Small motions about a state, by m modes; see the module.

    Attributes:
        inputs: Names of the k inputs, such as ``flexor_shortening_m`` and ``left_pressure_Pa``.
        outputs: Names of the p outputs, such as ``tip_x_m``.
        is_by_effort: Whether each input is an effort, shape (k,).
        input_values: Inputs at the state, shape (k,).
        output_values: Outputs at the state [m], shape (p,).
        M: Masses of the modes, all 1, shape (m, m).
        K: Ω², their stiffnesses [1/s²], shape (m, m).
        damping: c [1/s], shape (m, m).
        H: Bᵀ, the forces of one unit of each input on the modes, shape (k, m).
        H_rates: B'ᵀ, the same of its rate, shape (k, m).
        E: Motion of the outputs by the modes, shape (p, m).
        D: What the other modes add at once, shape (p, k).
        shapes: V, the modes, shape (free_node_count, 3, m).
        weights: Those of generalized α; None for backward Euler.
        time_step: Of the steps that `discrete` and `sampled` stand for by default [s].
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    is_by_effort: np.ndarray
    input_values: np.ndarray
    output_values: np.ndarray
    M: np.ndarray
    K: np.ndarray
    damping: np.ndarray
    H: np.ndarray
    H_rates: np.ndarray
    E: np.ndarray
    D: np.ndarray
    shapes: np.ndarray
    weights: Weights | None
    time_step: float

    @property
    def frequencies(self) -> np.ndarray:
        """Of the undamped modes [Hz], negative where they are unstable, shape (m,)."""
        squares = self.K.diagonal()
        return np.sign(squares) * np.sqrt(np.abs(squares)) / (2.0 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """Damping of each mode as a share of the critical one, shape (m,)."""
        return self.damping.diagonal() / (4.0 * np.pi * np.abs(self.frequencies))

    @property
    def static_gain(self) -> np.ndarray:
        """Outputs of a robot that stands, by one unit of each input, shape (p, k)."""
        return self.E @ np.linalg.solve(self.K, self.H.T) + self.D

    def continuous(self) -> StateSpace:
        """In continuous time; the states are z and ż - B' u."""
        m = len(self.K)
        A = np.block([[np.zeros((m, m)), np.eye(m)], [-self.K, -self.damping]])
        B = np.vstack([self.H_rates.T, self.H.T - self.damping @ self.H_rates.T])
        return StateSpace(A, B, np.hstack([self.E, np.zeros_like(self.E)]), self.D)

    def sampled(self, time_step: float | None = None) -> StateSpace:
        """A step of a time of the exact motion: efforts jump at its begin, displacements are ramped.

        Args:
            time_step: Duration of the step [s].

        Returns:
            Its states are those of `continuous` and the inputs of the step before; D is zero.
        """
        h, (A, B, C, D) = time_step or self.time_step, self.continuous()
        n, k = B.shape
        system = np.zeros((n + 2 * k, n + 2 * k))
        system[:n, :n], system[:n, n : n + k] = A, B
        system[n : n + k, n + k :] = np.eye(k)
        flow = expm(h * system)[:n]
        own, held, ramped = flow[:, :n], flow[:, n : n + k], flow[:, n + k :] / h
        jumps = np.where(self.is_by_effort, held, ramped)
        before = np.where(self.is_by_effort, 0.0, held - ramped)
        return StateSpace(
            np.block([[own, before], [np.zeros((k, n + k))]]), np.vstack([jumps, np.eye(k)]),
            np.hstack([C, D]), np.zeros_like(D))  # fmt: skip

    def discrete(self, time_step: float | None = None) -> StateSpace:
        """A step of the scene's time scheme, by its own weights.

        Args:
            time_step: Duration of the step [s].

        Returns:
            Its states are those of the scheme, of the modes and the inputs: places and velocities,
            of generalized α also v̇ and a; D is zero.
        """
        h, w, m = time_step or self.time_step, self.weights, len(self.K)
        r = m + len(self.H)
        size = (2 if w is None else 4) * r
        # Rows of what is known of the state, and of the inputs.
        known = np.eye(size + len(self.H))
        q, v, *others = (known[i * r : (i + 1) * r] for i in range(size // r))
        zeta, span, ahead, reference = 1.0, h, v, q
        if w is not None:
            v_dot, a = others
            ratio, share = w.beta / w.gamma, h * w.beta / (1.0 - w.alpha_m)
            zeta, span = w.zeta, h * ratio
            ahead = v + h * (0.5 - w.beta) * a + share * (w.alpha_f * v_dot - w.alpha_m * a)
            rate = (1.0 - ratio) * v + h * (0.5 - w.beta - ratio * (1.0 - w.gamma)) * a
            reference = q + h * rate
        after, c, B, by_rate = known[size:], self.damping, self.H.T, self.H_rates.T
        right = (q + h * ahead)[:m] / (zeta * h * h) + c @ reference[:m] / span
        right += B @ after + by_rate @ (after - reference[m:]) / span
        modes = np.linalg.solve(self.M / (zeta * h * h) + c / span + self.K, right)
        q_new = np.vstack([modes, after])
        mean = (q_new - q) / h
        new = [q_new, mean]
        if w is not None:
            a_new = ((mean - v) / h - (0.5 - w.beta) * a) / w.beta
            v_dot_new = (1.0 - w.alpha_m) * a_new + w.alpha_m * a - w.alpha_f * v_dot
            new = [q_new, v + h * ((1.0 - w.gamma) * a + w.gamma * a_new),
                   v_dot_new / (1.0 - w.alpha_f), a_new]  # fmt: skip
        moves = np.vstack(new)
        rest = np.zeros((len(self.E), size - r))
        return StateSpace(moves[:, :size], moves[:, size:], np.hstack([self.E, self.D, rest]),
                          np.zeros_like(self.D))  # fmt: skip


class ModalTangent(Sensitivities):
    """Computes linear models at the present state of a simulation that moves in time."""

    def __init__(self, simulation: Simulation, by_effort: np.ndarray | bool = False):
        """Allocate.

        Args:
            simulation: The simulation.
            by_effort: See `EffectorCompliance.at_state`.

        Raises:
            CommandError: No linear model is built for the scene.
        """
        if why := why_no_linear_model(simulation):
            raise CommandError("linear_model", why)
        super().__init__(simulation, by_effort)
        self._sparse, self._places = laid_out_like(simulation.model.factorization, SuperLU)

    def at_state(self, modes: int | None = 5, time_step: float = DEFAULT_TIME_STEP) -> LinearModel:
        """The linear model at the state where the simulation stands.

        Args:
            modes: How many modes it has: those of the slow ones through which the actuators move
                the effectors most. None for all modes of the mesh, by dense matrices.
            time_step: See `LinearModel`.

        Raises:
            CommandError: A cable is neither slack nor under tension.
        """
        solver, _ = self._system()
        for index in np.flatnonzero(self._held.touching):
            raise CommandError(self._model.actuators.names[index], "is neither slack nor under "
                               "tension, where its motion is not linear: pull it or slacken it")
        M, C = self._of_motion(True), self._of_motion(False)
        names, is_by_effort, values, loads, holds = self._inputs()
        G, _ = solver.solve(np.zeros_like(loads), holds)
        static = self._effectors @ (solver.solve(loads, np.zeros_like(holds))[0] + G)
        squares, V = self._modes(solver, M, modes)
        E = self._effectors @ V
        N, forces = V.T @ (M @ G), V.T @ loads
        limits = self._model.actuators.limits
        scales = np.where(is_by_effort, limits.effort_scale, limits.displacement_scale)
        shares = (forces / squares[:, None] + N) * scales
        gains = np.linalg.norm(E, axis=0) * np.linalg.norm(shares, axis=1)
        chosen = np.sort(np.argsort(-gains, kind="stable")[:modes])
        squares, V, E, N, forces = squares[chosen], V[:, chosen], E[:, chosen], N[chosen], forces[chosen]
        CV = C @ V
        damping = V.T @ CV
        B = forces + squares[:, None] * N
        scene, weights = self._model.scene, None
        if scene.time_scheme == "generalized_alpha":
            weights = Weights.of_radius(scene.spectral_radius)
        outputs = [f"{name}_{axis}_m" for name in self._simulation.effector_names for axis in "xyz"]
        return LinearModel(
            names, tuple(outputs), is_by_effort, values,
            self._simulation.effector_positions().ravel(), np.eye(len(chosen)), np.diag(squares),
            damping, B.T, (damping @ N - CV.T @ G).T, E, static - E @ (B / squares[:, None]),
            V.reshape(-1, 3, len(chosen)), weights, time_step,
        )  # fmt: skip

    def _inputs(self):
        """Names and kinds of the inputs, their values, and what one unit of each loads or moves."""
        actuators, state, held = self._model.actuators, self._simulation.state, self._held
        keeps_effort, follows = held.is_by_effort & ~held.held, held.held & ~held.is_by_effort
        loads = np.where(keeps_effort[:, None], self._actuator_rows, 0.0).T
        holds = np.zeros((len(held.places), len(held.held)))
        holds[: np.count_nonzero(held.held)] = np.diag(held.ratios * follows)[held.held]
        quantities = actuators.driven_quantities(held.is_by_effort)
        moved = actuators.displacements(state.setpoints, state.positions)
        return (tuple(map(column, actuators.names, quantities)), held.is_by_effort,
                np.where(held.is_by_effort, state.efforts, moved), loads, holds)  # fmt: skip

    def _of_motion(self, inertia: bool) -> sp.csc_array:
        """M [kg], or else the damping matrix C [N s/m], where nothing moves."""
        model, positions = self._model, self._simulation.state.positions
        still, total = np.zeros((model.nodes.free_node_count, 3)), np.zeros_like(self._storage)
        for term in model.forces:
            if not term.remembers_start or getattr(term, "is_inertia", False) != inertia:
                continue
            weight = getattr(term, "weight", None)
            if inertia:
                term.weight = 1.0
            # What is elastic is the same in a step that takes infinitely long.
            for sign, time_step in ((1.0, 1.0), (-1.0, np.inf)):
                self._storage[:] = 0.0
                term.begin_step(positions, still, time_step)
                term.add(positions, still.copy(), self._storage, False)
                total += sign * self._storage
            if inertia:
                term.weight = weight
        self._sparse.storage[:] = total[self._places]
        found = sp.csc_array(self._sparse.matrix(), copy=True)
        found.eliminate_zeros()
        return found

    def _modes(self, solver, M: sp.csc_array, count: int | None) -> tuple[np.ndarray, np.ndarray]:
        """Squares of angular frequencies [1/s²], and modes, of all or of the slow ones."""
        size = M.shape[0]
        held = len(self._held.places)

        def yields(forces: np.ndarray) -> np.ndarray:
            forces = forces.reshape(size, -1)
            return solver.solve(forces, np.zeros((held, forces.shape[1])))[0]

        if count is not None and (among := AMONG * count + AND_MORE) < size - held - 1:
            operator = LinearOperator((size, size), lambda f: yields(f)[:, 0], dtype=float)
            start = np.random.default_rng(0).standard_normal(size)
            # With its inverse given, only the shape of the first matrix counts.
            squares, V = eigsh(M, among, M, sigma=0.0, OPinv=operator, v0=start)
        else:
            masses, L = eigh(M.toarray())
            L = L * np.sqrt(np.maximum(masses, 0.0))
            by_forces = yields(L)
            compliances, W = eigh(L.T @ by_forces)
            moves = np.abs(compliances) > HELD_SHARE * np.abs(compliances).max()
            squares = 1.0 / compliances[moves]
            V = by_forces @ W[:, moves] * squares
        order = np.argsort(np.abs(squares), kind="stable")
        return squares[order], V[:, order]


def why_no_linear_model(simulation: Simulation) -> str:
    """Why no linear model is built for a scene; empty where one is.

    Args:
        simulation: The simulation of the scene.
    """
    scene, model = simulation.scene, simulation.model
    if scene.integration != "dynamic":
        return f"needs integration dynamic, and that of scene {scene.name} is {scene.integration}"
    if not model.target_rows.count:
        return "needs an effector"
    if scene.slides:
        return f"is not built for slides, which slides[0] {scene.slides[0].name} is"
    if not model.actuators.conserves:
        return f"is not built for {model.actuators.losses}"
    if any(isinstance(term.on_points, RememberingElements) for term in model.forces):
        return "is not built for materials that remember, such as viscous ones"
    return ""
