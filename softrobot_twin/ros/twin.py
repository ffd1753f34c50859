"""The twin: runs the simulation against the clock."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from softrobot_twin.ros.process import run_node


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``twin``.

    Args:
        arguments: Command line, or None for the process's own.

    Returns:
        Exit code.
    """
    return run_node("twin", _load, arguments)


def _load() -> type:
    from softrobot_twin.ros.twin_node import TwinNode

    return TwinNode


if __name__ == "__main__":
    sys.exit(main())
