"""The twin's account of its contacts, for ``/diagnostics``."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.scene.schema import Contact

_MILLI = 1.0e3


_EXCEEDED = ".force_limit_exceeded"


def contact_account(
    contact: Contact, tally: DiagnosticsWindow, follows: bool
) -> tuple[bytes, str, dict[str, object]]:
    """How many contacts there are, who touches whom how hard, and how exactly that was solved.

    Args:
        contact: The scene's entry, for its tolerance.
        tally: What happened since the last account.
        follows: Targets are followed: contacts are found by programs, not by sweeps.

    Returns:
        Level, a sentence and values.
    """
    if tally.newest is None:
        return DiagnosticStatus.OK, "no tick yet", {}
    count = tally.newest.result.report.contact_count
    values = {
        "count": count,
        "count_max": tally.contact_count_max,
        "programs_max" if follows else "sweeps_max": tally.contact_sweeps_max,
        "residual_mm": tally.contact_residual_max * _MILLI,
        "force_residual_n": tally.contact_force_residual_max,
        "overlap_max_mm": tally.overlap_max * _MILLI,
    }
    for (first, second), force in sorted(tally.contact_forces.items()):
        pair = f"{first} by {second}"
        resultant = tally.contact_resultants[first, second]
        values[f"resultant_max_n: on {pair}"] = " ".join(f"{value:.6g}" for value in resultant)
        values[f"sum_of_magnitudes_max_n: on {pair}"] = tally.contact_magnitude_sums[first, second]
        values[f"one_contact_max_n: on {pair}"] = force
    given_up = sorted(name for name in tally.limits if name.endswith(_EXCEEDED))
    if contact.force_limit is not None:
        values |= {"force_limit_n": contact.force_limit, "given_up": " ".join(given_up)}
    # A residual that is not a number is not within the tolerance either.
    if not tally.contact_residual_max <= contact.tolerance:
        return DiagnosticStatus.WARN, "not solved to the tolerance", values
    if given_up:
        return DiagnosticStatus.WARN, f"given up: {', '.join(given_up)}", values
    return DiagnosticStatus.OK, f"{count} touching" if count else "nothing touches", values
