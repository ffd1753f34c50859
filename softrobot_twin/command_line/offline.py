"""``simulate`` and ``explain``: a scene run from a file, and said in words."""

from __future__ import annotations

import argparse
from pathlib import Path

from softrobot_twin.command_line.arguments import (
    OptionError,
    add_command,
    add_scene,
    count,
    duration,
    positive_count,
    rate,
    refuse,
)


MOST_STEPS = 10_000_000
"""A run that nobody commands is no longer than this."""


def add_simulate(commands) -> None:
    """Declares ``simulate``."""
    parser = add_command(
        commands, "simulate", _simulate, "run a scene offline, without ROS",
        "Run a scene over a targets file, row by row; over a commands file, at a fixed rate; or "
        "left to itself, for some seconds or steps: cables hold, bodies sag and fall. "
        "Columns of a targets file: t,<effector>.x,<effector>.y,<effector>.z [s, m] for the "
        "inverse problem, t,<actuator>.length [m] or t,<actuator>.tension [N] for a direct run. "
        "A row's time step is its distance from the row before; the first row takes the second's, and a single row "
        "0.02 s. Columns of a commands file: time_s, <cable>_shortening_m, <cable>_length_m or "
        "<cable>_tension_N, <motor>_shortening_m for all its cables, <guided body>_x_m, _y_m, "
        "_z_m and, if it turns, _qx, _qy, _qz, _qw; evenly from row to row.")
    add_scene(parser)
    driven = parser.add_mutually_exclusive_group(required=True)
    driven.add_argument("--targets", metavar="FILE.csv", type=Path,
                        help="what to follow, row by row")
    driven.add_argument("--commands", metavar="FILE.csv", type=Path,
                        help="what cables, motors and guided bodies do, over time")
    driven.add_argument("--seconds", metavar="S", type=duration,
                        help="leave it to itself for so long [s]")
    driven.add_argument("--steps", metavar="N", type=positive_count,
                        help="leave it to itself for so many steps")
    parser.add_argument("--output", required=True, metavar="FILE.csv", type=Path,
                        help="where to write the run, one row a step")
    parser.add_argument("--settle", type=count, metavar="N",
                        help="with --targets: run the first row N times before recording "
                        "(default 0)")
    parser.add_argument("--rate", type=rate, metavar="HZ",
                        help="steps a second (default 250); not with --targets")
    parser.add_argument("--picture", metavar="FILE.png", type=Path,
                        help="draw the last state (needs matplotlib)")
    parser.add_argument("--picture-at", nargs="+", type=float, metavar="S",
                        help="draw these times [s] side by side instead; not with --targets")
    parser.add_argument("--picture-view", nargs=2, type=float, metavar=("ELEVATION", "AZIMUTH"),
                        help="where the eye is [degrees] (default 24 -58); not with --targets")


def add_explain(commands) -> None:
    """Declares ``explain``."""
    parser = add_command(
        commands, "explain", _explain, "show what a scene calls for and what that makes",
        "Print the effects a scene names, the terms they become, the stages of a "
        "step, the size of the mesh, and an estimate of its error.")
    add_scene(parser)
    parser.add_argument("--no-mesh-error", dest="mesh_error", action="store_false",
                        help="leave out that estimate, which takes longer than all the rest")


def _simulate(chosen: argparse.Namespace) -> int:
    _check_outputs(chosen)
    if chosen.targets is not None:
        refuse(chosen, "--commands", "rate", "picture_at", "picture_view")
        from softrobot_twin.study.offline.simulate_command import simulate
        return simulate(chosen.scene, chosen.targets, chosen.output, chosen.settle or 0,
                        chosen.picture)
    refuse(chosen, "--targets", "settle")
    if chosen.picture is None:
        refuse(chosen, "--picture", "picture_at", "picture_view")
    from softrobot_twin.study.offline.direct_command import (
        DEFAULT_RATE,
        Picture,
        simulate_alone,
        simulate_commands,
    )
    picture = None if chosen.picture is None else Picture(
        chosen.picture, tuple(chosen.picture_at or ()),
        chosen.picture_view and tuple(chosen.picture_view))
    steps_a_second = chosen.rate or DEFAULT_RATE
    if chosen.commands is not None:
        return simulate_commands(chosen.scene, chosen.commands, chosen.output, steps_a_second,
                                 picture)
    seconds = chosen.seconds or chosen.steps / steps_a_second
    if seconds * steps_a_second > MOST_STEPS:
        option = "--seconds" if chosen.seconds else "--steps"
        raise OptionError(option, f"makes more than {MOST_STEPS:,} steps at {steps_a_second:g} Hz")
    return simulate_alone(chosen.scene, seconds, chosen.output, steps_a_second, picture)


def _check_outputs(chosen: argparse.Namespace) -> None:
    """Refuses to write over what is read, or twice to one place."""
    taken = {str(path.resolve()): path
             for path in (chosen.scene, chosen.targets, chosen.commands) if path is not None}
    for option in ("output", "picture"):
        path = getattr(chosen, option)
        if path is None:
            continue
        try:
            if path.exists() and not path.is_file():  # a device takes anything
                continue
        except OSError as error:
            raise OptionError(f"--{option}", error.strerror or str(error)) from error
        if str(path.resolve()) in taken:
            raise OptionError(f"--{option}", f"{path} would overwrite {taken[str(path.resolve())]}")
        taken[str(path.resolve())] = path


def _explain(chosen: argparse.Namespace) -> int:
    from softrobot_twin.study.offline.explain_command import explain
    return explain(chosen.scene, chosen.mesh_error)
