"""Times of the package's robots and of sizes from 500 to 50,000 unknowns, beside what was published.

`python tools/bench_robots.py [--steps N] [--output FOLDER] [--compare FILE.csv]` prints the tables of
`bench`, what Python and the twin add to a step, whether each requirement is met, and how near the
factorization is to the speed of dense products; it writes bench.csv and bench.png into a folder.
docs/bench.csv is made by it. With `--compare` it marks what got slower, or makes more calls, than in an
earlier bench.csv.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from time import thread_time
from typing import NamedTuple

import numpy as np
from rich.table import Table
from scipy.interpolate import interp1d

from softrobot_twin.command_line.commands import whole
from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.figure import figure_file
from softrobot_twin.harness.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.harness.output_file import make_folder
from softrobot_twin.harness.study_rows import write_rows
from softrobot_twin.harness.terminal import by_key, console, table
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.actuator_entries import Cable
from softrobot_twin.scene.body_entries import Body, BoxMesh, BoxRegion, Mesh, Region
from softrobot_twin.scene.scene_changes import with_mesh_file
from softrobot_twin.scene.schema import Effector
from softrobot_twin.simulation import FollowTargets, Hold, Simulation
from softrobot_twin.simulation.command import Command
from softrobot_twin.solvers.dense_stiffness import without_rows
from softrobot_twin.solvers.factorization import Factorization
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.multifrontal.condensation import ConstraintColumns
from softrobot_twin.solvers.multifrontal.symbolic import NONE
from softrobot_twin.study.bench import bench_rows, measure_all, print_sizes
from softrobot_twin.study.bench_measurement import (
    OUTSIDE,
    WHOLE_STEP,
    BenchCase,
    circle_targets,
    default_scene_path,
    held_commands,
    swept_setpoints,
)
from softrobot_twin.tables.input_tables import read_targets
from step_overhead import compared, overhead_of, overhead_table, read_earlier
from superlu_reference import SUPERLU, BesideSuperLU, beside_superlu


INTERVAL_TIME_STEP = 0.02
"""Time between two targets [s]."""
_SETTLING_STEPS = 40


class FileInterval(NamedTuple):
    """A time interval of a targets file.

    Attributes:
        path: The file.
        begin: Start of the interval [s].
        end: End of the interval [s].
    """

    path: Path
    begin: float
    end: float


def interval_targets(simulation: Simulation, interval: FileInterval) -> Iterator[FollowTargets]:
    """Targets of an interval, followed forwards and backwards for any number of steps.

    Follows the file up to the interval; these steps are not timed.

    Args:
        simulation: At rest.
        interval: The interval of the file.

    Raises:
        TableFileError: The file does not fit the scene.
    """
    table = read_targets(interval.path, simulation)
    between_rows = interp1d(table.times, table.values, axis=0)

    def command(time: float) -> FollowTargets:
        return FollowTargets(between_rows(time), INTERVAL_TIME_STEP)

    for _ in range(_SETTLING_STEPS):
        simulation.step(Hold(INTERVAL_TIME_STEP))
    for time in np.arange(table.times[0], interval.begin, INTERVAL_TIME_STEP):
        simulation.step(command(time))
    times = np.arange(interval.begin, interval.end, INTERVAL_TIME_STEP)
    return map(command, cycle([*times[1:], *times[-2::-1]]))


_REFINEMENTS = (400, 600, 1600, 4500, 15000)
# The Diamond has no good mesh of 500 dof, because its struts are thin, and its finest mesh has less
# than 50 000 dof. A column of the same material, 30 × 30 × 200 mm, is used for both sizes.
_COLUMN_SIZE = (0.030, 0.030, 0.200)
_COLUMN_CELLS = ((2, 2, 18), (12, 12, 98))
# Heights of the column's cable points, as shares of its length.
_CABLE_HOLDS = (0.25, 0.5, 0.75, 0.9)


class Paper(NamedTuple):
    """Published values of a robot (Coevoet 2017, table 1).

    Attributes:
        dof: Unknowns of its mesh.
        step: Time of a step, contact included [s].
        source: Origin of the time, for messages.
        required: Longest allowed step [s]; a share of the published one when None.
    """

    dof: int
    step: float
    source: str = "the paper's"
    required: float | None = None


_BEST = "its C++ code's best"
PAPERS = {
    "grasper": Paper(1422, 5.0e-3),
    "octoleg": Paper(360, 1.7e-3),
    "trunk_700": Paper(2100, 4.5e-3, _BEST),
    "trunk_900": Paper(4995, 29.0e-3),
    "springy": Paper(4596, 19.7e-3, _BEST, required=4.0e-3),
    "pneunet_inverse": Paper(3642, 8.5e-3, _BEST, required=2.0e-3),
    # Reduced to two vertebrae, which the paper's step is of.
    "fetch_reduced": Paper(12, 7.5e-3, required=0.25e-3),
    "flexo": Paper(912, 4.5e-3, required=0.4e-3),
    "stifface": Paper(2285, 30.0e-3, required=3.0e-3),
    # Published for the Diamond in the C++ framework: 32 modes and hyper-reduction.
    "diamond_reduced": Paper(32, 4.6e-3, "the published reduction's", required=0.3e-3),
}


def robot_cases() -> list[BenchCase]:
    """The robots of the package that have figures of the paper, or are driven in their own way."""
    folder = default_scene_path().parent

    def case(name: str, drive: Callable[[Simulation], Iterator[Command]] = circle_targets) -> BenchCase:
        return BenchCase(name, load_scene(folder / f"{name}.yaml"), drive)

    def held(commands: str) -> Callable[[Simulation], Iterator[Command]]:
        return partial(held_commands, path=folder.parent / "commands" / commands)

    def along(targets: str, begin: float, end: float) -> Callable[[Simulation], Iterator[Command]]:
        return partial(interval_targets, interval=FileInterval(folder.parent / "targets" / targets, begin, end))

    # It touches a cylinder in this interval.
    trunk = case("trunk_cylinders", along("trunk_path.csv", 5.6, 8.3))
    small = with_mesh_file(trunk.scene, trunk.scene.mesh_path.with_name("trunk_700.vtk"))
    # The paper's small mesh, with one obstacle.
    small = small.changed(
        obstacles=small.obstacles[:1], contact={"between": small.contact.between[:1]})
    reduced = case("diamond_reduced")
    return [
        case("grasper", held("grasper_lift.csv")),
        case("octoleg", held("octoleg_curl.csv")),
        trunk._replace(name="trunk_700", scene=small),
        trunk._replace(name="trunk_900"),
        case("springy", swept_setpoints),
        # Its tips close and open in this interval.
        case("pneunet_inverse", along("pneunet_tips.csv", 0.5, 11.5)),
        case("fetch"),
        case("fetch_reduced"),
        case("cantilever", swept_setpoints),
        case("flexo", along("flexo_circle.csv", 4.0, 12.0)),
        case("stifface"),
        reduced._replace(name="diamond_quadratic", scene=reduced.scene.changed(body={"reduced": None})),
        reduced,
    ]


def standard_cases() -> list[BenchCase]:
    """Sizes from 500 to 50 000 dof, the smallest first."""
    path = default_scene_path()
    diamond = load_scene(path)
    meshes = diamond.mesh_path.parent
    diamonds = [
        BenchCase(f"diamond_{nodes}", with_mesh_file(diamond, meshes / f"diamond_{nodes}.vtk"),
                  circle_targets)
        for nodes in _REFINEMENTS
    ]
    small, large = (_column_case(diamond, cells) for cells in _COLUMN_CELLS)
    return [small, *diamonds, large, *robot_cases()]


def _column_case(diamond: Scene, cells: tuple[int, int, int]) -> BenchCase:
    """A hanging column with four cables inside it, halfway between its axis and its sides."""
    half, length = 0.5 * _COLUMN_SIZE[0], _COLUMN_SIZE[2]
    top = Region(box=BoxRegion(minimum=(-1.1 * half, -1.1 * half, -1e-6),
                               maximum=(1.1 * half, 1.1 * half, 1e-6)))
    out = 0.5 * half
    places = {"north": (0.0, out), "west": (-out, 0.0), "south": (0.0, -out), "east": (out, 0.0)}
    typical = diamond.cables[0]
    cables = tuple(
        Cable(name=side, pull_point=(x, y, 0.02),
              points=tuple((x, y, -share * length) for share in _CABLE_HOLDS),
              shortening=(0.0, 0.012), rate=typical.rate, tension=typical.tension)
        for side, (x, y) in places.items()
    )
    scene = diamond.model_copy(update={
        "name": "column", "markers": (), "cables": cables,
        "body": Body(mesh=Mesh(box=BoxMesh(size=_COLUMN_SIZE, cells=cells),
                               translation=(-half, -half, -length)),
                     element="linear", material=diamond.body.material, fixed=(top,)),
        "effectors": (Effector(name="tip", points=((0.0, 0.0, -length),)),),
    })
    return BenchCase("column_" + "x".join(map(str, cells)), scene, circle_targets)


class FlopCount(NamedTuple):
    """Number of floating-point operations.

    Attributes:
        factor: Of the numeric factorization.
        solves: Of Y = L⁻¹Hᵀ, y = L⁻¹b, W = YᵀY, and the solve back.
    """

    factor: float
    solves: float


def flop_count(factorization: Factorization, row_nodes: np.ndarray, row_count: int) -> FlopCount | None:
    """Counts operations, including those on zeros inside fronts.

    Args:
        factorization: The factorization.
        row_nodes: Free nodes that rows H touch.
        row_count: Rows of H.

    Returns:
        The counts; None for a factorization that has no fronts to count on.
    """
    if not isinstance(factorization, Multifrontal):
        return None
    fronts = factorization.layout.fronts
    rows, columns = fronts["rows"].astype(float), fronts["columns"].astype(float)
    # A column of height h costs h²: a root, h - 1 quotients, and h (h - 1) for the rest.
    factor = float(np.sum(_squares(rows) - _squares(rows - columns)))
    entries = _heights(rows) - _heights(rows - columns)
    reach = ConstraintColumns(factorization.elimination)
    reach.most_sizes(factorization.elimination_rank[row_nodes], row_count)
    reached = reach.places[fronts["first_rank"]] != NONE
    # An entry of L is a multiplication and an addition for every right-hand side.
    forward = 2.0 * (row_count * entries[reached].sum() + entries.sum())
    gram = (row_count + 1) * (row_count + 2) * reach.trees["dof_count"].sum()
    return FlopCount(factor, float(forward + gram + 2.0 * entries.sum()))


def _squares(n: np.ndarray) -> np.ndarray:
    """1² + 2² + … + n²."""
    return n * (n + 1.0) * (2.0 * n + 1.0) / 6.0


def _heights(n: np.ndarray) -> np.ndarray:
    """1 + 2 + … + n."""
    return 0.5 * n * (n + 1.0)


DENSE_SIZE = 512


class DenseSpeed:
    """Times products of two square matrices in double precision."""

    def __init__(self) -> None:
        generator = np.random.default_rng(1)
        self._a, self._b = generator.standard_normal((2, DENSE_SIZE, DENSE_SIZE))
        self._c = np.empty((DENSE_SIZE, DENSE_SIZE))

    def measure(self) -> float:
        """Speed of one product, after another one that fills the caches [flop/s].

        It is measured in processor time, which does not include other processes.
        """
        np.matmul(self._a, self._b, out=self._c)
        start = thread_time()
        np.matmul(self._a, self._b, out=self._c)
        return 2.0 * DENSE_SIZE**3 / (thread_time() - start)


REQUIRED_RATIO = 0.16
"""Longest allowed step on the default Diamond, in SuperLU factorizations."""
PAPER_FACTOR = 4.0
"""Least allowed ratio of the paper's time of a step to ours."""
REQUIRED_TAIL = 1.5
"""Upper bound for the 99th percentile of a step over its median."""
REQUIRED_REDUCED_TAIL = 1.3
"""The same for a reduced model, whose bar counts the largest allowed value."""


def requirements(size: BesideSuperLU) -> Iterator[tuple[str, bool, str]]:
    """What is required of a step: the requirement, whether it is met, and what was measured.

    Args:
        size: What was measured of a case.
    """
    step, paper = size.stages[WHOLE_STEP], PAPERS.get(size.case.name)
    if size.case.name == load_scene(default_scene_path()).mesh_path.stem:
        yield (f"{REQUIRED_RATIO} SuperLU factorizations", size.ratio <= REQUIRED_RATIO,
               f"{size.ratio:.3f}, {1e3 * step.median:.3f} ms")
        yield f"p99 < {REQUIRED_TAIL} × median", size.tail < REQUIRED_TAIL, f"{size.tail:.2f}"
    if size.is_reduced:
        yield (f"p99 <= {REQUIRED_REDUCED_TAIL} × median", size.tail <= REQUIRED_REDUCED_TAIL,
               f"{size.tail:.2f}")
    if paper is not None:
        required = paper.step / PAPER_FACTOR if paper.required is None else paper.required
        yield (f"{1e3 * required:.3g} ms", step.median <= required,
               f"{1e3 * step.median:.3f} ms with {size.dof_count} dof; {paper.source} {1e3 * paper.step:.3g} ms "
               f"with {paper.dof}, on another machine")


def print_requirements(sizes: Sequence[BesideSuperLU]) -> None:
    """Prints whether each requirement is met, and the share of steps that were interrupted.

    Args:
        sizes: What was measured.
    """
    console().print(table(
        "Requirements", "case", "required", "", "measured", "steps interrupted",
        rows=([size.case.name, wanted, "met" if is_met else "not met", found,
               f"{100.0 * size.interrupted_share:.1f} %"]
              for size in sizes for wanted, is_met, found in requirements(size))))


# Stages of factorization and solves, to be compared with the speed of dense products.
_ALGEBRA = ("factor", "condense", "correct")


def print_operations(sizes: Sequence[BesideSuperLU]) -> None:
    """Prints the operations of factor and solves, and the share of the speed of dense products reached.

    Args:
        sizes: What was measured.
    """
    speed, rows = DenseSpeed().measure(), []
    for size in sizes:
        model = Simulation(size.case.scene, with_warnings=False).model
        flops = flop_count(without_rows(model.factorization), model.rows.node_index, round(size.row_count))
        if flops is not None:
            share = sum(flops) / speed / sum(size.stages[stage].median for stage in _ALGEBRA)
            rows.append([size.case.name, *(f"{1e-6 * one:.2f}" for one in flops), f"{share:.2f}"])
    console().print(table(
        f"Operations, Mflop; a dense product reaches {1e-9 * speed:.1f} Gflop/s", "case", "factor", "solves",
        "share of dgemm speed", rows=rows))


# SOFA 25.06 with SoftRobots.Inverse, built with -O3 -march=native, on the original Diamond's mesh
# of 1628 nodes: a step in SuperLU factorizations of the same matrix.
SOFA_RATIOS = {"SOFA as shipped": 1.37, "SOFA, best tuning": 0.78}
_STAGE_COLOURS = ("#5f5aa2", "#d95f02", "#3a8f5c", "#a03b76", "#c79a00", "#7a5230", "#9a9a9a",
                  "#4db3c8")
# Families of one or two sizes are drawn as points with different shapes.
_MARKERS = "Dsv^P*"
_STEP_COLOUR = "#1b6ca8"
_SUPERLU_COLOUR = "#222222"


def growth_exponent(sizes, times) -> float:
    """Slope of a straight line through (log size, log time), by least squares.

    Args:
        sizes: Sizes, above zero, shape (count,).
        times: Times, same shape; points without a positive time are left out.

    Returns:
        The exponent; NaN when fewer than two different sizes are left.
    """
    sizes, times = np.asarray(sizes, dtype=float), np.asarray(times, dtype=float)
    known = np.isfinite(times) & (times > 0.0)
    x, y = np.log(sizes[known]), np.log(times[known])
    return float(np.polyfit(x, y, 1)[0]) if len(np.unique(x)) > 1 else float("nan")


def _families_of(sizes: Sequence[BesideSuperLU]) -> dict[str, list[BesideSuperLU]]:
    """Sizes by family, whose scenes differ in the mesh only, in their order."""
    return by_key((re.sub(r"_\d[\dx]*$", "", size.case.name), size) for size in sizes)


def _stage_names(sizes: Sequence[BesideSuperLU]) -> list[str]:
    """All stages in their order, then the time outside them, then the whole step."""
    inner = dict.fromkeys(name for size in sizes for name in size.stages)
    return [name for name in inner if name not in (OUTSIDE, WHOLE_STEP)] + [OUTSIDE, WHOLE_STEP]


def _growth_table(sizes: Sequence[BesideSuperLU]) -> Table | None:
    """Exponent of each stage over each family; None when no family has two sizes."""
    families = {family: members for family, members in _families_of(sizes).items()
                if len({size.dof_count for size in members}) > 1}
    if not families:
        return None
    return table("Growth: time ~ dof^p, p fitted to medians", "stage", *(
        f"{family} ({len(members)} sizes)" for family, members in families.items()),
        rows=([stage, *(f"{exponent(members, stage):.2f}" for members in families.values())]
              for stage in (*_stage_names(sizes), SUPERLU)))


def exponent(sizes: Sequence[BesideSuperLU], stage: str) -> float:
    """Growth exponent of one stage's median over sizes.

    Args:
        sizes: What was measured, of one family.
        stage: Name of the stage.
    """
    return growth_exponent([size.dof_count for size in sizes], _medians(sizes, stage))


def _medians(sizes: Sequence[BesideSuperLU], stage: str) -> list[float]:
    """Median of a stage of each size [s]; NaN where a size does not have this stage."""
    return [size.times[stage].median if stage in size.times else np.nan for size in sizes]


def draw_bench(path: Path, sizes: Sequence[BesideSuperLU], conditions: str) -> None:
    """Draws all sizes and writes the picture.

    Args:
        path: Picture to write; its suffix determines the format.
        sizes: Measured sizes.
        conditions: Machine and versions, for the bottom of the picture.

    Raises:
        MissingExtraError: matplotlib is not installed.
        OutputError: The picture cannot be written.
    """
    with figure_file(path, (13.0, 6.0), "Time of a step", conditions) as figure:
        left, right = figure.subplots(1, 2)
        _draw_stages(left, sizes)
        _draw_ratios(right, sizes)


def _draw_stages(axes, sizes: Sequence[BesideSuperLU]) -> None:
    """Medians of each stage, one line for each family of meshes."""
    inner = list(dict.fromkeys(name for size in sizes for name in size.stages if name != WHOLE_STEP))
    colours = dict(zip(inner, _STAGE_COLOURS * 2))
    colours |= {WHOLE_STEP: _STEP_COLOUR, SUPERLU: _SUPERLU_COLOUR}
    families = _families_of(sizes)
    longest = max(families.values(), key=len)
    for members, style in zip(families.values(), _styles(families), strict=True):
        ordered = sorted(members, key=lambda size: size.dof_count)
        dofs = [size.dof_count for size in ordered]
        for stage, colour in colours.items():
            # Not every family has every stage: only scenes with contact have the stage detect.
            times = 1e3 * np.array(_medians(ordered, stage))
            growth = "" if stage == SUPERLU else _growth_label(longest, stage)
            thick = stage == WHOLE_STEP
            axes.plot(dofs, times, style, color=colour, markersize=5 if thick else 3.5,
                      linewidth=2.2 if thick else 1.2, zorder=3 if thick else 2,
                      label=f"{stage}{growth}" if members is longest else None)
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom", ylabel="median time [ms]",
             title="Time of each stage" + _families_label(families))
    axes.legend(loc="upper left", fontsize=8)


def _draw_ratios(axes, sizes: Sequence[BesideSuperLU]) -> None:
    """Median and 99th percentile of the whole step, in SuperLU factorizations.

    Reduced models, of which none is factorized, are left out.
    """
    families = _families_of([size for size in sizes if size.superlu_count])
    for (family, members), style in zip(families.items(), _styles(families), strict=True):
        ordered = sorted(members, key=lambda size: size.dof_count)
        dofs = [size.dof_count for size in ordered]
        axes.plot(dofs, [size.ratio for size in ordered], style, color=_STEP_COLOUR,
                  linewidth=2.2, markersize=5, label=f"whole step, median, {family}")
        axes.plot(dofs, [size.ratio * size.tail for size in ordered], "_", color=_STEP_COLOUR,
                  markersize=11, label=f"99th percentile, {family}")
    lines = [(f"{name}, original Diamond", ratio, "#a03b76") for name, ratio in SOFA_RATIOS.items()]
    lines.append(("required of the default Diamond", REQUIRED_RATIO, "#3a8f5c"))
    for text, ratio, colour in lines:
        axes.axhline(ratio, color=colour, linewidth=1.1, linestyle=(0, (4, 2)))
        axes.annotate(f"{text}: {ratio}", (1.0, ratio), (-4, 3),
                      xycoords=("axes fraction", "data"), textcoords="offset points",
                      ha="right", fontsize=8, color=colour)
    axes.set(xscale="log", yscale="log", xlabel="degrees of freedom",
             ylabel="whole step / one SuperLU factorization",
             title="Whole step against SuperLU on the same matrices, lower is faster")
    if families:
        axes.legend(loc="lower left", fontsize=8)


def _styles(families: dict[str, list[BesideSuperLU]]) -> list[str]:
    """Line styles: a line for each family of more than two sizes, points for the others."""
    shapes = cycle(_MARKERS)
    return ["o-" if len(members) > 2 else next(shapes) for members in families.values()]


def _growth_label(sizes: Sequence[BesideSuperLU], stage: str) -> str:
    growth = exponent(sizes, stage)
    if len(sizes) < 3 or not np.isfinite(growth):
        return ""
    return f" ~ dof^{growth:.2f}"


def _families_label(families: dict[str, list[BesideSuperLU]]) -> str:
    lines = [family for family, members in families.items() if len(members) > 2]
    points = [family for family, members in families.items() if len(members) <= 2]
    if not lines or not points:
        return ""
    return f" (lines: {', '.join(lines)}; points: {', '.join(points)})"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures all cases."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=whole(1), default=1000, metavar="N")
    parser.add_argument("--output", type=Path, metavar="FOLDER")
    parser.add_argument("--compare", type=Path, metavar="FILE.csv")
    given = parser.parse_args(arguments)
    try:
        if given.output is not None:
            make_folder(given.output)
        earlier = {} if given.compare is None else read_earlier(given.compare)
        cases = standard_cases()
        sizes = [beside_superlu(size) for case in cases for size in measure_all([case], given.steps)]
        added = {case.name: overhead_of(case) for case in cases}
        conditions = describe_machine(NUMERICAL_LIBRARIES)
        console().print(conditions + "\n")
        print_sizes(sizes)
        console().print(overhead_table(added))
        if earlier:
            console().print(compared(sizes, added, earlier))
        if (growth := _growth_table(sizes)) is not None:
            console().print(growth)
        print_requirements(sizes)
        print_operations(sizes)
        if given.output is not None:
            own = {size.case.name: size for size in sizes}
            write_rows(given.output / "bench.csv",
                       [row | own[row["scene"]].columns(row["stage"]) | added[row["scene"]].columns
                        for row in bench_rows(sizes)])
            draw_bench(given.output / "bench.png", sizes, conditions)
    except SoftRobotTwinError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
