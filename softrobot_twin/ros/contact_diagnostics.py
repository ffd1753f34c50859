"""The twin's account of its contacts, for ``/diagnostics``."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from softrobot_twin.control.tally import Tally
from softrobot_twin.scene.surroundings import Contact

_MILLI = 1.0e3


def contact_account(contact: Contact, tally: Tally) -> tuple[bytes, str, dict[str, object]]:
    """How many contacts there are, and how exactly they were solved at worst.

    Args:
        contact: The scene's entry, for its tolerance.
        tally: What happened since the last account.

    Returns:
        Level, a sentence and values.
    """
    if tally.newest is None:
        return DiagnosticStatus.OK, "no tick yet", {}
    count = tally.newest.result.report.contact_count
    values = {
        "count": count,
        "count_max": tally.contact_count_max,
        "sweeps_max": tally.contact_sweeps_max,
        "residual_mm": tally.contact_residual_max * _MILLI,
        "force_residual_n": tally.contact_force_residual_max,
        "overlap_max_mm": tally.overlap_max * _MILLI,
    }
    # A residual that is not a number is not within the tolerance either.
    if not tally.contact_residual_max <= contact.tolerance:
        return DiagnosticStatus.WARN, "not solved to the tolerance", values
    return DiagnosticStatus.OK, f"{count} touching" if count else "nothing touches", values
