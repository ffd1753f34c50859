"""``python -m softrobot_twin``: simulate, explain, workspace, bench, accuracy, choose,
reduce, reduce-vertebrae, demo.
"""

import argparse
import sys
from importlib.metadata import PackageNotFoundError, version

from softrobot_twin.command_line.commands import (
    EXIT_CODES,
    add_accuracy,
    add_bench,
    add_choose,
    add_demo,
    add_explain,
    add_reduce,
    add_reduce_vertebrae,
    add_simulate,
    add_workspace,
)
from softrobot_twin.errors import SoftRobotTwinError


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    chosen = _parser().parse_args(arguments)
    try:
        return chosen.run(chosen)
    except SoftRobotTwinError as error:
        print(f"softrobot_twin: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("softrobot_twin: stopped", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m softrobot_twin", epilog=EXIT_CODES,
        description="Simulate and control soft robots. All values are in SI units.")
    parser.add_argument("--version", action="version", version=f"softrobot_twin {_version()}")
    commands = parser.add_subparsers(title="commands", dest="command", required=True)
    for add in (add_simulate, add_explain, add_workspace, add_bench, add_accuracy, add_choose,
                add_reduce, add_reduce_vertebrae, add_demo):
        add(commands)
    return parser


def _version() -> str:
    try:
        return version("softrobot_twin")
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
