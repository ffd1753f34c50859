"""Memory that this process holds, as the system sees it."""

from __future__ import annotations

import os
import resource
from pathlib import Path


def resident_bytes() -> int | None:
    """Memory in RAM now; None where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def page_faults() -> int:
    """Pages that this process had to be given so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
