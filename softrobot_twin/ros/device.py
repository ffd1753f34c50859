"""The simulated device: stands where the hardware would."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from softrobot_twin.ros.process import run_node


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``device``.

    Args:
        arguments: Command line, or None for the process's own.

    Returns:
        Exit code.
    """
    return run_node("device", _load, arguments)


def _load() -> type:
    from softrobot_twin.ros.device_node import DeviceNode

    return DeviceNode


if __name__ == "__main__":
    sys.exit(main())
