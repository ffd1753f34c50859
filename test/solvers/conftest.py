"""Random robots in contact."""

from collections.abc import Callable
from typing import NamedTuple

import daqp
import numpy as np
import pytest

from softrobot_twin.solvers.direct_problem import solve_direct
from softrobot_twin.solvers.inverse_problem import Bounds, InverseSystem, build_inverse_problem
from softrobot_twin.solvers.qpcc import QPCC
from test.builder import builder

ENERGY_WEIGHT = 1.0e-6


class Blocks(NamedTuple):
    """Blocks of effectors e, cables a and contacts c by tensions, contact forces and moves G."""

    W_ea: np.ndarray
    W_ec: np.ndarray
    W_aa: np.ndarray
    W_ac: np.ndarray
    W_cc: np.ndarray
    G_e: np.ndarray
    G_a: np.ndarray
    G_c: np.ndarray
    effectors: np.ndarray
    actuators: np.ndarray
    gaps: np.ndarray

    @property
    def stacked(self) -> InverseSystem:
        """The same by z = (λ_a, u, λ_c); what moves are actuators too."""
        first, moves = len(self.actuators), self.G_e.shape[1]
        own = np.eye(moves, first + moves + len(self.gaps), k=first)
        cables = np.hstack([self.W_aa, self.G_a, self.W_ac])
        return InverseSystem(
            np.hstack([self.W_ea, self.G_e, self.W_ec]), np.vstack([cables, own]),
            np.hstack([self.W_ac.T, self.G_c, self.W_cc]), np.arange(first + moves) >= first,
            self.effectors, np.pad(self.actuators, (0, moves)), self.gaps,
        )  # fmt: skip


class MoveBounds(NamedTuple):
    """Bounds on moves and contact forces."""

    move_min: np.ndarray
    move_max: np.ndarray
    force_max: np.ndarray


class RobotInContact(NamedTuple):
    """A condensed robot, and its state with held actuators."""

    system: Blocks
    bounds: Bounds
    contact_bounds: MoveBounds
    tensions: np.ndarray

    def given(self, weights: np.ndarray, energy_weight: float) -> tuple:
        """Arguments of `build_inverse_problem`."""
        least, most, force_max = self.contact_bounds
        free = np.full(len(least), np.inf)
        bounds = [np.concatenate([own, more]) for own, more in zip(
            self.bounds, (least, most, -free, free), strict=True)]  # fmt: skip
        return self.system.stacked, weights, energy_weight, Bounds(*bounds), force_max

    @property
    def contacts(self) -> int:
        return len(self.system.gaps)

    @property
    def held(self) -> np.ndarray:
        """(λ_a, u, λ_c): tensions kept, no move, and the forces that balance them."""
        count, system = self.contacts, self.system
        gaps = system.W_ac.T @ self.tensions + system.gaps
        none, unlimited = np.zeros(count), np.full(count, np.inf)
        forces = solve_direct(system.W_cc, gaps, none, none, unlimited)
        return np.concatenate([self.tensions, np.zeros(system.G_e.shape[1]), forces])

    @property
    def touching(self) -> np.ndarray:
        held = self.held
        return held[len(held) - self.contacts :] > 0.0

    def problem(self, energy_weight=ENERGY_WEIGHT) -> QPCC:
        weights = np.ones(len(self.system.effectors))
        problem = build_inverse_problem(*self.given(weights, energy_weight))
        return problem

    def with_contacts(self, of: np.ndarray) -> "RobotInContact":
        """The robot with these of its contacts; one that is named twice is there twice."""
        system = self.system._replace(
            W_ec=self.system.W_ec[:, of], W_ac=self.system.W_ac[:, of],
            W_cc=self.system.W_cc[np.ix_(of, of)], G_c=self.system.G_c[of],
            gaps=self.system.gaps[of],
        )  # fmt: skip
        limits = self.contact_bounds._replace(force_max=self.contact_bounds.force_max[of])
        return self._replace(system=system, contact_bounds=limits)

    def with_force_max(self, force_max) -> "RobotInContact":
        """The robot whose contact force is limited."""
        limit = np.broadcast_to(np.asarray(force_max, float), self.contacts)
        return self._replace(contact_bounds=self.contact_bounds._replace(force_max=limit))


@builder
def robot_in_contact(seed, contacts=10, actuators=8, moves=1, rows=3) -> RobotInContact:
    """Makes a robot among obstacles, with some contacts closed, and a target out of reach."""
    rng = np.random.default_rng((seed, contacts))
    first = actuators + rows
    size = first + contacts
    Q = np.linalg.qr(rng.standard_normal((size, size)))[0]
    W = 1.0e-3 * (Q * np.logspace(0.0, -2.0, size)) @ Q.T
    a, e, c = slice(actuators), slice(actuators, first), slice(first, size)
    G = 0.5 * rng.standard_normal((size, moves))
    tensions = rng.uniform(0.0, 4.0, actuators) * (rng.random(actuators) < 0.7)
    target = W[e, a] @ tensions + 6.0e-3 * rng.standard_normal(rows)
    system = Blocks(
        W[e, a], W[e, c], W[a, a], W[a, c], W[c, c], G[e], G[a], G[c],
        -target, np.zeros(actuators), 2.0e-3 * rng.standard_normal(contacts),
    )  # fmt: skip
    free = np.full(actuators, np.inf)
    limits = MoveBounds(np.full(moves, -1e-3), np.full(moves, 1e-3), np.full(contacts, np.inf))
    bounds = Bounds(-free, free, np.zeros(actuators), np.full(actuators, 10.0))
    robot = RobotInContact(system, bounds, limits, tensions)
    held = robot.held
    path = W[a, a] @ tensions + W[a, c] @ held[actuators + moves :]
    bounds = bounds._replace(displacement_min=path - 3e-3, displacement_max=path + 3e-3)
    return robot._replace(bounds=bounds)


def plain_residual(problem: QPCC, z: np.ndarray) -> float:
    """Largest complementarity residual of the natural map, in shares of the largest gap."""
    forces, gaps = problem.forces(z), problem.gaps(z)
    compliance = np.diag(problem.C[:, len(z) - problem.contact_count :])
    size = max(np.abs(problem.d).max(), (compliance * forces).max())
    return float(np.abs(np.minimum(compliance * forces, gaps)).max() / size)


@pytest.fixture
def complementarity_residual() -> Callable[[QPCC, np.ndarray], float]:
    """Measures how far forces and gaps are from 0 ≤ λ ⊥ δ ≥ 0."""
    return plain_residual


def least_of_piece(problem, touching):
    """z = E x + e with gaps of touching contacts zero; then a plain program in x."""
    own = len(problem.g) - problem.contact_count
    E, e = np.zeros((len(problem.g), own)), np.zeros(len(problem.g))
    E[:own] = np.eye(own)
    forces = own + np.flatnonzero(touching)
    W = problem.C[np.ix_(touching, forces)]
    E[forces] = -np.linalg.solve(W, problem.C[touching][:, :own])
    e[forces] = -np.linalg.solve(W, problem.d[touching])
    H, f = E.T @ problem.P @ E, E.T @ (problem.P @ e + problem.g)
    rows = np.vstack([problem.A, problem.C[~touching], np.eye(len(e))[forces]]) @ E
    at_zero = np.concatenate([problem.A @ e, problem.gaps(e)[~touching], e[forces]])
    many = len(at_zero) - len(problem.row_lower)
    low = np.concatenate([problem.row_lower, np.zeros(many)]) - at_zero
    high = np.concatenate([problem.row_upper, np.full(many, 1e30)]) - at_zero
    scale = 1.0 / np.sqrt(np.diag(H))
    lengths = np.linalg.norm(rows * scale, axis=1)
    size = np.abs(f * scale).max()
    H, f, rows = H * np.outer(scale, scale), f * scale / size, rows * scale / lengths[:, None]
    high = np.concatenate([problem.upper[:own] / scale, high / lengths]) / size
    low = np.concatenate([problem.lower[:own] / scale, low / lengths]) / size
    _, _, exit_flag, info = daqp.solve(H, f, rows, high, low, primal_tol=1e-10)
    if exit_flag != 1:
        return None
    # DAQP names the active rows; their equations are solved here.
    duals = info["lam"]
    active = duals != 0.0
    bounds = np.where(duals > 0.0, high, low)[active]
    R = np.vstack([np.eye(own), rows])[active]
    K = np.block([[H, R.T], [R, np.zeros((len(R), len(R)))]])
    x = np.linalg.lstsq(K, np.concatenate([-f, bounds]), rcond=1e-14)[0][:own]
    return E @ (x * scale * size) + e


@pytest.fixture
def eliminated() -> Callable[[QPCC, np.ndarray], np.ndarray | None]:
    """Solves one branch by another method: the contact forces are eliminated first."""
    return least_of_piece
