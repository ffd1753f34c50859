"""What the commands have in common: how one is declared, and the values an argument may have."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from softrobot_twin.errors import SoftRobotTwinError

EXIT_CODES = """exit codes: 0 done, 1 done but a row, a process or a check failed, 2 the input or
an argument cannot be used, 130 stopped by Ctrl-C"""


class OptionError(SoftRobotTwinError):
    """An option was given that does nothing here."""

    def __init__(self, option: str, reason: str):
        super().__init__(f"{option}: {reason}")


def add_command(
    commands, name: str, run: Callable[[argparse.Namespace], int], purpose: str, description: str
) -> argparse.ArgumentParser:
    """Declares a command.

    Args:
        commands: Subparsers of the program.
        name: What is typed.
        run: Runs it with what was parsed, and gives its exit code.
        purpose: What it is for, in the list of commands.
        description: What its own help says of it.

    Returns:
        Its parser, to which its arguments are added.
    """
    parser = commands.add_parser(name, help=purpose, description=description, epilog=EXIT_CODES)
    parser.set_defaults(run=run)
    return parser


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Declares the one scene that a command is about."""
    parser.add_argument("scene", metavar="SCENE", type=Path, help="scene file (YAML)")


def refuse(chosen: argparse.Namespace, needed: str, *options: str) -> None:
    """Says that options do nothing without another, rather than ignore them."""
    for option in options:
        if getattr(chosen, option) is not None:
            name = option.replace("_", "-")
            raise OptionError(f"--{name}", f"goes with {needed}")


def count(text: str) -> int:
    """A number from 0."""
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text} must not be negative")
    return number


def positive_count(text: str) -> int:
    """A number from 1."""
    number = count(text)
    if number == 0:
        raise argparse.ArgumentTypeError(f"{text} must be above zero")
    return number


def rate(text: str) -> float:
    """A rate that a clock can keep [Hz]."""
    number = float(text)
    if not 0.1 <= number <= 10_000.0:
        raise argparse.ArgumentTypeError(f"{text} must lie in 0.1..10000 Hz")
    return number


def seconds(text: str) -> float:
    """A length of a run [s]."""
    number = float(text)
    if not 1.0 <= number <= 3600.0:
        raise argparse.ArgumentTypeError(f"{text} must lie in 1..3600 s")
    return number


def duration(text: str) -> float:
    """A time that a scene is left to itself [s]."""
    number = float(text)
    if not 0.0 < number <= 86_400.0:
        raise argparse.ArgumentTypeError(f"{text} must lie above 0 and up to 86400 s")
    return number
