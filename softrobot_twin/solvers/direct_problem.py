"""The direct problem: efforts of commanded actuators (Coevoet 2017, eq. 16, with slack allowed).

A cable pulls and never pushes: where its path is shorter than its length, the cable is slack. Hence
its displacement is at least the commanded one, its effort is at least zero, and one of the two
inequalities is an equation:

    0 ≤ λ  ⊥  W λ + δ_free - δ_set ≥ 0

These are the optimality conditions of min ½ λᵀWλ + (δ_free - δ_set)ᵀλ over λ ≥ 0, a strictly
convex problem. Mostly all cables are taut, or the few that are slack are found at once: then one or
two small systems of equations give the optimum, with a proof (`warm_start`). The guess does not
depend on earlier steps. Otherwise the dual active-set method of DAQP solves the problem exactly.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.solvers.daqp_program import solve_program
from softrobot_twin.solvers.inverse_problem import Bounds, own_compliances
from softrobot_twin.solvers.warm_start import optimum_from_active_set

# Two cables on one path make W singular; with this share of its diagonal they share the load.
SHARING = 1.0e-10
ROUND_OFF = 1.0e-12


@njit(**KERNEL)
def _proved_efforts(W, free_violation, prescribed, effort_min, effort_max, sizes):
    """Efforts of `solve_direct`, and whether they are proved; the guess: no bound is active."""
    n = len(prescribed)
    scale = 1.0 / np.sqrt(own_compliances(W, 0, sizes))
    P, gradient, lower, upper = np.empty((n, n)), np.empty(n), np.empty(n), np.empty(n)
    size = 0.0
    for i in range(n):
        for j in range(n):
            P[i, j] = W[i, j] * (scale[i] * scale[j])
        P[i, i] += SHARING
        gradient[i] = scale[i] * (free_violation[i] - prescribed[i])
        lower[i], upper[i] = effort_min[i] / scale[i], effort_max[i] / scale[i]
        size = max(size, abs(gradient[i]))
    none, no_rows = np.empty(0), np.empty((0, n))
    proved, z, _, _, active, _ = optimum_from_active_set(
        P, gradient, lower, upper, no_rows, none, none, no_rows, none, none,
        np.empty(0, dtype=np.bool_), np.zeros(n, dtype=np.int64),
    )  # fmt: skip
    for i in range(n):
        if active[i] < 0 or z[i] <= lower[i] + ROUND_OFF * size:
            z[i] = effort_min[i]
        elif active[i] > 0 or z[i] >= upper[i] - ROUND_OFF * size:
            z[i] = effort_max[i]
        else:
            z[i] = min(max(scale[i] * z[i], effort_min[i]), effort_max[i])
    return proved, z


def solve_direct(
    W: np.ndarray,
    free_violation: np.ndarray,
    prescribed: np.ndarray,
    effort_min: np.ndarray,
    effort_max: np.ndarray,
    sizes: np.ndarray | None = None,
) -> np.ndarray | None:
    """Efforts that hold actuators at their commanded displacements.

    Args:
        W: Displacement by effort, the rows of the actuators first [m/N], shape (m, m).
        free_violation: Displacement after free motion δ_free [m], shape (m,).
        prescribed: Commanded displacement δ_set of each actuator [m], shape (n,).
        effort_min: Least effort [N], shape (n,).
        effort_max: Greatest effort, at which the displacement is reduced [N], shape (n,).
        sizes: Large displacement of each actuator in its unit, shape (n,); 1 by default.

    Returns:
        Efforts [N], shape (n,), or None when the solver finds none.
    """
    # Contiguous, so that the kernel is compiled once whatever W was cut from.
    contiguous, n = np.ascontiguousarray(W), len(prescribed)
    sizes = np.ones(n) if sizes is None else sizes
    proved, efforts = _proved_efforts(
        contiguous, free_violation, prescribed, effort_min, effort_max, sizes
    )
    if proved:
        return efforts
    return solve_by_daqp(W[:n, :n], free_violation[:n] - prescribed, effort_min, effort_max, sizes)


def solve_by_daqp(
    W: np.ndarray, violation: np.ndarray, effort_min: np.ndarray, effort_max: np.ndarray,
    sizes: np.ndarray | None = None,
) -> np.ndarray | None:  # fmt: skip
    """Efforts that hold prescribed displacements, found by DAQP without a guess.

    Args:
        W: Displacement by effort [m/N], shape (n, n).
        violation: δ_free - δ_set [m], shape (n,).
        effort_min: Least effort [N], shape (n,).
        effort_max: Greatest effort [N], shape (n,).
        sizes: See `solve_direct`.

    Returns:
        Efforts [N], shape (n,), or None when the solver finds none.
    """
    sizes = np.ones(len(W)) if sizes is None else sizes
    scale = 1.0 / np.sqrt(own_compliances(np.ascontiguousarray(W), 0, sizes))
    no_rows = np.zeros((0, len(scale)))
    return _solve(W, scale, scale * violation, no_rows, effort_min, effort_max, (), ())


def solve_towards(
    W: np.ndarray, free_violation: np.ndarray, tensions: np.ndarray, bounds: Bounds,
    sizes: np.ndarray | None = None,
) -> np.ndarray | None:  # fmt: skip
    """Efforts nearest to commanded ones, min ½ (λ - λ*)ᵀW(λ - λ*), within bounds on both sides.

    Args:
        W: Displacement by effort [m/N], shape (n, n).
        free_violation: Shortening after free motion [m], shape (n,).
        tensions: Commanded efforts λ* [N], shape (n,).
        bounds: Bounds on displacements [m] and efforts [N].
        sizes: See `solve_direct`.

    Returns:
        Efforts [N], shape (n,), or None when the solver finds none.
    """
    sizes = np.ones(len(W)) if sizes is None else sizes
    scale = 1.0 / np.sqrt(own_compliances(np.ascontiguousarray(W), 0, sizes))
    rows = W * np.outer(scale, scale)
    gradient = -rows @ (tensions / scale) - SHARING * (tensions / scale)
    return _solve(
        W, scale, gradient, rows, bounds.effort_min, bounds.effort_max,
        scale * (bounds.displacement_min - free_violation),
        scale * (bounds.displacement_max - free_violation),
    )  # fmt: skip


def _solve(W, scale, gradient, rows, effort_min, effort_max, row_min, row_max) -> np.ndarray | None:
    """min ½ zᵀPz + gradientᵀz in scaled unknowns z = λ / scale, by DAQP."""
    count = len(scale)
    if count == 0:
        return np.zeros(0)
    P = W * np.outer(scale, scale)
    P[np.diag_indices_from(P)] += SHARING
    # DAQP's tolerances are absolute and displacements are millimetres: scale the problem to one.
    size = np.abs(gradient).max() or 1.0
    if not np.isfinite(size) or not np.all(np.isfinite(P)):
        return None
    upper = np.concatenate([effort_max / scale, row_max]) / size
    lower = np.concatenate([effort_min / scale, row_min]) / size
    found = solve_program(P, gradient / size, rows, lower, upper)
    if not found.is_found:
        return None
    z = found.x
    # An effort at a bound is the bound, without the solver's round-off.
    efforts = np.clip(scale * size * z, effort_min, effort_max)
    efforts = np.where(z >= upper[:count] - ROUND_OFF, effort_max, efforts)
    return np.where(z <= lower[:count] + ROUND_OFF, effort_min, efforts)
