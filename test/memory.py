"""Memory that a process takes."""

import os
from pathlib import Path


def resident_memory() -> int:
    """Memory of this process [B]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
