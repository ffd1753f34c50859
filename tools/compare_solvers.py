"""Compares factorizations and QP solvers in time and accuracy; docs/solvers.md has their figures."""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from itertools import combinations, product
from pathlib import Path
from time import perf_counter
from typing import NamedTuple, Protocol

import daqp
import numpy as np
import scipy.sparse as sp
from rich.table import Table
from scipy.sparse.linalg import splu

from softrobot_twin.command_line.commands import whole
from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.harness.output_file import OutputError, make_folder
from softrobot_twin.harness.terminal import console, table, warn
from softrobot_twin.harness.timing import Spread, spread
from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.dense_stiffness import without_rows
from softrobot_twin.solvers.factorization import Factorization, NodeRows
from softrobot_twin.solvers.inverse_problem import Bounds, InverseSystem, build_inverse_problem
from softrobot_twin.solvers.quadratic_program import (
    DAQPSolver,
    QPSolution,
    WhitenedQP,
    whiten,
)
from softrobot_twin.solvers.superlu import OPTIONS
from softrobot_twin.study.bench_measurement import (
    BenchCase,
    circle_targets,
    default_scene_path,
    given_cases,
    without_garbage_collection,
)
from superlu_reference import SuperLUReference

# Every set of active rows is tried up to this many unknowns.
MOST_ENUMERATED = 4
_TOLERANCE = 1.0e-9
OSQP_INFINITY = 1.0e20
OSQP_TOLERANCE = 1.0e-8
OSQP_SETTINGS = {
    "verbose": False,
    # Where rows of C are nearly parallel, splitting methods converge slowly; another solver is
    # asked then.
    "max_iter": 1000,
    # The problem comes scaled.
    "scaling": 0,
    # Counted in iterations, never in seconds: the same input gives the same bits.
    "adaptive_rho_interval": 25,
}


def exact_multipliers(problem: WhitenedQP) -> np.ndarray | None:
    """λ that meets the optimality conditions to rounding.

    The Hessian is the identity, so the optimality conditions have exactly one solution.
    With few unknowns all sets of active rows are tried. With many, DAQP finds the set at a tight
    tolerance, and its equations are solved and checked here.

    Args:
        problem: The QP.

    Returns:
        λ [N], shape (n,); None when no set meets the conditions.
    """
    if len(problem.q) <= MOST_ENUMERATED:
        return enumerated(problem)
    return certified(problem)


def enumerated(problem: WhitenedQP) -> np.ndarray | None:
    """λ found by trying all sets of active rows, small sets first."""
    rows, n = problem.C.shape
    for count in range(n + 1):
        for active in combinations(range(rows), count):
            for upper in product((False, True), repeat=count):
                z = _meets_conditions(problem, np.array(active, int), np.array(upper, bool))
                if z is not None:
                    return problem.T @ z
    return None


def certified(problem: WhitenedQP) -> np.ndarray | None:
    """λ on the active set that DAQP finds, if it satisfies the conditions."""
    rows, n = problem.C.shape
    _, _, exit_flag, info = daqp.solve(
        np.eye(n), problem.q, problem.C, np.minimum(problem.upper, 1e30),
        np.maximum(problem.lower, -1e30), np.zeros(rows, dtype=np.intc), primal_tol=1e-11)
    if exit_flag < 1:
        return None
    duals = np.asarray(info["lam"])
    active = np.flatnonzero(duals)
    z = _meets_conditions(problem, active, duals[active] > 0.0)
    return None if z is None else problem.T @ z


def _meets_conditions(problem: WhitenedQP, active: np.ndarray, upper: np.ndarray) -> np.ndarray | None:
    """z with these rows at these bounds, if all duals have the right sign and no bound is
    violated.
    """
    C, q = problem.C[active], problem.q
    bounds = np.where(upper, problem.upper[active], problem.lower[active])
    if not np.all(np.isfinite(bounds)):
        return None
    # z = -q - Cᵀμ and C z = bounds.
    duals = np.linalg.lstsq(C @ C.T, -(bounds + C @ q), rcond=None)[0]
    if np.any(np.where(upper, duals, -duals) < -_TOLERANCE):
        return None
    z = -q - C.T @ duals
    # Dependent rows may contradict each other; then least squares violate some of them.
    if np.any(np.abs(C @ z - bounds) > _TOLERANCE):
        return None
    values = problem.C @ z
    breaks = np.any(values < problem.lower - _TOLERANCE) or np.any(
        values > problem.upper + _TOLERANCE)
    return None if breaks else z


SIZES = (4, 8, 12, 24)
_EFFECTOR_ROWS = 3
_ENERGY_WEIGHT = 1.0e-6
_COMPLIANCE = 1.0e-3  # m/N
_SEQUENCES = 6


class ProblemSet(NamedTuple):
    """Problems of one kind.

    Attributes:
        name: Name in tables.
        sequences: Sequences of consecutive problems, as in a run; a new solver is used for each
            sequence.
    """

    name: str
    sequences: tuple[tuple[WhitenedQP, ...], ...]

    @property
    def count(self) -> int:
        """Unknowns."""
        return len(self.sequences[0][0].q)


class RecordingSolver:
    """Solves by DAQP and records every problem."""

    name = DAQPSolver.name

    def __init__(self):
        self._solver = DAQPSolver()
        self.recorded: list[WhitenedQP] = []

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Records a problem and solves it."""
        self.recorded.append(problem)
        return self._solver.solve(problem)


def recorded_problems(case: BenchCase, count: int) -> ProblemSet:
    """Problems of a scene's own run along the circle.

    Args:
        case: A scene with cables and effectors.
        count: How many.
    """
    recorder = RecordingSolver()
    simulation = Simulation(case.scene)
    simulation.inverse.solver.qp_solver, simulation.inverse.solver.uses_warm_start = recorder, False
    commands = circle_targets(simulation)
    recorder.recorded.clear()
    while len(recorder.recorded) < count:
        simulation.step(next(commands))
    return ProblemSet(f"{case.scene.name}'s own run", (tuple(recorder.recorded[:count]),))


def random_problems(n: int, steps: int, twice: bool = False) -> ProblemSet:
    """Problems of random robots whose targets move on a circle, partly out of reach.

    Args:
        n: Number of actuators; even with `twice`.
        steps: Problems of each of a few sequences.
        twice: Every actuator exists twice, which makes rows parallel and the compliance singular.
    """
    sequences = tuple(_sequence(np.random.default_rng((n, seed)), n, steps, twice)
                      for seed in range(_SEQUENCES))
    return ProblemSet("random, each cable twice" if twice else "random", sequences)


def _sequence(generator, n: int, steps: int, twice: bool) -> tuple[WhitenedQP, ...]:
    different = n // 2 if twice else n
    size = different + _EFFECTOR_ROWS
    # A positive definite compliance with eigenvalues over three decades.
    Q = np.linalg.qr(generator.standard_normal((size, size)))[0]
    W = _COMPLIANCE * (Q * np.logspace(0.0, -3.0, size)) @ Q.T
    of = np.tile(np.arange(different), 2) if twice else np.arange(n)
    W_aa, W_ea = W[np.ix_(of, of)], W[different:, :different][:, of]
    tensions = generator.uniform(0.0, 4.0, n)
    reach = np.abs(W_ea @ tensions).max()
    middle = W_aa @ tensions
    half_range = 0.5 * np.abs(middle).max()
    bounds = Bounds(middle - half_range, middle + half_range, np.zeros(n), np.full(n, 10.0))
    first, second = np.linalg.qr(generator.standard_normal((_EFFECTOR_ROWS, 2)))[0].T
    angles = np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False)
    def problem(angle: float) -> WhitenedQP:
        target = 0.6 * reach * (np.cos(angle) * first + np.sin(angle) * second)
        system = InverseSystem.without_contacts(
            W_ea, W_aa, -W_ea @ tensions - target, np.zeros(n))
        weights = np.ones(_EFFECTOR_ROWS)
        return whiten(build_inverse_problem(system, weights, _ENERGY_WEIGHT, bounds))

    return tuple(map(problem, angles))


class OSQPSolver:
    """OSQP; its workspace is set up once, and updated by each problem of the same size."""

    name = "OSQP"

    def __init__(self, *, tolerance: float = OSQP_TOLERANCE):
        """Set nothing up yet: the first problem does.

        Args:
            tolerance: Residual, absolute and relative, at which the problem counts as solved.
        """
        import osqp

        self._osqp = osqp
        self._tolerance = tolerance
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, so that a run can be repeated to the bit."""
        self._solver, self._shape = None, (0, 0)

    def solve(self, problem: WhitenedQP) -> QPSolution:
        """Solve one problem, warm-started from the last.

        Args:
            problem: The whitened QP.

        Returns:
            z, and whether it can be trusted.
        """
        lower = np.maximum(problem.lower, -OSQP_INFINITY)
        upper = np.minimum(problem.upper, OSQP_INFINITY)
        if self._shape != problem.C.shape:
            self._set_up(problem, lower, upper)
        else:
            # Column by column, as a sparse matrix with every entry present stores it.
            self._solver.update(q=problem.q, l=lower, u=upper, Ax=problem.C.T.ravel())
        found = self._solver.solve(raise_error=False)
        status = found.info.status
        return problem.solution(found.x, found.y, status == "solved", found.info.iter, status, self.name)

    def _set_up(self, problem: WhitenedQP, lower: np.ndarray, upper: np.ndarray) -> None:
        self._solver, self._shape = self._osqp.OSQP(), problem.C.shape
        # Every entry is present, also one that is zero now.
        C = sp.csc_matrix(np.ones(self._shape))
        C.data = problem.C.T.ravel()
        identity = sp.eye(self._shape[1], format="csc")
        self._solver.setup(
            identity, problem.q, C, lower, upper,
            eps_abs=self._tolerance, eps_rel=self._tolerance, **OSQP_SETTINGS,
        )  # fmt: skip


OSQP, DAQP, AS_SHIPPED = "OSQP 1e-8", "DAQP 1e-6", "DAQP 1e-9 (default)"
QP_SOLVERS: dict[str, Callable[[], object]] = {
    "OSQP 1e-3": lambda: OSQPSolver(tolerance=1e-3),
    "OSQP 1e-5": lambda: OSQPSolver(tolerance=1e-5),
    OSQP: lambda: OSQPSolver(tolerance=1e-8),
    DAQP: lambda: DAQPSolver(tolerance=1e-6),
    AS_SHIPPED: DAQPSolver,
}
if find_spec("osqp") is None:
    QP_SOLVERS = {name: make for name, make in QP_SOLVERS.items() if not name.startswith("OSQP")}


class QPFigures(NamedTuple):
    """Results of one solver on one set of problems.

    Attributes:
        problems: Name of the set.
        count: Unknowns.
        solver: Name of the solver.
        time: Time of a solve through the interface of this package, solved or not [s].
        solved_share: Share of solved problems.
        median_error: Largest error of λ of a problem, relative to its largest λ; median over the
            solved problems.
        worst_error: Largest error over the solved problems.
        judged: Number of problems with an exact solution for comparison.
        posed: Number of problems in the set.
    """

    problems: str
    count: int
    solver: str
    time: Spread
    solved_share: float
    median_error: float
    worst_error: float
    judged: int
    posed: int


def compare_qp_solvers(sets: Sequence[ProblemSet]) -> list[QPFigures]:
    """Solves all problems with all solvers."""
    figures = []
    with without_garbage_collection():
        for problems in sets:
            exact = [[exact_multipliers(problem) for problem in sequence]
                     for sequence in problems.sequences]
            figures += [_qp_figures(problems, name, make, exact)
                        for name, make in QP_SOLVERS.items()]
    return figures


def _qp_figures(problems: ProblemSet, name: str, make, exact) -> QPFigures:
    times, solved, errors = [], [], []
    for sequence, answers in zip(problems.sequences, exact, strict=True):
        solver = make()
        # The first solve includes the setup and is not timed.
        solver.solve(sequence[0])
        for problem, answer in zip(sequence, answers, strict=True):
            start = perf_counter()
            solution = solver.solve(problem)
            times.append(perf_counter() - start)
            solved.append(solution.solved)
            if solution.solved and answer is not None:
                errors.append(_multiplier_error(solution.unknowns, answer))
    judged = sum(answer is not None for answers in exact for answer in answers)
    found = spread(np.array(errors))
    return QPFigures(problems.name, problems.count, name, spread(np.array(times)),
                     float(np.mean(solved)), found.median, found.maximum, judged, len(times))


def _multiplier_error(multipliers: np.ndarray, exact: np.ndarray) -> float:
    largest = np.abs(exact).max()
    return float(np.abs(multipliers - exact).max() / (largest if largest > 0.0 else 1.0))


class Candidate(Protocol):
    """A factorization of one matrix.

    Attributes:
        name: Name in tables.
    """

    name: str

    def factor(self) -> None:
        """Factorizes the matrix; results that depend only on its pattern may be reused."""

    def respond(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """W = H A⁻¹ Hᵀ, and dx = A⁻¹ (b + Hᵀ λ), shape (dof_count,)."""


class Job(NamedTuple):
    """The problem for every candidate.

    Attributes:
        matrix: A, full, shape (dof_count, dof_count).
        rows: H.
        b: Right-hand side [N], shape (node_count, 3).
    """

    matrix: sp.csc_matrix
    rows: NodeRows
    b: np.ndarray


class InUse:
    """A simulation's own factorization: forward solves for W, one backward solve for dx."""

    def __init__(self, factorization: Factorization, job: Job):
        self.name = factorization.name
        self._factorization, self._job = factorization, job

    def factor(self) -> None:
        """See `Candidate.factor`."""
        if not self._factorization.factor():
            raise ArithmeticError(f"{self.name}: the matrix is not positive definite")

    def respond(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Candidate.respond`."""
        W = self._factorization.condense(self._job.rows, self._job.b).W
        return W, self._factorization.expand(multipliers).reshape(-1)


class LibraryCandidate:
    """A library that solves complete systems: one for each row of H, and one for b."""

    name = ""

    def __init__(self, job: Job):
        self._matrix = job.matrix
        self._Ht = job.rows.transposed(len(job.b))
        self._right = np.asfortranarray(np.column_stack([self._Ht, job.b.reshape(-1)]))

    def respond(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Candidate.respond`."""
        X = self._solve(self._right)
        return self._Ht.T @ X[:, :-1], X[:, -1] + X[:, :-1] @ multipliers


class SuperLUCandidate(LibraryCandidate):
    """scipy's SuperLU, whose interface repeats ordering and analysis at every call."""

    name = "SuperLU (MMD_AT_PLUS_A, symmetric mode)"

    def factor(self) -> None:
        """See `Candidate.factor`."""
        self._lu = splu(self._matrix, **OPTIONS)

    def _solve(self, right: np.ndarray) -> np.ndarray:
        return self._lu.solve(right)


class QdldlCandidate(LibraryCandidate):
    """qdldl: LDLᵀ entry by entry, ordered by AMD once."""

    name = "qdldl"

    def __init__(self, job: Job):
        import qdldl

        super().__init__(job)
        self._upper = sp.triu(self._matrix, format="csc")
        self._solver = qdldl.Solver(self._upper, upper=True)

    def factor(self) -> None:
        """See `Candidate.factor`."""
        self._solver.update(self._upper, upper=True)

    def _solve(self, right: np.ndarray) -> np.ndarray:
        return np.column_stack([self._solver.solve(column) for column in right.T])


class PardisoCandidate(LibraryCandidate):
    """MKL Pardiso through pypardiso: symmetric positive definite, analysed once."""

    name = "MKL Pardiso"
    _POSITIVE_DEFINITE = 2
    _ANALYSE, _FACTOR, _SOLVE = 11, 22, 33

    def __init__(self, job: Job):
        from pypardiso import PyPardisoSolver

        super().__init__(job)
        self._upper = sp.triu(self._matrix, format="csr")
        self._solver = PyPardisoSolver(mtype=self._POSITIVE_DEFINITE)
        self._run(self._ANALYSE, np.zeros((self._upper.shape[0], 1)))

    def factor(self) -> None:
        """See `Candidate.factor`."""
        self._run(self._FACTOR, np.zeros((self._upper.shape[0], 1)))

    def _solve(self, right: np.ndarray) -> np.ndarray:
        return self._run(self._SOLVE, right)

    def _run(self, phase: int, right: np.ndarray) -> np.ndarray:
        # Its public functions repeat the analysis for every matrix.
        self._solver.set_phase(phase)
        return self._solver._call_pardiso(self._upper, right)


_OPTIONAL: dict[str, Callable[[Job], Candidate]] = {
    "qdldl": QdldlCandidate, "pypardiso": PardisoCandidate}


def candidates(factorization: Factorization, job: Job) -> tuple[list[Candidate], list[str]]:
    """Installed candidates, the one in use first, and the names of missing packages."""
    found: list[Candidate] = [InUse(factorization, job), SuperLUCandidate(job)]
    absent = []
    for package, make in _OPTIONAL.items():
        try:
            found.append(make(job))
        except ImportError:
            absent.append(package)
    return found, absent


_REFINEMENTS = 3


class FactorizationFigures(NamedTuple):
    """Time and accuracy of one factorization.

    Attributes:
        name: Its name.
        factor: Time of the numeric factorization [s].
        solves: Time of W and of dx [s].
        residual: ‖A dx - b - Hᵀλ‖ / ‖b + Hᵀλ‖.
        compliance_error: Largest error of W, relative to its largest entry.
    """

    name: str
    factor: Spread
    solves: Spread
    residual: float
    compliance_error: float


class FactorizationComparison(NamedTuple):
    """All factorizations on one matrix.

    Attributes:
        scene: Name of the scene.
        dof_count: Unknowns.
        row_count: Rows of H.
        figures: Figures of each factorization.
        absent: Packages that are not installed.
    """

    scene: str
    dof_count: int
    row_count: int
    figures: tuple[FactorizationFigures, ...]
    absent: tuple[str, ...]


def compare_factorizations(simulation: Simulation, repeats: int) -> FactorizationComparison:
    """Compares all candidates on the matrix of a step on a circle.

    Args:
        simulation: Warmed up.
        repeats: Number of timed repetitions.
    """
    commands = circle_targets(simulation)
    simulation.step(next(commands))
    model = simulation.model
    rows = NodeRows(model.rows.row_index.copy(), model.rows.node_index.copy(),
                    model.rows.blocks.copy(), model.rows.row_count)
    generator = np.random.default_rng(1)
    job = Job(SuperLUReference(without_rows(model.factorization)).matrix(), rows,
              generator.standard_normal((simulation.dof_count // 3, 3)))
    multipliers = generator.uniform(0.0, 1.0, rows.row_count)
    found, absent = candidates(without_rows(model.factorization), job)
    exact = _refined_compliance(job)
    with without_garbage_collection():
        times = _time(found, multipliers, repeats)
    return FactorizationComparison(
        simulation.scene.name, simulation.dof_count, rows.row_count,
        tuple(_factorization_figures(candidate, job, multipliers, exact, times[candidate.name])
              for candidate in found), tuple(absent))


def _time(
    found: Sequence[Candidate], multipliers: np.ndarray, repeats: int
) -> dict[str, tuple[list[float], list[float]]]:
    """Factor and solve times of each, measured in turns, so that conditions are the same."""
    times = {candidate.name: ([], []) for candidate in found}
    for number in range(repeats + 1):
        for candidate in found:
            # Two runs, of which the second is timed, because the first one fills the caches.
            for _ in range(2):
                start = perf_counter()
                candidate.factor()
                middle = perf_counter()
                candidate.respond(multipliers)
                end = perf_counter()
            if number:
                times[candidate.name][0].append(middle - start)
                times[candidate.name][1].append(end - middle)
    return times


def _factorization_figures(candidate, job: Job, multipliers, exact, times) -> FactorizationFigures:
    W, dx = candidate.respond(multipliers)
    right = job.b.reshape(-1) + job.rows.transposed(len(job.b)) @ multipliers
    residual = np.linalg.norm(job.matrix @ dx - right) / np.linalg.norm(right)
    error = np.abs(W - exact).max() / np.abs(exact).max()
    return FactorizationFigures(
        candidate.name, spread(times[0]), spread(times[1]), float(residual), float(error))


def _refined_compliance(job: Job) -> np.ndarray:
    """W by iterative refinement, its residuals in extended precision where the machine has it."""
    Ht = job.rows.transposed(len(job.b))
    lu, coo = splu(job.matrix, **OPTIONS), job.matrix.tocoo()
    values = coo.data.astype(np.longdouble)
    X = lu.solve(Ht).astype(np.longdouble)
    for _ in range(_REFINEMENTS):
        for k in range(Ht.shape[1]):
            image = np.zeros(len(Ht), dtype=np.longdouble)
            np.add.at(image, coo.row, values * X[coo.col, k])
            X[:, k] += lu.solve((Ht[:, k] - image).astype(float))
    return (Ht.T @ X).astype(float)


class TextTable(NamedTuple):
    """A table of text.

    Attributes:
        title: Title.
        columns: Headings.
        rows: Cells.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def for_terminal(self) -> Table:
        """The table as rich prints it."""
        made = table(self.title, *self.columns)
        for row in self.rows:
            made.add_row(*row)
        return made

    def write_csv(self, path: Path) -> None:
        """Writes the table as CSV.

        Raises:
            OutputError: The file cannot be written.
        """
        try:
            with path.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows([self.columns, *self.rows])
        except OSError as error:
            raise OutputError(path, error.strerror or str(error)) from error


def factorization_table(found: FactorizationComparison) -> TextTable:
    """One row for each factorization."""
    return TextTable(
        f"Factorizations of {found.scene}'s matrix, {found.dof_count} dof, "
        f"{found.row_count} rows of H",
        ("factorization", "factor, median ms", "factor, p99 ms", "W and dx, median ms",
         "together, ms", "residual of dx", "error of W"),
        tuple(
            (one.name, _ms(one.factor.median), _ms(one.factor.p99), _ms(one.solves.median),
             _ms(one.factor.median + one.solves.median), f"{one.residual:.1e}",
             f"{one.compliance_error:.1e}")
            for one in found.figures))


def qp_table(figures: Sequence[QPFigures]) -> TextTable:
    """One row for each solver on each set of problems."""
    return TextTable(
        "QP solvers on inverse problems",
        ("problems", "n", "solver", "median µs", "p99 µs", "solved", "error of λ, median",
         "error of λ, worst", "judged"),
        tuple(
            (one.problems, str(one.count), one.solver, f"{1e6 * one.time.median:.1f}",
             f"{1e6 * one.time.p99:.1f}", f"{100.0 * one.solved_share:.0f} %",
             _error_word(one.median_error), _error_word(one.worst_error),
             f"{one.judged}/{one.posed}")
            for one in figures))


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3f}"


def _error_word(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "-"


_OPTIONAL_PACKAGES = ("qdldl", "pypardiso", "osqp")
# One factorization is timed per this many requested steps, and one QP is taken per five steps.
_STEPS_A_REPEAT = 10
_STEPS_A_PROBLEM = 5
_TWICE = 8


def compare(scenes: list[Path], steps: int, output: Path | None = None, threads: int = 1) -> int:
    """Compares solvers and prints the results.

    Args:
        scenes: The scene to take matrices and problems from; none for the Diamond.
        steps: How much is measured: a tenth as many factorizations, a fifth as many problems.
        output: Folder for ``factorizations.csv`` and ``qp_solvers.csv``, or None.
        threads: Most threads of the default factorization, and those of MKL.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene cannot be used or an output not be written.
    """
    if output is not None:
        make_folder(output)
    case = given_cases(scenes[:1] or [default_scene_path()])[0]
    for ignored in scenes[1:]:
        warn(f"{ignored} is left out: solvers are compared on one scene")
    os.environ["MKL_NUM_THREADS"] = str(threads)
    simulation = Simulation(case.scene.changed(solver={"threads": threads}))
    simulation.warm_up()
    found = compare_factorizations(simulation, max(1, steps // _STEPS_A_REPEAT))
    count = max(1, steps // _STEPS_A_PROBLEM)
    each = max(1, count // 5)
    figures = compare_qp_solvers([
        recorded_problems(case, count), *(random_problems(n, each) for n in SIZES),
        random_problems(_TWICE, each, twice=True)])
    conditions = describe_machine((*NUMERICAL_LIBRARIES, *_OPTIONAL_PACKAGES)) + ". " + (
        "One thread" if threads == 1 else f"{threads} threads")
    tables = {"factorizations": factorization_table(found), "qp_solvers": qp_table(figures)}
    shown = console()
    shown.print(conditions + "\n")
    for made in tables.values():
        shown.print(made.for_terminal())
        shown.print()
    for package in found.absent:
        shown.print(f"{package} is not installed and was left out: pip install {package}")
    if output is not None:
        for name, made in tables.items():
            made.write_csv(output / f"{name}.csv")
        shown.print(f"written: {output / 'factorizations.csv'}, {output / 'qp_solvers.csv'}")
    return 0


def main() -> int:
    """Reads the command line and compares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", metavar="SCENE", type=Path, nargs="*",
                        help="scene to take matrices and problems from (default: the Diamond)")
    parser.add_argument("--steps", default=1000, type=whole(1), metavar="N",
                        help="a tenth as many factorizations, a fifth as many QPs (default 1000)")
    parser.add_argument("--output", metavar="FOLDER", type=Path,
                        help="write factorizations.csv and qp_solvers.csv there")
    parser.add_argument("--threads", default=1, type=whole(1), metavar="N",
                        help="most threads of the default factorization, and those of MKL (default 1)")
    chosen = parser.parse_args()
    try:
        return compare(chosen.scenes, chosen.steps, chosen.output, chosen.threads)
    except SoftRobotTwinError as error:
        print(f"compare_solvers: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
