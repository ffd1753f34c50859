"""``python -m softrobot_twin choose``: finds the most accurate setting for a rate on this machine.

A setting keeps a rate when the 99th percentile of its step fits into `MARGIN` of the period. Its
expected error is the sum of the mesh's, the reduction's and the linearizations' errors.

Reduced models whose files exist are candidates like full ones; `reduce` trains them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.harness.machine_facts import NUMERICAL_LIBRARIES, describe_machine
from softrobot_twin.harness.study_rows import write_rows
from softrobot_twin.harness.terminal import (
    console,
    print_to_stderr,
    report_activity,
    table,
    warn,
)
from softrobot_twin.harness.timing import RobustTiming
from softrobot_twin.mechanics.element_kinds import HEXAHEDRAL
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.accuracy_study import (
    MESH,
    REDUCED,
    AccuracyError,
    AccuracyRow,
    Limits,
    MeshLevel,
    ReducedModel,
    Setting,
    check_one_body,
    differences,
    follow_exactly,
    follow_lengths,
    given_words,
    hexahedral_family,
    length_path,
    mean_distance,
    mesh_family,
    read_study,
    rounds_of,
    study_meshes,
    with_element,
    with_hold_radius,
    with_law,
    write_scene_copy,
)
from softrobot_twin.study.reduced_models import (
    beside,
    every_level,
    own_file,
    reduced_models,
    reduced_row,
)

STEPS = 120
FIRST_ROUNDS, LAST_ROUNDS = 3, 4
FINALISTS = 3
"""Number of best candidates to time again, and of candidates that are slightly too slow."""
_REFERENCE_STEPS = 25


class SettingClock:
    """Times settings of one scene at one rate; the reference is its own mesh, linear elements.

    Attributes:
        timing: The rounds so far.
    """

    def __init__(self, own: Scene, rate: float, scene_of: Callable[[Setting], Scene]):
        """Builds the reference.

        Args:
            own: The scene on its own mesh.
            rate: Rate to keep [Hz].
            scene_of: Returns the scene of a setting.
        """
        self._rate, self._scene_of = rate, scene_of
        reference = with_element(own, "linear")
        path = length_path(reference, rate, _REFERENCE_STEPS)
        self.timing = RobustTiming(rounds_of(reference, path, 1))

    def measure(self, setting: Setting) -> Measured:
        """Time of a step on this machine, and the linearization error.

        Args:
            setting: Mesh, element, law and number of linearizations.
        """
        steps = self._rounds(setting)
        for _ in range(FIRST_ROUNDS):
            self.timing.add_round(setting, steps)
        times = self.timing.spread(setting)
        if times.p99 > MARGIN / self._rate:
            return Measured(times.median, times.p99, float("nan"))
        scene = self._scene_of(setting)
        path = length_path(scene, self._rate, STEPS)
        exact, start = follow_exactly(scene, path)
        followed = follow_lengths(scene, path, start, setting.iterations)
        displacement = mean_distance(exact - Simulation(scene).effector_positions())
        added = mean_distance(followed.positions - exact) / displacement
        return Measured(times.median, times.p99, added)

    def confirm(self, candidates: list[Candidate]) -> list[Candidate]:
        """Times the best candidates again, in turns, and evaluates all rounds together.

        Args:
            candidates: What was measured.
        """
        ranked = sorted(candidates, key=lambda one: one.error)
        near = [one for one in ranked if one.keeps_rate][:FINALISTS]
        missed = [one for one in ranked if one.measured.p99 <= 1.5 * MARGIN / self._rate
                  and not one.keeps_rate and np.isfinite(one.measured.linearization_error)]
        near += missed[:FINALISTS]
        rounds = {one.setting: self._rounds(one.setting) for one in near}
        for _ in range(LAST_ROUNDS):
            for setting, steps in rounds.items():
                self.timing.add_round(setting, steps)
        return [self._judged(one) for one in candidates]

    def _judged(self, candidate: Candidate) -> Candidate:
        times = self.timing.spread(candidate.setting)
        measured = candidate.measured._replace(median=times.median, p99=times.p99)
        keeps = times.p99 <= MARGIN / self._rate and np.isfinite(measured.linearization_error)
        return candidate._replace(measured=measured, keeps_rate=bool(keeps))

    def _rounds(self, setting: Setting):
        scene = self._scene_of(setting)
        return rounds_of(scene, length_path(scene, self._rate, STEPS), setting.iterations)


MARGIN = 0.7
"""Share of a period for the 99th percentile of a step; the rest is for the node and the system."""
ITERATIONS = (1, 2, 3)
CAUTION = 0.2
"""A choice with a larger error comes with a warning."""
# Further linearizations that reduce the error by less than this share are not used.
_ALIKE = 0.01


class Measured(NamedTuple):
    """Measurement of a setting on this machine, along a path at the requested rate.

    Attributes:
        median: Median time of a step [s].
        p99: Its 99th percentile [s].
        linearization_error: Linearization error relative to the effector's displacement; NaN where
            steps are late, because it is not measured then.
    """

    median: float
    p99: float
    linearization_error: float


class Candidate(NamedTuple):
    """A setting with its expected error and time.

    Attributes:
        setting: The setting.
        mesh_error: Error of mesh, element, law and reduction, displacements prescribed.
        force_error: The same with forces prescribed.
        measured: Time of a step, and linearization error.
        keeps_rate: Whether the 99th percentile of its steps is within the margin.
    """

    setting: Setting
    mesh_error: float
    force_error: float
    measured: Measured
    keeps_rate: bool

    @property
    def error(self) -> float:
        """Expected error relative to the effector's displacement: the sum of both parts."""
        return self.mesh_error + np.nan_to_num(self.measured.linearization_error)


class NoSettingError(SoftRobotTwinError):
    """No setting keeps a rate on this machine.

    Attributes:
        rate: Requested rate [Hz].
        nearest: The fastest setting tried, or None.
    """

    def __init__(self, rate: float, nearest: Candidate | None):
        self.rate, self.nearest = rate, nearest
        reason = "none could be tried"
        if nearest is not None:
            possible = MARGIN / nearest.measured.p99
            reason = (f"the fastest, {_describe_setting(nearest.setting)}, takes "
                    f"{1e3 * nearest.measured.p99:.2f} ms (p99), which keeps {possible:.0f} Hz")
        super().__init__(f"no setting keeps {rate:g} Hz within {MARGIN:g} of its period of "
                         f"{1e3 / rate:.2f} ms on this machine: {reason}")


Measure = Callable[[Setting], Measured]


def _describe_setting(setting: Setting) -> str:
    """A setting as text."""
    plural = "" if setting.iterations == 1 else "s"
    reduced = f"reduced by {setting.reduced}, " if setting.reduced else ""
    return (f"{describe_mesh(setting.mesh, setting.element)}, {setting.law} law, {reduced}"
            f"{setting.iterations} linearization{plural}")


def describe_mesh(mesh: str, element: str) -> str:
    """A mesh and its elements as text.

    Args:
        mesh: Name of the mesh.
        element: Kind of its elements.
    """
    return f"{mesh}, " + ("hexahedra" if element == HEXAHEDRAL else f"{element} tets")


def measure_candidates(rows: Iterable[AccuracyRow], rate: float, measure: Measure) -> list[Candidate]:
    """Times settings, the most accurate mesh first, until no further one can be the best.

    More linearizations are tried only when fewer ones keep the rate.

    Args:
        rows: Errors of meshes, elements and laws, and of reduced models.
        rate: Requested rate [Hz].
        measure: Measures one setting on this machine.
    """
    known = [row for row in rows if np.isfinite(row.error_lengths + row.error_weightless)]
    found: list[Candidate] = []
    for row in sorted(known, key=lambda row: row.error):
        best = min((one.error for one in found if one.keeps_rate), default=np.inf)
        if row.error > best + reference_uncertainty(known):
            break
        for iterations in ITERATIONS:
            setting = Setting(row.mesh, row.element, row.law, iterations, row.file)
            measured = measure(setting)
            keeps = measured.p99 <= MARGIN / rate
            found.append(Candidate(setting, row.error, row.error_tensions, measured, keeps))
            if not keeps:
                break
    return found


def reference_uncertainty(rows: Iterable[AccuracyRow]) -> float:
    """Uncertainty of the reference: smaller differences of errors are not significant.

    Args:
        rows: The rows of a study.
    """
    return max((row.uncertainty for row in rows if np.isfinite(row.uncertainty)), default=0.0)


def check_reference(rows: Iterable[AccuracyRow], scene: str) -> None:
    """Refuses errors whose differences are smaller than the reference's uncertainty.

    Args:
        rows: Errors of meshes, elements and laws.
        scene: Name of the scene, for the error.

    Raises:
        AccuracyError: The reference is too uncertain.
    """
    rows = list(rows)
    errors = [row.error for row in rows if row.law == "corotational" and np.isfinite(row.error)]
    unsure = reference_uncertainty(rows)
    differ = max(errors, default=0.0) - min(errors, default=0.0)
    if unsure > differ:
        raise AccuracyError(scene, f"the reference has an uncertainty of {100.0 * unsure:.2g} %, "
                            f"the errors differ by {100.0 * differ:.2g} %: no setting is known to "
                            "be the best; add a finer mesh to the family")


def accuracy_warnings(
    best: Candidate, words: tuple[str, str] = ("cable lengths", "cable tensions")
) -> list[str]:
    """Warnings about large errors of a choice; empty when there are none.

    Args:
        best: The choice.
        words: What displacements and efforts of the actuators are.
    """
    reason = []
    for error, given in zip((best.error, best.force_error), words, strict=True):
        if not error <= CAUTION:
            share = f"{100.0 * error:.0f} %" if np.isfinite(error) else "an unknown share"
            reason.append(f"CAUTION: for given {given} the error of the effector is {share} "
                        "of its displacement; no setting that keeps the rate is known to be better")
    return reason


def pick(candidates: Iterable[Candidate], rate: float, reference_uncertainty: float = 0.0) -> Candidate:
    """The most accurate candidate that keeps the rate.

    Of meshes whose errors differ by less than the reference's uncertainty, it is the one with the
    least error at prescribed forces; of numbers of linearizations with similar errors, the fastest.

    Args:
        candidates: The measured candidates.
        rate: Requested rate [Hz].
        reference_uncertainty: Smaller differences of errors are ignored.

    Raises:
        NoSettingError: None keeps the rate.
    """
    candidates = list(candidates)
    fitting = [one for one in candidates if one.keeps_rate]
    if not fitting:
        fastest = min(candidates, key=lambda one: one.measured.p99, default=None)
        raise NoSettingError(rate, fastest)
    least = min(one.error for one in fitting)
    margin = max(reference_uncertainty, _ALIKE * least)
    alike = [one for one in fitting if one.error <= least + margin]
    # An unknown error counts as infinite.
    soundest = min(alike, key=lambda one: (np.nan_to_num(one.force_error, nan=np.inf), one.error)).setting
    same = [one for one in alike if one.setting.model == soundest.model]
    least = min(one.error for one in same)
    return min((one for one in same if one.error <= (1.0 + _ALIKE) * least),
               key=lambda one: one.measured.median)


QUICK = Limits(timed_dof=20_000, reference_dof=50_000)
"""Size limits of the study that is made when no file of errors is given."""
# Settings slower than this many periods in the study are not measured again.
_MUCH_TOO_SLOW = 4.0


class Models:
    """The full and reduced models of a robot, by setting.

    Attributes:
        reduced: Reduced models by the names of their files.
    """

    def __init__(self, levels: Sequence[MeshLevel], hexahedra: Sequence[MeshLevel]):
        """Take the meshes, those of tetrahedra and those of hexahedra."""
        self._by_name = {level.name: level for level in [*levels, *hexahedra]}
        self.every = every_level(levels, hexahedra)
        self.reduced: dict[str, ReducedModel] = {}

    def __contains__(self, mesh: str) -> bool:
        return mesh in self._by_name

    def add(self, model: ReducedModel) -> None:
        """Add a reduced model; of two files with one name the first is kept.

        Args:
            model: The reduced model.
        """
        if self.reduced.setdefault(model.path.name, model) is not model:
            warn(f"{model.path} is left out: {self.reduced[model.path.name].path} has the same name")

    def scene(self, setting: Setting) -> Scene:
        """The scene of a setting.

        Args:
            setting: Mesh, element and law, or a reduced model.
        """
        if setting.reduced:
            return self.reduced[setting.reduced].scene
        scene = self._by_name[setting.mesh].scene
        return with_law(with_element(scene, setting.element), setting.law)

    def rows(self, known: Sequence[AccuracyRow]) -> list[AccuracyRow]:
        """Rows of the reduced models: measured by ``accuracy``, or measured beside full ones now.

        Args:
            known: Rows of full models, and of reduced ones that ``accuracy`` measured.
        """
        made = [self._row(model, known) for model in self.reduced.values()]
        return [row for row in made if row is not None]

    def _row(self, model: ReducedModel, known: Sequence[AccuracyRow]) -> AccuracyRow | None:
        body = model.level.scene.body
        name = model.level.name, body.element, body.material.law
        own = (model.path.name, model.mode_count, model.point_count)
        same = [row for row in known if (row.mesh, row.element, row.law) == name]
        for row in same:
            if row.knob == REDUCED and (row.file, row.mode_count, row.point_count) == own:
                return row
        full = next((row for row in same if row.knob == MESH), None)
        if full is None:
            warn(f"{model.path.name} is left out: the error of {describe_mesh(*name[:2])} is not known")
            return None
        report_activity(f"{model.path.name} beside its full model")
        added = differences(model.level.scene, model.scene)
        if not np.isfinite(added.moved):
            warn(f"{model.path.name} is left out: in the poses of the study it, or its full model, has "
                 "no equilibrium")  # fmt: skip
            return None
        return reduced_row(full, model, added)


def choose(
    scene_path: Path, rate: float, accuracy_file: Path | None = None, write: Path | None = None,
    measure: Callable[[Scene, float, int], Measured] | None = None, reduced: Sequence[Path] = (),
) -> int:  # fmt: skip
    """Times the candidates, prints the best one and writes its scene.

    Args:
        scene_path: Scene file.
        rate: Rate to keep [Hz].
        accuracy_file: File of ``accuracy``; a quick study writes it where it does not exist.
        write: Scene file to write; ``<name>_<rate>hz.yaml`` in the working folder when None.
        measure: Measures a scene at a rate with a number of linearizations; a clock when None.
        reduced: Files of reduced models, beside that of the scene and those beside its mesh and
            beside the scene that is written.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene cannot be used, no setting keeps the rate, or a file cannot
            be written.
    """
    scene = load_scene(scene_path)
    check_one_body(scene)
    write = write or Path(f"{scene.name}_{rate:g}hz.yaml")
    named = own_file(scene)
    if named is not None and not named.is_file():
        warn(f"{scene_path}: its reduced model {named} is not there, so it is no candidate")
        named = None
    scene = without_reductions(scene)
    held = with_hold_radius(scene)
    levels = mesh_family(held, write.resolve().parent / f"{write.stem}_meshes")
    hexahedra = hexahedral_family(held)
    models = Models(levels, hexahedra)
    found = beside(held.mesh_folder(held.body).resolve(), write.resolve().parent)
    given = [file for file in (named, *reduced) if file is not None]
    for model in reduced_models(given, found, models.every):
        models.add(model)
    known = _rows(levels, hexahedra, accuracy_file)
    check_reference([row for row in known if row.knob == MESH], scene.name)
    known = [row for row in known if row.mesh in models]
    clock = None if measure is not None else SettingClock(held, rate, models.scene)

    def measure_setting(setting: Setting) -> Measured:
        report_activity(_describe_setting(setting))
        if clock is not None:
            return clock.measure(setting)
        return measure(models.scene(setting), rate, setting.iterations)

    full = [row for row in known if row.knob == MESH]
    rows = [row for row in full if row.step_ms < _MUCH_TOO_SLOW * 1e3 / rate] + models.rows(known)
    unsure = reference_uncertainty(full)
    candidates = measure_candidates(rows, rate, measure_setting)
    if clock is not None:
        report_activity("the best candidates again, in turns")
        candidates = clock.confirm(candidates)
    shown = console()
    best = pick(candidates, rate, unsure)
    chosen = models.scene(best.setting)
    words = given_words(scene)
    warned = accuracy_warnings(best, words)
    remarks = [*_remarks(best, rows, rate, scene_path, words), *warned]
    if clock is not None:
        remarks.append("Times are those of a machine without other programs; this one was "
                       f"{clock.timing.slowdown:.2f} times slower in the median round of the timing.")
    write_scene_copy(write, chosen, best.setting, remarks)
    load_scene(write)  # checks the written file
    shown.print(_table(candidates, best, rate))
    for line in remarks[1:]:
        if line not in warned:
            shown.print(line)
    for line in warned:
        warn(line)
    shown.print(f"written: {write}")
    return 0


def _rows(levels: list[MeshLevel], hexahedra: list[MeshLevel], file: Path | None) -> list[AccuracyRow]:
    """Errors by setting: read from the file, or studied now and written to it."""
    if file is not None and file.exists():
        known = {level.name for level in levels}
        rows = read_study(file)
        if not any(row.mesh in known for row in rows):
            raise AccuracyError(str(file), "contains none of the meshes of this scene: "
                                + ", ".join(sorted(known)))
        _check_mesh_sizes(file, rows, levels)
        return rows
    print_to_stderr(f"the errors of these {len(levels)} meshes are not known: a study takes minutes; then the "
                    "candidates are timed. --accuracy FILE stores the errors")
    rows = study_meshes(levels, QUICK, hexahedra).rows
    if file is not None:
        write_rows(file, rows)
    return rows


def _check_mesh_sizes(file: Path, rows: list[AccuracyRow], levels: list[MeshLevel]) -> None:
    """Refuses errors of other meshes with the same names."""
    nodes = {level.name: level.node_count for level in levels}
    for row in rows:
        if (row.knob, row.element) != (MESH, "linear"):
            continue
        if row.node_count != nodes.get(row.mesh, row.node_count):
            raise AccuracyError(str(file), f"is of another mesh {row.mesh}: that one has "
                                f"{row.node_count} nodes, this scene's has {nodes[row.mesh]}")


def _remarks(
    best: Candidate, rows: list[AccuracyRow], rate: float, original: Path, words: tuple[str, str]
) -> list[str]:
    """What was chosen, what to expect, and why."""
    measured, (moved, pressed) = best.measured, words
    row = next(row for row in rows
               if (row.mesh, row.element, row.law, row.file) == best.setting.model)
    causes = "mesh, element, law and reduction" if row.file else "mesh, element and law"
    advice = f": command {moved} where possible" if row.error < row.error_tensions else ""
    return [
        f"Made from {original.name} by 'choose' for {rate:g} Hz on "
        f"{describe_machine(NUMERICAL_LIBRARIES)}",
        f"{_describe_setting(best.setting)}: p99 {1e3 * measured.p99:.2f} ms of a period of "
        f"{1e3 / rate:.2f} ms; at most {MARGIN:g} of the period is allowed.",
        f"Expected error of the effector for given {moved}: {100 * best.error:.2f} % of its "
        f"displacement ({row.displacement_mm * best.error:.2f} mm of {row.displacement_mm:.1f} mm)"
        f": {100 * best.mesh_error:.2f} % by {causes}, "
        f"{100 * measured.linearization_error:.2g} % by the linearizations; the uncertainty of the "
        f"reference is {100 * row.uncertainty:.2f} %.",
        f"For given {pressed} the same model has an error of {100 * row.error_tensions:.1f} %"
        f"{advice}.",
    ]


def _table(candidates: list[Candidate], best: Candidate, rate: float):
    lines = []
    for one in candidates:
        mark = "yes: chosen" if one is best else "yes" if one.keeps_rate else "no"
        lines.append((one.error, _describe_setting(one.setting), one.measured, mark))
    return table(
        f"Candidates for {rate:g} Hz, the most accurate first", "setting", "median [ms]",
        "p99 [ms]", "error [%]", f"within {MARGIN:g} of the period",
        rows=([name, f"{1e3 * measured.median:.2f}", f"{1e3 * measured.p99:.2f}",
               f"{100 * error:.2f}", mark]
              for error, name, measured, mark in sorted(lines, key=lambda line: line[0])))
