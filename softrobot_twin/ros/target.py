"""The target: leads an effector along a path."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from softrobot_twin.ros.process import run_node


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``target``.

    Args:
        arguments: Command line, or None for the process's own.

    Returns:
        Exit code.
    """
    return run_node("target", _load, arguments)


def _load() -> type:
    from softrobot_twin.ros.target_node import TargetNode

    return TargetNode


if __name__ == "__main__":
    sys.exit(main())
