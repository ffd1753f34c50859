"""The native viewer as a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys


def open_viewer(address: str) -> subprocess.Popen | None:
    """Open a viewer on an address, where there is a display to open it on.

    The viewer is that of this environment's rerun. It is detached: it survives this process, and
    its end does not matter to it.

    Args:
        address: What the viewer joins, such as ``rerun+http://127.0.0.1:9876/proxy``.

    Returns:
        Its process, or None without a display.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None
    # A viewer also listens for senders, by default on every interface: keep it to this machine.
    command = [sys.executable, "-m", "rerun_cli", "--connect", address, "--bind", "127.0.0.1",
               "--port", "auto"]
    return subprocess.Popen(command, start_new_session=True, stdin=subprocess.DEVNULL,
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
